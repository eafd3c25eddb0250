"""The residual asked for is the residual obtained, whatever the matrix does meanwhile."""

from functools import partial

import numpy as np
import pytest
from scipy.sparse import csr_array

import esfem_core as ec
from esfem_core.solvers import DirectSolver, LaggedSolver, cholmod, multifrontal, superlu

SPACE = ec.SurfaceSpace(ec.sphere("octahedron", 3), 2, ec.to_unit_sphere)
fronts = partial(multifrontal.factorise, fronts=SPACE.fronts)


def system(stretch, tau=0.01):
    M, A = SPACE.mass_stiffness(SPACE.nodes * [1, 1, stretch])
    return M / tau + A


def relative_residual(A, x, b):
    return (np.linalg.norm(b - A @ x, axis=0) / np.linalg.norm(b, axis=0)).max()


@pytest.mark.parametrize("factorise", [superlu, cholmod, fronts])
@pytest.mark.parametrize("columns", [(), (3,)])
@pytest.mark.parametrize("rtol", [1e-4, 1e-8, 1e-11])
def test_residual_along_a_slow_change(columns, rtol, factorise):
    rng = np.random.default_rng(0)
    solver, x = LaggedSolver(rtol, factorise=factorise), np.zeros((len(SPACE.nodes), *columns))
    for n in range(30):
        A, b = system(1 + 0.02 * n), rng.standard_normal(x.shape)
        x = solver.solve(A, b, x)
        assert relative_residual(A, x, b) <= rtol
    assert solver.factorisations < 10


def test_a_drifted_matrix_is_factorised_anew():
    rng = np.random.default_rng(0)
    b = rng.standard_normal(len(SPACE.nodes))
    solver = LaggedSolver()
    for stretch, tau, expected in ((1, 0.01, 1), (1.001, 0.01, 1), (30, 1.0, 2)):
        A = system(stretch, tau)
        x = solver.solve(A, b, np.zeros_like(b))
        assert relative_residual(A, x, b) <= solver.rtol
        assert solver.factorisations == expected


def test_age_is_paid_for_with_a_new_factorisation():
    """The larger the price, the fewer factorisations and the more iterations."""
    counts = []
    for price in (20, 60, 10**6):
        rng = np.random.default_rng(0)
        solver = LaggedSolver(price=price, factorise=fronts)
        for n in range(60):
            A, b = system(1 + 0.01 * n), rng.standard_normal(len(SPACE.nodes))
            before = solver.iterations
            x = solver.solve(A, b, np.zeros_like(b))
            assert relative_residual(A, x, b) <= solver.rtol
            assert solver.iterations - before < 20  # no solve is given up
        counts.append((solver.factorisations, solver.iterations))
    factorisations, iterations = zip(*counts, strict=True)
    assert factorisations[0] > factorisations[1] > factorisations[2] == 1
    assert iterations[0] < iterations[1] < iterations[2]


@pytest.mark.parametrize("factorise", [superlu, cholmod, fronts])
def test_a_factorisation_of_the_matrix_itself_does_not_age(factorise):
    """However much the guesses leave to be done."""
    rng = np.random.default_rng(0)
    solver, A, x = (
        LaggedSolver(price=4, factorise=factorise),
        system(1.2),
        np.zeros(len(SPACE.nodes)),
    )
    for size in (1, 1e-3, 1e-6, 1e-9, 1) * 5:
        b = A @ x
        solver.solve(A, b + size * rng.standard_normal(len(b)), x)
        x = rng.standard_normal(len(b))
    assert solver.factorisations == 1


def test_agrees_with_the_direct_solver():
    b = np.random.default_rng(0).standard_normal((len(SPACE.nodes), 3))
    A = system(1.4)
    lagged = LaggedSolver()
    lagged.solve(system(1.3), b, np.zeros_like(b))
    expected = DirectSolver().solve(A, b, b)
    np.testing.assert_allclose(
        lagged.solve(A, b, np.zeros_like(b)), expected, rtol=0, atol=1e-10 * abs(expected).max()
    )


def test_the_guess_is_used_and_not_overwritten():
    b = np.random.default_rng(0).standard_normal(len(SPACE.nodes))
    solver, A = LaggedSolver(), system(1)
    x = solver.solve(A, b, np.zeros_like(b))
    guess, before = x.copy(), solver.iterations
    solver.solve(A, b, guess)
    assert solver.iterations == before
    np.testing.assert_array_equal(guess, x)


def test_zero_columns_and_bad_guesses():
    b = np.zeros((len(SPACE.nodes), 2))
    b[:, 0] = 1.0
    solver, A = LaggedSolver(), system(1)
    x = solver.solve(A, b, np.full_like(b, np.nan))
    assert relative_residual(A, x[:, 0], b[:, 0]) < 1e-11
    assert abs(x[:, 1]).max() == 0
    x = solver.solve(A, b, np.ones_like(b))
    assert abs(x[:, 1]).max() == 0


@pytest.mark.parametrize("factorise", [superlu, fronts])
def test_the_residual_is_true_after_a_guess_much_larger_than_the_solution(factorise):
    """Its rounding errors would stay in the solution, unseen in the updated residual."""
    rng = np.random.default_rng(0)
    solver = LaggedSolver(factorise=factorise)
    for n, size in enumerate((1.0, 1e4, 1e8, 1e12, 1e300)):
        A, b = system(1 + 0.02 * n), rng.standard_normal(len(SPACE.nodes))
        x = solver.solve(A, b, size * rng.standard_normal(len(b)))
        assert relative_residual(A, x, b) <= solver.rtol


