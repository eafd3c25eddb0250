"""Spaces of given nodes and elements: of any degree, from files, and turned where they must be."""

from pathlib import Path

import meshio
import numpy as np
import pytest
from broken_meshes import SPHERE, joined, mesh
from scipy.spatial.transform import Rotation

import esfem_core as ec
from esfem_core.elements.numbering import mirrored
from esfem_core.surfaces.files import curved_elements
from esfem_core.surfaces.places import NEAR

DATA = Path(__file__).parents[1] / "surfaces" / "data"


def curved(degree, tri=SPHERE):
    return ec.SurfaceSpace(tri, degree, ec.to_unit_sphere)


def elements(nodes, cells):
    return meshio.Mesh(nodes, [("VTK_LAGRANGE_TRIANGLE", cells)])


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("order", ["vtk", "gmsh", "meshio"])
def test_nodes_and_elements_come_back_bit_for_bit(degree, order):
    made = curved(degree)
    space = ec.SurfaceSpace.from_nodes(made.nodes, made.cells, order=order)
    np.testing.assert_array_equal(space.nodes, made.nodes)
    np.testing.assert_array_equal(space.cells, made.cells)


# Areas that Gmsh itself computes from its elements, with the quadrature of the space.
@pytest.mark.parametrize(("degree", "area"), [(2, 12.544690125494014), (3, 12.57494757918213)])
def test_spheres_of_gmsh_have_their_area_to_the_last_bits(degree, area):
    said = []
    space = ec.SurfaceSpace.read(DATA / f"sphere_{degree}.msh", report=said.append)
    assert said == [f"sphere_{degree}.msh: degree {degree}, {len(space.nodes)} nodes, 78 cells"]
    assert space.integrate(space.nodes, 1) == pytest.approx(area, rel=1e-15)


@pytest.mark.parametrize("suffix", ["vtu", "msh"])
@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_files_of_any_degree_give_the_space_back(tmp_path, suffix, degree):
    made = curved(degree)
    kind = "triangle" if degree == 1 else f"triangle{made.cells.shape[1]}"
    if suffix == "vtu" and degree > 2:
        kind = "VTK_LAGRANGE_TRIANGLE"
    path = tmp_path / f"sphere.{suffix}"
    options = {"file_format": "gmsh"} if suffix == "msh" else {}
    meshio.write_points_cells(path, made.nodes, [(kind, made.cells)], **options)
    space = ec.SurfaceSpace.read(path, report=None)
    np.testing.assert_array_equal(space.cells, made.cells)
    np.testing.assert_allclose(space.nodes, made.nodes, rtol=0, atol=1e-15)


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_elements_of_mixed_orientation_are_turned(degree):
    def project(x):  # to the sphere and to the cavity
        outside = np.linalg.norm(x, axis=1, keepdims=True) > 0.6
        return np.where(outside, 1.0, 0.4) * ec.to_unit_sphere(x)

    tri = joined(SPHERE, mesh(0.4 * SPHERE.vertices, SPHERE.faces[:, ::-1]))
    made = ec.SurfaceSpace(tri, degree, project)
    cells = np.array(made.cells)
    wrong = np.random.default_rng(0).random(len(cells)) < 0.4
    cells[wrong] = cells[wrong][:, mirrored(degree)]
    said = []
    source = meshio.Mesh(
        made.nodes, [(f"triangle{cells.shape[1]}" if degree > 1 else "triangle", cells)]
    )
    space = ec.SurfaceSpace.read(source, report=said.append)
    np.testing.assert_array_equal(space.cells, made.cells)
    assert said[1] == f"turned {wrong.sum()} elements to agree and point outwards"
    inwards = ec.SurfaceSpace.from_nodes(made.nodes, made.cells[:, mirrored(degree)])
    np.testing.assert_array_equal(inwards.cells, made.cells)


