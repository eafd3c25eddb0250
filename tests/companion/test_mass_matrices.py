"""The experiments on (2.19) and (7.2), against closed forms and against the package's assembly."""

import inspect

import numpy as np
import pytest

import esfem_core as ec
from esfem_core.companion.experiments import mass_matrices, mass_runtime
from esfem_core.companion.experiments.mass_matrices import compare_masses, orders
from esfem_core.companion.experiments.mass_runtime import assemble_by_element, runtime


def test_the_difference_at_half_time_is_the_closed_form():
    """1 - exp(-kappa tau^2) with kappa = 11/3 pi^2 ln(3/2), and less than a tenth at t = 1."""
    kappa = 11 / 3 * np.pi**2 * np.log(1.5)
    half, one = [], []
    for n in (80, 160):
        row = compare_masses(refinements=2, steps_per_unit=n)
        relative = np.array(row["difference"]) / row["size"] * n**2
        half.append(relative[0])
        one.append(relative[1])
    assert 2 * half[1] - half[0] == pytest.approx(kappa, rel=0.03)
    assert one[1] < 0.1 * kappa


def test_errors_of_one_row_agree_with_each_other():
    row = compare_masses(refinements=1, steps_per_unit=40)
    for i in (0, 1):
        for mass in ("_reassembled", "_updated"):
            gap = row["difference" + mass.replace("_reassembled", "")][i]
            assert abs(row["error"][i] - row[f"error{mass}"][i]) <= gap
        assert row["lifted"][i] > row["error"][i]  # it counts the error of interpolation


@pytest.mark.parametrize("surface", ["ellipsoid", "growing sphere"])
def test_orders_and_conservation_of_the_three_mass_terms(surface):
    row = orders(surface=surface, order=3, steps_per_unit=[40, 80], fine=640)
    for mass, expected in (("extrapolated", 3), ("updated", 3), ("reassembled", 2)):
        assert np.log2(np.divide(*row[f"{mass}_u"])) == pytest.approx(expected, abs=0.15)
    assert np.abs(row["updated_amount"]).max() < 1e-12
    assert abs(row["reassembled_amount"][1]) > 20 * abs(row["extrapolated_amount"][1])


def test_orders_of_one_surface_share_their_fine_run(monkeypatch):
    mass_matrices._fine_run.cache_clear()
    steps, evolve = [], ec.evolve
    monkeypatch.setattr(ec, "evolve", lambda *a, **b: steps.append(a[3]) or evolve(*a, **b))
    for order in (1, 2):
        orders(surface="ellipsoid", order=order, steps_per_unit=[20], fine=40)
    assert steps.count(1 / 40) == 1


def test_assembly_by_element_gives_what_the_package_assembles():
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
    problem = ec.problems.expanding_sphere()
    x = space.nodes * [1.0, 1.2, 0.8]
    state = ec.State(0.2, x, None, np.sin(x[:, 0]) + x[:, 1])
    (M, A), (f, g) = assemble_by_element(space, state, problem)
    at = ec.Surface(space, x, state.u, state.t)
    source, speed = problem.species["u"].source(at), problem.law.g(at)
    for ours, theirs in (
        (M, at.M),
        (A, at.A),
        (f, space.load(x, source)),
        (g, space.load(x, speed[..., None] * space.normals(x))),
    ):
        assert abs(ours - theirs).max() < 1e-14


def test_parts_of_the_run_time():
    row = runtime(refinements=1, solver="lagged", seconds=0.0)
    assert row["rounds"] == 3
    assert row["nodes"] == 66
    for name in ("with_load", "with_matrix", "with_matrix_by_element"):
        low, middle, high = row[name]
        assert 1 < low <= middle <= high
    assert 0 < row["share_by_element"][0] < 1


def test_what_is_timed_is_computed_also_without_assertions(monkeypatch):
    """As under ``python -O``."""
    asked = []
    monkeypatch.setattr(ec.Surface, "M", property(lambda at: asked.append(at)))
    source = inspect.getsource(mass_runtime._assembled)
    space, names = ec.SurfaceSpace(ec.sphere("octahedron", 0)), dict(vars(mass_runtime))
    exec(compile(source, "mass_runtime.py", "exec", optimize=1), names)
    names["_assembled"](space, ec.State(0.0, space.nodes, None, space.nodes[:, 0]))
    assert len(asked) == 1


def test_steps_and_surfaces_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="steps_per_unit must be even, to meet t = 1/2, got 5"):
        compare_masses(refinements=1, steps_per_unit=5)
    with pytest.raises(ValueError, match=r'surface must be "growing sphere", .*, got .torus.'):
        orders(surface="torus", order=2, steps_per_unit=[20], fine=40)
    with pytest.raises(ValueError, match=r"must divide fine = 40, got \[20, 30\]"):
        orders(surface="ellipsoid", order=2, steps_per_unit=[20, 30], fine=40)
