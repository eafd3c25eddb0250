"""Making a space: numbering, nodes, and what is refused."""

import copy
import pickle

import numpy as np
import pytest
import trimesh

import esfem_core as ec


def pickled(space):
    return pickle.loads(pickle.dumps(space))


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5])
def test_numbers_of_nodes_follow_euler(degree):
    """N = V + (k-1) E + (k-1)(k-2)/2 T."""
    for tri in (ec.sphere("icosahedron", 1), trimesh.creation.torus(2.0, 0.6)):
        space = ec.SurfaceSpace(tri, degree)
        V, T = len(tri.vertices), len(tri.faces)
        expected = V + (degree - 1) * 3 * T // 2 + (degree - 1) * (degree - 2) // 2 * T
        assert space.nodes.shape == (expected, 3)
        assert len(np.unique(space.cells)) == expected
        np.testing.assert_array_equal(space.cells[:, :3], tri.faces)
        np.testing.assert_array_equal(space.nodes[:V], tri.vertices)


@pytest.mark.parametrize("degree", [2, 3, 4, 5])
def test_neighbours_share_the_nodes_of_their_edge(degree):
    """Without projection the nodes lie at equal distances: different numbers, different places."""
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), degree)
    rounded = np.unique(space.nodes.round(12), axis=0)
    assert len(rounded) == len(space.nodes)


@pytest.mark.parametrize("degree", [2, 3, 4])
def test_new_nodes_are_projected_and_vertices_stay(degree):
    tri = ec.sphere("octahedron", 1)
    tri.vertices[0] *= 1.1
    space = ec.SurfaceSpace(tri, degree, ec.to_unit_sphere)
    radius = np.linalg.norm(space.nodes, axis=1)
    assert radius[0] == pytest.approx(1.1)
    np.testing.assert_allclose(radius[1:], 1, atol=1e-15)


def test_evaluate_interpolates_polynomials():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), 3)
    points = space.quadrature_points(space.nodes)
    cubic = space.evaluate(space.nodes[:, 0] ** 3 - space.nodes[:, 1] * space.nodes[:, 2])
    np.testing.assert_allclose(
        cubic, points[..., 0] ** 3 - points[..., 1] * points[..., 2], atol=1e-14
    )


def test_shapes_of_points_and_components():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 0), 2, exactness=6)
    T, Q = 8, 12
    x = space.nodes
    u = np.zeros((len(x), 5, 2))
    assert space.evaluate(u).shape == (T, Q, 5, 2)
    assert space.gradient(x, u).shape == (T, Q, 5, 2, 3)
    assert space.gradient(x, u[:, 0, 0]).shape == (T, Q, 3)
    assert space.quadrature_points(x).shape == space.normals(x).shape == (T, Q, 3)
    assert space.load(x, np.ones((T, Q, 5, 2))).shape == (len(x), 5, 2)


def test_mesh_size():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 0), 3, ec.to_unit_sphere)
    assert space.mesh_size(space.nodes) == pytest.approx(np.sqrt(2))
    assert space.mesh_size(3 * space.nodes) == pytest.approx(3 * np.sqrt(2))


TRI = ec.sphere("octahedron", 1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"degree": 0}, "degree must be an integer from 1 to 12, got 0"),
        ({"degree": 1.5}, "degree must be an integer from 1 to 12, got 1.5"),
        ({"degree": 2, "exactness": -1}, "exactness must be an integer from 0 to 101"),
        (
            {"degree": 2, "project": lambda p: p[:2]},
            r"project\(points\) must have shape \(48, 3\), got \(2, 3\)",
        ),
        ({"degree": 2, "project": lambda p: p / 0.0}, r"project\(points\) must be finite"),
    ],
)
@pytest.mark.filterwarnings("ignore:divide by zero", "ignore:invalid value")
def test_space_refuses(arguments, message):
    with pytest.raises(ValueError, match=message):
        ec.SurfaceSpace(TRI, **arguments)


@pytest.mark.parametrize("degree", range(1, 13))
def test_an_exactness_is_accepted_from_the_one_on_that_messages_name(degree):
    tri, refused = ec.sphere("octahedron", 0), degree - 1
    with pytest.raises(ValueError, match="or more for elements of degree") as info:
        ec.SurfaceSpace(tri, degree, exactness=refused)
    least = int(str(info.value).split()[3])
    for exactness in (least, 100, 101) if degree < 3 else (least,):
        assert ec.SurfaceSpace(tri, degree, exactness=exactness).rule.exactness >= exactness
    with pytest.raises(ValueError, match=f"exactness must be {least} or more"):
        ec.SurfaceSpace(tri, degree, exactness=least - 1)


@pytest.mark.parametrize("back", [lambda space: space, pickled, copy.copy, copy.deepcopy])
@pytest.mark.parametrize("degree", [1, 2, 5])
def test_nobody_can_write_to_what_a_space_remembers(degree, back):
    """Nor to what its arrays are views of."""
    space = ec.SurfaceSpace(TRI, degree)
    assert len(space.elimination_order) == len(space.nodes) > space.neighbours.min()
    space = back(space)
    given = {**vars(space.tables), **space.rule._asdict(), **vars(space.pattern)}
    assert not given.pop("data").flags.writeable
    arrays = {name: a for name, a in {**vars(space), **given}.items() if isinstance(a, np.ndarray)}
    assert {"nodes", "cells", "boundary_nodes", "points", "weights", "values", "tests"} < set(
        arrays
    )
    for name in arrays.keys() - {"_cells_last"}:
        array = arrays[name]
        while isinstance(array, np.ndarray):  # pickles may end in bytes
            assert not array.flags.writeable, name
            array = array.base


