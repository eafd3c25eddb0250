"""Even triangles on a surface: short edges are collapsed, long ones split, the rest is relaxed.

What carries the triangles is known by three functions, a :class:`Guide`: of a level set, or of the
elements of a run. The changes themselves are those of :mod:`esfem_core.surfaces.edges`.
"""

from typing import NamedTuple

import numpy as np
import trimesh

from esfem_core.checks import Array, Ints
from esfem_core.surfaces.edges import collapse, edges_of, flip, split
from esfem_core.surfaces.level_set import Field
from esfem_core.surfaces.orientation import normals_of
from esfem_core.surfaces.quality import Quality, mesh_quality

__all__ = [
    "MAX_ROUNDS",
    "MEAN_RATIO",
    "MIN_ANGLE",
    "Evened",
    "Guide",
    "TooCoarseError",
    "evened",
    "resized",
]

# What is asked of the mesh; the rounds end when it holds and the mean ratio has settled.
MIN_ANGLE = 30.0  # degrees
MEAN_RATIO = 0.96  # of radii, 2 r_in/r_out
SETTLED = 0.003  # smallest gain of the mean ratio in a round that is worth another
SHORTEST, LONGEST = 0.6, 1.5  # shorter edges are collapsed, longer ones split; times h
MAX_ROUNDS, STEPS = 40, 12
MOST_FLIPS = 50  # passes over all edges in a row; ten are many
ROUGH_ROUNDS = 5  # after these the mesh must at least follow the surface
MAX_TURN = 0.5  # smallest cosine between normals of a triangle and of the surface at its corners
FOLDED, UNFOLDINGS = 0.3, 12  # a smaller cosine makes a fold; most attempts to take it away

# For another length of edges: halves of edges longer than 4/3 h are nearer to h, and edges shorter
# than 4/5 h after a collapse (M. Botsch, L. Kobbelt 2004).
TOO_SHORT, TOO_LONG = 4 / 5, 4 / 3
RESIZINGS, SWEEPS, FEW = 3, 20, 5


class TooCoarseError(ValueError):
    """Triangles too large for the curvature of their surface.

    Attributes
    ----------
    corners : (3, 3) float array
        Of one such triangle.
    """

    def __init__(self, message: str, corners: Array) -> None:
        super().__init__(message)
        self.corners = corners

    def __reduce__(self) -> tuple[object, ...]:  # for pools: exceptions are pickled by their text
        return type(self), (str(self), self.corners), vars(self)


class Guide(NamedTuple):
    """A surface, as triangles that move along it see it.

    Attributes
    ----------
    distance : callable
        (n, 3) -> (n,), zero on the surface and positive outside.
    gradient : callable
        (n, 3) -> (n, 3), of `distance`; along the normal.
    project : callable
        (n, 3) -> (n, 3), to the surface, or as near to it as is wanted.
    share : callable, optional
        (n, 3) -> (n,), the wanted length of edges there over h, at most 1; 1 if None.
    """

    distance: Field
    gradient: Field
    project: Field
    share: Field | None = None

    def lengths(self, x: Array, h: float) -> Array:
        """Wanted lengths of edges at points (n, 3), (n,)."""
        return np.full(len(x), h) if self.share is None else h * self.share(x)


class Evened(NamedTuple):
    """A triangulation after :func:`evened`.

    Attributes
    ----------
    vertices : (n, 3) float array
    faces : (T, 3) int array
    quality : Quality
    good : bool
        Whether all angles are above 30 degrees, all edges longer than 0.6 h, and the mean ratio of
        radii is above 0.96.
    """

    vertices: Array
    faces: Ints
    quality: Quality
    good: bool


