"""Real processes that die, are killed, start twice and find no room: nothing is lost or left."""

import importlib
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from asyncio import CancelledError
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import esfem_core as ec
from esfem_core.study import StudyWarning, UnsavedRowsError, WorkerLostError, grid, read, run
from esfem_core.study.rows import Row, Store

pytestmark = pytest.mark.slow  # a minute of processes that start, wait and are killed
posix = pytest.mark.skipif(sys.platform == "win32", reason="signals and limits of POSIX")

FORK = multiprocessing.get_context("fork") if sys.platform != "win32" else None


def started(function, *arguments):
    """A process that does not import everything again, in a session of its own."""

    def begin():
        os.setsid()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            function(*arguments)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of fork, where there are threads
        process = FORK.Process(target=begin)
        process.start()
    return process


def ended(process):
    process.join()
    process.close()


def slow(size, folder):
    """Compute something that takes its time, and say where."""
    with (Path(folder) / "log").open("a") as log:
        log.write(f"{size} {os.getpid()}\n")
    time.sleep(0.05)
    return {"size": size, "text": "x" * 200}


def study(folder, cases, workers):
    found = run(
        grid(size=range(cases), folder=[str(folder)]),
        slow,
        folder,
        workers=workers,
        progress=lambda line: (folder / "told").open("a").write(f"{line}\n"),
    )
    (folder / "end").open("a").write(f"{len(found.rows)}\n")


def until(true, seconds=60):
    """Wait for something to become true."""
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "it has not come true"
        time.sleep(0.02)


def sizes(folder):
    return sorted(row.parameters["size"] for row in read(folder / "slow.jsonl"))


def living(session):
    """Processes of a session that have not ended."""
    listed = subprocess.run(
        ["ps", "-A", "-o", "sess=,stat="], capture_output=True, text=True, check=True
    )
    lines = map(str.split, listed.stdout.splitlines())
    return sum(line[0] == str(session) and line[1][0] != "Z" for line in lines)


def weak(size, folder):
    """Compute what kills its process in several ways, once or always."""
    once = Path(folder) / f"{size}"
    if size == 1:
        os._exit(9)
    if size == 2:
        sys.exit("enough")
    if size == 3 and not once.exists():
        once.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if size == 4:
        raise OSError(28, "No space left")
    return {"size": size, "threads": os.environ.get("OMP_NUM_THREADS")}


@posix
def test_a_process_that_dies_takes_no_other_case_with_it(tmp_path):
    cases = grid(size=(0, 1, 2, 4, 5), folder=[str(tmp_path)])
    with pytest.warns(StudyWarning, match="^3 of the cases failed"):
        results = run(cases, weak, tmp_path, workers=1, threads=3, progress=False)
    assert [row.results for row in results.rows] == [
        {"size": size, "threads": "3"} for size in (0, 5)
    ]
    told = {f.parameters["size"]: f"{type(f.error).__name__}: {f.error}" for f in results.failures}
    assert told == {
        1: "WorkerLostError: the process that computed it ended with exit code 9",
        2: "RuntimeError: the case ended with sys.exit('enough')",
        4: "OSError: [Errno 28] No space left",
    }
    assert multiprocessing.active_children() == []


@posix
def test_a_pool_that_breaks_is_replaced(tmp_path):
    cases = grid(size=(0, 3, 5), folder=[str(tmp_path)])
    context = multiprocessing.get_context("spawn")
    with (
        ProcessPoolExecutor(1, mp_context=context) as pool,
        pytest.warns(StudyWarning, match="^the executor is broken .* new processes go on$") as told,
    ):
        results = run(cases, weak, tmp_path, pool, workers=1, progress=False)
    assert told[0].filename == __file__
    assert [row.parameters["size"] for row in results.rows] == [0, 3, 5]
    assert results.failures == []


@posix
def test_a_killed_study_leaves_no_process_and_goes_on(tmp_path):
    first = started(study, tmp_path, 400, 1)
    until(lambda: len(sizes(tmp_path)) >= 3)
    assert living(first.pid) >= 2
    first.kill()
    first.join()
    until(lambda: living(first.pid) == 0)
    kept = sizes(tmp_path)
    (tmp_path / "told").unlink()
    ended(started(study, tmp_path, 10, 0))
    told = (tmp_path / "told").read_text().splitlines()
    assert sum(line.endswith("found") for line in told) == len(set(kept) & set(range(10))) >= 3
    assert sizes(tmp_path) == sorted({*kept, *range(10)})
    assert {p.name for p in tmp_path.iterdir()} == {"end", "log", "slow.jsonl", "told"}


