"""Interrupted, resumed and failing campaigns."""

import json

import pytest

from esfem_core.companion import campaign
from esfem_core.companion.campaign import Experiment
from esfem_core.study import outcomes
from esfem_core.study.user_code import code_of


def compute(order, step):
    if step == 0.125 and order == 2:
        raise ArithmeticError("no convergence")
    return {"error": step**order + 0.1}


def chains(orders=(1, 2)):
    return [[{"order": p, "step": 0.5**k} for k in range(5)] for p in orders]


def settled(before, after):
    return after["error"] > 0.5 * before["error"]


def test_a_failing_case_ends_its_chain_and_no_other(tmp_path):
    experiment = Experiment("demo", "", compute, chains())
    found = list(outcomes([experiment], tmp_path, workers=2))
    assert sum(outcome.cases for outcome in found) == 10
    assert [str(outcome.error) for outcome in found if outcome.error] == ["no convergence"]
    rows = campaign.read(tmp_path / "demo.jsonl")
    assert len(campaign.select(rows, order=1)) == 5
    assert len(campaign.select(rows, order=2)) == 3
    assert rows[0].provenance["seconds"] >= 0
    assert "source" in rows[0].provenance["esfem_core"]


def test_a_chain_ends_when_it_is_enough(tmp_path):
    experiment = Experiment("demo", "", compute, chains([1]), settled)
    first = list(outcomes([experiment], tmp_path, workers=1))
    steps = [row.parameters["step"] for row in campaign.read(tmp_path / "demo.jsonl")]
    assert steps == [1, 0.5]  # 1.1 and 0.6: less than half is gained
    assert sum(outcome.cases for outcome in first) == 5
    again = list(outcomes([experiment], tmp_path, workers=1))
    assert [outcome.found for outcome in again] == [True, True]
    assert sum(outcome.cases for outcome in again) == 5
    assert len(campaign.read(tmp_path / "demo.jsonl")) == 2


def test_an_interrupted_run_goes_on_where_it_stopped(tmp_path):
    experiment = Experiment("demo", "", compute, chains([1]))
    for count, _ in enumerate(outcomes([experiment], tmp_path, workers=1)):
        if count == 1:
            break
    path = tmp_path / "demo.jsonl"
    with path.open("a") as file:
        file.write('{"parameters": {"ord')  # cut off in the middle of a line
    stored = len(campaign.read(path))
    assert stored >= 2
    again = [outcome.found for outcome in outcomes([experiment], tmp_path, workers=1)]
    assert again == [True] * stored + [False] * (5 - stored)
    assert [json.loads(line)["parameters"]["step"] for line in path.read_text().splitlines()] == [
        row["step"] for row in chains([1])[0]
    ]


def stored(path, steps, source):
    """Rows of the first chain, with a wrong result, as some code has left them."""
    where = {"seconds": 1.0, "date": "2026-01-31", "machine": "Abacus"}
    where["esfem_core"] = f"0.1.0, source {source}"
    rows = [campaign.Row({"order": 1, "step": step}, {"error": 7.0}, where) for step in steps]
    with path.open("a") as file:
        file.writelines(json.dumps(vars(row)) + "\n" for row in rows)
    return rows


def test_only_what_other_code_has_made_is_computed_again_and_in_its_place(tmp_path):
    experiment, path = Experiment("demo", "", compute, chains()), tmp_path / "demo.jsonl"
    here = code_of(compute)
    first = stored(path, [1, 0.5], "older")
    second = stored(path, [0.25], here)
    assert [campaign.is_current(experiment, row) for row in first + second] == [False, False, True]
    renewed = list(campaign.renew([experiment], tmp_path, jobs=1))
    assert [old for _, old, _ in renewed] == first
    rows = campaign.read(path)
    assert [row.parameters["step"] for row in rows] == [1, 0.5, 0.25]
    assert [row.results["error"] for row in rows] == [1.1, 0.6, 7.0]
    assert all(campaign.is_current(experiment, row) for row in rows)
    assert list(campaign.renew([experiment], tmp_path, jobs=1)) == []


def test_a_row_that_cannot_be_renewed_stays(tmp_path):
    experiment, path = Experiment("demo", "", compute, chains()), tmp_path / "demo.jsonl"
    row = campaign.Row(
        {"order": 2, "step": 0.125}, {"error": 7.0}, {"esfem_core": "0.1.0, source older"}
    )
    path.write_text(json.dumps(vars(row)) + "\n")
    [(_, old, outcome)] = campaign.renew([experiment], tmp_path, jobs=1)
    assert (old, str(outcome)) == (row, "no convergence")
    assert campaign.read(path) == [row]


