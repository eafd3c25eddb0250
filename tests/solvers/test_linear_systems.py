"""What a linear system may be made of, and which solutions of it are refused."""

from typing import ClassVar

import numpy as np
import pytest
from scipy.sparse import block_diag, csr_array

import esfem_core as ec
from esfem_core.solvers import (
    DirectSolver,
    LaggedSolver,
    factorise,
    require_small_residual,
    superlu,
)

SPACE = ec.SurfaceSpace(ec.sphere("octahedron", 2), 2, ec.to_unit_sphere)
M, A = SPACE.mass_stiffness(SPACE.nodes)
N = len(SPACE.nodes)
SOLVERS = [DirectSolver, LaggedSolver]
LOST = "must be (symmetric and )?positive definite, but"

CONSTANTS = csr_array([[1.0, -1.0], [-1.0, 1.0]])  # takes them to zero


class TestASingularMatrix:
    """Where b is not in its range, x grows until any residual is one of rounding."""

    @pytest.mark.parametrize("solver", SOLVERS)
    @pytest.mark.parametrize("columns", [(), (3,)])
    def test_is_refused_with_a_right_hand_side_out_of_its_range(self, solver, columns):
        b = np.ones((N, *columns))
        with pytest.raises(np.linalg.LinAlgError, match=LOST):
            solver().solve(A, b, np.zeros_like(b))

    @pytest.mark.parametrize("solver", SOLVERS)
    def test_is_refused_if_sums_are_zero_on_the_whole_but_not_on_each_component(self, solver):
        two = csr_array(block_diag([A, A]))
        b = np.repeat([1.0, -1.0], N)
        with pytest.raises(np.linalg.LinAlgError, match=LOST):
            solver().solve(two, b, np.zeros_like(b))

    def test_is_refused_if_one_column_among_larger_ones_is_out_of_range(self):
        b = np.column_stack([[1e3, -1e3], [1.0, 1.0]])
        x = np.column_stack([[500.0, -500.0], [1e16, 1e16 + 2]])
        with pytest.raises(np.linalg.LinAlgError, match=r"x leaves 2 of b.*add a multiple"):
            require_small_residual(CONSTANTS, b, x)

    def test_solves_a_right_hand_side_in_its_range(self):
        b = M @ SPACE.nodes[:, 0] ** 3
        b -= b.mean()
        x = DirectSolver().solve(A, b, b)
        np.testing.assert_allclose(A @ x, b, rtol=0, atol=1e-12 * abs(b).max())

    @pytest.mark.parametrize("size", [0.0, 1e-17])
    def test_is_no_matter_where_a_right_hand_side_is_zero_but_for_rounding(self, size):
        """As that of a law that subtracts the mean of u, where u is uniform."""
        require_small_residual(CONSTANTS, np.full(2, size), np.array([1.0, 1.0 + 2e-16]))

    def test_is_no_matter_in_a_law_that_subtracts_the_mean(self):
        """Of a u that is uniform, on a surface ten times as large."""

        class Potential:
            species: ClassVar = {}

            def velocity(self, at, new, tau, past, solve):
                w = solve(at.A, at.load(at.u - at.mean(at.u)))
                return at.x * (w - w.mean())[:, None]

        tri = ec.sphere("octahedron", 3)
        tri.apply_scale(10)
        space = ec.SurfaceSpace(tri, 2)
        problem = ec.Problem(species={"u": ec.Species(1.0)}, law=Potential())
        *_, last = ec.evolve(space, problem, 1, 0.01, 0.02, solver="direct")
        np.testing.assert_allclose(last.u, 1.0, rtol=1e-6)

    def test_in_a_law_of_ones_own_stops_the_run(self):
        class Potential:
            species: ClassVar = {}

            def velocity(self, at, new, tau, past, solve):
                w = solve(at.A, at.load(np.ones(at.density.shape)))
                return at.x * w[:, None]

        problem = ec.Problem(species={"u": ec.Species(1.0)}, law=Potential())
        for options in ({}, {"solver": "direct"}):
            with pytest.raises(ec.EvolutionError, match=LOST):
                list(ec.evolve(SPACE, problem, 1, 0.1, 0.1, **options))


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_needle_costs_no_digit_of_the_solution(solver):
    """Its entries of the matrix are 1e4 times as large, and the residual there half of b."""
    tri = ec.sphere("octahedron", 3)
    i = int(np.argmax(tri.vertices[:, 0]))
    end = tri.vertices[tri.vertex_neighbors[i][0]]
    x = np.array(tri.vertices)
    x[i] = end + 1e-4 * (x[i] - end)
    mass, stiffness = ec.SurfaceSpace.from_nodes(x, tri.faces).mass_stiffness(x)
    b = mass @ (1 + x[:, 0])
    w = solver().solve(mass + 1e10 * stiffness, b, 0 * b)
    np.testing.assert_allclose(w, b.sum() / mass.sum(), rtol=0.05)


