"""Saved runs go on bit for bit; damaged files are refused."""

import inspect
import io
import json
import os
import re
import signal
import subprocess
import sys
import tracemalloc
import zipfile
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from coupled import SPACE, coupled
from full_disk import room
from hemisphere import hemisphere

import esfem_core as ec
from esfem_core.stepping.checkpoints import close_idle

MASSES = ["updated", "extrapolated", "reassembled"]


PROBLEMS = {
    "coupled": coupled(),
    "moved alone": ec.Problem(
        species={}, law=ec.laws.Regularised(1, 1, lambda at: at.points[..., 0])
    ),
    "motion": ec.Problem(1.0, motion=lambda p, t: p * [1 + 0.3 * np.sin(t), 1, np.exp(-t)]),
    "velocity": ec.Problem(
        species={"u": ec.Species(lambda x: x[:, 0])},
        law=ec.laws.Prescribed(velocity=lambda x, t: x * np.sin(t)),
    ),
}


def same(one, other, tolerance=None):
    """Whether states are the same, bit for bit or nearly."""
    assert one.t == other.t
    assert list(one.fields) == list(other.fields)
    assert list(one.products) == list(other.products)
    pairs = [(one.x, other.x), (one.v, other.v)]
    pairs += [(one.fields[name], other.fields[name]) for name in one.fields]
    pairs += [(one.products[name], other.products[name]) for name in one.products]
    for a, b in pairs:
        if tolerance is None:
            np.testing.assert_array_equal(a, b)
        elif a is not None:
            np.testing.assert_allclose(a, b, rtol=0, atol=tolerance)


@pytest.mark.parametrize("mass", MASSES)
@pytest.mark.parametrize("kind", PROBLEMS)
@pytest.mark.parametrize(("solver", "tolerance"), [("direct", None), ("lagged", 1e-9)])
def test_a_run_that_is_saved_and_read_goes_on_as_if_it_had_not_stopped(
    tmp_path, kind, mass, solver, tolerance
):
    options = {"order": 3, "step": 0.05, "end": 0.6, "mass": mass, "solver": solver}
    states = list(ec.evolve(SPACE, PROBLEMS[kind], **options))
    for stopped in (3, 4, 8):  # right after the starting values, among them, and later
        ec.save(tmp_path / "run.npz", states[stopped - 3 : stopped])
        space, start = ec.load(tmp_path / "run.npz")
        again = list(ec.evolve(space, PROBLEMS[kind], **options, start=start))
        assert len(again) == len(states) - stopped + 3
        for one, other in zip(again, states[stopped - 3 :], strict=True):
            same(one, other, tolerance)


def test_the_space_that_is_read_is_the_same_bit_for_bit(tmp_path):
    for degree, exactness in ((1, None), (1, 100), (2, 5), (4, None), (5, 13)):
        space = ec.SurfaceSpace(ec.torus(1.0, 0.4, 6), degree, exactness=exactness)
        ec.save(tmp_path / "run.npz", ec.State(0.1, space.nodes, space=space))
        other, [state] = ec.load(tmp_path / "run.npz")
        assert state.space is other
        assert state.t == 0.1
        assert other.degree == degree
        for one, two in [
            (space.nodes, other.nodes),
            (space.cells, other.cells),
            (space.rule.points, other.rule.points),
            (space.elimination_order, other.elimination_order),
            (space.mass_stiffness(space.nodes)[1].data, other.mass_stiffness(other.nodes)[1].data),
        ]:
            np.testing.assert_array_equal(one, two)


def test_a_surface_with_a_boundary_is_read_back(tmp_path):
    space = hemisphere(0, 2)
    ec.save(tmp_path / "run.npz", ec.State(0.0, space.nodes, space=space))
    again, _ = ec.load(tmp_path / "run.npz")
    assert len(again.boundary_nodes) > 0
    np.testing.assert_array_equal(again.boundary_nodes, space.boundary_nodes)


KILLED = """
import os, signal, sys
import esfem_core as ec
from coupled import SPACE, coupled

class Source:
    def __call__(self, at):  # in the middle of a step, when half of its systems are solved
        if at.t > 0.42:
            os.kill(os.getpid(), signal.SIGKILL)
        return 0.0

problem = coupled(source=Source())
for state in ec.evolve(SPACE, problem, 3, 0.05, 0.6, solver="direct", save=sys.argv[1], every=2):
    print(state.t, flush=True)
"""