@posix
def test_two_studies_at_once_share_the_cases(tmp_path):
    for process in [started(study, tmp_path, 30, 0) for _ in range(2)]:
        ended(process)
    assert (tmp_path / "end").read_text() == "30\n30\n"
    assert sizes(tmp_path) == list(range(30))
    log = [line.split() for line in (tmp_path / "log").read_text().splitlines()]
    assert sorted(int(size) for size, _ in log) == list(range(30))  # none was computed twice
    assert len({pid for _, pid in log}) == 2


def claiming(path):
    store = Store(path)
    assert store.claim({"size": 1})
    path.with_name("claimed").touch()
    time.sleep(60)


@posix
def test_a_case_that_a_killed_study_had_begun_is_free(tmp_path):
    other = started(claiming, tmp_path / "a.jsonl")
    until((tmp_path / "claimed").exists)
    here = Store(tmp_path / "a.jsonl")
    assert not here.claim({"size": 1})
    assert here.claim({"size": 2})
    other.kill()
    ended(other)
    assert here.claim({"size": 1})
    here.close()


def hammering(folder):
    """Write new rows, and rows in the place of others, and say which are written."""
    store = Store(folder / "a.jsonl")
    with (folder / "written").open("ab", buffering=0) as file:
        for n in range(100000):
            row = Row({"size": n % 30}, {"n": n}, {"esfem_core": f"0, source {n}", "x": "x" * 9999})
            store.put(row)
            file.write(b".")
            if n % 40 == 39:
                store.close()  # leaves a new file without what does not count
                store = Store(folder / "a.jsonl")


@posix
@pytest.mark.parametrize("seed", range(3))
def test_what_was_written_survives_kills_at_any_moment(tmp_path, seed):
    random = np.random.default_rng(seed)
    for _ in range(4):
        for path in tmp_path.iterdir():
            path.unlink()
        process = started(hammering, tmp_path)
        until((tmp_path / "written").exists)
        time.sleep(0.1 * random.random())
        process.kill()
        ended(process)
        written = (tmp_path / "written").stat().st_size
        rows = read(tmp_path / "a.jsonl")
        assert max([row.results["n"] for row in rows], default=-1) in (written - 1, written)
        assert len({row.parameters["size"] for row in rows}) == len(rows) >= min(written, 30)
        store = Store(tmp_path / "a.jsonl")
        store.put(Row({"size": -1}, {}, {}))
        store.close()
        assert len(read(tmp_path / "a.jsonl")) == len(rows) + 1


def filling(folder):
    """Compute with no more room than for half of the rows."""
    import resource

    study(folder, 1, 0)
    (rows,) = folder.glob("*.jsonl")
    room = 7 * rows.stat().st_size // 2
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, resource.RLIM_INFINITY))
    try:
        study(folder, 6, 0)
    except UnsavedRowsError as error:
        (folder / "error").write_text(str(error))
        (folder / "rows").write_text(str([row.parameters["size"] for row in error.rows]))


@posix
def test_rows_without_room_are_set_aside_and_the_advice_brings_them_back(tmp_path):
    folder = tmp_path / "my results; 'all'"
    folder.mkdir()
    ended(started(filling, folder))
    assert sizes(folder) == [0, 1, 2]
    assert (folder / "rows").read_text() == "[3, 4, 5]"
    told, _, advice = (folder / "error").read_text().partition("; make room, then: ")
    assert told.startswith("3 finished rows could not be written (File too large).")
    subprocess.run(advice, shell=True, check=True)
    assert sizes(folder) == list(range(6))


@posix
def test_a_loop_that_is_left_ends_its_processes_and_keeps_what_is_finished(tmp_path):
    cases = [[case] for case in grid(size=(0, 5, 6, 7), folder=[str(tmp_path)])]
    study = ec.study.Experiment("weak", "", weak, cases)
    for outcome in ec.study.outcomes([study], tmp_path, workers=1):
        assert outcome.row
        break
    assert multiprocessing.active_children() == []
    assert outcome.row in read(tmp_path / "weak.jsonl")


NOTEBOOK = """
import sys, json
if {hide}:
    sys.modules["cloudpickle"] = None
import esfem_core as ec
FACTOR = 3
def compute(size):
    return {{"n": FACTOR * size}}
for workers in {workers}:
    try:
        found = ec.study.run(ec.study.grid(size=(1, 2)), compute, {folder!r}, workers=workers)
        print([row.results["n"] for row in found.rows])
    except ValueError as error:
        print(error)
"""


def python(*arguments, **options):
    return subprocess.run(
        [sys.executable, *arguments],
        env=os.environ | {"PYTHONPATH": str(Path(ec.__file__).parents[1])},
        capture_output=True,
        text=True,
        **options,
    )


def test_functions_of_a_notebook_are_sent_to_processes(tmp_path):
    pytest.importorskip("cloudpickle")
    # The functions of a notebook stand in no file, like those of this command.
    script = NOTEBOOK.format(hide=False, folder=str(tmp_path), workers=(1,))
    found = python("-c", script, check=True)
    assert found.stdout == "[3, 6]\n"
    assert "2/2" in found.stderr  # tqdm


