"""A smooth surface that is known by its triangles only."""

import pickle
from functools import partial

import level_sets
import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal
from scipy.interpolate import BarycentricInterpolator

import esfem_core as ec
from esfem_core.companion import bunny
from esfem_core.surfaces import derivative, displaced
from esfem_core.surfaces.foot_points import FootPoints
from esfem_core.surfaces.graphs import _neighbours, fit_graphs
from esfem_core.surfaces.smooth import _Flat

TORUS = ec.exact_surfaces.Torus(1.0, 0.4)
EGG = ec.exact_surfaces.Ellipsoid((1.5, 1.0, 0.7))
two_rings = partial(level_sets.two_rings, k=0.2)


class TwoRings:
    """Closest points and normals of two rings."""

    closest = staticmethod(ec.project_to_level_set(two_rings))

    def normal(self, x):
        g = ec.surfaces.central_gradient(two_rings)(self.closest(x))
        return g / np.linalg.norm(g, axis=1, keepdims=True)


def through_stl(tri, tmp_path):
    """Written in single precision, each triangle by itself, and read back."""
    tri.export(tmp_path / "surface.stl")
    return ec.read_mesh(tmp_path / "surface.stl", report=None)


def torus(n):
    return displaced(ec.torus(1.0, 0.4, n=5 * n, m=2 * n), 0.2, TORUS.closest)


def egg(refinements):
    tri = ec.sphere("icosahedron", refinements)
    return trimesh.Trimesh(EGG.closest(tri.vertices * EGG.axes), tri.faces, process=False)


def rings(h):
    box = [[-2.8, -1.7, -0.8], [2.8, 1.7, 0.8]]
    return ec.from_level_set(two_rings, box, h)


def errors(space, exact, area):
    """Mesh size, largest distance and difference of normals, relative error of the area."""
    at = ec.Surface(space, space.nodes)
    p, normal = at.points.reshape(-1, 3), at.normal.reshape(-1, 3)
    return (
        space.mesh_size(space.nodes),
        np.linalg.norm(exact.closest(p) - p, axis=1).max(),
        np.linalg.norm(exact.normal(p) - normal, axis=1).max(),
        abs(float(at.integral(1.0)) / area - 1),
    )


@pytest.mark.parametrize(
    ("exact", "area", "make", "sizes"),
    [  # areas from elements of degree 5, but for the torus
        (TORUS, 4 * np.pi**2 * 0.4, torus, (6, 12)),
        (EGG, 13.9842447, egg, (2, 3)),
        (TwoRings(), 29.12979, rings, (0.24, 0.17)),
    ],
    ids=["torus", "ellipsoid", "genus 2"],
)
def test_files_of_a_smooth_surface_gain_an_order_and_more(exact, area, make, sizes, tmp_path):
    meshes = [through_stl(make(size), tmp_path) for size in sizes]

    def orders(degree, smooth):
        spaces = [ec.SurfaceSpace(t, degree, ec.smooth(t) if smooth else None) for t in meshes]
        h, *found = np.transpose([errors(space, exact, area) for space in spaces])
        return [np.log(e[0] / e[1]) / np.log(h[0] / h[1]) for e in found]

    distance, normal, content = orders(2, smooth=False)
    assert distance < 2.3
    assert normal < 1.3
    assert content < 2.3
    for degree in (2, 3):
        distance, normal, content = orders(degree, smooth=True)
        assert distance > 3
        assert normal > 2
        assert content > 3


def test_vertices_stay_and_single_precision_costs_no_more_than_itself(tmp_path):
    tri = egg(2)
    read = through_stl(tri, tmp_path)
    assert_allclose(ec.smooth(tri)(tri.vertices), tri.vertices, rtol=0, atol=1e-14)
    middles = tri.vertices[tri.edges_unique].mean(axis=1)
    assert_allclose(ec.smooth(read)(middles), ec.smooth(tri)(middles), rtol=0, atol=1e-6)


