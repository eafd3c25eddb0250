"""What a triangulation has to be, the messages when it is not, and that their advice works."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from broken_meshes import BROKEN, SPHERE, half, joined, klein_bottle, mesh, soup, turned
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import esfem_core as ec
from esfem_core.elements.lagrange import MOST_DEGREE
from esfem_core.surfaces.orientation import components, shells, sides_of, turned_to_outside


def message(tri):
    with pytest.raises(ValueError) as error:
        ec.check_triangulation(tri)
    return str(error.value)


def test_any_closed_surface_is_accepted():
    for tri in (
        trimesh.creation.torus(2.0, 0.5),
        trimesh.creation.box(),
        joined(
            trimesh.creation.box(), trimesh.creation.icosphere(1, 3.0).apply_translation([9, 0, 0])
        ),
    ):
        ec.check_triangulation(tri)


@pytest.mark.parametrize("name", BROKEN)
def test_broken_meshes_are_refused_with_the_place(name):
    tri, text = BROKEN[name]
    with pytest.raises(ValueError, match=text):
        ec.SurfaceSpace(tri, 2)


@pytest.mark.parametrize("name", BROKEN)
def test_the_advice_of_each_message_works_to_the_letter(name):
    tri = BROKEN[name][0].copy()
    advice = re.search(r"(tri = ec\.repair\(tri[^)]*\))", message(tri))
    if advice is None:
        assert name in {
            "empty",
            "flat",
            "on a line",
            "curved elements",
            "not orientable",
            "third triangle at an edge",
        }
        with pytest.raises(ValueError, match="cannot be repaired"):
            ec.repair(tri, report=None)
        return
    names = {"ec": ec, "tri": tri}
    exec(advice[1], names)
    ec.check_triangulation(names["tri"])


def test_a_cavity_is_oriented_inwards_and_an_island_in_it_outwards():
    hollow = joined(SPHERE, turned(mesh(0.5 * SPHERE.vertices, SPHERE.faces)))
    island = joined(hollow, mesh(0.2 * SPHERE.vertices, SPHERE.faces))
    for tri in (hollow, island):
        ec.check_triangulation(tri)
    wrong = joined(SPHERE, mesh(0.5 * SPHERE.vertices, SPHERE.faces))
    assert "component 1 of 2, with triangle 80, lies inside 1 other: it is a cavity" in message(
        wrong
    )


def test_depths_are_counted_in_every_order_of_the_components():
    radii, places = [1, 0.5, 0.2, 0.1, 1, 0.3], [0, 0, 0.1, 0.35, 3, 3.2]
    parts = [
        mesh(r * SPHERE.vertices + [x, 0, 0], SPHERE.faces)
        for r, x in zip(radii, places, strict=True)
    ]
    depths = np.array([0, 1, 2, 2, 0, 1])
    for order in (np.arange(6), np.arange(6)[::-1], np.array([2, 5, 0, 3, 4, 1])):
        tri = joined(*(parts[i] for i in order))
        found = shells(np.asarray(tri.vertices), np.asarray(tri.faces))
        np.testing.assert_array_equal(found.depth, depths[order])


@pytest.mark.parametrize("seed", range(4))
def test_a_cavity_whose_triangles_cross_those_of_its_body_is_one(seed):
    """The sides of a thin shell, seen from each other."""
    one, other = Rotation.random(2, random_state=seed).as_matrix()
    inner = mesh(0.97 * SPHERE.vertices @ other, SPHERE.faces)
    right = joined(mesh(SPHERE.vertices @ one, SPHERE.faces), turned(inner))
    ec.check_triangulation(right)
    wrong = joined(mesh(SPHERE.vertices @ one, SPHERE.faces), inner)
    said = []
    assert ec.repair(wrong, report=said.append).volume == pytest.approx(right.volume, rel=1e-14)
    assert said == ["turned 1 cavity inwards"]


@pytest.mark.parametrize("place", [0.6, 0.75, 0.9])
def test_a_body_that_sticks_out_of_another_is_no_cavity(place):
    knob = mesh(0.5 * SPHERE.vertices + [place, 0, 0], SPHERE.faces)
    ec.check_triangulation(joined(SPHERE, knob))


@pytest.mark.parametrize(("small", "large"), [(0.5, 1.0), (1.0, 0.5)])
def test_one_component_inside_out_is_found_and_only_that_one_is_turned(small, large):
    other = mesh(small * SPHERE.vertices + [3, 0, 0], SPHERE.faces)
    tri = joined(mesh(large * SPHERE.vertices, SPHERE.faces), turned(other))
    assert "component 1 of 2, with triangle 80, is oriented inwards" in message(tri)
    right = joined(mesh(large * SPHERE.vertices, SPHERE.faces), other)
    assert ec.repair(tri, report=None).volume == pytest.approx(right.volume, rel=1e-14)


def test_a_turned_triangle_is_repaired_without_turning_the_cavity():
    tri = joined(SPHERE, turned(mesh(0.5 * SPHERE.vertices, SPHERE.faces)))
    volume, faces = tri.volume, np.array(tri.faces)
    faces[3] = faces[3, ::-1]
    said = []
    whole = ec.repair(mesh(tri.vertices, faces), report=said.append)
    assert said == ["turned 1 triangle to agree with neighbours"]
    assert whole.volume == pytest.approx(volume, rel=1e-14)


def test_a_klein_bottle_is_called_not_orientable():
    text = message(klein_bottle())
    assert "the surface is not orientable" in text
    assert "take an orientable surface" in text
    assert "repair" not in text


@pytest.mark.parametrize("missing", [1, 2, 4])
def test_a_klein_bottle_with_a_hole_is_not_told_to_be_closed(missing):
    whole = klein_bottle()
    tri = mesh(whole.vertices, whole.faces[:-missing])
    for refuse in (ec.check_triangulation, lambda tri: ec.repair(tri, report=None)):
        with pytest.raises(ValueError, match=r"is not orientable.*take an orientable") as error:
            refuse(tri)
        assert "close" not in str(error.value)


def test_a_moebius_strip_is_not_told_to_be_closed():
    """Closed by any lid, it is a surface without an inside."""
    n = 20
    v, w = np.meshgrid(2 * np.pi * np.arange(n) / n, [-0.3, 0.3], indexing="ij")
    r = 1 + w * np.cos(v / 2)
    x = np.stack([r * np.cos(v), r * np.sin(v), w * np.sin(v / 2)], axis=-1).reshape(-1, 3)
    numbers = np.arange(2 * n).reshape(n, 2)
    ahead = np.vstack([numbers[1:], numbers[:1, ::-1]])
    (a, b), (c, d) = numbers.T, ahead.T
    tri = mesh(x, np.vstack([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)]))
    for refuse in (
        ec.check_triangulation,
        lambda tri: ec.check_triangulation(tri, boundary=True),
        lambda tri: ec.repair(tri, report=None),
        lambda tri: ec.SurfaceSpace.from_nodes(tri.vertices, tri.faces),
    ):
        with pytest.raises(ValueError, match=r"is not orientable: .* take an orientable") as error:
            refuse(tri)
        assert "close it" not in str(error.value)


def test_a_needle_is_refused_and_the_advice_works():
    """The default solver failed on this mesh: two vertices 1e-8 apart."""
    sphere = ec.sphere("icosahedron", 2)
    x, (a, b, _) = np.array(sphere.vertices), sphere.faces[0]
    x[a] = x[b] + 1e-8 * (x[a] - x[b])
    tri = mesh(x, sphere.faces)
    assert "is degenerate" in message(tri)
    ec.check_triangulation(ec.repair(tri, report=None))


@pytest.mark.parametrize(("share", "fit"), [(0.99, False), (1.01, True)])
def test_meshes_and_elements_have_one_limit_for_degenerate(share, fit):
    sphere = ec.sphere("icosahedron", 2)
    space = ec.SurfaceSpace(sphere)
    x, (a, b, c) = np.array(sphere.vertices), sphere.faces[0]
    base, normal = x[b] - x[a], np.cross(x[b] - x[a], x[c] - x[a])
    up = np.cross(normal, base) / np.linalg.norm(np.cross(normal, base))
    # Height H over the middle of a base L has the shape 2 sqrt(3) L H / (1.5 L^2).
    x[c] = (x[a] + x[b]) / 2 + share * 1e-7 * 0.75 / np.sqrt(3) * np.linalg.norm(base) * up
    if fit:
        ec.check_triangulation(mesh(x, sphere.faces))
        space.mass_stiffness(x)
        return
    assert "triangle 0 with corners" in message(mesh(x, sphere.faces))
    with pytest.raises(ec.DegenerateElementError, match="element 0 near"):
        space.mass_stiffness(x)


@pytest.mark.parametrize("place", [0, 1e6])
@pytest.mark.parametrize("size", [1e-10, 1e-8, 1, 1e6])
def test_small_surfaces_and_far_ones_are_accepted_or_the_rounding_is_named(size, place):
    tri = mesh(size * SPHERE.vertices + place, SPHERE.faces)
    if size <= 1e-8 and place:
        text = message(tri)
        assert text.endswith(
            "numbers are rounded to 1e-10; subtract the middle of the surface before it is rounded"
        )
    else:
        ec.check_triangulation(tri)
        inside_out = turned(tri)
        assert "oriented inwards" in message(inside_out)


@pytest.mark.parametrize("refinements", [1, 2])
@pytest.mark.parametrize(("place", "fit"), [(1e12, True), (1e14, False), (1e15, False)])
def test_far_away_meshes_and_elements_have_one_limit_for_rounding(place, fit, refinements):
    sphere = ec.sphere("icosahedron", refinements)
    tri = mesh(sphere.vertices + place, sphere.faces)
    if fit:
        ec.SurfaceSpace(tri)
        return
    for refuse in (ec.SurfaceSpace, lambda tri: ec.repair(tri, report=None)):
        with pytest.raises(ValueError, match="subtract the middle of the surface before it is"):
            refuse(tri)


def test_a_surface_that_rounding_has_made_one_point_is_told_so():
    text = message(mesh(SPHERE.vertices + 1e17, SPHERE.faces))
    assert text.endswith(
        "rounded to 2e+01; subtract the middle of the surface before it is rounded"
    )


def test_a_surface_too_small_for_its_areas_is_refused():
    """That of a unit sphere times 1e-80 came out as 12.41 e-160, and not 12.33."""
    ec.check_triangulation(mesh(1e-70 * SPHERE.vertices, SPHERE.faces))
    for size in (1e-71, 1e-80, 1e-100, 1e-300):
        tri = mesh(size * SPHERE.vertices, SPHERE.faces)
        assert message(tri).startswith("tri must be 1e-70 or more across, but is 2e-")
        with pytest.raises(ValueError, match=r"nodes must be 1e-70 or more .* in a smaller unit"):
            ec.SurfaceSpace.from_nodes(tri.vertices, tri.faces)


def test_a_fin_of_one_triangle_is_to_be_dropped_and_not_closed():
    a, b = SPHERE.faces[0, :2]
    vertices = np.vstack([SPHERE.vertices, 1.3 * SPHERE.vertices[a]])
    text = message(mesh(vertices, np.vstack([SPHERE.faces, [[a, b, 42]]])))
    assert text.startswith(f"the surface is not a manifold: edge ({a}, {b}) of triangle 0 belongs")
    assert "without walls inside it and fins: tri.update_faces(keep)" in text


def test_a_torus_may_be_small():
    for R in (1e-3, 1e-6, 1e-8):
        tri = ec.torus(R, 0.4 * R, 20, 8)
        assert (len(tri.vertices), len(tri.faces)) == (160, 320)
        ec.check_triangulation(tri)


def test_curved_elements_are_shown_their_door():
    space = ec.SurfaceSpace(SPHERE, 2, ec.to_unit_sphere)
    text = message(trimesh.Trimesh(space.nodes, space.cells))
    assert text.endswith("ec.SurfaceSpace.from_nodes(nodes, cells)")


@pytest.mark.parametrize("degree", range(2, MOST_DEGREE + 1))
def test_flat_elements_of_every_degree_are_not_made_another_surface(degree):
    """Cut into triangles some are flat; a repair of these had twice the area and was accepted."""
    space = ec.SurfaceSpace(ec.sphere("octahedron", 0), degree)
    tri = trimesh.Trimesh(space.nodes, space.cells, process=False)
    for refuse in (
        ec.check_triangulation,
        lambda tri: ec.check_triangulation(tri, boundary=True),
        lambda tri: ec.repair(tri, report=None),
    ):
        with pytest.raises(
            ValueError, match=r"fans .* ec\.SurfaceSpace\.from_nodes\(nodes, cells\)"
        ):
            refuse(tri)


def test_only_trimesh_is_taken_and_the_conversion_is_said():
    with pytest.raises(TypeError, match=r"tri must be a trimesh\.Trimesh, got \(\[\], \[\]\)"):
        ec.check_triangulation(([], []))
    with pytest.raises(TypeError, match=r"got a Scene; tri = ec\.read_mesh\(tri\) converts it"):
        ec.SurfaceSpace(trimesh.Scene([SPHERE]))
    for path in ("a.stl", Path("a.stl")):
        with pytest.raises(TypeError, match=r"; tri = ec\.read_mesh\('a\.stl'\) reads it"):
            ec.SurfaceSpace(path)
    pair = np.array(SPHERE.vertices), np.array(SPHERE.faces)
    with pytest.raises(TypeError, match=r"; tri = trimesh\.Trimesh\(\*tri, process=False\) makes"):
        ec.SurfaceSpace(pair)
    ec.SurfaceSpace(trimesh.Trimesh(*pair, process=False))
    for other in (ConvexHull(SPHERE.vertices), SPHERE.voxelized(0.5)):  # read_mesh takes neither
        with pytest.raises(TypeError, match=r"tri must be a trimesh\.Trimesh, got (?!.*read_mesh)"):
            ec.SurfaceSpace(other)


def test_vertices_at_one_place_are_to_be_merged_and_no_boundary_is_advised():
    said = message(soup(SPHERE))
    assert "not closed" in said
    assert "boundary=True" not in said


def test_whether_a_boundary_is_meant_is_yes_or_no():
    with pytest.raises(TypeError, match="boundary must be True or False, got 'no'"):
        ec.check_triangulation(SPHERE, boundary="no")


def with_some_turned():
    tri = half()
    tri.faces = np.vstack([tri.faces[:9, ::-1], tri.faces[9:]])
    return tri


def with_some_given_twice():
    tri = half()
    return mesh(tri.vertices, np.vstack([tri.faces, tri.faces[:1], tri.faces[5:8, ::-1]]))


@pytest.mark.parametrize(
    "tri",
    [
        with_some_turned(),
        with_some_given_twice(),
        joined(half(), turned(SPHERE).apply_translation([5, 0, 0])),
        joined(half(), SPHERE.copy().apply_scale(3), SPHERE.copy().apply_scale(2)),
    ],
    ids=["turned", "twice", "inwards", "cavity"],
)
def test_advice_for_a_surface_with_a_boundary_works_to_the_letter_and_leaves_it_open(tri):
    rim = (sides_of(half().faces).times == 1).sum()
    with pytest.raises(ValueError) as error:
        ec.check_triangulation(tri, boundary=True)
    advice = re.search(r"; (tri\.\S.*\)(?:\.cells)?) (?:turns|drops) ", str(error.value))
    exec(advice[1], names := {"ec": ec, "tri": tri})
    ec.check_triangulation(tri := names["tri"], boundary=True)
    assert len(ec.SurfaceSpace(tri, boundary=True).boundary_nodes) == rim


def longitudes_and_latitudes():
    """A northern half with triangles of no area at the pole, and a seam."""
    a, b = np.meshgrid(np.linspace(0, np.pi / 2, 5), np.linspace(0, 2 * np.pi, 17), indexing="ij")
    x = np.stack([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)], axis=-1)
    i = np.arange(85).reshape(5, 17)
    p, q, r, s = (part.ravel() for part in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    return mesh(x.reshape(-1, 3), np.vstack([np.stack([p, q, r], 1), np.stack([p, r, s], 1)]))


def with_a_needle():
    tri = half()
    a, b, c = tri.faces[0]
    x = np.array(tri.vertices)
    x[a] = (x[b] + x[c]) / 2
    return mesh(x, tri.faces)


@pytest.mark.parametrize("make", [longitudes_and_latitudes, with_a_needle])
def test_degenerate_triangles_of_an_open_surface_go_by_the_advice_and_it_stays_open(make):
    tri = make()
    with pytest.raises(ValueError, match="is degenerate") as error:
        ec.SurfaceSpace(tri, 1, boundary=True)
    advice = re.search(r"(tri = ec\.repair\(tri[^)]*\)) helps", str(error.value))
    exec(advice[1], names := {"ec": ec, "tri": tri})
    space = ec.SurfaceSpace(names["tri"], 1, boundary=True)
    area, before = space.mass_stiffness(space.nodes)[0].sum(), tri.area
    assert area == pytest.approx(before, rel=1e-12)
    assert (sides_of(space.cells).times == 1).any()


def test_messages_and_repairs_need_numpy_scipy_and_trimesh_only():
    code = """
