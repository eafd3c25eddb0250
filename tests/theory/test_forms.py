"""Forms: known matrices, rates of change as difference quotients, lifts in a second way."""

import naive
import numpy as np
import pytest
from scipy.sparse import block_diag, diags_array

import esfem_core as ec
from esfem_core.surfaces.exact_surfaces import (
    Ellipsoid,
    ExactSurface,
    LevelSet,
    Near,
    Sphere,
    Torus,
)
from esfem_core.theory import forms

RNG = np.random.default_rng(5)


def torus_space(degree, n=10, exactness=None):
    return ec.SurfaceSpace(ec.torus(1.0, 0.4, 2 * n, n), degree, Torus().closest, exactness)


def close(A, B, tolerance=1e-13):
    return abs(A - B).max() <= tolerance * abs(B).max()


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_without_weights_they_are_mass_and_stiffness(degree):
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), degree, ec.to_unit_sphere)
    M, A = naive.mass_stiffness(space, space.nodes)
    assert close(forms.mass(space, space.nodes).toarray(), M)
    assert close(forms.stiffness(space, space.nodes).toarray(), A)
    tensor = np.broadcast_to(2 * np.eye(3), (len(space.cells), len(space.rule.weights), 3, 3))
    assert close(forms.stiffness(space, space.nodes, tensor).toarray(), 2 * A)


def test_weights_and_tensors_weigh_the_integrands():
    space = torus_space(2)
    x, w, z = space.nodes, *RNG.normal(size=(2, len(space.nodes)))
    shape = len(space.cells), len(space.rule.weights)
    weight, half = RNG.normal(size=shape), RNG.normal(size=(*shape, 3, 3))
    tensor = half + np.swapaxes(half, 2, 3)
    flux = np.einsum("tqij,tqj->tqi", tensor, space.gradient(x, z))
    for found, values in [
        (w @ forms.mass(space, x, weight) @ z, weight * space.evaluate(w) * space.evaluate(z)),
        (w @ forms.stiffness(space, x, tensor) @ z, np.sum(space.gradient(x, w) * flux, axis=-1)),
    ]:
        np.testing.assert_allclose(found, space.integrate(x, values), rtol=1e-11)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_rates_are_difference_quotients_of_the_matrices(degree):
    space = torus_space(degree)
    x, v = space.nodes, 0.1 * RNG.normal(size=space.nodes.shape)
    s = 1e-5
    (M1, A1), (M0, A0) = space.mass_stiffness(x + s * v), space.mass_stiffness(x - s * v)
    assert close((M1 - M0) / (2 * s), forms.mass_rate(space, x, v), 1e-6)
    assert close((A1 - A0) / (2 * s), forms.stiffness_rate(space, x, v), 1e-6)


@pytest.mark.parametrize(
    ("tri", "surface", "area"),
    [
        (ec.sphere("icosahedron", 1), Sphere(), 4 * np.pi),
        (ec.torus(1.0, 0.4, 20, 8), Torus(), 1.6 * np.pi**2),
    ],
)
def test_lifted_mass_is_exact_on_constants(tri, surface, area):
    """The area of Γ without any error of the geometry."""
    for degree in (1, 2):
        space = ec.SurfaceSpace(tri, degree, surface.closest, exactness=16)
        onto = forms.lift(space, space.nodes, surface)
        assert forms.mass(space, space.nodes, onto.ratio).sum() == pytest.approx(area, rel=1e-7)


@pytest.mark.parametrize("surface", [Sphere(), Torus(), Ellipsoid((1.3, 1.0, 0.8))])
def test_lifted_gradients_are_those_of_the_surface(surface):
    """Of w(y) = F(p(y)) the gradient on Γ_h leads back to the tangential gradient of F."""
    if isinstance(surface, Torus):
        tri = ec.torus(1.0, 0.4, 20, 8)
    else:
        tri = ec.sphere("icosahedron", 1)
        tri.vertices = surface.closest(tri.vertices)
    space = ec.SurfaceSpace(tri, 2, surface.closest)
    x = space.nodes
    onto, y, h = forms.lift(space, x, surface), space.quadrature_points(x), 1e-5

    def F(p):
        return np.sin(p[..., 0]) + p[..., 1] * p[..., 2]

    shifts = h * np.eye(3)[:, None, None]
    ambient = np.stack(F(surface.closest(y + shifts)) - F(surface.closest(y - shifts)), axis=-1)
    ambient /= 2 * h
    normal_h = space.normals(x)
    on_discrete = ambient - np.sum(ambient * normal_h, axis=-1, keepdims=True) * normal_h
    p = onto.points
    exact = np.stack([np.cos(p[..., 0]), p[..., 2], p[..., 1]], axis=-1)
    exact -= np.sum(exact * onto.normal, axis=-1, keepdims=True) * onto.normal
    lifted = np.einsum("tqij,tqj->tqi", onto.gradient, on_discrete)
    np.testing.assert_allclose(lifted, exact, atol=1e-8)


