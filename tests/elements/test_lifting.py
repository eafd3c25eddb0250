"""Lifted errors: closed forms on spheres, and what they have in common with nodal ones."""

import numpy as np
import pytest

import esfem_core as ec
from esfem_core.elements import squared_differences
from esfem_core.study import final, observed_orders, space_study, time_study

PROBLEM = ec.problems.expanding_sphere()


def space_of(refinements, degree=2, exactness=None):
    tri = ec.sphere("octahedron", refinements)
    return ec.SurfaceSpace(tri, degree, ec.to_unit_sphere, exactness)


def tangential(n):
    return np.eye(3) - n[..., :, None] * n[..., None, :]


def unlifted_errors(space, state):
    """Closed form, on Γ_h[x_*]: discrete function minus exact function at the closest point."""
    t, a = state.t, np.exp(-(state.t**2))
    r, dr = 1 + np.sin(np.pi * t) / 2, np.pi / 2 * np.cos(np.pi * t)
    x = PROBLEM.exact.x(space.nodes, t)
    points, normals = space.quadrature_points(x), space.normals(x)
    length = np.linalg.norm(points, axis=2, keepdims=True)
    n = points / length
    p = r * n
    Dp = (r / length)[..., None] * tangential(n) @ tangential(normals)
    grad_u = a * p[..., [1, 0, 0]] * p[..., [2, 2, 1]]
    exact = {
        "x": (p, Dp),
        "v": (dr / r * p, dr / r * Dp),
        "u": (a * p.prod(axis=2), np.einsum("tqi,tqij->tqj", grad_u, Dp)),
    }

    def norm(e):
        return np.sqrt(space.load(x, (e**2).reshape(*e.shape[:2], -1).sum(axis=2)).sum())

    out = []
    for q, (value, gradient) in exact.items():
        w = getattr(state, q)
        out += [norm(space.evaluate(w) - value), norm(space.gradient(x, w) - gradient)]
    return np.array(out)


def test_integrals_over_the_exact_surface_are_exact_however_coarse_the_mesh():
    """With w = 0 the metric of the lift and the function's derivative are all there is."""
    space, r = space_of(1), 3.0
    l2, h1 = squared_differences(
        space,
        r * space.nodes,
        lambda y: r * ec.to_unit_sphere(y),
        np.zeros((len(space.nodes), 2)),
        lambda y: np.stack([np.ones(len(y)), y[:, 0]], axis=1),
        exactness=24,
    )
    np.testing.assert_allclose(l2, [4 * np.pi * r**2, 4 / 3 * np.pi * r**4], rtol=1e-10)
    np.testing.assert_allclose(h1, [0, 8 / 3 * np.pi * r**2], rtol=1e-10, atol=1e-20)


def reused(function):
    """The function, which writes its values into one array for each shape."""
    arrays = {}

    def written(*given):
        values = function(*given)
        array = arrays.setdefault(values.shape, values)
        array[...] = values
        return array

    return written


@pytest.mark.parametrize("name", ["x", "v", "u", "closest", "origin"])
def test_an_exact_solution_may_return_the_same_array_each_time(name):
    """A difference of an array and itself is zero, as if the solution had no error."""
    space, exact = space_of(1), PROBLEM.exact
    x, v, fields = exact.nodal(space.nodes, 0.3)
    state = ec.State(0.3, 1.01 * x, v + x, 1 + fields["u"])
    given = {field: getattr(exact, field) for field in ("x", "v", "u", "closest", "origin")}
    again = ec.Problem(1.0, exact=ec.Exact(**{**given, name: reused(given[name])}))
    assert ec.errors.lifted(space, again, state) == ec.errors.lifted(space, PROBLEM, state)


def test_functions_on_the_exact_surface_may_write_into_their_points():
    space = space_of(1)

    def squared(y):
        y *= y
        return y

    w = np.zeros_like(space.nodes)
    given = (space, space.nodes, ec.to_unit_sphere, w)
    expected = squared_differences(*given, lambda y: y * y)
    for found in (squared_differences(*given, f) for f in (squared, reused(lambda y: y * y))):
        np.testing.assert_array_equal(found, expected)


def test_integrals_are_exact_for_two_degrees_more_than_products():
    """Up to degree three the rule for one degree more is the same."""
    space = space_of(0, 4)
    given = space, space.nodes, ec.to_unit_sphere, space.nodes, lambda y: 0 * y
    np.testing.assert_array_equal(
        squared_differences(*given), squared_differences(*given, exactness=2 * 4 + 2)
    )


@pytest.mark.parametrize("t", [0.3, 0.9])
def test_lifted_and_unlifted_norms_agree_up_to_the_geometry_error(t):
    """Their ratio is 1 + O(h^2): the error's gradient is that on another tangent plane."""
    gaps = []
    for refinements in (2, 3, 4):
        space = space_of(refinements, exactness=6)
        x = PROBLEM.exact.x(space.nodes, t)
        bump = 1e-2 * np.cos(3 * x) * x[:, [1]]
        state = ec.State(
            t, x + bump, PROBLEM.exact.v(space.nodes, t) - bump, PROBLEM.exact.u(x, t) + bump[:, 0]
        )
        lifted = ec.errors.lifted(space, PROBLEM, state)
        gaps.append(np.abs(np.array(lifted) / unlifted_errors(space, state) - 1).max())
    assert gaps[-1] < 1e-4
    assert observed_orders([4, 2, 1], gaps).min() > 2.5


