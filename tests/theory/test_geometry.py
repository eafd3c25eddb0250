"""Errors of the geometry: spheres of another radius, where all is known, and a torus."""

import numpy as np
import pytest

import esfem_core as ec
from esfem_core.surfaces.exact_surfaces import Ellipsoid, Sphere, Torus
from esfem_core.theory import forms, geometry


def linear(x):
    return x[..., 2]


def linear_gradient(x):
    return 0 * x + [0.0, 0.0, 1.0]


def errors(space, radius):
    return geometry.geometric_errors(
        space,
        lambda t: Sphere(radius * (1 + t)),
        lambda x, t: (1 + t) * x,
        lambda x: x,
        linear,
        linear_gradient,
    )


def test_the_errors_of_a_sphere_of_another_radius_are_known():
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), 3, ec.to_unit_sphere, exactness=8)
    found = errors(space, 2.0)
    # points of the unit sphere are 1 away from the sphere of radius 2, whose area is four times
    # as large; a Dirichlet integral does not see the scaling
    assert abs(found.distance - 1) < 1e-3
    assert abs(found.m - 3) < 1e-2
    assert found.a < 1e-2
    assert found.normal < 1e-2
    assert found.velocity < 1e-12
    assert abs(found.u_l2 / np.sqrt(4 / 3 * np.pi * 4) - 1) < 1e-3  # lifts of x3 are x3 / 2
    slope = np.sqrt(8 / 3 * np.pi * 4)  # of x3, over the sphere of radius 2
    assert found.u_h1 == pytest.approx(slope / 2, rel=1e-3)
    assert found.b == pytest.approx(slope, rel=1e-3)  # B is twice the projection
    assert found.q == pytest.approx(6, rel=1e-2)  # the rate of 4 (1 + t)^2 - (1 + t)^2


def test_functions_may_write_into_the_points_that_they_are_given():
    def spoilt(function):
        def writing(x, *t):
            returned = np.array(function(x, *t))
            x *= 2
            return returned

        return writing

    space = ec.SurfaceSpace(ec.sphere("icosahedron", 0), 2, ec.to_unit_sphere)
    given = (lambda x, t: (1 + t) * x, lambda x: x, linear, linear_gradient)
    writing = geometry.geometric_errors(space, lambda t: Sphere(1 + t), *map(spoilt, given))
    np.testing.assert_allclose(writing, errors(space, 1.0), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("degree", [1, 2])
def test_they_fall_with_the_mesh_size(degree):
    coarse, fine = (
        errors(ec.SurfaceSpace(ec.sphere("icosahedron", n), degree, ec.to_unit_sphere), 1.0)
        for n in (1, 2)
    )
    for name in ("distance", "normal", "m", "a", "q", "u_l2", "u_h1", "b", "m_smooth"):
        assert getattr(fine, name) < 0.6 * getattr(coarse, name), name


def test_m_smooth_is_the_difference_of_the_integrals_over_both_surfaces():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)
    nodal = linear(space.nodes)
    onto = geometry.lift(space, space.nodes, Sphere())
    on_exact = geometry.lifted_norm(space, space.nodes, onto, space.evaluate(nodal)) ** 2
    on_discrete = nodal @ (space.mass(space.nodes) @ nodal)
    assert errors(space, 1.0).m_smooth == pytest.approx(abs(on_exact - on_discrete), rel=1e-10)


def test_a_smooth_is_the_difference_of_the_energies_over_both_surfaces():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 2))
    x, nodal = space.nodes, linear(space.nodes)
    onto = geometry.lift(space, x, Sphere())
    lifted = geometry.apply(onto.gradient, space.gradient(x, nodal))
    on_exact = geometry.lifted_norm(space, x, onto, lifted) ** 2
    on_discrete = nodal @ (space.mass_stiffness(x)[1] @ nodal)
    assert errors(space, 1.0).a_smooth == pytest.approx(abs(on_exact - on_discrete), rel=1e-8)


