"""The loops of the chapter Loops of your own, taken from the notebook, under test."""

import json
from pathlib import Path

import matplotlib
import numpy as np
import pytest

import esfem_core as ec

NOTEBOOK = Path(__file__).parents[1] / "book/19_loops_of_your_own.ipynb"
CELLS = {c["id"]: "".join(c["source"]) for c in json.loads(NOTEBOOK.read_text("utf8"))["cells"]}


@pytest.fixture(scope="module")
def loops():
    """The names that the cells with the loops define."""
    names = {}
    with matplotlib.rc_context():
        for cell in ("imports", "cahn-hilliard", "right-hand-sides", "willmore"):
            exec(compile(CELLS[cell], f"{NOTEBOOK.name}:{cell}", "exec"), names)
    return names


SPHERE = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)


def test_the_loops_have_less_than_forty_lines():
    for cell in ("cahn-hilliard", "right-hand-sides"):
        assert len(CELLS[cell].splitlines()) < 40
    flow = CELLS["willmore"].partition("def bending")[0].strip()
    assert len(flow.splitlines()) < 40


class TestCahnHilliard:
    EPS = 0.3

    def run(self, loops, start, step=2e-3, end=0.1, **motion):
        return list(loops["cahn_hilliard"](SPHERE, start, self.EPS, step, end, **motion))

    def energy(self, state):
        at = state.surface()
        gradients = self.EPS / 2 * (at.grad_u**2).sum(-1)
        return at.integral(gradients + (at.u**2 - 1) ** 2 / (4 * self.EPS))

    @pytest.mark.parametrize("value", [-1.0, 0.0, 1.0])
    def test_a_pure_substance_and_an_even_mixture_stay(self, loops, value):
        last = self.run(loops, np.full(len(SPHERE.nodes), value))[-1]
        assert last.u == pytest.approx(value, abs=1e-12)

    def test_keeps_the_amount_and_lowers_the_energy(self, loops):
        start = 0.2 * np.random.default_rng(3).normal(size=len(SPHERE.nodes))
        run = self.run(loops, start)
        amounts = np.array([ec.measure(s).amount for s in run])
        total = SPHERE.mass_times(SPHERE.nodes, start).sum()
        assert amounts == pytest.approx(total, abs=1e-12)
        assert (np.diff([self.energy(s) for s in run]) < 0).all()

    def test_keeps_the_amount_on_a_moving_surface(self, loops):
        start = 0.5 + 0.2 * SPHERE.nodes[:, 0]
        run = self.run(loops, start, motion=lambda p, t: p * [1 + t, 1 - t, 1 + t**2])
        total = SPHERE.mass_times(SPHERE.nodes, start).sum()
        amounts = np.array([ec.measure(s).amount for s in run])
        assert amounts == pytest.approx(total, abs=1e-12)
        assert run[-1].x == pytest.approx(SPHERE.nodes * [1.1, 0.9, 1.01])

    def test_a_constant_is_diluted_by_a_growing_sphere(self, loops):
        start = np.full(len(SPHERE.nodes), 0.8)
        last = self.run(loops, start, motion=lambda p, t: (1 + t) * p)[-1]
        assert last.u == pytest.approx(0.8 / 1.1**2, abs=1e-12)

    @pytest.mark.parametrize(
        ("degree", "harmonic"), [(1, lambda z: z), (2, lambda z: z**2 - 1 / 3)]
    )
    def test_small_waves_grow_and_decay_as_the_dispersion_relation_says(
        self, loops, degree, harmonic
    ):
        eigenvalue = degree * (degree + 1)
        rate = eigenvalue * (1 / self.EPS - self.EPS * eigenvalue)
        run = self.run(loops, 1e-5 * harmonic(SPHERE.nodes[:, 2]), step=1e-3)
        sizes = [np.ptp(s.u) for s in run]
        assert np.log(sizes[-1] / sizes[49]) / 0.05 == pytest.approx(rate, rel=0.02)

    def test_is_of_second_order_in_time(self, loops):
        start = 0.4 * SPHERE.nodes[:, 0] * SPHERE.nodes[:, 1] + 0.3 * SPHERE.nodes[:, 2]
        fine = self.run(loops, start, step=2.5e-4, end=0.08)[-1].u
        errors = [
            np.abs(self.run(loops, start, step, 0.08)[-1].u - fine).max() for step in (4e-3, 2e-3)
        ]
        assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.3)


