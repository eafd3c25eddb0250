"""Meshes from files, and from other libraries by :mod:`esfem_core.surfaces.sources`.

Files come as triangles, polygons, parts of a scene, curved elements or the inside of a body.
:func:`read_mesh` makes flat triangles of all of them, :func:`curved_elements` keeps the nodes of
curved ones for :meth:`esfem_core.SurfaceSpace.read`.
"""

import contextlib
import errno
import io
import itertools
import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from esfem_core.checks import (
    Array,
    Ints,
    function,
    package,
    path_of,
    shown,
    string,
)
from esfem_core.surfaces.check import boundary_advice
from esfem_core.surfaces.faults import check_coordinates, fault
from esfem_core.surfaces.orientation import components, sides_of
from esfem_core.surfaces.places import (
    NEAR,
    diagonal_of,
    joined,
    merged,
    merging,
    repeated,
    without_unused,
)
from esfem_core.surfaces.repair import counted, dropping, remedy
from esfem_core.surfaces.sources import Elements, of_mesh, of_meshio, of_scene
from esfem_core.surfaces.text_files import (
    check_ply,
    counted_from_the_first,
    points_and_polygons,
    solids,
    utf_8,
)
from esfem_core.surfaces.unread import KINDS, passed_over

__all__ = ["curved_elements", "read_mesh"]

BY_TRIMESH = (
    *("stl", "stl_ascii", "ply", "obj", "off", "glb", "gltf", "3mf", "dae", "zae", "xaml"),
    *("3dxml", "ctm", "step", "stp"),
)
BY_MESHIO = (
    *("avs", "bdf", "cgns", "dat", "dato", "e", "ele", "ex2", "exo", "f3grid", "fem", "h5m", "hmf"),
    *("inp", "mdpa", "med", "mesh", "meshb", "msh", "nas", "node", "post", "su2", "tec"),
    *("ugrid", "vol", "vtk", "vtu", "xdmf", "xmf", "xml"),
)
SIDES_OF = {  # of cells of a body, outwards
    "tetra": [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]],
    "hexahedron": [
        *([0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]),
    ],
}

SURFACE = ("triangle", "quad", "polygon")

COARSE = 1e-4  # steps of coordinates that are worth a word, over the mean edge
FAR = 10.0  # distance from the origin, over the size, from which on these are for moving a surface
ODD = (
    0.1  # share of odd numbers of steps: fewer are no rounding, but a grid such as of whole numbers
)

FLAT = ("vertex", "line", "curve", *(f"VTK cell type {n}" for n in (0, 1, 2, 3, 4, 21, 35, 68)))


