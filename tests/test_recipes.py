"""What the chapters say in a sentence, and run nowhere: each does what it promises."""

import numpy as np
import pytest
import trimesh
from scipy.interpolate import CubicSpline
from scipy.sparse.csgraph import connected_components

import esfem_core as ec

SPACE = ec.SurfaceSpace(ec.sphere("icosahedron", 2), 2, ec.to_unit_sphere)
HEIGHT = ec.Surface(SPACE, SPACE.nodes, {"u": SPACE.nodes[:, 2]})


def final(problem, end=1.0):
    return list(ec.evolve(SPACE, problem, 2, 1 / 20, end))[-1]


def test_the_amount_in_a_region():
    at = HEIGHT
    assert at.integral(np.where(at.points[..., 2] > 0, at.u, 0.0)) == pytest.approx(np.pi, rel=3e-3)


def test_the_amount_on_each_component():
    small = ec.sphere("icosahedron", 2).apply_scale(0.5).apply_translation([3, 0, 0])
    tri = trimesh.util.concatenate([ec.sphere("icosahedron", 2), small])
    space = ec.SurfaceSpace(tri, 2)
    at = ec.Surface(space, space.nodes, {"u": np.ones(len(space.nodes))})
    n, part = connected_components(at.M)
    element = part[at.space.cells[:, 0]]
    amounts = [at.integral(np.where((element == i)[:, None], at.u, 0.0)) for i in range(n)]
    assert amounts[0] / amounts[1] == pytest.approx(4)
    assert sum(amounts) == pytest.approx(tri.area)


def test_the_flux_through_a_curve():
    """Of u = x3 through the equator of the sphere, out of the north."""
    chi, D = np.where(SPACE.nodes[:, 2] > 0, 1.0, 0.0), 0.3
    into = -D * chi @ (HEIGHT.A @ HEIGHT.fields["u"])
    assert into == pytest.approx(-2 * np.pi * D, rel=2e-3)


def test_a_source_that_senses_the_curvature():
    """On a sphere of radius 1 + t, H = 2/r makes 8 pi r of an amount per time."""

    def curvature(at):
        return at.space.evaluate(ec.elements.normal_and_curvature(at)[1])

    last = final(ec.Problem(0.0, curvature, motion=lambda p, t: p * (1 + t)))
    assert ec.measure(last).amount == pytest.approx(12 * np.pi, rel=2e-4)


def test_a_film_of_nodal_positions_and_a_table_of_radii_are_motions():
    times = np.linspace(0, 1, 11)
    radii = 2 + 0.6 * np.sin(times)
    X = CubicSpline(times, [SPACE.nodes * r / 2 for r in radii], extrapolate=False)
    R = CubicSpline(times, radii / radii[0])
    film = final(ec.Problem(1.0, motion=lambda p, t: X(t)))
    table = final(ec.Problem(1.0, motion=lambda p, t: R(t) * p))
    for last in (film, table):
        np.testing.assert_allclose(last.x, SPACE.nodes * radii[-1] / 2, rtol=0, atol=1e-12)
    np.testing.assert_allclose(film.u, table.u, rtol=1e-9)
    with pytest.raises(ec.EvolutionError, match=r"motion\(p, t\) is not finite .* at t = 1\."):
        final(ec.Problem(1.0, motion=lambda p, t: X(t)), 1.5)


def test_fibres_move_with_the_matter():
    """A sphere that turns has the solution of the sphere at rest, with its directions."""

    def along(at):
        first = ec.Surface(at.space, at.space.nodes, {"y": at.x})
        a = np.cross([0.0, 0.0, 1.0], first.points)
        a = (first.grad("y") @ a[..., None])[..., 0]
        a /= np.linalg.norm(a, axis=-1, keepdims=True)
        return 0.1 * np.eye(3) + a[..., :, None] * a[..., None, :]

    def turned(p, t):
        c, s = np.cos(t), np.sin(t)
        return p @ np.array([[1, 0, 0], [0, c, s], [0, -s, c]])

    def u0(x):
        return 1 + x[:, 0] + x[:, 1] * x[:, 2]

    here, there = (
        final(ec.Problem(u0, diffusivity=along, motion=motion), 0.5).u
        for motion in (lambda p, t: p, turned)
    )
    np.testing.assert_allclose(there, here, rtol=0, atol=1e-9)
    free = final(ec.Problem(u0, diffusivity=0.6, motion=turned), 0.5).u
    assert abs(free - here).max() > 0.1
