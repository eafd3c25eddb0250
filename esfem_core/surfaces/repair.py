"""Repairs of a triangulation: what files and programs break, put right step by step.

Each step takes vertices (n, 3) and triangles (T, 3), changes as little as it can, and says what
it did. A mesh without a fault is left as it is.
"""

import re
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import trimesh

from esfem_core.checks import Array, Bools, Ints, flag, function, whole_number
from esfem_core.surfaces.faults import (
    Fault,
    check_coordinates,
    check_is_trimesh,
    fault,
    of_elements,
    without_area,
)
from esfem_core.surfaces.folds import unfolded
from esfem_core.surfaces.lids import lid_of, rims
from esfem_core.surfaces.orientation import (
    Shells,
    components,
    directed,
    fans,
    normals_of,
    shells,
    sides_of,
    turned_to_agree,
    with_turned,
)
from esfem_core.surfaces.places import (
    NEAR,
    PIECES,
    diagonal_of,
    gap_of,
    is_rounding,
    merged,
    merging,
    repeated,
    without_unused,
)

__all__ = [
    "Repaired",
    "counted",
    "dropping",
    "remedy",
    "repair",
    "repaired",
]

HOLE = 12  # edges of the largest hole that is filled without being asked for
LID = 200  # edges of the largest hole that a message offers to fill
WORK = 4 * LID**3  # cubes of the edges of all holes up to which that is tried, for seconds
SEPARATION = 1e-3  # how far a vertex that is split moves into its fan, over the fan's size
FLIPS = 10  # sweeps over flat triangles


def repair(
    tri: trimesh.Trimesh,
    holes: int = HOLE,
    report: Callable[[str], object] | None = print,
    boundary: bool = False,
) -> trimesh.Trimesh:
    """Make a triangulation fit for a :class:`esfem_core.SurfaceSpace`.

    In this order, and only where it is needed:

    1. of triangles at one place, oriented alike, one is kept; those with corners that are missing
       or not finite are dropped, then vertices without triangles;
    2. vertices at one place become one, whatever their texture or normal (first equal ones, then
       those nearer than 1e-8 and 1e-6 of the diagonal of the surface, if that closes more of it,
       ten edges or more for each triangle that vanishes);
    3. triangles with a corner twice are dropped, and flat ones that stick to the surface by an
       edge; of those with the same three corners one is kept, or none if they are the two sides of
       a wall or a fin; triangles without area are flipped away;
    4. neighbours are oriented alike, most triangles staying as they are; polygons that were cut
       into triangles which lie on each other, as those that are not convex, are cut anew;
    5. holes of up to `holes` edges are filled without new vertices, with the smallest area, and
       triangles without area flipped away again; but not if a tenth of the surface or more is in
       pieces that end where others go on;
    6. components that enclose no volume, single triangles and sheets, are dropped with their
       vertices if there are others; where surfaces touch in a vertex or an edge, each gets its
       own, moved apart by a thousandth of the triangles, so that no later merging joins them;
    7. components are oriented outwards, cavities inwards.

    Parameters
    ----------
    tri : trimesh.Trimesh
        It stays as it is.
    holes : int
        Edges of the largest hole that is filled, 0 for none.
    report : callable, optional
        Is told each thing that was done, in a line of text.
    boundary : bool
        Whether larger holes may stay, for a space with ``boundary=True``.

    Returns
    -------
    trimesh.Trimesh
        Accepted by :func:`esfem_core.check_triangulation`. Colours and textures are lost if
        anything was done. Of triangles at one place, alike oriented, one is kept: a part that is in
        a file twice is no cavity of itself.

    Raises
    ------
    TypeError, ValueError
        If `tri` is not a :class:`trimesh.Trimesh`, has coordinates beyond 1e75 or is less than
        1e-70 across; if what comes out would be refused: it is not closed, not a manifold, or not
        orientable. The message says what is left to a person.

    Examples
    --------
    >>> import esfem_core as ec
    >>> tri = ec.sphere("icosahedron", 1)
    >>> soup = trimesh.Trimesh(tri.triangles.reshape(-1, 3), np.arange(240).reshape(-1, 3),
    ...                        process=False)
    >>> soup.update_faces(np.arange(80) != 7)
    >>> whole = repair(soup)
    dropped 3 vertices without triangles
    merged 237 vertices into 42 at the same places
    filled 1 hole of 3 edges with 1 triangle
    >>> print(f"{whole.volume / tri.volume:.12f}")
    1.000000000000
    """
    check_is_trimesh("tri", tri)
    holes = whole_number("holes", holes, 0)
    if report is not None:
        function("report", report, "of a line of text, or None")
    flag("boundary", boundary)
    vertices, faces = np.array(tri.vertices, dtype=float), np.array(tri.faces, dtype=np.int64)
    check_coordinates("tri", vertices, faces)
    found = fault(vertices, faces, boundary)
    if found is None:
        if report is not None:
            report("nothing to repair")
        return tri.copy()
    if elements := of_elements(vertices, faces):
        raise ValueError(f"tri cannot be repaired: {elements.text}; {elements.advice}")
    result = repaired(vertices, faces, holes)
    if report is not None:
        for step in result.steps:
            report(step)
    left = fault(result.vertices, result.faces, boundary)
    if left is not None:
        if not found.orientable:
            left, advice = found, found.advice
        elif boundary:
            advice = left.advice
        else:
            advice = _next(vertices, faces, left, holes)
        raise ValueError(f"tri cannot be repaired: {left.text}; {advice}")
    made = trimesh.Trimesh(result.vertices, result.faces, process=False, metadata=tri.metadata)
    if tri.units is not None:  # trimesh makes text of None
        made.units = tri.units
    return made


