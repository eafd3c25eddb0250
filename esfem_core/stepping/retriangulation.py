"""A discrete surface triangulated anew: where new nodes lie on the old elements.

Lengths of edges follow the curvature, the triangles are made by :mod:`esfem_core.surfaces`, and
what comes out is checked against the old surface. Where a triangle does not follow that, edges are
halved nearby and the triangles are made again from there. Curved elements that fold over become
flat: so it is where the old surface, known by too few triangles, has edges and not bends.
"""

from typing import NamedTuple

import numpy as np
import trimesh
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra

from esfem_core.checks import Array, Bools, Ints
from esfem_core.elements import (
    Surface,
    SurfaceSpace,
    TangentPlanes,
    closest_points,
    nodal_average,
    node_indices,
    tabulate,
)
from esfem_core.surfaces import (
    Guide,
    MeshingError,
    components,
    evened,
    normals_of,
    resized,
    without_unused,
)

__all__ = ["Transfer", "triangulated"]

FEWEST = 20  # triangles that a component must have room for, as many as an icosahedron has
MOST = 10**6  # triangles
SPACING = 0.25  # of the points that stand for the old surface, over lengths of edges
ROUNDS, ATTEMPTS = 8, 4
FINEST, RADII, SLOPE = 1 / 32, 0.7, 0.4  # of lengths of edges, see _lengths and _graded
LEAST_ANGLE = 15.0  # degrees: what is worse is no help
MAX_TURN, SLACK, LAST_TURN = 60.0, 15.0, 120.0  # degrees between old and new normals
FOLDED, FLATTENINGS = 0.2, 5  # a smaller cosine within an element; attempts
ANY_TURN = -2.0  # a cosine: all are accepted


class Transfer(NamedTuple):
    """New nodes as points of an old space.

    Attributes
    ----------
    cells : (S, (k+1)(k+2)/2) int array
        The new elements.
    cell : (n,) int array
        The old element that each new node lies in.
    interpolation : (n, N) CSR array
        Values there of functions given by their values at the old nodes.
    """

    cells: Ints
    cell: Ints
    interpolation: csr_array


def triangulated(space: SurfaceSpace, x: Array, h: float, normal: Array | None = None) -> Transfer:
    """Triangulate Γ_h[x] anew.

    Parameters
    ----------
    space : SurfaceSpace
        Of a closed surface.
    x : (N, 3) float array
    h : float
        Length of edges, positive; shorter where the surface bends.
    normal : (N, 3) float array, optional
        Normals at the nodes, of any length. A law that evolves the normal knows the curvature
        better than the elements do: where particles come close to each other, as at the tips of
        a surface that shrinks, small errors of their positions are steep. None: those of the
        elements.

    Returns
    -------
    Transfer

    Raises
    ------
    ValueError
        If h is too large, see :func:`esfem_core.remeshed`, or gives more than a million triangles;
        if a node has no normal, or those that are given point inwards.
    MeshingError
        If some angle remains below 15 degrees.
    """
    at = Surface(space, x)
    _check_room(at, h)
    normal = _unit_normals(at, normal)
    turn = _allowed_turn(at, normal)
    lengths = _lengths(at, h, normal)
    vertices, faces = without_unused(x, space.cells[:, :3])
    for _ in range(ATTEMPTS):
        lengths = _graded(at, lengths)
        planes = TangentPlanes(at, SPACING * lengths[space.cells].min(axis=1), normal)
        guide = Guide(planes.distance, planes.normal, planes.near, planes.values(lengths / h))
        found = evened(*resized(vertices, faces, guide, h), guide, h, ROUNDS, ANY_TURN)
        vertices, faces = found.vertices, found.faces
        transfer = _transfer(at, vertices, faces, h)
        follows = _follows(at, normal, transfer, turn)
        if follows.all() and found.quality.min_angle >= LEAST_ANGLE:
            return transfer
        near = np.unique(space.cells[transfer.cell[transfer.cells[~follows]]])
        lengths[near] /= 2
    if follows.all():
        raise MeshingError(
            f"the smallest angle remains {found.quality.min_angle:.1f} degrees (allowed: "
            f"{LEAST_ANGLE:g}); a smaller h than {h:g} may help"
        )
    place = vertices[faces[int(np.argmin(follows))]].mean(axis=0).round(3).tolist()
    raise ValueError(
        f"h = {h:g} is too large for this surface: a triangle near {place} does not follow it"
    )


def _unit_normals(at: Surface, given: Array | None) -> Array:
    """Those of the elements at the nodes, or given ones, with length one."""
    normal = nodal_average(at, at.normal) if given is None else given
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    if not (length > 0).all():
        i = int(np.argmin(length > 0))
        why = "those of the elements around cancel" if given is None else 'its "normal" is zero'
        raise ValueError(
            f"the surface must have a normal at each node, but at node {i}, "
            f"{at.x[i].tolist()}, {why}"
        )
    cells = at.space.cells[:, :3]
    if given is not None and np.einsum("ti,tai->", _planes(at.x, cells), normal[cells]) < 0:
        raise ValueError('the vectors "normal" of the last state must point outwards, not inwards')
    return np.asarray(normal / length)