def test_a_run_killed_in_the_middle_of_a_step_goes_on_bit_for_bit(tmp_path):
    path = tmp_path / "run.npz"
    folders = [str(Path(ec.__file__).parents[1]), str(Path(__file__).parents[1])]
    killed = subprocess.run(
        [sys.executable, "-c", KILLED, path],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(folders)},
        capture_output=True,
        text=True,
    )
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    assert killed.stdout.split()[-1] == "0.4"
    space, start = ec.load(path)
    assert start[-1].t == 0.4
    whole = list(ec.evolve(SPACE, coupled(), 3, 0.05, 0.6, solver="direct"))
    again = list(ec.evolve(space, coupled(), 3, 0.05, 0.6, solver="direct", start=start))
    for one, other in zip(again, whole[-len(again) :], strict=True):
        same(one, other)


def test_evolve_saves_after_the_starting_values_every_so_many_steps_and_at_the_end(tmp_path):
    path, held = tmp_path / "run.npz", []
    run = ec.evolve(SPACE, coupled(), 3, 0.1, 1.2, save=path, every=4)
    for state in run:
        held.append((state.t, ec.load(path)[1][-1].t if path.exists() else None))
    assert held == [
        (0.0, None), (0.1, None), (0.2, 0.2), (0.3, 0.2), (0.4, 0.2), (0.5, 0.2), (0.6, 0.6),
        (0.7, 0.6), (0.8, 0.6), (0.9, 0.6), (1.0, 1.0), (1.1, 1.0), (1.2, 1.0),
    ]  # fmt: skip
    assert [state.t for state in ec.load(path)[1]] == [0.9, 1.0, 1.1, 1.2]
    assert [file.name for file in tmp_path.iterdir()] == ["run.npz"]


def test_a_run_that_fails_leaves_its_last_good_states(tmp_path):
    path = tmp_path / "run.npz"
    problem = ec.Problem(
        1.0, f=lambda at: at.u * (np.nan if at.t > 0.72 else 1.0), motion=lambda p, t: p
    )
    with pytest.raises(ec.EvolutionError, match="nan") as failed:
        list(ec.evolve(SPACE, problem, 2, 0.1, 2.0, save=path))
    [note] = failed.value.__notes__
    assert note == (
        f"'{path}' holds the good states up to t = 0.7: space, states = esfem_core.load('{path}'), "
        "then evolve(..., start=states) goes on from them"
    )
    assert [state.t for state in ec.load(path)[1]] == [0.5, 0.6, 0.7]


def test_a_run_that_is_left_saves_its_last_states_when_it_is_closed(tmp_path):
    path = tmp_path / "run.npz"
    for taken in (2, 5):  # in place of no file, and of one from an earlier run
        run = ec.evolve(SPACE, coupled(), 2, 0.1, 1.0, save=path)
        states = list(islice(run, taken))
        run.close()
        assert ec.load(path)[1][-1].t == states[-1].t
    run = ec.evolve(SPACE, coupled(), 2, 0.1, 1.0, save=path)
    states = list(islice(run, 4))
    path.unlink()
    run.close()
    assert ec.load(path)[1][-1].t == states[-1].t


ENDED = """
import sys
import esfem_core as ec

space = ec.SurfaceSpace(ec.sphere("octahedron", 0))
run = ec.evolve(space, ec.Problem(1.0, motion=lambda p, t: p), 2, 0.1, 1.0, save=sys.argv[1])
for state in run:
    if state.t > 0.65:
        sys.exit("enough")
"""


def test_a_script_that_ends_with_a_run_in_a_variable_saves_its_last_states(tmp_path):
    path = tmp_path / "run.npz"
    ended = subprocess.run(
        [sys.executable, "-c", ENDED, path],
        env=os.environ | {"PYTHONPATH": str(Path(ec.__file__).parents[1])},
        capture_output=True,
        text=True,
    )
    assert (ended.returncode, ended.stderr) == (1, "enough\n")
    assert ec.load(path)[1][-1].t == 0.7


