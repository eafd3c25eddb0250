"""Closest points of discrete surfaces: beside brute force, and where the answer is known."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import esfem_core as ec
from esfem_core.elements import probing, tabulate
from esfem_core.elements.probing import _step, closest_points, probe
from esfem_core.study import observed_orders

DEGREES = range(1, 6)


def sphere(degree, refinements=2, kind="octahedron"):
    return ec.SurfaceSpace(ec.sphere(kind, refinements), degree, ec.to_unit_sphere)


def at(space, x, cell, local):
    """Phi(local), row by row."""
    return np.einsum("na,nai->ni", tabulate(space.degree, local).values, x[space.cells[cell]])


def points_around(n, seed=0):
    """Inside, near, outside and far away."""
    rng = np.random.default_rng(seed)
    directions = ec.to_unit_sphere(rng.normal(size=(n, 3)))
    radii = [rng.uniform(0, 2, n // 2), 1 + 1e-3 * rng.normal(size=n // 4), np.full(n // 4, 50.0)]
    return directions * np.concatenate(radii)[:, None]


def brute_force(space, x, points):
    """Exact distances to all triangles."""
    triangles = np.repeat(x[space.cells][None], len(points), axis=0).reshape(-1, 3, 3)
    each = np.repeat(points, len(space.cells), axis=0)
    found = trimesh.triangles.closest_point(triangles, each)
    return np.linalg.norm(found - each, axis=1).reshape(len(points), -1)


@pytest.mark.parametrize("shape", ["sphere", "squashed", "crumpled", "graded"])
def test_flat_elements_agree_with_brute_force(shape):
    space = sphere(1)
    x = space.nodes.copy()
    if shape == "squashed":
        x *= [1.0, 1.0, 1e-3]
    elif shape == "crumpled":
        x += 0.3 * np.random.default_rng(1).normal(size=x.shape)
    elif shape == "graded":
        x *= 0.01 + np.exp(4 * x[:, :1])
    points = np.vstack([points_around(80), x[:20], np.zeros((1, 3))])
    found = closest_points(space, x, points)
    distances = brute_force(space, x, points)
    np.testing.assert_allclose(found.distance, distances.min(axis=1), rtol=1e-12, atol=1e-13)
    chosen = distances[np.arange(len(points)), found.cell]
    np.testing.assert_allclose(chosen, distances.min(axis=1), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("degree", DEGREES)
def test_a_point_above_an_element_comes_back_to_where_it_started(degree):
    space = sphere(degree, 1)
    rng = np.random.default_rng(degree)
    cell = np.repeat(np.arange(len(space.cells)), 4)
    local = rng.dirichlet([4, 4, 4], len(cell))[:, 1:]
    derivatives = tabulate(degree, local).derivatives
    t1, t2 = np.einsum("dna,nai->dni", derivatives, space.nodes[space.cells[cell]])
    foot = at(space, space.nodes, cell, local)
    height = rng.uniform(0, 0.2, len(cell))
    found = closest_points(
        space, space.nodes, foot + height[:, None] * ec.to_unit_sphere(np.cross(t1, t2))
    )
    assert (found.cell == cell).all()
    np.testing.assert_allclose(found.local, local, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.points, foot, rtol=0, atol=1e-13)
    np.testing.assert_allclose(found.distance, height, rtol=0, atol=1e-14)


@pytest.mark.parametrize("degree", DEGREES)
@pytest.mark.parametrize("noise", [0.02, 0.2])
def test_no_sample_of_a_crumpled_curved_surface_is_closer(degree, noise):
    space = sphere(degree, 1, "icosahedron")
    rng = np.random.default_rng(degree)
    x = space.nodes + noise / degree * rng.normal(size=space.nodes.shape)
    lattice = [(i / 40, j / 40) for i in range(41) for j in range(41 - i)]
    samples = (tabulate(degree, np.array(lattice)).values @ x[space.cells]).reshape(-1, 3)
    points = points_around(200, degree)
    found = closest_points(space, x, points)
    assert (found.distance <= cKDTree(samples).query(points)[0] + 1e-12).all()
    assert found.local.min() >= 0
    assert found.local.sum(axis=1).max() <= 1 + 1e-15
    np.testing.assert_allclose(
        at(space, x, found.cell, found.local), found.points, rtol=0, atol=1e-14
    )
    gap = np.linalg.norm(found.points - points, axis=1)
    np.testing.assert_allclose(found.distance, gap, rtol=1e-13, atol=1e-14)


def test_no_sample_is_closer_where_elements_of_degree_four_have_several_feet():
    """Searches must start from the corners of an element's parts, not from their centres only."""
    space, rng = sphere(4, 1), np.random.default_rng(2)
    x = space.nodes + 0.3 * rng.uniform(-1, 1, space.nodes.shape)
    points = 1.3 * rng.uniform(-1, 1, (100, 3))
    lattice = np.array([(i / 40, j / 40) for i in range(41) for j in range(41 - i)])
    samples = (tabulate(4, lattice).values @ x[space.cells]).reshape(-1, 3)
    nearest = cKDTree(samples).query(points)[0]
    assert (closest_points(space, x, points).distance <= nearest + 1e-12).all()