def test_lifted_ratio_is_that_of_the_lifted_tangents():
    space, surface = torus_space(1), Torus()
    x, h = space.nodes, 1e-5
    onto = forms.lift(space, x, surface)
    y, a, b, c = space.quadrature_points(x), *np.moveaxis(x[space.cells], 1, 0)
    tangents = [
        (surface.closest(y + h * t[:, None]) - surface.closest(y - h * t[:, None])) / (2 * h)
        for t in (b - a, c - a)
    ]
    area = np.linalg.norm(np.cross(*tangents), axis=-1)
    np.testing.assert_allclose(onto.ratio, area / space.density(x), rtol=1e-8)


def test_the_tensor_of_a_lift_gives_the_energy_of_lifted_gradients():
    space = torus_space(1)
    onto = forms.lift(space, space.nodes, Torus())
    g = RNG.normal(size=onto.points.shape)
    lifted = np.einsum("tqij,tqj->tqi", onto.gradient, g)
    energy = np.einsum("tqi,tqij,tqj->tq", g, onto.tensor, g)
    np.testing.assert_allclose(energy, onto.ratio * (lifted**2).sum(axis=-1), rtol=1e-12)


def test_relative_norm_of_dense_and_large_matrices_agree(monkeypatch):
    monkeypatch.setattr(forms, "DENSE", 100)
    space = torus_space(2, 5)
    x, v = space.nodes, RNG.normal(size=space.nodes.shape)
    M, A = space.mass_stiffness(x)
    assert len(x) > forms.DENSE
    for form, norm, seminorm in (
        (forms.mass_rate(space, x, v), M, False),
        (forms.stiffness_rate(space, x, v), A, True),
    ):
        large = forms.relative_norm(form, norm, seminorm)
        cut = int(seminorm)
        dense = np.linalg.eigvals(
            np.linalg.solve(norm.toarray()[cut:, cut:], form.toarray()[cut:, cut:])
        )
        assert large == pytest.approx(np.abs(dense).max(), rel=1e-9)


def test_the_relative_norm_is_the_largest_size_also_if_that_is_negative(monkeypatch):
    form, norm = diags_array(np.linspace(-3, 1, 200)).tocsr(), diags_array(np.ones(200)).tocsr()
    for dense in (1000, 100):
        monkeypatch.setattr(forms, "DENSE", dense)
        assert forms.relative_norm(form, norm) == pytest.approx(3, rel=1e-8)


def test_relative_norm_is_attained_by_no_larger_product():
    space = torus_space(1)
    x, v = space.nodes, RNG.normal(size=space.nodes.shape)
    M, Q = forms.mass(space, x), forms.mass_rate(space, x, v)
    c = forms.relative_norm(Q, M)
    for _ in range(50):
        w, z = RNG.normal(size=(2, len(x)))
        assert abs(w @ Q @ z) <= c * ec.errors.seminorm(M, w) * ec.errors.seminorm(M, z)
    assert c <= np.abs(forms.divergence(space, x, v)).max() * (1 + 1e-12)


def test_coefficients_of_another_shape_are_refused():
    space = torus_space(1)
    x, one = space.nodes, np.ones((3, 3))
    with pytest.raises(ValueError, match=r"weight must have shape \(400, 3\), got \(3, 3\)"):
        forms.mass(space, x, one)
    with pytest.raises(ValueError, match=r"weight must be finite, but weight\[0, 0\] is nan"):
        forms.mass(space, x, np.full((400, 3), np.nan))
    with pytest.raises(ValueError, match=r"tensor must have shape \(400, 3, 3, 3\)"):
        forms.stiffness(space, x, one)
    with pytest.raises(ValueError, match="tensor must be symmetric, but entries"):
        forms.stiffness(space, x, np.broadcast_to(np.triu(one), (400, 3, 3, 3)))