def test_a_run_is_not_closed_in_the_middle_of_a_step():
    def steps():
        close_idle(run)
        yield from (1, 2)

    run = steps()
    assert next(run) == 1
    close_idle(run)
    assert list(run) == []


@pytest.mark.parametrize("every", [2, 50])
def test_a_run_that_is_left_does_not_replace_the_states_of_one_that_has_gone_on(tmp_path, every):
    path = tmp_path / "run.npz"
    left = ec.evolve(SPACE, coupled(), 2, 0.1, 1.0, save=path, every=every)
    states = list(islice(left, 5))
    start = ec.respaced(states, 0.05, order=2)
    *_, last = ec.evolve(SPACE, coupled(), 2, 0.05, 0.6, start=start, save=path)
    left.close()
    same(ec.load(path)[1][-1], last)


@pytest.mark.parametrize("mass", ["updated", "extrapolated"])
def test_a_run_that_goes_on_and_fails_at_once_leaves_its_file_as_good_as_it_was(tmp_path, mass):
    path = tmp_path / "run.npz"
    failing = coupled(source=lambda at: at["u"] * np.nan)
    list(ec.evolve(SPACE, coupled(), 3, 0.1, 0.8, mass=mass, save=path))
    space, states = ec.load(path)
    with pytest.raises(ec.EvolutionError, match="nan"):
        list(ec.evolve(space, failing, 3, 0.1, 1.0, mass=mass, start=states, save=path))
    _, again = ec.load(path)
    for one, other in zip(again, states, strict=True):
        same(one, other)
    run = ec.evolve(space, coupled(), 3, 0.1, 1.0, start=states, save=tmp_path / "new.npz")
    list(islice(run, 2))
    run.close()
    assert not (tmp_path / "new.npz").exists()  # its starting values were not yet known


def test_a_state_before_those_to_start_from_that_does_not_fit_is_not_saved(tmp_path):
    path = tmp_path / "run.npz"
    states = list(ec.evolve(SPACE, coupled(), 2, 0.1, 0.4))
    other = ec.SurfaceSpace(ec.sphere("octahedron", 0))
    for unfit in (
        ec.State(0.2, other.nodes, space=other),
        ec.State(0.2, SPACE.nodes),
        ec.State(0.2, np.nan * SPACE.nodes, fields=states[2].fields),
        states[-1],
    ):
        start = [unfit, *states[-2:]]
        list(ec.evolve(SPACE, coupled(), 2, 0.1, 0.4, start=start, save=path))
        assert [state.t for state in ec.load(path)[1]] == [0.3, 0.4]


def test_a_run_that_comes_to_its_end_saves_it_whatever_the_file_holds(tmp_path):
    path = tmp_path / "run.npz"
    run = ec.evolve(SPACE, coupled(), 2, 0.1, 0.8, save=path)
    states = list(islice(run, 4))
    ec.save(path, states)
    *_, last = run
    same(ec.load(path)[1][-1], last)


def test_a_full_disk_leaves_the_older_file_whole(tmp_path):
    path = tmp_path / "run.npz"
    states = list(ec.evolve(SPACE, coupled(), 2, 0.1, 0.4))
    ec.save(path, states[:2])
    before = path.read_bytes()
    message = r"File too large; the file is as it was: make room.*run\.npz"
    with room(1000), pytest.raises(OSError, match=message):
        ec.save(path, states)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["run.npz"]


def test_a_run_goes_on_and_leaves_a_file_that_is_write_protected_meanwhile(tmp_path, monkeypatch):
    path, access = tmp_path / "run.npz", os.access
    run = ec.evolve(SPACE, coupled(), 2, 0.1, 0.8, save=path, every=2)
    list(islice(run, 3))
    before = path.read_bytes()
    monkeypatch.setattr(  # who runs the tests may be root, who may write anywhere
        os, "access", lambda asked, mode: asked != path and access(asked, mode)
    )
    with pytest.warns(ec.EvolutionWarning, match=r"t = 0\.3 could not be saved .*write-protected"):
        list(islice(run, 2))
    assert path.read_bytes() == before
    monkeypatch.undo()
    *_, last = run
    same(ec.load(path)[1][-1], last)


