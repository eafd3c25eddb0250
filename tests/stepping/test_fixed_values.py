"""Runs on surfaces with a boundary: natural conditions, and values that are given at nodes."""

import dataclasses
from fractions import Fraction

import numpy as np
import pytest
import trimesh
from hemisphere import FIXED, NATURAL, growing, hemisphere, moving, upper_half

import esfem_core as ec
from esfem_core.stepping.elimination import Elimination
from esfem_core.study import final, observed_orders, space_study

MASSES = ("updated", "extrapolated", "reassembled")
STARTS = ("euler", "exact")
GROWING = ec.laws.Prescribed(motion=lambda p, t: (1 + t) * p)
AT_REST = ec.laws.Prescribed(motion=lambda p, t: p)
PROBLEMS = {"natural": moving(NATURAL), "fixed": moving(FIXED)}


def on(species, law=GROWING, **options):
    return ec.Problem(species={"u": species}, law=law, **options)


def run(space, problem, order=2, step=0.1, end=0.4, **options):
    return final(ec.evolve(space, problem, order, step, end, **options))


@pytest.mark.parametrize("mass", MASSES)
def test_given_values_are_those_of_the_new_positions_and_not_of_extrapolated_ones(mass):
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)
    caps = np.flatnonzero(abs(space.nodes[:, 2]) > 0.9)
    height = ec.Species(lambda x: x[:, 2], fixed=(caps, lambda x, t: x[:, 2]))
    pushed = ec.laws.Regularised(1.0, 0.0, lambda at: 1 + 0 * at.density)
    found = run(space, on(height, pushed), mass=mass)
    np.testing.assert_array_equal(found.u[caps], found.x[caps, 2])


class TestOrders:
    @pytest.mark.parametrize("kind", PROBLEMS)
    @pytest.mark.parametrize("degree", [1, 2, 3])
    def test_k_plus_one_in_l2_and_k_in_h1(self, degree, kind):
        spaces = [hemisphere(r, degree) for r in ((3, 4) if degree == 1 else (2, 3))]
        table = space_study(spaces, PROBLEMS[kind], 4, 1 / 40, 0.2, ec.errors.lifted)
        assert table.orders("u_l2")[0] > degree + 1 - 0.1
        assert table.orders("u_h1")[0] == pytest.approx(degree, abs=0.3)

    @pytest.mark.parametrize(("fixed", "orders"), [(False, (2, 5)), (True, (1, 2, 3, 4, 5))])
    def test_p_in_time(self, fixed, orders):
        space, problem, steps = hemisphere(1, 2), growing(fixed), (1 / 20, 1 / 40)
        options = {"end": 1.0, "start": "euler", "solver": "direct"}
        fine = run(space, problem, 5, 1 / 80, **options)
        for p in orders:
            lasts = [run(space, problem, p, tau, **options) for tau in steps]
            errors = [ec.errors.difference(space, last, fine).u_l2 for last in lasts]
            assert observed_orders(steps, errors)[0] == pytest.approx(p, abs=0.35), p


class TestNaturalConditions:
    @pytest.mark.parametrize("mass", MASSES)
    def test_the_amount_stays(self, mass):
        space = hemisphere(2, 2)
        problem = on(ec.Species(lambda x: 1 + x[:, 0] + x[:, 2]))
        states = list(ec.evolve(space, problem, 3, 0.1, 1.0, mass=mass))
        amounts = [ec.measure(state).amount for state in states]
        assert np.ptp(amounts) < 1e-12 * amounts[0]

    def test_what_does_not_thin_out_becomes_its_mean(self):
        space = hemisphere(1, 2)
        problem = on(ec.Species(lambda x: x[:, 2], conserved=False), AT_REST)
        last = run(space, problem, 1, 1.0, 20.0)
        start = ec.Surface(space, space.nodes, space.nodes[:, 2])
        np.testing.assert_allclose(last.u, start.mean(start.u), rtol=1e-9)


