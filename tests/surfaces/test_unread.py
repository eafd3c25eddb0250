"""Files with parts that their readers would lose, or put in wrong places, are refused."""

import json
import struct
import sys
from base64 import b64encode

import meshio
import numpy as np
import pytest
from broken_meshes import SMALL

import esfem_core as ec
from esfem_core.surfaces.unread import passed_over

FAR = SMALL.vertices + np.array([30, 0, 0])


def rows(table, separator, *, numbered=False):
    """Lines of numbers, in the way of Abaqus with their own number first."""
    lines = [separator.join(map(repr, row)) for row in np.asarray(table).tolist()]
    return "".join(f"{i}, {line}\n" if numbered else f"{line}\n" for i, line in enumerate(lines, 1))


def piece(points):
    corners, n = np.asarray(SMALL.faces), len(SMALL.faces)
    arrays = [("connectivity", corners), ("offsets", 3 * np.arange(1, n + 1)), ("types", n * [5])]
    said = "".join(
        f'<DataArray type="Int64" Name="{name}" format="ascii">{rows(np.ravel(values)[None], " ")}'
        "</DataArray>"
        for name, values in arrays
    )
    return (
        f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{n}"><Points><DataArray '
        f'type="Float64" NumberOfComponents="3" format="ascii">{rows(points, " ")}</DataArray>'
        f"</Points><Cells>{said}</Cells></Piece>"
    )


def vtu(*parts):
    inside = "".join(map(piece, parts))
    return (
        '<?xml version="1.0"?><VTKFile type="UnstructuredGrid" version="0.1" byte_order='
        f'"LittleEndian"><UnstructuredGrid>{inside}</UnstructuredGrid></VTKFile>'
    )


def tecplot(*parts):
    head = 'TITLE = "zone"\nVARIABLES = "X" "Y" "Z"\n'
    corners = rows(SMALL.faces + 1, " ")
    return head + "".join(
        f"ZONE N={len(points)}, E={len(SMALL.faces)}, DATAPACKING=POINT, ZONETYPE=FETRIANGLE\n"
        + rows(points, " ")
        + corners
        for points in parts
    )


def su2(*parts):
    corners = rows(np.insert(np.asarray(SMALL.faces), 0, 5, axis=1), " ")
    return f"NZONE= {len(parts)}\n" + "".join(
        f"IZONE= {i}\nNDIME= 3\nNELEM= {len(SMALL.faces)}\n{corners}"
        f"NPOIN= {len(points)}\n{rows(points, ' ')}NMARK= 0\n"
        for i, points in enumerate(parts, 1)
    )


def abaqus(*parts, before="", behind=""):
    corners = rows(SMALL.faces + 1, ", ", numbered=True)
    return before + "".join(
        f"*PART, NAME=P-{i}\n*Node\n{rows(points, ', ', numbered=True)}"
        f"*NODE PRINT\n*ELEMENT, TYPE=S3\n{corners}*END PART\n{behind}"
        for i, points in enumerate(parts)
    )


def instances(*places):
    return "".join(f"*INSTANCE, NAME=A, PART=P-0\n{place}*END INSTANCE\n" for place in places)


def nastran(system, kind="GRID", form="{}{:>8d}{:>8}{:8.4f}{:8.4f}{:8.4f}\n", width=8, more=""):
    points = [
        form.format(kind.ljust(width), i, system, *point)
        for i, point in enumerate(SMALL.vertices.tolist(), 1)
    ]
    triangles = [f"CTRIA3,{t},1,{a},{b},{c}\n" for t, (a, b, c) in enumerate(SMALL.faces + 1, 1)]
    return f"BEGIN BULK\n{more}{''.join([*points, *triangles])}ENDDATA\n"


COMMAS = {"form": "{},{},{},{},{},{}\n", "width": 0}
LARGE = {"kind": "GRID*", "form": "{}{:>16d}{:>16}{:16.10f}{:16.10f}\n*       {:16.10f}\n"}

WHOLE = {
    "one.vtu": vtu(SMALL.vertices),
    "one.dat": tecplot(SMALL.vertices),
    "one.su2": su2(SMALL.vertices),
    "one.inp": abaqus(SMALL.vertices),
    "placed.inp": abaqus(SMALL.vertices) + instances("0., 0., 0.\n"),
    "included.inp": abaqus(SMALL.vertices) + "*INCLUDE, INPUT=empty.inp\n",
    "blank.nas": nastran(""),
    "basic.bdf": nastran("0", **COMMAS),
    "large.fem": nastran("", **LARGE, more="GRDSET,,,,,,6\nCORD2C,5,0,0.,0.,0.,0.,0.,1.\n"),
}


