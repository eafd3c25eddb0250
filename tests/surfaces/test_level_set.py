"""Closest points on level sets."""

import numpy as np
import pytest
from level_sets import ellipsoid, torus, two_rings, unit_sphere
from scipy.interpolate import RegularGridInterpolator

import esfem_core as ec
from esfem_core.surfaces import central_gradient, descend
from esfem_core.surfaces.exact_surfaces import LevelSet
from esfem_core.surfaces.level_set import reach

NEAR = np.random.default_rng(0).standard_normal((200, 3))


def torus_closest(x, r=0.4):
    ring = np.hypot(x[:, 0], x[:, 1])[:, None]
    core = np.hstack([x[:, :2] / ring, np.zeros((len(x), 1))])
    return core + r * (x - core) / np.linalg.norm(x - core, axis=1, keepdims=True)


def test_sphere_and_torus_have_closed_forms():
    on_sphere = ec.to_unit_sphere(NEAR)
    x = on_sphere * np.linspace(0.8, 1.2, len(NEAR))[:, None]
    np.testing.assert_allclose(
        ec.project_to_level_set(unit_sphere)(x), on_sphere, rtol=0, atol=1e-11
    )
    angle, tube = np.random.default_rng(1).uniform(0, 2 * np.pi, (2, 200))
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    x = ring * (1 + 0.5 * np.cos(tube))[:, None] + 0.5 * np.sin(tube)[:, None] * [0, 0, 1]
    np.testing.assert_allclose(
        ec.project_to_level_set(torus)(x), torus_closest(x), rtol=0, atol=1e-11
    )


@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e3])
def test_ellipsoid_against_the_problem_with_its_own_solver(scale):
    """Not a distance, and d times a constant has the same surface."""
    problem = ec.problems.oscillating_ellipsoid()
    a = 1 + np.sin(1.0) / 4
    x = problem.exact.x(ec.to_unit_sphere(NEAR), 1.0) * np.linspace(0.9, 1.1, 200)[:, None]
    project = ec.project_to_level_set(lambda x: scale * ((x**2 / [a, 1, 1]).sum(axis=1) - 1))
    np.testing.assert_allclose(project(x), problem.exact.closest(x, 1.0), rtol=0, atol=1e-10)


def test_what_is_left_is_normal_and_the_given_gradient_is_used():
    calls = []

    def gradient(x):
        calls.append(len(x))
        return 2 * x / [4, 1, 0.49]

    x = ec.to_unit_sphere(NEAR) * [2.05, 1.05, 0.73]
    y = ec.project_to_level_set(ellipsoid, gradient)(x)
    assert calls
    n = ec.to_unit_sphere(gradient(y))
    off = x - y
    assert np.abs(ellipsoid(y)).max() < 1e-12
    assert np.linalg.norm(off - (off * n).sum(axis=1, keepdims=True) * n, axis=1).max() < 1e-10


@pytest.mark.parametrize(
    "gradient",
    [
        lambda x: 2 * x,
        lambda x: -2 * x / [4, 1, 0.49],
        lambda x: 9 * x / [4, 1, 0.49],
        lambda x: 2 * x / [4, 1, 0.49] + 0.1 * ec.to_unit_sphere(np.cross(x, [0, 0, 1])),
    ],
)
def test_a_gradient_of_another_function_is_refused(gradient):
    x = ec.to_unit_sphere(NEAR) * [2.05, 1.05, 0.73]
    with pytest.raises(
        ValueError, match=r"gradient must be that of d, but at \[.*differences of d"
    ):
        ec.project_to_level_set(ellipsoid, gradient)(x)
    with pytest.raises(ValueError, match="gradient must be that of d"):
        ec.exact_surfaces.LevelSet(ellipsoid, gradient).near(x)


def test_a_gradient_that_is_right_on_the_surface_is_enough():
    y = ec.project_to_level_set(lambda x: np.linalg.norm(x, axis=1) - 1, lambda x: 1 * x)
    np.testing.assert_allclose(y(1.1 * ec.to_unit_sphere(NEAR)), ec.to_unit_sphere(NEAR))