@pytest.mark.parametrize("degree", DEGREES)
def test_nodes_return_themselves_in_their_smallest_element(degree):
    space = sphere(degree, 1)
    smallest = np.full(len(space.nodes), len(space.cells))
    np.minimum.at(smallest, space.cells, np.arange(len(space.cells))[:, None])
    found = closest_points(space, space.nodes, space.nodes)
    np.testing.assert_array_equal(found.cell, smallest)
    np.testing.assert_allclose(found.points, space.nodes, rtol=0, atol=1e-14)
    np.testing.assert_allclose(found.distance, 0, atol=1e-14)
    u = np.random.default_rng(0).normal(size=(len(space.nodes), 2, 3))
    np.testing.assert_allclose(probe(space, space.nodes, u, space.nodes), u, rtol=0, atol=1e-12)


@pytest.mark.parametrize("degree", DEGREES)
def test_polynomials_on_flat_faces_are_reproduced(degree):
    """On a polyhedron, a polynomial of degree k in space is its own interpolant."""
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), degree)
    points = points_around(100)

    def polynomial(y):
        return (y @ [1.0, 2.0, -0.5]) ** degree + y[:, 2] ** (degree - 1)

    foot = closest_points(space, space.nodes, points).points
    values = probe(space, space.nodes, polynomial(space.nodes), points)
    np.testing.assert_allclose(values, polynomial(foot), rtol=1e-12, atol=1e-12)


def test_the_nodes_as_a_vector_field_give_the_closest_points():
    space, points = sphere(3), points_around(100)
    found = closest_points(space, space.nodes, points).points
    np.testing.assert_allclose(
        probe(space, space.nodes, space.nodes, points), found, rtol=0, atol=1e-15
    )


@pytest.mark.parametrize(("degree", "order"), [(2, 4), (3, 4)])
def test_the_distance_to_the_sphere_and_the_error_of_values_have_their_orders(degree, order):
    """Both k + 1; for even k on spheres the distance has one more."""
    points = ec.to_unit_sphere(np.random.default_rng(0).normal(size=(2000, 3)))
    h, rows = [], []
    for refinements in (2, 3, 4):
        space = sphere(degree, refinements)
        x = space.nodes
        h.append(space.mesh_size(x))
        values = probe(space, x, np.exp(x[:, 0] + 2 * x[:, 1]), points)
        error = values - np.exp(points[:, 0] + 2 * points[:, 1])
        distance = closest_points(space, x, points).distance
        rows.append([distance.max(), np.abs(error).max()])
    distances, errors = np.transpose(rows)
    np.testing.assert_allclose(observed_orders(h, distances)[-1], order, rtol=0, atol=0.2)
    np.testing.assert_allclose(observed_orders(h, errors)[-1], degree + 1, rtol=0, atol=0.2)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_the_centre_and_points_far_away_have_some_closest_point(degree):
    """On the coarse cubic sphere the vertices are not the highest points."""
    space = sphere(degree)
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1e8], [1e4, 2e4, -3e4]])
    lattice = [(i / 20, j / 20) for i in range(21) for j in range(21 - i)]
    samples = (tabulate(degree, np.array(lattice)).values @ space.nodes[space.cells]).reshape(-1, 3)
    nearest = np.linalg.norm(samples - points[:, None], axis=2).min(axis=1)
    found = closest_points(space, space.nodes, points)
    assert (found.distance <= nearest * (1 + 1e-15)).all()
    np.testing.assert_allclose(found.distance, nearest, rtol=1e-3)


