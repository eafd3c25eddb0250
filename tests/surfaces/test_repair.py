"""What a repair does to a mesh, and what it leaves alone."""

import contextlib
import re
import sys
import tracemalloc

import numpy as np
import pytest
import trimesh
from broken_meshes import (
    BROKEN,
    SPHERE,
    boxes_with_a_common_edge,
    half,
    joined,
    klein_bottle,
    longitudes,
    mesh,
    pinched,
    soup,
    turned,
)

import esfem_core as ec
from esfem_core.surfaces.places import merged


def repaired(tri, **options):
    said = []
    return ec.repair(tri, report=said.append, **options), said


def test_a_mesh_without_a_fault_is_left_as_it_is():
    again, said = repaired(SPHERE)
    assert said == ["nothing to repair"]
    np.testing.assert_array_equal(again.vertices, SPHERE.vertices)
    np.testing.assert_array_equal(again.faces, SPHERE.faces)
    again.apply_scale(2)
    np.testing.assert_array_equal(again.vertices, 2 * SPHERE.vertices)  # it was a copy


@pytest.mark.parametrize("name", BROKEN)
def test_the_given_mesh_stays_as_it_is(name):
    tri = BROKEN[name][0]
    vertices, faces = np.array(tri.vertices), np.array(tri.faces)
    with contextlib.suppress(ValueError):
        ec.repair(tri, report=None)
    np.testing.assert_array_equal(tri.vertices, vertices)
    np.testing.assert_array_equal(tri.faces, faces)


def test_repairs_are_printed_unless_told_otherwise(capsys):
    ec.repair(soup(SPHERE))
    assert capsys.readouterr().out == "merged 240 vertices into 42 at the same places\n"
    ec.repair(soup(SPHERE), report=None)
    assert capsys.readouterr().out == ""


def test_vertices_are_merged_across_seams_of_textures_and_normals():
    tri = soup(SPHERE)
    uv = np.random.default_rng(0).random((240, 2))
    tri.visual = trimesh.visual.TextureVisuals(uv=uv)
    tri.merge_vertices()
    assert len(tri.vertices) == 240
    assert len(ec.repair(tri, report=None).vertices) == 42


@pytest.mark.parametrize("size", [1e-8, 1.0, 1e6])
@pytest.mark.parametrize("noise", [0.0, 1e-10, 1e-7])
def test_merging_knows_the_size_of_the_surface(size, noise):
    tri = soup(SPHERE)
    x = tri.vertices + noise * np.random.default_rng(1).uniform(-1, 1, (240, 3))
    whole, said = repaired(mesh(size * x, tri.faces))
    assert len(whole.vertices) == 42
    assert len(said) == 1
    assert whole.volume == pytest.approx(size**3 * SPHERE.volume, rel=1e-6)


def test_a_vertex_that_many_triangles_share_is_merged_once():
    """The middles of the discs are given 4,000 times each: 8 million pairs, and half a gigabyte."""
    fan = np.random.default_rng(0).permutation(4000)
    angle = 2 * np.pi * np.arange(4000) / 4000
    rim = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    points = np.vstack([np.zeros((4000, 3)), rim[fan], rim + 1e-9, np.full((1, 3), np.nan)])
    tracemalloc.start()
    place = merged(points, 1e-8)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 1e7
    np.testing.assert_array_equal(place[:4000], 0)
    np.testing.assert_array_equal(place[4000:8000], 4000 + np.arange(4000))
    np.testing.assert_array_equal(place[8000:12000], 4000 + np.argsort(fan))
    assert place[-1] == 12000


def test_a_mesh_far_from_the_origin_is_repaired():
    tri = soup(SPHERE)
    whole, _ = repaired(mesh(np.asarray(tri.vertices) + 1e6, tri.faces))
    assert (len(whole.vertices), len(whole.faces)) == (42, 80)


