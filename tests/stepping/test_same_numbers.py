"""Every problem, order and mass gives the numbers it gave before the package had rooms and laws.

numbers.json was made by the code of commit 7c9b3f6, with direct solves: for each run, the products
of the last x and u with two fixed vectors.
"""

import json
from pathlib import Path

import numpy as np
import pytest

import esfem_core as ec
from esfem_core.study import final

NUMBERS = json.loads(Path(__file__).with_name("numbers.json").read_text("utf8"))
SPACE = ec.SurfaceSpace(ec.sphere("octahedron", 2), 2, ec.to_unit_sphere)
PROBLEMS = {
    "expanding": ec.problems.expanding_sphere("smooth"),
    "printed": ec.problems.expanding_sphere("printed"),
    "none": ec.problems.expanding_sphere("none"),
    "ell_decay": ec.problems.oscillating_ellipsoid("decay"),
    "ell_lifted": ec.problems.oscillating_ellipsoid("oscillation", "lifted"),
    "bat": ec.problems.baseball_bat(),
    "growing": ec.problems.growing_sphere(),
    "shrinking": ec.problems.shrinking_sphere(),
}


@pytest.mark.parametrize("name", PROBLEMS)
def test_numbers_are_what_they_were(name):
    weights = np.cos(np.arange(len(SPACE.nodes)))
    for p in range(1, 6):
        for mass in ("extrapolated", "reassembled", "updated"):
            run = ec.evolve(SPACE, PROBLEMS[name], p, 1 / 20, 0.5, mass=mass, solver="direct")
            last = final(run)
            found = [weights @ last.x @ [1.0, 2.0, 3.0], weights @ last.u]
            assert found == pytest.approx(NUMBERS[f"{name} {p} {mass}"], rel=1e-10, abs=1e-10)