class Repaired(NamedTuple):
    """Vertices, triangles, and what was done to them."""

    vertices: Array
    faces: Ints
    steps: list[str]


def repaired(vertices: Array, faces: Ints, holes: int = HOLE) -> Repaired:
    """What :func:`repair` does, on arrays; faults may be left."""
    steps: list[str] = []
    faces = _without_copies(vertices, faces, steps)
    known = ((faces >= 0) & (faces < len(vertices))).all(axis=1)
    infinite = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    fit = known & ~np.isin(faces, infinite).any(axis=1)
    faces = faces[fit]
    if not fit.all():
        steps.append(
            f"dropped {counted((~fit).sum(), 'triangle')} with missing or infinite corners"
        )
    if len(faces) > 0:
        before = len(vertices)
        vertices, faces = without_unused(vertices, faces)
        steps += dropping(before - len(vertices))
        vertices, faces = _merge(vertices, faces, steps)
        vertices, faces = without_unused(vertices, _without_flat_fins(vertices, faces, steps))
    if len(faces) > 0:
        faces = _flip_flat(vertices, faces, steps)
        faces = _agree(faces, steps)
        faces, count = unfolded(vertices, faces)
        if count:
            steps.append(f"cut {counted(count, 'polygon')} anew, whose triangles lay on each other")
        faces = _fill(vertices, faces, holes, steps)
        faces = _flip_flat(vertices, faces, steps)
        vertices, faces = _split(vertices, faces, steps)
        vertices, faces = without_unused(vertices, _turn(vertices, faces, steps))
    return Repaired(vertices, faces, steps)


def remedy(vertices: Array, faces: Ints, found: Fault, boundary: bool = False) -> str:
    """What a person can do about a fault: the advice has been tried.

    A surface that is meant to be open keeps its holes, and has less done to it by advice in code.
    """
    if not found.repairable or (boundary and re.search(r"\btri(\.| = )", found.advice)):
        return found.advice
    result = repaired(vertices, faces, 0 if boundary else HOLE)
    left = fault(result.vertices, result.faces, boundary)
    if left is None:
        call = "tri, holes=0, boundary=True" if boundary else "tri"
        return f"tri = ec.repair({call}) helps ({', '.join(result.steps)})"
    if boundary or not found.orientable:  # no lid is wanted, or of any use
        return found.advice
    same = left.text.split(":")[0] == found.text.split(":")[0]
    rest = "" if same else f"ec.repair is not enough: then {left.text}; "
    return rest + _next(vertices, faces, left, HOLE)