@pytest.mark.parametrize("rtol", [0.5, 1e-3])
def test_a_loose_residual_that_was_asked_for_is_none_that_is_lost(rtol):
    K = M + 1e9 * A
    b = M @ (1 + SPACE.nodes[:, 0])
    w = LaggedSolver(rtol).solve(K, b, 0 * b)
    assert np.linalg.norm(b - K @ w) <= rtol * np.linalg.norm(b)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize(
    ("dtype", "message"),
    [
        (complex, "A must hold real numbers, got complex128"),
        (bool, "A must hold real numbers, got bool"),
        (np.int16, "A must hold numbers of double precision, got int16: A.astype.float. has"),
        (np.float32, "A must hold numbers of double precision, got float32: A.astype.float. has"),
    ],
)
def test_matrices_of_other_numbers_are_refused_by_name(solver, dtype, message):
    with pytest.raises(TypeError, match=message):
        solver().solve((M + A).astype(dtype), np.ones(N), np.ones(N))
    with pytest.raises(TypeError, match=message):
        superlu((M + A).astype(dtype))


def test_a_block_factor_of_a_complex_matrix_is_refused():
    with pytest.raises(TypeError, match="A must hold real numbers, got complex128"):
        factorise((M + A).astype(complex), SPACE.fronts)


@pytest.mark.parametrize("solver", SOLVERS)
def test_integers_are_numbers_as_good_as_any(solver):
    K = (100 * (M + A)).astype(int) + csr_array(100 * np.eye(N, dtype=int))
    x = solver().solve(K, np.ones(N), np.zeros(N))
    np.testing.assert_allclose(K @ x, 1.0, rtol=0, atol=1e-9)


@pytest.mark.parametrize("solver", SOLVERS)
def test_no_right_hand_side_has_no_solution(solver):
    assert solver().solve(M, np.zeros((N, 0)), np.zeros((N, 0))).shape == (N, 0)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_an_answer_that_is_not_finite_is_none(bad):
    with pytest.raises(np.linalg.LinAlgError, match="a relative residual of nan"):
        require_small_residual(csr_array(np.eye(2)), np.ones(2), np.array([bad, 1.0]))


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_solution_that_overflows_is_refused(solver):
    b = np.full(N, 1e307)
    with pytest.raises((FloatingPointError, np.linalg.LinAlgError)), np.errstate(all="ignore"):
        solver().solve(M, b, 0 * b)


def test_a_matrix_whose_squares_are_infinite_is_not_blamed_on_definiteness():
    """Nor is a guess accepted, whatever the residual."""
    message = "the numbers of A must be at most 1e150, so that .* got .*e.200"
    for rhs, guess in ((1.0, 0.0), (1e90, 1e-82)):
        with pytest.raises(np.linalg.LinAlgError, match=message):
            LaggedSolver().solve(1e200 * (M + A), np.full(N, rhs), np.full(N, guess))
