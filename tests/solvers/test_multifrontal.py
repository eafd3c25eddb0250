"""Factorisation by dense fronts: solves like SuperLU, in double precision to rounding."""

import numpy as np
import pytest
import trimesh
from scipy.sparse import diags_array
from scipy.sparse.linalg import spsolve

import esfem_core as ec
from esfem_core.solvers import Fronts, LaggedSolver, dissect, factorise
from esfem_core.solvers.multifrontal import HALVED, _inverse


def pieces():
    ball = ec.sphere("octahedron", 2)
    return trimesh.util.concatenate([ball, ball.copy().apply_translation([5, 0, 0])])


SPACES = {
    "linear": ec.SurfaceSpace(ec.sphere("octahedron", 4), 1),
    "quadratic": ec.SurfaceSpace(ec.sphere("icosahedron", 3), 2, ec.to_unit_sphere),
    "degree 5": ec.SurfaceSpace(ec.sphere("octahedron", 2), 5, ec.to_unit_sphere),
    "torus": ec.SurfaceSpace(ec.torus(1.0, 0.3, 24, 8), 3),
    "one part": ec.SurfaceSpace(ec.sphere("octahedron", 1), 1),
    "two pieces": ec.SurfaceSpace(pieces(), 3),
}


@pytest.fixture(params=SPACES)
def space(request):
    return SPACES[request.param]


def system(space, weight=10.0):
    M, A = space.mass_stiffness(space.nodes * [1, 1.3, 0.8])
    return weight * M + A


@pytest.mark.parametrize("columns", [(), (1,), (3,)])
def test_agrees_with_superlu(space, columns):
    A = system(space)
    b = np.random.default_rng(0).standard_normal((len(space.nodes), *columns))
    expected = spsolve(A.tocsc(), b).reshape(b.shape)
    x = factorise(A, space.fronts, dtype=np.float64).solve(b)
    assert x.shape == b.shape
    np.testing.assert_allclose(x, expected, rtol=0, atol=1e-13 * abs(expected).max())
    single = factorise(A, space.fronts, np.float32).solve(b)
    assert single.dtype == np.float64
    np.testing.assert_allclose(single, expected, rtol=0, atol=1e-5 * abs(expected).max())


@pytest.mark.parametrize("part_size", [1, 10, 1000, 10**6])
def test_the_size_of_the_parts_does_not_matter(part_size):
    space = SPACES["quadratic"]
    A = system(space)
    b = np.random.default_rng(0).standard_normal(len(space.nodes))
    fronts = Fronts(dissect(space.cells, space.nodes, part_size), space.cells, A)
    x = factorise(A, fronts, dtype=np.float64).solve(b)
    np.testing.assert_allclose(A @ x, b, rtol=0, atol=1e-12)


def test_fronts_eliminated_one_at_a_time_give_the_same(monkeypatch):
    """Also where the first one is padded and the next one, just behind it, is not."""
    ring = ec.torus(1.0, 0.3, 8, 8)  # as many triangles as the ball, but two nodes less
    ring.apply_translation([5, 0, 0])
    space = ec.SurfaceSpace(trimesh.util.concatenate([ec.sphere("octahedron", 2), ring]))
    A, b = system(space), np.random.default_rng(0).standard_normal(len(space.nodes))
    fronts = Fronts(dissect(space.cells, space.nodes, 128), space.cells, A)
    assert [batch.shape for batch in fronts.levels[1].batches] == [(2, 66, 66)]
    together = factorise(A, fronts, np.float64).solve(b)
    monkeypatch.setattr("esfem_core.solvers.multifrontal.RUN", 1)
    np.testing.assert_allclose(factorise(A, fronts, np.float64).solve(b), together, atol=1e-13)


@pytest.mark.parametrize("k", [1, HALVED, HALVED + 1, 2 * HALVED + 1, 100])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_matrices_inverted_half_by_half(k, dtype):
    half = np.random.default_rng(k).standard_normal((3, k, k))
    F = (half @ half.swapaxes(1, 2) + np.eye(k)).astype(dtype)
    inverse = _inverse(F)
    assert inverse.dtype == dtype
    scale = np.linalg.norm(F, 2, axis=(1, 2)) * np.linalg.norm(inverse, 2, axis=(1, 2))
    error = abs(inverse @ F - np.eye(k)).max(axis=(1, 2))
    assert (error < 10 * np.finfo(dtype).eps * scale).all()


def test_a_singular_block_is_refused():
    F = np.ones((1, 2 * HALVED, 2 * HALVED))
    with pytest.raises(np.linalg.LinAlgError, match="Singular"):
        _inverse(F)


@pytest.mark.parametrize("size", [1e-200, 1e-30, 1e30, 1e200])
def test_sizes_beyond_single_precision(size):
    """The factor is linear in A and in every right-hand side, however small or large."""
    space = SPACES["linear"]
    A, b = system(space), np.random.default_rng(0).standard_normal((len(space.nodes), 2))
    expected = factorise(A, space.fronts).solve(b)
    scaled = factorise(A, space.fronts).solve(b * [1, size])
    np.testing.assert_allclose(scaled, expected * [1, size], rtol=1e-5)
    scaled = factorise(size**0.5 * A, space.fronts).solve(b)
    np.testing.assert_allclose(scaled, expected / size**0.5, rtol=1e-5)


def test_zero_columns():
    space = SPACES["linear"]
    x = factorise(system(space), space.fronts).solve(np.zeros((len(space.nodes), 2)))
    assert (x == 0).all()