def evened(
    x: Array,
    faces: Ints,
    guide: Guide,
    h: float,
    rounds: int = MAX_ROUNDS,
    turn: float = MAX_TURN,
) -> Evened:
    """Even out a triangulation whose edges have about the length h, until it is good and settled.

    A round is described with :func:`esfem_core.from_level_set`.

    Parameters
    ----------
    x : (n, 3) float array
        On the surface.
    faces : (T, 3) int array
        Closed and oriented.
    guide : Guide
    h : float
        Positive.
    rounds : int
        At most so many.
    turn : float
        Smallest cosine between normals of a triangle and of the surface at its corners.

    Returns
    -------
    Evened

    Raises
    ------
    TooCoarseError
        If the surface turns by more than 60 degrees, or what `turn` says, within a triangle, of
        the final mesh or of one that is not good after five rounds.

    Examples
    --------
    >>> import esfem_core as ec
    >>> sphere = ec.exact_surfaces.Sphere()
    >>> tri = ec.sphere("octahedron", 3)
    >>> guide = Guide(lambda x: np.linalg.norm(x, axis=1) - 1, sphere.normal, sphere.closest)
    >>> found = evened(tri.vertices, tri.faces, guide, 0.2)
    >>> found.good, bool(found.quality.mean_ratio > ec.mesh_quality(tri).mean_ratio)
    (True, True)
    """
    before = 0.0
    for n in range(rounds):
        x, faces, changes = _even_out(x, faces, guide, h)
        x, faces = _relax(guide.project(x), faces, guide, h)
        x = _unfolded(guide.project(x), faces, guide)
        reached = mesh_quality(trimesh.Trimesh(x, faces, process=False))
        good = (
            reached.min_angle >= MIN_ANGLE
            and reached.mean_ratio >= MEAN_RATIO
            and _shortest(x, faces, guide, h) >= SHORTEST
        )
        if good and not changes and reached.mean_ratio - before < SETTLED:
            break
        before = reached.mean_ratio
        if n >= ROUGH_ROUNDS and not good:
            _require_small_turns(x, faces, guide.gradient, h, turn)
    _require_small_turns(x, faces, guide.gradient, h, turn)
    return Evened(x, faces, reached, good)


def resized(x: Array, faces: Ints, guide: Guide, h: float) -> tuple[Array, Ints]:
    """Bring edges of any lengths to about h, for :func:`evened`.

    Parameters
    ----------
    x : (n, 3) float array
        On the surface.
    faces : (T, 3) int array
        Closed and oriented.
    guide : Guide
    h : float
        Positive.

    Returns
    -------
    (m, 3) float array, (S, 3) int array
        Vertices near the surface, and triangles.

    Examples
    --------
    >>> import esfem_core as ec
    >>> sphere, tri = ec.exact_surfaces.Sphere(), ec.sphere("icosahedron", 1)
    >>> guide = Guide(lambda x: np.linalg.norm(x, axis=1) - 1, sphere.normal, sphere.closest)
    >>> x, faces = resized(tri.vertices, tri.faces, guide, 0.15)
    >>> lengths = edges_of(faces).lengths(x)
    >>> bool(0.13 < lengths.mean() < 0.17)
    True
    """
    for _ in range(RESIZINGS):
        for _ in range(SWEEPS):
            x, faces, changes = split(x, faces, TOO_LONG * guide.lengths(x, h))
            if not changes:
                break
            x = _without_folds(x, guide.project(x), faces)
        faces = _flipped(x, faces)  # not before: flips of long edges cut through what is thin
        for _ in range(SWEEPS):
            e, wanted = edges_of(faces), guide.lengths(x, h)
            lengths, middle = e.lengths(x), wanted[e.ends].mean(axis=1)
            priority = np.where(lengths < TOO_SHORT * middle, middle - lengths, 0)
            x, faces, changes = collapse(x, faces, priority, TOO_LONG * wanted)
            if not changes:
                break
            x = _without_folds(x, guide.project(x), faces)
            faces = _flipped(x, faces)
        x, faces = _relax(x, faces, guide, h)
        x = _unfolded(x, faces, guide)
    return x, faces


def _even_out(x: Array, faces: Ints, guide: Guide, h: float) -> tuple[Array, Ints, int]:
    """Collapse short edges and one edge at vertices in fewer than five triangles; split long ones.

    New vertices are on edges, not on the surface. Also returns the number of changes.
    """
    e, wanted = edges_of(faces), guide.lengths(x, h)
    lengths, middle = e.lengths(x), wanted[e.ends].mean(axis=1)
    few = np.bincount(faces.ravel())[e.ends].min(axis=1) < 5
    priority = np.where(lengths < SHORTEST * middle, 2 * middle - lengths, 0)
    priority = np.where(few, 10 * middle - lengths, priority)
    x, faces, collapses = collapse(x, faces, priority, LONGEST * wanted)
    x, faces, splits = split(x, faces, LONGEST * guide.lengths(x, h))
    return x, faces, collapses + splits


def _shortest(x: Array, faces: Ints, guide: Guide, h: float) -> float:
    """The smallest length of an edge over what is wanted there."""
    e, wanted = edges_of(faces), guide.lengths(x, h)
    return float((e.lengths(x) / wanted[e.ends].mean(axis=1)).min())