def test_a_renewal_that_stops_between_two_rows_goes_on(tmp_path):
    experiment, path = Experiment("demo", "", compute, chains()), tmp_path / "demo.jsonl"
    stored(path, [1, 0.5, 0.25], "older")
    for _ in campaign.renew([experiment], tmp_path, jobs=1):
        break
    left = [campaign.is_current(experiment, row) for row in campaign.read(path)].count(False)
    assert left == 2
    assert len(list(campaign.renew([experiment], tmp_path, jobs=1))) == left


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        ({"x": 1.0}, {"x": 1.0099}, []),
        ({"x": 1.0}, {"x": 1.02}, [("x", 1.0, 1.02)]),
        ({"x": 1e-15}, {"x": -1e-13}, []),
        ({"x": [1.0, [2, 3]]}, {"x": [1.0, [2, 4]]}, [("x[1][1]", 3, 4)]),
        ({"x": {"l2": 1.0}}, {"x": {"l2": 2.0}}, [("x.l2", 1.0, 2.0)]),
        ({"x": float("nan")}, {"x": float("nan")}, []),
        ({"x": None}, {"x": 1.0}, [("x", None, 1.0)]),
        ({"x": "a"}, {"x": "b"}, [("x", "a", "b")]),
        ({"x": [1.0]}, {"x": [1.0, 2.0]}, [("x[1]", None, 2.0)]),
        ({"x": 1.0}, {"y": 1.0}, [("x", 1.0, None), ("y", None, 1.0)]),
        ({"x": None}, {}, [("x", None, None)]),
        ({"x": []}, {"x": {}}, [("x", [], {})]),
        ({"x": 1.0, "y": []}, {"x": 1.0}, [("y", [], None)]),
        ({"x": True}, {"x": 1.0}, [("x", True, 1.0)]),
        ({}, {}, []),
    ],
)
def test_changes_are_numbers_that_differ_by_more_than_a_percent(old, new, found):
    assert campaign.changes(old, new) == found


def test_jobs_and_files_that_are_none_are_refused(tmp_path):
    with pytest.raises(ValueError, match="jobs must be an integer >= 1, got 0"):
        campaign.renew([], tmp_path, jobs=0)
    path = tmp_path / "demo.jsonl"
    path.write_text("no json\n{}\n")
    with pytest.raises(ValueError, match=r"demo\.jsonl is not a file of results"):
        campaign.read(path)
    assert campaign.read(tmp_path / "missing.jsonl") == []
    with pytest.raises(ValueError, match="there are no rows"):
        campaign.provenance([])
    with pytest.raises(ValueError, match="share must be a finite number >= 0 and < 1, got 2"):
        campaign.changes({}, {}, share=2)


def test_rows_without_what_is_asked_for_are_named():
    rows = [campaign.Row({"step": 0.5}, {"u": 1.0}, {}), campaign.Row({"step": 0.2}, {}, {})]
    with pytest.raises(KeyError, match=r"rows\[0\] has no 'h', only 'u', 'step'"):
        campaign.convergence(rows, "h")
    with pytest.raises(KeyError, match=r"rows\[1\] has no 'u', only none"):
        campaign.convergence(iter(rows), "step")
    with pytest.raises(KeyError, match=r"rows\[0\] has no 'seconds', only none"):
        campaign.origin("full", rows)
    with pytest.raises(TypeError, match=r"rows\[0\] must be a Row, got 1"):
        campaign.provenance([1])


def test_provenance_names_every_machine(tmp_path):
    experiment = Experiment("demo", "", compute, chains([1]))
    list(outcomes([experiment], tmp_path, workers=1))
    rows = campaign.read(tmp_path / "demo.jsonl")
    other = campaign.Row({}, {}, {**rows[0].provenance, "machine": "A counting frame"})
    text = campaign.provenance([*rows, other])
    assert text.startswith("6 runs, 0.0 s in all, on A counting frame and ")
    assert rows[0].provenance["machine"] in text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.04, "0.0 s"), (119, "119.0 s"), (120, "2.0 min"), (9000, "2.5 h")],
)
def test_provenance_tells_the_time_in_a_unit_that_fits(seconds, text):
    where = {"machine": "Abacus", "date": "2026-01-31", "esfem_core": "0.1.0, source 0123"}
    row = campaign.Row({}, {}, {"seconds": seconds, **where})
    assert campaign.provenance([row]).startswith(f"1 run, {text} in all, on Abacus,")


def test_provenance_names_each_version_once():
    codes = ["0.1.0, source aa", "0.1.0, source bb", "0.1.0, source cc", "0.2.0, source dd"]
    where = {"machine": "Abacus", "date": "2026-01-31", "seconds": 1.0}
    rows = [campaign.Row({}, {}, {**where, "esfem_core": code}) for code in codes + codes]
    assert campaign.provenance(rows).endswith(
        "esfem_core 0.1.0, source aa, bb and cc; 0.2.0, source dd"
    )
