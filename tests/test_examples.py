"""The example scripts run in an empty folder, and print the numbers that they should."""

import os
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

import esfem_core as ec

ROOT = Path(__file__).parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))

# What stands before a number in the output, the number, and a tolerance. Exact facts first; the
# others are what the scripts gave.
NUMBERS = {
    "adaptive": [
        ("amount changes by ", 0, 1e-13),
        ("^", 56, 2),  # steps
        ("longest ", 0.185, 2e-2),
        ("error with chosen steps: ", 0.0012, 3e-4),
        ("error with equal steps: ", 0.107, 1e-2),
    ],
    "convergence": [("order in time: ", 2.0, 0.1), ("order in space, H1: ", 2.0, 0.1)],
    "growth": [
        ("t = 1.00: .* u ", 12.566295, 2e-6),  # the same as at the beginning
        ("t = 1.00: area ", 24.8374, 2e-4),
        ("centre at the end: ", 0.2008, 2e-4),
    ],
    "heat": [("t = 2.0: mean ", 20.0, 1e-9), ("range at the end: ", 8.5374, 2e-4)],
    "hemisphere": [
        ("nodes on the boundary: ", 64, 0),
        ("t = 1.00: amounts insulated ", 3.14137, 2e-5),  # as at the beginning
        ("t = 1.00: .* cold ", 0.785398, 2e-5),  # pi/4
        ("largest error of cold: ", 0, 2e-5),
        ("at the rim: .* cold ", 0, 0),
    ],
    "jump": [
        ("p = 2, in one run: .* order ", 1, 0.1),
        ("p = 3, in one run: .* order ", 1, 0.1),
        ("p = 1, started anew: .* order ", 1, 0.1),
        ("p = 2, started anew: .* order ", 2, 0.2),
        ("p = 3, started anew: .* order ", 3, 0.2),
        ("p = 3, started anew: ", 1.1e-6, 2e-7),
    ],
    "mean_curvature": [
        ("t = 0.16: radius ", 0.6, 1e-4),
        ("area at the end: ", 0.50120, 2e-5),
    ],
    "own_law": [
        ("t = 20: radius ", 0.5 + 0.2**0.5 / 2, 1e-4),
        ("t = 1: radius ", 0.860430, 2e-6),
    ],
    "parameter_study": [
        ("'alpha': 0.1, 'beta': 0.0}: area ", 29.84736, 2e-5),
        ("'alpha': 1.0, 'beta': 0.2}: area ", 17.39299, 2e-5),
    ],
    "paraview": [("^", 11, 0), ("at t = ", 1, 0), ("area ", 26.0598, 2e-4)],
    "patterns": [
        ("contrast at the end: ", 1.1519, 2e-4),
        ("t = 1.0: .* area ", 17.8969, 2e-4),
    ],
    "remeshing": [
        ("triangles kept: smallest angle ", 4.9, 0.1),
        ("triangles made anew: smallest angle ", 14.7, 0.5),
        ("triangles made anew: .* area ", 21.667, 1e-2),
        ("amount changes by ", 0, 1e-12),
    ],
    "restart": [
        ("saved up to t = ", 0.6, 0),
        ("difference: ", 0, 0),
        (" in x, ", 0, 0),
        ("area ", 24.83525, 2e-5),
    ],
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Run an example in an empty folder, once; returns the folder and what it prints."""
    places = [str(Path(ec.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, places))}

    @cache
    def done(path):
        folder = tmp_path_factory.mktemp(path.stem)
        found = subprocess.run(
            [sys.executable, str(path)],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        assert (found.returncode, found.stderr) == (0, "")  # no warning, either
        return folder, found.stdout

    return done


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_prints_its_numbers(path, run):
    _, out = run(path)
    for before, number, tolerance in NUMBERS[path.stem]:
        found = re.search(rf"{before}(-?\d+(?:\.\d+)?(?:e[+-]?\d+)?)", out, re.M)
        assert found, f"no number after {before!r} in\n{out}"
        assert abs(float(found[1]) - number) <= tolerance, found[0]


def test_a_study_that_goes_on_computes_nothing_twice(run):
    folder, out = run(ROOT / "examples" / "parameter_study.py")
    assert out.count(": found\n") == 2
    assert len((folder / "results" / "area.jsonl").read_text("utf8").splitlines()) == 6


def test_each_example_is_a_page_and_is_shown_in_the_book():
    page = (ROOT / "book" / "examples.md").read_text("utf8")
    assert set(NUMBERS) == {path.stem for path in EXAMPLES}
    for path in EXAMPLES:
        assert len(path.read_text("utf8").splitlines()) < 50, path.name
        assert f"{{literalinclude}} ../examples/{path.name}\n" in page
        assert f"{{download}}`{path.name} <../examples/{path.name}>`" in page