def _lengths(at: Surface, h: float, normal: Array) -> Array:
    """Wanted lengths of edges at the nodes, (N,).

    They are h, or less where the surface bends: `RADII` radii of curvature, but at least `FINEST` h
    and half the shortest edge of the old element, which says how well the surface is known.
    """
    space = at.space
    bending = np.linalg.norm(space.gradient(at.x, normal), axis=(2, 3)).max(axis=1)
    corners = at.x[space.cells[:, :3]]
    own = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).min(axis=1)
    least = np.clip(own / 2, FINEST * h, h)
    wanted = np.clip(RADII / np.maximum(bending, 1e-300), least, h)
    lengths = np.full(len(at.x), h)
    np.minimum.at(lengths, space.cells, wanted[:, None])
    return lengths


def _graded(at: Surface, lengths: Array) -> Array:
    """The largest lengths, (N,), below the given ones that grow with a slope of at most `SLOPE`."""
    # Paths over edges between nodes, from a point that is as far away from each as its length.
    i, j = at.space.pattern.nonzero()
    n, away = len(lengths), SLOPE * np.linalg.norm(at.x[i] - at.x[j], axis=1)
    every = np.arange(n, dtype=i.dtype)  # SciPy's paths want 32 bits as the pattern has them
    ends = np.r_[i, np.full_like(every, n)], np.r_[j, every]
    graph = coo_array((np.r_[away, lengths], ends), (n + 1, n + 1))
    return np.asarray(dijkstra(graph.tocsr(), indices=[n]))[0, :n]


def _allowed_turn(at: Surface, normal: Array) -> float:
    """Cosine of 60 degrees, or of more where the surface turns by more within old elements."""
    cells = at.space.cells[:, :3]
    cosine = np.einsum("ti,tai->ta", _planes(at.x, cells), normal[cells]).min()
    found = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return float(np.cos(np.radians(np.clip(found + SLACK, MAX_TURN, LAST_TURN))))


def _planes(x: Array, faces: Ints) -> Array:
    """Unit normals of triangles, (T, 3)."""
    n = normals_of(x, faces)
    return np.asarray(n / np.linalg.norm(n, axis=1, keepdims=True))


def _transfer(at: Surface, vertices: Array, faces: Ints, h: float) -> Transfer:
    """Give new triangles nodes on the old surface; h is for the message if they are unfit there."""
    space, x = at.space, at.x
    vertices = closest_points(space, x, vertices).points
    try:
        flat = SurfaceSpace(trimesh.Trimesh(vertices, faces, process=False), space.degree)
    except ValueError:  # it tells of triangles that nobody else has
        raise ValueError(
            f"h = {h:g} is too large for this surface: the new triangles do not follow it, as "
            "where two of its sides are near each other"
        ) from None
    found = closest_points(space, x, flat.nodes)
    values = tabulate(space.degree, found.local).values
    rows = np.arange(0, values.size + 1, values.shape[1])
    shape = len(flat.nodes), len(space.nodes)
    P = csr_array((values.ravel(), space.cells[found.cell].ravel(), rows), shape)
    for _ in range(FLATTENINGS):
        folded = _folded(flat, np.asarray(P @ x))
        if not folded.any():
            break
        P = _flattened(flat, folded) @ P
    return Transfer(flat.cells, found.cell, P)


def _folded(space: SurfaceSpace, x: Array) -> Bools:
    """Which elements turn by a right angle, or nearly, against the triangle of their corners."""
    curved = Surface(space, x).normal
    cosine = np.einsum("ti,tqi->tq", _planes(x, space.cells[:, :3]), curved)
    return np.asarray(cosine.min(axis=1) < FOLDED)


def _flattened(space: SurfaceSpace, which: Bools) -> csr_array:
    """Takes nodal values to those with nodes of some elements on the planes of their corners."""
    cells = space.cells[which]
    nodes, first = np.unique(cells, return_index=True)
    element, place = np.divmod(first, cells.shape[1])
    share = np.ones(len(space.nodes))
    share[nodes] = 0
    weights = (node_indices(space.degree) / space.degree)[place]
    kept = np.flatnonzero(share)
    rows = np.r_[kept, np.repeat(nodes, 3)]
    columns = np.r_[kept, cells[element, :3].ravel()]
    values = np.r_[share[kept], weights.ravel()]
    return csr_array((values, (rows, columns)), (len(share), len(share)))


def _follows(at: Surface, normal: Array, transfer: Transfer, turn: float) -> Bools:
    """Which new triangles do not turn too much against the old surface, and join no two parts."""
    cells, P = transfer.cells, transfer.interpolation
    plane = _planes(np.asarray(P @ at.x), cells[:, :3])
    n = np.asarray(P @ normal)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    cosine = np.einsum("ti,tai->ta", plane, n[cells]).min(axis=1)
    component = components(at.space.cells[:, :3])[transfer.cell]
    torn = (component[cells] != component[cells[:, :1]]).any(axis=1)
    return np.asarray((cosine > turn) & ~torn)


def _check_room(at: Surface, h: float) -> None:
    """Refuse a length that leaves a component too few triangles, or would make too many."""
    component = components(at.space.cells[:, :3])
    areas = np.bincount(component, at.density @ at.space.rule.weights)
    triangle = np.sqrt(3) / 4
    limit = float(np.sqrt(areas.min() / (FEWEST * triangle)))
    if h > limit:
        which = "the surface" if len(areas) == 1 else "the smallest component"
        raise ValueError(
            f"h must be at most {limit!r}, so that {which}, of area {areas.min():.3g}, has room "
            f"for {FEWEST} triangles, got {h:g}"
        )
    least = float(np.sqrt(areas.sum() / (MOST * triangle)))
    if h < least:
        raise ValueError(
            f"h must be at least {least!r}, so that there are at most {MOST} triangles, got {h:g}"
        )
