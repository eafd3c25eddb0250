"""Meshes from files of many kinds, and from other libraries."""

import io
from pathlib import Path
from types import SimpleNamespace

import meshio
import numpy as np
import pytest
import trimesh
from broken_meshes import SMALL, SPHERE, half, klein_bottle, mesh, pinched, soup, turned
from packaging.version import Version

import esfem_core as ec
from esfem_core.surfaces.files import BY_MESHIO, BY_TRIMESH
from esfem_core.surfaces.text_files import check_ply, solids

DATA = Path(__file__).parent / "data"
SHARED = Path(__file__).parents[2]


def read(source, **options):
    said = []
    return ec.read_mesh(source, report=said.append, **options), said


@pytest.fixture
def folder(tmp_path):
    return tmp_path


def written(folder, name, tri=SPHERE):
    path = folder / name
    if path.suffix[1:] in ("stl", "ply", "obj", "off", "glb"):
        tri.export(path)
    else:
        meshio.write_points_cells(path, tri.vertices, [("triangle", np.asarray(tri.faces))])
    return path


FORMATS = ["stl", "ply", "obj", "off", "glb", "vtk", "vtu", "msh", "mesh", "inp", "avs", "xml"]


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_closed_surface_of_any_format_is_fit_at_once(folder, suffix):
    tri, said = read(written(folder, f"sphere.{suffix}"))
    unit = " meters" if suffix == "glb" else ""
    assert said[
        0
    ] == f"sphere.{suffix}: 42 vertices, 80 triangles, 1 component, 1.9 x 1.9 x 1.9{unit}".replace(
        "1.9 x 1.9 x 1.9", " x ".join(f"{n:.3g}" for n in np.ptp(SPHERE.vertices, axis=0))
    )
    assert said[-1] == "fit for ec.SurfaceSpace"
    assert ("merged 240 vertices into 42 at the same places" in said) == (suffix == "stl")
    assert tri.volume == pytest.approx(SPHERE.volume, rel=1e-6)
    ec.SurfaceSpace(tri)


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize(
    ("broken", "word"),
    [
        (mesh(SPHERE.vertices, SPHERE.faces[1:]), "filled 1 hole"),
        (turned(SPHERE), "turned 1 component outwards"),
        (pinched(), "split 1 vertex"),
    ],
    ids=["hole", "inside out", "pinched"],
)
def test_a_broken_surface_of_any_format_comes_with_advice_that_works(folder, suffix, broken, word):
    tri, said = read(written(folder, f"broken.{suffix}", broken))
    assert said[-1].startswith("not fit as it is: ")
    assert "tri = ec.repair(tri) helps" in said[-1]
    assert word in said[-1]
    ec.SurfaceSpace(ec.repair(tri, report=None))


def test_lengths_of_1e_minus_8_survive_a_file(folder):
    for suffix in ("stl", "ply", "obj"):
        path = written(folder, f"small.{suffix}", mesh(1e-8 * SPHERE.vertices, SPHERE.faces))
        if suffix == "obj":  # trimesh writes eight digits after the point
            lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in (1e-8 * SPHERE.vertices).tolist()]
            path.write_text("\n".join(lines + [f"f {a} {b} {c}" for a, b, c in SPHERE.faces + 1]))
        tri, said = read(path)
        assert said[-1] == "fit for ec.SurfaceSpace"
        assert tri.volume == pytest.approx(1e-24 * SPHERE.volume, rel=1e-5)


def test_a_texture_does_not_tear_a_surface(folder):
    s, uv = ec.sphere("octahedron", 1), np.random.default_rng(0).random((96, 2))
    lines = [f"v {x} {y} {z}" for x, y, z in s.vertices.tolist()] + [f"vt {a} {b}" for a, b in uv]
    for t, face in enumerate(s.faces.tolist()):
        lines.append("f " + " ".join(f"{i + 1}/{3 * t + c + 1}" for c, i in enumerate(face)))
    path = folder / "textured.obj"
    path.write_text("\n".join(lines))
    tri, said = read(path)
    assert said[1:] == ["merged 96 vertices into 18 at the same places", "fit for ec.SurfaceSpace"]
    assert len(tri.vertices) == 18


def test_parts_of_a_scene_stand_in_their_places(folder):
    scene = trimesh.Scene([SPHERE])
    mirror = np.diag([-1.0, 1, 1, 1])
    mirror[0, 3] = 5
    scene.add_geometry(SPHERE, transform=mirror)
    path = folder / "two.glb"
    scene.export(path)
    for source in (scene, path, trimesh.load(io.BytesIO(path.read_bytes()), file_type="glb")):
        tri, said = read(source)
        assert "parts of the scene joined: 2" in said
        assert said[-1] == "fit for ec.SurfaceSpace"
        assert tri.bounds[1, 0] == pytest.approx(5 + SPHERE.vertices[:, 0].max())
        assert tri.volume == pytest.approx(2 * SPHERE.volume, rel=1e-6)


