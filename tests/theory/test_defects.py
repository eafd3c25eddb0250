"""Defects: perturbed runs that return the exact values, orders, and the splits of the proof."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import solve
from scipy.sparse import csr_array

import esfem_core as ec
from esfem_core.elements import NotFiniteError
from esfem_core.problems import Exact
from esfem_core.solvers import superlu
from esfem_core.stepping import exact_state
from esfem_core.study import observed_orders
from esfem_core.surfaces import derivative
from esfem_core.surfaces.exact_surfaces import Ellipsoid
from esfem_core.theory.defect_terms import (
    Field,
    spatial_terms_u,
    temporal_terms_u,
    temporal_terms_v,
)
from esfem_core.theory.defects import (
    constant_diffusivity,
    defects,
    diffusion,
    dual_norm,
    exact_values,
    force_load,
    rate_of_mass,
    rate_of_u,
    regularised_law,
    source_load,
    spatial_defects,
    stretching,
)
from esfem_core.theory.forms import mass_rate
from esfem_core.theory.stability import response

EXPANDING = ec.problems.expanding_sphere()


def space_of(refinements=1, degree=2):
    return ec.SurfaceSpace(ec.sphere("icosahedron", refinements), degree, ec.to_unit_sphere)


def triaxial():
    """Stretch the sphere along three axes; f and g are arbitrary, no equation is solved."""

    def scale(t, n):
        w = np.array([1.0, 1.3, 0.7])
        return (n == 0) + 0.3 * w**n * np.sin(w * t + n * np.pi / 2)

    def f(at):
        return at.u**2 + at.grad_u[..., 0] * at.points[..., 1]

    def g(at):
        return np.sin(at.u) + at.grad_u[..., 2] ** 2

    exact = Exact(
        lambda p, t: p * scale(t, 0),
        lambda p, t: p * scale(t, 1),
        lambda x, t: np.cos(t) * x[..., 0] + x[..., 1] * x[..., 2],
    )
    return ec.Problem(
        u0=lambda x: x[:, 0] + x[:, 1] * x[:, 2], f=f, g=g, alpha=0.5, beta=2.0, exact=exact
    )


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
@pytest.mark.parametrize(
    "problem",
    [EXPANDING, triaxial(), ec.problems.oscillating_ellipsoid("oscillation")],
    ids=["sphere", "triaxial", "prescribed"],
)
def test_a_run_perturbed_by_the_defects_returns_the_exact_values(problem, order):
    space, step = space_of(0), 1 / 40

    def perturbation(n):
        return defects(space, problem, order, step, n)

    options = {"mass": "extrapolated", "solver": "direct", "perturbation": perturbation}
    for state in ec.evolve(space, problem, order, step, 0.5, **options):
        e = ec.errors.compare(space, problem, state)
        assert max(e.x_l2, e.x_h1, e.u_l2, e.u_h1) < 1e-11
        # With a prescribed motion v is the quotient of positions.
        if state.v is not None and not isinstance(problem.law, ec.laws.Prescribed):
            assert max(e.v_l2, e.v_h1) < 1e-11


def test_exact_starting_values_are_not_perturbed_and_euler_steps_have_the_number_they_lead_to():
    space = space_of(0)

    def run(start, size):
        seen = []

        def perturbation(n):
            seen.append(n)
            zero = np.zeros_like(space.nodes)
            return np.full(len(space.nodes), size), zero, zero

        options = {"start": start, "solver": "direct", "perturbation": perturbation}
        return list(ec.evolve(space, EXPANDING, 3, 0.1, 0.6, **options)), seen

    states, seen = run("exact", 1e-3)
    assert seen == [3, 4, 5, 6]
    for n in range(3):
        np.testing.assert_array_equal(states[n].u, exact_state(space, EXPANDING, n / 10).u)
    substeps = 1 + 2 + 3  # of each of the two steps by Euler's method
    states, seen = run("euler", 1e-3)
    assert seen == [1] * substeps + [2] * substeps + [3, 4, 5, 6]
    unperturbed, _ = run("euler", 0.0)
    np.testing.assert_array_equal(states[0].u, unperturbed[0].u)
    for n in (1, 2):
        assert abs(states[n].u - unperturbed[n].u).max() > 1e-4


def test_what_the_scheme_reproduces_has_no_defect():
    # u constant on a surface at rest, held there by g = beta H
    space = space_of(2)
    exact = Exact(lambda p, t: p, lambda p, t: 0 * p, lambda x, t: np.ones(x.shape[:-1]))
    problem = ec.Problem(u0=lambda x: np.ones(len(x)), beta=0.0, exact=exact)
    for values in defects(space, problem, 3, 0.1, 7):
        assert np.abs(values).max() < 1e-14


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_what_time_leaves_has_order_p(order):
    space, problem, t, steps = space_of(0), triaxial(), 1.0, [1 / 20, 1 / 40]
    limit = spatial_defects(space, problem, t)
    M, A = space.mass_stiffness(exact_state(space, problem, t).x)
    K = M + A
    sizes = []
    for step in steps:
        d = defects(space, problem, order, step, round(t / step))
        time_u, time_v = dual_norm(K, d.u - limit.u), dual_norm(K, d.v - limit.v)
        sizes.append([time_u, time_v, np.abs(d.x).max()])
    for column in np.transpose(sizes):
        assert observed_orders(steps, column)[0] > order - 0.25


@pytest.mark.parametrize("order", [1, 3, 5])
def test_the_terms_of_the_proof_add_up(order):
    space, problem, step = space_of(0), triaxial(), 1 / 20
    n = 2 * order + 3
    d, limit = defects(space, problem, order, step, n), spatial_defects(space, problem, n * step)
    terms = temporal_terms_u(space, problem, order, step, n)
    assert np.abs(sum(terms.values()) - (d.u - limit.u)).max() < 1e-11
    assert all(np.abs(r).max() > 1e-9 for r in terms.values())
    terms = temporal_terms_v(space, problem, order, step, n * step)
    assert np.abs(sum(terms.values()) - (d.v - limit.v)).max() < 1e-12


def test_the_terms_of_the_proof_are_those_that_they_are_called():
    space, problem, step, n = space_of(0), triaxial(), 1 / 20, 7
    now, *past = (exact_values(space, problem, (n - j) * step) for j in range(3))
    far_x, far_v, far_u = (2 * one - other for one, other in zip(*past, strict=True))
    (Mt, At), (M, A) = space.mass_stiffness(far_x), space.mass_stiffness(now.x)
    in_u = temporal_terms_u(space, problem, 2, step, n)
    in_v = temporal_terms_v(space, problem, 2, step, n * step)
    alpha, beta = problem.law.alpha, problem.law.beta
    for found, term in (
        (in_u["A"], (At - A) @ now.u),
        (in_u["(6.9)"], (Mt - M) @ rate_of_u(space, problem, n * step)),
        (in_u["(6.16)"], mass_rate(space, far_x, far_v - now.v) @ now.u),
        (in_u["(6.17)"], (mass_rate(space, far_x, now.v) - mass_rate(space, now.x, now.v)) @ now.u),
        (in_v["M"], (Mt - M) @ now.v),
        (in_v["alpha A"], alpha * (At - A) @ now.v),
        (in_v["beta A"], beta * (At - A) @ now.x),
    ):
        np.testing.assert_allclose(found, term, atol=1e-13)
    for terms, of_surface, of_u, load in (
        (in_u, "(6.22)", "f, extrapolated u", source_load),
        (in_v, "g, surface", "g, extrapolated u", force_load),
    ):
        near, middle, far = (
            load(space, problem, x, u, n * step)
            for x, u in ((now.x, now.u), (far_x, now.u), (far_x, far_u))
        )
        np.testing.assert_allclose(terms[of_surface], near - middle, atol=1e-13)
        np.testing.assert_allclose(terms[of_u], middle - far, atol=1e-13)


def test_the_spatial_defect_of_a_prescribed_motion_is_a_derivative():
    space, problem = space_of(1, 1), ec.problems.oscillating_ellipsoid("oscillation")
    t, eps = 0.3, 1e-4
    now = exact_state(space, problem, t)

    def mass_term(s):
        state = exact_state(space, problem, s)
        return space.mass_stiffness(state.x)[0] @ state.u

    A = space.mass_stiffness(now.x)[1]
    f = problem.species["u"].source(ec.Surface(space, now.x, now.u, t))
    expected = (mass_term(t + eps) - mass_term(t - eps)) / (2 * eps) + A @ now.u
    expected -= space.load(now.x, f)
    assert np.abs(spatial_defects(space, problem, t).u - expected).max() < 1e-7


def test_spatial_defects_meet_forces_of_their_time():
    """A resting sphere that is pushed by g = t: the load of the normal, t times."""
    space = space_of(0)
    exact = Exact(lambda p, t: p.copy(), lambda p, t: 0 * p, lambda x, t: np.ones(len(x)))
    problem = ec.Problem(1.0, exact=exact, g=lambda at: at.t + 0 * at.density)
    one, other = (spatial_defects(space, problem, t).v for t in (0.5, 2.0))
    at = ec.Surface(space, space.nodes)
    np.testing.assert_allclose(other - one, -1.5 * at.load(at.normal), atol=1e-13)


def test_dual_norm_is_a_supremum():
    space = space_of(0)
    M, A = space.mass_stiffness(space.nodes)
    K = M + 0.3 * A
    rng = np.random.default_rng(1)
    r = rng.normal(size=(len(space.nodes), 3))
    best = solve(K.toarray(), r)  # the supremum is attained there
    attained = np.sum(r * best) / np.sqrt(np.sum(best * (K @ best)))
    assert dual_norm(K, r) == pytest.approx(attained)
    w = rng.normal(size=r.shape)
    assert np.sum(r * w) / np.sqrt(np.sum(w * (K @ w))) < attained


def test_dual_norm_refuses_what_does_not_fit_or_is_not_finite():
    space = space_of(0)
    M, _ = space.mass_stiffness(space.nodes)
    with pytest.raises(ValueError, match=r"functional must have shape \(42, ...\), got \(5, 3\)"):
        dual_norm(M, space.nodes[:5])
    with pytest.raises(ValueError, match=r"functional\[3\] is nan"):
        dual_norm(superlu(M), np.where(np.arange(42) == 3, np.nan, 1.0))
    one_sided = M.copy()
    one_sided[0, 1] += 1.0
    with pytest.raises(ValueError, match="K must be symmetric, but is not"):
        dual_norm(one_sided, np.ones(42))


@pytest.mark.parametrize("kind", [np.float32, np.int8])
def test_dual_norm_takes_matrices_of_other_numbers(kind):
    assert dual_norm(csr_array(4 * np.eye(3, dtype=kind)), np.ones(3)) == pytest.approx(0.75**0.5)


@pytest.mark.parametrize("power", [-900, -570, 530, 1000])
def test_dual_norm_is_homogeneous_where_squares_are_out_of_range(power):
    space = space_of(0)
    K = sum(space.mass_stiffness(space.nodes))
    r = K @ space.nodes
    assert dual_norm(K, 2.0**power * r) == 2.0**power * dual_norm(K, r)


def test_dual_norm_refuses_a_matrix_that_vanishes_on_constants():
    A = space_of(0).mass_stiffness(space_of(0).nodes)[1]
    with pytest.raises(ValueError, match="K must be positive definite, but has the pivot"):
        dual_norm(A, np.ones(42))


def test_what_is_no_problem_no_space_and_no_field_is_named():
    space, x, u = space_of(0), space_of(0).nodes, space_of(0).nodes[:, 0]
    A, no_problem = space.mass_stiffness(x)[1], "problem must be a Problem, got None"
    of_another = ec.Problem(species={"w": ec.Species(1.0)}, law=ec.laws.Regularised())
    for call, message in (
        (lambda: regularised_law(None), no_problem),
        (lambda: constant_diffusivity(3), "problem must be a Problem, got 3"),
        (
            lambda: constant_diffusivity(of_another),
            "the species \"u\" alone .*'w'",
        ),
        (lambda: force_load(space, None, x, u, 0.0), no_problem),
        (lambda: temporal_terms_u(space, None, 1, 0.1, 2), no_problem),
        (lambda: temporal_terms_v(space, None, 1, 0.1, 0.2), no_problem),
        (lambda: temporal_terms_u(None, EXPANDING, 1, 0.1, 2), "space must be a SurfaceSpace"),
        (lambda: rate_of_mass(None, x, x, u, u), "space must be a SurfaceSpace"),
        (lambda: temporal_terms_v(space, EXPANDING, 200, 0.1, 0.2), "order must be .* 1 to 100"),
        (lambda: spatial_terms_u(space, EXPANDING, None, 0.5), "field must be a Field, got None"),
        (
            lambda: spatial_terms_u(space, EXPANDING, Field(lambda t: 1, 2, 3), 0.5),
            r"field\.v must be a function of points and a time, got 2",
        ),
        (lambda: diffusion(EXPANDING, A, np.ones(2)), r"u must have shape \(42, \.\.\.\), got"),
        (lambda: diffusion(EXPANDING, A.toarray(), u), "A must be a sparse matrix"),
    ):
        with pytest.raises((TypeError, ValueError), match=message):
            call()


def test_steps_and_problems_without_defects_are_refused():
    space = space_of(0)
    with pytest.raises(ValueError, match="n must be at least p = 3, got 2"):
        defects(space, EXPANDING, 3, 0.1, 2)
    with pytest.raises(ValueError, match=r"n must be an integer >= 0, got 2\.5"):
        defects(space, EXPANDING, 2, 0.1, 2.5)
    with pytest.raises(ValueError, match="step must be a finite number > 0, got 0"):
        defects(space, EXPANDING, 2, 0, 2)
    with pytest.raises(ValueError, match="n must be at least 2 p = 6, got 5"):
        temporal_terms_u(space, EXPANDING, 3, 0.1, 5)
    for function in (defects, temporal_terms_u, temporal_terms_v):
        with pytest.raises(ValueError, match="exact solution"):
            function(space, ec.Problem(u0=lambda x: x[:, 0]), 1, 0.1, 2)
    prescribed = ec.problems.oscillating_ellipsoid()
    for function in (temporal_terms_u, temporal_terms_v):
        with pytest.raises(ValueError, match=r"laws\.Regularised, but its motion is prescribed"):
            function(space, prescribed, 1, 0.1, 2)


@pytest.mark.parametrize(
    ("species", "message"),
    [
        ({"u": ec.Species(1.0, rate=3.0)}, r'a species "u" that .*, rate=3\.0'),
        ({"u": ec.Species(1.0, fixed=0.0)}, 'a species "u" that .*fixed=Fixed'),
        ({"u": ec.Species(1.0, conserved=False)}, 'a species "u" that .*got conserved=False'),
        ({"u": ec.Species(1.0), "w": ec.Species(1.0)}, "alone for the theory, got 'u', 'w'"),
        ({}, "alone for the theory, got none"),
    ],
)
def test_problems_with_terms_that_the_theory_lacks_are_refused(species, message):
    space, x = space_of(0), space_of(0).nodes
    exact = Exact(lambda p, t: p, lambda p, t: 0 * p, lambda x, t: x[:, 0])
    problem = ec.Problem(
        species=species, law=ec.laws.Regularised(), exact=exact if "u" in species else None
    )
    for call in (
        lambda: defects(space, problem, 1, 0.1, 1),
        lambda: spatial_defects(space, problem, 0.0),
        lambda: source_load(space, problem, x, x[:, 0], 0.0),
        lambda: response(space, problem, 1, 0.1, 0.3, lambda n: None),
    ):
        with pytest.raises((TypeError, ValueError), match=message):
            call()


def test_integers_of_any_library_are_steps():
    space = space_of(0)
    expected = defects(space, EXPANDING, 2, 0.1, 3)
    for part, same in zip(
        defects(space, EXPANDING, 2.0, np.float64(0.1), np.int64(3)), expected, strict=True
    ):
        np.testing.assert_array_equal(part, same)


def test_the_rate_of_mass_times_u_is_a_derivative():
    """For one and for two components of u."""
    space, t = space_of(1), 0.4
    one = triaxial()
    exact = one.exact._replace(
        u=lambda x, t: np.stack([one.exact.u(x, t), np.exp(t) * x[..., 2]], axis=-1)
    )
    for problem in (one, ec.Problem(u0=lambda x: exact.u(x, 0.0), exact=exact)):

        def mass_term(s, problem=problem):
            state = exact_state(space, problem, s)
            return space.mass_times(state.x, state.u)

        rate = rate_of_mass(space, *exact_values(space, problem, t), rate_of_u(space, problem, t))
        np.testing.assert_allclose(rate, derivative(mass_term, t), atol=1e-11)


def test_each_component_has_its_own_diffusivity():
    space = space_of(0, 1)
    _, A = space.mass_stiffness(space.nodes)
    u = space.nodes[:, :2]
    pair = ec.Species(lambda x: x[:, :2], diffusivity=[1.0, 3.0])
    problem = ec.Problem(species={"u": pair}, law=ec.laws.Regularised())
    np.testing.assert_array_equal(diffusion(problem, A, u), (A @ u) * [1.0, 3.0])


@pytest.mark.parametrize("components", [(), (2,)])
def test_a_source_is_loaded_with_the_values_it_returns(components):
    space, n = space_of(0), 42
    u = np.ones((n, *components))
    problem = ec.Problem(u0=u, f=lambda at: 3 * at.u, g=lambda at: 2 * np.ones(at.density.shape))
    M, _ = space.mass_stiffness(space.nodes)
    np.testing.assert_allclose(source_load(space, problem, space.nodes, u, 0.0), 3 * M @ u)
    load = force_load(space, problem, space.nodes, u, 0.0)
    np.testing.assert_allclose(
        load, space.load(space.nodes, 2 * space.normals(space.nodes)), atol=1e-15
    )
    nothing = ec.Problem(u0=u)
    assert source_load(space, nothing, space.nodes, u, 0.0).shape == u.shape
    assert force_load(space, nothing, space.nodes, u, 0.0).shape == (n, 3)


@pytest.mark.parametrize(
    ("returned", "error", "message"),
    [
        (
            lambda at: at.u[..., None],
            ValueError,
            r"g must return an array of shape \(80, 6\) or \(80, 6, 3\), got \(80, 6, 1\)",
        ),
        (
            lambda at: at.u[0],
            ValueError,
            r"g must return an array of shape \(80, 6\) or \(80, 6, 3\), got \(6,\)",
        ),
        (lambda at: at.u * 1j, TypeError, "what g returns must hold real numbers, got complex128"),
        (
            lambda at: at.u * np.nan,
            NotFiniteError,
            r"g returned nan in element 0 at \[-?\d\.\d+ +-?\d\.\d+ +-?\d\.\d+\]",
        ),
    ],
)
def test_sources_of_another_shape_or_not_finite_are_refused(returned, error, message):
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2)
    problem = ec.Problem(u0=lambda x: x[:, 0], g=returned)
    with pytest.raises(error, match=message):
        force_load(space, problem, space.nodes, space.nodes[:, 0], 0.0)


@pytest.mark.parametrize("other", [{"rate": 3.0}, {"conserved": False}, {"fixed": 1.0}])
def test_equations_that_the_papers_do_not_have_are_refused(other):
    """Their defects would silently be those of another equation."""
    species = {"u": replace(EXPANDING.species["u"], **other)}
    problem = ec.Problem(species=species, law=EXPANDING.law, exact=EXPANDING.exact)
    with pytest.raises(TypeError, match='species "u" that is conserved, without a rate'):
        defects(space_of(0), problem, 2, 0.1, 3)
    with pytest.raises(TypeError, match=next(iter(other))):
        spatial_defects(space_of(0), problem, 0.1)


def test_nodal_values_of_another_shape_are_refused():
    space = space_of(0)
    x, u = space.nodes, space.nodes[:, 0]
    with pytest.raises(ValueError, match=r"u must have shape \(42, \.\.\.\), got \(1,\)"):
        source_load(space, EXPANDING, x, u[:1], 0.0)
    with pytest.raises(ValueError, match=r"v must have shape \(42, 3\), got \(42,\)"):
        stretching(space, x, u, u)
    with pytest.raises(ValueError, match=r"rate must have shape \(42,\), got \(42, 3\)"):
        rate_of_mass(space, x, x, u, x)


def axis(t):
    return np.sqrt(1 + 0.25 * np.sin(t))


def field_of(problem):
    """What the spatial terms need to know of the oscillating ellipsoid."""
    return Field(
        surface=lambda t: Ellipsoid((axis(t), 1.0, 1.0)),
        v=lambda x, t: x * [np.cos(t) / (8 * axis(t) ** 2), 0, 0],
        f=lambda x, t: problem.species["u"].source(SimpleNamespace(points=x, t=t)),
    )


def test_the_spatial_terms_of_the_proof_add_up():
    problem = ec.problems.oscillating_ellipsoid("oscillation", "lifted")
    field = field_of(problem)
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere, exactness=10)
    *terms, spurious = spatial_terms_u(space, problem, field, 0.6).values()
    expected = spatial_defects(space, problem, 0.6).u
    assert np.abs(sum(terms) - expected).max() < 1e-7
    assert all(np.abs(r).max() > 2e-7 for r in [*terms, spurious])


def test_a_velocity_may_return_the_same_array_each_time():
    problem = ec.problems.oscillating_ellipsoid("oscillation", "lifted")
    space, field = space_of(0), field_of(problem)
    array = np.empty((len(space.cells), space.rule.weights.size, 3))

    def written(x, t):
        array[...] = field.v(x, t)
        return array

    expected = spatial_terms_u(space, problem, field, 0.6)
    found = spatial_terms_u(space, problem, field._replace(v=written), 0.6)
    for name, term in expected.items():
        np.testing.assert_array_equal(found[name], term)


def test_times_of_more_digits_give_the_same_terms():
    problem = ec.problems.oscillating_ellipsoid("oscillation", "lifted")
    space, field, time = space_of(0), field_of(problem), np.longdouble(0.6)
    spatial = spatial_terms_u(space, problem, field, time)
    for name, term in spatial_terms_u(space, problem, field, float(time)).items():
        np.testing.assert_array_equal(spatial[name], term)
    temporal = temporal_terms_v(space, EXPANDING, 2, 0.1, time)
    for name, term in temporal_terms_v(space, EXPANDING, 2, 0.1, float(time)).items():
        np.testing.assert_array_equal(temporal[name], term)


def test_functions_may_write_into_the_points_that_they_are_given():
    def spoilt(function):
        def writing(x, t):
            returned = np.array(function(x, t))
            x *= 2
            return returned

        return writing

    problem = ec.problems.oscillating_ellipsoid("oscillation", "lifted")
    space, field = space_of(0), field_of(problem)
    expected = spatial_terms_u(space, problem, field, 0.6)
    writing = field._replace(v=spoilt(field.v), f=spoilt(field.f))
    for name, term in spatial_terms_u(space, problem, writing, 0.6).items():
        np.testing.assert_array_equal(expected[name], term)


def test_the_term_of_the_test_function_is_an_integral_over_the_slip_of_lifted_particles():
    """On a growing sphere they move with v = x/R; with v + w as the velocity the slip is -w."""
    omega, c, R = np.array([1.0, 2.0, 2.0]), np.array([1.0, -1.0, 3.0]), 1.3
    exact = Exact(lambda p, t: p * (1 + t), lambda p, t: p, lambda x, t: x @ c)
    field = Field(
        surface=lambda t: Ellipsoid((1 + t,) * 3),
        v=lambda x, t: x / (1 + t) + np.cross(omega, x),
        f=lambda x, t: x[..., 0],
    )
    space, problem = space_of(0, 4), ec.Problem(u0=lambda x: x @ c, exact=exact)
    term = spatial_terms_u(space, problem, field, R - 1)["(6.4), test function"]
    # With u = c . x and the coordinates as test functions, of which the gradients are the axes:
    expected = -4 * np.pi / 3 * R**4 * np.cross(omega, c)  # the integral of -u w over the sphere
    np.testing.assert_allclose(term @ (R * space.nodes), expected, rtol=1e-3)


def test_fields_of_another_shape_are_refused():
    problem = ec.problems.oscillating_ellipsoid("oscillation", "lifted")
    space, field = space_of(0), field_of(problem)
    with pytest.raises(ValueError, match=r"field\.v\(x, t\) must have shape \(20, 6, 3\)"):
        spatial_terms_u(space, problem, field._replace(v=lambda x, t: x[..., 0]), 0.6)
    with pytest.raises(ValueError, match=r"field\.f\(x, t\) must have shape \(20, 6\)"):
        spatial_terms_u(space, problem, field._replace(f=lambda x, t: x), 0.6)
    two = ec.Problem(u0=space.nodes, exact=problem.exact._replace(u=lambda x, t: x[..., :2]))
    with pytest.raises(ValueError, match=r"the exact u must have shape \(42,\), got \(42, 2\)"):
        spatial_terms_u(space, two, field, 0.6)


@pytest.mark.parametrize("degree", [1, 2])  # of which the first has three quadrature points
def test_an_exact_u_is_called_with_points_as_documented(degree):
    problem = ec.problems.oscillating_ellipsoid("oscillation", "lifted")
    space, field, u = space_of(0, degree), field_of(problem), problem.exact.u

    held = {}

    def of_points(x, t):
        """The same array each time, and x spoilt."""
        values = held.setdefault(len(x), np.empty(len(x)))
        values[:] = u(np.stack([x[:, 0], x[:, 1], x[:, 2]], axis=1), t)
        x *= 2
        return values

    expected = spatial_terms_u(space, problem, field, 0.6)
    other = replace(problem, exact=problem.exact._replace(u=of_points))
    for name, term in spatial_terms_u(space, other, field, 0.6).items():
        np.testing.assert_array_equal(expected[name], term)


def test_an_exact_u_of_another_shape_or_not_finite_away_from_the_nodes_is_refused():
    problem = ec.problems.oscillating_ellipsoid("oscillation", "lifted")
    space, field, u = space_of(0), field_of(problem), problem.exact.u
    for bad, message in (
        (lambda x, t: u(x, t)[:42], r"exact\.u\(x, t\) must have shape \(120,\), got \(42,\)"),
        (lambda x, t: u(x, t) / (len(x) == 42), r"exact\.u\(x, t\) must be finite"),
    ):
        other = replace(problem, exact=problem.exact._replace(u=bad))
        with np.errstate(all="ignore"), pytest.raises(ValueError, match=message):
            spatial_terms_u(space, other, field, 0.6)


@pytest.mark.parametrize(
    "of",
    [
        lambda space: defects(space, EXPANDING, 2, 0.05, 5),
        lambda space: spatial_defects(space, EXPANDING, 0.5),
        lambda space: temporal_terms_v(space, EXPANDING, 2, 0.05, 0.5),
        lambda space: temporal_terms_u(space, EXPANDING, 2, 0.05, 10),
        lambda space: spatial_terms_u(space, EXPANDING, field_of(EXPANDING), 0.5),
    ],
)
def test_defects_of_an_exact_solution_of_another_surface_are_refused(of):
    """The exact nodes of a torus on which a sphere moves are no nodes of the sphere."""
    torus = ec.SurfaceSpace(ec.torus(1, 0.4, 12, 6))
    with pytest.raises(ValueError, match="exact must belong to this surface, but the node"):
        of(torus)


def test_defects_of_a_motion_that_begins_later_are_its_defects_at_later_times():
    """Its nodes are elsewhere at t = 0, but on the exact surface."""

    def later(name):
        return lambda x, t: getattr(EXPANDING.exact, name)(x, t + 0.5)

    begun = ec.Exact(**{name: later(name) for name in ("x", "v", "u", "closest")})
    found, expected = (
        defects(space_of(), ec.Problem(u0=1.0, exact=exact), 2, 0.05, n)
        for exact, n in ((begun, 5), (EXPANDING.exact, 15))
    )
    assert found.v == pytest.approx(expected.v, abs=1e-12)


def test_a_matrix_without_unknowns_has_no_dual_norm():
    with pytest.raises(ValueError, match="K must have at least one unknown"):
        ec.defects.dual_norm(csr_array((0, 0)), np.zeros(0))
