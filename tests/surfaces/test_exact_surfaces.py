"""Distance, normal and curvature of the exact surfaces: closed forms and difference quotients."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from esfem_core.surfaces import torus
from esfem_core.surfaces.exact_surfaces import Ellipsoid, LevelSet, Sphere, Torus

SURFACES = [Sphere(1.3), Torus(1.0, 0.4), Ellipsoid((1.4, 1.0, 0.7))]


def points_near(surface, n=200):
    """Points on the surface, and points off it by up to 0.15 along its normals."""
    rng = np.random.default_rng(3)
    start = rng.normal(size=(n, 3))
    on = surface.closest(start / np.linalg.norm(start, axis=1, keepdims=True) * 1.1)
    d = rng.uniform(-0.15, 0.15, n)
    return on, d, on + d[:, None] * surface.near(on).normal


@pytest.mark.parametrize("surface", SURFACES)
def test_decomposition_returns_what_it_was_made_of(surface):
    on, d, x = points_near(surface)
    near = surface.near(x)
    np.testing.assert_allclose(near.points, on, atol=1e-13)
    np.testing.assert_allclose(near.distance, d, atol=1e-13)
    np.testing.assert_allclose(near.normal, surface.near(on).normal, atol=1e-13)
    np.testing.assert_allclose(surface.closest(x), near.points, atol=1e-15)


def test_points_satisfy_the_equations():
    x = points_near(SURFACES[1])[0]
    np.testing.assert_allclose(np.hypot(np.hypot(x[:, 0], x[:, 1]) - 1, x[:, 2]), 0.4, atol=1e-14)
    x = points_near(SURFACES[2])[0]
    np.testing.assert_allclose(((x / [1.4, 1.0, 0.7]) ** 2).sum(axis=1), 1, atol=1e-13)


def uneven(x):
    return (x**2 / [4, 1, 0.49]).sum(axis=1) - 1 + 0.1 * np.sin(x[:, 0] * x[:, 1] + x[:, 2])


@pytest.mark.parametrize(
    ("surface", "accuracy"),
    [*((surface, 1e-8) for surface in SURFACES), (LevelSet(uneven), 2e-6)],
)
def test_weingarten_map_is_the_differential_of_the_normal(surface, accuracy):
    on, _, _ = points_near(surface, 40)
    near = surface.near(on)
    h = 1e-5
    for i, e in enumerate(np.eye(3)):
        quotient = (surface.near(on + h * e).normal - surface.near(on - h * e).normal) / (2 * h)
        np.testing.assert_allclose(near.weingarten[:, :, i], quotient, atol=accuracy)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", near.weingarten, near.normal), 0, atol=1e-14)
    transposed = np.swapaxes(near.weingarten, 1, 2)
    np.testing.assert_allclose(near.weingarten, transposed, rtol=0, atol=1e-14)


def test_mean_curvature_in_closed_form():
    np.testing.assert_allclose(Sphere(2.0).near(np.eye(3)).mean_curvature, 1.0)
    outer, inner = Torus(2.0, 0.5).near(np.array([[2.5, 0, 0], [1.5, 0, 0]])).mean_curvature
    np.testing.assert_allclose([outer, inner], [2 + 1 / 2.5, 2 - 1 / 1.5])
    a, b, c = 1.4, 1.0, 0.7  # at (a, 0, 0) the curvatures are a/b^2 and a/c^2
    tip = Ellipsoid((a, b, c)).near(np.array([a, 0, 0])).mean_curvature
    np.testing.assert_allclose(tip, a / b**2 + a / c**2)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Sphere(0.0), "radius must be a finite number > 0, got 0.0"),
        (lambda: Torus(1.0, 1.5), "R must be larger than r, got R = 1 and r = 1.5"),
        (lambda: Torus(1.0, float("nan")), "r must be a finite number > 0, got nan"),
        (lambda: Ellipsoid((1.0, 2.0)), r"axes must have shape \(3,\), got \(2,\)"),
        (lambda: Ellipsoid((1.0, -2.0, 1.0)), r"axes must be positive, got \[1.0, -2.0, 1.0\]"),
        (lambda: Ellipsoid((1e200, 1.0, 1.0)), r"axes must be from 1e-75 to 1e\+75, got \[1e\+200"),
        (lambda: Ellipsoid((1e-200, 1.0, 1.0)), r"axes must be from 1e-75 to 1e\+75, got \[1e-200"),
        (lambda: Sphere().near(np.zeros((2, 3))), r"\[0.0, 0.0, 0.0\] is too far from the sphere"),
        (lambda: Sphere().near(np.array([1e200, 0, 0])), "too far from the sphere"),
        (lambda: Torus().near(np.array([1e200, 0, 0])), "too far from the torus"),
        (lambda: Torus().near(np.array([[0, 0, 0.4]])), "too far from the torus"),
        (lambda: Torus().near(np.array([[0, 1.0, 0]])), "too far from the torus"),
        (lambda: Ellipsoid((2, 1, 1)).near(np.zeros(3)), "too far from the ellipsoid"),
        (lambda: Sphere().near(np.ones((2, 2))), r"x must have shape \(\.\.\., 3\), got \(2, 2\)"),
        (lambda: Torus().closest([[1, np.nan, 0]]), r"x must be finite, but x\[0, 1\] is nan"),
        (lambda: Ellipsoid().closest(1.0), r"x must have shape \(\.\.\., 3\), got \(\)"),
    ],
)
def test_what_has_no_closest_point_and_what_is_no_surface_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize("axes", [(2, 1, 1), (1, 2, 2), (3, 2, 1), (10, 1, 0.1), (1, 1, 1.0001)])
def test_inside_an_ellipsoid_no_sample_of_it_is_closer_however_deep_a_point_lies(axes):
    rng = np.random.default_rng(5)
    x = rng.uniform(-1, 1, (30, 3)) * axes
    x[:10] *= 1e-3
    x[10:20, np.argmin(axes)] *= 1e-9  # to the other side it is hardly farther
    p = Ellipsoid(axes).closest(x)
    np.testing.assert_allclose(((p / axes) ** 2).sum(axis=1), 1, rtol=1e-14)
    samples = rng.normal(size=(20_000, 3))
    samples *= np.asarray(axes) / np.linalg.norm(samples, axis=1, keepdims=True)
    nearest = cKDTree(samples).query(x)[0]
    assert (np.linalg.norm(x - p, axis=1) <= nearest).all()


def test_between_the_focal_curve_and_the_surface_points_of_a_plane_have_one_closest():
    """From a radius of 1.5 on, at the vertex of curvature 2; nearer to the middle there are two."""
    surface = Ellipsoid((1.0, 2.0, 2.0))
    found = surface.closest(np.array([[0, 1.51, 0], [0, 1.2, 0.96], [0, 0, -1.9]]))
    np.testing.assert_allclose(found[0], [0, 2, 0], rtol=1e-14)
    np.testing.assert_allclose(found[1] / [1, 1.2, 0.96], [0, *2 * [2 / np.hypot(1.2, 0.96)]])
    np.testing.assert_allclose(found[2], [0, 0, -2], rtol=1e-14)
    with pytest.raises(ValueError, match="too far from the ellipsoid"):
        surface.closest(np.array([[0, 1.51, 0], [0, 1.2, 0.8]]))


def test_radii_and_axes_may_be_of_any_library():
    assert Sphere(np.float32(2)) == Sphere(2) == Sphere(2.0)
    assert Torus(2, np.array(1)) == Torus(2.0, 1.0)
    assert Ellipsoid(np.array([3, 2, 1])) == Ellipsoid((3.0, 2.0, 1.0))
    for surface in (Sphere, Torus):
        with pytest.raises(TypeError, match="must be a finite number > 0, got '1'"):
            surface("1")


@pytest.mark.parametrize(("away", "accuracy"), [(0, 1e-10), (1e2, 2e-9), (1e4, 1e-8), (1e6, 1e-7)])
@pytest.mark.parametrize("given", [False, True])
def test_the_curvature_of_a_level_set_is_right_far_from_the_origin(away, accuracy, given):
    centre = away * np.array([1, -1 / 3, 1 / 7])
    x = centre + Sphere().closest(np.random.default_rng(0).normal(size=(5, 3)))

    def d(x):
        return np.linalg.norm(x - centre, axis=1) - 1

    def gradient(x):
        return (x - centre) / np.linalg.norm(x - centre, axis=1, keepdims=True)

    level_set = LevelSet(d, gradient if given else None)
    np.testing.assert_allclose(level_set.mean_curvature(x), 2, rtol=accuracy)


def test_a_given_gradient_makes_the_curvature_more_accurate():
    def d(x):
        return np.exp((x**2 / [4, 1, 0.49]).sum(axis=1)) - np.e

    def gradient(x):
        return 2 * x / [4, 1, 0.49] * np.exp((x**2 / [4, 1, 0.49]).sum(axis=1))[:, None]

    x = Sphere().closest(np.random.default_rng(0).normal(size=(50, 3))) * [2, 1, 0.7]
    exact = Ellipsoid((2, 1, 0.7)).mean_curvature(x)
    errors = [abs(LevelSet(d, g).mean_curvature(x) / exact - 1).max() for g in (gradient, None)]
    assert errors[0] < 1e-10 < errors[1] < 1e-8


@pytest.mark.parametrize(
    ("r", "accuracy"), [(0.4, 1e-9), (0.05, 2e-9), (0.004, 1e-8), (1e-4, 1e-7)]
)
def test_the_curvature_of_a_thin_level_set_is_right(r, accuracy):
    def d(x):
        return np.hypot(np.hypot(x[:, 0], x[:, 1]) - 1, x[:, 2]) - r

    x = torus(1, r, 8, 6).vertices
    expected = Torus(1, r).mean_curvature(x)
    np.testing.assert_allclose(LevelSet(d).mean_curvature(x), expected, rtol=accuracy)


@pytest.mark.parametrize(("height", "k"), [(1e-2, 10), (1e-2, 30), (1e-3, 100)])
def test_the_curvature_of_waves_is_as_wrong_as_documented(height, k):
    x = Sphere().closest(np.random.default_rng(0).normal(size=(500, 3)))
    level_set = LevelSet(lambda x: (x**2).sum(axis=1) - 1 - height * np.sin(k * x[:, 0]))
    near = level_set.near(x)
    second = np.full((500, 3), 2.0)
    second[:, 0] += height * k**2 * np.sin(k * near.points[:, 0])
    slope = 2 * near.points
    slope[:, 0] -= height * k * np.cos(k * near.points[:, 0])
    expected = (second * (1 - near.normal**2)).sum(axis=1) / np.linalg.norm(slope, axis=1)
    accuracy = 2e-9 * (k / (2 * np.pi)) ** 4
    largest = (np.abs(second).max(axis=1) / np.linalg.norm(slope, axis=1)).max()
    np.testing.assert_allclose(near.mean_curvature, expected, rtol=0, atol=accuracy * largest)


def test_a_gradient_that_writes_into_its_argument_changes_no_points():
    def gradient(x):
        return np.multiply(x, 2, out=x)

    near = LevelSet(lambda x: (x**2).sum(axis=1) - 1, gradient).near(np.array([[0, 0, 1.1]]))
    np.testing.assert_allclose(near.points, [[0, 0, 1]], atol=1e-13)
    np.testing.assert_allclose(near.distance, 0.1, atol=1e-13)


def test_booleans_are_no_axes():
    with pytest.raises(TypeError, match=r"axes\[0\] must be a number, got True"):
        Ellipsoid((True, 1, 1))