@pytest.mark.parametrize("back", [pickled, copy.deepcopy])
def test_no_matrix_changes_the_pattern_of_the_next_one(back):
    space = back(ec.SurfaceSpace(TRI))
    first, second = (space.mass_stiffness(space.nodes)[1] for _ in range(2))
    with pytest.raises(ValueError, match="read-only"):
        first.eliminate_zeros()
    assert space.mass_stiffness(space.nodes)[1].nnz == second.nnz == len(second.data)
    own = second.copy()
    own.eliminate_zeros()


def test_methods_refuse_wrong_shapes():
    space = ec.SurfaceSpace(TRI, 2)
    n = len(space.nodes)
    with pytest.raises(ValueError, match=rf"x must have shape \({n}, 3\), got \(18, 3\)"):
        space.mass_stiffness(space.nodes[:18])
    with pytest.raises(ValueError, match=rf"u must have shape \({n}, \.\.\.\), got \(5,\)"):
        space.evaluate(np.zeros(5))
    with pytest.raises(
        ValueError, match=r"values must have shape \(32, 6, \.\.\.\), got \(6, 32\)"
    ):
        space.load(space.nodes, np.zeros((6, 32)))


def test_a_density_is_one_number_for_each_point():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)
    density = space.density(space.nodes)
    values = np.ones(density.shape)
    wrong = {
        r"density must have shape \(32, 6\), got \(32, 6, 1\)": density[..., None],
        "density must hold real numbers, got bool": density > 0,
        "density must hold real numbers, got a masked array": np.ma.masked_array(density),
        r"density must be an array of shape \(32, 6\), got None": None,
    }
    for message, given in wrong.items():
        for method in (space.load_with, space.integral_with):
            with pytest.raises((TypeError, ValueError), match=message):
                method(given, values)
    with pytest.raises(ValueError, match=r"values must have shape \(32, 6, ...\), got \(6, 32\)"):
        space.load_with(density, values.T)


def test_the_mass_matrix_alone_is_that_of_both():
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), 3, ec.to_unit_sphere)
    x = space.nodes * [1, 1.2, 0.7]
    M, _ = space.mass_stiffness(x)
    np.testing.assert_array_equal(space.mass(x).data, M.data)
    u = np.random.default_rng(0).standard_normal((len(x), 2))
    np.testing.assert_allclose(space.mass_times(x, u), M @ u, rtol=0, atol=1e-15)


def test_interpolation_takes_nodal_values_on_the_surface_asked_for():
    space = ec.SurfaceSpace(TRI, 2)
    x = 2 * space.nodes
    np.testing.assert_array_equal(space.interpolate(lambda x: x[:, 0] ** 2, x), x[:, 0] ** 2)
    values = space.interpolate(lambda x: x, x)
    assert not np.shares_memory(values, x)
    np.testing.assert_array_equal(values, x)


def test_integrals_of_components_and_numbers():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 0), 1)
    area = 4 * np.sqrt(3)
    assert space.integrate(space.nodes, 2) == pytest.approx(2 * area, rel=1e-14)
    values = np.ones((8, 3, 2, 4)) * np.arange(4)
    np.testing.assert_allclose(
        space.integrate(3 * space.nodes, values), np.tile(9 * area * np.arange(4), (2, 1))
    )


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (
            lambda s: s.interpolate(lambda x: x[:3], s.nodes),
            ValueError,
            r"function\(x\) must have shape \(66, \.\.\.\), got \(3, 3\)",
        ),
        (
            lambda s: s.interpolate(lambda x: x * np.nan, s.nodes),
            ValueError,
            r"function\(x\) must be finite, but function\(x\)\[0, 0\] is nan",
        ),
        (
            lambda s: s.interpolate(s.nodes, s.nodes),
            TypeError,
            r"function must be a function of points \(N, 3\), got an array of shape \(66, 3\)",
        ),
        (
            lambda s: s.interpolate(lambda x: x, s.nodes[1:]),
            ValueError,
            r"x must have shape \(66, 3\), got \(65, 3\)",
        ),
        (
            lambda s: s.interpolate(lambda x: 1 + 0 * x[:, 0], np.full((66, 3), np.nan)),
            ValueError,
            r"x must be finite, but x\[0, 0\] is nan",
        ),
        (
            lambda s: s.integrate(s.nodes, np.ones(66)),
            ValueError,
            r"values must have shape \(32, 6, \.\.\.\), got \(66,\)",
        ),
        (
            lambda s: s.integrate(s.nodes, 1j),
            TypeError,
            r"values must hold real numbers, got complex128 \(1j\)",
        ),
        (
            lambda s: s.integrate(s.nodes[1:], 1),
            ValueError,
            r"x must have shape \(66, 3\), got \(65, 3\)",
        ),
    ],
)
def test_interpolation_and_integrals_refuse(call, error, message):
    with pytest.raises(error, match=message):
        call(ec.SurfaceSpace(TRI, 2))
