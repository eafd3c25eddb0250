"""Meshes with one fault each, and what a message must say of it."""

import numpy as np
import trimesh
from hemisphere import upper_half

import esfem_core as ec

SPHERE = ec.sphere("icosahedron", 1)
SMALL = ec.sphere("octahedron", 1)


def mesh(vertices, faces):
    return trimesh.Trimesh(vertices, faces, process=False, validate=False)


def joined(*parts):
    return trimesh.util.concatenate(parts)


def turned(tri):
    return mesh(tri.vertices, np.asarray(tri.faces)[:, ::-1])


def soup(tri):
    """Each triangle with vertices of its own."""
    return mesh(tri.triangles.reshape(-1, 3), np.arange(3 * len(tri.faces)).reshape(-1, 3))


def pinched():
    """Two boxes with one vertex in common."""
    a = trimesh.creation.box().convex_hull
    b = a.copy()
    b.apply_translation(a.vertices[0] - b.vertices[-1])
    vertices = np.vstack([a.vertices, b.vertices])
    faces = np.vstack([a.faces, b.faces + len(a.vertices)])
    faces[faces == len(vertices) - 1] = 0
    return mesh(vertices[:-1], faces)


def boxes_with_a_common_edge():
    """As images of voxels are turned into surfaces."""
    tri = joined(trimesh.creation.box(), trimesh.creation.box().apply_translation([1, 1, 0]))
    tri.merge_vertices()
    return tri


def klein_bottle(n=20, m=10):
    u, w = np.meshgrid(2 * np.pi * np.arange(n) / n, 2 * np.pi * np.arange(m) / m, indexing="ij")
    r = 2 + np.cos(u / 2) * np.sin(w) - np.sin(u / 2) * np.sin(2 * w)
    z = np.sin(u / 2) * np.sin(w) + np.cos(u / 2) * np.sin(2 * w)
    x = np.stack([r * np.cos(u), r * np.sin(u), z], axis=-1).reshape(-1, 3)

    def at(i, j):
        return i * m + j % m if i < n else -j % m

    quads = [
        [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)] for i in range(n) for j in range(m)
    ]
    return mesh(x, [f for a, b, c, d in quads for f in ([a, b, c], [a, c, d])])


def longitudes(n=8):
    """A sphere by longitude and latitude: a seam, and poles of many vertices."""
    a, b = np.meshgrid(
        np.linspace(0, np.pi, n + 1), np.linspace(0, 2 * np.pi, 2 * n + 1), indexing="ij"
    )
    x = np.stack([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)], axis=-1)
    m = 2 * n + 1
    quads = [
        [m * i + j, m * i + j + m, m * i + j + m + 1, m * i + j + 1]
        for i in range(n)
        for j in range(2 * n)
    ]
    return mesh(x.reshape(-1, 3), [f for a, b, c, d in quads for f in ([a, b, c], [a, c, d])])


def half():
    return upper_half(ec.sphere("icosahedron", 2))


def changed(change):
    vertices, faces = np.array(SMALL.vertices), np.array(SMALL.faces)
    return mesh(*change(vertices, faces))


def with_row(array, i, value):
    array[i] = value
    return array


def with_flat_triangle():
    """A vertex in the middle of an edge, for one of its two triangles only."""
    x, faces = np.array(SMALL.vertices), np.array(SMALL.faces)
    a, b, c = faces[0]
    n = len(x)
    return mesh(
        np.vstack([x, (x[a] + x[b]) / 2]), np.vstack([faces[1:], [[a, n, c], [n, b, c], [a, b, n]]])
    )


BROKEN = {
    "hole": (
        changed(lambda v, f: (v, f[1:])),
        r"not closed: edge .* belongs to 1 triangle \(3 such",
    ),
    "half": (half(), r"and 1 hole of up to 2\d edges is open: tri = ec.repair\(tri, holes=2\d\)"),
    "triangles of their own": (soup(SMALL), r"not closed.*merged 96 vertices into 18"),
    "flipped triangle": (
        changed(lambda v, f: (v, np.vstack([f[:1, ::-1], f[1:]]))),
        r"oriented against each other: triangle \d+ .* edge \(\d+, \d+\)",
    ),
    "inside out": (turned(SMALL), r"oriented inwards \(enclosed volume -"),
    "cavity outwards": (joined(SPHERE, mesh(SPHERE.vertices / 2, SPHERE.faces)), "it is a cavity"),
    "third triangle at an edge": (
        changed(
            lambda v, f: (np.vstack([v, [[9.0, 9, 9]]]), np.vstack([f, [[f[0, 0], f[0, 1], 18]]]))
        ),
        "edge .* of triangle .* belongs to (3|1) triangle",
    ),
    "wall": (
        changed(lambda v, f: (v, np.vstack([f, f[:1], f[:1, ::-1]]))),
        "not a manifold: edge .* belongs to 4 triangles",
    ),
    "repeated corner": (
        changed(lambda v, f: (v, np.vstack([f, [[1, 1, 2]]]))),
        r"triangle 32 is degenerate: its corners \[1, 1, 2\]",
    ),
    "no area": (with_flat_triangle(), r"triangle \d+ with corners .* is degenerate: area 0"),
    "on a line": (
        changed(lambda v, f: (v * [1, 0, 0], f)),
        r"triangle \d+ with corners .* is degenerate: area 0",
    ),
    "flat": (changed(lambda v, f: (v * [1, 1, 0], f)), "the surface, .* encloses no volume"),
    "longitudes": (longitudes(), "is degenerate"),
    "not a number": (changed(lambda v, f: (with_row(v, 5, np.nan), f)), "vertex 5 is not finite"),
    "unused vertex": (
        changed(lambda v, f: (np.vstack([v, [[0.0, 0, 0]]]), f)),
        r"vertex 18 belongs to no triangle \(1 such",
    ),
    "missing vertex": (
        changed(lambda v, f: (v, with_row(f, 2, [0, 1, 99]))),
        r"triangle 2 has corners \[0, 1, 99\]",
    ),
    "pinched": (pinched(), r"vertex 0 joins 2 separate fans.*Euler number 3"),
    "boxes with a common edge": (boxes_with_a_common_edge(), "belongs to 4 triangles"),
    "not orientable": (klein_bottle(), "not orientable"),
    "curved elements": (
        trimesh.Trimesh(*(lambda s: (s.nodes, s.cells))(ec.SurfaceSpace(SPHERE, 2)), process=False),
        "as trimesh cuts rows of 6 numbers",
    ),
    "empty": (changed(lambda v, f: (v, f[:0])), "has no triangles"),
}
