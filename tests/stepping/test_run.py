"""The time schemes: what they satisfy exactly, what they refuse, how they stop."""

import dataclasses
import sys
import weakref
from fractions import Fraction
from itertools import islice
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

import esfem_core as ec
from esfem_core.solvers import superlu
from esfem_core.study import final

SPACE = ec.SurfaceSpace(ec.sphere("octahedron", 2), 2, ec.to_unit_sphere)


def wobble(u0=lambda x: 1 + x[:, 0] * x[:, 1], **options):
    """A coupled problem without symmetry and without an exact solution."""
    return ec.Problem(
        u0=u0, g=lambda at: 1 + at.u + at.points[..., 2] * np.cos(3 * at.t), **options
    )


def residuals(space, problem, states, p):
    """Plug a run into (2.19)-(2.21) written out as printed, and return relative residuals."""
    tau = states[1].t - states[0].t
    d, c = ec.bdf.delta(p), ec.bdf.gamma(p)
    n = len(states) - 1

    def extrapolated(name, m):
        if m < p:  # the starting levels
            return getattr(states[m], name)
        return sum(c[j] * getattr(states[m - 1 - j], name) for j in range(p))

    x, u = extrapolated("x", n), extrapolated("u", n)
    M, A = space.mass_stiffness(x)
    K = M + problem.law.alpha * A
    t = states[n].t
    masses = [space.mass_stiffness(extrapolated("x", n - j))[0] for j in range(p + 1)]
    change = sum(d[j] * masses[j] @ states[n - j].u for j in range(p + 1)) / tau
    at = ec.Surface(space, x, u, t)
    f = space.load(x, problem.species["u"].source(at)) if problem.species["u"].source else 0.0
    g = space.load(x, problem.law.g(at)[..., None] * space.normals(x))
    for terms in (
        (change, A @ states[n].u, -f),
        (K @ states[n].v, problem.law.beta * A @ states[n].x, -g),
        (sum(d[j] * states[n - j].x for j in range(p + 1)) / tau, -states[n].v),
    ):
        yield np.abs(sum(terms)).max() / max(np.abs(term).max() for term in terms)


@pytest.mark.parametrize("p", [1, 2, 3, 4, 5])
def test_every_step_solves_the_printed_equations(p):
    problem = wobble(f=lambda at: np.sin(at.u) + at.grad_u[..., 0] * at.t, alpha=0.7, beta=0.3)
    end = 0.02 * (2 * p + 2)
    run = ec.evolve(SPACE, problem, p, 0.02, end, mass="extrapolated", solver="direct")
    states = list(run)
    for n in (p, 2 * p + 2):
        assert max(residuals(SPACE, problem, states[: n + 1], p)) < 1e-11


def test_perturbations_are_right_hand_sides_of_the_printed_equations():
    """Translations and constants solve them, so r_v is M v, and r_u M times the rate of u."""
    M, _ = SPACE.mass_stiffness(SPACE.nodes)
    v, r_x, rate = np.array([1.0, -2.0, 0.5]), np.array([0.25, 0.0, 1.0]), 3.0
    ones = np.ones((len(SPACE.nodes), 1))
    perturbation = (rate * M @ ones[:, 0], M @ ones * v, ones * r_x)
    options = {"solver": "direct", "perturbation": lambda n: perturbation}
    *_, state = ec.evolve(SPACE, ec.Problem(1.0, alpha=0.7, beta=0.0), 1, 0.1, 0.2, **options)
    np.testing.assert_allclose(state.v, ones * v, rtol=1e-12)
    np.testing.assert_allclose(state.x, SPACE.nodes + 0.2 * (v + r_x), atol=1e-13)
    np.testing.assert_allclose(state.u, 1 + 0.2 * rate, rtol=1e-12)