@pytest.mark.parametrize("name", WHOLE)
def test_files_of_one_part_are_read(tmp_path, name):
    (tmp_path / name).write_text(WHOLE[name])
    (tmp_path / "empty.inp").write_text("** nothing\n")
    tri = ec.read_mesh(tmp_path / name, report=None)
    assert ec.repair(tri, report=None).volume == pytest.approx(SMALL.volume, rel=1e-3)


TWO = SMALL.vertices, FAR
BROKEN = {
    "two.vtu": (vtu(*TWO), "2 times <PIECE"),
    "two.dat": (tecplot(*TWO), "2 times ZONE"),
    "two.tec": (tecplot(*TWO).lower(), "2 times ZONE"),
    "two.su2": (su2(*TWO), "2 times NPOIN"),
    "two.inp": (abaqus(*TWO), r"2 times \*PART"),
    "nodes.inp": (abaqus(*TWO).replace("PART", "X"), r"2 times \*NODE"),
    "twice.inp": (abaqus(FAR) + instances("", "30., 0., 0.\n"), r"2 times \*INSTANCE"),
    "moved.inp": (abaqus(FAR) + instances("30., 0., 0.\n"), r"\*INSTANCE, NAME=A, PART=P-0 30\., "),
    "turned.inp": (abaqus(FAR) + instances("0., 0., 0.\n0, 0, 0, 0, 0, 1, 90\n"), "1, 90"),
    "system.inp": (abaqus(FAR).replace("*Node", "*Node, System=C"), r"\*Node, System=C"),
    "other.inp": (abaqus(FAR, before="*SYSTEM\n1., 0., 0.\n"), r"\*SYSTEM"),
    "made.inp": (abaqus(FAR, behind="*ELGEN\n1, 5\n"), r"\*ELGEN"),
    "away.inp": (abaqus(FAR, behind="*ELEMENT, TYPE=S3, INPUT=b.txt\n"), "INPUT=b.txt"),
    "above.inp": (abaqus(FAR, before="*INCLUDE, INPUT=b.inp\n"), r"\*INCLUDE, INPUT=b\.inp'"),
    "small.nas": (nastran("5"), "GRID 1 5 "),
    "commas.bdf": (nastran("12", **COMMAS), "GRID,1,12,"),
    "large.fem": (nastran("10", **LARGE), r"GRID\* 1 10 "),
    "all.nas": (nastran("", more="GRDSET,,3\n"), "GRDSET,,3"),
    "include.nas": (nastran("", more="INCLUDE 'other.bdf'\n"), r"INCLUDE 'other\.bdf'"),
}


@pytest.mark.parametrize("name", BROKEN)
@pytest.mark.parametrize("reading", [ec.read_mesh, ec.SurfaceSpace.read])
def test_files_of_several_parts_or_systems_are_refused_before_a_part_is_lost(
    tmp_path, name, reading
):
    text, found = BROKEN[name]
    for ends in ("\n", "\r\n"):
        (tmp_path / name).write_bytes(text.replace("\n", ends).encode())
        with pytest.raises(ValueError, match=f"{name} has .*{found}.*write it as one part in one"):
            reading(tmp_path / name, report=None)


@pytest.mark.parametrize("kind", ["vtu", "dat", "tec", "inp", "post", "dato", "mdpa"])
def test_what_meshio_writes_itself_has_one_part(tmp_path, kind):
    cells = [("triangle", SMALL.faces[:40]), ("triangle", SMALL.faces[40:])]
    path = tmp_path / f"a.{kind}"
    meshio.write_points_cells(path, SMALL.vertices, cells)
    assert passed_over(kind, path.read_bytes()) is None


def test_parts_of_other_formats_are_counted():
    for kind, word in (("post", "$COOR NSET=A"), ("dato", "$COOR"), ("mdpa", "Begin Nodes")):
        data = f"{word}\n1 0. 0. 0.\n".encode()
        assert passed_over(kind, data) is None
        assert passed_over(kind, 2 * data) == f"2 times {word.upper().partition(' NSET')[0]}"


