"""What is wrong with a mesh: the first thing that the theory forbids, and where it is."""

import os
from typing import NamedTuple

import numpy as np
import trimesh

from esfem_core.checks import Array, Bools, Ints, shown
from esfem_core.surfaces.folds import folded
from esfem_core.surfaces.orientation import (
    Sides,
    coincident,
    fans,
    normals_of,
    open_components,
    shells,
    sides_of,
    turned_to_agree,
)
from esfem_core.surfaces.places import NEAR, diagonal_of, joined, merged, repeated

__all__ = [
    "FARTHEST",
    "FLATTEST",
    "NO_LENGTH",
    "Fault",
    "check_coordinates",
    "check_is_trimesh",
    "fault",
    "of_elements",
    "without_area",
]

# Smallest allowed 4 sqrt(3) area / (sum of squared sides), 1 if equilateral: the one limit of the
# package. An area from the metric, sqrt(EG - F^2), is lost in rounding at 1e-8.
FLATTEST = 1e-7
"""Smallest quality of a triangle that is allowed; an equilateral one has 1."""

NO_LENGTH = 1e-14
"""Share of the coordinates below which a side or a tangent is a rounding error."""

# What a repair turns as well, but that would close a surface that is meant to be open.
TURNING = (
    "tri.faces = ec.SurfaceSpace.from_nodes(tri.vertices, tri.faces, boundary=True).cells turns"
)

DEGREES = range(2, 13)  # of curved elements; as many as the elements of this package have

FARTHEST = 1e75  # largest coordinate; the fourth power of a length must be a float
SMALLEST = 1e-70  # size of a surface, likewise, with edges of a thousandth of it and all digits


def check_is_trimesh(name: str, value: object) -> None:
    """Refuse what is not a :class:`trimesh.Trimesh`.

    Examples
    --------
    >>> check_is_trimesh("tri", trimesh.Scene())
    Traceback (most recent call last):
        ...
    TypeError: tri must be a trimesh.Trimesh, got a Scene; tri = ec.read_mesh(tri) converts it
    """
    if isinstance(value, trimesh.Trimesh):
        return
    if isinstance(value, trimesh.Scene) or any(
        hasattr(value, name) for name in ("cells_dict", "triangulate", "extract_surface")
    ):  # of trimesh, meshio and PyVista
        raise TypeError(
            f"{name} must be a trimesh.Trimesh, got a {type(value).__name__}; "
            f"{name} = ec.read_mesh({name}) converts it"
        )
    advice = ""
    if isinstance(value, str | os.PathLike):
        advice = f"; {name} = ec.read_mesh({str(value)!r}) reads it"
    elif isinstance(value, tuple | list) and [getattr(part, "ndim", 0) for part in value] == [2, 2]:
        advice = f"; {name} = trimesh.Trimesh(*{name}, process=False) makes one of arrays"
    raise TypeError(f"{name} must be a trimesh.Trimesh, got {shown(value)}{advice}")


def check_coordinates(name: str, vertices: Array, faces: Ints) -> None:
    """Refuse vertices of triangles so far away, or so close, that areas and volumes are lost.

    Those that are not finite are left to a repair.

    Examples
    --------
    >>> check_coordinates("tri", 1e80 * np.eye(3), np.array([[0, 1, 2]]))
    Traceback (most recent call last):
        ...
    ValueError: tri must have coordinates up to 1e+75, but point 0 is [1e+80, 0.0, 0.0]; give...
    """
    used = np.zeros(len(vertices), dtype=bool)
    used[faces[((faces >= 0) & (faces < len(vertices))).all(axis=1)]] = True
    far = np.flatnonzero(used & (np.isfinite(vertices) & (np.abs(vertices) > FARTHEST)).any(axis=1))
    if len(far):
        raise ValueError(
            f"{name} must have coordinates up to {FARTHEST:g}, but point {far[0]} is "
            f"{vertices[far[0]].tolist()}; give lengths in a larger unit"
        )
    points = vertices[used & np.isfinite(vertices).all(axis=1)]
    size = np.ptp(points, axis=0).max() if len(points) else 0.0
    if 0 < size < SMALLEST:
        raise ValueError(
            f"{name} must be {SMALLEST:g} or more across, but is {size:.3g}; give lengths in a "
            "smaller unit"
        )


class Fault(NamedTuple):
    """Something that the theory forbids.

    Attributes
    ----------
    text : str
        What and where.
    advice : str
        What a person can do about it if a repair cannot.
    repairable : bool
        False if a repair would not even be the right thing.
    orientable : bool
        False if the surface has one side only, so that no lid gives it an inside.
    """

    text: str
    advice: str
    repairable: bool = True
    orientable: bool = True