@pytest.mark.parametrize(
    ("law", "advice"),
    [
        (ec.laws.MeanCurvature(), "MeanCurvature solves none; perturb 'normal' or 'H'"),
        (ec.laws.VolumePreserving(ec.laws.MeanCurvature()), "MeanCurvature solves none"),
        (ec.laws.Dynamic(), "Dynamic solves none; perturb 'velocity'"),
        (
            ec.laws.with_slip(ec.laws.Prescribed(velocity=lambda x, t: x), lambda at: 0 * at.x),
            "Prescribed solves none; perturb 'x'",
        ),
    ],
)
def test_a_perturbation_of_a_velocity_that_no_system_is_solved_for_is_refused(law, advice):
    """Unless it is zero, as in (r_u, 0, r_x)."""
    problem = ec.Problem(species={"u": ec.Species(1.0)}, law=law)
    first, second = ec.evolve(SPACE, problem, 1, 0.01, 0.01, perturbation=lambda n: (10, 0, 0))
    assert (second.u > first.u).all()
    with pytest.raises(ValueError, match=f"solves for the velocity, but {advice}"):
        list(ec.evolve(SPACE, problem, 1, 0.01, 0.01, perturbation=lambda n: {"v": 0.1}))


def test_a_perturbation_of_a_velocity_that_is_solved_for_column_by_column_is_refused():
    def velocity(at, fields, tau, past, solve):
        K = at.matrix(1.0, 1.0)
        return np.column_stack([solve(K, b) for b in (at.M @ at.x).T])

    problem = ec.Problem(1.0, law=SimpleNamespace(velocity=velocity))
    *_, state = ec.evolve(SPACE, problem, 1, 0.01, 0.01)
    assert np.isfinite(state.v).all()
    with pytest.raises(ValueError, match=r"of shape \(258,\).*with b of shape \(258, 3\)"):
        list(ec.evolve(SPACE, problem, 1, 0.01, 0.01, perturbation=lambda n: {"v": 0.1}))


@pytest.mark.parametrize("number", [np.float32(0.25), np.array(0.25), Fraction(1, 4)])
def test_a_constant_perturbation_is_a_number_of_any_library(number):
    def last(constant):
        return final(ec.evolve(SPACE, wobble(), 1, 0.1, 0.2, perturbation=lambda n: [constant] * 3))

    for name in ("x", "u"):
        np.testing.assert_array_equal(getattr(last(number), name), getattr(last(0.25), name))