def gltf(folder, primitives, arrays=(), **more):
    """A file with SMALL as arrays 0 and 1, and further arrays as 2, 3, ..."""
    arrays = [np.asarray(SMALL.vertices, "<f4"), np.asarray(SMALL.faces, "<u4"), *arrays]
    kinds = {"float32": 5126, "uint32": 5125, "int16": 5122}
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": primitives}],
        "bufferViews": [{"buffer": i, "byteLength": a.nbytes} for i, a in enumerate(arrays)],
        "buffers": [
            {
                "byteLength": a.nbytes,
                "uri": f"data:application/octet-stream;base64,{b64encode(a.tobytes()).decode()}",
            }
            for a in arrays
        ],
        "accessors": [
            {
                "bufferView": i,
                "componentType": kinds[a.dtype.name],
                "count": len(a) if a.dtype.kind == "f" or a.dtype.itemsize == 2 else a.size,
                "type": "SCALAR" if a.dtype.kind == "u" else "VEC3",
            }
            for i, a in enumerate(arrays)
        ],
        **more,
    }
    for accessor, words in tree.pop("changes", {}).items():
        tree["accessors"][accessor] |= words
    path = folder / "a.gltf"
    path.write_text(json.dumps(tree))
    binary = json.dumps(tree).encode()
    head = struct.pack("<4sIIII", b"glTF", 2, 20 + len(binary), len(binary), 0x4E4F534A)
    path.with_suffix(".glb").write_bytes(head + binary)
    return path, path.with_suffix(".glb")


PLAIN = {"attributes": {"POSITION": 0}, "indices": 1}
FAN = {"attributes": {"POSITION": 0}, "indices": 2, "mode": 6}
SPARSE = {"sparse": {"count": 1, "indices": {"bufferView": 1}, "values": {"bufferView": 0}}}


@pytest.mark.parametrize(
    ("primitives", "more", "found"),
    [
        ([PLAIN], {"changes": {0: SPARSE}}, "a sparse accessor"),
        ([PLAIN], {"changes": {1: SPARSE}}, "a sparse accessor"),
        ([PLAIN], {"changes": {0: {"normalized": True}}}, "normalized positions"),
        ([PLAIN, FAN], {}, r"triangle fans \(mode 6\)"),
        ([PLAIN], {"extensionsRequired": ["EXT_meshopt_compression"]}, "EXT_meshopt_compression"),
        ([PLAIN], {"extensionsUsed": ["EXT_mesh_gpu_instancing"]}, "EXT_mesh_gpu_instancing"),
    ],
)
def test_what_trimesh_passes_over_in_gltf_is_refused(tmp_path, primitives, more, found):
    for path in gltf(tmp_path, primitives, [np.arange(4, dtype="<u4")], **more):
        with pytest.raises(ValueError, match=f"{path.name} has .{found}.*wrong places; write it"):
            ec.read_mesh(path, report=None)


def test_plain_triangles_and_strips_of_gltf_are_read(tmp_path):
    """Whatever stands beside them: lines, materials, a mesh that trimesh itself refuses."""
    strip = np.array([0, 1, 2, 3, 0, 1], dtype="<u4")
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, -1]], dtype="<f4")
    band = {"attributes": {"POSITION": 3}, "indices": 2, "mode": 5}
    lines = {"attributes": {"POSITION": 4}, "mode": 1}
    more = {"extensionsRequired": ["KHR_texture_transform"], "changes": {4: {"normalized": True}}}
    arrays = [strip, corners, np.eye(3, dtype="<i2")]
    for path in gltf(tmp_path, [PLAIN, band, lines], arrays, **more):
        tri = ec.read_mesh(path, report=None)
        assert tri.volume == pytest.approx(SMALL.volume + 1 / 6, rel=1e-6)
    (tmp_path / "bad.gltf").write_text("[1]")
    with pytest.raises(ValueError, match=r"bad\.gltf cannot be read as \.gltf"):
        ec.read_mesh(tmp_path / "bad.gltf")


def test_what_reads_compressed_meshes_is_named_where_it_is_missing(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    for path in gltf(tmp_path, [PLAIN], extensionsRequired=["KHR_draco_mesh_compression"]):
        with pytest.raises(ImportError, match=r"pip install DracoPy$") as found:
            ec.read_mesh(path)
        assert found.value.name == "DracoPy"
    (path, _) = gltf(tmp_path, [PLAIN], extensionsUsed=["KHR_draco_mesh_compression"])
    assert ec.read_mesh(path, report=None).volume == pytest.approx(SMALL.volume, rel=1e-6)