def test_the_matrix_is_left_alone():
    space = SPACES["quadratic"]
    A = system(space)
    data, b = A.data.copy(), np.ones(len(space.nodes))
    factorise(A, space.fronts).solve(b)
    np.testing.assert_array_equal(A.data, data)
    np.testing.assert_array_equal(b, 1)


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf])
def test_unsolvable_matrices_are_reported(value):
    space = SPACES["linear"]
    A = system(space)
    A.data[:] = value
    with pytest.raises(np.linalg.LinAlgError, match="must be positive definite and finite, but"):
        factorise(A, space.fronts)


def test_another_pattern_is_refused():
    space, other = SPACES["linear"], SPACES["quadratic"]
    with pytest.raises(ValueError, match="A must have the pattern that the fronts were made for"):
        factorise(system(other), space.fronts)
    with pytest.raises(ValueError, match=r"with \d+ entries; got shape .* with 1026"):
        factorise(diags_array(np.ones(len(space.nodes)), format="csr"), space.fronts)
    turned = system(space)[::-1][:, ::-1].tocsr()
    with pytest.raises(ValueError, match=r"made for, that of space\.pattern; got as many"):
        factorise(turned, space.fronts)


@pytest.mark.parametrize("dtype", [None, np.float32, np.float64])
def test_a_matrix_that_is_not_symmetric_is_refused(dtype):
    """Of two entries that mirror each other one is read, and another system would be solved."""
    space = SPACES["quadratic"]
    A = system(space)
    A.data[1] += 0.5
    with pytest.raises(ValueError, match="A must be symmetric and positive definite, but is not s"):
        factorise(A, space.fronts, dtype)


@pytest.mark.parametrize(("weight", "dtype"), [(1.0, np.float32), (1e-9, np.float64)])
def test_nearly_singular_matrices_are_kept_in_double_precision(weight, dtype):
    space = SPACES["quadratic"]
    A, b = system(space, weight), np.random.default_rng(0).standard_normal(len(space.nodes))
    np.testing.assert_array_equal(
        factorise(A, space.fronts).solve(b), factorise(A, space.fronts, dtype).solve(b)
    )


def test_what_is_singular_in_single_precision_alone_is_done_in_double():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 0))
    A, b = system(space), np.ones(len(space.nodes))
    rows = np.repeat(np.arange(len(b)), np.diff(A.indptr))
    A.data[(rows == 0) | (A.indices == 0)] = 0.0
    A.data[(rows == 0) & (A.indices == 0)] = b[0] = 1e-50  # zero in single precision
    with pytest.raises(np.linalg.LinAlgError, match="Singular"):
        factorise(A, space.fronts, np.float32)
    np.testing.assert_allclose(A @ factorise(A, space.fronts).solve(b), b, rtol=0, atol=1e-5)


@pytest.mark.parametrize("weight", [1.0, 1e-1, 1e-2, 1e-3, 1e-5])
def test_hubs_cost_no_iterations(weight):
    """Around them, single precision throughout would cost ten to thirty."""
    space = ec.SurfaceSpace(trimesh.creation.cylinder(1.0, 1e-3, sections=3000), 1)
    M, A = space.mass_stiffness(space.nodes)
    solver = LaggedSolver(factorise=lambda A: factorise(A, space.fronts))
    b = M @ np.random.default_rng(0).standard_normal(len(space.nodes))
    solver.solve(weight * M + A, b, np.zeros_like(b))
    assert solver.iterations <= 6
    assert solver.factorisations == 1


@pytest.mark.parametrize("dtype", [np.float16, int, complex, "double double"])
def test_other_precisions_are_refused(dtype):
    space = SPACES["linear"]
    with pytest.raises(ValueError, match="dtype must be float32, float64 or None, got "):
        factorise(system(space), space.fronts, dtype)


def test_precisions_have_several_names():
    space = SPACES["linear"]
    A, b = system(space), np.ones(len(space.nodes))
    expected = factorise(A, space.fronts, np.float64).solve(b)
    for dtype in (float, "float64", np.dtype("f8")):
        np.testing.assert_array_equal(factorise(A, space.fronts, dtype).solve(b), expected)


@pytest.mark.parametrize("in_double_first", [False, True])
def test_no_number_is_subnormal_where_a_solution_decays(in_double_first):
    """Processors take up to a hundred times as long for them: factorising took four times."""
    space = ec.SurfaceSpace(ec.sphere("octahedron", 5), 2, ec.to_unit_sphere)
    M, A = space.mass_stiffness(space.nodes)
    K = M + 1e-4 * A
    factor = factorise(K, space.fronts, np.float64 if in_double_first else np.float32)
    factor = factor.astype(np.dtype(np.float32))
    tiny = np.sqrt(np.finfo(np.float32).tiny)
    for block in factor._blocks:
        assert not ((block != 0) & (abs(block) < tiny)).any()
    x = factor.solve(np.eye(1, len(space.nodes))[0])
    assert (x == 0).sum() > len(x) / 10  # exp(-100) and less
    assert abs(x[x != 0]).min() * K.data.max() > tiny


def test_single_precision_takes_half_the_memory(space):
    n, stored = len(space.nodes), space.fronts.n_stored
    for dtype, size in ((np.float32, 4), (np.float64, 8)):
        assert repr(factorise(system(space), space.fronts, dtype)) == (
            f"BlockFactor(unknowns={n}, levels={len(space.fronts.levels)}, entries per unknown="
            f"{stored / n:.1f}, memory={stored * size / 1e6:.1f} MB, dtype={np.dtype(dtype)})"
        )