@pytest.mark.parametrize("turn", [False, True])
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("degree", "outer", "inner", "radius"),
    [(2, 1, 1, 0.95), (4, 0, 0, 0.9), (4, 0, 2, 0.9), (2, 1, 3, 0.98), (1, 2, 2, 0.99)],
)
def test_the_cavity_of_a_thin_shell_is_oriented_inwards(degree, outer, inner, radius, seed, turn):
    """Though elements bulge beyond the corners of those on the other side."""
    around, within = (curved(degree, ec.sphere("icosahedron", n)) for n in (outer, inner))
    one, other = Rotation.random(2, random_state=seed).as_matrix()
    nodes = np.vstack([around.nodes @ one, radius * within.nodes @ other])
    mirror = mirrored(degree)
    cells = np.vstack([around.cells, len(around.nodes) + within.cells[:, mirror]])
    given = cells[:, mirror] if turn else cells
    np.testing.assert_array_equal(ec.SurfaceSpace.from_nodes(nodes, given).cells, cells)


def test_elements_without_common_nodes_are_joined_by_reading_and_refused_as_arrays():
    made = curved(2)
    nodes, cells = made.nodes[made.cells].reshape(-1, 3), np.arange(480).reshape(80, 6)
    with pytest.raises(ValueError, match=r"not closed: .* SurfaceSpace\.read makes one of nodes"):
        ec.SurfaceSpace.from_nodes(nodes, cells)
    said = []
    space = ec.SurfaceSpace.read(meshio.Mesh(nodes, [("triangle6", cells)]), report=said.append)
    assert said[1] == "merged 480 nodes into 162 at the same places"
    assert space.integrate(space.nodes, 1) == pytest.approx(
        made.integrate(made.nodes, 1), rel=1e-15
    )


@pytest.mark.parametrize("noise", [0, 1e-12])
def test_elements_that_share_corners_but_no_nodes_on_edges_are_joined_by_reading(noise):
    made = curved(2)
    cells = np.hstack([made.cells[:, :3], len(made.nodes) + np.arange(240).reshape(80, 3)])
    own = made.nodes[made.cells[:, 3:]].reshape(-1, 3)
    own = own + noise * np.random.default_rng(0).standard_normal(own.shape)
    used, cells = np.unique(cells, return_inverse=True)
    nodes = np.vstack([made.nodes, own])[used]
    source = meshio.Mesh(nodes, [("triangle6", cells.reshape(80, 6))])
    space = ec.SurfaceSpace.read(source, report=None)
    assert len(space.nodes) == len(made.nodes)
    assert space.integrate(space.nodes, 1) == pytest.approx(made.integrate(made.nodes, 1), rel=1e-9)


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_elements_with_nodes_of_their_own_share_them_within_rounding(degree):
    made = curved(degree)
    apart = made.nodes[made.cells].reshape(-1, 3)
    apart += 1e-10 * np.random.default_rng(0).uniform(-1, 1, apart.shape)
    cells = np.arange(len(apart)).reshape(made.cells.shape)
    found = curved_elements(elements(apart, cells))
    assert len(found.points) == len(made.nodes)
    np.testing.assert_allclose(found.points[found.cells[0][1]], made.nodes[made.cells], atol=1e-9)


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_elements_that_share_their_nodes_are_left_alone(degree):
    """Also where nodes are nearly at one place: of two spheres that are 1e-9 apart."""
    made = curved(degree)
    nodes = np.vstack([made.nodes, made.nodes + np.array([2 + 1e-9, 0, 0])])
    cells = np.vstack([made.cells, made.cells + len(made.nodes)])
    found = curved_elements(elements(nodes, cells))
    assert found.notes == []
    np.testing.assert_array_equal(found.points, nodes)


def test_of_an_element_given_twice_one_is_read_and_arrays_are_refused():
    made, said = curved(2), []
    twice = np.vstack([made.cells, made.cells[5:6]])
    with pytest.raises(ValueError, match=r"not a manifold: .* each once: cells = cells\[keep\]"):
        ec.SurfaceSpace.from_nodes(made.nodes, twice)
    source = meshio.Mesh(made.nodes, [("triangle6", twice)])
    space = ec.SurfaceSpace.read(source, report=said.append)
    np.testing.assert_array_equal(space.cells, made.cells)
    assert said[1] == "dropped 1 element given before"