class TestGivenValues:
    @pytest.mark.parametrize("mass", MASSES)
    @pytest.mark.parametrize("start", STARTS)
    @pytest.mark.parametrize("solver", ["lagged", "direct"])
    def test_are_kept_to_the_last_bit(self, mass, start, solver):
        space, problem = hemisphere(1, 2), PROBLEMS["fixed"]
        b = space.boundary_nodes
        for state in ec.evolve(space, problem, 3, 0.1, 0.5, mass=mass, start=start, solver=solver):
            np.testing.assert_array_equal(state.u[b], problem.exact.u(state.x[b], state.t))

    def test_a_constant_that_fits_is_the_solution(self):
        last = run(hemisphere(2, 2), on(ec.Species(3.0, conserved=False, fixed=3)))
        np.testing.assert_allclose(last.u, 3, rtol=1e-10)

    @pytest.mark.parametrize("number", [np.float32(0.25), np.array(0.25), Fraction(1, 4)])
    def test_a_constant_is_a_number_of_any_library(self, number):
        for fixed in (number, lambda x, t: number):
            u = run(hemisphere(0), on(ec.Species(0.0, fixed=fixed)), order=1).u
            np.testing.assert_array_equal(u[hemisphere(0).boundary_nodes], 0.25)

    def test_what_passes_the_boundary_changes_the_amount(self):
        space = hemisphere(2)
        amount = ec.measure(run(space, on(ec.Species(1.0, fixed=0.0)), end=1.0)).amount
        assert amount < 0.9 * space.integrate(space.nodes, 1)

    def test_one_step_solves_the_equations_of_the_other_nodes(self):
        space, tau = hemisphere(1, 2), 0.1
        problem = on(ec.Species(lambda x: x[:, 0], fixed=lambda x, t: x[:, 0] + t), AT_REST)
        *_, last = ec.evolve(space, problem, 1, tau, tau, solver="direct")
        M, A = (K.toarray() for K in space.mass_stiffness(space.nodes))
        residual = M @ (last.u - space.nodes[:, 0]) / tau + A @ last.u
        free = np.setdiff1d(np.arange(len(M)), space.boundary_nodes)
        assert np.abs(residual[free]).max() < 1e-12
        assert np.abs(residual).max() > 1e-2

    def test_some_nodes_of_the_boundary_and_natural_at_the_others(self):
        space = hemisphere(2, 2)
        b = space.boundary_nodes
        warm = b[space.nodes[b, 0] > 0.5]
        mask = np.isin(np.arange(len(space.nodes)), warm)
        values = np.full(len(warm), 2.0)
        runs = [
            run(space, on(ec.Species(1.0, conserved=False, fixed=fixed)), end=0.2)
            for fixed in ((warm, 2.0), (mask, 2), (warm, values), (warm, lambda x, t: values))
        ]
        for other in runs[1:]:
            np.testing.assert_array_equal(other.u, runs[0].u)
        assert (runs[0].u[warm] == 2).all()
        assert 1 < runs[0].u[space.nodes[:, 0] < -0.9].max() < 1.5

    @pytest.mark.parametrize("mass", MASSES)
    def test_given_what_comes_out_anyway_nothing_changes(self, mass):
        """On a closed surface that u moves: nodes fixed at the values of a run without."""
        space = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)
        free = ec.Problem(lambda x: 1 + x[:, 0] ** 2, g=lambda at: at.u, alpha=0.5, beta=0.1)
        states = list(ec.evolve(space, free, 2, 0.1, 0.6, mass=mass))
        nodes = np.array([7, 3])
        known = {round(10 * state.t): state.u[nodes] for state in states}
        given = dataclasses.replace(
            free.species["u"], fixed=(nodes, lambda x, t: known[round(10 * t)])
        )
        again = run(space, on(given, free.law), end=0.6, mass=mass, start=states[:2])
        np.testing.assert_allclose(again.u, states[-1].u, rtol=1e-8)
        np.testing.assert_allclose(again.x, states[-1].x, rtol=1e-8, atol=1e-9)

    def test_species_with_the_same_nodes_are_solved_together(self):
        space, statistics = hemisphere(1), ec.Statistics()
        poles = np.flatnonzero(space.nodes[:, 2] == 1)
        one = ec.Species(1.0, fixed=1.0)
        species = {"a": one, "b": dataclasses.replace(one, fixed=lambda x, t: x[:, 0])}
        species |= {"c": ec.Species(1.0, fixed=(poles, 0.0)), "d": ec.Species(1.0)}
        problem = ec.Problem(species=species, law=GROWING)
        last = run(space, problem, 1, 0.1, 0.2, statistics=statistics)
        assert set(statistics.solves) == {"a and b", "c", "d"}
        b = space.boundary_nodes
        np.testing.assert_array_equal(last["b"][b], last.x[b, 0])
        assert last["c"][poles] == 0
        assert last["d"].min() > 0.5

    def test_each_component_has_its_own_values_and_diffusivity(self):
        space = hemisphere(1, 2)
        vector = ec.Species(
            lambda x: x[:, :2], fixed=lambda x, t: x[:, :2], diffusivity=[1, 2], conserved=False
        )
        last = run(space, on(vector))
        for i in range(2):
            part = ec.Species(
                lambda x, i=i: x[:, i],
                fixed=lambda x, t, i=i: x[:, i],
                diffusivity=1.0 + i,
                conserved=False,
            )
            np.testing.assert_allclose(last.u[:, i], run(space, on(part)).u, atol=1e-9)

    def test_values_with_coefficients_of_the_surface(self):
        space = hemisphere(1, 2)
        options = {"initial": 1.0, "conserved": False, "fixed": lambda x, t: 1 + x[:, 0] * t}
        plain = ec.Species(rate=2.0, diffusivity=0.5, **options)
        functions = ec.Species(
            rate=lambda at: 2.0 + 0 * at.density,
            diffusivity=lambda at: 0.5 + 0 * at.density,
            **options,
        )
        a, b = (run(space, on(one)).u for one in (plain, functions))
        np.testing.assert_allclose(a, b, rtol=1e-9)

    def test_a_run_that_goes_on_has_the_same_bits(self, tmp_path):
        space, problem = hemisphere(1, 2), PROBLEMS["fixed"]
        whole = list(ec.evolve(space, problem, 3, 0.1, 0.8, solver="direct"))
        ec.save(tmp_path / "run.npz", whole[:5])
        again, states = ec.load(tmp_path / "run.npz")
        np.testing.assert_array_equal(again.boundary_nodes, space.boundary_nodes)
        last = run(again, problem, 3, 0.1, 0.8, start=states, solver="direct")
        np.testing.assert_array_equal(last.u, whole[-1].u)
        start = ec.respaced(whole, 0.05, order=3)
        assert run(again, problem, 3, 0.05, 0.9, start=start).t == 0.9