class TestWillmore:
    def run(self, loops, surface, nodes, cells, step, end, **options):
        space = ec.SurfaceSpace.from_nodes(nodes, cells)
        x = space.nodes
        start = surface.normal(x), surface.mean_curvature(x)
        return list(loops["willmore_flow"](space, *start, step, end, **options))

    @pytest.mark.parametrize("radius", [0.5, 1.0, 3.0])
    def test_spheres_stay_in_their_own_time(self, loops, radius):
        surface = ec.exact_surfaces.Sphere(radius)
        nodes = radius * SPHERE.nodes
        *_, last = self.run(loops, surface, nodes, SPHERE.cells, radius**4 / 200, radius**4 / 10)
        assert np.abs(last.x - nodes).max() < 1e-4 * radius
        assert loops["bending"](last) == pytest.approx(4 * np.pi, rel=2e-3)

    def test_does_not_depend_on_the_position_and_turns_with_the_surface(self, loops):
        ellipsoid = ec.exact_surfaces.Ellipsoid((1.0, 1.2, 0.9))
        nodes = SPHERE.nodes * [1.0, 1.2, 0.9]
        space = ec.SurfaceSpace.from_nodes(nodes, SPHERE.cells)
        turn = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])
        moved = ec.SurfaceSpace.from_nodes(nodes @ turn + 2.0, SPHERE.cells)
        normal, H = ellipsoid.normal(nodes), ellipsoid.mean_curvature(nodes)
        *_, one = loops["willmore_flow"](space, normal, H, 1e-3, 0.01)
        *_, other = loops["willmore_flow"](moved, normal @ turn, H, 1e-3, 0.01)
        assert other.x == pytest.approx(one.x @ turn + 2.0, abs=1e-10)

    def test_cliffords_torus_stays_up_to_the_spatial_error(self, loops):
        torus, moved = ec.exact_surfaces.Torus(np.sqrt(2), 1.0), []
        for n, m in ((10, 8), (16, 12)):
            space = ec.SurfaceSpace(ec.torus(np.sqrt(2), 1.0, n, m), 2, torus.closest)
            *_, last = self.run(loops, torus, space.nodes, space.cells, 1 / 200, 1 / 20)
            moved.append(np.abs(last.x - space.nodes).max())
        assert moved[0] > 4 * moved[1]
        assert loops["bending"](last) == pytest.approx(2 * np.pi**2, rel=1e-3)

    def test_another_torus_does_not_stay_and_loses_energy_as_the_theory_says(self, loops):
        torus, step = ec.exact_surfaces.Torus(1.0, 0.5), 5e-4
        space = ec.SurfaceSpace(ec.torus(1.0, 0.5, 16, 10), 2, torus.closest)
        run = self.run(loops, torus, space.nodes, space.cells, step, 0.01)
        W = np.array([loops["bending"](s) for s in run])
        assert W[0] / (2 * np.pi**2) == pytest.approx(2 / np.sqrt(3), rel=2e-3)
        assert (np.diff(W) < 0).all()
        at = run[-2].surface()
        slope = (W[-1] - W[-3]) / (2 * step)
        assert slope == pytest.approx(-at.integral(at["V"] ** 2) / 2, rel=0.02)

    def test_an_ellipsoid_becomes_round(self, loops):
        axes = np.array([1.0, 1.0, 1.2])
        surface = ec.exact_surfaces.Ellipsoid(tuple(axes))
        run = self.run(loops, surface, SPHERE.nodes * axes, SPHERE.cells, 2.5e-3, 0.25)
        spread = [np.ptp(np.linalg.norm(s.x, axis=1)) for s in (run[0], run[-1])]
        assert spread[1] < 0.05 * spread[0]

    def test_the_length_of_the_normal_is_unstable_if_it_is_left_alone(self, loops):
        space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), 2, ec.to_unit_sphere)
        x, n = space.nodes, len(space.nodes)
        run = loops["willmore_flow"](
            space, 1.001 * x, np.full(n, 2.0), 5e-3, 0.15, unit_normal=False
        )
        excess = [np.linalg.norm(s["normal"], axis=1).mean() - 1 for s in run]
        assert np.log(excess[-1] / excess[20]) / 0.05 == pytest.approx(8, abs=0.3)
