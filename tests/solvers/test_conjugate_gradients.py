"""Conjugate gradients end where theory says, with the residual that is allowed and sum zero."""

import numpy as np
import pytest
from scipy.sparse import csr_array, diags_array

from esfem_core.solvers.conjugate_gradients import Tolerance, pcg, tolerance


def spd(n=40, eigenvalues=None):
    """A matrix with given eigenvalues."""
    Q = np.linalg.qr(np.random.default_rng(0).standard_normal((n, n)))[0]
    A = (Q * np.linspace(1, 10, n) if eigenvalues is None else Q * eigenvalues) @ Q.T
    return csr_array((A + A.T) / 2)


def right_hand_sides(n=40, m=3):
    return np.random.default_rng(1).standard_normal((m, n))


def solve(A, b, x=None, precondition=lambda r: r, rtol=1e-10, most=100):
    allowed = tolerance(A, np.vecdot(b, b), rtol)
    return pcg(A, b, np.zeros_like(b) if x is None else x, precondition, allowed, most)


def test_as_many_iterations_as_eigenvalues():
    """In exact arithmetic, with k different ones, the k-th iterate is the solution."""
    for k in (1, 2, 5):
        found = solve(spd(40, np.arange(1.0, k + 1)[np.arange(40) % k]), right_hand_sides())
        assert (found.converged, found.iterations) == (True, k)


def test_one_iteration_with_the_inverse_as_preconditioner():
    A, b = spd(), right_hand_sides()
    found = solve(A, b, precondition=lambda r: np.linalg.solve(A.toarray(), r))
    assert found.iterations == 1
    assert found.start > 1 >= found.end
    np.testing.assert_allclose(found.x, np.linalg.solve(A.toarray(), b.T).T, atol=1e-12)


def test_iterates_are_those_of_the_textbook():
    """After k iterations x minimises the energy norm of the error over the Krylov space of k."""
    A, b = spd(12).toarray(), right_hand_sides(12, 1)
    exact = np.linalg.solve(A, b[0])
    for k in range(1, 6):
        found = pcg(csr_array(A), b, 0 * b, lambda r: r, Tolerance(np.full(1, 1e-30), 0.0), k)
        krylov = np.stack([np.linalg.matrix_power(A, j) @ b[0] for j in range(k)], axis=1)
        best = krylov @ np.linalg.solve(krylov.T @ A @ krylov, krylov.T @ A @ exact)
        np.testing.assert_allclose(found.x[0], best, rtol=0, atol=1e-9 * abs(best).max())
        assert (found.converged, found.iterations) == (False, k)


def test_rows_do_not_influence_each_other():
    A, b = spd(), right_hand_sides()
    together = pcg(A, b, 0 * b, lambda r: r, Tolerance(np.full(3, 1e-30), 0.0), 7).x
    for n in range(3):
        alone = b[n : n + 1]
        x = pcg(A, alone, 0 * alone, lambda r: r, Tolerance(np.full(1, 1e-30), 0.0), 7).x
        np.testing.assert_allclose(x[0], together[n], rtol=1e-13)


@pytest.mark.parametrize("rtol", [1e-2, 1e-6, 1e-12])
def test_the_residual_is_what_is_allowed_and_its_sum_zero(rtol):
    A, b = spd(), right_hand_sides()
    found = solve(A, b, rtol=rtol)
    r = b - found.x @ A.toarray()
    assert (np.linalg.norm(r, axis=1) <= rtol * np.linalg.norm(b, axis=1)).all()
    np.testing.assert_allclose(r.sum(axis=1), 0, atol=1e-13)


def test_zero_is_solved_by_zero_and_by_what_is_small_enough():
    A, b = spd(), np.zeros((2, 40))
    assert (solve(A, b).x == 0).all()
    found = solve(A, b, np.ones((2, 40)), rtol=1e-8)
    assert np.linalg.norm(found.x @ A.toarray(), axis=1).max() <= 1e-8


def test_matrix_and_right_hand_sides_are_left_alone_and_the_guess_becomes_the_solution():
    A, b = spd(), right_hand_sides()
    x = np.ones_like(b)
    before = A.data.copy(), b.copy()
    assert solve(A, b, x).x is x
    for array, copy in zip((A.data, b), before, strict=True):
        np.testing.assert_array_equal(array, copy)
    np.testing.assert_allclose(x @ A.toarray(), b, atol=1e-8)