import sys
for name in ("networkx", "rtree", "meshio", "lxml", "shapely"):
    sys.modules[name] = None
import numpy as np, trimesh, esfem_core as ec
s = ec.sphere("icosahedron", 1)
faces = np.array(s.faces)
faces[0] = faces[0, ::-1]
soup = s.vertices[faces[2:]].reshape(-1, 3)
tri = trimesh.Trimesh(soup, np.arange(len(soup)).reshape(-1, 3), process=False)
try:
    ec.check_triangulation(tri)
except ValueError as error:
    print(error)
ec.check_triangulation(ec.repair(ec.read_mesh(trimesh.Scene([tri]))))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "tri = ec.repair(tri) helps" in done.stdout


SAID = r"components 0 and 1 of 2, with triangles 0 and 80, lie at the same place; "


def test_of_two_copies_alike_oriented_a_repair_keeps_one():
    two = joined(SPHERE, SPHERE)
    with pytest.raises(ValueError, match=rf"{SAID}tri = ec\.repair\(tri\) helps \(dropped 80"):
        ec.check_triangulation(two)
    with pytest.raises(ValueError, match=f"{SAID}remove one of them"):
        ec.SurfaceSpace.from_nodes(two.vertices, two.faces)


def test_of_two_copies_oriented_against_each_other_a_person_removes_one():
    two = joined(SPHERE, turned(mesh(SPHERE.vertices[::-1], 41 - SPHERE.faces)))
    with pytest.raises(ValueError, match=f"{SAID}remove one of them"):
        ec.check_triangulation(two)
    with pytest.raises(ValueError, match=f"tri cannot be repaired: {SAID}remove one of them"):
        ec.repair(two, report=None)