def test_close_vertices_of_a_closed_surface_are_not_merged():
    """Two spheres 1e-9 apart are two."""
    near = mesh(SPHERE.vertices * [1, 1, 1] + [2 + 1e-9, 0, 0], SPHERE.faces)
    whole, _ = repaired(joined(SPHERE, turned(near)))
    assert len(whole.vertices) == 84


@pytest.mark.parametrize(("distance", "merges"), [(3e-7, True), (3e-6, False)])
def test_near_vertices_are_one_up_to_a_millionth_of_the_diagonal(distance, merges):
    """Of a triangle that is cut out and put back a little off; or else the hole is filled."""
    diagonal = np.linalg.norm(np.ptp(SPHERE.vertices, axis=0))
    off = SPHERE.triangles[0] + distance * diagonal * np.array([0.0, 0.0, 1.0])
    faces = np.vstack([SPHERE.faces[1:], [[42, 43, 44]]])
    whole, said = repaired(mesh(np.vstack([SPHERE.vertices, off]), faces))
    assert said[0].startswith("merged 45 vertices into 42") == merges
    assert len(whole.vertices) == 42


def shaken(tri, distance):
    x = np.asarray(tri.vertices)
    return mesh(x + distance * np.random.default_rng(0).normal(size=x.shape), tri.faces)


@pytest.mark.parametrize("distance", [5e-6, 1e-5, 1e-3])
def test_triangles_that_share_no_vertices_are_not_dropped_under_lids_of_their_own(distance):
    """Or else a thousandth of the body was left, and fit for a space."""
    whole = ec.sphere("icosahedron", 2)
    tri = shaken(soup(whole), distance)
    said = []
    ec.read_mesh(tri, report=said.append)
    with pytest.raises(ValueError, match="in pieces that share no vertices, whose corners") as told:
        repaired(tri)
    assert "in pieces that share no vertices" in said[-1]
    assert "boundary=True" not in said[-1]
    if distance < 1e-3:
        call, then = re.findall(r"apart: tri\.(\S.*\)) before tri = (.*\)) joins", str(told.value))[
            0
        ]
        eval(f"tri.{call}", {"tri": tri})
        again = eval(then, {"ec": ec, "tri": tri})
        assert again.volume == pytest.approx(whole.volume, rel=1e-3)


def tiny_ball(size):
    return mesh(size * SPHERE.vertices + [1.5, 0, 0], SPHERE.faces)


def with_a_short_edge(tri, share):
    x = np.array(tri.vertices)
    i, j = tri.edges_unique[0]
    x[i] = x[j] + share * (x[i] - x[j])
    return mesh(x, tri.faces)


FINE = ec.sphere("icosahedron", 2)
POINT = mesh(np.repeat(FINE.vertices[:1], 3, axis=0), [[0, 1, 2]])


@pytest.mark.parametrize("noise", [1e-9, 3e-8, 1e-7, 3e-7])
@pytest.mark.parametrize(
    "tri",
    [
        with_a_short_edge(FINE, 1e-5),
        with_a_short_edge(FINE, 1e-7),
        joined(FINE, POINT),
        *(joined(FINE, tiny_ball(size)) for size in (1e-8, 1e-6)),
    ],
)
def test_few_triangles_smaller_than_the_noise_do_not_keep_a_surface_in_pieces(tri, noise):
    """Or else each triangle got a lid of its own, was dropped, and a splinter was left."""
    loose = shaken(soup(tri), noise)
    whole, _ = repaired(loose)
    assert whole.volume == pytest.approx(tri.volume, rel=1e-5)
    again, _ = repaired(ec.read_mesh(loose, report=None))
    assert again.volume == pytest.approx(tri.volume, rel=1e-5)


def test_triangles_that_vanish_in_reading_are_told():
    said = []
    ec.read_mesh(shaken(soup(with_a_short_edge(FINE, 1e-5)), 4e-8), report=said.append)
    assert said[2:] == ["dropped 2 triangles smaller than that distance", "fit for ec.SurfaceSpace"]