@pytest.mark.parametrize("p", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("solver", ["lagged", "direct"])
def test_amounts_are_kept_without_sources_starting_states_included(p, solver):
    """1' M(x^n) u^n with updated mass matrices, 1' M(x~^n) u^n with extrapolated ones."""
    gamma = ec.bdf.gamma(p)
    for mass in ("updated", "extrapolated"):
        run = ec.evolve(SPACE, wobble(), p, 0.02, 0.4, mass=mass, start="euler", solver=solver)
        states = list(run)
        for n, state in enumerate(states):
            x = state.x
            if mass == "extrapolated" and n >= p:
                x = sum(gamma[j] * states[n - 1 - j].x for j in range(p))
            amount = SPACE.mass(x).sum(axis=0) @ state.u
            first = SPACE.mass(states[0].x).sum(axis=0) @ states[0].u
            assert amount == pytest.approx(first, rel=1e-13)


@pytest.mark.parametrize("p", [1, 2, 3, 4, 5])
def test_solvers_agree(p):
    direct, lagged, cholmod = (
        final(ec.evolve(SPACE, wobble(), p, 0.02, 0.4, solver=s))
        for s in ("direct", "lagged", "cholmod")
    )
    for name in "xvu":
        np.testing.assert_allclose(getattr(lagged, name), getattr(direct, name), atol=1e-8)
        np.testing.assert_allclose(getattr(cholmod, name), getattr(direct, name), atol=1e-8)


@pytest.mark.parametrize("coefficients", [{"alpha": 5e7}, {"diffusivity": 1e9}, {"alpha": 1e-8}])
def test_solvers_agree_for_extreme_coefficients(coefficients):
    direct, lagged = (
        final(ec.evolve(SPACE, wobble(**coefficients), 2, 0.02, 0.2, solver=s))
        for s in ("direct", "lagged")
    )
    for name in "xvu":
        np.testing.assert_allclose(getattr(lagged, name), getattr(direct, name), atol=1e-7)


def test_a_solver_of_ones_own():
    made = []

    def make():
        made.append(ec.LaggedSolver(rtol=1e-6, price=7, factorise=superlu))
        return made[-1]

    own = final(ec.evolve(SPACE, wobble(), 2, 0.02, 0.4, solver=make))
    direct = final(ec.evolve(SPACE, wobble(), 2, 0.02, 0.4, solver="direct"))
    assert sum(solver.iterations for solver in made) > 20
    for name in "xvu":
        difference = abs(getattr(own, name) - getattr(direct, name)).max()
        assert 1e-11 < difference < 1e-4


def test_several_components_are_solved_like_single_ones():
    """Two components with different diffusivities, each as if alone (g depends on the first)."""

    def u0(x):
        return np.column_stack([1 + x[:, 0], x[:, 1] * x[:, 2], x[:, 2]])

    def problem(columns, diffusivity):
        return ec.Problem(
            u0=lambda x: u0(x)[:, columns],
            f=lambda at: -2 * at.u,
            g=lambda at: 1 + 0 * at.density,
            diffusivity=diffusivity,
        )

    several = final(ec.evolve(SPACE, problem([0, 1, 2], np.array([1.0, 0.1, 1.0])), 2, 0.05, 0.5))
    for column, D in enumerate([1.0, 0.1, 1.0]):
        alone = final(ec.evolve(SPACE, problem(column, D), 2, 0.05, 0.5))
        np.testing.assert_allclose(several.u[:, column], alone.u, atol=1e-9)


@pytest.mark.parametrize("p", [1, 2, 3, 4, 5, 6])
@pytest.mark.filterwarnings("ignore:BDF6")
def test_prescribed_motion_solves_the_printed_equation(p):
    """[LMV] (3.1) on exact nodes."""

    def motion(q, t):
        return q * [1 + 0.3 * np.sin(t), 1, np.exp(-t)]

    problem = ec.Problem(u0=lambda x: x[:, 0], f=lambda at: at.points[..., 0] * at.t, motion=motion)
    tau = 0.05
    states = list(ec.evolve(SPACE, problem, p, tau, tau * (p + 3), solver="direct"))
    d, last = ec.bdf.delta(p), states[-1]
    np.testing.assert_array_equal(last.x, motion(SPACE.nodes, last.t))
    _, A = SPACE.mass_stiffness(last.x)
    change = sum(
        d[j] * SPACE.mass_stiffness(states[-1 - j].x)[0] @ states[-1 - j].u for j in range(p + 1)
    )
    f = SPACE.load(last.x, SPACE.quadrature_points(last.x)[..., 0] * last.t)
    assert abs(change / tau + A @ last.u - f).max() < 1e-12 * abs(change / tau).max() * 10


def test_times_and_starting_states():
    problem = ec.problems.growing_sphere()
    states = list(ec.evolve(SPACE, problem, 4, 0.1, 1.0))
    assert [s.t for s in states] == [n / 10 for n in range(11)]
    assert [s.v is None for s in states] == [True] * 4 + [False] * 7
    for s in states[:4]:
        np.testing.assert_array_equal(s.x, problem.exact.x(SPACE.nodes, s.t))
        np.testing.assert_array_equal(s.u, problem.exact.u(s.x, s.t))
    assert len(list(ec.evolve(SPACE, problem, 4, 0.1, 0.3))) == 4


def test_exact_starting_values_have_the_shape_of_the_initial_ones():
    exact = ec.Exact(lambda p, t: p, lambda p, t: 0 * p, fields={"w": lambda x, t: x})
    problem = ec.Problem(species={"w": ec.Species(1.0)}, motion=lambda p, t: p, exact=exact)
    n = len(SPACE.nodes)
    message = rf"exact.w must have the shape \({n},\) of the initial values of 'w', got \({n}, 3\)"
    with pytest.raises(ValueError, match=message):
        ec.evolve(SPACE, problem, 2, 0.1, 0.5)
    next(ec.evolve(SPACE, problem, 2, 0.1, 0.5, start="euler"))


def test_exact_starting_values_are_the_initial_ones():
    """Those of ``Species(initial)`` would otherwise be dropped in silence."""
    known = ec.problems.expanding_sphere()
    species = {"u": ec.Species(5.0, known.species["u"].source)}
    problem = ec.Problem(species=species, law=known.law, exact=known.exact)
    with pytest.raises(ValueError, match=r'exact.u must have the initial values .*start="euler"'):
        ec.evolve(SPACE, problem, 2, 0.1, 0.5)
    first = next(iter(ec.evolve(SPACE, problem, 2, 0.1, 0.5, start="euler")))
    np.testing.assert_array_equal(first.u, 5.0)


def test_the_functions_of_another_law_can_be_made_from_a_state():
    last = final(ec.evolve(SPACE, ec.Problem(1.0), 1, 0.1, 0.1))
    flow = ec.Problem(1.0, law=ec.laws.MeanCurvature())
    with pytest.raises(
        ValueError, match=r"'normal', .*started_anew\(state, problem, order, step\)"
    ):
        ec.evolve(SPACE, flow, 1, 0.1, 0.2, start=[last])
    start = ec.started_anew(last, flow, 1, 0.1)
    assert final(ec.evolve(SPACE, flow, 1, 0.1, 0.2, start=start)).t == 0.2


@pytest.mark.parametrize("p", [2, 3, 4, 5])
def test_euler_start_has_order_p(p):
    """Against many small steps on the same mesh, since the spatial error would hide it.

    The nodal interpolant of u0 is not quite smooth for the discrete Laplacian, and its stiff part
    costs u a fraction of an order.
    """
    steps, errors = [0.05, 0.025], []
    for step in steps:
        end = (p - 1) * step
        start = final(ec.evolve(SPACE, wobble(), p, step, end, start="euler", solver="direct"))
        fine = ec.evolve(SPACE, wobble(), 5, step / 64, end, start="euler", solver="direct")
        errors.append(ec.errors.difference(SPACE, start, final(fine)))
    for name in ("x_l2", "u_l2"):
        values = [getattr(error, name) for error in errors]
        assert ec.study.observed_orders(steps, values)[0] > p - 0.6


def test_yielded_arrays_are_never_written_to():
    kept = []
    for state in ec.evolve(SPACE, wobble(), 3, 0.05, 0.5):
        kept.append((state, [a if a is None else a.copy() for a in (state.x, state.v, state.u)]))
    for state, copies in kept:
        for array, copy in zip((state.x, state.v, state.u), copies, strict=True):
            np.testing.assert_array_equal(array, copy)
    assert len({id(state.x) for state, _ in kept}) == len(kept)


def test_starting_from_given_states_goes_on_where_they_end():
    problem = wobble()
    states = list(ec.evolve(SPACE, problem, 2, 0.05, 0.5))
    again = list(ec.evolve(SPACE, problem, 2, 0.05, 0.5, start=states[:2]))
    np.testing.assert_allclose(again[-1].u, states[-1].u, atol=1e-13)


def test_starting_later():
    """Steps are numbered on from the last starting state; a motion in time needs the right t."""
    problem = ec.problems.baseball_bat()
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    states = list(ec.evolve(space, problem, 3, 0.1, 1.0, solver="direct"))
    again = list(ec.evolve(space, problem, 3, 0.1, 1.0, start=states[4:7], solver="direct"))
    assert [s.t for s in again] == [s.t for s in states[4:]]
    np.testing.assert_array_equal(again[-1].x, states[-1].x)
    np.testing.assert_allclose(again[-1].u, states[-1].u, atol=1e-15)


def test_starting_states_must_be_a_step_apart():
    states = list(ec.evolve(SPACE, wobble(), 2, 0.05, 0.5))
    for start, end in [(states[2:4], 1.0), (states[0:6:5], 0.5), (states[7:9], 0.35)]:
        with pytest.raises(
            ValueError, match=r"start must hold states that are a step of|end must not be before"
        ):
            ec.evolve(SPACE, wobble(), 2, 0.05 if end < 0.5 else 0.1, end, start=start)


@pytest.mark.parametrize("step", [1.0, 0.1, 1e-3])
@pytest.mark.parametrize("t", [0.0, 1.7e9, -1.7e9])
def test_starting_states_are_a_step_apart_however_late_they_are(t, step):
    at = [ec.State(t + j * step, SPACE.nodes, None, SPACE.nodes[:, 0]) for j in range(5)]
    problem = ec.Problem(1.0, law=ec.laws.Prescribed(velocity=lambda x, t: 0 * x))
    for order in (2, 5):
        ec.evolve(SPACE, problem, order, step, t + 9 * step, start=at)
    for start in (at[2:5:2], [at[3], dataclasses.replace(at[4], t=t + 4.01 * step)]):
        with pytest.raises(ValueError, match="start must hold states that are a step of"):
            ec.evolve(SPACE, problem, 2, step, t + 20 * step, start=start)


REFUSED = [
    ({"order": 0}, "order must be an integer from 1 to 100, got 0"),
    ({"order": 7}, "BDF7 is not zero-stable.*allow_unstable=True"),
    ({"step": 0.0}, "step must be a finite number > 0, got 0.0"),
    ({"step": np.nan}, "step must be a finite number > 0, got nan"),
    ({"end": -1.0}, "end must not be before the start at t = 0.0, got -1.0"),
    ({"end": 0.95}, r"end/step must be an integer, got 0\.95/0\.1"),
    (
        {"order": 5, "end": 0.3},
        r"end must be at least \(p - 1\) step = 0\.4 for order p = 5, got 0\.3",
    ),
    ({"mass": "lumped"}, 'mass must be "updated", "extrapolated" or "reassembled", got'),
    ({"start": "cold"}, 'start must be "exact", "euler" or a sequence of states'),
    ({"start": "exact"}, 'start="exact" needs a problem with an exact solution'),
    ({"start": []}, "start must hold p = 2 states or more, got 0; .*started_anew"),
    (
        {"solver": "gmres"},
        'solver must be "lagged", "cholmod", "direct" or a function that makes one',
    ),
]


@pytest.mark.parametrize(("change", "message"), REFUSED)
def test_refused_at_the_call(change, message):
    arguments = {"order": 2, "step": 0.1, "end": 1.0} | change
    with pytest.raises(ValueError, match=message):
        ec.evolve(SPACE, wobble(), **arguments)


WRONG_TYPES = [
    ({"order": "2"}, "order must be an integer from 1 to 100, got '2'"),
    ({"order": True}, "order must be an integer from 1 to 100, got True"),
    ({"step": None}, "step must be a finite number > 0, got None"),
    ({"start": 3}, 'start must be "exact", "euler" or a sequence of states, got 3'),
    ({"start": [1, 2]}, r"start\[0\] must be a State, got 1"),
    ({"space": ec.sphere("octahedron", 1)}, "space must be a SurfaceSpace, got <trimesh"),
    ({"problem": lambda x: x}, "problem must be a Problem, got <function"),
]


@pytest.mark.parametrize(("change", "message"), WRONG_TYPES)
def test_wrong_types_are_refused_at_the_call(change, message):
    arguments = {"space": SPACE, "problem": wobble(), "order": 2, "step": 0.1, "end": 1.0}
    with pytest.raises(TypeError, match=message):
        ec.evolve(**(arguments | change))


@pytest.mark.parametrize("order", [2.0, np.int64(2), np.float32(2), np.arange(3)[2], np.array(2)])
def test_integers_of_any_library_are_orders(order):
    whole = final(ec.evolve(SPACE, wobble(), 2, 0.1, 0.3, solver="direct"))
    other = final(ec.evolve(SPACE, wobble(), order, np.float64(0.1), 0.3, solver="direct"))
    np.testing.assert_array_equal(other.u, whole.u)


def test_mass_matrices_are_updated_unless_one_says_otherwise():
    default, *others = (
        final(ec.evolve(SPACE, wobble(), 3, 0.05, 0.5, solver="direct", **options))
        for options in ({}, {"mass": "updated"}, {"mass": "extrapolated"})
    )
    np.testing.assert_array_equal(default.u, others[0].u)
    assert abs(default.u - others[1].u).max() > 1e-6


def test_a_motion_that_starts_elsewhere_is_refused_at_the_call():
    message = (
        r"motion must start on the surface, X\(p, 0\) = p, but X\(p, 0\) = \[.*\] for the node "
        r"p = \[.*\]; a velocity goes into laws\.Prescribed\(velocity=v\)"
    )
    with pytest.raises(ValueError, match=message):
        ec.evolve(SPACE, ec.Problem(1.0, motion=lambda p, t: 1.001 * p), 1, 0.1, 0.1)
    with pytest.raises(ValueError, match="motion must start on the surface"):
        ec.evolve(SPACE, ec.Problem(1.0, motion=lambda p, t: 0 * p), 1, 0.1, 0.1)
    with pytest.raises(
        ValueError, match=r"motion\(p, t\) must have shape \(258, 3\), got \(258,\)"
    ):
        ec.evolve(SPACE, ec.Problem(1.0, motion=lambda p, t: p[:, 0]), 1, 0.1, 0.1)


def test_mean_curvature_without_regularisation_warns_for_curved_elements_only():
    with pytest.warns(ec.EvolutionWarning, match="elements of degree 2 lose two orders") as caught:
        ec.evolve(SPACE, ec.Problem(alpha=0), 1, 0.1, 0.1)
    assert caught[0].filename == __file__
    ec.evolve(SPACE, ec.Problem(alpha=0, beta=0), 1, 0.1, 0.1)
    ec.evolve(ec.SurfaceSpace(ec.sphere("octahedron", 1)), ec.Problem(alpha=0), 1, 0.1, 0.1)


@pytest.mark.parametrize("p", [1, 3])
@pytest.mark.parametrize("conserved", [True, False])
def test_what_does_not_diffuse_is_diluted_or_carried(p, conserved):
    """On a surface that is blown up by 1 + t: u0/(1 + t)^2 at every node, or u0."""
    rough = np.random.default_rng(0).standard_normal(len(SPACE.nodes))
    species = {"u": ec.Species(rough, diffusivity=0, conserved=conserved)}
    problem = ec.Problem(species=species, law=ec.laws.Prescribed(lambda p, t: (1 + t) * p))
    for state in ec.evolve(SPACE, problem, p, 0.1, 1.0):
        expected = rough / (1 + state.t) ** 2 if conserved else rough
        np.testing.assert_allclose(state.u, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("mass", ["updated", "extrapolated", "reassembled"])
@pytest.mark.parametrize("p", [1, 3])
def test_what_is_carried_and_does_not_diffuse_stays_where_it_is_on_any_surface(p, mass):
    rough = np.random.default_rng(0).standard_normal(len(SPACE.nodes))
    carried = ec.Species(rough, diffusivity=0, conserved=False)
    law = ec.laws.Regularised(g=lambda at: 5 + at["c"])
    *_, last = ec.evolve(
        SPACE, ec.Problem(species={"c": carried}, law=law), p, 0.05, 0.5, mass=mass
    )
    assert np.linalg.norm(last.x, axis=1).min() > 1.05
    np.testing.assert_allclose(last["c"], rough, rtol=0, atol=1e-9)


def test_a_surface_alone_moves_as_if_something_were_on_it():
    def g(at):
        return 1 + at.points[..., 2] + at.t

    alone, together = (
        final(ec.evolve(SPACE, ec.Problem(u0, g=g), 3, 0.05, 0.5, solver="direct"))
        for u0 in (None, 1)
    )
    assert list(alone.fields) == []
    assert list(together.fields) == ["u"]
    np.testing.assert_array_equal(alone.x, together.x)
    np.testing.assert_array_equal(alone.v, together.v)
    with pytest.raises(KeyError, match="there is no function 'u' on this surface, only none"):
        final(ec.evolve(SPACE, ec.Problem(g=lambda at: at.u), 1, 0.1, 0.1))


def test_speeds_along_the_normal_are_numbers_values_or_vectors():
    def run(g):
        return final(ec.evolve(SPACE, ec.Problem(g=g), 2, 0.05, 0.3, solver="direct"))

    values = run(lambda at: np.full(at.density.shape, 1.5))
    np.testing.assert_array_equal(run(lambda at: 1.5).x, values.x)
    np.testing.assert_array_equal(run(lambda at: 1.5 * at.normal).x, values.x)
    sideways = run(lambda at: 1.5 * at.normal + [0, 0, 0.5])  # a translation, and nothing else
    np.testing.assert_allclose(sideways.x - values.x, np.tile([0, 0, 0.15], (258, 1)), atol=1e-10)


def test_initial_values_of_one_number():
    number, values = (
        final(ec.evolve(SPACE, wobble(u0=u0), 2, 0.05, 0.3, solver="direct"))
        for u0 in (2, np.full(258, 2.0))
    )
    np.testing.assert_array_equal(number.u, values.u)


def test_six_warns_and_seven_runs_if_asked():
    with pytest.warns(UserWarning, match="BDF6 has no multiplier"):
        states = ec.evolve(SPACE, wobble(), 6, 0.05, 0.5)
    assert np.isfinite(final(states).u).all()
    assert len(list(islice(ec.evolve(SPACE, wobble(), 7, 0.05, 0.5, allow_unstable=True), 9))) == 9


def collect_until_error(states):
    collected = []
    with pytest.raises(ec.EvolutionError) as error:
        collected.extend(states)  # keeps what came before the error
    for state in collected:
        assert np.isfinite(state.x).all()
        assert np.isfinite(state.u).all()
    return collected, error.value


def test_not_a_number_from_f_stops_with_the_place():
    def f(at):
        return np.where((at.t > 0.27) & (at.points[..., 0] > 0.9), np.nan, at.u)

    collected, error = collect_until_error(ec.evolve(SPACE, wobble(f=f), 2, 0.05, 1.0))
    assert (error.step, len(collected)) == (6, 6)
    assert error.t == pytest.approx(0.3)
    assert "step 6, t = 0.3: the source f of 'u' returned nan in element" in str(error)
    x = SPACE.quadrature_points(collected[-1].x)[error.element]
    assert x[:, 0].max() > 0.8


def test_infinity_from_g_stops():
    problem = ec.Problem(lambda x: x[:, 0], g=lambda at: at.u / np.maximum(0.5 - at.t, 0))
    with np.errstate(divide="ignore", invalid="ignore"):
        _, error = collect_until_error(ec.evolve(SPACE, problem, 1, 0.1, 1.0))
    assert "g returned" in str(error)
    assert error.element is not None


@pytest.mark.filterwarnings("ignore::esfem_core.EvolutionWarning")
def test_overflow_stops():
    problem = ec.Problem(u0=lambda x: 1 + 0 * x[:, 0], f=lambda at: 1e3 * at.u**3)
    with np.errstate(over="ignore", invalid="ignore"):
        collected, error = collect_until_error(ec.evolve(SPACE, problem, 2, 0.1, 10.0))
    assert 2 <= error.step == len(collected)


@pytest.mark.filterwarnings("ignore::esfem_core.EvolutionWarning")
def test_a_sphere_that_shrinks_through_its_center_stops():
    """G < 0 drives the surface through a point: elements turn over without losing their area."""
    problem = ec.Problem(u0=lambda x: x[:, 0], g=lambda at: -8.0 + 0 * at.u, alpha=0, beta=0)
    collected, error = collect_until_error(ec.evolve(SPACE, problem, 2, 0.05, 5.0))
    assert error.element is not None
    assert len(collected) == 3  # radii 1, 0.6, 0.2; the next one is negative
    assert np.linalg.norm(collected[-1].x, axis=1).min() > 0


def test_a_motion_that_flattens_the_surface_to_a_line_stops():
    def motion(q, t):
        return q * [1, max(1 - 2 * t, 0), max(1 - 2 * t, 0)]

    problem = ec.Problem(u0=lambda x: x[:, 0], motion=motion)
    collected, error = collect_until_error(ec.evolve(SPACE, problem, 2, 0.1, 1.0))
    assert (error.step, len(collected)) == (5, 5)
    assert "is degenerate" in str(error)


@pytest.mark.parametrize("start", ["euler", "states"])
def test_a_run_does_not_keep_its_starting_states(start):
    if start == "states":
        start = list(ec.evolve(SPACE, wobble(), 3, 0.02, 0.04))
    run = ec.evolve(SPACE, wobble(), 3, 0.02, 0.2, start=start)
    first = weakref.ref(next(run))
    del start
    for _ in islice(run, 6):
        pass
    assert first() is None


def test_functions_of_the_wrong_shape_are_explained():
    message = r"source f of 'u' must return an array of shape \(128, 6\), got \(128, 6, 3\)"
    with pytest.raises(ValueError, match=message):
        final(ec.evolve(SPACE, wobble(f=lambda at: at.grad_u), 1, 0.1, 0.5))


def test_a_solver_that_is_not_installed_is_missed_at_the_call(monkeypatch):
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), 1)
    monkeypatch.setitem(sys.modules, "cholespy", None)
    with pytest.raises(ImportError, match=r'cholespy: pip install "esfem-core\[fast\]"$'):
        ec.evolve(space, ec.problems.growing_sphere(), 1, 0.1, 0.1, solver="cholmod")