def fault(
    vertices: Array,
    faces: Ints,
    boundary: bool = False,
    curved: tuple[Array, Ints] | None = None,
) -> Fault | None:
    """Find the first fault of a mesh, or None.

    Looked for in this order: triangles, not curved elements cut into some; finite vertices, each
    in some triangle; triangles with three different corners and an area; every edge in two
    triangles, and open ones not in pairs at one place; neighbours oriented alike; triangles around
    a vertex forming one fan, so that V - E + F = 2 (components - handles); each component enclosing
    a volume, at a place of its own, oriented outwards, or inwards if it is a cavity; no triangle
    lying on its neighbour.

    Parameters
    ----------
    vertices : (n, 3) float array
    faces : (T, 3) int array
    boundary : bool
        Whether edges may belong to one triangle only. Components with such edges enclose nothing,
        and have no outside.
    curved : (N, 3) float array and (mT, 3) int array, optional
        Nodes of curved elements with these corners, and flat triangles between them, m in
        succession for each element: what lies inside what is told by them.

    Returns
    -------
    Fault or None

    Examples
    --------
    >>> fault(np.eye(3), np.array([[0, 1, 2]])).text
    'the surface is not closed: edge (0, 1) of triangle 0 belongs to 1 triangle (3 such edges)'
    >>> fault(np.eye(3), np.array([[0, 1, 2]]), boundary=True) is None
    True
    """
    if len(faces) == 0:
        return Fault(
            "the triangulation has no triangles",
            "look at what it was made from; trimesh.Trimesh drops triangles smaller than 1e-8 "
            "unless it is given process=False",
        )
    sides = sides_of(faces)
    return (
        of_elements(vertices, faces)
        or _of_vertices(vertices, faces)
        or _of_triangles(vertices, faces)
        or _of_edges(faces, sides, boundary)
        or _of_seams(vertices, faces, sides)
        or _of_neighbours(faces, sides)
        or _of_fans(len(vertices), faces, sides)
        or _of_shells(vertices, faces, sides, curved or (vertices, faces))
        or _of_folds(vertices, faces, sides)
    )


def without_area(vertices: Array, faces: Ints) -> Bools:
    """Which triangles have no area to speak of, (T,): the limit for elements of a run, too."""
    area, squares = _areas(vertices, faces)
    lost = (NO_LENGTH * np.abs(vertices[faces]).max(initial=0.0)) ** 2  # twice an area
    return np.asarray(~(4 * np.sqrt(3) * area > FLATTEST * squares + 2 * np.sqrt(3) * lost))


def _areas(vertices: Array, faces: Ints) -> tuple[Array, Array]:
    p, q, r = vertices[faces.T]
    squares = ((q - p) ** 2 + (r - q) ** 2 + (p - r) ** 2).sum(axis=1)
    return np.linalg.norm(normals_of(vertices, faces), axis=1) / 2, squares


def _of_vertices(vertices: Array, faces: Ints) -> Fault | None:
    bad = ~np.isfinite(vertices).all(axis=1)
    if bad.any():
        i = int(np.argmax(bad))
        return Fault(f"vertex {i} is not finite: {vertices[i].tolist()}", "remove its triangles")
    wrong = ((faces < 0) | (faces >= len(vertices))).any(axis=1)
    if wrong.any():
        t = int(np.argmax(wrong))
        return Fault(
            f"triangle {t} has corners {faces[t].tolist()}, but there are {len(vertices)} vertices",
            "remove it",
        )
    unused = np.bincount(faces.ravel(), minlength=len(vertices)) == 0
    if unused.any():
        return Fault(
            f"vertex {np.argmax(unused)} belongs to no triangle ({unused.sum()} such vertices)",
            "call tri.remove_unreferenced_vertices()",
        )
    return None