def test_a_small_body_with_a_hole_does_not_vanish_for_its_three_edges():
    opened = mesh(1e-7 * SPHERE.vertices + [1.5, 0, 0], SPHERE.faces[1:])
    whole, _ = repaired(joined(FINE, opened))
    assert len(whole.faces) == len(FINE.faces) + len(SPHERE.faces)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("ground", [False, True])
def test_a_surface_that_is_joined_in_parts_is_not_dropped(seed, ground):
    """Corners lie about as far apart as they may: some are merged, and pieces hang together."""
    tri = soup(FINE)
    if ground:
        flat = np.array([[9, 9, -1], [-9, 9, -1], [-9, -9, -1], [9, -9, -1.0]])
        tri = joined(tri, soup(mesh(flat, [[0, 1, 2], [0, 2, 3]])))
    noise = np.random.default_rng(seed).normal(size=(len(tri.vertices), 3))
    size = np.linalg.norm(np.ptp(tri.vertices, axis=0))
    with pytest.raises(ValueError, match="it is in pieces that share no vertices"):
        repaired(mesh(tri.vertices + 7e-7 * size * noise, tri.faces))


@pytest.mark.parametrize("noise", [0.0, 1e-9, 1e-7])
def test_a_flat_triangle_that_sticks_to_an_edge_is_dropped(noise):
    """On a surface that is whole without it."""
    a, b, _ = FINE.triangles[0]
    tri = shaken(soup(joined(FINE, mesh([a, (a + b) / 2, b], [[0, 1, 2]]))), noise)
    whole, said = repaired(tri)
    assert said[1:] == ["dropped 1 flat triangle that stuck to the surface"]
    assert whole.volume == pytest.approx(FINE.volume, rel=1e-6)


def test_a_flat_triangle_is_not_flipped_with_its_own_lid():
    """They became triangles with a corner twice, in the mesh that came out."""
    needle = mesh([[5.0, 0, 0], [6, 0, 0], [5.5, 1e-9, 0]], [[0, 1, 2]])
    whole, said = repaired(joined(SPHERE, needle))
    assert said[-1] == "dropped 1 component without volume"
    assert len(whole.faces) == len(SPHERE.faces)


@pytest.mark.parametrize("size", [1e-30, 1e30])
def test_advice_to_round_corners_knows_the_size_of_the_surface(size):
    tri = shaken(soup(ec.sphere("icosahedron", 1)), 1e-5)
    with pytest.raises(ValueError, match=r"digits_vertex=-?\d+\) before .* joins them"):
        repaired(mesh(size * tri.vertices, tri.faces))


def test_two_halves_with_a_crack_between_them_are_not_made_two_bodies():
    tri = ec.sphere("octahedron", 1)
    upper = tri.triangles_center[:, 2] > 0
    one, other = (
        mesh(tri.vertices + np.array([0, 0, z]), tri.faces[at])
        for z, at in ((2e-5, upper), (0, ~upper))
    )
    with pytest.raises(
        ValueError, match=r"in pieces .* are up to 2e-05 apart: tri\.merge_vertices"
    ):
        repaired(joined(one, other))


def test_a_ground_that_is_larger_than_the_body_on_it_is_dropped():
    ground = soup(
        mesh(
            np.array([[9, 9, -1], [-9, 9, -1], [-9, -9, -1], [9, -9, -1.0]]), [[0, 1, 2], [0, 2, 3]]
        )
    )
    whole, said = repaired(joined(SPHERE, ground))
    assert len(whole.faces) == len(SPHERE.faces)
    assert "dropped 1 component without volume" in said


def test_degenerate_triangles_go_and_the_shape_stays():
    whole, said = repaired(longitudes())
    assert [line.split()[0] for line in said] == ["merged", "dropped"]
    assert whole.euler_number == 2
    assert len(whole.vertices) == 7 * 16 + 2
    whole, said = repaired(BROKEN["no area"][0])
    assert said == ["flipped 1 edge of triangles without area"]
    assert len(whole.faces) == 34
    assert whole.volume == pytest.approx(ec.sphere("octahedron", 1).volume, rel=1e-14)