@pytest.mark.parametrize("surface", [Torus(), Ellipsoid((1.4, 1.1, 0.8))])
def test_the_differential_of_the_closest_point_is_a_difference_quotient(surface):
    x = surface.closest(np.array([[1.2, 0.3, 0.2], [-0.9, 0.8, 0.3]])) * 1.05
    exact = geometry.closest_point_derivative(surface, x)
    for i, shift in enumerate(1e-5 * np.eye(3)):
        quotient = (surface.closest(x + shift) - surface.closest(x - shift)) / 2e-5
        np.testing.assert_allclose(exact[..., i], quotient, atol=1e-8)


def test_points_so_far_away_that_their_differential_is_rounding_are_refused():
    here = geometry.closest_point_derivative(Sphere(), np.array([3e7, 0.0, 4e7]))
    assert here @ [0.0, 1.0, 0.0] == pytest.approx([0, 2e-8, 0], rel=1e-6)
    for x in ([3e15, 0.0, 4e15], [-3.496931719863867e16, -4.6e-263, -2.3566134133819144e16]):
        with pytest.raises(ValueError, match=r"points must be within 1e\+08 radii of curv.* but"):
            geometry.closest_point_derivative(Sphere(), np.array(x))


def test_the_operators_turn_gradients_and_products_of_lifts_back():
    space = ec.SurfaceSpace(ec.torus(1.0, 0.4, 20, 8), 1)
    x, w, z = space.nodes, *np.random.default_rng(1).normal(size=(2, len(space.nodes)))
    B, R = geometry.lift_operators(space, x, Torus())
    onto = forms.lift(space, x, Torus())
    grad_w, grad_z = space.gradient(x, w), space.gradient(x, z)
    lifted_w, lifted_z = (geometry.apply(onto.gradient, g) for g in (grad_w, grad_z))
    np.testing.assert_allclose(geometry.apply(B, lifted_w), grad_w, atol=1e-12)  # [LMV] (5.7)
    product = onto.ratio * np.sum(geometry.apply(R, lifted_w) * lifted_z, axis=-1)
    np.testing.assert_allclose(product, np.sum(grad_w * grad_z, axis=-1), atol=1e-11)  # (5.8)


def test_the_norm_over_the_lift_is_that_over_the_exact_surface():
    space = ec.SurfaceSpace(ec.torus(1.0, 0.4, 40, 16), 2, Torus().closest, exactness=10)
    onto = forms.lift(space, space.nodes, Torus())
    norm = geometry.lifted_norm(space, space.nodes, onto, onto.normal)
    assert abs(norm**2 / (4 * np.pi**2 * 0.4) - 1) < 1e-6


def test_sizes_are_frobenius_norms():
    tensors = np.zeros((1, 2, 3, 3))
    tensors[0, 1] = 2.0
    assert geometry.largest_norm(tensors) == pytest.approx(6.0)
    assert geometry.largest_norm(tensors[..., 0]) == pytest.approx(np.sqrt(12))
    assert geometry.largest_norm(tensors[:0]) == 0.0


class Own(Sphere):
    """A surface of the reader's own, that changes what a sphere says."""

    def __init__(self, **changes):
        super().__init__()
        self.__dict__["changes"] = changes

    def near(self, x):
        near = super().near(x)
        return near._replace(**{name: of(getattr(near, name)) for name, of in self.changes.items()})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"distance": lambda d: d[..., None]}, r"\.distance must have shape \(2,\), got \(2, 1\)"),
        ({"normal": lambda n: n * np.nan}, r"\.normal must be finite"),
        ({"weingarten": lambda W: W[..., 0]}, r"\.weingarten must have shape \(2, 3, 3\), got"),
    ],
)
def test_what_a_surface_of_ones_own_says_of_points_is_looked_at(changes, message):
    points = np.array([[0.0, 0.0, 2.0], [0.0, 3.0, 0.0]])
    with pytest.raises(ValueError, match=r"surface\.near\(x\)" + message):
        geometry.closest_point_derivative(Own(**changes), points)
    lists = Own(distance=np.ndarray.tolist, weingarten=np.ndarray.tolist)
    found = geometry.closest_point_derivative(lists, points)
    np.testing.assert_array_equal(found, geometry.closest_point_derivative(Sphere(), points))