def test_the_normal_converges_and_is_that_of_the_surface():
    largest = []
    for refinements in (2, 3):
        tri = egg(refinements)
        surface, points = ec.smooth(tri), tri.triangles_center
        normal = surface.normal(points)
        assert_allclose(np.linalg.norm(normal, axis=1), 1, rtol=0, atol=1e-14)
        exact = EGG.normal(EGG.closest(surface(points)))
        largest.append(np.linalg.norm(normal - exact, axis=1).max())
    assert largest[0] / largest[1] > 2**2.5


@pytest.mark.parametrize("crease", [50.0, 0.0])
def test_neighbours_agree_on_their_edge(crease):
    """Whatever is a crease, points of an edge have one place from either side."""
    tri = torus(6)
    surface = ec.smooth(tri, crease)
    assert (len(surface.creases) > 0) == (crease == 0)
    pairs, edges = tri.face_adjacency, tri.face_adjacency_edges
    t = np.linspace(0, 1, 5)[:, None, None]
    places = []
    for side in range(2):
        triangle = pairs[:, side]
        corner = (tri.faces[triangle][:, None] == edges[:, :, None]).argmax(axis=2)
        for share in t:
            b = np.zeros((len(edges), 3))
            np.put_along_axis(b, corner, np.hstack([1 - share, share]) * np.ones((1, 2)), 1)
            near, rest = surface._along_creases(triangle, b)
            places.append(near + surface._step(surface._fan[triangle], b, near) + rest)
    one, other = np.array(places[:5]), np.array(places[5:])
    assert_allclose(one, other, rtol=0, atol=1e-13)
    assert_allclose(one[[0, -1]].transpose(1, 0, 2), tri.vertices[edges], rtol=0, atol=1e-13)


