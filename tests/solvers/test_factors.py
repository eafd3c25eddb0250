"""Factorisations by libraries solve for every shape of right-hand side, and refuse what is none."""

from functools import partial

import numpy as np
import pytest
from scipy.sparse import csr_array, diags_array

import esfem_core as ec
from esfem_core.solvers import DirectSolver, cholmod, factorise, superlu

SPACE = ec.SurfaceSpace(ec.sphere("octahedron", 3), 2, ec.to_unit_sphere)
N = len(SPACE.nodes)
A = sum(SPACE.mass_stiffness(SPACE.nodes))
LIBRARIES = [superlu, cholmod]
ALL = [*LIBRARIES, partial(factorise, fronts=SPACE.fronts)]


def tridiagonal(n):
    return diags_array([[-1.0] * (n - 1), [3.0] * n, [-1.0] * (n - 1)], offsets=[-1, 0, 1]).tocsr()


@pytest.mark.parametrize("make", LIBRARIES)
@pytest.mark.parametrize("ordered", [False, True])
@pytest.mark.parametrize("columns", [(), (1,), (3,)])
def test_solves_in_any_order_of_elimination(make, ordered, columns):
    b = np.random.default_rng(0).standard_normal((N, *columns))
    x = make(A, SPACE.elimination_order if ordered else None).solve(b)
    assert x.shape == b.shape
    np.testing.assert_allclose(A @ x, b, rtol=0, atol=1e-12)


@pytest.mark.parametrize("make", LIBRARIES)
def test_a_matrix_of_known_inverse(make):
    n = 6
    laplacian = diags_array([[-1.0] * (n - 1), [2.0] * n, [-1.0] * (n - 1)], offsets=[-1, 0, 1])
    i = np.arange(1, n + 1)
    inverse = np.minimum.outer(i, i) - np.outer(i, i) / (n + 1)
    x = make(laplacian.tocsr(), np.array([3, 0, 5, 1, 4, 2])).solve(np.eye(n))
    np.testing.assert_allclose(x, inverse, rtol=0, atol=1e-14)


@pytest.mark.parametrize("make", LIBRARIES)
@pytest.mark.parametrize(
    "order", [[0, 1, 2, 3], [0, 1, 2, 3, 3], [1, 2, 3, 4, 5], [[0, 1, 2, 3, 4]]]
)
def test_an_order_that_is_no_permutation_is_refused(make, order):
    with pytest.raises(ValueError, match="order must "):
        make(tridiagonal(5), np.array(order))


@pytest.mark.parametrize("make", ALL)
def test_a_matrix_that_is_not_square_is_refused(make):
    with pytest.raises(ValueError, match=r"A must be square, got shape \(5, 4\)"):
        make(csr_array((5, 4)))


@pytest.mark.parametrize("make", ALL)
@pytest.mark.parametrize(("A", "found"), [(np.eye(5), "ndarray"), (A.tocsc(), "csc_array")])
def test_other_formats_of_matrices_are_refused(make, A, found):
    with pytest.raises(TypeError, match=f"A must be a sparse matrix in CSR format, got a {found}"):
        make(A)


@pytest.mark.parametrize("make", ALL)
@pytest.mark.parametrize("shape", [(N + 1,), (1, N), (N, 2, 2), ()])
def test_a_right_hand_side_of_another_length_is_refused(make, shape):
    message = rf"b must have shape \({N},\) or \({N}, m\) beside A of shape \({N}, {N}\), got \("
    with pytest.raises(ValueError, match=message):
        make(A).solve(np.zeros(shape))


@pytest.mark.parametrize("make", ALL)
def test_complex_right_hand_sides_are_refused(make):
    with pytest.raises(TypeError, match="b must hold real numbers, got complex128"):
        make(A).solve(np.zeros(N, dtype=complex))


