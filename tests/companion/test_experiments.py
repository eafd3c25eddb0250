"""The stored results of the book: complete, and what the code computes today."""

import json
import re
import sys
from pathlib import Path

import pytest

from esfem_core.companion import campaign
from esfem_core.companion.experiments import EXPERIMENTS, __main__
from esfem_core.companion.experiments.__main__ import main
from esfem_core.companion.figures import four_panels
from esfem_core.study import Outcome

BOOK = Path(__file__).parents[2] / "book"
BY_NAME = {experiment.name: experiment for experiment in EXPERIMENTS}
STORED = {name: campaign.stored(name) for name in BY_NAME}


def test_every_file_of_results_belongs_to_an_experiment():
    assert {path.stem for path in campaign.DATA.glob("*.jsonl")} == set(BY_NAME)


@pytest.mark.parametrize("name", BY_NAME)
def test_every_stored_case_is_one_that_the_command_computes(name):
    cases = [dict(parameters) for chain in BY_NAME[name].chains for parameters in chain]
    assert all(row.parameters in cases for row in STORED[name])
    assert all(
        any(row.parameters == chain[0] for row in STORED[name]) for chain in BY_NAME[name].chains
    ), "a chain has not been begun"


TIMES = {"lmv_run_times", "nick_mass_runtime"}  # no two are the same
LONG = 3  # seconds


def has_digits(row):
    """Not where the printed coupling is evaluated near 0/0: there the last bits decide."""
    p = row.parameters
    aligned = p.get("mesh") == "octahedron" and p.get("angle", 0.0) < 0.01
    return p.get("coupling") != "printed" or aligned


# The cheapest of each experiment, whatever it costs, and two more if they cost little.
CHEAP = [
    pytest.param(
        BY_NAME[name],
        row,
        id=f"{name}-{'-'.join(map(str, row.parameters.values()))}"[:80],
        marks=[pytest.mark.slow] if row.provenance["seconds"] >= LONG else [],
    )
    for name, rows in STORED.items()
    if name not in TIMES
    for i, row in enumerate(
        sorted(filter(has_digits, rows), key=lambda row: row.provenance["seconds"])[:3]
    )
    if i == 0 or row.provenance["seconds"] < LONG
]


@pytest.mark.parametrize(("experiment", "row"), CHEAP)
def test_cheap_cases_are_what_the_code_computes_today(experiment, row):
    today = campaign.case(experiment, row.parameters).results
    assert today.keys() == row.results.keys()
    for key, value in row.results.items():
        assert today[key] == (
            pytest.approx(value, rel=1e-5, abs=1e-12, nan_ok=True)
            if isinstance(value, float | list)
            else value
        ), key


def test_names_numbers_and_folders_that_do_not_fit_are_refused(capsys, tmp_path):
    file = tmp_path / "file"
    file.touch()
    (tmp_path / "bat_time.jsonl").write_text("step,error\n0.1,2e-3\n")
    for arguments, message in [
        (["nonsense"], "no such experiment: nonsense"),
        (["--jobs", "0"], "--jobs must be an integer >= 1, got 0"),
        (
            ["--folder", f"{tmp_path}", "bat_time"],
            "bat_time.jsonl is not a file of results: line 1",
        ),
        (["--folder", f"{file}/data"], f"cannot write into {file}/data (Not a directory); "),
    ]:
        with pytest.raises(SystemExit):
            main(arguments)
        assert message in capsys.readouterr().err


