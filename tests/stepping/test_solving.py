"""Linear systems of a run: matrices brought into one pattern, and what was counted."""

import numpy as np
import pytest
from scipy.sparse import coo_array, csr_array, diags_array

import esfem_core as ec
from esfem_core.stepping.solving import Systems, stacked

SPACE = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)
M, A = SPACE.mass_stiffness(SPACE.nodes)
N = len(SPACE.nodes)
ZERO = np.zeros(N)


class Recorder:
    """A solver that keeps what it gets."""

    def __init__(self):
        self.seen = []

    def solve(self, K, b, guess):
        self.seen.append((K, b, guess))
        return np.linalg.solve(K.toarray(), b)


def systems(statistics=None):
    return Systems(Recorder, SPACE.pattern, statistics or ec.Statistics())


def solved(K):
    """What a solver gets of a matrix."""
    statistics = ec.Statistics()
    w = systems(statistics).solve("u", K, SPACE.nodes, 0 * SPACE.nodes)
    [(found, _, _)] = statistics.solvers["u"].seen
    np.testing.assert_allclose(K @ w, SPACE.nodes, atol=1e-12)
    return found


def shuffled(K):
    """The same matrix with the entries of each row in another order."""
    rng = np.random.default_rng(0)
    order = np.concatenate(
        [a + rng.permutation(b - a) for a, b in zip(K.indptr, K.indptr[1:], strict=False)]
    )
    return csr_array((K.data[order], K.indices[order], K.indptr), shape=K.shape)


class TestMatricesOfLaws:
    def test_those_of_the_space_are_taken_as_they_are(self):
        K = ec.Surface(SPACE, SPACE.nodes).matrix(1.0, 0.5)
        assert solved(K) is K
        copy = M + A
        assert solved(copy) is copy

    @pytest.mark.parametrize(
        "K",
        [
            diags_array(2.0 + np.arange(N)),
            diags_array(2.0 + np.arange(N), format="csr"),
            csr_array(M * (abs(M) > 0.1 * M.max()) + 3 * diags_array(np.ones(N), format="csr")),
            shuffled(M + A),
            (M + A).tocsc(),
            (M + A).tocoo(),
        ],
        ids=["diagonal", "diagonal in CSR", "some entries", "shuffled", "CSC", "COO"],
    )
    def test_others_get_all_entries_of_the_pattern(self, K):
        found = solved(K)
        assert abs(found - K).max() == 0
        np.testing.assert_array_equal(found.indices, SPACE.pattern.indices)
        np.testing.assert_array_equal(found.indptr, SPACE.pattern.indptr)

    def test_entries_that_are_there_twice_are_added(self):
        twice = np.repeat(np.arange(N), 2)
        in_rows = csr_array((np.tile([1.0, 2.0], N), twice, 2 * np.arange(N + 1)), shape=(N, N))
        for K in (in_rows, coo_array((in_rows.data, (twice, twice)), shape=(N, N))):
            assert K.nnz == 2 * N
            np.testing.assert_array_equal(solved(K).toarray(), 3 * np.eye(N))

    def test_nodes_without_a_common_element_are_refused(self):
        far = int(np.flatnonzero(M[[0]].toarray()[0] == 0)[0])
        more = coo_array(([1.0, 1.0], ([0, far], [far, 0])), shape=(N, N))
        few = csr_array(diags_array(np.full(N, 5.0)) + more)
        # As many entries as the pattern has, in other places.
        near = int(M.indices[1])
        K = (M + A).tolil()
        K[0, near] = K[near, 0] = 0
        K[0, far] = K[far, 0] = 1.0
        as_many = csr_array(K)
        as_many.eliminate_zeros()
        assert as_many.nnz == SPACE.pattern.nnz
        for foreign in (few, as_many):
            with pytest.raises(ValueError, match=r"must .* couple nodes of one element only"):
                systems().solve("u", foreign, ZERO, ZERO)

    def test_another_shape_is_refused(self):
        for shape in (N - 1, N + 1):
            K = diags_array(np.ones(shape), format="csr")
            message = rf"the shape of M and A .*, got shape \({shape}, {shape}\)"
            with pytest.raises(ValueError, match=message):
                systems().solve("law 1", K, ZERO, ZERO)

    @pytest.mark.parametrize("solver", ["lagged", "direct"])
    def test_a_law_may_solve_with_any_of_them(self, solver):
        class Normal(ec.laws.Law):
            def __init__(self, change):
                self.change = change

            def velocity(self, at, new, tau, past, solve):
                return solve(self.change(at.matrix(1.0, 1.0)), at.load(at.normal))

        expected, found = (
            list(ec.evolve(SPACE, ec.Problem(law=Normal(change)), 1, 0.01, 0.03, solver=solver))[-1]
            for change in (lambda K: K, shuffled)
        )
        np.testing.assert_allclose(found.v, expected.v, rtol=0, atol=1e-10)