def read_mesh(
    source: Any, unit: str | None = None, report: Callable[[str], object] | None = print
) -> trimesh.Trimesh:
    """Read flat triangles from a file, or take them from a mesh of another library.

    Polygons are cut into triangles, the parts of a scene are put in their places and joined, and
    of curved elements the corners are taken (:meth:`esfem_core.SurfaceSpace.read` keeps them
    curved). Bodies of tetrahedra and hexahedra are replaced by their boundary, but left out of a
    file that has cells of a surface as well, whatever part of the boundary or the inside these are.
    If triangles do not share vertices, as in STL files and along seams, vertices at equal places
    become one, or within 1e-6 of the diagonal if only that closes more of the surface; triangles
    smaller than that may vanish, one for ten edges that are closed. Points without triangles are
    left out. All else is as it is in the file, also what its writer has rounded, as trimesh does
    OBJ to eight decimals: see :func:`esfem_core.repair`.

    Parameters
    ----------
    source : path, trimesh.Trimesh, trimesh.Scene, meshio.Mesh or PyVista data set
        Files: STL, PLY, OBJ, OFF, GLB and glTF in a plain installation; Gmsh, VTK, VTU, Abaqus,
        Nastran, Medit, XDMF and what else meshio reads with ``pip install "esfem-core[files]"``.
    unit : str, optional
        Unit of length of the result, such as "meters" or "millimeters"; that of the file if None.
        Parts of a scene that do not say theirs are taken to have that of the others.
    report : callable, optional
        Is told, in lines of text, what was found and done, and whether the mesh is fit for a
        :class:`esfem_core.SurfaceSpace`, or else what helps.

    Returns
    -------
    trimesh.Trimesh
        ``tri.units`` is its unit, or None.

    Raises
    ------
    FileNotFoundError, ImportError
        If there is no such file, or a package that reads it is missing.
    OSError, MemoryError
        If the system cannot read it: too many are open, it may not be, or there is no room.
    TypeError, ValueError
        If the source is none of these, cannot be read, holds no triangles, has coordinates beyond
        1e75, or is less than 1e-70 across; if it is a file with parts that its reader would lose or
        put in wrong places, such as pieces of VTU, zones of Tecplot, parts of Abaqus and points of
        Nastran in systems of coordinates; if it is a scene whose parts have different units; if
        `unit` is given, but unknown or the source has none.

    Examples
    --------
    >>> import esfem_core as ec
    >>> scene = trimesh.Scene([ec.sphere(), ec.sphere().apply_translation([3, 0, 0])])
    >>> tri = read_mesh(scene)
    Scene: 516 vertices, 1024 triangles, 2 components, 5 x 2 x 2
    parts of the scene joined: 2
    fit for ec.SurfaceSpace
    """
    if unit is not None:
        string("unit", unit)
    if report is not None:
        function("report", report, "of a line of text, or None")
    found = _elements(source)
    if found.points.shape[1:] != (3,):
        raise ValueError(
            f"source must have points with three coordinates, but {found.name} has an array of "
            f"shape {found.points.shape}"
        )
    vertices, faces = found.points, _triangles(found)
    if len(faces) == 0:
        raise _without_triangles(found)
    steps = found.notes
    if len(curved := {cells.shape[1] for kind, cells in found.cells if kind == "triangle"} - {3}):
        steps.append(
            f"corners of elements with {' and '.join(map(str, sorted(curved)))} nodes taken; "
            "ec.SurfaceSpace.read keeps the other nodes"
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError(
            f"{found.name} holds triangles without all their corners: they name points up to "
            f"{faces.max()} and down to {faces.min()}, but there are {len(vertices)}, counted from "
            "0; it may have been cut off, or have been written with another count"
        )
    check_coordinates(f"source, {found.name},", vertices, faces)
    given = len(vertices)
    vertices, faces = without_unused(vertices, faces)
    if not curved:
        steps += dropping(given - len(vertices))
    vertices, faces = _joined(vertices, faces, steps)
    steps += _rounded_far_away(vertices, faces)
    scale, unit = _scale(found, unit)
    made = trimesh.Trimesh(scale * vertices, faces, process=False)
    if unit is not None:  # trimesh makes text of None
        made.units = unit
    if report is not None:
        report(f"{found.name}: {_described(vertices, faces, scale)}{f' {unit}' if unit else ''}")
        for step in steps:
            report(step)
        report(_fitness(vertices, faces))
    return made


def _without_triangles(found: Elements) -> ValueError:
    kinds = ", ".join(sorted({kind for kind, _ in found.cells}))
    empty = len(found.points) == 0 and not found.notes
    kinds = kinds or ("nothing that can be read" if empty else "points only")
    return ValueError(
        f"source must hold triangles, but {found.name} holds none ({kinds}); write the surface "
        "with the program that made it"
    )


def _described(vertices: Array, faces: Ints, scale: float) -> str:
    """Numbers of vertices, triangles and components, and the size in three directions."""
    finite = vertices[np.isfinite(vertices).all(axis=1)]
    size = " x ".join(f"{scale * n:.3g}" for n in np.ptp(finite, axis=0)) if len(finite) else "?"
    parts = counted(int(components(faces).max(initial=-1)) + 1, "component")
    corners = counted(len(vertices), "vertex", "vertices")
    return f"{corners}, {counted(len(faces), 'triangle')}, {parts}, {size}"


def _rounded_far_away(vertices: Array, faces: Ints) -> Iterator[str]:
    """A note if single precision has rounded the shape, far from the origin."""
    x = vertices[np.isfinite(vertices).all(axis=1)]
    with np.errstate(over="ignore"):
        single = x.astype(np.float32)
    if len(x) == 0 or not np.array_equal(x, single):
        return
    axis = int(np.argmax(np.abs(x).max(axis=0)))
    largest = float(np.abs(x[:, axis]).max())
    step = float(np.spacing(np.float32(largest)))
    with np.errstate(all="ignore"):  # of corners that are not finite, nothing is said here
        sides = vertices[faces] - vertices[np.roll(faces, 1, axis=1)]
        edge = float(np.linalg.norm(sides, axis=2).mean())
    far = largest > FAR * np.ptp(x, axis=0).max()
    rounded = (np.spacing(np.abs(single[:, axis])) == step) & (x[:, axis] / step % 2 == 1)
    if far and step > COARSE * edge and rounded.mean() > ODD:
        yield (
            f"coordinates have steps of {step:.2g}, {step / edge:.1g} of an edge: so far from the "
            "origin single precision rounds the shape to these, and ec.repair does not bring it "
            "back; move the surface to the origin before it is saved"
        )


def _fitness(vertices: Array, faces: Ints) -> str:
    """Whether a mesh is fit for a space as it is, or else what helps."""
    wrong = fault(vertices, faces)
    if wrong is None:
        return "fit for ec.SurfaceSpace"
    helps = f"{remedy(vertices, faces, wrong)}{boundary_advice(vertices, faces)}"
    return f"not fit as it is: {wrong.text}; {helps}"


def curved_elements(source: Any) -> Elements:
    """Nodes and Lagrange triangles of one degree, for :meth:`esfem_core.SurfaceSpace.read`.

    Nodes that belong to no element are left out; if elements do not share nodes, those at equal
    places become one, or within 1e-6 of the diagonal. Of an element given twice one is kept.

    Parameters
    ----------
    source : as for :func:`read_mesh`

    Returns
    -------
    Elements
        With one entry in ``cells``.

    Raises
    ------
    FileNotFoundError, ImportError, TypeError, ValueError
        As for :func:`read_mesh`; if there are no triangles, or of several degrees, or other cells
        beside them.
    """
    found = _elements(source)
    blocks = [cells for kind, cells in found.cells if kind == "triangle" and len(cells)]
    others = sorted({kind for kind, cells in found.cells if kind in SURFACE[1:]})
    if not any(kind in (*SURFACE, *SIDES_OF) and len(cells) for kind, cells in found.cells):
        raise _without_triangles(found)
    if not blocks or others:
        kinds = ", ".join(others or sorted({kind for kind, _ in found.cells}))
        raise ValueError(
            f"source must have triangles for curved elements, but {found.name} holds {kinds}: have "
            "its surface meshed with triangles, or take flat ones by ec.read_mesh"
        )
    numbers = sorted({cells.shape[1] for cells in blocks})
    if len(numbers) > 1:
        raise ValueError(
            f"source must have elements of one degree, but {found.name} holds elements with "
            f"{' and '.join(map(str, numbers))} nodes: write the mesh with elements of one order"
        )
    cells = np.vstack(blocks)
    wrong = (cells < 0) | (cells >= len(found.points))
    if wrong.any():
        t = int(np.argmax(wrong.any(axis=1)))
        raise ValueError(
            f"source must have elements of its nodes, 0 to {len(found.points) - 1}, but element "
            f"{t} of {found.name} has node {cells[t][wrong[t]][0]}"
        )
    infinite = np.intersect1d(np.flatnonzero(~np.isfinite(found.points).all(axis=1)), cells)
    if len(infinite):
        raise ValueError(
            f"source must have nodes that are finite, but node {infinite[0]} of {found.name} is "
            f"{found.points[infinite[0]].tolist()}"
        )
    check_coordinates(f"source, {found.name},", found.points, cells)
    _tell_left_out(found)
    nodes, cells = without_unused(found.points, cells)
    found.notes.extend(dropping(len(found.points) - len(nodes)))
    nodes, cells = _with_shared_nodes(nodes, cells, found.notes)
    found.notes.extend(_rounded_far_away(nodes, cells[:, :3]))
    _, once = np.unique(np.sort(cells, axis=1), axis=0, return_index=True)
    if len(once) < len(cells):
        found.notes.append(f"dropped {counted(len(cells) - len(once), 'element')} given before")
        cells = cells[np.sort(once)]
    return found._replace(points=nodes, cells=[("triangle", cells)])


def _with_shared_nodes(nodes: Array, cells: Ints, notes: list[str]) -> tuple[Array, Ints]:
    """Nodes at one place as one, to rounding, where neighbours do not share those on their edge."""
    diagonal = diagonal_of(nodes)
    for near in NEAR:
        if _share_nodes(cells):
            break
        place = merged(nodes, near * diagonal)[cells]
        if near and (repeated(place) & ~repeated(cells)).any():
            break  # that is no rounding: nodes of one element would be one
        count = len(np.unique(place))
        if count < len(nodes):
            notes.append(merging(len(nodes), "nodes", count, near * diagonal))
            nodes, cells = without_unused(nodes, place)
    return nodes, cells


def _share_nodes(cells: Ints) -> bool:
    """Whether the elements of a surface are closed and have no more nodes than they need."""
    sides = sides_of(cells[:, :3])
    inner = round((np.sqrt(8 * cells.shape[1] + 1) - 3) / 2) - 1  # of an edge
    wanted = len(np.unique(cells[:, :3])) + inner * (int(sides.edge.max()) + 1)
    wanted += len(cells) * inner * (inner - 1) // 2
    return not (sides.times == 1).any() and len(np.unique(cells)) == wanted


def _elements(source: Any) -> Elements:
    if isinstance(source, str | os.PathLike):
        if re.match(r"\w\w+://", str(source)):  # one letter is a drive
            raise ValueError(
                f"source must be the path of a file, got the address {source}: download it first, "
                "or give its path"
            )
        return _of_file(path_of("source", source, "a file"))
    return of_mesh(source)


def _of_file(path: Path) -> Elements:
    if not path.is_file():
        raise FileNotFoundError(f"source must be a file, but there is no file {str(path)!r}")
    kind = path.suffix.lower().lstrip(".")
    if kind not in (*BY_TRIMESH, *BY_MESHIO):
        raise ValueError(_unknown(path, kind))
    if kind in KINDS and (lost := passed_over(kind, path.read_bytes())):
        raise ValueError(
            f"{path.name} has {lost!r}: parts of its surface would be lost, or stand in wrong "
            "places; write it as one part in one system of coordinates, or as PLY, STL or OBJ, of "
            "triangles only, with the program that made it"
        )
    said = io.StringIO()
    try:
        if kind == "off":
            points, polygons = points_and_polygons(
                utf_8(path.read_bytes()).decode("utf-8", "replace")
            )
            cells = [("triangle" if p.shape[1] == 3 else "polygon", p) for p in polygons]
            found = Elements(path.name, points, cells, None, [])
        elif kind in BY_TRIMESH:
            found = of_scene(path.name, _scene(path, kind))
        else:
            meshio = _meshio(path)
            with (
                contextlib.redirect_stdout(said),
                contextlib.redirect_stderr(said),
                _known_ends(meshio._files, meshio.tetgen._tetgen),
            ):
                found = of_meshio(path.name, meshio.read(path))
    except ImportError as error:
        if error.name == "meshio":
            raise
        missing = re.search(r"No module named '(\w+)'|pip install (\w+)", str(error))
        name = next(filter(None, missing.groups()), "") if missing else ""
        raise ImportError(
            f"files .{kind} need another package: pip install {name or error}", name=name
        ) from error
    except (Exception, SystemExit) as error:  # meshio leaves Python where it cannot read
        if _is_of_system(error):
            raise
        reason = " ".join(said.getvalue().split()) or f"{type(error).__name__}: {error}"
        raise ValueError(
            f"{path.name} cannot be read as .{kind} ({reason}); {_other_ways(path)}"
        ) from error
    if found.unit is None and kind in ("glb", "gltf"):
        found = found._replace(unit="meters")  # by the standard
    return found


def _is_of_system(error: BaseException) -> bool:
    """Whether an error says nothing about a file, such as that too many are open."""
    if isinstance(error, OSError):  # damaged files name others, and places before their beginning
        return error.errno not in (None, errno.ENOENT, errno.EINVAL)
    return isinstance(error, MemoryError)


@contextlib.contextmanager
def _known_ends(*modules: Any) -> Iterator[None]:
    """Let meshio open files that say when they end: it waits for ever for lines cut off."""
    for module in modules:
        module.open = _ending
    try:
        yield
    finally:
        for module in modules:
            vars(module).pop("open", None)  # another thread may have done it


def _ending(path: str, mode: str = "r") -> Any:
    """A file that cannot be read for ever behind its end."""
    file: Any = open(path, mode)  # noqa: SIM115 - closed by meshio
    ends = itertools.count()

    def bounded(read: Callable[..., Any]) -> Callable[..., Any]:
        def more(*size: int) -> Any:
            found = read(*size)
            if not found and next(ends) == 100:  # readers that know the end ask once or twice
                raise EOFError("the file ends too early")
            return found

        return more

    file.read, file.readline = bounded(file.read), bounded(file.readline)
    return file


def _unknown(path: Path, kind: str) -> str:
    if kind in ("gz", "bz2", "xz", "zip"):
        return f"{path.name} is packed: unpack it first"
    if kind == "npz":
        return f"{path.name} is no mesh: ec.load({str(path)!r}) reads what ec.save has written"
    if kind == "pvd":
        return f"{path.name} only names the files of a series: read one that ends with .vtu"
    what = f"files .{kind} are not read" if kind else "files are known by their suffix"
    return f"{path.name} cannot be read: {what}; {_other_ways(path)}"


def _other_ways(path: Path) -> str:
    return (
        f"if PyVista can read it, pyvista.read({str(path)!r}) is taken instead of the path, or "
        "else write it as PLY, STL or OBJ, of triangles only, with the program that made it"
    )


def _meshio(path: Path) -> Any:
    return package(f"files {path.suffix} are read by meshio", "meshio", "files")


def _scene(path: Path, kind: str) -> Any:
    if kind == "obj" and (text := counted_from_the_first(path.read_bytes())) is not None:
        return trimesh.load(io.BytesIO(text), file_type=kind, force="scene", process=False)
    if kind in ("stl", "stl_ascii") and (parts := solids(path.read_bytes())) is not None:
        return trimesh.Scene([_solid(corners.reshape(-1, 3), len(parts)) for corners in parts])
    if kind == "ply":
        check_ply(path.read_bytes())
    try:
        return trimesh.load(path, force="scene", process=False)
    except ValueError as error:
        if kind == "ply" and "unexpected length" in str(error):
            raise ValueError(
                "it was cut off, or has polygons of several kinds, which are read from PLY files "
                "of text only"
            ) from error
        raise


def _solid(corners: Array, count: int) -> trimesh.Trimesh:
    """One of so many solids; of several each is joined by itself: two may have a side in common."""
    place = merged(corners, 0.0) if count > 1 else np.arange(len(corners))
    return trimesh.Trimesh(*without_unused(corners, place.reshape(-1, 3)), process=False)


def _triangles(found: Elements) -> Ints:
    """Flat triangles of the cells, (T, 3): those of surfaces, or the boundary of a body."""
    polygons = [
        numbers[:, : {"triangle": 3, "quad": 4}.get(kind)]
        for kind, numbers in found.cells
        if kind in SURFACE and len(numbers)
    ]
    if polygons:
        _tell_left_out(found)
    else:
        polygons = _boundary(found)
    cut = sum(len(corners) for corners in polygons if corners.shape[1] > 3)
    if cut:
        found.notes.append(f"cut into triangles: {cut} polygons")
    return np.vstack([np.zeros((0, 3), dtype=np.int64), *_fans(polygons)])


def _tell_left_out(found: Elements) -> None:
    """Note the cells of a body that are not looked at beside those of a surface."""
    counts: dict[str, int] = {}
    for kind, numbers in found.cells:
        if kind not in (*SURFACE, *FLAT) and len(numbers):
            counts[kind] = counts.get(kind, 0) + len(numbers)
    if counts:
        left = ", ".join(f"{count} {kind}" for kind, count in counts.items())
        found.notes.append(f"left out: {left}, as there are cells of a surface")


def _boundary(found: Elements) -> list[Ints]:
    """Sides of the cells of a body that belong to one cell only, by kind of cell."""
    out = []
    known = {*SIDES_OF, *FLAT}
    others = sorted({kind for kind, numbers in found.cells if len(numbers) and kind not in known})
    if others and any(kind in SIDES_OF for kind, _ in found.cells):
        raise ValueError(
            f"{found.name} holds {' and '.join(others)} beside other cells of a body: their sides "
            "are not known here, and the boundary would have holes; write the surface with the "
            "program that made it"
        )
    for kind, numbers in _of_one_kind(found.cells):
        found.notes.append(f"boundary of {len(numbers)} cells ({kind}) taken")
        sides = np.vstack([numbers[:, side] for side in SIDES_OF[kind]])
        _, first, times = np.unique(
            np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True
        )
        out.append(sides[np.sort(first[times == 1])])
    return out


def _of_one_kind(cells: list[tuple[str, Ints]]) -> Iterator[tuple[str, Ints]]:
    for kind in SIDES_OF:
        blocks = [numbers[:, : np.max(SIDES_OF[kind]) + 1] for k, numbers in cells if k == kind]
        if blocks:
            yield kind, np.vstack(blocks)


def _fans(polygons: list[Ints]) -> Iterator[Ints]:
    for corners in polygons:
        n = corners.shape[1]
        fan = np.array([[0, i, i + 1] for i in range(1, n - 1)])
        yield corners[:, fan].reshape(-1, 3)


def _joined(vertices: Array, faces: Ints, steps: list[str]) -> tuple[Array, Ints]:
    """Vertices at one place as one, if that closes more of the surface."""
    moved, distance = joined(vertices, faces)
    if moved is faces:
        return vertices, faces
    steps.append(merging(len(vertices), "vertices", len(np.unique(moved)), distance))
    if gone := len(faces) - len(moved):
        steps.append(f"dropped {counted(gone, 'triangle')} smaller than that distance")
    return without_unused(vertices, moved)


def _scale(found: Elements, unit: str | None) -> tuple[float, str | None]:
    """Factor to a unit of length, and the unit."""
    if unit is None or unit == found.unit:
        return 1.0, found.unit
    if found.unit is None:
        raise ValueError(
            f"{found.name} does not say its unit: leave unit out, and scale by hand, "
            "such as tri.apply_scale(0.001)"
        )
    try:
        trimesh.units.unit_conversion(found.unit, "meters")
    except (KeyError, ValueError) as error:
        raise ValueError(
            f"{found.name} says its unit is {found.unit!r}, which is not known here: set units to "
            'a word such as "microns", "nanometers" or "mm", or leave unit out'
        ) from error
    try:
        return float(trimesh.units.unit_conversion(found.unit, unit)), unit
    except (KeyError, ValueError) as error:
        raise ValueError(
            f'unit must be a unit of length such as "meters" or "microns", got {shown(unit)}'
        ) from error
