"""The stored results of the book: complete, and what the code computes today."""

from pathlib import Path

import pytest

from esfem_core.companion import campaign
from esfem_core.companion.experiments import EXPERIMENTS
from esfem_core.companion.experiments.__main__ import main

DATA = Path(campaign.__file__).parent / "data"
BY_NAME = {experiment.name: experiment for experiment in EXPERIMENTS}
STORED = {name: campaign.read(DATA / f"{name}.jsonl") for name in BY_NAME}


def test_every_file_of_results_belongs_to_an_experiment():
    assert {path.stem for path in DATA.glob("*.jsonl")} == set(BY_NAME)


@pytest.mark.parametrize("name", BY_NAME)
def test_every_stored_case_is_one_that_the_command_computes(name):
    cases = [dict(parameters) for chain in BY_NAME[name].chains for parameters in chain]
    assert all(row.parameters in cases for row in STORED[name])
    assert all(
        any(row.parameters == chain[0] for row in STORED[name]) for chain in BY_NAME[name].chains
    ), "a chain has not been begun"


CHEAP = [
    pytest.param(BY_NAME[name], row, id=f"{name}-{'-'.join(map(str, row.parameters.values()))}")
    for name, rows in STORED.items()
    for row in sorted(rows, key=lambda row: row.provenance["seconds"])[:3]
    if row.provenance["seconds"] < 3
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


def test_a_wrong_name_and_a_wrong_number_are_refused(capsys):
    for arguments, message in [
        (["nonsense"], "no such experiment: nonsense"),
        (["--jobs", "0"], "--jobs must be at least 1, but is 0"),
    ]:
        with pytest.raises(SystemExit):
            main(arguments)
        assert message in capsys.readouterr().err
