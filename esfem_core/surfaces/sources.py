"""Meshes of other libraries, trimesh, meshio and PyVista: points and cells as they come."""

import re
from typing import Any, NamedTuple

import numpy as np
import trimesh

from esfem_core.checks import Array, Ints, real_array, shown

__all__ = ["Elements", "of_mesh", "of_meshio", "of_scene"]

VTK_CELLS = {5: "triangle", 7: "polygon", 9: "quad", 10: "tetra", 12: "hexahedron", 22: "triangle"}
VTK_CELLS |= {69: "triangle"}
CORNERS = {"triangle": 3, "quad": 4, "polygon": 3, "tetra": 4, "hexahedron": 8}


class Elements(NamedTuple):
    """Points and cells as they come.

    Attributes
    ----------
    name : str
        What a report calls them.
    points : (n, 3) float array
    cells : list of (str, (m, k) int array)
        Kinds without the number of their nodes: "triangle", "quad", "polygon", "tetra", ...
    unit : str or None
        Unit of length, if it is known.
    notes : list of str
        What was done and left out.
    """

    name: str
    points: Array
    cells: list[tuple[str, Ints]]
    unit: str | None
    notes: list[str]


def of_mesh(source: Any) -> Elements:
    """Points and cells of a mesh of trimesh, meshio or PyVista.

    Raises
    ------
    TypeError, ValueError
        If it is none of these; if its arrays are no points and cells.

    Examples
    --------
    >>> import esfem_core as ec
    >>> found = of_mesh(ec.sphere("octahedron", 1))
    >>> found.name, [(kind, cells.shape) for kind, cells in found.cells]
    ('Trimesh', [('triangle', (32, 3))])
    """
    name = type(source).__name__
    if isinstance(source, trimesh.Trimesh):
        return of_scene(name, trimesh.Scene([source]))
    if isinstance(source, trimesh.Scene):
        return of_scene(name, source)
    if hasattr(source, "points") and hasattr(source, "cells_dict") and hasattr(source, "cell_data"):
        if hasattr(source, "celltypes"):
            return _of_pyvista(name, source)
        return of_meshio(name, source)
    if hasattr(source, "points") and hasattr(source, "faces") and hasattr(source, "triangulate"):
        triangles = np.asarray(source.triangulate().faces, dtype=np.int64).reshape(-1, 4)[:, 1:]
        return Elements(name, _three(source.points), [("triangle", triangles)], None, [])
    if hasattr(source, "extract_surface"):  # grids of PyVista
        return of_mesh(source.extract_surface())._replace(name=name)
    raise TypeError(
        "source must be the path of a file, or a mesh of trimesh, meshio or PyVista, got "
        f"{shown(source)}"
    )


def of_scene(name: str, scene: trimesh.Scene) -> Elements:
    """All instances of all meshes of a scene, in their places."""
    points, cells, notes = [np.zeros((0, 3))], [], []
    nodes, unit = list(scene.graph.nodes_geometry), _unit(scene)
    others: dict[str, int] = {}
    for node in nodes:
        transform, key = scene.graph[node]
        part = scene.geometry[key]
        if not isinstance(part, trimesh.Trimesh):
            others[type(part).__name__] = others.get(type(part).__name__, 0) + 1
            continue
        faces = np.asarray(part.faces, dtype=np.int64)
        if np.linalg.det(transform[:3, :3]) < 0:
            faces = faces[:, ::-1]
        cells.append(("triangle", faces + sum(map(len, points))))
        vertices = np.asarray(part.vertices, dtype=float)
        if not np.array_equal(transform, np.eye(4)):
            vertices = vertices @ transform[:3, :3].T + transform[:3, 3]
        points.append(vertices)
    if len(cells) > 1:
        notes.append(f"parts of the scene joined: {len(cells)}")
    if others:
        left = ", ".join(f"{count} {kind}" for kind, count in others.items())
        notes.append(f"left out: {left}")
    return Elements(name, np.vstack(points), cells, unit, notes)


def of_meshio(name: str, mesh: Any) -> Elements:
    """All blocks of cells of a mesh of meshio."""
    blocks = [(_kind(block.type), np.asarray(block.data)) for block in mesh.cells]
    for kind, data in blocks:
        _check_block(name, kind, data)
    cells = [(k, d.astype(np.int64)) for k, d in blocks if d.ndim == 2 and d.dtype.kind in "iu"]
    return Elements(name, _three(mesh.points), cells, None, [])


def _check_block(name: str, kind: str, data: Any) -> None:
    """Refuse cells of a known kind that are no rows of integers, or of too few."""
    least = CORNERS.get(kind)
    if least is None or data.size == 0:
        return
    if data.ndim != 2 or data.dtype.kind not in "iu" or data.shape[1] < least:
        raise ValueError(
            f"source must have rows of {least} or more integers for cells of kind {kind}, but "
            f"those of {name} are of type {data.dtype} and shape {data.shape}"
        )


def _of_pyvista(name: str, grid: Any) -> Elements:
    types = np.asarray(grid.celltypes)
    ends = np.asarray(grid.cell_offsets if hasattr(grid, "cell_offsets") else grid.offset)
    numbers, sizes = np.asarray(grid.cell_connectivity, dtype=np.int64), np.diff(ends)
    cells = []
    for code, size in np.unique(np.stack([types, sizes]), axis=1).T.tolist():
        begin = ends[:-1][(types == code) & (sizes == size)]
        kind = VTK_CELLS.get(code, f"VTK cell type {code}")
        cells.append((kind, numbers[begin[:, None] + np.arange(size)]))
    return Elements(name, _three(grid.points), cells, None, [])


def _three(points: Any) -> Array:
    """Points with three coordinates."""
    array = real_array("the points of source", points, ("n", "m"))
    return np.pad(array, ((0, 0), (0, 3 - array.shape[1]))) if array.shape[1] < 3 else array


def _kind(name: str) -> str:
    """Meshio's name of a kind of cells without order and number of nodes."""
    plain = name.lower().replace("vtk_lagrange_", "")
    plain = plain.replace("quadrilateral", "quad").replace("tetrahedron", "tetra")
    return re.sub(r"\d+$", "", plain)


def _unit(scene: trimesh.Scene) -> str | None:
    """The unit of the parts, or None; parts in different ones are refused: they do not fit."""
    parts = [scene.geometry[scene.graph[node][1]] for node in scene.graph.nodes_geometry]
    units = sorted({p.units for p in parts if isinstance(p, trimesh.Trimesh) and p.units})
    if len(units) > 1:
        raise ValueError(
            f"source must have parts of one unit, but those of the scene are in "
            f"{' and '.join(units)}: part.convert_units({units[0]!r}) for each part, before the "
            "scene is made of them"
        )
    return units[0] if units else None
