"""Surfaces with a boundary: what is accepted, and what their spaces know."""

from functools import partial

import numpy as np
import pytest
import trimesh
from hemisphere import hemisphere, upper_half

import esfem_core as ec
from esfem_core.elements import combination
from esfem_core.elements.numbering import mirrored
from esfem_core.solvers import DirectSolver, LaggedSolver, factorise

SPHERE = ec.sphere("octahedron", 2)


def joined(*meshes):
    return trimesh.util.concatenate(meshes)


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_all_nodes_of_the_equator_are_boundary_nodes(degree):
    space = hemisphere(2, degree)
    np.testing.assert_array_equal(space.boundary_nodes, np.flatnonzero(space.nodes[:, 2] == 0))
    assert len(space.boundary_nodes) == 16 * degree
    assert not space.boundary_nodes.flags.writeable


def test_a_closed_surface_has_no_boundary_nodes_and_is_the_same_with_and_without_the_option():
    spaces = [ec.SurfaceSpace(SPHERE, 2, ec.to_unit_sphere, boundary=b) for b in (False, True)]
    assert [len(space.boundary_nodes) for space in spaces] == [0, 0]
    np.testing.assert_array_equal(spaces[0].cells, spaces[1].cells)
    with pytest.raises(TypeError, match="boundary must be True or False, got 2"):
        ec.SurfaceSpace(SPHERE, boundary=2)


def test_without_the_option_a_boundary_is_refused_with_the_ways_out():
    half = upper_half(SPHERE)
    for make in (
        lambda: ec.SurfaceSpace(half),
        lambda: ec.SurfaceSpace.from_nodes(half.vertices, half.faces),
        lambda: ec.check_triangulation(half),
    ):
        with pytest.raises(ValueError, match=r"not closed: .* where the motion is prescribed, a S"):
            make()
    said = []
    ec.read_mesh(half, report=said.append)
    assert "a SurfaceSpace with boundary=True takes it as it is" in said[-1]


def test_triangles_that_only_need_to_be_joined_are_not_offered_as_a_surface_with_boundary():
    corners = SPHERE.triangles.reshape(-1, 3)
    apart = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
    with pytest.raises(ValueError, match="not closed") as error:
        ec.SurfaceSpace(apart)
    assert "boundary" not in str(error.value)


def around_the_pole(dtype=float, n=4):
    """A hemisphere by longitude and latitude, its columns at 0 and at 2 pi at nearly one place."""
    m = 4 * n
    up, around = np.meshgrid(
        np.linspace(0, np.pi / 2, n + 1, dtype=dtype),
        np.linspace(0, 2 * np.pi, m + 1, dtype=dtype),
        indexing="ij",
    )
    x = np.stack([np.sin(up) * np.cos(around), np.sin(up) * np.sin(around), np.cos(up)], axis=-1)
    a = np.arange((n + 1) * (m + 1)).reshape(n + 1, m + 1)
    corners = a[:-1, :-1], a[1:, :-1], a[1:, 1:], a[:-1, 1:]
    one, other = (np.stack([corners[i] for i in c], axis=-1) for c in ([0, 1, 2], [0, 2, 3]))
    faces = np.vstack([one.reshape(-1, 3), other[1:].reshape(-1, 3)])
    used, faces = np.unique(faces, return_inverse=True)
    return trimesh.Trimesh(
        x.reshape(-1, 3)[used].astype(float), faces.reshape(-1, 3), process=False
    )