def test_every_without_a_file_to_save_to_is_refused():
    with pytest.raises(ValueError, match="every needs a file to save to, got every=5 without save"):
        ec.evolve(SPACE, coupled(), 2, 0.1, 0.8, every=5)
    default = inspect.signature(ec.evolve).parameters["every"].default
    assert next(ec.evolve(SPACE, coupled(), 2, 0.1, 0.8, every=default)).t == 0


def test_a_run_outlives_a_full_disk_and_says_how_to_go_on(tmp_path):
    path = tmp_path / "run.npz"
    run = ec.evolve(SPACE, coupled(), 2, 0.1, 0.8, save=path, every=2)
    assert [state.t for state in islice(run, 2)] == [0.0, 0.1]
    first, second = r"t = 0\.3 could not be saved .*File too large", r"t = 0\.1.*again after 2"
    with room(1000), pytest.warns(ec.EvolutionWarning, match=first):
        list(islice(run, 2))
    assert ec.load(path)[1][-1].t == 0.1
    with room(1000), pytest.warns(ec.EvolutionWarning, match=second):
        list(islice(run, 2))
    states = list(islice(run, 2))
    assert ec.load(path)[1][-1].t == 0.7
    with (
        room(1000),
        pytest.warns(ec.EvolutionWarning, match=r"the run has ended: esfem_core\.save"),
    ):
        states += run
    assert [state.t for state in states] == [0.6, 0.7, 0.8]
    assert ec.load(path)[1][-1].t == 0.7


def test_a_run_whose_folder_is_gone_warns_where_it_is_gone_through(tmp_path):
    (tmp_path / "gone").mkdir()
    run = ec.evolve(SPACE, coupled(), 1, 0.1, 0.2, save=tmp_path / "gone" / "run.npz", every=1)
    (tmp_path / "gone").rmdir()
    with pytest.warns(ec.EvolutionWarning) as warned:
        list(run)
    assert {one.filename for one in warned} == {__file__}
    nothing_held = r"the file is as it was: choose another place: '.*run\.npz'\); the run goes on"
    assert re.search(nothing_held, str(warned[0].message))


def saved(tmp_path):
    path = tmp_path / "run.npz"
    states = list(ec.evolve(SPACE, coupled(), 2, 0.1, 0.4))[-2:]
    ec.save(path, states)
    return path, states