def test_each_component_is_turned_for_itself_and_cavities_stay():
    hollow = joined(SPHERE, turned(mesh(0.5 * SPHERE.vertices, SPHERE.faces)))
    beside = mesh(0.7 * SPHERE.vertices + [3, 0, 0], SPHERE.faces)
    right = joined(hollow, beside)
    rng = np.random.default_rng(2)
    faces = np.array(right.faces)
    shuffled = rng.random(len(faces)) < 0.3  # fewer than half of each component
    faces[shuffled] = faces[shuffled][:, ::-1]
    whole, said = repaired(mesh(right.vertices, faces))
    assert said == [f"turned {shuffled.sum()} triangles to agree with neighbours"]
    np.testing.assert_array_equal(whole.faces[shuffled], right.faces[shuffled])
    assert whole.volume == pytest.approx(right.volume, rel=1e-14)
    whole, said = repaired(turned(right))
    assert said == ["turned 2 components outwards", "turned 1 cavity inwards"]
    assert whole.volume == pytest.approx(right.volume, rel=1e-14)


def test_small_holes_are_filled_and_large_ones_on_demand():
    tri = ec.sphere("icosahedron", 2)
    centre = np.bincount(tri.faces.ravel()).argmax()
    tri.update_faces((tri.faces != centre).all(axis=1))
    whole, said = repaired(tri)
    assert said[-1] == "filled 1 hole of 6 edges with 4 triangles"
    assert whole.volume == pytest.approx(tri.volume, rel=0.02)
    with pytest.raises(ValueError, match=r"edge .* belongs to 1 triangle") as error:
        ec.repair(tri, holes=5, report=None)
    assert "tri = ec.repair(tri, holes=6)" in str(error.value)
    lid, said = repaired(half(), holes=30)
    assert "filled 1 hole" in said[0]
    assert lid.euler_number == 2


@pytest.mark.parametrize("edges", [12, 13])
def test_holes_of_up_to_twelve_edges_are_filled_without_being_asked_for(edges):
    """A pyramid without its base."""
    angle = 2 * np.pi * np.arange(edges) / edges
    rim = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    faces = [[i, (i + 1) % edges, edges] for i in range(edges)]
    tri = mesh(np.vstack([rim, [[0, 0, 1]]]), faces)
    if edges == 12:
        assert repaired(tri)[0].volume == pytest.approx(12 * np.sin(np.pi / 6) / 2 / 3)
    else:
        with pytest.raises(ValueError, match="holes=13"):
            ec.repair(tri, report=None)


def tubes(count, n=180):
    """Tubes beside each other with rims of n edges."""
    angle, low = 2 * np.pi * np.arange(n) / n, np.arange(n)
    ring, after = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1), np.roll(low, -1)
    faces = np.vstack([np.c_[low, after, after + n], np.c_[low, after + n, low + n]])
    one = mesh(np.vstack([ring, np.array([0, 0, 1]) + ring]), faces)
    return joined(*(one.copy().apply_translation([3 * i, 0, 0]) for i in range(count)))


def test_many_large_lids_are_offered_without_having_been_made(monkeypatch):
    """Those of twenty tubes took 39 s, for an error message."""
    made = []

    def lid(vertices, rim, taken):
        made.append(len(rim))
        return []

    monkeypatch.setattr(sys.modules["esfem_core.surfaces.repair"], "lid_of", lid)
    words = r"40 holes of up to 180 edges are open: tri = ec\.repair\(tri, holes=180\) may put lids"
    with pytest.raises(ValueError, match=words):
        ec.check_triangulation(tubes(20))
    assert made == []
    with pytest.raises(ValueError, match="close it with a program for meshes"):
        ec.check_triangulation(tubes(1))
    assert made == [180, 180]