@pytest.mark.parametrize("dtype", [float, np.float32])
def test_a_seam_is_no_boundary_and_the_advice_closes_it(dtype):
    """It was taken as it is: 24 boundary nodes, and nothing flowed through the seam."""
    tri = around_the_pole(dtype)
    with pytest.raises(
        ValueError, match=r"boundary=True takes it after tri = ec\.read_mesh\(tri\)$"
    ):
        ec.SurfaceSpace(tri)
    words = (
        r"lie at the same place, but are open \(19 such pairs\); tri = ec\.read_mesh\(tri\) makes"
    )
    with pytest.raises(ValueError, match=words):
        ec.SurfaceSpace(tri, boundary=True)
    with pytest.raises(ValueError, match=r"\(19 such pairs\); neighbours must share their nodes"):
        ec.SurfaceSpace.from_nodes(tri.vertices, tri.faces, boundary=True)
    meshio = pytest.importorskip("meshio")
    as_file = meshio.Mesh(tri.vertices, [("triangle", tri.faces)])
    for space in (
        ec.SurfaceSpace(ec.read_mesh(tri, report=None), boundary=True),
        ec.SurfaceSpace.read(as_file, report=None, boundary=True),
    ):
        assert len(space.boundary_nodes) == 16
        np.testing.assert_allclose(space.nodes[space.boundary_nodes, 2], 0, atol=1e-7)


def test_a_soup_of_triangles_is_no_surface_with_a_boundary():
    corners = SPHERE.triangles.reshape(-1, 3)
    cells = np.arange(len(corners)).reshape(-1, 3)
    with pytest.raises(ValueError, match=r"are open \(192 such pairs\)"):
        ec.SurfaceSpace(trimesh.Trimesh(corners, cells, process=False), boundary=True)


@pytest.mark.parametrize("turn", [1, -1])
def test_of_two_sheets_at_one_place_one_is_to_be_removed(turn):
    """Joined, as was advised, every edge had four triangles."""
    half = upper_half(SPHERE)
    other = trimesh.Trimesh(half.vertices, half.faces[:, ::turn], process=False)
    two = joined(half, other)
    for make in (
        lambda: ec.SurfaceSpace(two, boundary=True),
        lambda: ec.SurfaceSpace.from_nodes(two.vertices, two.faces, boundary=True),
    ):
        with pytest.raises(ValueError, match=r"\(16 such pairs\); (.*dropped 64|remove one of)"):
            make()


@pytest.mark.parametrize(("width", "fit"), [(1e-7, False), (1e-5, True)])
def test_a_slit_is_taken_where_its_sides_are_apart(width, fit):
    below, above = [[0, -1], [1, -1], [2, -1], [0, 0], [1, 0], [2, 0]], [[2, width]]
    x = np.pad(np.array([*below, *above, [0, 1], [1, 1], [2, 1]], float), ((0, 0), (0, 1)))
    lower = [[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]]
    upper = [[3, 4, 8], [3, 8, 7], [4, 6, 9], [4, 9, 8]]
    slit = trimesh.Trimesh(x, lower + upper, process=False)
    if fit:
        assert len(ec.SurfaceSpace(slit, boundary=True).boundary_nodes) == 10
        return
    with pytest.raises(ValueError, match="the two sides of a slit must lie farther apart than 1e-"):
        ec.SurfaceSpace(slit, boundary=True)


def strip(twists, n=12):
    """A band of 2n triangles, closed after some half twists."""
    angle = 2 * np.pi * np.arange(n) / n
    across, up = 0.3 * np.cos(twists * angle / 2), 0.3 * np.sin(twists * angle / 2)
    rims = [
        np.stack([(1 + s * across) * np.cos(angle), (1 + s * across) * np.sin(angle), s * up])
        for s in (-1, 1)
    ]
    low, high = np.arange(n), n + np.arange(n)
    first = (n, 0) if twists % 2 else (0, n)  # what comes after the last
    next_low, next_high = np.append(low[1:], first[0]), np.append(high[1:], first[1])
    faces = np.vstack([np.c_[low, next_low, high], np.c_[next_low, next_high, high]])
    return trimesh.Trimesh(np.hstack(rims).T, faces, process=False)


def test_two_rims_are_a_boundary_and_one_twisted_rim_is_none():
    band = ec.SurfaceSpace(strip(0), 2, boundary=True)
    assert len(band.boundary_nodes) == 48
    with pytest.raises(ValueError, match="not orientable"):
        ec.SurfaceSpace(strip(1), boundary=True)