def test_a_good_guess_takes_no_iteration():
    A, b = spd(), right_hand_sides()
    x = solve(A, b).x
    found = solve(A, b, x)
    assert (found.iterations, found.converged) == (0, True)
    assert found.start == found.end <= 1


def test_gives_up_after_the_iterations_allowed():
    found = solve(spd(), right_hand_sides(), most=3)
    assert (found.iterations, found.converged) == (3, False)
    assert found.end > 1


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e300, 1e8])
def test_a_guess_that_is_worse_than_none_is_not_used(bad):
    A, b = spd(), right_hand_sides()
    x = np.zeros_like(b)
    x[0, 0] = bad
    found, expected = solve(A, b, x), solve(A, b)
    assert found.iterations == expected.iterations
    np.testing.assert_array_equal(found.x, expected.x)


def test_gives_up_at_once_when_a_residual_is_not_finite():
    A, b = spd(), right_hand_sides()
    b[0, 0] = np.nan
    with np.errstate(invalid="ignore"):
        found = solve(A, b)
    assert (found.iterations, found.converged) == (0, False)


def test_a_tolerance_below_rounding_is_raised_to_it():
    A, b = spd(), right_hand_sides()
    found = solve(A, b, rtol=1e-30)
    assert found.converged
    r = np.linalg.norm(b - found.x @ A.toarray(), axis=1)
    assert (r <= 16 * np.finfo(float).eps * A.max() * np.linalg.norm(found.x, axis=1)).all()


def test_shifting_the_sum_to_zero_costs_no_iterations_at_rounding_level():
    A, b = spd(), right_hand_sides()
    found = solve(A, b, precondition=lambda r: np.linalg.solve(A.toarray(), r), rtol=1e-30)
    assert (found.converged, found.iterations) == (True, 1)


def test_the_excess_is_the_worst_quotient_of_squares():
    r, x = np.array([[3.0, 4.0], [0.0, 1.0]]), np.array([[0.0, 2.0], [0.0, 0.0]])
    assert Tolerance(np.array([5.0, 1.0]), 0.0).excess(r, x) == 5.0
    assert Tolerance(np.array([25.0, 0.5]), 0.0).excess(r, x) == 2.0
    rounding = Tolerance(np.array([5.0, 1.0]), 1.25)  # 2.5 are allowed for the first row
    assert rounding.excess(r, x) == 4.0
    assert np.isnan(Tolerance(np.ones(2), 0.0).excess(np.full((2, 2), np.nan), x))


def test_the_tolerance_of_a_zero_row_is_absolute():
    A = diags_array([2.0, 1.0]).tocsr()
    found = tolerance(A, np.array([9.0, 0.0]), 0.1)
    np.testing.assert_allclose(found.squares, [0.09, 0.01])
    assert found.rounding == 8 * np.finfo(float).eps


def test_the_sum_of_the_residual_is_zero_and_the_error_smaller_in_the_norm_of_the_matrix():
    A, b = spd(), right_hand_sides()
    exact = np.linalg.solve(A.toarray(), b.T).T
    rough = solve(A, b, rtol=0.1)
    assert np.abs((b - rough.x @ A.toarray()).sum(axis=1)).max() < 1e-13
    errors = [np.vecdot(e, e @ A.toarray()) for e in (rough.x - exact, rough.x + 1e-3 - exact)]
    assert (errors[0] < errors[1]).all()  # A-orthogonal to constants
    assert np.allclose(errors[1] - errors[0], 1e-6 * A.sum(), rtol=1e-6)


def test_a_matrix_that_takes_constants_to_zero_gets_no_constant():
    Q = np.linalg.qr(np.c_[np.ones(40), right_hand_sides(40, 39).T])[0]
    A = csr_array((Q * np.r_[0.0, np.linspace(1, 10, 39)]) @ Q.T)
    b = right_hand_sides()
    b -= b.mean(axis=1, keepdims=True)
    found = solve(A, b)
    assert found.converged
    assert np.abs(found.x.mean(axis=1)).max() < 1e-12