def test_of_elements_given_twice_the_first_are_kept_in_their_order():
    made = curved(2)
    cells = np.random.default_rng(0).permutation(made.cells)
    found = curved_elements(elements(made.nodes, np.vstack([cells, cells[:7]])))
    np.testing.assert_array_equal(found.cells[0][1], cells)
    assert found.notes == ["dropped 7 elements given before"]


def test_nodes_outside_of_all_elements_are_refused_with_a_line_that_works():
    made = curved(2)
    nodes, cells = np.vstack([[[9.0, 9, 9]], made.nodes]), made.cells + 1
    with pytest.raises(ValueError, match=r"node 0 belongs to none \(1 such nodes\)") as error:
        ec.SurfaceSpace.from_nodes(nodes, cells)
    assert "used, numbers = np.unique(cells, return_inverse=True) gives nodes[used]" in str(
        error.value
    )
    used, numbers = np.unique(cells, return_inverse=True)
    space = ec.SurfaceSpace.from_nodes(nodes[used], numbers.reshape(cells.shape))
    np.testing.assert_array_equal(space.nodes, made.nodes)
    assert (
        len(ec.SurfaceSpace.read(meshio.Mesh(nodes, [("triangle6", cells)]), report=None).nodes)
        == 162
    )


def test_another_order_of_nodes_is_found_out():
    """As in Basix: edges (1, 2), (0, 2), (0, 1)."""
    made = curved(2)
    with pytest.raises(
        ValueError, match=r"does not have the nodes of its neighbours .*permutation"
    ):
        ec.SurfaceSpace.from_nodes(made.nodes, made.cells[:, [0, 1, 2, 4, 5, 3]])
    with pytest.raises(ValueError, match=r'order must be "vtk", "gmsh" or "meshio"'):
        ec.SurfaceSpace.from_nodes(made.nodes, made.cells, order="basix")


def test_edges_given_backwards_are_found_out():
    made = curved(3)
    backwards = made.cells[:, [0, 1, 2, 4, 3, 6, 5, 8, 7, 9]]
    message = r"do not fold back, .* nearer to it, or, .* in the order of VTK.*from 2 to 0.*permu"
    with pytest.raises(ValueError, match=message):
        ec.SurfaceSpace.from_nodes(made.nodes, backwards)
    swapped = np.zeros_like(made.nodes)
    swapped[made.cells] = made.nodes[backwards]
    with pytest.raises(ValueError, match=r"nodes nearer to it$"):  # their order is the class's own
        ec.SurfaceSpace(SPHERE, 3, lambda x: swapped[-len(x) :])


def test_unfit_elements_are_refused():
    made = curved(2)
    for cells, text in [
        (made.cells[:, :5], "cells must have 3, 6, 10, .* columns"),
        (made.cells + 1, "cells must hold numbers of nodes, 0 to 161"),
        (made.cells[1:], "a fit triangulation, but the surface is not closed"),
    ]:
        with pytest.raises(ValueError, match=text):
            ec.SurfaceSpace.from_nodes(made.nodes, cells)
    mixed = meshio.Mesh(
        made.nodes, [("triangle6", made.cells[:40]), ("triangle", made.cells[40:, :3])]
    )
    with pytest.raises(ValueError, match="one degree, but Mesh holds elements with 3 and 6 nodes"):
        ec.SurfaceSpace.read(mixed)
    quads = meshio.Mesh(made.nodes, [("triangle6", made.cells), ("quad", made.cells[:1, :4])])
    with pytest.raises(ValueError, match="for curved elements, but Mesh holds quad"):
        ec.SurfaceSpace.read(quads)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_vertices_are_projected_on_demand(degree):
    near = mesh(1.05 * SPHERE.vertices, SPHERE.faces)
    space = ec.SurfaceSpace(near, degree, ec.to_unit_sphere, project_vertices=True)
    np.testing.assert_allclose(np.linalg.norm(space.nodes, axis=1), 1, atol=1e-15)
    stays = ec.SurfaceSpace(near, degree, ec.to_unit_sphere)
    np.testing.assert_array_equal(stays.nodes[:42], near.vertices)