def test_interpolation_has_order_k_plus_1_in_l2_and_k_in_h1():
    """x_* and I_h u against id and u: k + 1 in L2 and k in H1, one more for x on the sphere."""
    t, h, rows = 0.4, [], []
    for refinements in (2, 3, 4):
        space = space_of(refinements)
        x = PROBLEM.exact.x(space.nodes, t)
        state = ec.State(t, x, PROBLEM.exact.v(space.nodes, t), PROBLEM.exact.u(x, t))
        assert max(ec.errors.compare(space, PROBLEM, state)) < 1e-14
        h.append(space.mesh_size(space.nodes))
        rows.append(ec.errors.lifted(space, PROBLEM, state))
    orders = [observed_orders(h, column)[-1] for column in np.transpose(rows)]
    np.testing.assert_allclose(orders, [4, 3, 4, 3, 3, 2], rtol=0, atol=0.1)


def test_difference_to_nodal_errors_is_the_error_of_interpolation():
    """Triangle inequality; norms on Γ and on Γ_h differ by a factor close to one."""
    space = space_of(3)
    state = final(ec.evolve(space, PROBLEM, order=5, step=1 / 80, end=1.0))
    x = PROBLEM.exact.x(space.nodes, 1.0)
    nodal = ec.State(1.0, x, PROBLEM.exact.v(space.nodes, 1.0), PROBLEM.exact.u(x, 1.0))
    lifted, interpolation = (np.array(ec.errors.lifted(space, PROBLEM, s)) for s in (state, nodal))
    at_nodes = np.array(ec.errors.compare(space, PROBLEM, state))
    assert (lifted <= interpolation + 1.01 * at_nodes).all()
    assert (lifted >= np.abs(interpolation - at_nodes) - 0.01 * at_nodes).all()


@pytest.mark.parametrize(
    "problem",
    [
        ec.problems.growing_sphere(),
        ec.problems.shrinking_sphere(),
        ec.problems.oscillating_ellipsoid(),
    ],
    ids=["growing", "shrinking", "ellipsoid"],
)
def test_closest_points_and_origins_fit_the_motion(problem):
    p, t = space_of(1).nodes, 0.3
    x = problem.exact.x(p, t)
    np.testing.assert_allclose(problem.exact.origin(x, t), p, rtol=0, atol=1e-14)
    np.testing.assert_allclose(problem.exact.closest(x, t), x, rtol=0, atol=1e-14)
    off = x + 0.02 * np.sin(np.arange(3 * len(x))).reshape(-1, 3)
    y = problem.exact.closest(off, t)
    np.testing.assert_allclose(problem.exact.closest(y, t), y, rtol=0, atol=1e-13)
    # No other point of the surface is closer.
    many = problem.exact.x(space_of(3, 4).nodes, t)
    distances = np.linalg.norm(off[:, None] - many, axis=2)
    assert (np.linalg.norm(off - y, axis=1) <= distances.min(axis=1) + 1e-12).all()


def test_studies_take_either_measure():
    spaces, problem = [space_of(1), space_of(2)], ec.problems.growing_sphere()
    options = {"order": 3, "end": 0.5, "measure": ec.errors.lifted}
    table = space_study(spaces, problem, step=1 / 20, **options)
    last = final(ec.evolve(spaces[1], problem, order=3, step=1 / 20, end=0.5))
    assert table["x_h1"][1] == ec.errors.lifted(spaces[1], problem, last).x_h1
    assert time_study(spaces[1], problem, steps=[1 / 20], **options)["u_l2"][0] == table["u_l2"][1]


def test_without_a_velocity_its_errors_are_nan():
    space = space_of(1)
    state = ec.State(0.0, space.nodes, None, PROBLEM.initial_values(space.nodes)["u"])
    errors = ec.errors.lifted(space, PROBLEM, state)
    assert np.isnan([errors.v_l2, errors.v_h1]).all()
    assert np.isfinite([errors.x_l2, errors.x_h1, errors.u_l2, errors.u_h1]).all()


def test_without_an_exact_solution_or_its_closest_points_there_is_no_lifted_error():
    space = space_of(0)
    state = ec.State(0.0, space.nodes, None, space.nodes[:, 0])
    with pytest.raises(ValueError, match="need an exact solution with closest points and origins"):
        ec.errors.lifted(space, ec.Problem(u0=lambda x: x[:, 0]), state)
    bare = ec.Exact(*PROBLEM.exact[:3])
    with pytest.raises(ValueError, match="need an exact solution with closest points and origins"):
        ec.errors.lifted(space, ec.Problem(u0=lambda x: x[:, 0], exact=bare), state)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"x": np.zeros((3, 3))}, r"x must have shape \(18, 3\), got \(3, 3\)"),
        ({"w": np.zeros(18)}, r"w must have shape \(18, m\), got \(18,\)"),
        (
            {"closest": lambda x: x[:, 0]},
            r"values of closest must have shape \(96, 3\), got \(96,\)",
        ),
        ({"function": lambda y: y}, r"values of function must have shape \(96, 1\), got \(96, 3\)"),
        ({"exactness": 2.5}, "exactness must be an integer from 0 to 101, got 2.5"),
    ],
)
def test_arrays_that_do_not_fit_are_refused_by_name(change, message):
    space = space_of(0)
    arguments = {
        "x": space.nodes,
        "closest": ec.to_unit_sphere,
        "w": space.nodes[:, :1],
        "function": lambda y: y[:, :1],
    }
    with pytest.raises(ValueError, match=message):
        squared_differences(space, **(arguments | change))


def test_what_is_no_space_is_refused_by_name():
    x = space_of(0).nodes
    with pytest.raises(TypeError, match="space must be a SurfaceSpace, got None"):
        squared_differences(None, x, ec.to_unit_sphere, x[:, :1], lambda y: y[:, :1])