class TestFirstGuesses:
    def test_solutions_are_extrapolated_from_the_last_five_of_their_kind(self):
        statistics = ec.Statistics()
        own = systems(statistics)
        polynomial = [(1 + n) ** 4 * np.ones(N) for n in range(7)]
        for b in polynomial:
            own.solve_again("law 1", csr_array(diags_array(np.ones(N))), b)
        guesses = [guess for _, _, guess in statistics.solvers["law 1"].seen]
        np.testing.assert_array_equal(guesses[0], ZERO)
        np.testing.assert_array_equal(guesses[1], polynomial[0])
        np.testing.assert_allclose(guesses[2], 2 * polynomial[1] - polynomial[0])
        for n in (5, 6):
            np.testing.assert_allclose(guesses[n], polynomial[n], rtol=1e-12)

    def test_solutions_of_another_shape_do_not_count(self):
        statistics = ec.Statistics()
        own, K = systems(statistics), csr_array(diags_array(np.ones(N)))
        own.solve_again("law 1", K, np.ones(N))
        own.solve_again("law 1", K, np.ones((N, 3)))
        np.testing.assert_array_equal(statistics.solvers["law 1"].seen[1][2], np.zeros((N, 3)))


class TestStatistics:
    def test_they_count_by_the_kind_of_system(self):
        statistics = ec.Statistics()
        assert repr(statistics) == "Statistics: nothing solved yet"
        assert (statistics.iterations, statistics.factorisations) == (0, 0)
        problem = ec.Problem(
            species={
                "a": ec.Species(1.0),
                "b": ec.Species(2.0, diffusivity=0.5),
                "c": ec.Species(SPACE.nodes[:, :2], diffusivity=0.5),
                "d": ec.Species(1.0, diffusivity=0.5, conserved=False),
                "e": ec.Species(SPACE.nodes, diffusivity=[1.0, 2.0, 2.0]),
            }
        )
        list(
            ec.evolve(
                SPACE, problem, 1, 0.1, 0.4, solver="direct", start="euler", statistics=statistics
            )
        )
        # What shares a matrix is solved together.
        kinds = ["law 1", "a and e[0]", "b and c", "d", "e[1, 2]"]
        assert statistics.solves == dict.fromkeys(kinds, 4)
        assert list(statistics.solvers) == kinds
        assert statistics.factorisations == 20
        assert statistics.iterations == 0
        line = "b and c: 4 solves, DirectSolver(factorise=superlu, factorisations=4)"
        assert line in repr(statistics).split("\n")

    def test_they_add_up_what_the_solvers_say(self):
        statistics = ec.Statistics()
        problem = ec.problems.growing_sphere()
        run = ec.evolve(SPACE, problem, 2, 0.05, 0.5, start="euler", statistics=statistics)
        assert statistics.solves == {}
        states = [next(run) for _ in range(4)]
        part = dict(statistics.solves)
        assert len(states) == 4
        assert part["law 1"] == part["u"] == 3 + 2  # Euler steps 1 + 2, and two of order 2
        assert part["start"] == 1
        states.extend(run)
        assert statistics.solves["u"] == part["u"] + 7
        solvers = statistics.solvers.values()
        assert statistics.iterations == sum(s.iterations for s in solvers) > 20
        assert statistics.factorisations == sum(s.factorisations for s in solvers) >= 2

    def test_a_second_run_needs_its_own(self):
        """It reset the kinds that it solved, and left the others: the start of the first run."""
        statistics = ec.Statistics()
        options = {"problem": ec.problems.growing_sphere(), "order": 2, "step": 0.05}
        states = list(ec.evolve(SPACE, end=0.5, start="euler", statistics=statistics, **options))
        with pytest.raises(
            ValueError, match=r"'start': 1}: esfem_core\.Statistics\(\) makes new ones"
        ):
            ec.evolve(SPACE, end=0.6, start=states, statistics=statistics, **options)
        statistics = ec.Statistics()
        list(ec.evolve(SPACE, end=0.6, start=states, statistics=statistics, **options))
        assert statistics.solves == {"law 1": 2, "u": 2}

    def test_those_of_a_study_are_those_of_its_last_run(self):
        statistics, alone = ec.Statistics(), ec.Statistics()
        options = {"problem": ec.problems.growing_sphere(), "order": 2, "end": 0.5}
        options["start"] = "euler"
        ec.study.time_study(SPACE, steps=[0.05, 0.025], statistics=statistics, **options)
        list(ec.evolve(SPACE, step=0.025, statistics=alone, **options))
        assert statistics.solves == alone.solves == {"law 1": 22, "u": 22, "start": 1}
        assert statistics.iterations == alone.iterations


