"""The benchmark set for other codes: its numbers are ours, and its checker can say no."""

import importlib.util
import json
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
    assert "3 times ours" in said
    assert "1 of 2 numbers agree" in said
    with pytest.raises(SystemExit, match=r"no row .*nick-7"):
        list(check.compared([mine | {"order": 9}], ERRORS))
    with pytest.raises(SystemExit, match="none of x_l2"):
        list(check.compared([mine | {"measured": {"w": 1.0}}], ERRORS))