def dropping(unused: int) -> list[str]:
    """What to say of so many vertices that were left out: nothing of none."""
    lost = counted(unused, "vertex", "vertices")
    return [f"dropped {lost} without triangles"] if unused else []


def counted(n: int, one: str, many: str | None = None) -> str:
    """A number and what it counts: "1 hole", "2 holes"."""
    return f"{n} {one if n == 1 else many or one + 's'}"


def _next(vertices: Array, faces: Ints, left: Fault, holes: int) -> str:
    """Advice for what a repair leaves: larger lids where they would do."""
    bare = repaired(vertices, faces, 0)
    if gap := gap_of(bare.vertices, bare.faces):
        whole = len(bare.faces) == len(faces) and np.isfinite(vertices).all()
        return _joining(*((vertices, faces) if whole else bare[:2]), gap)
    sides = sides_of(bare.faces)
    lengths = [len(rim) for rim in rims(sides)]
    largest = max(lengths, default=0)
    if not holes < largest <= LID:
        return left.advice
    known = sum(n**3 for n in lengths) <= WORK
    if known:
        attempt = repaired(vertices, faces, largest)
        if fault(attempt.vertices, attempt.faces) is not None:
            return left.advice
    return (
        f"the theory is for closed surfaces, and {counted(len(lengths), 'hole')} of up to "
        f"{largest} edges {'is' if len(lengths) == 1 else 'are'} open: "
        f"tri = ec.repair(tri, holes={largest}) {'puts' if known else 'may put'} lids on them"
    )


def _joining(vertices: Array, faces: Ints, gap: float) -> str:
    """Advice for a surface in pieces: to round their corners to the same digits, if that helps."""
    text = f"it is in pieces that share no vertices, whose corners are up to {gap:.1g} apart: "
    sides = sides_of(faces)
    lengths = np.linalg.norm(vertices[sides.end] - vertices[sides.start], axis=1)
    digits = int(np.ceil(-np.log10(lengths[lengths > gap].min() / 2)))
    attempt = trimesh.Trimesh(vertices, faces, process=False)
    attempt.merge_vertices(merge_tex=True, merge_norm=True, digits_vertex=digits)
    result = repaired(np.array(attempt.vertices), np.array(attempt.faces, dtype=np.int64))
    kept = len(result.faces) >= (1 - PIECES) * len(faces)
    if kept and fault(result.vertices, result.faces) is None:
        text += (
            f"tri.merge_vertices(merge_tex=True, merge_norm=True, digits_vertex={digits}) before "
            "tri = ec.repair(tri) joins them; or "
        )
    return f"{text}write it with shared vertices, or merge them with a program such as MeshLab"


def _without_copies(vertices: Array, faces: Ints, steps: list[str]) -> Ints:
    """Triangles without those that lie where another one does, corner on corner, alike oriented.

    Vertices of a surface that is closed are not merged, so that two copies of it would stay, each
    of them a cavity of the other.
    """
    known = np.flatnonzero(((faces >= 0) & (faces < len(vertices))).all(axis=1))
    places = _places(vertices, faces[known])[faces[known]]
    first = places.argmin(axis=1)  # the corner to begin with
    turned = np.take_along_axis(places, (first[:, None] + np.arange(3)) % 3, axis=1)
    again = np.ones(len(known), dtype=bool)
    again[np.unique(turned, axis=0, return_index=True)[1]] = False
    again &= ~repeated(places)  # smaller than the distance
    if again.any():
        steps.append(f"dropped {counted(again.sum(), 'triangle')} at the places of others")
    return np.delete(faces, known[again], axis=0)