CACHING = """
import functools
import esfem_core as ec
made = []
@functools.cache
def mesh(n):
    made.append(n)
    return ec.sphere("octahedron", n)
@functools.lru_cache(maxsize=None)
def factorial(n):
    return n * factorial(n - 1) if n else 1
def compute(n, i):
    return {{"n": len(mesh(n).faces) * factorial(i), "made": len(made)}}
cases = ec.study.grid(n=(1, 2), i=(1, 2, 3))
found = ec.study.run(cases, compute, {folder!r}, workers=1, progress=False)
print([row.results["n"] for row in found.rows], found.rows[-1].results["made"])
"""


def test_cached_functions_of_a_notebook_are_sent_and_keep_what_they_have_made(tmp_path):
    pytest.importorskip("cloudpickle")
    found = python("-c", CACHING.format(folder=str(tmp_path)), check=True)
    assert found.stdout == "[32, 64, 192, 128, 256, 768] 2\n"


def test_where_they_cannot_be_sent_this_is_said_and_they_can_be_computed_here(tmp_path):
    script = NOTEBOOK.format(hide=True, folder=str(tmp_path), workers=(1, 0))
    refused, computed = python("-c", script, check=True).stdout.splitlines()
    assert refused.startswith("compute must be a function that another process can read, but 'com")
    assert "install cloudpickle (pip install cloudpickle), put it into a module, or" in refused
    assert refused.endswith("compute in this process with workers=0")
    assert computed == "[3, 6]"


UNGUARDED = """
import sys
import esfem_core as ec
def compute(size):
    return {"size": size}
ec.study.run(ec.study.grid(size=(1, 2)), compute, sys.argv[1], workers=1, progress=False)
"""


@posix
def test_a_script_without_a_guard_ends_and_says_what_is_missing(tmp_path):
    (tmp_path / "script.py").write_text(UNGUARDED)
    out = python(tmp_path / "script.py", tmp_path, timeout=300).stderr
    assert out.splitlines()[-1].startswith("esfem_core.study.processes.WorkerLostError: a process")
    assert 'what starts a study must stand under `if __name__ == "__main__":`' in out


def test_errors_that_cannot_be_sent_are_told():
    from esfem_core.study.processes import transportable

    class OwnError(Exception):
        def __init__(self, one, two):
            super().__init__(f"{one} and {two}")

    found = transportable(OwnError(1, 2))
    assert (type(found), str(found)) == (RuntimeError, "OwnError: 1 and 2")
    assert json.dumps(str(transportable(ValueError("a"))))

    class SilentError(Exception):
        def __str__(self):
            return self.missing

    found = transportable(SilentError())
    assert (type(found), str(found)) == (RuntimeError, "SilentError: <no text>")
    assert "SilentError" in found.__notes__[0]


@dataclass(frozen=True)
class FrozenError(Exception):
    n: int = 0


class NotedError(Exception):
    def add_note(self, note):
        raise TypeError("no notes")


def raising(kind):
    if kind:
        raise {"frozen": FrozenError, "noted": NotedError}[kind]()
    return {"y": 1}


@pytest.mark.parametrize("workers", [0, 1])
def test_errors_that_take_no_note_end_no_other_case(tmp_path, workers):
    cases = [{"kind": kind} for kind in ("frozen", "noted", "")]
    with pytest.warns(StudyWarning, match="2 of the cases failed"):
        results = run(cases, raising, tmp_path, workers=workers, progress=False)
    assert [row.parameters["kind"] for row in results.rows] == [""]
    told = [str(failure.error).partition(":")[0] for failure in results.failures]
    assert told == ["FrozenError", "NotedError"]
    assert all("in raising" in failure.error.__notes__[0] for failure in results.failures)


@pytest.mark.parametrize("kind", [CancelledError, GeneratorExit, SystemExit])
@pytest.mark.parametrize("workers", [0, 1])
def test_whatever_a_case_raises_ends_no_other(tmp_path, kind, workers):
    def compute(size):
        if size == 1:
            raise kind("lost")
        return {"y": size}

    with pytest.warns(StudyWarning, match="1 of the cases failed"):
        results = run(grid(size=range(3)), compute, tmp_path, workers=workers, progress=False)
    assert [row.parameters["size"] for row in results.rows] == [0, 2]
    [failure] = results.failures
    assert type(failure.error) is RuntimeError
    assert "lost" in str(failure.error)


def test_a_pool_ends_when_it_is_shut_down():
    with ec.study.Processes(1) as pool:
        futures = [pool.submit(abs, -n) for n in range(3)]
        assert pool.submit(divmod, 1, 0).exception().args == ("integer division or modulo by zero",)
    assert [future.result() for future in futures] == [0, 1, 2]
    assert multiprocessing.active_children() == []
    with pytest.raises(RuntimeError, match="cannot schedule new futures after shutdown"):
        pool.submit(abs, 1)
    assert issubclass(WorkerLostError, RuntimeError)


