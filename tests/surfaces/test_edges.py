"""Flips, splits and collapses keep what they must keep."""

import numpy as np
import pytest
import trimesh
from level_sets import BOXES, EULER, torus

import esfem_core as ec
from esfem_core.surfaces import collapse, edges_of, flip, split


def disturbed(seed=0, size=0.12):
    tri = ec.sphere("icosahedron", 3)
    noise = np.random.default_rng(seed).standard_normal((len(tri.vertices), 3))
    return ec.to_unit_sphere(np.array(tri.vertices) + size * noise / 3), np.array(tri.faces)


def check(x, faces, euler=2):
    tri = trimesh.Trimesh(x, faces, process=False)
    ec.check_triangulation(tri)
    assert tri.euler_number == euler


def angle_sums(x, faces):
    """Of the two angles opposite to each edge, by the arc cosine."""
    e = edges_of(faces)
    total = np.zeros(len(e.ends))
    for k in (0, 1):
        p, q = (x[e.ends[:, n]] - x[e.opposite[:, k]] for n in (0, 1))
        total += np.arccos(
            (p * q).sum(axis=1) / np.linalg.norm(p, axis=1) / np.linalg.norm(q, axis=1)
        )
    return total


def test_every_edge_is_listed_once_with_its_two_triangles():
    tri = ec.sphere("icosahedron", 2)
    e = edges_of(np.array(tri.faces))
    assert len(e.ends) == len(tri.edges_unique)
    np.testing.assert_allclose(
        np.sort(e.lengths(np.array(tri.vertices))), np.sort(tri.edges_unique_length), rtol=1e-14
    )
    for n, (i, j) in ((0, (0, 1)), (1, (1, 0))):
        corners = np.stack([e.ends[:, i], e.ends[:, j], e.opposite[:, n]], axis=1)
        rotations = [np.roll(corners, s, axis=1) for s in range(3)]
        faces = tri.faces[e.halves[:, n] // 3]
        assert np.any([(faces == r).all(axis=1) for r in rotations], axis=0).all()


def test_flips_end_at_delaunay_triangulations():
    x, faces = disturbed(size=0.1)
    assert (angle_sums(x, faces) > np.pi + 1e-6).sum() > 20
    for _ in range(50):
        faces, flips = flip(x, faces)
        check(x, faces)
        if flips == 0:
            break
    assert flips == 0
    assert angle_sums(x, faces).max() < np.pi + 1e-5


def test_a_wrong_diagonal_is_put_right():
    tri = ec.sphere("icosahedron", 2)
    x, faces = np.array(tri.vertices), np.array(tri.faces)
    e = edges_of(faces)
    (i, j), (p, q), halves = e.ends[100], e.opposite[100], e.halves[100]
    wrong = faces.copy()
    wrong[halves // 3] = [[p, i, q], [q, j, p]]
    corrected, flips = flip(x, wrong)
    assert flips == 1
    assert {frozenset(f) for f in corrected.tolist()} == {frozenset(f) for f in faces.tolist()}
    check(x, corrected)


def test_a_tetrahedron_is_left_alone():
    """Its other diagonals exist already, and collapsing an edge would destroy it."""
    x = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]])
    faces = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    x[0] *= 5
    assert flip(x, faces)[1] == 0
    assert collapse(x, faces, np.ones(6), 100.0)[2] == 0


def test_an_edge_that_exists_is_not_made_again():
    """A flat tetrahedron whose long edge (0, 1) should be flipped to (2, 3), an edge already."""
    corners = [[-5.0, 0, 0], [5, 0, 0], [0, 1, 1], [0, 1, -1], [-1.7, 1, 0], [1.7, 1, 0]]
    x = np.array(corners)
    two, others = [[0, 1, 2], [1, 0, 3]], [[0, 2, 4], [2, 3, 4], [3, 0, 4]]
    mirrored = [[2, 1, 5], [3, 2, 5], [1, 3, 5]]
    faces = np.array([*two, *others, *mirrored])
    check(x, faces)
    result = faces
    for _ in range(5):
        result, _ = flip(x, result)
        check(x, result)
    assert (angle_sums(x, faces) > np.pi).any()


def test_splits_leave_no_long_edge():
    x, faces = disturbed()
    longest = 0.8 * edges_of(faces).lengths(x).max()
    for _ in range(20):
        x, faces, splits = split(x, faces, longest)
        check(x, faces)
        if splits == 0:
            break
    assert edges_of(faces).lengths(x).max() <= longest