def test_a_gradient_is_not_compared_across_kinks_or_where_differences_say_nothing():
    def box(x):  # kinks where two coordinates have one size
        return np.abs(x).max(axis=1) - 1

    def slope(x):
        side = np.abs(x).argmax(axis=1)
        return np.eye(3)[side] * np.sign(x)

    x = np.array([[1.1, 1.1, 0.2], [0.1, 0.2, 1.2], [0.3, -1.1, 0.2]])
    np.testing.assert_allclose(ec.project_to_level_set(box, slope)(x[1:]), x[1:].clip(-1, 1))
    far = np.array([1e6, 0, 0])
    small = ec.project_to_level_set(
        lambda x: np.linalg.norm(x - far, axis=1) - 1e-3,
        lambda x: (x - far) / np.linalg.norm(x - far, axis=1, keepdims=True),
    )
    np.testing.assert_allclose(small(far + np.eye(3)[2:] / 500), far + np.eye(3)[2:] / 1000)


@pytest.mark.parametrize("distance", [1e6, 1e9, 1e12])
def test_a_point_far_away_does_not_spoil_the_others(distance):
    def d(x):
        return np.sqrt((x**2 / [4, 1, 1]).sum(axis=1)) - 1

    def gradient(x):
        return x / [4, 1, 1] / (d(x) + 1)[:, None]

    near = np.array([[1.3, 0.7, 0.1], [0.9, 0.6, 0.0]])
    some = np.vstack([near[:1], [[distance, 0, 0]], near[1:]])
    for given in (None, gradient):
        project = ec.project_to_level_set(d, given)
        np.testing.assert_array_equal(project(some)[::2], project(near))
        np.testing.assert_allclose(project(some)[1], [2, 0, 0], atol=1e-12)
    np.testing.assert_array_equal(descend(d, gradient, some)[::2], descend(d, gradient, near))


def distance_to_sphere(x):
    return np.linalg.norm(x, axis=1) - 1


@pytest.mark.parametrize("spread", [0.03, 1e-4, 1e-10, 0.0])
def test_points_that_are_close_together_are_projected_as_alone(spread):
    cluster = [1.2, 0.6, 0.3] + spread * NEAR[:5]
    y = ec.project_to_level_set(distance_to_sphere)(cluster)
    np.testing.assert_allclose(y, ec.to_unit_sphere(cluster), rtol=0, atol=2e-11)


@pytest.mark.parametrize("away", [1e2, 1e4, 1e6])
def test_a_point_of_a_surface_far_from_the_origin_is_projected_alone(away):
    u, centre = ec.to_unit_sphere(NEAR[:1]), away * np.array([1, -1 / 3, 1 / 7])
    project = ec.project_to_level_set(lambda x: distance_to_sphere(x - centre))
    np.testing.assert_allclose(project(centre + 1.3 * u), centre + u, rtol=0, atol=1e-11 * away)


@pytest.mark.parametrize("r", [0.05, 1e-2, 1e-4])
def test_thin_surfaces_have_their_closest_points(r):
    y = torus_closest(NEAR, r)
    x = y + 0.5 * (y - torus_closest(NEAR, 0))
    project = ec.project_to_level_set(lambda x: torus(x, r=r))
    np.testing.assert_allclose(project(x), y, rtol=0, atol=2e-11)


def expanded_sphere(x, c):
    return (x**2).sum(axis=1) - 2 * c * x.sum(axis=1) + 3 * c**2 - 1


@pytest.mark.parametrize("r", [0.03, 0.01])
def test_polynomials_whose_terms_cancel_have_their_closest_points(r):
    def d(x):
        return ((x**2).sum(axis=1) + 1 - r**2) ** 2 - 4 * (x[:, :2] ** 2).sum(axis=1)

    y = torus_closest(NEAR, r)
    x = y + 0.3 * (y - torus_closest(NEAR, 0))
    np.testing.assert_allclose(ec.project_to_level_set(d)(x), y, rtol=0, atol=2e-11)