class TestSurfaces:
    def test_numbers_pictures_and_files_of_a_hemisphere(self, tmp_path):
        space = hemisphere(2, 2)
        states = list(ec.evolve(space, on(ec.Species(1.0)), 1, 0.5, 1.0))
        m = ec.measure(states[-1])
        assert np.isnan(m.volume)
        assert (m.area, m.amount) == pytest.approx((8 * np.pi, 2 * np.pi), rel=2e-3)
        assert m.centre == pytest.approx([0, 0, 1], abs=2e-3)
        ec.save_series(tmp_path / "run.pvd", states)
        assert len(list(tmp_path.rglob("*.vtu"))) == 3
        assert ec.plot(states[-1]) is not None

    def test_an_open_surface_has_no_inside_but_a_closed_one_beside_it_has(self):
        """The cap is pushed through its plane: the volume under it changes its sign."""
        cap = upper_half(ec.sphere("octahedron", 2))
        through = ec.laws.Prescribed(motion=lambda p, t: p * [1, 1, 1 - t])
        last = run(
            ec.SurfaceSpace(cap, 2, ec.to_unit_sphere, boundary=True),
            on(ec.Species(1.0), through),
            step=0.02,
            end=1.3,
        )
        assert last.x[:, 2].min() == pytest.approx(-0.3)
        ball = ec.sphere("octahedron", 1).apply_translation([5, 0, 0])
        both = ec.SurfaceSpace(trimesh.util.concatenate([cap, ball]), boundary=True)

        def reflected(p, t):
            return np.where(p[:, :1] > 3, [5, 0, 0] + (1 - t) * (p - [5, 0, 0]), p)

        problem = on(ec.Species(1.0), ec.laws.Prescribed(motion=reflected))
        with pytest.raises(ec.EvolutionError, match="component 1 of the surface is inside out"):
            run(both, problem, 1, 0.6, 1.2)

    def test_turned_triangles_are_refused_on_open_surfaces_too(self):
        space = hemisphere(2)
        mirror = ec.laws.Prescribed(motion=lambda p, t: p * [1, 1 - 2 * t, 1])
        with pytest.raises(ec.EvolutionError, match="turned over"):
            run(space, on(ec.Species(1.0), mirror), 1, 0.75, 1.5)

    @pytest.mark.parametrize(
        "law",
        [
            ec.laws.Regularised(1.0, 1.0),
            ec.laws.MeanCurvature(),
            ec.laws.Dynamic(0.0, 1.0, 1.0),
            ec.laws.VolumePreserving(ec.laws.Regularised(1.0, 1.0)),
            ec.laws.with_slip(ec.laws.Prescribed(velocity=lambda x, t: 0 * x), "elastic"),
        ],
    )
    def test_laws_with_an_equation_are_refused_with_the_reason(self, law):
        problem = ec.Problem(species={}, law=law)
        with pytest.raises(ValueError, match="law must prescribe the motion of a surface with a b"):
            ec.evolve(hemisphere(1), problem, 1, 0.1, 0.1)

    def test_a_velocity_field_moves_the_boundary(self):
        field = ec.laws.Prescribed(velocity=lambda x, t: np.cross([0, 0, 1], x))
        space = hemisphere(1, 2)
        last = run(space, on(ec.Species(lambda x: x[:, 2], fixed=0.0), field))
        np.testing.assert_allclose(last.x[space.boundary_nodes, 2], 0, atol=1e-12)