def _relax(x: Array, faces: Ints, guide: Guide, h: float) -> tuple[Array, Ints]:
    """Let edges push their ends apart, and flip edges; vertices end near the surface."""
    share = guide.lengths(x, h) / h
    for step in range(STEPS):
        if step % 4 == 0:
            faces = _flipped(x, faces)
            i, j = edges_of(faces).ends.T
            middle = (share[i] + share[j]) / 2
        # Springs shorter than wanted push; as these are 1.2 mean lengths, nearly all are.
        across = np.take(x, j, axis=0) - np.take(x, i, axis=0)
        squares = np.maximum(np.einsum("ij,ij->i", across, across), 1e-300)
        wanted = 1.2 * np.sqrt((squares / middle**2).mean()) * middle
        push = (0.2 * np.maximum(wanted / np.sqrt(squares) - 1, 0))[:, None] * across
        move = np.stack(
            [np.bincount(j, p, len(x)) - np.bincount(i, p, len(x)) for p in push.T], axis=1
        )

        # Along the tangent plane, at most h/10 at once, then one Newton step to the surface.
        g = guide.gradient(x)
        steepness = np.einsum("ij,ij->i", g, g)
        if not steepness.all():
            zero = x[int(np.argmin(steepness))].tolist()
            raise ValueError(f"the gradient of d must not vanish, but is zero at {zero}")
        move -= (np.einsum("ij,ij->i", move, g) / steepness)[:, None] * g
        size = np.sqrt(np.einsum("ij,ij->i", move, move))
        y = x + np.minimum(1, 0.1 * h * share / np.maximum(size, 1e-3 * h))[:, None] * move
        y -= (guide.distance(y) / steepness)[:, None] * g
        x = _without_folds(x, y, faces)
    return x, faces


def _without_folds(x: Array, y: Array, faces: Ints) -> Array:
    """Vertices moved from x to y, but for those of triangles that would turn by 60 degrees."""
    before = normals_of(x, faces)
    for _ in range(FEW):
        after = normals_of(y, faces)
        square = np.einsum("ij,ij->i", before, before) * np.einsum("ij,ij->i", after, after)
        folded = np.einsum("ij,ij->i", before, after) < MAX_TURN * np.sqrt(square)
        if not folded.any():
            break
        back = np.unique(faces[folded])
        y = y.copy()  # `project` may keep what it has returned
        y[back] = x[back]
    return y


def _unfolded(x: Array, faces: Ints, guide: Guide) -> Array:
    """Vertices of folds moved to the mean of their neighbours, until no triangle is folded over.

    No move turns a triangle by much, and so a fold that has come about would stay for ever.
    """
    i, j = edges_of(faces).ends.T
    valence = np.bincount(i, minlength=len(x)) + np.bincount(j, minlength=len(x))
    for n in range(UNFOLDINGS):
        folded = _agreement(x, faces, guide) < FOLDED
        if not folded.any():
            break
        moved = np.unique(faces[folded])
        if n >= FEW:  # that was not enough: one ring more
            moved = np.unique(faces[np.isin(faces, moved).any(axis=1)])
        sums = [np.bincount(i, c[j], len(x)) + np.bincount(j, c[i], len(x)) for c in x.T]
        x = x.copy()
        x[moved] = guide.project((np.stack(sums, axis=1) / valence[:, None])[moved])
    return x


def _agreement(x: Array, faces: Ints, guide: Guide) -> Array:
    """Cosines between normals of triangles and the mean of the surface's at their corners, (T,)."""
    normals, g = normals_of(x, faces), guide.gradient(x)
    g = (g / np.linalg.norm(g, axis=1, keepdims=True))[faces].sum(axis=1)
    size = np.linalg.norm(normals, axis=1) * np.linalg.norm(g, axis=1)
    return np.asarray(np.einsum("ti,ti->t", normals, g) / np.maximum(size, 1e-300))


def _flipped(x: Array, faces: Ints) -> Ints:
    """The triangles after flips; near a singular point these could go on for ever."""
    for _ in range(MOST_FLIPS):
        faces, flips = flip(x, faces)
        if not flips:
            break
    return faces


def _require_small_turns(x: Array, faces: Ints, gradient: Field, h: float, turn: float) -> None:
    """Refuse triangles that the surface leaves at a larger angle than allowed."""
    normals = normals_of(x, faces)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    g = gradient(x)
    g = g / np.linalg.norm(g, axis=1, keepdims=True)  # not in place: it may be x itself
    cosine = np.einsum("ti,tji->tj", normals, g[faces]).min(axis=1)
    worst = int(np.argmin(cosine))
    if not cosine[worst] > turn:
        angle = np.degrees(np.arccos(np.clip(cosine[worst], -1, 1)))
        raise TooCoarseError(
            f"h must be smaller for this surface, got {h:g}, which is too large: near "
            f"{x[faces[worst, 0]].round(3).tolist()} it turns by {angle:.1f} degrees within a "
            f"triangle (allowed: {np.degrees(np.arccos(turn)):.1f}); angles go with h, so try "
            f"h = {0.8 * h * np.degrees(np.arccos(turn)) / angle:.2g}; where the surface has a "
            "crease or a tip, or meets itself, no h is small enough",
            x[faces[worst]],
        )
