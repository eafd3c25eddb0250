"""The benchmark set for other codes: its numbers are ours, and its checker can say no."""

import importlib.util
import json
import re
from pathlib import Path

import meshio
import numpy as np
import pytest

import esfem_core as ec

SET = Path(__file__).parent.parent / "benchmarks" / "set"


def module(name):
    spec = importlib.util.spec_from_file_location(f"benchmark_set_{name}", SET / f"{name}.py")
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


make, check = module("make"), module("check")
ERRORS = json.loads((SET / "errors.json").read_text())
PROBLEMS = json.loads((SET / "problems.json").read_text())["problems"]


def test_every_problem_has_its_rows_and_its_text():
    assert list(PROBLEMS) == list(make.PROBLEMS)
    assert len(ERRORS) == len(PROBLEMS) * len(list(make.runs(1.0)))
    for name, (_, _, end) in make.PROBLEMS.items():
        assert PROBLEMS[name]["end"] == end


@pytest.mark.parametrize("name", make.PROBLEMS)
def test_numbers_are_those_of_the_solver_as_it_is(name):
    problem, surface, end = make.PROBLEMS[name]
    row = next(row for row in ERRORS if row["problem"] == name)
    assert row["mesh"] == f"{surface.__name__}_1"
    space = make.quadratic(surface, 1)
    found = make.measured(space, problem(), row["order"], row["step"], end, solver="direct")
    compared = list(check.compared([row | {"measured": found}], ERRORS))
    assert [line for line in compared if not line[-1]] == []


@pytest.mark.parametrize("name", ["sphere", "torus"])
def test_meshes_are_those_that_the_numbers_belong_to(name):
    for level in make.LEVELS:
        with_nodes = ec.SurfaceSpace.read(SET / "meshes" / f"{name}_{level}.vtu", report=None)
        space = make.quadratic(getattr(make, name), level)
        np.testing.assert_array_equal(with_nodes.nodes, space.nodes)
        mesh = meshio.read(SET / "meshes" / f"{name}_{level}.vtu")
        np.testing.assert_array_equal(mesh.cells_dict["triangle6"], space.cells)


def test_the_checker_says_what_agrees_and_what_does_not(tmp_path, capsys):
    row = next(r for r in ERRORS if r["problem"] == "nick-7.3")
    mine = {k: row[k] for k in check.KEY} | {
        "measured": {"x_l2": row["measured"]["x_l2"][0], "u_l2": 3 * row["measured"]["u_l2"][0]}
    }
    file = tmp_path / "mine.json"
    file.write_text(json.dumps([mine]))
    assert check.main(file) == 1
    said = capsys.readouterr().out
    assert "agrees" in said
    assert re.search(r"off by .*e-0\d, allowed 2e-0\d, 3 times ours", said)
    assert "1 of 2 numbers agree" in said
    with pytest.raises(SystemExit, match=r"row 0 has order 9 for nick-7\.3 sphere_1; known: 4$"):
        list(check.compared([mine | {"order": 9}], ERRORS))
    with pytest.raises(SystemExit, match="none of x_l2"):
        list(check.compared([mine | {"measured": {"w": 1.0}}], ERRORS))


def test_a_number_that_is_off_in_its_last_digit_is_seen_to_be(tmp_path, capsys):
    row = next(r for r in ERRORS if "area" in r["measured"])
    area, allowed = row["measured"]["area"]
    file = tmp_path / "mine.json"
    file.write_text(json.dumps([row | {"measured": {"area": area + 5 * allowed}}]))
    assert check.main(file) == 1
    line = capsys.readouterr().out.splitlines()[0]
    theirs, ours = line.split()[5:7]
    assert theirs != ours
    assert line.endswith(f"off by {5 * allowed:.1e}, allowed {allowed:.0e}, 1 times ours")


ROW = {"problem": "lmv-1", "mesh": "sphere_3", "order": 2, "step": 0.05, "measured": {"u_l2": 1.0}}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[]", r"there must be a list of rows, got \[\]"),
        (json.dumps(ROW), "there must be a list of rows, got {"),
        ("", "mine.json must be a file of JSON: Expecting value"),
        ('["a"]', 'row 0 must have problem, mesh, order, step and measured, got "a"'),
        (json.dumps([ROW | {"measured": {}}]), r'row 0 must have "measured", .*u_l2.*, got \{\}'),
        (
            json.dumps([ROW | {"measured": {"u_l2": "1"}}]),
            'u_l2 of row 0 must be a number, got "1"',
        ),
        (json.dumps([ROW | {"measured": {"u_l2": [1, 2]}}]), r"must be a number, got \[1, 2\]"),
        (
            json.dumps([ROW | {"mesh": "sphere"}]),
            'has mesh "sphere" for lmv-1; known: sphere_1, ',
        ),
        (
            json.dumps([ROW | {"step": [0.05]}]),
            r"has step \[0.05\] for .* 2; known: 0.05, 0.025",
        ),
        (json.dumps([ROW, ROW]), r'rows 0 and 1 are both for \["lmv-1"'),
    ],
)
def test_the_checker_says_what_is_wrong_with_a_file(text, message, tmp_path):
    file = tmp_path / "mine.json"
    file.write_text(text)
    with pytest.raises(SystemExit, match=message):
        check.main(file)
    with pytest.raises(SystemExit, match=r"must be a file of JSON: .*No such file"):
        check.main(tmp_path / "none.json")


def test_steps_are_the_same_to_nine_digits_and_files_of_any_unicode_encoding_are_read(tmp_path):
    file = tmp_path / "mine.json"
    known = next(r for r in ERRORS if all(r[k] == ROW[k] for k in check.KEY))
    mine = ROW | {"step": 0.05000000000000001, "measured": {"u_l2": known["measured"]["u_l2"][0]}}
    for encoding in ("utf-8-sig", "utf-16"):
        file.write_text(json.dumps([mine]), encoding)
        assert check.main(file) == 0
    file.write_text(json.dumps([mine | {"measured": {"u_l2": float("nan")}}]))
    assert check.main(file) == 1