def test_a_part_of_a_scene_is_turned_as_it_says():
    """A quarter of a turn takes the first axis to the second."""
    turn = trimesh.transformations.rotation_matrix(np.pi / 2, [0, 0, 1])
    turn[2, 3] = 7
    scene = trimesh.Scene()
    scene.add_geometry(SPHERE.copy().apply_translation([5.0, 0, 0]), transform=turn)
    np.testing.assert_allclose(read(scene)[0].vertices.mean(axis=0), [0, 5, 7], atol=1e-12)


def test_units_are_kept_converted_or_missed(folder):
    path = written(folder, "sphere.glb")
    assert read(path)[0].units == "meters"
    tri, said = read(path, unit="millimeters")
    assert tri.units == "millimeters"
    assert said[0].endswith("millimeters")
    assert tri.volume == pytest.approx(1e9 * SPHERE.volume, rel=1e-6)
    with pytest.raises(ValueError, match=r'unit must be a unit of length such as "meters"'):
        read(path, unit="parsnips")
    with pytest.raises(ValueError, match=r"sphere\.stl does not say its unit.*apply_scale"):
        read(written(folder, "sphere.stl"), unit="meters")


@pytest.mark.parametrize("unit", ["um", "µm", "nm", "furlongs"])
def test_the_unit_that_is_not_known_is_the_one_that_is_named(unit):
    tri = SPHERE.copy()
    tri.units = unit
    assert read(tri)[0].units == unit
    with pytest.raises(ValueError, match=f"Trimesh says its unit is '{unit}', which is not known"):
        read(tri, unit="mm")
    tri.units = "microns"
    assert read(tri, unit="mm")[0].extents == pytest.approx(1e-3 * SPHERE.extents)
    with pytest.raises(ValueError, match=f"unit must be a unit .* or \"microns\", got '{unit}'"):
        read(tri, unit=unit)


def test_parts_in_different_units_are_not_joined():
    small, large = SPHERE.copy(), SPHERE.copy().apply_translation([3, 0, 0])
    small.units, large.units = "mm", "m"
    scene = trimesh.Scene([small, large])
    for unit in ("m", None):
        with pytest.raises(ValueError, match=r"in m and mm: part\.convert_units\('m'\) for each"):
            read(scene, unit=unit)
    with pytest.raises(ValueError, match="in m and mm"):
        ec.SurfaceSpace.read(scene, report=None)
    small.convert_units("m")
    tri, _ = read(trimesh.Scene([small, large]))
    assert tri.units == "m"
    assert tri.volume == pytest.approx((1 + 1e-9) * SPHERE.volume)
    large.metadata.pop("units")
    assert read(trimesh.Scene([small, large]))[0].units == "m"


def test_meshes_of_meshio_and_trimesh_are_taken():
    cells = [("triangle", np.asarray(SPHERE.faces))]
    for source in (meshio.Mesh(SPHERE.vertices, cells), SPHERE, soup(SPHERE)):
        tri, said = read(source)
        assert said[-1] == "fit for ec.SurfaceSpace"
        assert len(tri.vertices) == 42


def test_meshes_of_pyvista_are_taken():
    pyvista = pytest.importorskip("pyvista")
    _, said = read(pyvista.Sphere())
    assert said[-1] == "fit for ec.SurfaceSpace"
    made = ec.SurfaceSpace(SPHERE, 3, ec.to_unit_sphere)
    grid = pyvista.UnstructuredGrid({69: made.cells}, made.nodes)
    assert len(read(grid)[0].faces) == 80
    space = ec.SurfaceSpace.read(grid, report=None)
    np.testing.assert_array_equal(space.nodes, made.nodes)
    np.testing.assert_array_equal(space.cells, made.cells)