def _places(vertices: Array, faces: Ints) -> Ints:
    """Number of the first of the corners at each vertex's place, (n,), to rounding."""
    used = np.unique(faces)
    place = np.arange(len(vertices))
    place[used] = used[merged(vertices[used], NEAR[-1] * diagonal_of(vertices[used]))]
    return place


def _merge(vertices: Array, faces: Ints, steps: list[str]) -> tuple[Array, Ints]:
    """Steps 2 and 3: what closes most of the surface, merging as little as possible."""
    best: tuple[int, int, Array, Ints, list[str]] | None = None
    diagonal = diagonal_of(vertices)
    for near in (None, *NEAR):
        x, f = vertices, faces
        said: list[str] = []
        gone = 0  # proper triangles
        if near is not None:
            place = merged(x, near * diagonal)
            gone = int((repeated(place[f]) & ~repeated(f) & ~without_area(x, f)).sum())
            f = place[f]
            count = len(np.unique(f))
            if count < len(x):
                said.append(merging(len(x), "vertices", count, near * diagonal))
        f = _drop_doubles(f, said)
        x, f = without_unused(x, f)
        broken = int((sides_of(f).times == 1).sum() + without_area(x, f).sum())
        if best is None or (broken < best[0] and is_rounding(gone - best[1], best[0] - broken)):
            best = broken, gone, x, f, said
        if best[0] == 0:
            break
    assert best is not None
    *_, x, f, said = best
    steps += said
    return x, f


