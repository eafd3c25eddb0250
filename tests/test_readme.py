"""What the README says is true: its example, its speed, its map and its limits."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from test_rooms import ORDER

import esfem_core as ec
from esfem_core.companion import campaign

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text("utf8")


def test_the_example_runs(capsys):
    (example,) = re.findall(r"```python\n(.*?)```", README, re.S)
    assert len([line for line in example.splitlines() if line.strip()]) <= 10
    names: dict = {}
    exec(compile(example, "README.md", "exec"), names)
    assert names["errors"].x_l2 < 1e-3
    assert capsys.readouterr().out.startswith("t = 1, error of the position ")


def test_the_files_it_names_exist():
    for target in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (ROOT / target).exists(), target


def test_the_speed_it_names_was_measured():
    (low, high), *others = re.findall(
        r"(\d+) to\s+(\d+)\s+times\s+as fast as with\s+NGSolve", README
    )
    machines = campaign.performance(), campaign.performance("performance_xeon")
    ratios = [row["ratio"] for found in machines for row in found["step"]]
    assert (int(low), int(high)) == (math.floor(min(ratios)), math.floor(max(ratios)))
    assert not others


def test_its_map_shows_the_rooms_in_their_order():
    shown = re.findall(r"^  ([a-z_]+)(?:/|\.py)  ", README, re.M)
    package = Path(ec.__file__).parent
    assert shown == [r for r in ORDER if any(package.glob(r)) or any(package.glob(f"{r}.py"))]
    for name in re.findall(r"^([a-z_]+)/  ", README, re.M):
        assert (ROOT / name).is_dir(), name


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md", "CHANGELOG.md"])
def test_its_lines_fit_a_window(name):
    lines = (ROOT / name).read_text("utf8").splitlines()
    assert [line for line in lines if len(line) > 120 and not line.startswith("|")] == []


def refusal(make):
    with pytest.raises((ValueError, TypeError)) as found:
        make()
    return str(found.value)


def test_its_limits_are_refused_by_name():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    problem = ec.problems.growing_sphere()
    half = trimesh.Trimesh(space.nodes, space.cells[:10], process=False)
    half.remove_unreferenced_vertices()
    assert "not closed" in refusal(lambda: ec.SurfaceSpace(half))
    assert "law must have" in refusal(lambda: ec.Problem(u0=np.ones(1), law="mean curvature"))
    assert "alpha must be" in refusal(lambda: ec.Problem(u0=np.ones(1), alpha=-1.0))
    assert "diffusivity must be" in refusal(lambda: ec.Problem(u0=np.ones(1), diffusivity=-1.0))
    assert "integer" in refusal(lambda: list(ec.evolve(space, problem, 1, step=0.3, end=1.0)))
    with pytest.warns(UserWarning, match="BDF6"):
        ec.evolve(space, problem, 6, step=0.1, end=1.0)


def test_a_surface_that_passes_through_itself_is_not_noticed():
    balls = trimesh.util.concatenate([ec.sphere(), ec.sphere().apply_translation([0.5, 0, 0])])
    ec.SurfaceSpace(balls)