def doubled(x):
    return {"y": 2 * x}


def pooled(method):
    if method == "study":
        with tempfile.TemporaryDirectory() as folder:
            [row] = run([{"x": 1}], doubled, folder, workers=1, progress=False).rows
        return row.results
    with ProcessPoolExecutor(1, multiprocessing.get_context(method)) as pool:
        return pool.submit(doubled, 1).result()


def test_a_case_may_have_processes_of_its_own(tmp_path):
    results = run(grid(method=("spawn", "study")), pooled, tmp_path, workers=1, progress=False)
    assert [row.results for row in results.rows] == [{"y": 2}] * 2, results


def starting(folder, size):
    """Start a program and a process that would go on for long."""
    subprocess.Popen(["sleep", "77"])
    multiprocessing.get_context("spawn").Process(target=time.sleep, args=(77,)).start()
    (Path(folder) / f"started{size}").touch()
    if size == 0:
        os._exit(3)
    time.sleep(77)


def starting_study(folder):
    cases = [{"folder": str(folder), "size": size} for size in (0, 1)]
    run(cases, starting, folder, workers=1, progress=False)


@posix
def test_a_killed_study_leaves_none_of_what_its_cases_have_started(tmp_path):
    first = started(starting_study, tmp_path)
    until((tmp_path / "started1").exists)
    assert living(first.pid) >= 4
    first.kill()
    first.join()
    until(lambda: living(first.pid) == 0, 20)


@posix
def test_a_case_whose_process_dies_leaves_none_of_what_it_has_started(tmp_path):
    study = ec.study.Experiment("a", "", starting, [[{"folder": str(tmp_path), "size": 0}]])
    [outcome] = ec.study.outcomes([study], tmp_path, workers=1)
    assert isinstance(outcome.error, WorkerLostError)
    listed = subprocess.run(["ps", "-A", "-o", "args="], capture_output=True, text=True, check=True)
    assert "sleep 77" not in listed.stdout.splitlines()


SETTINGS = """
import numpy as np
OPTIONS = {"factor": 1}
WEIGHTS = np.ones(1)
class Config:
    factor = 1
config = Config()
DRAWN = np.random.default_rng().random()
NAMES = {"a", "b", ("c", "d")}
def by_dict(n): return {"y": OPTIONS["factor"] * n}
def by_array(n): return {"y": WEIGHTS[0] * n}
def by_class(n): return {"y": Config.factor * n}
def by_object(n): return {"y": config.factor * n}
def honest(n): return {"y": n if NAMES else 0}
def drawn(n): return {"y": n + (DRAWN < 0)}
"""


@pytest.fixture
def settings(tmp_path, monkeypatch):
    (tmp_path / "settings_of_a_study.py").write_text(SETTINGS)
    monkeypatch.syspath_prepend(tmp_path)
    yield importlib.import_module("settings_of_a_study")
    del sys.modules["settings_of_a_study"]


@pytest.mark.parametrize("name", ["by_dict", "by_array", "by_class", "by_object"])
def test_what_was_set_in_a_module_after_its_import_is_not_missed_in_silence(
    tmp_path, settings, name
):
    settings.OPTIONS["factor"] = settings.WEIGHTS[0] = 5
    settings.Config.factor = settings.config.factor = 5
    with pytest.warns(StudyWarning, match="2 of the cases failed"):
        results = run(grid(n=(1, 2)), getattr(settings, name), tmp_path, workers=1, progress=False)
    assert results.rows == []
    assert "hand it over as a parameter, or compute with workers=0" in str(
        results.failures[0].error
    )


def test_what_is_the_same_in_processes_or_other_in_each_is_computed(tmp_path, settings):
    from functools import partial

    names, factor = settings.NAMES, {"factor": 3}

    def enclosing(n):
        return {"y": factor["factor"] * n + (len(names) < 0) + settings.honest(n)["y"]}

    honest = settings.honest, settings.drawn, settings.by_object, enclosing, partial(settings.drawn)
    for function in honest:
        results = run([{"n": 2}], function, tmp_path, name="a", workers=1, progress=False)
        assert results.failures == []
    assert results.rows[0].results == {"y": 2}


def forking(*, i):
    if i == 0:
        os.fork()
    return {"i": i}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_case_that_forks_is_answered_once(tmp_path):
    cases = [{"i": i} for i in range(4)]
    result = run(cases, forking, tmp_path, workers=1, progress=False)
    assert sorted((row.parameters["i"], row.results["i"]) for row in result.rows) == [
        (i, i) for i in range(4)
    ]