@pytest.mark.parametrize(
    "wrapped",
    [
        lambda law: law,
        ec.laws.VolumePreserving,
        lambda law: ec.laws.with_slip(law, lambda at: 0 * at.x),
    ],
    ids=["alone", "at constant volume", "with slip"],
)
def test_alpha_zero_is_warned_of_at_the_call_and_inside_other_laws(wrapped):
    problem = ec.Problem(law=wrapped(ec.laws.Regularised(alpha=0.0, beta=1.0)))
    linear = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    with pytest.warns(ec.EvolutionWarning, match="elements of degree 2 lose two orders") as caught:
        ec.evolve(SPACE, problem, 2, 0.01, 0.1)
    assert caught[0].filename == __file__
    with pytest.warns(ec.EvolutionWarning, match="unstable for p = 4.*take p <= 3 or alpha > 0"):
        ec.evolve(linear, problem, 4, 0.01, 0.1)
    ec.evolve(linear, problem, 3, 0.01, 0.1)
    ec.evolve(linear, ec.Problem(alpha=0.0, beta=0.0), 5, 0.01, 0.1)


def test_a_slip_with_a_normal_part_is_warned_of_once():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    law = ec.laws.with_slip(ec.laws.Regularised(), lambda at: 0.1 * at.x)
    with pytest.warns(ec.EvolutionWarning, match="the slip w must be tangential") as warned:
        list(ec.evolve(space, ec.Problem(law=law), 1, 0.01, 0.03))
    assert len(warned) == 1


