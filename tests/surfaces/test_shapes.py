"""What a triangulation has to be, and the messages when it is not."""

import numpy as np
import pytest
import trimesh

import esfem_core as ec
from esfem_core.surfaces import displaced


@pytest.mark.parametrize("refinements", range(4))
def test_sphere_sizes(refinements):
    assert len(ec.sphere("octahedron", refinements).vertices) == 4 ** (refinements + 1) + 2
    assert len(ec.sphere("icosahedron", refinements).vertices) == 10 * 4**refinements + 2


@pytest.mark.parametrize("kind", ["octahedron", "icosahedron"])
def test_sphere_is_closed_oriented_and_round(kind):
    tri = ec.sphere(kind, 3)
    ec.check_triangulation(tri)
    assert tri.is_watertight
    assert tri.euler_number == 2
    assert tri.volume == pytest.approx(4 / 3 * np.pi, rel=0.03)
    np.testing.assert_allclose(np.linalg.norm(tri.vertices, axis=1), 1, rtol=0, atol=1e-15)


def test_octahedral_edges_stay_on_the_coordinate_planes():
    signs = np.sign(ec.sphere("octahedron", 4).triangles)
    assert not ((signs.min(axis=1) < 0) & (signs.max(axis=1) > 0)).any()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("cube", 1), 'kind must be "octahedron" or "icosahedron", got \'cube\''),
        (("octahedron", -1), "refinements must be an integer >= 0, got -1"),
        (("octahedron", 1.5), "refinements must be an integer >= 0, got 1.5"),
    ],
)
def test_sphere_refuses(arguments, message):
    with pytest.raises(ValueError, match=message):
        ec.sphere(*arguments)


def test_any_closed_surface_is_accepted():
    for tri in (
        trimesh.creation.torus(2.0, 0.5),
        trimesh.creation.box(),
        trimesh.util.concatenate([trimesh.creation.box(), trimesh.creation.icosphere(1, 3.0)]),
    ):
        ec.check_triangulation(tri)


def pinched():
    """Two tetrahedra with one vertex in common."""
    a = trimesh.creation.box().convex_hull
    b = a.copy()
    b.apply_translation(a.vertices[0] - b.vertices[-1])
    vertices = np.vstack([a.vertices, b.vertices])
    faces = np.vstack([a.faces, b.faces + len(a.vertices)])
    faces[faces == len(vertices) - 1] = 0
    return vertices[:-1], faces


def changed(change):
    tri = ec.sphere("octahedron", 1)
    vertices, faces = np.array(tri.vertices), np.array(tri.faces)
    return change(vertices, faces) or (vertices, faces)


def set_vertex(i, value):
    def change(vertices, faces):
        vertices[i] = value

    return change


def set_face(i, value):
    def change(vertices, faces):
        faces[i] = value

    return change


BROKEN = {
    "hole": (
        lambda v, f: (v, f[1:]),
        "not closed: edge .* belongs to 1 triangle .*closed surfaces",
    ),
    "flipped triangle": (
        lambda v, f: (v, np.vstack([f[:1, ::-1], f[1:]])),
        r"oriented against each other: triangle \d+ .* edge \(\d+, \d+\)",
    ),
    "inside out": (lambda v, f: (v, f[:, ::-1]), r"oriented inwards \(enclosed volume -"),
    "third triangle at an edge": (
        lambda v, f: (np.vstack([v, [[9.0, 9, 9]]]), np.vstack([f, [[f[0, 0], f[0, 1], 18]]])),
        "edge .* of triangle .* belongs to (3|1) triangle",
    ),
    "repeated corner": (
        set_face(3, [1, 1, 2]),
        r"triangle 3 is degenerate: its corners \[1, 1, 2\]",
    ),
    "no area": (
        lambda v, f: (v * [1, 0, 0], f),
        r"triangle \d+ with corners .* is degenerate: area 0",
    ),
    "not a number": (set_vertex(5, np.nan), "vertex 5 is not finite"),
    "unused vertex": (lambda v, f: (np.vstack([v, [[0.0, 0, 0]]]), f), "vertex 18 belongs to no"),
    "missing vertex": (set_face(2, [0, 1, 99]), r"triangle 2 has corners \[0, 1, 99\]"),
    "pinched": (lambda v, f: pinched(), r"vertex 0 joins 2 separate fans.*Euler number 3"),
    "empty": (lambda v, f: (v, f[:0]), "has no triangles"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_meshes_are_refused_with_the_place(name):
    change, message = BROKEN[name]
    tri = trimesh.Trimesh(*changed(change), process=False, validate=False)
    with pytest.raises(ValueError, match=message):
        ec.SurfaceSpace(tri, 2)


def test_vertices_of_a_file_without_connectivity_are_explained():
    tri = ec.sphere("icosahedron", 1)
    soup = trimesh.Trimesh(
        tri.triangles.reshape(-1, 3), np.arange(240).reshape(-1, 3), process=False
    )
    with pytest.raises(ValueError, match="merge_vertices"):
        ec.check_triangulation(soup)
    soup.merge_vertices()
    ec.check_triangulation(soup)


def test_only_trimesh_is_taken():
    with pytest.raises(TypeError, match=r"expected a trimesh\.Trimesh, got tuple"):
        ec.check_triangulation(([], []))


def test_torus_is_closed_oriented_and_on_the_torus():
    tri = ec.torus(1.5, 0.5, 40, 16)
    ec.check_triangulation(tri)
    assert tri.euler_number == 0
    assert tri.volume == pytest.approx(2 * np.pi**2 * 1.5 * 0.25, rel=0.05)
    x, y, z = tri.vertices.T
    np.testing.assert_allclose((np.hypot(x, y) - 1.5) ** 2 + z**2, 0.25, atol=1e-14)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((1.0, 1.0, 20, 8), "R > r > 0, got R = 1.0 and r = 1.0"),
        ((1.0, 0.4, 2, 8), "integers >= 3, got n = 2 and m = 8"),
        ((1.0, 0.4, 20, 8.5), "integers >= 3, got n = 20 and m = 8.5"),
    ],
)
def test_torus_refuses(arguments, message):
    with pytest.raises(ValueError, match=message):
        ec.torus(*arguments)


def test_displaced_vertices_stay_on_the_surface_and_near():
    tri = ec.sphere("icosahedron", 2)
    moved = displaced(tri, 0.3, ec.to_unit_sphere, seed=4)
    ec.check_triangulation(moved)
    np.testing.assert_allclose(np.linalg.norm(moved.vertices, axis=1), 1, atol=1e-14)
    assert np.abs(moved.vertices - tri.vertices).max() > 0.1 * tri.edges_unique_length.min()
    again = displaced(tri, 0.3, ec.to_unit_sphere, seed=4)
    assert np.array_equal(moved.vertices, again.vertices)
    same = displaced(tri, 0.0, ec.to_unit_sphere)
    np.testing.assert_allclose(same.vertices, tri.vertices, atol=1e-15)
    with pytest.raises(ValueError, match=r"share must be from 0 to 0\.3, got 0\.5"):
        displaced(tri, 0.5, ec.to_unit_sphere)
