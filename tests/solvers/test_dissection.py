"""Nested dissection: every node separates what it should, and the order has little fill."""

import numpy as np
import pytest
import trimesh
from scipy.sparse.linalg import splu

import esfem_core as ec
from esfem_core.solvers import dissect

SPACES = [
    ec.SurfaceSpace(ec.sphere("octahedron", 5), 1),
    ec.SurfaceSpace(ec.sphere("icosahedron", 4), 2, ec.to_unit_sphere),
    ec.SurfaceSpace(ec.sphere("octahedron", 3), 4, ec.to_unit_sphere),
]


@pytest.mark.parametrize("space", SPACES, ids=str)
def test_less_fill_than_colamd(space):
    M, _ = space.mass_stiffness(space.nodes)
    order = space.elimination_order
    np.testing.assert_array_equal(np.sort(order), np.arange(len(space.nodes)))
    ours = splu(M[order][:, order].T, permc_spec="NATURAL", options={"SymmetricMode": True})
    theirs = splu(M.T, permc_spec="COLAMD", options={"SymmetricMode": True})
    assert ours.nnz < 0.8 * theirs.nnz


@pytest.mark.parametrize("space", SPACES, ids=str)
def test_a_node_belongs_to_the_smallest_part_with_all_its_elements(space):
    tree = dissect(space.cells, space.nodes, 20)
    for node in np.random.default_rng(0).integers(0, len(space.nodes), 100):
        around = tree.cell_part[(space.cells == node).any(axis=1)]
        depth = next(
            d for d in range(tree.depth, -1, -1) if len(np.unique(around >> (tree.depth - d))) == 1
        )
        assert (tree.node_depth[node], tree.node_part[node]) == (
            depth,
            around[0] >> (tree.depth - depth),
        )


@pytest.mark.parametrize("space", SPACES, ids=str)
def test_parts_are_equal_to_one_element(space):
    tree = dissect(space.cells, space.nodes, 20)
    sizes = np.bincount(tree.cell_part)
    assert len(sizes) == 2**tree.depth
    assert np.ptp(sizes) <= 1


def stretched(tri, *factors):
    tri = tri.copy()
    tri.apply_scale(factors)
    return tri


def bipyramid(n):
    """Two hubs over a ring of n vertices."""
    angle = 2 * np.pi * np.arange(n) / n
    ring = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    i, j = np.arange(n), (np.arange(n) + 1) % n
    faces = [np.column_stack([i, j, np.full(n, n)]), np.column_stack([j, i, np.full(n, n + 1)])]
    vertices = np.vstack([ring, [[0, 0, 1], [0, 0, -1]]])
    return trimesh.Trimesh(vertices, np.vstack(faces), process=False)


profile = [[0, -1], [1, -1], [1, -0.5], [0.2, 0], [1, 0.5], [1, 1], [0, 1]]
box = trimesh.creation.box()
for _ in range(5):
    box = box.subdivide()
SHAPES = {
    "a cylinder of long triangles": trimesh.creation.cylinder(1, 2, sections=1500),
    "a tall cylinder": trimesh.creation.cylinder(0.1, 5, sections=1500),
    "a cone": trimesh.creation.cone(1, 2, sections=1500),
    "an annulus": trimesh.creation.annulus(0.5, 1, 0.2, sections=1500),
    "rings": trimesh.creation.revolve(profile, sections=800),
    "two hubs": bipyramid(2000),
    "a capsule": trimesh.creation.capsule(height=5, radius=0.2, count=[60, 60]),
    "a needle": stretched(ec.sphere("icosahedron", 4), 50, 1, 1),
    "a long box": stretched(box, 20, 1, 0.05),
    "several parts": trimesh.util.concatenate(
        [ec.sphere("icosahedron", 3).apply_translation((3 * i, 0, 0)) for i in range(5)]
    ),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_no_shape_of_elements_makes_large_fronts(shape):
    space = ec.SurfaceSpace(SHAPES[shape])
    sphere = ec.SurfaceSpace(ec.sphere("icosahedron", 4))
    n, fronts = len(space.nodes), space.fronts
    largest = max(batch.shape[2] for level in fronts.levels for batch in level.batches)
    assert largest < 4 * np.sqrt(n)
    assert fronts.n_stored / n < 1.25 * sphere.fronts.n_stored / len(sphere.nodes)


def test_few_and_coinciding_nodes():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 3), 2)
    order = dissect(space.cells, np.zeros_like(space.nodes)).order
    np.testing.assert_array_equal(np.sort(order), np.arange(len(space.nodes)))
    space = ec.SurfaceSpace(ec.sphere("octahedron", 0))
    tree = dissect(space.cells, space.nodes)
    assert tree.depth == 0
    assert len(tree.order) == 6


def test_no_more_parts_than_elements():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 0), 9)
    assert 2 ** dissect(space.cells, space.nodes, part_size=1).depth == len(space.cells) == 8


def test_parts_without_nodes_are_refused():
    space = SPACES[0]
    with pytest.raises(ValueError, match="part_size must be an integer >= 1, got 0"):
        dissect(space.cells, space.nodes, part_size=0)


def test_points_of_no_mesh_are_refused():
    space = SPACES[0]
    with pytest.raises(ValueError, match=r"points must have shape \(N, 3\), got \(4098, 2\)"):
        dissect(space.cells, space.nodes[:, :2])
    with pytest.raises(ValueError, match="node 4098 lies in no element"):
        dissect(space.cells, np.r_[space.nodes, [[0, 0, 0]]])


def test_pieces_that_do_not_touch():
    ball = ec.sphere("octahedron", 3)
    both = trimesh.util.concatenate([ball, ball.copy().apply_translation([5, 0, 0])])
    space = ec.SurfaceSpace(both, 2)
    tree = dissect(space.cells, space.nodes)
    assert tree.depth > 1
    assert (tree.node_depth > 0).all()  # nothing separates them


@pytest.mark.parametrize(
    ("cells", "message"),
    [
        (np.zeros((0, 3)), r"shape \(T, n\) with T >= 1 and n >= 3, got \(0, 3\)"),
        ([[0, 1]], r"shape \(T, n\) with T >= 1 and n >= 3, got \(1, 2\)"),
        ([[0, 1, 3]], "numbers of nodes, 0 to 2, got 0 to 3"),
        ([[0, 1, -1]], "numbers of nodes, 0 to 2, got -1 to 1"),
    ],
)
def test_what_holds_no_elements_of_the_points_is_refused(cells, message):
    with pytest.raises(ValueError, match=message):
        dissect(cells, np.eye(3))