def of_elements(vertices: Array, faces: Ints) -> Fault | None:
    """Curved elements that trimesh has cut into triangles around their first corner.

    Node 3 of an element of degree k lies near its edge from 0 to 1, k - 1 parts from the end.
    Mended as triangles they would become another surface.

    Parameters
    ----------
    vertices : (n, 3) float array
    faces : (T, 3) int array
        They may name vertices that there are not.

    Examples
    --------
    >>> nodes = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    >>> of_elements(nodes, np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])).text
    'the triangles are fans of 4, as trimesh cuts rows of 6 numbers'
    """
    known = ((faces >= 0) & (faces < len(vertices))).all()
    if not known or (sides_of(faces).times == 2).all():
        return None
    for degree in DEGREES:
        nodes = (degree + 1) * (degree + 2) // 2
        if len(faces) % (nodes - 2):
            continue
        cut = faces.reshape(-1, nodes - 2, 3)
        if (cut[..., 0] != cut[:, :1, 0]).any() or (cut[:, 1:, 1] != cut[:, :-1, 2]).any():
            continue
        first, second, node = (vertices[cut[:, t, c]] for t, c in ((0, 0), (0, 1), (1, 2)))
        edge = second - first
        off = np.linalg.norm(node - first - edge / degree, axis=1)
        if (off < np.linalg.norm(edge, axis=1) / (degree + 1)).all():
            return Fault(
                f"the triangles are fans of {nodes - 2}, as trimesh cuts rows of {nodes} numbers",
                f"elements with {nodes} nodes become a space by "
                "ec.SurfaceSpace.from_nodes(nodes, cells)",
                repairable=False,
            )
    return None


def _of_triangles(vertices: Array, faces: Ints) -> Fault | None:
    twice = repeated(faces)
    if twice.any():
        t = int(np.argmax(twice))
        return Fault(
            f"triangle {t} is degenerate: its corners {faces[t].tolist()} repeat", "remove it"
        )
    flat = without_area(vertices, faces)
    if not flat.any():
        return None
    t = int(np.argmax(flat))
    area, squares = _areas(vertices, faces[t : t + 1])
    longest = np.sqrt(squares[0] / 2)
    text = (
        f"triangle {t} with corners {faces[t].tolist()} is degenerate: area {area[0]:.3g} "
        f"at a longest edge of about {longest:.3g}"
    )
    away = np.abs(vertices[faces[t]]).max()
    size = longest or diagonal_of(vertices)  # all may have become one point
    if size < 1e-8 * away:
        return Fault(
            f"{text}; at a distance of {away:.3g} from the origin, numbers are rounded to "
            f"{np.spacing(away):.1g}",
            "subtract the middle of the surface before it is rounded",
            repairable=False,
        )
    return Fault(
        text, "make better triangles with a program for meshes, such as MeshLab or Blender"
    )


def _of_edges(faces: Ints, sides: Sides, boundary: bool) -> Fault | None:
    rim, many = (sides.times == 1) & (not boundary), sides.times > 2
    # A fin has wrong edges of both kinds: to close the surface would be the wrong advice.
    at_rim, at_many = (wrong.reshape(-1, 3).any(axis=1) for wrong in (rim, many))
    if (at_rim & at_many).any():
        rim = np.zeros_like(rim)
    for bad in (rim, many):
        if not bad.any():
            continue
        e = int(np.argmax(bad))
        edge = f"edge ({sides.start[e]}, {sides.end[e]}) of triangle {e // 3}"
        if sides.times[e] == 1:
            # A lid for a Möbius strip would be lost labour.
            return _of_orientation(faces) or Fault(
                f"the surface is not closed: {edge} belongs to 1 triangle ({bad.sum()} such edges)",
                "the theory is for closed surfaces: close it with a program for meshes, such as "
                "MeshLab or Blender",
            )
        text = f"the surface is not a manifold: {edge} belongs to {sides.times[e]} triangles"
        if boundary and len(np.unique(np.sort(faces, axis=1), axis=0)) < len(faces):
            return Fault(text, "tri.update_faces(tri.unique_faces()) drops triangles given before")
        kept = "make up the surface" if boundary else "bound the body"
        return Fault(
            text,
            f"keep those triangles that {kept}, without walls inside it and fins: "
            "tri.update_faces(keep) with a bool for each triangle",
        )
    return None


def _of_seams(vertices: Array, faces: Ints, sides: Sides) -> Fault | None:
    """Two open edges at one place: nothing would flow from one side of them to the other."""
    is_open = np.flatnonzero(sides.times == 1)
    if len(is_open) == 0:
        return None
    ends = np.stack([sides.start[is_open], sides.end[is_open]])
    used, number = np.unique(ends, return_inverse=True)
    place = merged(vertices[used], NEAR[-1] * diagonal_of(vertices))[number.reshape(ends.shape)]
    _, edge, times = np.unique(
        np.sort(place, axis=0), axis=1, return_inverse=True, return_counts=True
    )
    edge = edge.ravel()
    seam = np.flatnonzero((times[edge] == 2) & (place[0] != place[1]))
    if len(seam) == 0:
        return None
    one, other = is_open[np.flatnonzero(edge == edge[seam[0]])]
    text = (
        f"edges ({sides.start[one]}, {sides.end[one]}) of triangle {one // 3} and "
        f"({sides.start[other]}, {sides.end[other]}) of triangle {other // 3} lie at the same "
        f"place, but are open ({len(seam) // 2} such pairs)"
    )
    if (sides_of(joined(vertices, faces)[0]).times > 2).any():
        return Fault(
            text, "remove one of the sheets: joined, more than two triangles would meet in an edge"
        )
    return Fault(
        text,
        "tri = ec.read_mesh(tri) makes one of their vertices; the two sides of a slit must lie "
        f"farther apart than {NEAR[-1]:g} of the diagonal",
    )