def test_a_projection_that_spoils_the_triangulation_is_refused():
    one, other = SPHERE.faces[0, :2]

    def onto_one_point(x):  # near enough, but the triangles there lose their area
        y = np.array(x)
        y[[one, other]] = (x[one] + x[other]) / 2
        return y

    with pytest.raises(ValueError, match=r"project makes the triangulation unfit: .* degenerate"):
        ec.SurfaceSpace(SPHERE, 2, onto_one_point, project_vertices=True)
    with pytest.raises(ValueError, match="project must move nodes to the surface that the tri"):
        ec.SurfaceSpace(ec.torus(), 2, ec.to_unit_sphere)
    with pytest.raises(ValueError, match="project_vertices needs a project"):
        ec.SurfaceSpace(SPHERE, 2, project_vertices=True)


@pytest.mark.parametrize("node", [-1, 5000])
def test_elements_of_a_file_with_nodes_that_are_not_there_are_named(node):
    space = ec.SurfaceSpace(SPHERE, 2, ec.to_unit_sphere)
    cells = space.cells.copy()
    cells[7, 4] = node
    source = meshio.Mesh(space.nodes, [("triangle6", cells)])
    with pytest.raises(
        ValueError, match=rf"nodes, 0 to 161, but element 7 of Mesh has node {node}"
    ):
        ec.SurfaceSpace.read(source, report=None)


@pytest.mark.parametrize("kind", [complex, str])
def test_points_of_no_real_numbers_are_refused(kind):
    source = meshio.Mesh(SPHERE.vertices, [("triangle", np.asarray(SPHERE.faces))])
    source.points = SPHERE.vertices.astype(kind)
    for read in (ec.SurfaceSpace.read, ec.read_mesh):
        with pytest.raises(TypeError, match="the points of source must hold real numbers"):
            read(source, report=None)


def test_nodes_too_far_away_for_areas_are_named():
    space = ec.SurfaceSpace(SPHERE, 2, ec.to_unit_sphere)
    with pytest.raises(ValueError, match=r"nodes must have coordinates up to 1e\+75, but point 0"):
        ec.SurfaceSpace.from_nodes(1e200 * space.nodes, space.cells)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({5: [0, np.nan, 1]}, r"nodes that are finite, but node 5 of Mesh is \[0\.0, nan, 1\.0\]"),
        ({7: [0, np.inf, 1]}, r"nodes that are finite, but node 7 of Mesh is \[0\.0, inf, 1\.0\]"),
        ({3: [1e155, 0, 0]}, r"coordinates up to 1e\+75, but point 3 is \[1e\+155, 0\.0, 0\.0\]"),
    ],
)
def test_nodes_of_elements_that_share_none_are_finite_and_not_too_far_away(change, text):
    """The search for nodes at one place had words of its own for them."""
    nodes = ec.sphere("octahedron", 1).triangles.reshape(-1, 3).copy()
    for i, place in change.items():
        nodes[i] = place
    apart = meshio.Mesh(nodes, [("triangle", np.arange(len(nodes)).reshape(-1, 3))])
    with pytest.raises(ValueError, match=text):
        ec.SurfaceSpace.read(apart, report=None)


def test_a_message_says_how_near_nodes_are_made_one():
    space = curved(2)
    apart = space.nodes[space.cells].reshape(-1, 3)
    cells = np.arange(len(apart)).reshape(space.cells.shape)
    corners, numbers = np.unique(space.cells[:, :3], return_inverse=True)
    cells[:, :3] = len(apart) + numbers.reshape(-1, 3)
    used, numbers = np.unique(cells, return_inverse=True)
    nodes, cells = np.vstack([apart, space.nodes[corners]])[used], numbers.reshape(cells.shape)
    with pytest.raises(ValueError, match="makes one of nodes nearer than") as refused:
        ec.SurfaceSpace.from_nodes(nodes, cells)
    assert float(str(refused.value).split("nearer than ")[1].split()[0]) == NEAR[-1]