def test_polygons_and_bodies_become_triangles():
    box = np.array([[x, y, z] for z in (0.0, 1) for y in (0.0, 1) for x in (0.0, 1)])
    cube = np.array([[0, 1, 3, 2, 4, 5, 7, 6]])
    tets = np.array(
        [[0, 1, 3, 7], [0, 1, 7, 5], [0, 5, 7, 4], [0, 3, 2, 7], [0, 6, 4, 7], [0, 2, 6, 7]]
    )
    quads = cube[0][
        [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
    ]
    for kind, cells in (("hexahedron", cube), ("tetra", tets), ("quad", quads)):
        tri, said = read(meshio.Mesh(np.vstack([box, [[9.0, 9, 9]]]), [(kind, cells)]))
        assert said[-1] == "fit for ec.SurfaceSpace", said
        assert (len(tri.vertices), len(tri.faces)) == (8, 12)
        assert tri.volume == pytest.approx(1)


CORNERS = np.array([[x, y, z] for z in (0.0, 1.0) for y in (0.0, 1.0) for x in (0.0, 1.0)])
CUBE = np.array([[0, 1, 3, 2, 4, 5, 7, 6]])
TETRAHEDRA = np.array(
    [[0, 1, 3, 7], [0, 1, 7, 5], [0, 5, 7, 4], [0, 3, 2, 7], [0, 6, 4, 7], [0, 2, 6, 7]]
)
SQUARES = CUBE[0][
    [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
]


def is_the_cube(source):
    tri, _ = read(source)
    return (len(tri.vertices), len(tri.faces), tri.volume) == (8, 12, pytest.approx(1))


def test_a_body_in_several_blocks_has_one_boundary():
    """As Gmsh writes one for each physical volume: sides between blocks are inside."""
    blocks = [("tetra", TETRAHEDRA[:3]), ("tetra", TETRAHEDRA[3:])]
    assert is_the_cube(meshio.Mesh(CORNERS, blocks))


def test_a_body_that_is_left_out_beside_a_surface_is_told():
    """Triangles inside it may be all that is marked."""
    sphere = ("triangle", np.asarray(SMALL.faces))
    tetra, line = ("tetra", np.array([[0, 1, 2, 3]])), ("line", np.array([[0, 1]]))
    for cells, notes in (
        ([tetra, sphere, tetra, line], ["left out: 2 tetra, as there are cells of a surface"]),
        ([line, sphere], []),
    ):
        _, said = read(meshio.Mesh(SMALL.vertices, cells))
        assert said[1:] == [*notes, "fit for ec.SurfaceSpace"]
        ec.SurfaceSpace.read(meshio.Mesh(SMALL.vertices, cells), report=(said := []).append)
        assert said[1:] == notes


def test_of_curved_quadrilaterals_the_corners_are_taken():
    middles = (CORNERS[SQUARES] + CORNERS[np.roll(SQUARES, -1, axis=1)]) / 2
    cells = np.hstack([SQUARES, 8 + np.arange(24).reshape(6, 4)])
    points = np.vstack([CORNERS, middles.reshape(-1, 3)])
    assert is_the_cube(meshio.Mesh(points, [("quad8", cells)]))


@pytest.mark.parametrize(
    ("kind", "cells"),
    [("TETRAHEDRON", TETRAHEDRA), ("HEXAHEDRON", CUBE), ("QUADRILATERAL", SQUARES)],
)
def test_cells_of_vtk_have_long_names(kind, cells):
    assert is_the_cube(meshio.Mesh(CORNERS, [(f"VTK_LAGRANGE_{kind}", cells)]))


def grid(points, code, cells):
    """What is asked of an unstructured grid of PyVista."""
    return SimpleNamespace(
        points=points,
        celltypes=np.full(len(cells), code),
        cell_connectivity=cells.ravel(),
        offset=cells.shape[1] * np.arange(len(cells) + 1),
        cells_dict={},
        cell_data={},
    )


@pytest.mark.parametrize(("code", "cells"), [(9, SQUARES), (10, TETRAHEDRA), (12, CUBE)])
def test_cells_of_a_grid_are_known_by_the_numbers_of_vtk(code, cells):
    assert is_the_cube(grid(CORNERS, code, cells))


@pytest.mark.parametrize(("code", "degree"), [(5, 1), (22, 2), (69, 2), (69, 3)])
def test_triangles_of_a_grid_are_known_by_the_numbers_of_vtk(code, degree):
    made = ec.SurfaceSpace(SPHERE, degree, ec.to_unit_sphere)
    space = ec.SurfaceSpace.read(grid(made.nodes, code, made.cells), report=None)
    np.testing.assert_array_equal(space.nodes, made.nodes)
    np.testing.assert_array_equal(space.cells, made.cells)


def test_of_curved_elements_the_corners_are_taken_and_that_is_said():
    tri, said = read(DATA / "sphere_2.msh")
    assert said[1].startswith("corners of elements with 6 nodes taken; ec.SurfaceSpace.read")
    assert (len(tri.vertices), len(tri.faces)) == (41, 78)


def test_what_is_no_surface_is_reported():
    _, said = read(klein_bottle())
    assert "not orientable" in said[-1]
    assert "repair" not in said[-1]


def test_what_cannot_be_read_is_refused_with_what_to_do(folder):
    with pytest.raises(FileNotFoundError, match=r"there is no file '.*nothing\.stl'"):
        read(folder / "nothing.stl")
    with pytest.raises(TypeError, match=r"source must be the path of a file, or a mesh of trimesh"):
        read(7)
    for name in ("broken.vtk", "broken.ply", "broken.txt", "broken"):
        (folder / name).write_text("no mesh")
        with pytest.raises(ValueError, match=rf"{name} cannot be read.*or else write it as PLY"):
            read(folder / name)
    for end in ("gz", "bz2", "xz", "zip"):  # what is looked at in a file is not seen through them
        (folder / f"sphere.stl.{end}").write_bytes(b"packed")
        with pytest.raises(ValueError, match=rf"sphere\.stl\.{end} is packed: unpack it first"):
            read(folder / f"sphere.stl.{end}")
    for name, advice in [
        ("run.npz", r"ec\.load\('.*run\.npz'\)"),
        ("run.pvd", r"ends with \.vtu$"),
    ]:
        (folder / name).touch()
        for reading in (read, ec.SurfaceSpace.read):
            with pytest.raises(ValueError, match=rf"{name} .*: .*{advice}"):
                reading(folder / name)
    texts = {"empty.stl": "", "empty.obj": "", "page.stl": "<html><body>404</body></html>"}
    cloud, lines = trimesh.PointCloud(SPHERE.vertices), meshio.Mesh(np.eye(3), {"line": [[0, 1]]})
    for reading in (read, ec.SurfaceSpace.read):
        for name, text in texts.items():
            (folder / name).write_text(text)
            with pytest.raises(ValueError, match=f"triangles, but {name} holds none .nothing that"):
                reading(folder / name)
        with pytest.raises(ValueError, match=r"source .* Scene holds none \(points only\)"):
            reading(trimesh.Scene([cloud]))
        with pytest.raises(ValueError, match=r"source .* Mesh holds none \(line\)"):
            reading(lines)


def test_meshio_is_named_for_all_that_it_reads_and_nothing_else():
    ours = {f".{kind}" for kind in (*BY_MESHIO, *BY_TRIMESH)}
    theirs = {kind for kind in meshio.extension_to_filetypes if not kind.endswith(".gz")}
    # One is written only, and of a file of the other that was cut off meshio tries all splittings.
    assert theirs - ours == {".svg", ".wkt"}


@pytest.mark.parametrize("kind", ["off", "stl", "glb", "obj", "vtk", "vtu", "inp"])
@pytest.mark.parametrize(
    "error", [OSError(24, "Too many open files"), PermissionError(13, "no"), MemoryError()]
)
def test_what_the_system_cannot_do_says_nothing_about_a_file(folder, monkeypatch, kind, error):
    path = written(folder, f"sphere.{kind}")

    def refuse(*_, **__):
        raise error

    for place in ("pathlib.Path.read_bytes", "trimesh.load", "meshio.read"):
        monkeypatch.setattr(place, refuse)
    with pytest.raises(type(error)) as caught:
        read(path)
    assert caught.value is error


def test_a_file_that_belongs_to_one_and_is_missing_is_named_with_it(folder):
    (folder / "a.gltf").write_text(
        '{"asset": {"version": "2.0"}, "buffers": [{"byteLength": 4, "uri": "a.bin"}]}'
    )
    with pytest.raises(ValueError, match=r"a\.gltf cannot be read as \.gltf \(.*a\.bin"):
        read(folder / "a.gltf")


def test_a_missing_reader_is_named(folder, monkeypatch):
    path = written(folder, "sphere.vtk")
    monkeypatch.setitem(__import__("sys").modules, "meshio", None)
    with pytest.raises(
        ImportError, match=r'\.vtk are read by meshio: pip install "esfem-core\[files\]"$'
    ):
        read(path)


def test_a_mesh_without_a_unit_has_none():
    tri, _ = read(SPHERE)
    assert tri.units is None
    assert not read(tri)[1][0].endswith("none")


@pytest.mark.parametrize(
    ("points", "cells", "message"),
    [
        (np.eye(4), [("triangle", [[0, 1, 2]])], r"three coordinates, .* of shape \(4, 4\)"),
        (
            np.eye(3),
            [("triangle", [[7, 8, 9]])],
            "points up to 9 and down to 7, .* are 3, counted from 0",
        ),
        (np.eye(3), [("triangle", [[0, 1, 2], [1, 2, 3]])], "up to 3 and down to 0, .* are 3,"),
        (np.eye(3), [("quad", [[0, 1, 2, -1]])], "up to 2 and down to -1, .* are 3,"),
        (
            np.vstack([np.eye(3), -np.eye(3)]),
            [("tetra", [[0, 1, 2, 3]]), ("wedge", [[0, 1, 2, 3, 4, 5]])],
            "holds wedge beside other cells of a body: .* would have holes",
        ),
        (
            np.eye(3),
            [("triangle", [[0.0, 1, 2]])],
            r"rows of 3 or more integers for cells of kind triangle, but those of Mesh are of type "
            r"float64 and shape \(1, 3\)",
        ),
        (np.eye(3), [("triangle", [[0]])], r"3 or more integers .* triangle, .* shape \(1, 1\)"),
        (np.eye(3), [("quad", [[0, 1, 2]])], r"4 or more integers .* quad, .* shape \(1, 3\)"),
        (np.eye(3), [("tetra", [[0, 1, 2]])], r"4 or more integers .* tetra, .* shape \(1, 3\)"),
    ],
)
def test_what_would_give_another_surface_is_refused(points, cells, message):
    given = meshio.Mesh(points, [(kind, np.array(numbers)) for kind, numbers in cells])
    with pytest.raises(ValueError, match=message):
        read(given)


def test_points_and_lines_beside_a_body_do_no_harm():
    cells = [("tetra", [[0, 1, 2, 3]]), ("line", [[0, 1]]), ("vertex", [[0]])]
    cells.append(("VTK_LAGRANGE_CURVE", [[0, 1]]))
    given = meshio.Mesh(np.vstack([np.zeros(3), np.eye(3)]), [(k, np.array(n)) for k, n in cells])
    assert len(read(given)[0].faces) == 4


def test_an_open_surface_whose_triangles_share_no_vertices_is_joined_as_well():
    tri, _ = read(soup(half()))
    assert len(tri.vertices) == len(half().vertices)


@pytest.mark.parametrize("option", [{"unit": 3}, {"report": 3}])
def test_options_are_looked_at_before_a_file_is_read(option):
    with pytest.raises(TypeError, match=f"{next(iter(option))} must be a .*, got 3"):
        ec.read_mesh("none.stl", **option)


def test_an_address_is_no_path_and_is_shown_as_it_is():
    with pytest.raises(ValueError, match=r"got the address https://x\.org/a\.stl: download it"):
        read("https://x.org/a.stl")
    with pytest.raises(FileNotFoundError):
        read("C://meshes/a.stl")  # a drive


def test_a_path_where_nothing_can_be_is_named():
    with pytest.raises(ValueError, match=r"source must be the path of a file, got .*too long"):
        read("a" * 300 + ".ply")
    with pytest.raises(TypeError, match="source must be the path of a file"):
        read(b"mesh.ply")


@pytest.mark.parametrize("kind", ["msh", "mdpa", "node", "tec"])
@pytest.mark.parametrize("share", [0.002, 0.3, 0.6])
def test_a_file_that_was_cut_off_is_refused_and_not_waited_for(tmp_path, kind, share):
    tri = ec.sphere("octahedron", 1)
    whole, cut = tmp_path / f"whole.{kind}", tmp_path / f"cut.{kind}"
    tetra = ("tetra", np.array([[0, 1, 2, 3]])) if kind == "node" else ("triangle", tri.faces)
    meshio.Mesh(np.asarray(tri.vertices), [tetra]).write(whole)
    cut.write_bytes(whole.read_bytes()[: int(share * whole.stat().st_size)])
    with pytest.raises(ValueError, match=rf"cut\.{kind} cannot be read as \.{kind}"):
        ec.read_mesh(cut, report=None)


@pytest.mark.parametrize("corner", ["{0}", "{0}/-1", "{0}//-1", "{0}/-1/-1"])
def test_negative_numbers_of_an_obj_file_count_back_from_their_line(folder, corner):
    small = mesh(0.5 * SMALL.vertices + [3, 0, 0], SMALL.faces)
    lines = []
    for part in (SPHERE, small):
        lines += [f"o part\nv {x} {y} {z}\nvt 0 0\nvn 0 0 1" for x, y, z in part.vertices.tolist()]
        for face in (part.faces - len(part.vertices)).tolist():
            lines.append("f \\\n" + " ".join(corner.format(i) for i in face) + " # -")
    path = folder / "parts.obj"
    path.write_text("\n".join(lines))
    tri, said = read(path)
    assert said[-1] == "fit for ec.SurfaceSpace"
    assert len(tri.faces) == len(SPHERE.faces) + len(SMALL.faces)
    assert tri.volume == pytest.approx(SPHERE.volume + small.volume, rel=1e-6)


def test_a_corner_that_no_vertex_of_an_obj_file_has_is_refused(folder):
    path = folder / "early.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nf -3 -2 -1\nv 0 1 0\n")
    with pytest.raises(ValueError, match="a face has corner -3, but 2 vertices above it"):
        read(path)


def test_an_obj_file_may_have_tabs_indented_lines_comments_behind_lines_and_any_ends(folder):
    lines = [f"v {x} {y} {z}" for x, y, z in SMALL.vertices.tolist()]
    lines += [f"f {i} {j} {k}" for i, j, k in (SMALL.faces + 1).tolist()]
    for text in (
        "\n".join(lines).replace(" ", "\t"),
        "\n".join(lines[:-1]) + f"\n  {lines[-1]}",
        "\n".join(f"\t{line}" for line in lines),
        "# all\n" + "\n".join([f"{lines[0]} # first", *lines[1:]]),
        "\n".join([*lines[:-1], f"{lines[-1]} # last"]),
        "\r\n".join(["g a#1", f"{lines[0]}# first", *lines[1:]]),
        "\r".join(["# all", *lines]),
        "\r\n".join(lines),
    ):
        (folder / "small.obj").write_bytes(text.encode())
        tri, said = read(folder / "small.obj")
        assert said[-1] == "fit for ec.SurfaceSpace"
        assert np.array_equal(tri.faces, SMALL.faces)
        assert np.allclose(tri.vertices, SMALL.vertices, rtol=1e-15)


@pytest.mark.parametrize(
    ("kind", "encoding"),
    [
        *((k, "utf-8-sig") for k in ("obj", "off", "stl", "ply")),
        ("obj", "utf-16"),
        ("off", "utf-16"),
    ],
)
def test_a_byte_order_mark_takes_no_vertex_away(folder, kind, encoding):
    """A vertex without triangles at the end made up for the first one of OBJ files, unnoticed."""
    option = {"encoding": "ascii"} if kind == "ply" else {}
    text = SMALL.export(file_type="stl_ascii" if kind == "stl" else kind, **option)
    text = text if isinstance(text, str) else text.decode()
    if kind == "obj":
        text = text[text.index("v ") :] + "\nv 9 9 9\n"
    path = folder / f"small.{kind}"
    path.write_bytes(text.encode(encoding))
    tri, said = read(path)
    assert said[-1] == "fit for ec.SurfaceSpace"
    assert tri.volume == pytest.approx(SMALL.volume, rel=1e-6)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_negative_numbers_count_back_behind_a_byte_order_mark_as_well(folder, encoding):
    lines = [f"v {x} {y} {z}" for x, y, z in SMALL.vertices.tolist()]
    n = len(lines)
    lines += [f"f {i} {j} {k}" for i, j, k in (SMALL.faces - n).tolist()]
    (folder / "small.obj").write_bytes("\n".join([*lines, "v 9 9 9"]).encode(encoding))
    np.testing.assert_array_equal(read(folder / "small.obj")[0].vertices, SMALL.vertices)


def text_stl(*parts):
    """Solids of an STL file, with all digits."""
    facet = (
        "facet normal 0 0 0\nouter loop\n" + 3 * "vertex {!r} {!r} {!r}\n" + "endloop\nendfacet\n"
    )
    return "".join(
        "solid vertex 1 of a facet\n"
        + "".join(facet.format(*corners) for corners in part.triangles.reshape(-1, 9).tolist())
        + "endsolid\n"
        for part in parts
    )


@pytest.mark.parametrize("size", [1e-30, 1e-9, 1.0])
@pytest.mark.parametrize("count", [1, 2])
def test_solids_of_an_stl_file_of_text_keep_their_vertices_whatever_their_size(folder, size, count):
    """Vertices within 1e-8 were made one, if there were several solids."""
    parts = [
        mesh(size * (SPHERE.vertices + np.array([3 * i, 0, 0])), SPHERE.faces) for i in range(count)
    ]
    (folder / "small.stl").write_text(text_stl(*parts))
    tri, said = read(folder / "small.stl")
    assert said[-1] == "fit for ec.SurfaceSpace"
    assert len(tri.vertices) == count * len(SPHERE.vertices)
    assert tri.volume / size**3 == pytest.approx(count * SPHERE.volume)


def test_solids_with_a_side_in_common_stay_two(folder):
    boxes = [trimesh.creation.box(bounds=[[i, 0, 0], [i + 1, 1, 1]]) for i in (0, 1)]
    (folder / "boxes.stl").write_text(text_stl(*boxes))
    tri, said = read(folder / "boxes.stl")
    assert said[-1] == "fit for ec.SurfaceSpace"
    assert len(tri.vertices) == 16


def test_an_stl_file_of_text_that_was_cut_off_is_no_surface_without_its_last_solid(folder):
    text, path = text_stl(SMALL, SPHERE), folder / "cut.stl"
    assert len(solids(text.upper().replace("\n", "\r\n").encode())) == 2
    for share in (0.3, 0.5, 0.9):
        path.write_text(text[: int(share * len(text))])
        with pytest.raises(
            ValueError, match=r"cut\.stl cannot be read as \.stl \(.*it was cut off"
        ):
            read(path)
    for wrong in (text.replace("vertex", "", 4), text.removesuffix("endsolid\n")):
        path.write_text(wrong)
        with pytest.raises(ValueError, match=r"was cut off, or has other facets than triangles"):
            read(path)


@pytest.mark.parametrize("change", [-30, -1000, -4044, 1, 4084])
def test_a_binary_stl_file_of_another_length_than_it_says_is_not_said_to_hold_nothing(
    folder, change
):
    path = written(folder, "sphere.stl")
    data = path.read_bytes()
    path.write_bytes(data[:change] if change < 0 else data + (b"\n" if change == 1 else data))
    size = len(path.read_bytes())
    count = 80 if size >= 84 else 0
    with pytest.raises(
        ValueError,
        match=rf"it was cut off, or has more .* the {count} triangles that its header counts it "
        rf"should have {84 + 50 * count} bytes, but it has {size}\)",
    ):
        read(path)


@pytest.mark.parametrize("face", ["0 1 2", "1 2 0", "1/1 0/1 2/1", "2 0//1 1", " 1\t00 2 # last"])
def test_a_corner_0_of_an_obj_file_is_not_taken_for_the_first(folder, face):
    path = folder / "zero.obj"
    path.write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf {face}\n")
    with pytest.raises(ValueError, match="a face has corner 0: corners of an OBJ file count from"):
        read(path)
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n" + "v 1 1 1\n" * 97 + "f 1/10 2 100 # 0\n")
    assert len(read(path)[0].faces) == 1


@pytest.mark.parametrize("share", [0.001, 0.01, 0.1, 0.5, 0.9])
def test_an_off_file_that_was_cut_off_is_no_surface_with_holes(folder, share):
    path = written(folder, "sphere.off")
    assert len(ec.SurfaceSpace.read(path, report=None).cells) == 80
    path.write_text(path.read_text()[: int(share * path.stat().st_size)])
    with pytest.raises(ValueError, match=r"(it was cut off, .*: of 42 points|OFF and the numbers)"):
        read(path)


def test_a_ply_file_of_text_that_was_cut_off_is_no_surface_with_holes(folder):
    data, path = SMALL.export(file_type="ply", encoding="ascii").rstrip(), folder / "small.ply"
    path.write_bytes(data)
    assert read(path)[1][-1] == "fit for ec.SurfaceSpace"
    body = data.index(b"end_header") + len("end_header")
    for end in (*range(body, data.rindex(b" "), 7), data.rindex(b" ")):  # the last number is whole
        with pytest.raises(
            ValueError, match=r"its header counts \d+ lines of points and faces, but"
        ):
            check_ply(data[:end])
    path.write_bytes(data[: -len(data) // 10])
    with pytest.raises(ValueError, match=r"small\.ply cannot be read as \.ply \(.*it was cut off"):
        read(path)


@pytest.mark.parametrize("last", [[3, 0, 1, 4], [3, 0, 1]])
def test_polygons_of_several_kinds_in_a_binary_ply_file_are_not_said_to_be_cut_off_only(
    folder, last
):
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 5\n"
    head += "".join(f"property float {name}\n" for name in "xyz")
    head += "element face 2\nproperty list uchar uchar vertex_indices\nend_header\n"
    data = head.encode() + np.eye(5, 3, dtype="<f4").tobytes() + bytes([4, 3, 2, 1, 0, *last])
    (folder / "pyramid.ply").write_bytes(data)
    with pytest.raises(ValueError, match="was cut off, or has polygons of several kinds"):
        read(folder / "pyramid.ply")


def test_a_ply_file_whose_header_gives_too_few_vertices_is_refused(folder):
    data, n = SMALL.export(file_type="ply", encoding="ascii"), len(SMALL.vertices)
    path, wrong = folder / "small.ply", f"vertex {n - 1}\n".encode()
    path.write_bytes(data.replace(f"vertex {n}\n".encode(), wrong))
    with pytest.raises(ValueError, match=r"its header counts .*, or the header is wrong"):
        read(path)


def test_blank_lines_and_lists_of_other_lengths_in_a_ply_file_do_no_harm(folder):
    reads_empty_elements = Version(trimesh.__version__) >= Version("4.8.3")  # older ones refuse
    text = "ply\nformat ascii 1.0\ncomment c\nelement vertex 5\n"
    text += "".join(f"property float {name}\n" for name in "xyz")
    text += "element face 5\nproperty list uchar int vertex_indices\nproperty uchar red\n"
    if reads_empty_elements:
        text += "element edge 0\nproperty int vertex1\n"
    text += "end_header\n"
    text += "0 0 0\n1 0 0\n1 1 0\n0 1 0\n.5 .5 1\n"
    text += "4 3 2 1 0 9\n3 0 1 4 9\n3 1 2 4 9\n3 2 3 4 9\n3 3 0 4 9\n\n"
    for ends in ("\n", "\r\n"):
        (folder / "pyramid.ply").write_bytes(text.replace("\n", ends).encode())
        tri, said = read(folder / "pyramid.ply")
        assert said[-1] == "fit for ec.SurfaceSpace"
        assert tri.volume == pytest.approx(1 / 3)


@pytest.mark.parametrize("kind", ["4OFF", "nOFF", "C4nOFF"])
def test_an_off_file_with_another_number_of_coordinates_is_refused(folder, kind):
    path = folder / "four.off"
    path.write_text(f"{kind}\n3 1 0\n0 0 0 2\n1 0 0 2\n0 1 0 2\n3 0 1 2\n")
    with pytest.raises(ValueError, match=f"three coordinates, but {kind} stands for another"):
        read(path)


@pytest.mark.parametrize("corners", [3, 4, 6])
@pytest.mark.parametrize("head", ["OFF", "COFF # colours", "STCNOFF"])
def test_polygons_of_several_kinds_in_an_off_file_are_cut_into_triangles(folder, corners, head):
    """A prism: two polygons beside its sides, which have four corners."""
    angle = 2 * np.pi * np.arange(corners) / corners
    rim = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = [f"{x} {y} {z} 255 0 0" for z in (0, 1) for x, y in rim]
    n = np.arange(corners)
    after = np.roll(n, -1)
    polygons = [n[::-1], corners + n, *np.stack([n, after, corners + after, corners + n], axis=1)]
    rows = [" ".join(map(str, [len(p), *p, 0, 255, 0])) for p in polygons]
    path = folder / "prism.off"
    path.write_text("\n".join([head, f"{2 * corners} {len(rows)} 0", *points, "", *rows]))
    tri, said = read(path)
    assert said[-1] == "fit for ec.SurfaceSpace"
    assert tri.volume == pytest.approx(corners / 2 * np.sin(2 * np.pi / corners))


@pytest.mark.parametrize("suffix", ["stl", "ply", "glb"])
@pytest.mark.parametrize(
    ("away", "step"), [(500, None), (1e5, "0.0078, 0.01"), (1e6, "0.062, 0.1")]
)
def test_rounding_far_from_the_origin_is_told(folder, suffix, away, step):
    """The steps of single precision, against edges of 0.56; of 1e-4 of these nothing is said."""
    shift = np.array([0, away, 0])
    far = mesh(SPHERE.vertices + shift, SPHERE.faces)
    tri, said = read(written(folder, f"far.{suffix}", far))
    notes = [text for text in said if "single precision" in text]
    wanted = f"coordinates have steps of {step} of an edge: so far from the origin"
    assert [text.startswith(wanted) for text in notes] == [True] * (step is not None)
    assert all("move the surface to the origin before it is saved" in text for text in notes)
    moved = mesh(tri.vertices - shift, tri.faces)  # too late
    assert (abs(moved.volume / SPHERE.volume - 1) > 1e-5) == (step is not None)


def test_coordinates_that_are_not_rounded_are_not_called_so(folder):
    """Double precision, whole numbers, and fine meshes around the origin."""

    def notes(tri):
        return [text for text in read(tri)[1] if "single precision" in text]

    far = mesh(SPHERE.vertices + 1e6, SPHERE.faces)
    whole = trimesh.creation.box((2, 2, 2)).apply_translation([5e4, 0, 0])
    fine = mesh((1e-4 * SPHERE.vertices).astype(np.float32), SPHERE.faces)
    wide = trimesh.util.concatenate([fine, trimesh.creation.box((2, 2, 2))])
    assert notes(far) == notes(whole) == notes(fine) == notes(wide) == []
    assert len(notes(mesh(far.vertices.astype(np.float32), far.faces))) == 1


def test_rounding_of_curved_elements_is_told(folder):
    said = []
    far = mesh((SPHERE.vertices + 1e5).astype(np.float32), SPHERE.faces)
    ec.SurfaceSpace.read(far, report=said.append)
    assert sum("coordinates have steps of 0.0078" in text for text in said) == 1