def changed_half(change):
    half = upper_half(SPHERE)
    vertices, faces = change(np.array(half.vertices), np.array(half.faces))
    return trimesh.Trimesh(vertices, faces, process=False)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (
            lambda x, f: (x, np.vstack([f, f[:1, [0, 0, 1]]])),
            "its corners .*; tri = ec.repair",
        ),
        (lambda x, f: (x, np.vstack([f[:1, ::-1], f[1:]])), "oriented against each other"),
        (lambda x, f: (x * [1, 1, np.nan], f), "is not finite"),
        (lambda x, f: (np.vstack([x, x[:1]]), f), "belongs to no triangle"),
        (lambda x, f: (x, np.vstack([f, f])), r"edge .* belongs to (2|4) triangles"),
    ],
)
def test_all_other_faults_are_faults_still(change, text):
    with pytest.raises(ValueError, match=text):
        ec.SurfaceSpace(changed_half(change), boundary=True)


def test_two_sheets_that_touch_in_a_vertex_are_refused():
    x = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
    bow = trimesh.Trimesh(x, [[0, 1, 2], [0, 3, 4]], process=False)
    with pytest.raises(ValueError, match=r"vertex 0 joins 2 separate fans .*Euler number 1"):
        ec.SurfaceSpace(bow, boundary=True)


def test_closed_components_are_oriented_outwards_and_open_ones_as_they_are():
    half = upper_half(SPHERE).apply_translation([5, 0, 0])
    turned, inwards = half.copy(), SPHERE.copy()
    turned.faces, inwards.faces = half.faces[:, ::-1], SPHERE.faces[:, ::-1]
    for one in (half, turned):
        ec.SurfaceSpace(joined(one, SPHERE), boundary=True)
    n = len(half.faces)
    with pytest.raises(ValueError, match=rf"closed component 0 of 1, with triangle {n}, is ori"):
        ec.SurfaceSpace(joined(half, inwards), boundary=True)
    both = joined(turned, inwards)
    space = ec.SurfaceSpace.from_nodes(both.vertices, both.faces, boundary=True)
    np.testing.assert_array_equal(space.cells[:n], turned.faces)
    np.testing.assert_array_equal(space.cells[n:], both.faces[n:][:, mirrored(1)])


def test_curved_elements_with_a_boundary_are_read_with_one_turned():
    meshio = pytest.importorskip("meshio")
    made = hemisphere(1, 2)
    cells = made.cells.copy()
    cells[3] = cells[3][mirrored(2)]
    mesh = meshio.Mesh(made.nodes, [("triangle6", cells)])
    with pytest.raises(ValueError, match="not closed"):
        ec.SurfaceSpace.read(mesh, report=None)
    space = ec.SurfaceSpace.read(mesh, report=None, boundary=True)
    np.testing.assert_array_equal(space.cells, made.cells)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_matrices_integrals_and_closest_points_are_those_of_the_half(degree):
    space = hemisphere(3, degree)
    x = space.nodes
    assert space.integrate(x, 1) == pytest.approx(2 * np.pi, rel=[2e-2, 1e-4, 1e-4][degree - 1])
    M, A = space.mass_stiffness(x)
    np.testing.assert_allclose(A @ np.ones(len(x)), 0, atol=1e-13)
    below = [[0.0, 2.0, -1.0], [3.0, 0.0, -4.0]]  # closest points lie on the boundary
    np.testing.assert_allclose(space.probe(x, x, below), [[0, 1, 0], [1, 0, 0]], atol=1e-3)
    # The multifrontal factorisation, as a solver of (M + A) w = b.
    b = M @ np.cos(x)
    K = combination(1.0, M, 1.0, A)
    w = LaggedSolver(factorise=partial(factorise, fronts=space.fronts)).solve(K, b, 0 * b)
    np.testing.assert_allclose(w, DirectSolver().solve(K, b, 0 * b), rtol=0, atol=1e-9)


def test_normal_averages_at_the_boundary_are_exact_for_a_flat_disc():
    disc = upper_half(ec.sphere("octahedron", 1))
    disc.vertices = disc.vertices * [1, 1, 0]
    space = ec.SurfaceSpace(disc, 2, boundary=True)
    at = ec.Surface(space, space.nodes)
    np.testing.assert_allclose(at.normal, np.broadcast_to([0.0, 0, 1], at.normal.shape))