class Tensor:
    """Numbers of a library that gives no array of them."""

    def __array__(self, dtype=None, copy=None):
        raise RuntimeError("call detach() first")

    def __repr__(self):
        return "Tensor()"


@pytest.mark.parametrize(
    ("fixed", "error", "text"),
    [
        (
            "hot",
            TypeError,
            r"fixed must be a number, a function g\(x, t\), or a pair .*, got 'hot'",
        ),
        ([1.0, 2.0], TypeError, r"a number, a function g\(x, t\), or a pair \(nodes, values\), g"),
        ([[0, 1], 0.0], TypeError, r"or a pair .*, got \[\[0, 1\], 0.0\]; a pair is a tuple"),
        (Tensor(), TypeError, r"fixed must hold real numbers, got Tensor\(\): call detach\(\)"),
        (([[0], [1, 2]], 1.0), ValueError, "the nodes of fixed must have rows of one length"),
        (([0, 1], [[1], [1, 2]]), ValueError, "the values of fixed must have rows of one length"),
        (np.inf, ValueError, "fixed must be a finite number"),
        ((1, 2, 3), ValueError, "got 3 things"),
        (([0.5], 1.0), ValueError, r"the nodes of fixed must hold integers"),
        ((None, 1.0), TypeError, "nodes of fixed must be numbers of nodes or a bool for each, got"),
        (([0], [np.nan]), ValueError, "the values of fixed must be finite"),
        (([True, False], 1.0), ValueError, r"a bool for each of 41 nodes, got shape \(2,\)"),
        ((np.zeros(41, bool), 1.0), ValueError, "must be one at least, got none"),
        (([0, 41], 1.0), ValueError, "must lie in 0 to 40, got 0, 41"),
        (([3, 3], 1.0), ValueError, "must not be repeated"),
        (([3, 4], np.ones(3)), ValueError, r"fixed of 'u' must have shape \(2,\), got \(3,\)"),
        (lambda x, t: x, ValueError, r"fixed of 'u' must have shape \(16,\), got \(16, 3\)"),
        (
            lambda x, t: x[:, 0] / 0 * 0,
            ValueError,
            r"must be finite, but is not at \[.*\] at t = 0",
        ),
    ],
)
def test_unfit_values_are_refused_before_anything_is_computed(fixed, error, text):
    with np.errstate(all="ignore"), pytest.raises(error, match=text):
        ec.evolve(hemisphere(2), on(ec.Species(1.0, fixed=fixed)), 1, 0.1, 0.1)


