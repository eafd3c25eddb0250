"""Matrices and loads: exact integrals, invariants, laws of scaling, a second way to compute."""

from fractions import Fraction
from math import factorial

import naive
import numpy as np
import pytest
import sympy
import trimesh

import esfem_core as ec
from esfem_core.elements import node_indices, tabulate, triangle_rule
from esfem_core.elements.integrals import ElementTables
from esfem_core.surfaces import FLATTEST

XI, ETA = sympy.symbols("xi eta")


def exact_element_matrices(degree, triangle):
    """Mass and stiffness matrix of an affine triangle, integrated exactly by sympy."""
    nodes = [
        (sympy.Rational(int(i), degree), sympy.Rational(int(j), degree))
        for _, i, j in node_indices(degree)
    ]
    powers = [(i, m - i) for m in range(degree + 1) for i in range(m + 1)]
    vandermonde = sympy.Matrix([[x**i * y**j for i, j in powers] for x, y in nodes])
    monomials = sympy.Matrix([XI**i * ETA**j for i, j in powers])
    basis = [sympy.Poly(e, XI, ETA) for e in (vandermonde.inv().T * monomials)]

    def integral(poly):
        return sum(
            Fraction(int(c.p), int(c.q))
            * Fraction(factorial(i) * factorial(j), factorial(i + j + 2))
            for (i, j), c in poly.terms()
        )

    a, b, c = triangle
    t1, t2 = b - a, c - a
    E, F, G = t1 @ t1, t1 @ t2, t2 @ t2
    s = np.sqrt(E * G - F * F)
    d1, d2 = [p.diff(XI) for p in basis], [p.diff(ETA) for p in basis]
    n = len(basis)
    M, A = np.empty((2, n, n))
    for i in range(n):
        for j in range(n):
            M[i, j] = s * float(integral(basis[i] * basis[j]))
            k11, k22 = integral(d1[i] * d1[j]), integral(d2[i] * d2[j])
            k12 = integral(d1[i] * d2[j]) + integral(d2[i] * d1[j])
            A[i, j] = (G * float(k11) - F * float(k12) + E * float(k22)) / s
    return M, A


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_affine_element_is_exact(degree):
    triangle = np.array([[0.3, -0.2, 1.0], [1.1, 0.4, 0.7], [-0.1, 0.9, 1.6]])
    M, A = exact_element_matrices(degree, triangle)
    rule = triangle_rule(2 * degree)
    tables = ElementTables(tabulate(degree, rule.points), rule)
    nodes = node_indices(degree) / degree @ triangle
    mass, stiffness = tables.mass_stiffness(tables.metric(nodes.T[:, :, None]))
    i, j = tables.pairs
    np.testing.assert_allclose(mass[:, 0], M[i, j], rtol=0, atol=1e-14 * abs(M).max())
    np.testing.assert_allclose(stiffness[:, 0], A[i, j], rtol=0, atol=1e-13 * abs(A).max())


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5])
def test_agrees_with_the_textbook_assembly(degree):
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), degree, ec.to_unit_sphere)
    x = space.nodes * [1.0, 1.3, 0.8] + 0.1 * np.sin(3 * space.nodes[:, [1, 2, 0]])
    M, A = space.mass_stiffness(x)
    M_naive, A_naive = naive.mass_stiffness(space, x)
    rounding = 1e-13 if degree < 5 else 3e-13  # basis functions of degree 5 cancel more
    np.testing.assert_allclose(M.toarray(), M_naive, rtol=0, atol=rounding * abs(M_naive).max())
    np.testing.assert_allclose(A.toarray(), A_naive, rtol=0, atol=rounding * abs(A_naive).max())


@pytest.fixture(scope="module", params=[1, 2, 3, 4])
def space(request):
    return ec.SurfaceSpace(ec.sphere("icosahedron", 3), request.param, ec.to_unit_sphere)