@pytest.mark.parametrize("power", [-900, -570, 530, 1000])
def test_norms_are_homogeneous_where_squares_are_out_of_range(power):
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 0), 2, ec.to_unit_sphere)
    onto = forms.lift(space, space.nodes, Sphere())
    values = 2.0**power * onto.points
    assert geometry.largest_norm(values) == 2.0**power * geometry.largest_norm(onto.points)
    expected = geometry.lifted_norm(space, space.nodes, onto, onto.points)
    assert geometry.lifted_norm(space, space.nodes, onto, values) == 2.0**power * expected


def test_a_normal_that_is_no_vector_is_refused():
    with pytest.raises(ValueError, match="normal must have shape"):
        geometry.tangent_projection([1.0, 0.0])


def test_tensors_and_surfaces_of_another_kind_are_refused():
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 0))
    onto = forms.lift(space, space.nodes, Sphere())
    for call, message in (
        (lambda: geometry.closest_point_derivative(None, space.nodes), "surface must be an Exact"),
        (lambda: geometry.closest_point_derivative(Sphere(), [1.0]), "points must have shape"),
        (
            lambda: geometry.lifted_norm(space, space.nodes, onto, np.ones(3)),
            r"values must have shape \(20, 3, \.\.\.\), got \(3,\)",
        ),
        (
            lambda: geometry.lifted_norm(space, space.nodes, None, onto.points),
            "onto must be a Lift",
        ),
        (lambda: geometry.apply(onto.gradient, np.ones(3)), r"vectors must have shape \(20, 3, 3"),
        (lambda: geometry.largest_norm(np.ones(3)), r"tensors must have shape \(T, Q, 3"),
    ):
        with pytest.raises((TypeError, ValueError), match=message):
            call()


def test_the_errors_are_numbers_of_python():
    found = geometry.geometric_errors(
        ec.SurfaceSpace(ec.sphere("icosahedron", 0)),
        lambda t: Sphere(1 + t),
        lambda x, t: (1 + t) * x,
        lambda x: x,
        linear,
        linear_gradient,
    )
    assert {type(value) for value in found} == {float}


@pytest.mark.parametrize(
    ("other", "message"),
    [
        ({"space": 3}, "space must be a SurfaceSpace, got 3"),
        ({"surface": Sphere()}, "surface must be a function of a time, got Sphere"),
        ({"surface": lambda t: 1.0}, "surface must be an ExactSurface, got 1"),
        ({"motion": lambda x, t: (2 + t) * x}, "motion must leave points .*, but moves one by 0"),
        (
            {"motion": lambda x, t: x[:, 0]},
            r"motion\(x, t\) must have shape \(12, 3\), got \(12,\)",
        ),
        ({"velocity": lambda x: 1.0}, r"velocity\(x\) must have shape \(20, 3, 3\), got \(\)"),
        ({"gradient": linear}, r"gradient\(x\) must have shape \(20, 3, 3\), got \(20, 3\)"),
        ({"u": lambda x: x}, r"u\(x\) must have shape \(12,\), got \(12, 3\)"),
        ({"u": lambda x: np.nan * x[..., 0]}, r"u\(x\) must be finite, but"),
    ],
)
def test_what_is_no_geometry_is_named(other, message):
    given = {
        "space": ec.SurfaceSpace(ec.sphere("icosahedron", 0)),
        "surface": lambda t: Sphere(1 + t),
        "motion": lambda x, t: (1 + t) * x,
        "velocity": lambda x: x,
        "u": linear,
        "gradient": linear_gradient,
    }
    with pytest.raises((TypeError, ValueError), match=message):
        geometry.geometric_errors(**{**given, **other})
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 0))
    with pytest.raises(TypeError, match="surface must be an ExactSurface, got 'sphere'"):
        geometry.lift_operators(space, space.nodes, "sphere")