def test_two_bodies_in_one_box_are_not_at_the_same_place():
    """An octahedron in a cube touches the same box, and inside out is a cavity of it."""
    cube = trimesh.creation.box((2.0, 2.0, 2.0))
    ec.check_triangulation(joined(cube, turned(ec.sphere("octahedron", 0))))


def test_vertices_too_far_away_for_areas_are_named_without_advice_that_fails():
    with pytest.raises(
        ValueError,
        match=r"tri must have coordinates up to 1e\+75, but point 0 is \[.* a larger unit",
    ):
        ec.check_triangulation(mesh(1e200 * SPHERE.vertices, SPHERE.faces))


@pytest.mark.parametrize("kind", [np.int32, np.uint32, np.uint64])
def test_faces_may_be_integers_of_any_type(kind):
    faces = np.array([[2, 1, 0], [1, 3, 0], [3, 2, 0], [2, 3, 1]])
    faces = faces.astype(kind)
    assert turned_to_outside(faces, np.eye(4, 3)[::-1], faces).all()
    # The keys of the edges from 0 to 3 and from 1 to 3 differ by 2**32.
    far = np.array([0, 2**15, 2**16, 2**17 - 1])[faces].astype(kind)
    assert (sides_of(far).times == 2).all()
    assert components(far).tolist() == [0] * 4
    np.testing.assert_array_equal(sides_of(far).edge, sides_of(faces).edge)