def test_symmetric_with_constants_in_the_kernel(space):
    M, A = space.mass_stiffness(space.nodes)
    for matrix in (M, A):
        assert abs(matrix - matrix.T).max() == 0
    assert abs(A @ np.ones(len(space.nodes))).max() < 1e-13
    assert (A.diagonal() > 0).all()


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_orders_of_area_and_rayleigh_quotient(degree):
    """1'M1 -> 4 pi and (u'Au)/(u'Mu) -> 12 for u = x1 x2 x3.

    The area has order k + 1 for odd k; for even k the sphere gives one more. Rayleigh quotients
    double the order 2k of the energy error, but the geometry's order k + 1 (k + 2) stays.
    """
    expected = degree + 1 if degree % 2 else degree + 2
    h, area, quotient = [], [], []
    for refinements in (2, 3, 4) if degree < 3 else (2, 3):
        space = ec.SurfaceSpace(ec.sphere("icosahedron", refinements), degree, ec.to_unit_sphere)
        M, A = space.mass_stiffness(space.nodes)
        u = space.nodes.prod(axis=1)
        h.append(space.mesh_size(space.nodes))
        area.append(abs(M.sum() - 4 * np.pi))
        quotient.append(abs((u @ (A @ u)) / (u @ (M @ u)) - 12))
    assert ec.study.observed_orders(h, area)[-1] == pytest.approx(expected, abs=0.15)
    assert ec.study.observed_orders(h, quotient)[-1] == pytest.approx(expected, abs=0.6)


def test_scaling_and_rigid_motion(space):
    M, A = space.mass_stiffness(space.nodes)
    rotation = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])[:3, :3]
    M2, A2 = space.mass_stiffness(2.5 * space.nodes @ rotation.T + [3, -1, 2])
    assert abs(M2 - 2.5**2 * M).max() < 1e-14 * abs(M2).max() * 20
    assert abs(A2 - A).max() < 1e-13 * abs(A).max()


def test_pattern_is_shared_and_data_fresh(space):
    M, A = space.mass_stiffness(space.nodes)
    M2, _ = space.mass_stiffness(2 * space.nodes)
    assert np.shares_memory(M.indices, A.indices)
    assert np.shares_memory(M.indices, M2.indices)
    assert not np.shares_memory(M.data, M2.data)
    assert M.has_sorted_indices
    before = M.data.copy()
    M2.data[:] = 0
    np.testing.assert_array_equal(M.data, before)


def test_no_matrix_can_change_the_pattern_of_the_others(space):
    M, _ = space.mass_stiffness(space.nodes)
    before = M.copy()
    M.data[1] = 0
    with pytest.raises(ValueError, match="read-only"):
        M.eliminate_zeros()
    with pytest.raises(ValueError, match="read-only"):
        M.indices[0] = 1
    again = space.mass(space.nodes)
    np.testing.assert_array_equal(again.indices, before.indices)
    np.testing.assert_array_equal(again.data, before.data)
    before.data[1] = 0
    before.eliminate_zeros()  # a copy is one's own
    assert before.nnz == space.pattern.nnz - 1


@pytest.mark.parametrize("trailing", [(), (3,), (2, 3), (0,), (2, 0)])
def test_load_is_the_integral_against_the_basis(space, trailing):
    """With nodal functions for values, load(evaluate(u)) = M u, for every component."""
    rng = np.random.default_rng(0)
    u = rng.standard_normal((len(space.nodes), *trailing))
    M, _ = space.mass_stiffness(space.nodes)
    b = space.load(space.nodes, space.evaluate(u))
    assert b.shape == u.shape
    expected = (M @ u.reshape(len(u), -1)).reshape(u.shape)
    np.testing.assert_allclose(b, expected, rtol=0, atol=1e-14)


def test_gradient_gives_the_stiffness_and_is_tangential(space):
    rng = np.random.default_rng(0)
    u, w = rng.standard_normal((2, len(space.nodes)))
    x = space.nodes * [1, 1.2, 0.7]
    _, A = space.mass_stiffness(x)
    grad_u, grad_w = space.gradient(x, u), space.gradient(x, w)
    density = np.einsum("tqi,tqi->tq", grad_u, grad_w)
    energy = space.load(x, density).sum()
    assert energy == pytest.approx(u @ (A @ w), rel=1e-12, abs=1e-11 * abs(u @ (A @ u)))
    normals = space.normals(x)
    assert abs(np.einsum("tqi,tqi->tq", grad_u, normals)).max() < 1e-11 * abs(grad_u).max()
    np.testing.assert_allclose(np.linalg.norm(normals, axis=2), 1, atol=1e-14)


