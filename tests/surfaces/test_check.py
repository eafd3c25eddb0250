"""What a triangulation has to be, and the messages when it is not."""

import numpy as np
import pytest
import trimesh

import esfem_core as ec


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
    with pytest.raises(TypeError, match=r"tri must be a trimesh\.Trimesh, got \(\[\], \[\]\)"):
        ec.check_triangulation(([], []))