def _drop_doubles(faces: Ints, steps: list[str]) -> Ints:
    """Drop triangles with a corner twice, of those with the same corners all but one, and walls."""
    twice = repeated(faces)
    if twice.any():
        steps.append(f"dropped {counted(twice.sum(), 'triangle')} with a corner twice")
        faces = faces[~twice]
    order = np.argsort(faces, axis=1)
    even = ((order[:, 1] - order[:, 0]) % 3) == 1  # a rotation of the sorted corners
    _, first, group, count = np.unique(
        np.sort(faces, axis=1), axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    group = group.ravel()
    if (count == 1).all():
        return faces
    sign = np.bincount(group, np.where(even, 1, -1), minlength=len(first))
    facing = (count > 1) & (sign == 0)
    if facing.any():
        facing &= _are_walls(faces[first], facing)
    keep = np.zeros(len(faces), dtype=bool)
    keep[first[~facing]] = True
    steps.append(f"dropped {counted((~keep).sum(), 'triangle')} that others cover")
    return faces[keep]


def _are_walls(faces: Ints, facing: Bools) -> Bools:
    """Which triangles to drop of those that face another one with the same corners, (T,).

    Those that belong together, joined by edges of no other triangles, are a wall between two bodies
    or a fin if dropping them leaves no wrong edge, and keeping one side of them does. Otherwise
    one side is kept: they are a surface with two sides, or a part of one that is given twice.

    Parameters
    ----------
    faces : (T, 3) int array
        One of each pair.
    facing : (T,) bool array
        Which have another side.
    """
    sides = sides_of(faces)
    own = np.repeat(facing, 3)
    others = np.bincount(sides.edge, ~own)[sides.edge]  # sides of other triangles at the edge
    keys = np.where(own & (others == 0), sides.edge, sides.edge.max() + 1 + np.arange(faces.size))
    part = components(np.unique(keys, return_inverse=True)[1].reshape(-1, 3))
    if_kept = np.bincount(part, (own & (sides.times != 2)).reshape(-1, 3).sum(axis=1))
    if_dropped = np.bincount(part, (own & (others % 2 == 1)).reshape(-1, 3).sum(axis=1))
    wall = facing & ((if_kept > 0) & (if_dropped <= if_kept))[part]
    return np.asarray(wall if not wall.all() else np.zeros_like(wall))


def _without_flat_fins(vertices: Array, faces: Ints, steps: list[str]) -> Ints:
    """Drop triangles as flat as rounding makes them that only stick to the surface by an edge."""
    sides = sides_of(faces)
    times = sides.times.reshape(-1, 3)
    lengths = np.linalg.norm(vertices[sides.end] - vertices[sides.start], axis=1).reshape(-1, 3)
    area = np.linalg.norm(normals_of(vertices, faces), axis=1)  # twice that: height times length
    flat = area <= NEAR[-1] * diagonal_of(vertices) * lengths.max(axis=1)
    fin = flat & (times % 2 == 1).all(axis=1) & (times > 2).any(axis=1)
    if fin.any():
        steps.append(f"dropped {counted(fin.sum(), 'flat triangle')} that stuck to the surface")
    return np.asarray(faces[~fin])


def _flip_flat(vertices: Array, faces: Ints, steps: list[str]) -> Ints:
    """Give the longest side of a flat triangle (a, b, c) to c: its neighbour becomes two."""
    faces = faces.copy()
    flips = 0
    for _ in range(FLIPS):
        flat = np.flatnonzero(without_area(vertices, faces))
        if len(flat) == 0:
            break
        sides = sides_of(faces)
        partner = np.full(faces.size, -1)
        pairs = sides.pairs()
        partner[pairs] = pairs[:, ::-1]
        edges = directed(sides)
        touched: set[int] = set()
        for t in flat.tolist():
            corners = vertices[faces[t]]
            lengths = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
            side = 3 * t + int(np.argmax(lengths))
            other = int(partner[side])
            if other < 0 or sides.start[side] == sides.start[other]:
                continue
            s = other // 3
            a, b = sides.start[side], sides.end[side]
            c, d = faces[t][(side + 2) % 3], faces[s][(other + 2) % 3]
            if {s, t} & touched or c == d or (c, d) in edges or (d, c) in edges:
                continue
            faces[t], faces[s] = (a, d, c), (d, b, c)
            touched |= {s, t}
            edges.add((c, d))
            flips += 1
        if not touched:
            break
    if flips:
        steps.append(f"flipped {counted(flips, 'edge')} of triangles without area")
    return faces


def _agree(faces: Ints, steps: list[str]) -> Ints:
    """Step 4."""
    turned, _ = turned_to_agree(faces)
    if turned.any():
        steps.append(f"turned {counted(turned.sum(), 'triangle')} to agree with neighbours")
    return with_turned(faces, turned)


def _fill(vertices: Array, faces: Ints, holes: int, steps: list[str]) -> Ints:
    """Step 5."""
    sides = sides_of(faces)
    if not (sides.times == 1).any() or holes < 3 or gap_of(vertices, faces) > 0:
        return faces  # lids on both sides of a crack would make bodies of the pieces
    taken = directed(sides)
    sizes, lids = [], []
    for rim in rims(sides):
        if len(rim) <= holes and (lid := lid_of(vertices, rim, taken)):
            sizes.append(len(rim))
            lids += lid
    if lids:
        n, largest, added = len(sizes), max(sizes), counted(len(lids), "triangle")
        upto = "" if n == 1 else "up to "
        steps.append(f"filled {counted(n, 'hole')} of {upto}{largest} edges with {added}")
        faces = np.vstack([faces, lids])
    return faces


def _split(vertices: Array, faces: Ints, steps: list[str]) -> tuple[Array, Ints]:
    """Step 6: vertices for each fan, across edges that two sheets have in common."""
    sides = sides_of(faces)
    pairs = np.vstack([sides.pairs(), *_sheets(vertices, faces)])
    if 2 * len(pairs) < faces.size:
        return vertices, faces  # open, or no body at some edge: nothing that splitting helps
    fan = fans(faces, pairs)
    _, first, own = np.unique(fan, return_index=True, return_inverse=True)
    at = faces.ravel()[first]  # vertex of each fan
    if len(first) == len(vertices):
        return vertices, faces
    parted = own.reshape(faces.shape)
    if _is_closed(parted) and (flat := _without_volume(shells(vertices[at], parted), steps)).any():
        # They go before anything moves: a body that only they touch stays where it is.
        return _split(*without_unused(vertices, faces[~flat]), steps)
    order = np.argsort(at, kind="stable")
    again = np.zeros(len(first), dtype=bool)
    again[order[1:]] = at[order[1:]] == at[order[:-1]]  # all fans of a vertex but one
    number = at.copy()
    number[again] = len(vertices) + np.arange(again.sum())
    split = number[own].reshape(faces.shape)

    # Each new vertex goes a little towards the middle of its fan.
    middle = np.zeros((len(first), 3))
    np.add.at(middle, own, np.repeat(vertices[faces].mean(axis=1), 3, axis=0))
    middle /= np.bincount(own)[:, None]
    moved = vertices[at] + SEPARATION * (middle - vertices[at])
    steps.append(
        f"split {counted(len(np.unique(at[again])), 'vertex', 'vertices')} where the surface "
        "touched itself"
    )
    return np.vstack([vertices, moved[again]]), split


def _sheets(vertices: Array, faces: Ints) -> Iterator[Ints]:
    """Pairs of sides at edges of four and more triangles, the body between the two of a pair.

    Around such an edge the triangles that run from i to j and those that run from j to i follow
    each other by turns, if they bound a body that touches itself there.
    """
    sides = sides_of(faces)
    a, b, c = (vertices - vertices.mean(axis=0))[faces.T]
    back = 1 if (a * np.cross(b, c)).sum() > 0 else -1  # or all are inside out
    many = np.flatnonzero(sides.times > 2)
    many = many[np.argsort(sides.edge[many], kind="stable")]
    for group in np.split(many, np.flatnonzero(np.diff(sides.edge[many])) + 1):
        if len(group) == 0:
            return
        i, j = sorted((int(sides.start[group[0]]), int(sides.end[group[0]])))
        axis = vertices[j] - vertices[i]
        axis /= np.linalg.norm(axis)
        away = vertices[faces[group // 3, (group + 2) % 3]] - vertices[i]
        away -= (away @ axis)[:, None] * axis
        first = away[0] / np.linalg.norm(away[0])
        group = group[np.argsort(np.arctan2(away @ np.cross(axis, first), away @ first))]
        forth = sides.start[group] == i
        if len(group) % 2 or (forth == np.roll(forth, 1)).any():
            continue
        # The normal of a triangle that runs from i to j points to larger angles, so that its
        # body, and the other triangle of its sheet, is at smaller ones.
        yield np.stack([group, np.roll(group, back)], axis=1)[forth]


def _is_closed(faces: Ints) -> bool:
    """Whether each edge has two triangles, oriented alike."""
    sides = sides_of(faces)
    one, other = sides.pairs().T
    return bool((sides.times == 2).all() and (sides.start[one] != sides.start[other]).all())


def _without_volume(found: Shells, steps: list[str]) -> Bools:
    """Triangles to drop, (T,): of components without volume, if there are others."""
    if found.flat.all():
        return np.zeros(len(found.label), dtype=bool)
    if found.flat.any():
        steps.append(f"dropped {counted(found.flat.sum(), 'component')} without volume")
    return np.asarray(found.flat[found.label])


def _turn(vertices: Array, faces: Ints, steps: list[str]) -> Ints:
    """Step 7, and 6 where nothing touches."""
    if not _is_closed(faces):
        return faces
    found = shells(vertices, faces)
    if (flat := _without_volume(found, steps)).any():
        faces = faces[~flat]
        found = shells(vertices, faces)
    wrong = found.wrong() & ~found.flat
    inwards = int((wrong & (found.volume > 0)).sum())
    outwards = int(wrong.sum()) - inwards
    if outwards:
        steps.append(f"turned {counted(outwards, 'component')} outwards")
    if inwards:
        steps.append(f"turned {counted(inwards, 'cavity', 'cavities')} inwards")
    return with_turned(faces, wrong[found.label])