def _of_orientation(faces: Ints) -> Fault | None:
    orientable = turned_to_agree(faces)[1]
    if orientable.all():
        return None
    return Fault(
        "the surface is not orientable: a way around it, as on a Möbius strip or a Klein bottle, "
        f"comes back to triangle {np.argmin(orientable)} from behind",
        "it has no inside and no normal, which the equations need: take an orientable surface",
        orientable=False,
    )


def _of_neighbours(faces: Ints, sides: Sides) -> Fault | None:
    one, other = sides.pairs().T
    against = sides.start[one] == sides.start[other]
    if not against.any():
        return None
    if found := _of_orientation(faces):
        return found
    e = int(one[against].min())
    return Fault(
        f"neighbours are oriented against each other: triangle {e // 3} and its neighbour "
        f"both run through edge ({sides.start[e]}, {sides.end[e]}) in this direction",
        f"{TURNING} as few triangles as it can",
    )


def _of_fans(n_vertices: int, faces: Ints, sides: Sides) -> Fault | None:
    fan = fans(faces, sides.pairs())
    first = np.unique(fan, return_index=True)[1]  # corner of each fan
    if len(first) == n_vertices:
        return None
    fans_at = np.bincount(faces.ravel()[first], minlength=n_vertices)
    i = int(np.argmax(fans_at > 1))
    euler = n_vertices - (int(sides.edge.max()) + 1) + len(faces)
    return Fault(
        f"vertex {i} joins {fans_at[i]} separate fans of triangles: the surface touches itself "
        f"there (Euler number {euler})",
        "give each fan its own vertex",
    )


def _of_shells(
    vertices: Array, faces: Ints, sides: Sides, shape: tuple[Array, Ints]
) -> Fault | None:
    closed = np.flatnonzero(~open_components(faces, sides))
    if len(closed) == 0:
        return None
    nodes, pieces = shape
    each = len(pieces) // len(faces)
    found = shells(nodes, pieces.reshape(-1, each, 3)[closed].reshape(-1, 3))
    found = found._replace(label=found.label[::each])
    count = len(found.volume)
    kind = "component" if len(closed) == len(faces) else "closed component"
    if found.flat.any():
        c = int(np.argmax(found.flat))
        what = f"{kind} {c} of {count}" if count > 1 else "the surface"
        t = closed[np.argmax(found.label == c)]
        return Fault(
            f"{what}, with triangle {t}, encloses no volume",
            "a sheet of triangles is no surface of a body: give it a thickness",
        )
    if pair := coincident(vertices, faces[closed], found.label):
        one, other = (closed[np.argmax(found.label == c)] for c in pair)
        return Fault(
            f"{kind}s {pair[0]} and {pair[1]} of {count}, with triangles {one} and {other}, lie at "
            "the same place",
            "remove one of them",
        )
    wrong = found.wrong()
    if not wrong.any():
        return None
    c = int(np.argmax(wrong))
    t, volume, depth = closed[np.argmax(found.label == c)], found.volume[c], found.depth[c]
    if count == 1 and len(closed) == len(faces):
        return Fault(
            f"the triangles are oriented inwards (enclosed volume {volume:.3g})",
            "call tri.invert()",
        )
    if depth % 2:
        return Fault(
            f"{kind} {c} of {count}, with triangle {t}, lies inside {depth} "
            f"other{'s' if depth > 1 else ''}: it is a cavity, but oriented outwards",
            f"{TURNING} it; a surface of its own, inside another, needs a triangulation of its own",
        )
    return Fault(
        f"{kind} {c} of {count}, with triangle {t}, is oriented inwards (enclosed volume "
        f"{volume:.3g}), but is no cavity of another",
        f"{TURNING} it",
    )


def _of_folds(vertices: Array, faces: Ints, sides: Sides) -> Fault | None:
    pairs = folded(vertices, faces, sides)
    if len(pairs) == 0:
        return None
    one, other = pairs[0]
    return Fault(
        f"triangles {one // 3} and {other // 3} lie on each other: the surface is folded along "
        f"edge ({sides.start[one]}, {sides.end[one]}) ({len(pairs)} such edges)",
        "have it cut into triangles by the program that made it: of polygons that are not convex, "
        "files tell the corners only",
    )