def test_collapses_keep_the_topology_however_many():
    """A torus cannot be coarsened to nothing."""
    tri = ec.from_level_set(torus, BOXES[torus], 0.3)
    x, faces = np.array(tri.vertices), np.array(tri.faces)
    for _ in range(300):
        shortest_first = 10 - edges_of(faces).lengths(x)
        x, faces, collapses = collapse(x, faces, shortest_first, 10.0)
        check(x, faces, EULER[torus])
        if collapses == 0:
            break
    assert collapses == 0
    assert 7 <= len(x) < len(tri.vertices) / 2  # no torus has fewer than 7 vertices


def test_collapses_respect_the_longest_edge():
    x, faces = disturbed()
    longest = 1.3 * edges_of(faces).lengths(x).max()
    x, faces, collapses = collapse(x, faces, np.ones(len(faces) * 3 // 2), longest)
    assert collapses > 10
    assert edges_of(faces).lengths(x).max() <= longest


def test_the_preferred_edge_goes_first():
    x, faces = disturbed(size=0)
    priority = np.zeros(len(faces) * 3 // 2)
    priority[17] = 1.0
    i, j = edges_of(faces).ends[17]
    y, smaller, collapses = collapse(x, faces, priority, 10.0)
    assert collapses == 1
    assert len(y) == len(x) - 1
    assert np.linalg.norm(y - (x[i] + x[j]) / 2, axis=1).min() < 1e-15
    check(y, smaller)


@pytest.mark.parametrize("operation", [flip, lambda x, f: split(x, f, 0.2)])
def test_arguments_are_not_changed(operation):
    x, faces = disturbed()
    before = x.copy(), faces.copy()
    operation(x, faces)
    assert np.array_equal(x, before[0])
    assert np.array_equal(faces, before[1])


OCTAHEDRON = ec.sphere("octahedron", 0)


@pytest.mark.parametrize(
    "change",
    [
        lambda faces: faces[1:],
        lambda faces: faces[2:],
        lambda faces: np.vstack([faces[:1, ::-1], faces[1:]]),
    ],
    ids=["one triangle missing", "two triangles missing", "one triangle turned"],
)
def test_edges_need_a_closed_oriented_triangulation(change):
    faces = change(np.array(OCTAHEDRON.faces))
    with pytest.raises(ValueError, match="faces must be a closed triangulation, neighbours orient"):
        edges_of(faces)


def test_an_edge_of_four_triangles_is_refused():
    """Two tetrahedra that share one."""
    one = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    other = np.where(one > 1, one + 2, one)
    with pytest.raises(ValueError, match="faces must be a closed triangulation"):
        edges_of(np.vstack([one, other]))


def test_a_collapse_is_the_same_among_vertices_of_no_triangle():
    x, faces = disturbed()
    found, found_faces, collapses = collapse(x, faces, np.ones(len(faces) * 3 // 2), 0.5)
    apart = np.vstack([np.zeros((2, 3)), x, np.zeros((1, 3))])
    again = collapse(apart, faces + 2, np.ones(len(faces) * 3 // 2), 0.5)
    assert collapses == again[2] > 10
    np.testing.assert_array_equal(found, again[0])
    np.testing.assert_array_equal(found_faces, again[1])


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"x": np.eye(3)}, ValueError, "numbers of the 3 vertices, from 0, got 0 to 5"),
        ({"x": np.eye(6)}, ValueError, r"x must have shape \(n, 3\), got \(6, 6\)"),
        (
            {"faces": [[0, 1, 0.5]]},
            ValueError,
            r"faces must hold integers, but faces\[0, 2\] is 0\.5",
        ),
        ({"faces": None}, TypeError, "faces must hold real numbers"),
        ({"longest": 0.0}, ValueError, r"longest must be a finite number > 0, got 0\.0"),
        ({"priority": np.ones(5)}, ValueError, r"priority must have shape \(12,\), got \(5,\)"),
    ],
)
def test_arguments_that_do_not_fit_are_refused_by_name(change, error, message):
    x, faces = np.array(OCTAHEDRON.vertices), np.array(OCTAHEDRON.faces)
    arguments = {"x": x, "faces": faces, "priority": np.ones(12), "longest": 1.0} | change
    with pytest.raises(error, match=message):
        collapse(**arguments)
    if "priority" not in change:
        arguments.pop("priority")
        with pytest.raises(error, match=message):
            split(**arguments)