def test_sums_are_exact():
    """What conserves mass: 1'(b - A x) = 0."""
    rng = np.random.default_rng(0)
    solver, x = LaggedSolver(1e-4), np.zeros((len(SPACE.nodes), 2))
    for n in range(4):
        A, b = system(1 + 0.05 * n), rng.random(x.shape)
        x = solver.solve(A, b, x)
        np.testing.assert_allclose((A @ x).sum(axis=0), b.sum(axis=0), rtol=1e-14)


@pytest.mark.parametrize("size", [1e-300, 1e-170, 1e-120, 1e120, 1e200, 1e300])
def test_right_hand_sides_may_have_any_size(size):
    """Also beside one of another size, and where their squares are no numbers."""
    rng = np.random.default_rng(0)
    A, b = system(1), rng.standard_normal((len(SPACE.nodes), 3)) * [1.0, 1.0, 0.0]
    expected = LaggedSolver().solve(A, b, np.zeros_like(b))
    x = LaggedSolver().solve(A, b * [size, 1.0, 1.0], np.ones_like(b))
    np.testing.assert_allclose(x / [size, 1.0, 1.0], expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_right_hand_side_that_is_not_finite_is_refused(bad):
    b = np.full(len(SPACE.nodes), bad)
    with pytest.raises(FloatingPointError, match="right-hand side of a linear system"):
        LaggedSolver().solve(system(1), b, np.zeros_like(b))


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (0.0, "a pivot that is zero"),
        (np.nan, "A must be finite, but has entries that are not"),
        (
            -1.0,
            "in 30 iterations .the price of LaggedSolver.*, or its condition number is too large",
        ),
    ],
)
def test_unsolvable_systems_are_reported(bad, message):
    A = system(1)
    A.data *= bad
    with pytest.raises(np.linalg.LinAlgError, match=message):
        LaggedSolver().solve(A, np.ones(A.shape[0]), np.zeros(A.shape[0]))


def test_where_its_own_factor_is_of_no_use_it_takes_that_of_superlu():
    """As with needles, whose mass matrices have no right digit in single precision."""

    class Useless:
        def solve(self, b):
            return np.zeros(b.shape)

    A, b = system(1), np.random.default_rng(0).random(len(SPACE.nodes))
    solver = LaggedSolver(factorise=lambda A: Useless())
    assert relative_residual(A, solver.solve(A, b, 0 * b), b) < 1e-11
    assert (solver.factorisations, "SuperLU" in repr(solver)) == (2, True)
    x = solver.solve(1.01 * A, b, b)  # it is kept
    assert relative_residual(1.01 * A, x, b) < 1e-11
    assert solver.factorisations == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"rtol": 0}, "rtol must be a finite number > 0 and < 1, got 0"),
        ({"rtol": 1}, "rtol must be a finite number > 0 and < 1, got 1"),
        ({"price": 0}, "price must be an integer >= 1, got 0"),
        ({"price": 1.5}, "price must be an integer >= 1, got 1.5"),
    ],
)
def test_parameters_outside_their_range_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        LaggedSolver(**arguments)


def test_systems_whose_parts_do_not_fit_are_refused():
    A, solver = system(1), LaggedSolver()
    n = A.shape[0]
    with pytest.raises(ValueError, match=rf"A must be square, got shape \({n}, {n - 1}\)"):
        solver.solve(A[:, 1:], np.ones(n), np.ones(n))
    with pytest.raises(ValueError, match=rf"b must have shape .* \({n}, {n}\), got \(1, {n}\)"):
        solver.solve(A, np.ones((1, n)), np.ones((1, n)))
    with pytest.raises(ValueError, match=rf"guess must have shape \({n}, 2\), got \({n},\)"):
        solver.solve(A, np.ones((n, 2)), np.ones(n))
    assert (solver.factorisations, solver.iterations) == (0, 0)


def test_says_what_it_has_done():
    solver = LaggedSolver(1e-6, 7, fronts)
    assert repr(solver) == (
        "LaggedSolver(rtol=1e-06, price=7, iterations=0, factorisations=0, factor=None)"
    )
    A = system(1)
    solver.solve(A, np.ones(A.shape[0]), np.zeros(A.shape[0]))
    assert f"iterations={solver.iterations}, factorisations=1, factor=BlockFac" in repr(solver)


def test_a_matrix_of_another_size_is_named():
    solver = LaggedSolver()
    solver.solve(csr_array(np.eye(2)), np.ones(2), np.zeros(2))
    with pytest.raises(
        ValueError, match=r"A must have the shape .*\(2, 2\), got \(3, 3\): make a new"
    ):
        solver.solve(csr_array(np.eye(3)), np.ones(3), np.zeros(3))


def test_what_factorise_returns_is_named():
    solver = LaggedSolver(factorise=lambda A: None)
    with pytest.raises(TypeError, match=r"factorise must return a Factor, .* got None"):
        solver.solve(csr_array(np.eye(2)), np.ones(2), np.zeros(2))