@pytest.mark.parametrize(
    "function", [forms.divergence, forms.deformation, forms.mass_rate, forms.stiffness_rate]
)
def test_velocities_are_finite_and_have_three_components(function):
    space = torus_space(1)
    x, n = space.nodes, len(space.nodes)
    for v in (x[:, 0], x[:, :2], np.ones((n, 3, 3)), x[1:]):
        with pytest.raises(ValueError, match=rf"v must have shape \({n}, 3\), got"):
            function(space, x, v)
    with pytest.raises(ValueError, match=r"v must be finite, but v\[0, 0\] is inf"):
        function(space, x, np.full((n, 3), np.inf))


def test_the_relative_norm_of_zero_is_zero(monkeypatch):
    space = torus_space(1, 5)
    M, _ = space.mass_stiffness(space.nodes)
    for dense in (forms.DENSE, 10):
        monkeypatch.setattr(forms, "DENSE", dense)
        assert forms.relative_norm(M - M, M) == 0


def test_forms_without_a_relative_norm_are_refused():
    space = torus_space(1)
    x = space.nodes
    M, A = space.mass_stiffness(x)
    with pytest.raises(ValueError, match="must have one shape"):
        forms.relative_norm(M[1:, 1:], M)
    one_sided = M.copy()
    one_sided[0, 1] += 1.0
    with pytest.raises(ValueError, match="form must be symmetric"):
        forms.relative_norm(one_sided, M)
    with pytest.raises(ValueError, match="form must vanish on constants"):
        forms.relative_norm(M, A, seminorm=True)


@pytest.mark.parametrize("dense", [0, 1000])
def test_norms_that_are_none_are_refused_whatever_their_size(monkeypatch, dense):
    monkeypatch.setattr(forms, "DENSE", dense)
    space = torus_space(1)
    M, A = space.mass_stiffness(space.nodes)
    one_sided = M.copy()
    one_sided[0, 1] += 1.0
    for norm in (-M, A, 0 * M, A - M):
        with pytest.raises(ValueError, match="norm must be positive definite, but has the pivot"):
            forms.relative_norm(M, norm)
    with pytest.raises(ValueError, match="norm must be symmetric"):
        forms.relative_norm(M, one_sided)
    with pytest.raises(ValueError, match="seminorm=True norm must vanish on constants, but does"):
        forms.relative_norm(A, M + A, seminorm=True)
    apart = block_diag([A, A], "csr")
    with pytest.raises(ValueError, match=r"constants only, but vanishes .* each of 2 components"):
        forms.relative_norm(apart, apart, seminorm=True)
    with pytest.raises(ValueError, match=r"form must have 2 rows or more, got shape \(1, 1\)"):
        forms.relative_norm(0 * M[:1, :1], 0 * M[:1, :1], seminorm=True)


@pytest.mark.parametrize(
    ("returned", "message"),
    [
        (lambda x: None, r"surface.near\(x\) must be a Near, got None"),
        (lambda x: Near(x, x[..., 0], x[..., :2], np.eye(3)), r"near\(x\).normal must have shape"),
        (lambda x: Near(x, x[..., 0] / 0, x, np.eye(3)), r"near\(x\).distance must be finite"),
    ],
)
@pytest.mark.filterwarnings("ignore:divide by zero", "ignore:invalid value")
def test_a_surface_of_ones_own_must_say_what_a_lift_needs(returned, message):
    class Own(ExactSurface):
        def near(self, x):
            return returned(x)

    space = ec.SurfaceSpace(ec.sphere("octahedron", 0))
    with pytest.raises((TypeError, ValueError), match=message):
        forms.lift(space, space.nodes, Own())


def test_a_surface_that_is_oriented_the_other_way_has_no_lift():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)
    inside_out = LevelSet(lambda x: 1 - (x**2).sum(axis=1))
    with pytest.raises(ValueError, match=r"surface must be oriented as .* normals is -"):
        forms.lift(space, space.nodes, inside_out)


@pytest.mark.parametrize(
    ("form", "more"),
    [("mass", 0), ("stiffness", 0), ("divergence", 1), ("deformation", 1), ("mass_rate", 1)],
)  # fmt: skip
def test_forms_need_a_space(form, more):
    x = np.eye(3)
    with pytest.raises(TypeError, match="space must be a SurfaceSpace, got 3"):
        getattr(ec.forms, form)(3, x, *[x] * more)