@pytest.mark.parametrize("c", [10, 30])
def test_spheres_whose_squares_are_expanded_have_their_closest_points(c):
    u = ec.to_unit_sphere(np.random.default_rng(0).normal(size=(2000, 3)))
    y = ec.project_to_level_set(lambda x: expanded_sphere(x, c))(c + 1.05 * u)
    np.testing.assert_allclose(y, c + u, rtol=0, atol=2e-9)


@pytest.mark.parametrize("given", [False, True])
@pytest.mark.parametrize(("name", "away"), [("root", 1e3), ("growth", 1e5), ("image", 1210)])
def test_a_function_may_be_known_near_the_surface_only(name, away, given):
    centre = away * np.array([1, 1, -1])
    axes = [np.linspace(-1.3, 1.3, 14) + c for c in centre]

    def square(x):
        return ((x - centre) ** 2).sum(axis=-1)

    image = square(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)) - 1
    d, slope = {  # and its derivative with respect to the square
        "root": (lambda x: np.sqrt(3) - np.sqrt(4 - square(x)), lambda s: 0.5 / np.sqrt(4 - s)),
        "growth": (lambda x: np.exp(square(x)) - np.e, np.exp),
        "image": (RegularGridInterpolator(axes, image, method="cubic"), np.ones_like),
    }[name]

    def gradient(x):
        return 2 * (x - centre) * slope(square(x))[:, None]

    u = ec.to_unit_sphere(NEAR[:20])
    level_set = LevelSet(d, gradient if given else None)
    near = level_set.near(centre + 1.2 * u)
    np.testing.assert_allclose(near.points, centre + u, rtol=0, atol=1e-9)
    np.testing.assert_allclose(near.mean_curvature, 2, rtol=1e-6)


def test_rounding_errors_of_terms_that_cancel_are_not_called_single_precision():
    u = ec.to_unit_sphere(np.random.default_rng(0).normal(size=(2000, 3)))
    project = ec.project_to_level_set(lambda x: expanded_sphere(x, 300))
    with pytest.raises(ValueError, match=r"terms of d cancel .* \(its last values are up to .*e-1"):
        project(300 + 1.05 * u)

    def single(x):
        return ((x.astype(np.float32) ** 2).sum(axis=1) - np.float32(1)).astype(float)

    with pytest.raises(ValueError, match="must be of double precision, got numbers of single"):
        ec.project_to_level_set(single)(1.05 * u[:20])


def test_a_point_that_sways_with_the_errors_of_differences_is_not_too_far_away():
    x = np.array([[0.935047854779887, -0.8898793992604399, 0.7163563527889524]])
    y = ec.project_to_level_set(distance_to_sphere)(x)
    np.testing.assert_allclose(y, ec.to_unit_sphere(x), rtol=0, atol=1e-10)


def test_d_bends_over_its_radius_and_over_nothing_at_a_kink():
    x = np.array([[1.0, 0, 0], [0, 0.01, 0], [0, 0, 1e-3]])
    np.testing.assert_allclose(reach(distance_to_sphere, x), [1, 0.01, 1e-3], rtol=0.3)
    kink = reach(lambda x: np.abs(x).max(axis=1) - 1, np.array([[1.0, 1, 0], [1, 0.5, 0]]))
    np.testing.assert_array_equal(kink, [1e-8, 1])


def test_projection_leaves_the_surface_alone():
    y = descend(two_rings, central_gradient(two_rings), np.array([[1.1, 1.45, 0.1], [0, 0.3, 0.4]]))
    np.testing.assert_allclose(ec.project_to_level_set(two_rings)(y), y, rtol=0, atol=1e-13)


def test_no_points_are_no_problem():
    assert ec.project_to_level_set(torus)(np.empty((0, 3))).shape == (0, 3)


def test_the_central_gradient_is_accurate_to_nine_digits():
    x = NEAR[:20]
    exact = np.stack([np.cos(x[:, 0]) * x[:, 1], np.sin(x[:, 0]), 2 * x[:, 2]], axis=1)
    gradient = central_gradient(lambda x: np.sin(x[:, 0]) * x[:, 1] + x[:, 2] ** 2)
    np.testing.assert_allclose(gradient(x), exact, rtol=0, atol=1e-9)