def test_gradient_of_the_position_is_the_tangential_projection(space):
    """Grad x_Γ = I - nu nu^T: every component of a vector field, with the derivative last."""
    x = space.nodes * [1, 1.2, 0.7] + 0.3
    nu = space.normals(x)
    projection = np.eye(3) - nu[..., :, None] * nu[..., None, :]
    np.testing.assert_allclose(space.gradient(x, x), projection, atol=1e-12)
    skew = space.gradient(x, x @ np.array([[0, 1, 0], [0, 0, 0], [0, 0, 0]]))  # only component 1
    np.testing.assert_allclose(skew[..., 1, :], projection[..., 0, :], atol=1e-12)
    assert abs(skew[..., [0, 2], :]).max() < 1e-12


def test_normals_point_outwards(space):
    points = space.quadrature_points(space.nodes)
    assert (np.einsum("tqi,tqi->tq", space.normals(space.nodes), points) > 0.9).all()


def test_divergence_theorem(space):
    """Int x . nu = 3 volume, and int nu = 0 on a closed surface."""
    x = space.nodes
    nu, points = space.normals(x), space.quadrature_points(x)
    assert abs(space.load(x, nu).sum(axis=0)).max() < 1e-13
    volume = space.load(x, np.einsum("tqi,tqi->tq", points, nu)).sum() / 3
    assert volume == pytest.approx(4 / 3 * np.pi, rel=0.02 if space.degree == 1 else 1e-4)


def test_chunks_do_not_show(space, monkeypatch):
    whole = space.mass_stiffness(space.nodes)
    monkeypatch.setattr("esfem_core.elements.integrals.CHUNK", 777)
    tri = ec.sphere("icosahedron", 3)
    small_chunks = ec.SurfaceSpace(tri, space.degree, ec.to_unit_sphere)
    for matrix, expected in zip(small_chunks.mass_stiffness(space.nodes), whole, strict=True):
        np.testing.assert_allclose(matrix.data, expected.data, rtol=1e-13)


@pytest.mark.parametrize("method", ["mass_stiffness", "normals"])
def test_lost_element_is_named(space, method):
    x = space.nodes.copy()
    x[space.cells[41]] = x[space.cells[41]].mean(axis=0)
    with pytest.raises(ec.DegenerateElementError, match=r"element \d+ near .* is degenerate") as e:
        getattr(space, method)(x)
    assert set(space.cells[e.value.element]) & set(space.cells[41])
    x[space.cells[41, 0]] = np.nan
    with pytest.raises(ec.DegenerateElementError, match="is not finite"):
        getattr(space, method)(x)


@pytest.mark.parametrize("size", [1e-120, 1e120])
def test_tiny_and_huge_surfaces_are_no_degenerate_ones(space, size):
    _, A = space.mass_stiffness(space.nodes)
    for scaled in space.mass_stiffness(size**0.5 * space.nodes):
        assert np.isfinite(scaled.data).all()
    np.testing.assert_allclose(scaled.data, A.data, atol=1e-12)


def test_overflow_is_reported(space):
    with pytest.raises(ec.DegenerateElementError, match="element 0"):
        space.mass_stiffness(1e200 * space.nodes)


@pytest.mark.parametrize(("share", "good"), [(1.1, True), (0.9, False)])
def test_the_limit_of_flatness_is_that_for_triangulations(share, good):
    """A corner near a side: 4 sqrt(3) area is FLATTEST times the sum of squared sides there."""
    tri = ec.sphere("octahedron", 1)
    space = ec.SurfaceSpace(tri)
    x = space.nodes.copy()
    a, b, c = space.cells[0]
    side = x[c] - x[b]
    height = share * FLATTEST * 1.5 / (2 * np.sqrt(3)) * np.linalg.norm(side)
    across = np.cross(side, tri.face_normals[0])
    x[a] = (x[b] + x[c]) / 2 + height * across / np.linalg.norm(across)
    if good:
        assert np.isfinite(space.mass_stiffness(x)[1].data).all()
        return
    with pytest.raises(ec.DegenerateElementError, match=r"element 0 near .* is degenerate"):
        space.mass_stiffness(x)