def test_the_help_names_every_experiment_and_the_folder_where_the_book_reads(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    text = capsys.readouterr().out
    for name, experiment in BY_NAME.items():
        assert f"  {name} " in text
        assert experiment.title in text
    assert re.sub(r"\s", "", str(campaign.DATA)) in re.sub(r"\s", "", text)


def test_commands_of_the_pages_compute_something_in_a_folder_of_their_own():
    """Beside the results that the package has, only what is missing is computed: nothing."""
    pattern = r"python -m esfem_core\.companion\.experiments ([a-z][^`]*)`"
    printed = [
        (path.stem, command)
        for path in [*BOOK.glob("*.ipynb"), *BOOK.glob("*.md"), BOOK.parent / "README.md"]
        for command in re.findall(pattern, path.read_text("utf8"))
    ]
    assert len(printed) >= 3
    for page, command in printed:
        *names, option, folder = command.split()
        assert option == "--folder", page
        assert folder, page
        assert set(names) <= set(BY_NAME), page


def test_stale_cases_are_counted_renewed_and_their_changes_listed(tmp_path, capsys):
    row = STORED["nick_theorem"][0]
    by_other_code = row.provenance | {"esfem_core": "0.1.0, source 000000000000"}
    wrong = campaign.Row(row.parameters, row.results | {"x": 1.0}, by_other_code)
    path = tmp_path / "nick_theorem.jsonl"
    path.write_text(json.dumps(vars(wrong)) + "\n")
    arguments = ["nick_theorem", "--stale", "--jobs", "1", "--folder", str(tmp_path)]
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert re.search(r"nick_theorem \{.*\}: x was 1.0, is 0\.\d+", out)
    [renewed] = campaign.read(path)
    assert campaign.is_current(BY_NAME["nick_theorem"], renewed)
    assert renewed.results["x"] == pytest.approx(row.results["x"], rel=1e-5)
    assert main(arguments) == 0
    assert "was" not in capsys.readouterr().out


def test_an_experiment_named_twice_runs_once(tmp_path, monkeypatch):
    asked = []

    def nothing(experiments, folder, workers):
        asked.extend(experiments)
        yield from ()

    monkeypatch.setattr(__main__, "outcomes", nothing)
    assert main(["nick_table", "lmv_run_times", "nick_table", "--folder", str(tmp_path)]) == 0
    assert [experiment.name for experiment in asked] == ["nick_table", "lmv_run_times"]


def test_without_a_bar_there_are_lines_and_what_is_stored_already_is_told(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setitem(sys.modules, "tqdm", None)
    path = BY_NAME["lmv_run_times"].path(tmp_path)
    path.write_bytes(BY_NAME["lmv_run_times"].path(campaign.DATA).read_bytes())
    assert main(["lmv_run_times", "--folder", str(tmp_path)]) == 0
    out, err = capsys.readouterr()
    assert err == "1/1 lmv_run_times\n"
    assert out.startswith(f"all is stored in {tmp_path} already: another --folder computes it anew")

    row = STORED["lmv_run_times"][0]
    chain = [BY_NAME["lmv_run_times"], row.parameters, None, ValueError("no"), False, 1]
    monkeypatch.setattr(__main__, "outcomes", lambda *_, **__: (Outcome(*chain) for _ in "a"))
    assert main(["lmv_run_times", "--folder", str(tmp_path)]) == 1
    out, err = capsys.readouterr()
    assert out.startswith(f"lmv_run_times {json.dumps(row.parameters)}: ValueError: no\n")
    assert "already" not in out


def test_an_interrupted_command_says_how_to_go_on(tmp_path, monkeypatch, capsys):
    def interrupted(*_, **__):
        raise KeyboardInterrupt
        yield

    monkeypatch.setattr(__main__, "outcomes", interrupted)
    assert main(["lmv_run_times", "--folder", str(tmp_path)]) == 130
    assert "start again to go on" in capsys.readouterr().err


def test_without_matplotlib_a_figure_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    rows = campaign.stored("nick_figures_2_4", mesh="octahedron", order=5)
    with pytest.raises(ImportError, match=r'need Matplotlib: pip install "esfem-core\[pict.*]'):
        four_panels(rows, "h", (3, 2), "$h$", ("a", "b"), "full")


@pytest.mark.parametrize("path", sorted(BOOK.glob("*.ipynb")), ids=lambda path: path.stem)
def test_notebooks_ask_for_stored_results_by_name_and_not_by_path(path):
    for cell in json.loads(path.read_text("utf8"))["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "code":
            assert not re.search(r"\.jsonl|performance\.json|[\"']data\b|data/", source), source