def test_a_level_set_may_return_one_array_each_time():
    values = {}

    def buffered(x):
        buffer = values.setdefault(len(x), np.empty(len(x)))
        np.copyto(buffer, torus(x))
        return buffer

    x = 1.05 * torus_closest(NEAR)
    plain, same = ec.project_to_level_set(torus), ec.project_to_level_set(buffered)
    np.testing.assert_array_equal(same(x), plain(x))
    for one, other in zip(LevelSet(buffered).near(x), LevelSet(torus).near(x), strict=True):
        np.testing.assert_array_equal(one, other)


REFUSED = {
    "vanishing gradient": (
        unit_sphere,
        np.zeros((1, 3)),
        "gradient of d must not vanish",
    ),
    "no zero": (
        lambda x: (x**2).sum(axis=1) + 1,
        np.array([[0.3, 0.2, 0.1]]),
        "does not reach the surface",
    ),
    "triple zero": (lambda x: unit_sphere(x) ** 3, np.ones((2, 3)), "vanishes on the surface"),
    "large": (lambda x: 1e300 * unit_sphere(x), np.ones((2, 3)), r"d must be up to 1e\+150"),
    "small": (
        lambda x: 1e-300 * unit_sphere(x),
        np.ones((2, 3)),
        "gradient of d must be larger than 1e-150, .* multiply d by a large number",
    ),
    "shape": (lambda x: x, np.ones((2, 3)), r"values of d must have shape \(2,\), got \(2, 3\)"),
    "one point": (unit_sphere, np.ones(3), r"points must have shape \(n, 3\), got \(3,\)"),
    "infinite point": (
        unit_sphere,
        np.array([[0, np.inf, 1]]),
        r"points must be finite, but points\[0, 1\] is inf",
    ),
    "not a number": (lambda x: np.log(-x[:, 0]), np.ones((2, 3)), r"d is nan at \[1\.0, 1\.0"),
}


@pytest.mark.parametrize("name", REFUSED)
@pytest.mark.filterwarnings("ignore:invalid value")
def test_what_cannot_be_projected_is_refused_with_the_point(name):
    d, x, message = REFUSED[name]
    with pytest.raises(ValueError, match=message):
        ec.project_to_level_set(d)(x)


def in_single_precision(d):
    """As d, with numbers of double precision that have the digits of single precision."""
    return lambda x: np.asarray(d(x.astype(np.float32)), dtype=float)


@pytest.mark.parametrize("d", [unit_sphere, ellipsoid, torus, two_rings])
@pytest.mark.parametrize("n", [1, 200])
def test_single_precision_is_refused_where_newtons_method_would_stop_at_its_jitter(d, n):
    near = 1.02 * descend(d, central_gradient(d), torus_closest(NEAR[:n]))
    with pytest.raises(ValueError, match="values of d must be of double precision"):
        ec.project_to_level_set(in_single_precision(d))(near)


@pytest.mark.parametrize(
    ("gradient", "message"),
    [
        (lambda x: (2 * x).astype(np.float32), "values of gradient must be of double precision"),
        (in_single_precision(lambda x: 2 * x), "single precision"),
    ],
)
def test_a_gradient_in_single_precision_is_named(gradient, message):
    with pytest.raises(ValueError, match=message):
        ec.project_to_level_set(unit_sphere, gradient)(1.05 * ec.to_unit_sphere(NEAR))


def test_functions_with_flat_parts_are_not_called_single_precision():
    """A box, of whose faces all moves but one leave d as it is, and points where d is constant."""
    box = ec.project_to_level_set(lambda x: np.abs(x).max(axis=1) - 1)
    at = np.array([[1.01, 0.3, 0.2], [0.1, -0.98, 0.4]])
    np.testing.assert_allclose(box(at), [[1, 0.3, 0.2], [0.1, -1, 0.4]], atol=1e-11)