def test_one_point_and_none():
    space = sphere(2)
    one = closest_points(space, space.nodes, [[0.0, 2.0, 0.0]])
    assert [part.shape for part in one] == [(1,), (1, 2), (1, 3), (1,)]
    none = closest_points(space, space.nodes, np.empty((0, 3)))
    assert [part.shape for part in none] == [(0,), (0, 2), (0, 3), (0,)]
    assert probe(space, space.nodes, space.nodes, np.empty((0, 3))).shape == (0, 3)
    assert probe(space, space.nodes, space.nodes[:, 0], np.empty((0, 3))).shape == (0,)


@pytest.mark.parametrize("degree", [1, 2, 4])
def test_moving_and_turning_and_scaling_everything_changes_nothing(degree):
    space, points = sphere(degree), points_around(200)
    turn = Rotation.from_euler("xyz", [0.3, -1.1, 2.0]).as_matrix().T
    shift = np.array([3.0, -2.0, 5.0])
    first = closest_points(space, space.nodes, points)
    other = closest_points(space, 7 * space.nodes @ turn + shift, 7 * points @ turn + shift)
    np.testing.assert_allclose(other.distance, 7 * first.distance, rtol=1e-12, atol=1e-13)
    # A point far away tells places on the surface apart only to the root of rounding.
    near = first.distance < 2
    np.testing.assert_allclose(
        other.points[near], 7 * first.points[near] @ turn + shift, rtol=0, atol=1e-6
    )


def test_each_point_has_its_answer_whatever_the_others_are():
    space, points = sphere(2), points_around(100)
    together = closest_points(space, space.nodes, points)
    for i in range(0, 100, 10):
        alone = closest_points(space, space.nodes, points[[i]])
        np.testing.assert_allclose(alone.points[0], together.points[i], rtol=0, atol=1e-13)
        assert alone.cell[0] == together.cell[i]


@pytest.mark.parametrize("chunk", [1, 100])
def test_chunks_do_not_matter(chunk, monkeypatch):
    space, points = sphere(2), points_around(60)
    whole = closest_points(space, space.nodes, points)
    monkeypatch.setattr("esfem_core.surfaces.balls.CHUNK", chunk)
    parts = closest_points(space, space.nodes, points)
    np.testing.assert_array_equal(parts.cell, whole.cell)
    np.testing.assert_allclose(parts.points, whole.points, rtol=0, atol=1e-13)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_places_are_nearly_as_exact_as_distances_and_turn_with_the_surface(degree):
    """Also on edges, where rounding once made the last steps longer."""
    turn = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
    ellipsoid = ec.exact_surfaces.Ellipsoid((1.5, 1.0, 0.5))
    tri = ec.sphere("octahedron", 2)
    tri.vertices = tri.vertices @ turn * ellipsoid.axes
    space = ec.SurfaceSpace(tri, degree, ellipsoid.closest if degree > 1 else None)
    points = 3 * ec.to_unit_sphere(np.random.default_rng(5).normal(size=(500, 3)))
    found = closest_points(space, space.nodes, points)
    turned = closest_points(space, space.nodes @ turn, points @ turn)
    np.testing.assert_allclose(turned.points @ turn.T, found.points, rtol=0, atol=1e-12)
    if degree == 1:
        exact = trimesh.triangles.closest_point(space.nodes[space.cells[found.cell]], points)
        np.testing.assert_allclose(found.points, exact, rtol=0, atol=1e-13)