def test_a_slip_that_is_normal_on_a_small_component_only_is_warned_of_with_its_number(recwarn):
    large = ec.sphere("octahedron", 2)
    small = large.copy().apply_scale(0.01).apply_translation([3, 0, 0])
    space = ec.SurfaceSpace(trimesh.util.concatenate([large, small]))

    def evolve(size):
        def w(at):
            return np.where(at.x[:, :1] > 2, size * (at.x - [3, 0, 0]), np.cross([0, 0, 1], at.x))

        law = ec.laws.with_slip(ec.laws.Prescribed(velocity=lambda x, t: 0 * x), w)
        ec.evolve(space, ec.Problem(species={}, law=law), 1, 0.01, 0.03)

    for rounding in (0.0, 1e-14):  # of a component that does not slip
        evolve(rounding)
    assert not recwarn
    with pytest.warns(
        ec.EvolutionWarning, match="but 100% of it on component 1 of the surface is normal: it"
    ):
        evolve(0.1)


@pytest.mark.filterwarnings("error::esfem_core.EvolutionWarning")
def test_the_advice_for_a_slip_with_a_normal_part_works():
    space = ec.SurfaceSpace(ec.torus(1.0, 0.4, 16, 8))

    def w(at):
        return 0.1 * at.x

    def tangential(at):
        nu = ec.elements.nodal_average(at, at.normal)
        nu /= np.linalg.norm(nu, axis=1, keepdims=True)
        return w(at) - (w(at) * nu).sum(axis=1, keepdims=True) * nu

    law = ec.laws.Regularised()
    with pytest.warns(
        ec.EvolutionWarning, match=r"esfem_core\.elements\.nodal_average\(at, at\.normal\)"
    ):
        ec.evolve(space, ec.Problem(law=ec.laws.with_slip(law, w)), 1, 0.01, 0.03)
    ec.evolve(space, ec.Problem(law=ec.laws.with_slip(law, tangential)), 1, 0.01, 0.03)


def test_a_built_in_slip_whose_nodes_run_away_is_not_told_to_be_tangential():
    tri = ec.sphere("octahedron", 2)
    law = ec.laws.with_slip(ec.laws.MeanCurvature(), "elastic")
    space = ec.SurfaceSpace(tri, 1)
    x = space.nodes * [1, 1, 1.3]
    skew = x + np.random.default_rng(0).normal(size=x.shape)
    fields = {"normal": skew, "H": np.ones(len(x))}
    computed = {"fields": fields, "method": ("updated", 1, 0.01)}
    start = [ec.State(0.0, x, None, space=space, **computed)]
    with pytest.warns(ec.EvolutionWarning, match="nodes run away") as warned:
        ec.evolve(space, ec.Problem(species={}, law=law), 1, 0.01, 0.1, start=start)
    assert not any("tangential" in str(one.message) for one in warned)