def test_a_surface_turned_moved_and_scaled_has_its_points_so():
    tri, points = torus(4), torus(4).triangles_center
    turn, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))
    turn *= np.linalg.det(turn)

    def moved(x):
        return 1e-3 * x @ turn.T + [0.01, 0.02, -0.03]

    other = ec.smooth(trimesh.Trimesh(moved(tri.vertices), tri.faces, process=False))
    found, expected = other(moved(points)), moved(ec.smooth(tri)(points))
    assert_allclose(found, expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("subdivisions", [0, 1, 2])
def test_a_cube_stays_a_cube(subdivisions):
    tri = trimesh.creation.box()
    for _ in range(subdivisions):
        tri = tri.subdivide()
    surface = ec.smooth(trimesh.Trimesh(tri.vertices, tri.faces, process=False))
    assert len(surface.creases) == 12 * 2**subdivisions
    space = ec.SurfaceSpace(tri, 3)
    assert_allclose(surface(space.nodes), space.nodes, rtol=0, atol=1e-15)
    assert ec.smooth(tri, 91).creases.shape == (0, 2)


def test_points_of_a_cube_stay_also_beside_the_edges_of_its_triangles():
    tri, b = trimesh.creation.box(), np.array([0.7, 0.2995, 5e-4])
    points = np.vstack([np.roll(b, i) @ tri.triangles for i in range(3)])
    assert_allclose(ec.smooth(tri)(points), points, rtol=0, atol=1e-14)


def test_a_mean_normal_does_not_depend_on_how_a_side_is_cut_into_triangles():
    """At the corners of a cube, where its sides have one triangle or two."""
    box = trimesh.creation.box()
    assert set(np.bincount(box.faces.ravel())) != {3}
    normals = _Flat(np.array(box.triangles)).mean_normals(np.array(box.faces))
    assert_allclose(normals, ec.to_unit_sphere(box.vertices), atol=1e-15)


def test_only_angles_above_the_limit_are_sharp():
    box = trimesh.creation.box()
    assert [len(ec.smooth(box, crease).creases) for crease in (89.9, 90, 180)] == [12, 0, 0]
    # Sides of prisms meet at 51.4 and 45 degrees; without a limit it is 50.
    prisms = (trimesh.creation.cylinder(1.0, 1.0, sections=n) for n in (7, 8))
    assert [len(ec.smooth(prism).creases) for prism in prisms] == [3 * 7, 2 * 8]


def test_what_a_smooth_surface_tells_of_itself_is_read_only():
    first = ec.smooth(trimesh.creation.box())
    for s in (first, pickle.loads(pickle.dumps(first))):
        assert (s(first.vertices) == first(first.vertices)).all()
        for array in (s.vertices, s.faces, s.creases):
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 0


def test_an_octahedron_is_a_ball_if_no_edge_is_a_crease():
    tri = ec.sphere("octahedron", 0)
    flat, ball = (
        float(space.integrate(space.nodes, 1.0)) / (4 * np.pi)
        for space in (ec.SurfaceSpace(tri, 2, ec.smooth(tri, c)) for c in (50, 180))
    )
    assert flat == pytest.approx(np.sqrt(12) / (2 * np.pi))
    assert 0.75 < ball < 1.1


def lens(n):
    """Two caps of unit spheres that meet at an angle of 120 degrees, in n rings of triangles."""
    disc = [[0.0, 0.0]]
    for i in range(1, n + 1):
        angle = np.arange(6 * i) * np.pi / (3 * i)
        disc += (i / n * np.column_stack([np.cos(angle), np.sin(angle)])).tolist()
    faces = []
    start = [1 + 3 * i * (i - 1) for i in range(n + 2)]
    for i in range(1, n + 1):
        inner = [start[i - 1] + j for j in range(6 * (i - 1))] if i > 1 else [0]
        outer = [start[i] + j for j in range(6 * i)]
        for side in range(6):
            for j in range(i):
                a, b = side * i + j, side * (i - 1) + j
                here = inner[b % len(inner)]
                faces.append([outer[a], outer[(a + 1) % (6 * i)], here])
                if j < i - 1:
                    faces.append([here, outer[(a + 1) % (6 * i)], inner[(b + 1) % len(inner)]])
    x, f = np.array(disc), np.array(faces)
    polar = np.pi / 3 * np.linalg.norm(x, axis=1)
    direction = x / np.maximum(np.linalg.norm(x, axis=1), 1e-300)[:, None]
    top = np.column_stack([np.sin(polar)[:, None] * direction, np.cos(polar) - 0.5])
    rim = np.arange(len(x)) >= start[n]
    below = np.where(rim, np.arange(len(x)), len(x) + np.arange(len(x)))
    vertices = np.vstack([top, top[~rim] * [1, 1, -1]])
    return trimesh.Trimesh(vertices, np.vstack([f, below[f[:, ::-1]]]), process=False)


def test_a_crease_goes_to_the_curve_where_both_sides_meet():
    """A lens: its rim is a circle, which its triangles know by chords only."""
    at_rim, everywhere = [], []
    for n in (6, 12):
        tri = lens(n)
        surface = ec.smooth(tri)
        assert len(surface.creases) == 6 * n
        chords = tri.vertices[surface.creases].mean(axis=1)
        rim = surface(chords)
        at_rim.append(np.abs([np.hypot(*rim.T[:2]) - np.sqrt(0.75), rim[:, 2]]).max())
        x = ec.SurfaceSpace(tri, 3, surface).nodes
        everywhere.append(
            np.abs(np.linalg.norm(np.abs(x) + np.array([0, 0, 0.5]), axis=1) - 1).max()
        )
    assert at_rim[0] / at_rim[1] > 2**3.3
    assert everywhere[0] / everywhere[1] > 2**3.3


def test_an_arc_that_is_too_high_is_cut_to_its_room():
    """A rim of eight chords, whose arcs would be 0.0995 of them high; 0.08 are allowed."""
    s = ec.smooth(trimesh.creation.cylinder(1.0, 1.0, sections=8))
    half = np.flatnonzero(s._across >= 0)
    chord, curve = s._curve(half, np.full((len(half), 2), 0.5))
    height = np.linalg.norm(curve - chord, axis=1)
    assert_allclose(height, 0.08 * 2 * np.sin(np.pi / 8), rtol=1e-12)


def test_a_crease_moves_its_triangle_by_the_square_of_the_distance_from_the_corner_opposite():
    s = ec.smooth(trimesh.creation.cylinder(1.0, 1.0, sections=12))
    flat = np.ptp(s.vertices[s.faces, 2], axis=1) == 0
    side = next(i for i in np.flatnonzero(s._across >= 0) if flat[i // 3])  # at the rim of a lid
    t, ends = np.array([side // 3]), [side % 3, (side + 1) % 3]
    moved = []
    for share in (0.25, 0.5, 1.0):
        b = np.full((1, 3), 1 - share)
        b[0, ends] = share / 2
        near, _ = s._along_creases(t, b)
        moved.append(near - b @ s.vertices[s.faces[t[0]]])
    assert np.linalg.norm(moved[2]) > 0.01
    assert_allclose([16 * moved[0], 4 * moved[1]], [moved[2]] * 2, atol=1e-13)


@pytest.mark.parametrize(("crease", "degree"), [(30.0, 2), (50.0, 3), (180.0, 3)])
def test_no_element_of_a_scanned_surface_folds_over(crease, degree):
    tri = bunny()
    curved = ec.SurfaceSpace(tri, degree, ec.smooth(tri, crease))
    flat = ec.SurfaceSpace(tri, degree)
    normal, facet = (ec.Surface(s, s.nodes).normal for s in (curved, flat))
    assert (normal * facet).sum(axis=2).min() > 0
    assert 1 < ec.Surface(curved, curved.nodes).integral(1.0) / tri.area < 1.02


@pytest.mark.parametrize(("crease", "height"), [(50.0, 1.0), (180.0, 1.0), (180.0, 0.2)])
def test_rough_surfaces_go_back_towards_their_triangles(crease, height):
    """Vertices at random distances: hardly anything is resolved, and less if it is flattened."""
    tri = ec.sphere("icosahedron", 2)
    share = np.random.default_rng(2).uniform(0.8, 1.2, (len(tri.vertices), 1))
    tri = trimesh.Trimesh(share * tri.vertices * [1, 1, height], tri.faces, process=False)
    surface = ec.smooth(tri, crease)
    assert surface._trust.min() < 1
    curved, flat = ec.SurfaceSpace(tri, 2, surface), ec.SurfaceSpace(tri, 2)
    normal, facet = (ec.Surface(s, s.nodes).normal for s in (curved, flat))
    assert (normal * facet).sum(axis=2).min() > 0.4


def test_points_near_the_triangles_and_none_at_all():
    surface = ec.smooth(ec.sphere("icosahedron", 3))
    far = np.random.default_rng(0).normal(size=(50, 3))
    assert_allclose(np.linalg.norm(surface(far), axis=1), 1, rtol=0, atol=1e-4)
    assert surface(np.zeros((0, 3))).shape == (0, 3)


def test_triangles_that_face_each_other_have_a_normal():
    corners = np.eye(3)
    flat = _Flat(np.array([corners, corners[::-1]]))
    normal = flat.mean_normals(np.array([[0, 1, 2], [2, 1, 0]]))
    assert_allclose(np.abs(normal), 1 / np.sqrt(3), rtol=1e-15)


def test_foot_points_are_the_closest_of_all_triangles():
    tri = torus(3)
    points = np.random.default_rng(1).normal(size=(60, 3))
    triangle, b = FootPoints(tri.triangles)(points)
    foot = np.einsum("nc,nci->ni", b, tri.triangles[triangle])
    everywhere = np.array(
        [
            trimesh.triangles.closest_point(tri.triangles, np.tile(p, (len(tri.faces), 1)))
            for p in points
        ]
    )
    least = np.linalg.norm(everywhere - points[:, None], axis=2).min(axis=1)
    assert_allclose(np.linalg.norm(foot - points, axis=1), least, rtol=1e-13)
    assert_allclose(b.sum(axis=1), 1, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (("bunny.ply",), TypeError, "tri must be a trimesh.Trimesh, got 'bunny.ply'"),
        ((ec.sphere(refinements=0), 200), ValueError, "crease must be .* <= 180, got 200"),
        ((ec.sphere(refinements=0), "sharp"), TypeError, "crease must be a finite number"),
        ((trimesh.Trimesh(np.eye(3), [[0, 1, 2]]),), ValueError, "the surface is not closed"),
    ],
)
def test_what_is_refused(arguments, error, message):
    with pytest.raises(error, match=message):
        ec.smooth(*arguments)


def part(tri, kept):
    """The triangles whose centres (x, y, z) are to be kept, by a condition of these."""
    tri = tri.copy()
    tri.update_faces(kept(*tri.triangles_center.T))
    tri.remove_unreferenced_vertices()
    return tri


def test_a_mesh_with_a_hole_has_a_smooth_surface_as_it_is_told():
    tri = part(ec.sphere("icosahedron", 2), lambda x, y, z: z < 0.6)
    with pytest.raises(ValueError, match=r"project = ec\.smooth\(tri, boundary=True\) ec\.Surf"):
        ec.smooth(tri)
    project = ec.smooth(tri, boundary=True)
    space = ec.SurfaceSpace(tri, 2, project, boundary=True)
    assert len(space.boundary_nodes) == 48
    assert_allclose(np.linalg.norm(space.nodes, axis=1), 1, atol=2e-3)
    flat = ec.SurfaceSpace(tri, 2, boundary=True).nodes
    assert abs(np.linalg.norm(flat, axis=1) - 1).max() > 0.01


@pytest.mark.parametrize("degree", [2, 3])
def test_a_rim_has_order_four(degree):
    """Of half a sphere: to the sphere, and in it to the circle that the rim has its vertices on."""
    found = []
    for refinements in (3, 4):
        tri = part(ec.sphere("octahedron", refinements), lambda x, y, z: z > 0)
        project = ec.smooth(tri, boundary=True)
        space = ec.SurfaceSpace(tri, degree, project, boundary=True)
        off, rim = np.abs(np.linalg.norm(space.nodes, axis=1) - 1), space.boundary_nodes
        found.append([off.max(), off[rim].max(), np.abs(space.nodes[rim, 2]).max()])
    orders = np.log2(np.divide(*found))
    assert (orders > 3.5).all(), orders
    assert found[0][1] < 3e-4


def test_the_rim_of_a_flat_sheet_becomes_round():
    """No lid could say so: in its plane the vertices of the rim alone know the circle."""
    found = []
    for n in (6, 12):
        tri = part(lens(n), lambda x, y, z: z > 0)
        radius = np.hypot(*tri.vertices.T[:2])
        tri.vertices[:] = tri.vertices * [1, 1, 0] / radius.max()
        space = ec.SurfaceSpace(tri, 2, ec.smooth(tri, boundary=True), boundary=True)
        assert not space.nodes[:, 2].any()
        found.append(abs(np.hypot(*space.nodes[space.boundary_nodes, :2].T) - 1).max())
    assert np.log2(found[0] / found[1]) > 3.5


def test_corners_of_a_rim_and_its_straight_parts_stay():
    box = trimesh.creation.box().subdivide().subdivide()
    tri = part(box, lambda x, y, z: z < 0.49)
    surface = ec.smooth(tri, boundary=True)
    flat = ec.SurfaceSpace(tri, 3, boundary=True)
    assert len(flat.boundary_nodes) == 48
    assert_allclose(surface(flat.nodes), flat.nodes, rtol=0, atol=1e-14)
    assert surface._rim.bends.shape == (2, 16, 3)
    assert not surface._rim.bends.any()


def test_a_rim_is_the_cubic_curve_through_four_vertices_or_fewer_at_a_corner():
    """By lengths of chords; a fan around its last vertex, where it has corners, as at both ends."""
    x = np.array([0.0, 0.5, 1.2, 2.0, 2.5])
    vertices = np.column_stack([[*x, 1.25], [*np.sin(x / 2), -3.0], [*(x**2 / 20), 0.0]])
    faces = np.column_stack([np.arange(4), np.full(4, 5), np.arange(4) + 1])
    rim = ec.smooth(trimesh.Trimesh(vertices, faces, process=False), boundary=True)._rim
    length = np.linalg.norm(np.diff(vertices[:5], axis=0), axis=1)
    s = np.append(0, np.cumsum(length))
    t = np.linspace(0, 1, 5)
    for i in range(4):
        side = np.full(len(t), 3 * i + 2)  # from vertex i + 1 to vertex i
        known = slice(max(i - 1, 0), i + 3 if i < 3 else 5)
        curve = BarycentricInterpolator(s[known], vertices[known])(s[i + 1] - t * length[i])
        chord = vertices[i + 1] + t[:, None] * (vertices[i] - vertices[i + 1])
        assert_allclose(rim.off(side, t), curve - chord, rtol=0, atol=1e-14)
    assert not rim.off(np.array([0]), np.array([0.5])).any()  # between two corners
    assert rim.number[1] == -1


def test_points_must_be_finite_and_of_three_coordinates():
    surface = ec.smooth(ec.sphere(refinements=1))
    with pytest.raises(ValueError, match=r"points must be finite, but points\[0, 1\] is nan"):
        surface([[0.0, np.nan, 1.0]])
    with pytest.raises(ValueError, match=r"points must have shape \(n, 3\), got \(3,\)"):
        surface.normal([0.0, 0.0, 1.0])
    with pytest.raises(
        ValueError, match=r"coordinates up to 1, but one has the coordinate 1e\+200"
    ):
        surface([[0.0, 0.0, -1e200]])


def test_the_slopes_of_graphs_are_the_derivatives_of_their_heights():
    """(-f_u, -f_v, 1) is minus the gradient of f(u, v) - z."""
    tri = torus(3)
    x = np.array(tri.vertices)
    graphs = fit_graphs(x, TORUS.normal(x), np.array(tri.faces))
    i, near = np.arange(len(x)), x + np.array([0.2, 0.1, -0.1])
    gradient = [
        derivative(lambda s, e=e: graphs.heights(i, near + s * e), order=4, step=0.1)
        for e in np.eye(3)
    ]
    assert_allclose(graphs.slopes(i, near), -np.transpose(gradient), atol=1e-11)


def test_hubs_of_many_triangles_do_not_make_everything_a_neighbour_of_everything():
    n = 1500
    can = trimesh.creation.cylinder(radius=1, height=2, sections=n)
    assert _neighbours(can.faces, len(can.vertices)).nnz < 25 * len(can.vertices)  # and not n^2
    ball = trimesh.creation.uv_sphere(1, count=[24, 110])  # its poles have 220 triangles
    points = ec.smooth(ball)(ball.triangles_center)
    assert_allclose(np.linalg.norm(points, axis=1), 1, atol=1e-4)


def test_foot_points_on_a_hub_are_the_closest_of_few_triangles():
    n = 300
    corners = np.array(trimesh.creation.cylinder(radius=1, height=2, sections=n).triangles)
    points = ((corners + np.roll(corners, 1, axis=1)) / 2).reshape(-1, 3)
    points += 0.02 * np.random.default_rng(2).normal(size=points.shape)
    foot = FootPoints(corners)
    bound = foot.foot(points, foot.near(points))[1]
    pairs = sum(len(point) for point, _ in foot.pairs(points, bound))
    assert pairs < 40 * len(points)  # and not n
    some = points[::30]
    triangle, b = foot(some)
    every = np.tile(np.arange(len(corners)), len(some))
    local, distance = foot.foot(np.repeat(some, len(corners), axis=0), every)
    best = distance.reshape(len(some), -1).argmin(axis=1)
    assert_array_equal(triangle, best)
    assert_array_equal(b, local.reshape(len(some), -1, 3)[np.arange(len(some)), best])