def test_holes_that_meet_in_a_vertex_are_filled_one_by_one():
    tri = ec.sphere("octahedron", 2)
    first, *others = np.flatnonzero((tri.faces == 0).any(axis=1))
    [opposite] = [t for t in others if len(np.intersect1d(tri.faces[t], tri.faces[first])) == 1]
    tri.update_faces(~np.isin(np.arange(len(tri.faces)), [first, opposite]))
    whole, said = repaired(tri)
    assert said == ["filled 2 holes of up to 3 edges with 2 triangles"]
    assert whole.volume == pytest.approx(ec.sphere("octahedron", 2).volume, rel=1e-14)


@pytest.mark.parametrize("turn", [trimesh.Trimesh.copy, turned], ids=["outwards", "inwards"])
@pytest.mark.parametrize("make", [pinched, boxes_with_a_common_edge])
def test_surfaces_that_touch_are_parted_and_stay_so(make, turn):
    whole, said = repaired(turn(make()))
    assert any(line.startswith("split ") for line in said)
    assert whole.euler_number == 4
    assert 0 < 2 - whole.volume < 5e-4  # as vertices move into their own box
    again = trimesh.Trimesh(
        whole.triangles.reshape(-1, 3), np.arange(whole.faces.size).reshape(-1, 3)
    )
    assert again.euler_number == 4  # merged by trimesh, as when read from a file
    ec.check_triangulation(again)
    np.testing.assert_array_equal(repaired(whole)[0].vertices, whole.vertices)


def test_a_vertex_that_is_split_moves_a_thousandth_into_its_own_fan():
    """Two tetrahedra: towards 2/3 of the height, so that the volume falls by 2/3000."""
    corners = np.vstack([np.zeros(3), np.eye(3), -np.eye(3)]) + np.array([1, 2, 3])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    other = np.where(faces > 0, faces + 3, 0)[:, ::-1]
    whole, _ = repaired(mesh(corners, np.vstack([faces, other])))
    np.testing.assert_array_equal(whole.vertices[:7], corners)
    assert whole.volume == pytest.approx(1 / 3 - 2e-3 / 3 / 6, rel=1e-12)


def test_boxes_with_a_common_wall_become_one_body():
    box = trimesh.creation.box()
    wall = joined(box, turned(mesh([1, 0, 0] + box.vertices * [-1, 1, 1], box.faces)))
    wall.merge_vertices()
    one, _ = repaired(wall)
    assert one.euler_number == 2
    assert one.volume == pytest.approx(2)


@pytest.mark.parametrize("doubled", [1, 2, 3, 6, 50, 80])
@pytest.mark.parametrize("apart", [False, True])
def test_of_a_surface_with_two_sides_one_is_kept(doubled, apart):
    """Both were dropped: of a whole sphere nothing was left, of single triangles flat lids."""
    both = mesh(SPHERE.vertices, np.vstack([SPHERE.faces, SPHERE.faces[:doubled, ::-1]]))
    whole, said = repaired(soup(both) if apart else both)
    assert f"dropped {doubled} triangle{'s' * (doubled > 1)} that others cover" in said
    assert len(whole.faces) == 80
    assert whole.volume == SPHERE.volume


def test_of_a_half_with_two_sides_one_is_kept_alone_and_none_beside_a_body():
    tri = half()
    two = mesh(tri.vertices, np.vstack([tri.faces, tri.faces[:, ::-1]]))
    lid, _ = repaired(tri, holes=30)
    assert repaired(two, holes=30)[0].volume == lid.volume
    beside = SPHERE.copy().apply_translation([3, 0, 0])
    assert repaired(joined(beside, two))[0].volume == beside.volume


def test_a_fin_of_two_sides_is_dropped():
    a, b = SPHERE.faces[0, :2]
    vertices = np.vstack([SPHERE.vertices, 1.3 * SPHERE.vertices[a]])
    whole, _ = repaired(mesh(vertices, np.vstack([SPHERE.faces, [[a, b, 42], [42, b, a]]])))
    assert whole.volume == SPHERE.volume


