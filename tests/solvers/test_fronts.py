"""Fronts hold every node and every entry of a matrix once, in the order of elimination."""

import numpy as np
import pytest
from scipy.sparse import csr_array

import esfem_core as ec
from esfem_core.solvers import Fronts, dissect
from esfem_core.solvers.fronts import batches_of_similar_size, nodes_of_parts, places_in_memory

SPACES = {
    "linear": ec.SurfaceSpace(ec.sphere("octahedron", 4), 1),
    "quadratic": ec.SurfaceSpace(ec.sphere("icosahedron", 3), 2, ec.to_unit_sphere),
    "torus": ec.SurfaceSpace(ec.torus(1.0, 0.3, 24, 8), 3),
}


@pytest.fixture(params=SPACES)
def space(request):
    return SPACES[request.param]


@pytest.fixture
def tree(space):
    return dissect(space.cells, space.nodes, 10)


def test_parts_have_their_own_nodes_and_those_of_larger_parts_around_them(space, tree):
    for depth in range(tree.depth + 1):
        found = nodes_of_parts(tree, space.cells, depth)
        for part in range(2**depth):
            cells = space.cells[tree.cell_part >> (tree.depth - depth) == part]
            own = np.flatnonzero((tree.node_depth == depth) & (tree.node_part == part))
            nodes = np.unique(cells)
            around = nodes[tree.node_depth[nodes] < depth]
            np.testing.assert_array_equal(found.node[found.part == part], np.r_[own, around])
            assert found.counts[part].tolist() == [len(own), len(around)]


def test_pairs_of_a_part_and_a_node_are_found(space, tree):
    found = nodes_of_parts(tree, space.cells, tree.depth // 2)
    np.testing.assert_array_equal(found.find(found.part, found.node), np.arange(len(found.part)))


@pytest.mark.parametrize(("parts", "batches"), [(1, 1), (63, 1), (64, 2), (127, 3), (1024, 4)])
def test_batches_are_of_similar_size_and_not_too_many(parts, batches):
    counts = np.random.default_rng(0).integers(1, 100, (parts, 2))
    found = batches_of_similar_size(counts)
    assert len(found.parts) == batches
    order = np.concatenate(found.parts)
    np.testing.assert_array_equal(np.sort(order), np.arange(parts))
    assert (np.diff(counts[order].sum(axis=1)) >= 0).all()
    for members in found.parts:
        assert (found.padded[members] == counts[members].max(axis=0)).all()


def test_fronts_stand_one_behind_the_other(space, tree):
    for depth in range(tree.depth + 1):
        nodes = nodes_of_parts(tree, space.cells, depth)
        batches = batches_of_similar_size(nodes.counts)
        places = places_in_memory(nodes, batches)
        order = np.concatenate(batches.parts)
        for start, length in (
            (places.own, batches.padded[:, 0]),
            (places.nodes, places.width),
            (places.front, places.width**2),
        ):
            end = (start + length)[order]
            np.testing.assert_array_equal(start[order], np.r_[0, end[:-1]])


def test_every_node_has_a_slot_of_its_own_but_never_slot_zero(space, tree):
    M, _ = space.mass_stiffness(space.nodes)
    fronts = Fronts(tree, space.cells, M)
    assert len(np.unique(fronts.slot)) == len(space.nodes)
    assert fronts.slot.min() > 0
    assert fronts.slot.max() < fronts.size
    assert np.array_equal(fronts.node[fronts.slot], np.arange(len(space.nodes)))
    assert np.count_nonzero(fronts.node == len(space.nodes)) == fronts.size - len(space.nodes)


def test_every_entry_comes_in_once_or_as_its_mirror_image(space, tree):
    M, _ = space.mass_stiffness(space.nodes)
    fronts = Fronts(tree, space.cells, M)
    entries = np.concatenate([level.entries for level in fronts.levels])
    assert len(np.unique(entries)) == len(entries)
    came = np.zeros(M.nnz)
    came[entries] = 1
    came = csr_array((came, M.indices, M.indptr), shape=M.shape).toarray()
    assert ((came + came.T > 0) == (M.toarray() != 0)).all()
    for level in fronts.levels:
        assert len(np.unique(level.places)) == len(level.places)
        assert not np.isin(level.padding, level.places).any()


def test_a_pattern_of_another_mesh_is_refused():
    space, other = SPACES["linear"], SPACES["torus"]
    M, _ = other.mass_stiffness(other.nodes)
    tree = dissect(space.cells, space.nodes)
    with pytest.raises(ValueError, match=r"a row for each of the 1026 nodes of the tree, got shap"):
        Fronts(tree, space.cells, M)


def test_fronts_say_what_they_are():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 0))
    assert repr(space.fronts) == (
        "Fronts(nodes=6, levels=1, fronts=1, largest front=6 x 6, entries of a factor per node=6.0)"
    )