def test_values_that_stop_being_finite_stop_the_run_with_its_time():
    species = ec.Species(1.0, fixed=lambda x, t: np.where(t > 0.25, np.nan, 1.0) + 0 * x[:, 0])
    with pytest.raises(ec.EvolutionError, match=r"step 3, t = 0\.3: fixed of 'u' must be finite"):
        run(hemisphere(1), on(species))


def test_a_closed_surface_has_no_boundary_to_fix_values_at():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    with pytest.raises(ValueError, match=r"none: name the nodes, fixed=\(nodes, values\)"):
        ec.evolve(space, on(ec.Species(1.0, fixed=0.0)), 1, 0.1, 0.1)


def test_an_array_of_the_caller_may_change_afterwards():
    nodes, values = np.array([0, 1]), np.array([1.0, 2.0])
    species = ec.Species(1.0, fixed=(nodes, values))
    nodes[:], values[:] = 5, 5
    assert (species.fixed.where.tolist(), species.fixed.values.tolist()) == ([0, 1], [1, 2])
    assert dataclasses.replace(species, rate=1.0).fixed is species.fixed


def test_an_elimination_keeps_the_pattern_and_positive_definiteness():
    space = hemisphere(1, 3)
    M, _ = space.mass_stiffness(space.nodes)
    K = Elimination(space.pattern, space.boundary_nodes).without(M)
    assert K.indices is M.indices
    assert abs(K - K.T).max() == 0
    assert np.linalg.eigvalsh(K.toarray()).min() > 0


def test_an_elimination_leaves_what_it_is_given():
    space = hemisphere(1)
    nodes, (M, _) = space.boundary_nodes, space.mass_stiffness(space.nodes)
    b, guess, given = (np.full(len(space.nodes), value) for value in (2.0, 3.0, 7.0))
    w = Elimination(space.pattern, nodes).solve(lambda K, b, guess: guess, M, b, guess, given)
    assert (w[nodes] == 7).all()
    for array, value in ((b, 2), (guess, 3), (given, 7)):
        assert (array == value).all()


@pytest.mark.parametrize("fixed", [ec.laws.Fixed, (ec.laws.Fixed, 1.0), ([0], ec.laws.Fixed)])
def test_a_class_is_no_value(fixed):
    with pytest.raises(TypeError, match=r"fixed must .*, got .*(class Fixed|object)"):
        ec.Species(1.0, fixed=fixed)


def test_what_is_given_as_an_object_is_checked_as_well():
    with pytest.raises(TypeError, match=r"fixed must be a number, a function .*, got 'rest'"):
        ec.laws.Fixed("rest")
    with pytest.raises(ValueError, match=r"the nodes of fixed must hold integers, but .*\[0\]"):
        ec.laws.Fixed(1.0, [0.5])