@pytest.mark.parametrize("convex", [True, False])
def test_a_step_of_the_search_expects_what_a_quadratic_function_does(convex):
    """Its slope, and by how much it is lower where the step ends."""
    rng = np.random.default_rng(3)
    local, g = rng.dirichlet(np.ones(3), 200)[:, 1:], rng.normal(size=(2, 200))
    root, S = rng.normal(size=(2, 2, 2, 200))
    G, S = np.einsum("ikn,jkn->ijn", root, root), 0 * S if convex else S + S.swapaxes(0, 1)
    target, slope, decrease = _step(local, g, G, S)
    step = (target - local).T
    assert (target >= 0).all()
    assert (target.sum(axis=1) <= 1 + 1e-15).all()
    np.testing.assert_allclose(slope, np.sum(g * step, axis=0), atol=1e-13)
    change = slope + np.einsum("in,ijn,jn->n", step, G + S, step) / 2
    np.testing.assert_allclose(decrease, -change, atol=1e-13)


def test_a_surface_that_has_collapsed_to_a_point():
    space = sphere(2)
    found = closest_points(space, np.ones_like(space.nodes), [[1.0, 1.0, 3.0], [1.0, 1.0, 1.0]])
    np.testing.assert_array_equal(found.distance, [2, 0])


@pytest.mark.parametrize(
    ("x", "u", "points", "message"),
    [
        ((65, 3), (66,), (4, 3), r"x must have shape \(66, 3\), got \(65, 3\)"),
        ((66, 3), (65,), (4, 3), r"u must have shape \(66, ...\), got \(65,\)"),
        ((66, 3), (66,), (4, 2), r"points must have shape \(n, 3\), got \(4, 2\)"),
        ((66, 3), (66,), (3,), r"points must have shape \(n, 3\), got \(3,\)"),
    ],
)
def test_other_shapes_are_refused(x, u, points, message):
    with pytest.raises(ValueError, match=message):
        probe(sphere(1), np.zeros(x), np.zeros(u), np.zeros(points))


def test_what_is_not_finite_or_real_is_refused():
    space = sphere(1)
    x, u, points = space.nodes, space.nodes[:, 0], np.zeros((2, 3))
    with pytest.raises(ValueError, match=r"points must be finite, but points\[1, 2\] is inf"):
        probe(space, x, u, [[0, 0, 0], [0, 0, np.inf]])
    with pytest.raises(ValueError, match=r"x must be finite, but x\[0, 0\] is nan"):
        probe(space, x + np.nan, u, points)
    with pytest.raises(ValueError, match=r"u must be finite, but u\[0\] is nan"):
        probe(space, x, u * np.nan, points)
    with pytest.raises(TypeError, match="u must hold real numbers"):
        probe(space, x, u + 1j, points)


@pytest.mark.parametrize(("function", "u"), [(probe, [np.zeros(18)]), (closest_points, [])])
def test_what_is_no_space_is_refused_by_name(function, u):
    with pytest.raises(TypeError, match="space must be a SurfaceSpace, got None"):
        function(None, np.zeros((18, 3)), *u, np.zeros((2, 3)))


@pytest.mark.parametrize("distance", [1e9, 1e14, 1e75, 1e160, 1e308])
def test_from_very_far_away_the_tip_is_closest(distance):
    space = sphere(2)
    axes = np.vstack([np.eye(3), -np.eye(3)])
    found = closest_points(space, space.nodes, distance * axes)
    np.testing.assert_allclose(found.points, axes, atol=1e-6)
    np.testing.assert_allclose(found.distance, distance, rtol=2e-9)