@pytest.mark.parametrize("copies", [2, 3])
def test_of_copies_of_a_surface_one_is_kept(copies):
    """Closed as each is, none would be merged; each lies in the other, and both turned inwards."""
    whole, said = repaired(trimesh.util.concatenate([SPHERE] * copies))
    assert (
        said[0] == f"dropped {(copies - 1) * len(SPHERE.faces)} triangles at the places of others"
    )
    assert len(whole.faces) == len(SPHERE.faces)
    assert whole.volume == pytest.approx(SPHERE.volume)
    ec.check_triangulation(whole)


@pytest.mark.parametrize("tri", [ec.sphere("octahedron", 2), ec.torus(1, 0.4, 24, 12)])
@pytest.mark.parametrize("digits", [None, 6])
def test_of_a_body_and_itself_turned_one_is_kept(tri, digits):
    again = tri.copy()
    again.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 0, 1]))
    if digits:
        again.vertices = again.vertices.round(digits)
    both = joined(tri, again)
    with pytest.raises(ValueError, match=r"lie at the same place; tri = ec\.repair.* helps"):
        ec.check_triangulation(both)
    assert repaired(both)[0].volume == pytest.approx(tri.volume, rel=1e-12)


def cut_along_a_side(tri, t):
    """Of the two triangles at a side of triangle t only one is cut in its middle."""
    a, b, c = tri.faces[t]
    middle = (tri.vertices[a] + tri.vertices[b]) / 2
    n = len(tri.vertices)
    faces = np.vstack([np.delete(tri.faces, t, axis=0), [[a, n, c], [n, b, c]]])
    return mesh(np.vstack([tri.vertices, middle]), faces)


@pytest.mark.parametrize("times", [1, 10])
def test_a_node_on_one_side_of_an_edge_only_is_taken_into_the_other(times):
    tri = SPHERE
    for i in range(times):
        tri = cut_along_a_side(tri, 5 * i)
    again, _ = repaired(tri)
    assert again.volume == pytest.approx(SPHERE.volume, rel=1e-12)
    assert again.area == pytest.approx(SPHERE.area, rel=1e-12)


@pytest.mark.parametrize("times", [1, 2])
def test_a_box_with_one_side_cut_finer_than_the_others_keeps_its_corners(times):
    """Lids close the side and the rest apart: the side is flat then, and dropped."""
    box = trimesh.creation.box()
    top = box.triangles_center[:, 2] == 0.5
    finer = mesh(box.vertices, box.faces[top])
    for _ in range(times):
        finer = finer.subdivide()
    whole, said = repaired(soup(joined(finer, mesh(box.vertices, box.faces[~top]))), holes=16)
    assert said[-1] == "dropped 1 component without volume"
    assert whole.volume == pytest.approx(1, rel=1e-14)
    np.testing.assert_array_equal(np.abs(whole.bounds), 0.5)


@pytest.mark.parametrize("far", [ec.sphere().apply_scale(1e7), mesh(np.eye(3), [[0, 1, 2]])])
def test_what_lies_far_away_does_not_make_one_vertex_of_a_body(far):
    opened = mesh(SPHERE.vertices, SPHERE.faces[1:])
    far = far.copy().apply_translation([2e7, 0, 0])
    again, _ = repaired(joined(opened, far), holes=40)
    near = again.vertices[:, 0] < 1e6
    assert near.sum() == len(SPHERE.vertices)


def test_a_unit_stays_and_none_is_made_up():
    opened = mesh(SPHERE.vertices, SPHERE.faces[1:])
    assert repaired(opened)[0].units is None
    opened.units = "millimeters"
    assert repaired(opened)[0].units == "millimeters"


LETTER = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]])


def prism(polygon, begin=0):
    """A prism of height 1 whose polygons are cut from their corner `begin`, as readers do."""
    n = len(polygon)
    rows = [np.roll(np.arange(n)[::-1], begin), np.roll(np.arange(n, 2 * n), begin)]
    rows += [[i, (i + 1) % n, n + (i + 1) % n, n + i] for i in range(n)]
    faces = [[row[0], row[i], row[i + 1]] for row in rows for i in range(1, len(row) - 1)]
    return mesh([(*p, z) for z in (0, 1) for p in polygon], faces)