def test_no_flipped_bit_is_read_as_a_number(tmp_path):
    """Wherever the damage is: refused by name, or in a byte that means nothing."""
    path, states = saved(tmp_path)
    data = path.read_bytes()
    rng = np.random.default_rng(1)
    places = {*rng.integers(len(data), size=150).tolist(), *range(len(data) - 60, len(data))}
    refused = 0
    for place in sorted(places | set(range(0, 200, 3))):
        changed = bytearray(data)
        changed[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(changed)
        try:
            _, read = ec.load(path)
        except ValueError as error:
            refused += 1
            assert str(path) in str(error)  # noqa: PT017
        else:
            for one, other in zip(read, states, strict=True):
                same(one, other)
    assert refused > 150


def test_a_file_cut_short_or_of_another_kind_is_refused_by_name(tmp_path):
    path, _ = saved(tmp_path)
    data = path.read_bytes()
    for wrong in (b"", b"no archive", data[:100], data[: len(data) // 2], data[:-1]):
        path.write_bytes(wrong)
        with pytest.raises(ValueError, match=r"run\.npz' is damaged, or was not written by"):
            ec.load(path)
    np.savez(path, x=np.zeros(3))
    with pytest.raises(ValueError, match=r"run\.npz' is damaged, or was not written by"):
        ec.load(path)
    with pytest.raises(FileNotFoundError, match="there is no file"):
        ec.load(tmp_path / "other.npz")


@pytest.mark.parametrize(
    ("error", "where"),
    [
        (PermissionError(13, "Permission denied"), "pathlib.Path.read_bytes"),
        (OSError(24, "Too many open files"), "pathlib.Path.read_bytes"),
        (OSError(5, "Input/output error"), "pathlib.Path.read_bytes"),
        (MemoryError(), "zipfile.ZipFile.__init__"),
    ],
)
def test_a_file_that_the_system_cannot_read_is_not_called_damaged(
    tmp_path, monkeypatch, error, where
):
    path, _ = saved(tmp_path)

    def refuse(*_):
        raise error

    monkeypatch.setattr(where, refuse)
    with pytest.raises(type(error)) as caught:
        ec.load(path)
    assert caught.value is error


def rewritten(path, change):
    """Change header and arrays as an editor could, with right checksums."""
    with np.load(path) as file:
        arrays = dict(file)
    header = json.loads(str(arrays.pop("header")))
    change(header, arrays)
    np.savez(path, header=json.dumps(header), **arrays)


def drop(header, arrays):
    del arrays["1/fields/0"]


def add(header, arrays):
    arrays["2/x"] = arrays["1/x"]


def halve(header, arrays):
    arrays["0/x"] = arrays["0/x"].astype(np.float32)


def shorten(header, arrays):
    arrays["1/x"] = arrays["1/x"][:-1]


def change_type(header, arrays):
    arrays["0/x"] = arrays["0/x"].astype(complex)


def tear(header, arrays):
    arrays["cells"][0, 3] = arrays["cells"][1, 4]


def mirror(header, arrays):
    arrays["nodes"] *= -1


def spoil(header, arrays):
    arrays["1/x"][3, 1] = np.nan


def swap(header, arrays):
    header["states"][0]["t"] = 7.0


def rename(header, arrays):
    header["states"][0]["fields"][0] = "other"


def rename_in_all(header, arrays):
    for state in header["states"]:
        state["fields"][0] = "other"


def list_shapes(header, arrays):
    header["shapes"] = list(header["shapes"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (list_shapes, "'list' object has no attribute"),
        (drop, "array 1/fields/0 is missing"),
        (add, "array 2/x is not in its list"),
        (halve, "0/x has type float32"),
        (shorten, r"1/x has type float64 and shape \(65, 3\)"),
        (change_type, "0/x has type complex128"),
        (tear, "element 0 does not have the nodes of its neighbours|neighbours must share"),
        (mirror, "oriented inwards"),
        (spoil, r"states\[1\]\.x must be finite, but .*\[3, 1\] is nan"),
        (swap, "order of time"),
        (rename, r"states\[0\]\.products\[.u.\] belongs to no function"),
        (rename_in_all, "belongs to no function"),
    ],
)
def test_what_does_not_fit_together_is_refused(tmp_path, change, message):
    path, _ = saved(tmp_path)
    rewritten(path, change)
    with pytest.raises(ValueError, match=rf"run\.npz' is damaged: .*({message})"):
        ec.load(path)


def test_a_later_version_is_told_from_damage(tmp_path):
    path, _ = saved(tmp_path)
    for version in (2, True):
        rewritten(path, lambda header, arrays, v=version: header.update(version=v))
        with pytest.raises(ValueError, match=f"has version {version} of the format"):
            ec.load(path)


def test_the_other_order_of_bytes_is_read(tmp_path):
    path, states = saved(tmp_path)

    def turn(header, arrays):
        arrays.update({n: a.astype(a.dtype.newbyteorder("S")) for n, a in arrays.items()})

    rewritten(path, turn)
    for one, other in zip(ec.load(path)[1], states, strict=True):
        same(one, other)


def test_no_room_is_made_for_more_than_a_file_holds(tmp_path):
    path, _ = saved(tmp_path)
    with zipfile.ZipFile(path) as file:
        members = {name: file.read(name) for name in file.namelist()}
    head, tail = members["0/x.npy"].split(b"(66, 3), }" + 9 * b" ")
    members["0/x.npy"] = head + b"(66000000000, 3), }" + tail
    with zipfile.ZipFile(path, "w") as file:
        for name, data in members.items():
            file.writestr(name, data)
    with pytest.raises(ValueError, match="array 0/x should have 1584000000000 bytes, but has 1584"):
        ec.load(path)


@pytest.mark.parametrize("version", [(2, 0), (3, 0)])
def test_no_room_is_made_for_arrays_in_a_form_that_save_does_not_write(tmp_path, version):
    path, _ = saved(tmp_path)
    with zipfile.ZipFile(path) as file:
        members = {name: file.read(name) for name in file.namelist()}
    head = {"descr": "<f8", "fortran_order": False, "shape": (10**17, 3)}
    claiming = io.BytesIO()
    np.lib.format.write_array_header_2_0(claiming, head)
    magic = np.lib.format.magic(*version)
    members["0/x.npy"] = magic + claiming.getvalue()[len(magic) :] + bytes(100)
    with zipfile.ZipFile(path, "w") as file:
        for name, data in members.items():
            file.writestr(name, data)
    message = rf"run\.npz' is damaged, .*array 0/x has version \({version[0]}, 0\)"
    with pytest.raises(ValueError, match=message):
        ec.load(path)


def test_a_file_that_is_compressed_is_refused_unread_and_can_be_unpacked_as_told(tmp_path):
    path, states = saved(tmp_path)
    packed, unpacked = tmp_path / "packed.npz", tmp_path / "unpacked.npz"
    with np.load(path) as file:
        np.savez_compressed(packed, **file)
    with zipfile.ZipFile(packed, "a", zipfile.ZIP_DEFLATED) as file:
        file.writestr("zeros.npy", bytes(100_000_000))
    tracemalloc.start()
    with pytest.raises(ValueError, match=r"packed\.npz' is .* compressed, .*savez\(new, \*\*numpy"):
        ec.load(packed)
    assert tracemalloc.get_traced_memory()[1] < 5_000_000
    tracemalloc.stop()
    with np.load(path) as file:
        np.savez_compressed(packed, **file)
    np.savez(unpacked, **np.load(packed))
    for one, other in zip(ec.load(unpacked)[1], states, strict=True):
        same(one, other)


def test_nothing_in_a_file_is_executed(tmp_path):
    path, _ = saved(tmp_path)
    with zipfile.ZipFile(path) as file:
        for name in file.namelist():
            assert b"'descr': '|O'" not in file.read(name)
    with np.load(path) as file:
        arrays = dict(file)
    np.savez(path, **arrays | {"0/x": np.array([print], dtype=object)})
    with pytest.raises(ValueError, match=r"damaged.*allow_pickle=False"):
        ec.load(path)


def test_save_refuses_what_it_could_not_read_again(tmp_path):
    states = list(ec.evolve(SPACE, coupled(), 2, 0.1, 0.4))
    other = ec.SurfaceSpace(ec.sphere("octahedron", 1), 1)
    alone = ec.State(0.0, SPACE.nodes, None, SPACE.nodes[:, 0], space=SPACE)
    for path, given, error, message in [
        ("run.txt", states, ValueError, 'path must end with ".npz"'),
        ("none/run.npz", states, FileNotFoundError, "directory .* does not exist; make it first"),
        ("run.npz", [], ValueError, "states must hold at least one"),
        ("run.npz", [1], TypeError, r"states\[0\] must be a State, got 1"),
        ("run.npz", [ec.State(0.0, SPACE.nodes)], ValueError, "must know its space"),
        ("run.npz", states[::-1], ValueError, "must be in the order of time"),
        ("run.npz", [alone, states[-1]], ValueError, "must have the same functions"),
        (
            "run.npz",
            [ec.State(0.0, other.nodes, space=other), states[-1]],
            ValueError,
            r"one space, but states\[1\] has another",
        ),
    ]:
        with pytest.raises(error, match=message):
            ec.save(tmp_path / path, given)
    assert list(tmp_path.iterdir()) == []


def test_evolve_refuses_a_save_that_could_not_be_written_at_the_call(tmp_path):
    for options, error, message in [
        ({"save": tmp_path / "run.vtu"}, ValueError, 'save must end with ".npz"'),
        (
            {"save": tmp_path / "a" / "run.npz"},
            FileNotFoundError,
            "save must be in a directory that is there",
        ),
        ({"save": tmp_path / "run.npz", "every": 0}, ValueError, "every must be an integer >= 1"),
        ({"save": 3}, TypeError, "save must be the path of a file, got 3"),
    ]:
        with pytest.raises(error, match=message):
            ec.evolve(SPACE, coupled(), 2, 0.1, 0.4, **options)


def test_the_last_p_of_more_states_are_started_from():
    states = list(ec.evolve(SPACE, coupled(), 2, 0.1, 0.8, solver="direct"))
    options = {"order": 2, "step": 0.1, "end": 0.8, "solver": "direct"}
    for one, other in zip(
        ec.evolve(SPACE, coupled(), **options, start=states[:5]), states[3:], strict=True
    ):
        same(one, other)