def test_seen_from_afar_a_surface_that_is_moved_has_its_closest_points_moved():
    space, away = sphere(2), np.array([5.0, 0, 0])
    far = 1e5 * ec.to_unit_sphere(np.array([[1.0, 2.0, 3.0]]))
    here = closest_points(space, space.nodes, far).points
    there = closest_points(space, space.nodes + away, away + far).points
    np.testing.assert_allclose(there - away, here, atol=1e-6)


@pytest.mark.parametrize("power", [-900, -300, 300, 900])
def test_a_surface_of_any_size_has_closest_points(power):
    space, points = sphere(2), points_around(20)
    one = closest_points(space, space.nodes, points)
    other = closest_points(space, 2.0**power * space.nodes, 2.0**power * points)
    np.testing.assert_array_equal(other.cell, one.cell)
    np.testing.assert_array_equal(other.points, 2.0**power * one.points)
    np.testing.assert_array_equal(other.distance, 2.0**power * one.distance)


def descents(monkeypatch):
    """Numbers of descents of calls that come."""
    counts, minimise = [], probing._minimise

    def counted(degree, nodes, start):
        counts.append(len(nodes))
        return minimise(degree, nodes, start)

    monkeypatch.setattr(probing, "_minimise", counted)
    return counts


@pytest.mark.parametrize("shape", ["can", "ellipsoid"])
def test_pieces_are_not_searched_when_others_are_closer(shape, monkeypatch):
    if shape == "can":
        space = ec.SurfaceSpace(trimesh.creation.cylinder(radius=1, height=2, sections=400))
    else:
        space = sphere(3)
    x = space.nodes * [1.0, 1.1, 1.5]
    near = x[::14] + 0.01 * np.random.default_rng(4).normal(size=x[::14].shape)
    points = np.vstack([x[::14], near])
    counts = descents(monkeypatch)
    few = closest_points(space, x, points)
    assert sum(counts) < 40 * len(points)

    def every(pieces, points, bound):
        return tuple(np.indices((len(points), len(pieces.centre))).reshape(2, -1))

    monkeypatch.setattr("esfem_core.elements.probing._candidates", every)
    all_pairs = closest_points(space, x, points)
    np.testing.assert_array_equal(few.cell, all_pairs.cell)
    np.testing.assert_allclose(few.points, all_pairs.points, rtol=0, atol=1e-13)


@pytest.mark.parametrize("degree", [3, 4])
def test_near_the_centre_of_a_sphere_few_pieces_are_searched_and_the_closest_is_found(
    degree, monkeypatch
):
    """All are nearly as far away: bounds by hulls of Bézier points let half of them through."""
    space = sphere(degree, 2)
    points = 1e-3 * np.random.default_rng(5).normal(size=(10, 3))
    counts = descents(monkeypatch)
    few = closest_points(space, space.nodes, points)
    assert sum(counts) < 0.1 * 4 * degree**2 * len(space.cells) * len(points)

    def every(pieces, points, bound):
        return tuple(np.indices((len(points), len(pieces.centre))).reshape(2, -1))

    monkeypatch.setattr(probing, "_candidates", every)
    all_pairs = closest_points(space, space.nodes, points)
    np.testing.assert_allclose(few.distance, all_pairs.distance, rtol=1e-14)
    np.testing.assert_allclose(few.points, all_pairs.points, rtol=0, atol=1e-7)


@pytest.mark.parametrize("degree", DEGREES)
def test_squares_of_polynomials_are_no_smaller_than_their_least_coefficients(degree):
    space, rng = sphere(degree, 0), np.random.default_rng(degree)
    x = space.nodes + 0.5 * rng.normal(size=space.nodes.shape)
    pieces = probing._divide(degree, x[space.cells])
    points = rng.normal(size=(20, 3))
    point, piece = np.indices((20, len(pieces.centre))).reshape(2, -1)
    least = probing._least_squares(pieces, points, point, piece)
    at_centres = ((pieces.centre[piece] - points[point]) ** 2).sum(axis=1)
    assert (least <= at_centres * (1 + 1e-13)).all()
    np.testing.assert_allclose(pieces.squares.sum(axis=1), 1, rtol=1e-13)  # of a constant