@pytest.mark.parametrize("begin", range(6))
def test_a_polygon_that_is_not_convex_has_its_own_area(begin):
    tri = prism(LETTER, begin)
    assert tri.volume == pytest.approx(3)
    if tri.area > 14.1:
        with pytest.raises(ValueError, match=r"lie on each other: .* tri = ec\.repair.* helps"):
            ec.check_triangulation(tri)
    again, _ = repaired(tri)
    assert (again.volume, again.area) == pytest.approx((3, 14))


def test_of_many_stars_few_keep_a_wrong_area():
    rng = np.random.default_rng(0)
    wrong = []
    for _ in range(60):
        angle = np.sort(rng.uniform(0, 2 * np.pi, 7))
        if np.diff(angle, append=angle[0] + 2 * np.pi).max() > np.pi:
            continue
        x, y = rng.uniform(0.2, 1, 7) * [np.cos(angle), np.sin(angle)]
        sides = np.hypot(x - np.roll(x, 1), y - np.roll(y, 1)).sum()
        exact = sides + x @ np.roll(y, -1) - y @ np.roll(x, -1)
        wrong.append(abs(repaired(prism(np.stack([x, y], axis=1)))[0].area - exact) > 1e-9)
    assert len(wrong) > 40
    assert sum(wrong) <= 1  # triangles without area can hide that others lie on each other


def test_sheets_beside_a_body_are_dropped():
    sheet = mesh([[5.0, 0, 0], [6, 0, 0], [5, 1, 0]], [[0, 1, 2]])
    whole, said = repaired(joined(SPHERE, sheet))
    assert said[-1] == "dropped 1 component without volume"
    assert len(whole.faces) == 80


def test_what_cannot_be_repaired_is_said():
    with pytest.raises(ValueError, match="tri cannot be repaired: the surface is not orientable"):
        ec.repair(klein_bottle(), report=None)
    with pytest.raises(ValueError, match=r"tri cannot be repaired: .* encloses no volume"):
        ec.repair(mesh([[5.0, 0, 0], [6, 0, 0], [5, 1, 0]], [[0, 1, 2]]), report=None)
    with pytest.raises(TypeError, match=r"tri must be a trimesh\.Trimesh"):
        ec.repair("bunny.ply")
    with pytest.raises(ValueError, match="holes must be an integer >= 0"):
        ec.repair(SPHERE, holes=-1)


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (ec.check_triangulation, "tri"),
        (ec.SurfaceSpace, "tri"),
        (lambda tri: ec.SurfaceSpace.from_nodes(tri.vertices, tri.faces), "nodes"),
    ],
)
def test_spaces_refuse_what_is_too_far_away_as_a_repair_does(make, name):
    for size in (1e76, 1e160, 1e300):
        with pytest.raises(
            ValueError, match=rf"^{name} must have coordinates up to 1e\+75, but po"
        ):
            make(mesh(size * SPHERE.vertices, SPHERE.faces))
    make(mesh(1e75 * SPHERE.vertices, SPHERE.faces))


@pytest.mark.parametrize("make", [ec.repair, ec.read_mesh])
def test_vertices_too_far_away_for_areas_are_refused_and_named(make):
    for size in (1e76, 1e99, 1e110, 1e200, 1e300):
        with pytest.raises(ValueError, match=r"have coordinates up to 1e\+75, but point 0 is \["):
            make(mesh(size * SPHERE.vertices, SPHERE.faces), report=None)
    assert make(mesh(1e75 * SPHERE.vertices, SPHERE.faces), report=None).is_watertight
    unused = mesh(np.vstack([SPHERE.vertices, [[1e300, 0, 0]]]), SPHERE.faces)
    assert len(make(unused, report=None).vertices) == 42