@pytest.mark.parametrize("make", ALL)
def test_right_hand_sides_of_other_real_types_are_converted(make):
    factor, b = make(A), np.arange(N)
    np.testing.assert_array_equal(factor.solve(b), factor.solve(b.astype(float)))


@pytest.mark.parametrize("make", LIBRARIES)
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_matrix_that_is_not_finite_is_refused(make, bad):
    matrix = tridiagonal(5)
    matrix.data[3] = bad
    with pytest.raises(np.linalg.LinAlgError, match="A must be finite, but has entries that are"):
        make(matrix)


@pytest.mark.parametrize("make", ALL)
def test_a_matrix_without_unknowns_is_refused(make):
    with pytest.raises(ValueError, match=r"A must have at least one unknown, got shape \(0, 0\)"):
        make(csr_array((0, 0)))


def test_superlu_reports_a_singular_matrix():
    zero = tridiagonal(5)
    zero.data[:] = 0
    with pytest.raises(np.linalg.LinAlgError, match="has a pivot that is zero or lost in rounding"):
        superlu(zero)


def test_factors_say_what_they_store():
    assert repr(superlu(diags_array(np.ones(4)).tocsr())) == (
        "SuperLU(unknowns=4, entries per unknown=2.0, memory=0.0 MB)"  # L and U are the identity
    )
    assert repr(cholmod(tridiagonal(5))) == "CHOLMOD(unknowns=5)"


def test_the_direct_solver_factorises_every_time():
    solver, b = DirectSolver(partial(superlu, order=SPACE.elimination_order)), np.ones((N, 2))
    for weight in (1, 2, 3):
        x = solver.solve(weight * A, b, b)
        np.testing.assert_allclose(weight * (A @ x), b, rtol=0, atol=1e-12)
    assert repr(solver) == "DirectSolver(factorise=superlu, factorisations=3)"


def test_the_direct_solver_refuses_what_does_not_fit():
    with pytest.raises(ValueError, match=r"A must be square, got shape \(5, 4\)"):
        DirectSolver().solve(csr_array((5, 4)), np.zeros(5), np.zeros(5))
    with pytest.raises(ValueError, match=r"beside A of shape \(5, 5\), got \(4,\)"):
        DirectSolver().solve(tridiagonal(5), np.zeros(4), np.zeros(4))


@pytest.mark.parametrize("factorise", [superlu, cholmod])
def test_a_matrix_that_is_not_symmetric_is_refused(factorise):
    A = csr_array([[2.0, 0.5], [0.0, 2.0]])
    with pytest.raises(ValueError, match="is not symmetric"):
        factorise(A)


UNSORTED = csr_array((np.array([0.5, 2.0, 0.5, 2.0]), [1, 0, 0, 1], [0, 2, 4]))
TWICE = csr_array((np.array([1.0, 1.0, 0.5, 0.5, 2.0]), [0, 0, 1, 0, 1], [0, 3, 5]))


@pytest.mark.parametrize("A", [UNSORTED, TWICE], ids=["unsorted", "entries given twice"])
@pytest.mark.parametrize(("off", "refused"), [(0.0, False), (1e-10, False), (1e-8, True)])
def test_symmetry_is_one_of_values_to_rounding_however_they_are_stored(A, off, refused):
    A = A.copy()
    A.data[2] += off
    if refused:
        with pytest.raises(ValueError, match="is not symmetric"):
            superlu(A)
    else:
        assert superlu(A).solve(np.ones(2)) == pytest.approx([0.4, 0.4])


def test_matrices_of_elements_are_found_symmetric_without_a_difference(monkeypatch):
    """A difference of sparse matrices takes as long as a third of a small factorisation."""
    monkeypatch.setattr(csr_array, "__sub__", None, raising=False)
    superlu(A)


def test_what_factorise_returns_is_named():
    with pytest.raises(TypeError, match=r"factorise must return a Factor, .* got None"):
        DirectSolver(lambda A: None).solve(csr_array(np.eye(2)), np.ones(2), np.zeros(2))