def test_right_hand_sides_are_stacked_and_taken_apart():
    b = [np.arange(4.0), np.arange(8.0).reshape(4, 2), np.arange(24.0).reshape(4, 3, 2)]
    together, apart = stacked(b)
    assert together.shape == (4, 9)
    for part, expected in zip(apart(2 * together), b, strict=True):
        np.testing.assert_array_equal(part, 2 * expected)
    alone, apart = stacked(b[2:])
    assert alone is b[2]
    assert apart(alone)[0] is alone


@pytest.mark.parametrize("solver", ["lagged", "direct"])
@pytest.mark.parametrize(
    ("problem", "system"),
    [
        ({"alpha": 1.7e308}, "law 1, the first that the law solves in a step"),
        ({"u0": 1.0, "diffusivity": 1e200, "motion": lambda p, _: p}, "u"),
    ],
    ids=["law", "species"],
)
@pytest.mark.filterwarnings("error:overflow encountered in dot")
@pytest.mark.filterwarnings("ignore:overflow encountered in multiply")
def test_a_system_that_is_not_solved_is_named(solver, problem, system):
    with pytest.warns(ec.EvolutionWarning, match=r"is .* times area/\(4 pi\)"):
        run = ec.evolve(SPACE, ec.Problem(**problem), order=1, step=0.1, end=0.1, solver=solver)
    message = rf"the linear system of {system}: (A must be|no |the numbers of A)"
    with pytest.raises(ec.EvolutionError, match=message):
        list(run)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("solver", ["lagged", "direct"])
def test_a_surface_that_shrinks_to_a_point_within_a_step_is_thought_of(solver):
    """Its matrix for u is a stiffness matrix but for rounding."""
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), 2, ec.to_unit_sphere)
    run = ec.evolve(space, ec.Problem(1.0, beta=1e12), 1, 0.05, 0.1, solver=solver)
    message = "system of u: no solution: .* so it is if the surface has shrunk to a point within"
    with pytest.raises(ec.EvolutionError, match=message):
        list(run)
