"""Closest points of a discrete surface, and values of finite element functions there."""

from math import factorial
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from esfem_core.checks import Array, Ints, finite_array, shown
from esfem_core.elements.lagrange import node_indices, tabulate
from esfem_core.elements.numbering import flat_triangles
from esfem_core.surfaces import FootPoints

__all__ = ["ClosestPoints", "closest_points", "probe"]

CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
EDGES = np.roll(CORNERS, -1, axis=0) - CORNERS
CHUNK = 50_000  # pairs that are treated at once
MANY = 100  # pieces for a point: from there on it is worth while to look at each more closely
PRODUCTS = 2_000_000  # of Bézier points that are kept at once
THIN = 1e-6  # doubled area over the longest side squared: a normal has an error of 1e-10
TOLERANCE = 1e-8  # of distances to triangles, and of what is taken as the same point
FAR = 1e7  # sizes of the surface; farther away, rounding of distances hides closest points


@runtime_checkable
class SpaceLike(Protocol):
    """What is used of a :class:`esfem_core.SurfaceSpace`."""

    degree: int
    nodes: Array
    cells: Ints


class ClosestPoints(NamedTuple):
    """Points of Γ_h[x] that are closest to n given ones.

    Attributes
    ----------
    cell : (n,) int array
        Elements that they lie in.
    local : (n, 2) float array
        Reference coordinates (xi, eta) there.
    points : (n, 3) float array
    distance : (n,) float array
        From the given points.
    """

    cell: Ints
    local: Array
    points: Array
    distance: Array


def check_space(space: SpaceLike) -> None:
    """Refuse what is no space.

    Examples
    --------
    >>> check_space(None)
    Traceback (most recent call last):
        ...
    TypeError: space must be a SurfaceSpace, got None
    """
    if not isinstance(space, SpaceLike):
        raise TypeError(f"space must be a SurfaceSpace, got {shown(space)}")


def closest_points(space: SpaceLike, x: ArrayLike, points: ArrayLike) -> ClosestPoints:
    """Find the points of Γ_h[x] that are closest to given ones.

    On each element that could hold the closest point, ``|Phi(xi) - p|^2`` is minimised over the
    reference triangle by Newton's method. No element is left out that could be closer: each is
    divided into k² pieces, and a piece lies in the convex hull of its Bézier points, and near the
    triangle of its corners. In each piece that remains four descents start, at its corners and its
    centre. They find its closest point, unless it is crumpled so much that the distance has further
    minima between them. Distances are exact to rounding; so are places along the surface, but to
    1e-8 of its size from near a centre of curvature and, for k > 3, on some edges. At a hub, where
    n elements meet, its own node is compared with all n.

    Parameters
    ----------
    space : SurfaceSpace
    x : (N, 3) array_like of float
        Node positions.
    points : (n, 3) array_like of float
        Anywhere; n may be 0. From 1e7 sizes of x on, the direction from the origin decides.

    Returns
    -------
    ClosestPoints
        Where there are several, one of them; on an edge or a corner, the element with the
        smallest number.

    Raises
    ------
    TypeError, ValueError
        If an argument has the wrong type or shape or is not real and finite.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 2), 2, ec.to_unit_sphere)
    >>> found = closest_points(space, space.nodes, [[0.0, 0.0, 3.0], [3.0, 4.0, 0.0]])
    >>> found.points.round(2) + 0.0
    array([[0. , 0. , 1. ],
           [0.6, 0.8, 0. ]])
    >>> found.distance.round(2)
    array([2., 4.])
    """
    check_space(space)
    x = finite_array("x", x, (len(space.nodes), 3))
    given = finite_array("points", points, ("n", 3))
    largest, size = np.abs(x).max(initial=0), np.abs(given).max(axis=1, initial=0)
    far = size / FAR > largest
    _, scale = np.frexp(largest)  # a power of 2: it rounds nothing
    scaled = np.ldexp(np.where(far[:, None], 0, given), -scale)
    scaled[far] = FAR * (given[far] / size[far, None])
    degree, nodes = space.degree, np.ldexp(x, -scale)[space.cells]
    pieces = _divide(degree, nodes)
    per_cell = len(pieces.starts)

    def descend(point: Ints, piece: Ints) -> tuple[Ints, Ints, Array, Array]:
        start = pieces.starts[piece % per_cell].reshape(-1, 2)
        point, piece = np.repeat(point, 4), np.repeat(piece, 4)
        relative = nodes[piece // per_cell] - scaled[point, None]
        return point, piece, *_minimise(degree, relative, start)

    nearest = np.asarray(cKDTree(pieces.centre).query(scaled)[1], dtype=np.int64)
    rows = [descend(np.arange(len(scaled)), nearest)]
    bound = rows[0][3].reshape(-1, 4).min(axis=1)
    point, piece = _candidates(pieces, scaled, bound)
    others = np.flatnonzero(piece != nearest[point])  # that one is known
    for part in np.array_split(others, len(others) // CHUNK + 1):
        rows.append(descend(point[part], piece[part]))
    point, piece, local, distance = (np.concatenate(parts) for parts in zip(*rows, strict=True))
    found = np.einsum("na,nai->ni", tabulate(degree, local).values, nodes[piece // per_cell])

    # The closest of each point; then, of all that are the same point, the smallest element.
    order = np.lexsort((piece, distance, point))
    best = order[np.unique(point[order], return_index=True)[1]][point]
    gap = np.linalg.norm(found - found[best], axis=1)
    same = np.flatnonzero(gap <= 1e-12 * pieces.radius[piece[best]])
    order = same[np.lexsort((distance[same], piece[same] // per_cell, point[same]))]
    chosen = order[np.unique(point[order], return_index=True)[1]]
    closest, distance = np.ldexp(found[chosen], scale), np.ldexp(distance[chosen], scale)
    with np.errstate(over="ignore"):  # infinite if it is larger than any float
        distance[far] = np.hypot.reduce(given[far] - closest[far], axis=1)
    return ClosestPoints(piece[chosen] // per_cell, local[chosen], closest, distance)


def probe(space: SpaceLike, x: ArrayLike, u: ArrayLike, points: ArrayLike) -> Array:
    """Values of a finite element function at the points of Γ_h[x] closest to given ones.

    A point that is as far from all of the surface, as the centre of a sphere, is compared with
    every element, in a time that grows with their number, and its value is that at one of many
    closest points.

    Parameters
    ----------
    space : SurfaceSpace
    x : (N, 3) array_like of float
        Node positions.
    u : (N, ...) array_like of float
        Nodal values.
    points : (n, 3) array_like of float
        Anywhere; n may be 0.

    Returns
    -------
    (n, ...) float array

    Raises
    ------
    TypeError, ValueError
        If an argument has the wrong type or shape or is not real and finite.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 3), 2, ec.to_unit_sphere)
    >>> x = space.nodes
    >>> probe(space, x, x[:, 0] * x[:, 1], [[0.3, 0.4, 0.0], [3.0, 4.0, 0.0]]).round(4)
    array([0.48, 0.48])
    """
    check_space(space)
    u = finite_array("u", u, (len(space.nodes), "..."))
    at = closest_points(space, x, points)
    values = tabulate(space.degree, at.local).values
    found: Array = np.einsum("na,na...->n...", values, u[space.cells[at.cell]])
    return found


class _Pieces(NamedTuple):
    """The surface in small pieces, those of an element in succession."""

    starts: Array  # (k², 4, 2), their corners and centres in the reference triangle
    centre: Array  # (k² T, 3), on the surface
    bezier: Array  # (k² T, (k+1)(k+2)/2, 3), Bézier points as seen from there
    radius: Array  # (k² T,), of the ball around the centre that holds them
    bend: Array  # (k² T,), how far they are from the triangle of its corners, at most
    squares: csr_array  # from products of two Bézier points to the coefficients of the square


def _divide(degree: int, nodes: Array) -> _Pieces:
    """Pieces of elements with nodes (T, (k+1)(k+2)/2, 3)."""
    indices = node_indices(degree)
    lattice = indices / degree
    orders = np.array([factorial(i) for i in range(degree + 1)])[indices].prod(axis=1)
    bernstein = factorial(degree) / orders * (lattice[:, None] ** indices).prod(axis=2)
    # Bézier points take the values at a piece's own lattice when weighted by Bernstein polynomials.
    corners = lattice[flat_triangles(np.arange(len(lattice))[None], degree), 1:]  # (k², 3, 2)
    values = tabulate(degree, (lattice @ corners).reshape(-1, 2)).values
    bezier = np.linalg.solve(bernstein, values.reshape(len(corners), *bernstein.shape))
    centres = corners.mean(axis=1)
    at_centre = tabulate(degree, centres).values
    relative = ((bezier - at_centre[:, None]) @ nodes[:, None]).reshape(-1, len(lattice), 3)
    radius = np.linalg.norm(relative, axis=2).max(axis=1)
    bend = np.linalg.norm(relative - lattice @ relative[:, :3], axis=2).max(axis=1)
    starts = np.concatenate([corners, centres[:, None]], axis=1)
    squares = _squares(indices, factorial(degree) / orders)
    return _Pieces(starts, (at_centre @ nodes).reshape(-1, 3), relative, radius, bend, squares)


def _squares(indices: Ints, multinomials: Array) -> csr_array:
    """From L² products b_i b_j to Bernstein coefficients of (sum b_i B_i)², of degree 2k.

    B_i B_j is a multiple of the polynomial with the index i + j. A polynomial is nowhere less than
    the least of its coefficients.
    """
    sums = (indices[:, None] + indices).reshape(-1, 3)
    found, inverse = np.unique(sums, axis=0, return_inverse=True)
    row = inverse.ravel()  # some versions of NumPy give it a second axis
    weights = np.outer(multinomials, multinomials).ravel()
    weights /= np.bincount(row, weights)[row]  # of constants, all coefficients are the square
    return csr_array((weights, (row, np.arange(len(row)))), shape=(len(found), len(row)))


def _candidates(pieces: _Pieces, points: Array, bound: Array) -> tuple[Ints, Ints]:
    """Pairs of a point and a piece that may come closer than a bound, in the closest elements."""
    per_cell = len(pieces.starts)
    point, cell = np.divmod(_closest_cells(pieces, points, bound), len(pieces.centre) // per_cell)
    point = np.repeat(point, per_cell)
    piece = (per_cell * cell[:, None] + np.arange(per_cell)).ravel()
    # All of a piece lies beyond its first Bézier point in the direction of its centre.
    direction = pieces.centre[piece] - points[point]
    length = np.linalg.norm(direction, axis=1)
    direction /= np.maximum(length, 1e-300)[:, None]
    ahead = length + np.einsum("nai,ni->an", pieces.bezier[piece], direction).min(axis=0)
    size = length + pieces.radius[piece]
    keep = ahead <= bound[point] + 1e-12 * size
    point, piece, size = point[keep], piece[keep], size[keep]
    # Seen from near the centre of a sphere, that tells few pieces apart; squares of distances do.
    many = np.flatnonzero(np.bincount(point, minlength=len(points))[point] > MANY)
    squared = _least_squares(pieces, points, point[many], piece[many])
    beyond = many[squared > bound[point[many]] ** 2 + 1e-12 * size[many] ** 2]
    point, piece = np.delete(point, beyond), np.delete(piece, beyond)
    order = np.lexsort((piece, np.frexp(pieces.radius)[1][piece], point))  # small ones first
    return point[order], piece[order]


def _least_squares(pieces: _Pieces, points: Array, point: Ints, piece: Ints) -> Array:
    """What squared distances of points to pieces are at least: their least coefficients."""
    least = np.empty(len(point))
    count = max(PRODUCTS // pieces.squares.shape[1], 1)
    for i in range(0, len(point), count):
        here = slice(i, i + count)
        b = pieces.bezier[piece[here]] + (pieces.centre[piece[here]] - points[point[here]])[:, None]
        products = (b @ b.swapaxes(1, 2)).reshape(len(b), -1)
        least[here] = (pieces.squares @ products.T).min(axis=0)
    return least


def _closest_cells(pieces: _Pieces, points: Array, bound: Array) -> Ints:
    """Pairs of points and elements that may hold the closest: number of a point times T, plus t.

    A piece is near the triangle of its corners: no farther than its Bézier points are from points
    of that with the same coordinates. So the triangles tell which is closest, but for elements that
    nearly are; of triangles so thin that their normals are rounding, nothing is taken as known.
    """
    corners = pieces.centre[:, None] + pieces.bezier[:, :3]
    foot = FootPoints(corners, pieces.bend)
    sides = np.roll(corners, -1, axis=1) - corners
    double_area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    thin = double_area <= THIN * (sides**2).sum(axis=2).max(axis=1)
    unsure = np.where(thin, np.inf, pieces.bend)

    first, per_cell = foot.near(points), len(pieces.starts)
    bound = np.minimum(bound, foot.foot(points, first)[1] + unsure[first])
    found = []
    for point, piece in foot.pairs(points, bound + TOLERANCE):
        distance = foot.foot(points[point], piece)[1]
        np.minimum.at(bound, point, distance + unsure[piece])
        error = unsure[piece] + TOLERANCE * (1 + distance)
        found.append(
            (point * (len(corners) // per_cell) + piece // per_cell, point, distance - error)
        )
    pair, point, least = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return np.unique(pair[least <= bound[point]])


def _minimise(degree: int, nodes: Array, start: Array) -> tuple[Array, Array]:
    """Minimise |Phi| over the reference triangle for elements with nodes (n, L, 3).

    Each step minimises a convex quadratic model of f = |Phi|²/2 over the triangle and goes there,
    or a part of the way if f does not decrease enough. Edges and corners need no other treatment.
    """
    indices = node_indices(degree)[:, 1:] / degree
    derivative = tabulate(degree, indices).derivatives[:, None]  # of nodal values
    local, target = start.copy(), start.copy()
    f, slope, part = np.full(len(nodes), np.inf), np.zeros(len(nodes)), np.ones(len(nodes))
    last = np.zeros(len(nodes), dtype=bool)
    rounding = 1e-15 * np.abs(nodes).max(axis=(1, 2))  # of Phi
    todo = np.arange(len(nodes))
    for _ in range(100):
        t = part[todo, None]
        trial = (1 - t) * local[todo] + t * target[todo]
        values, first = tabulate(degree, trial)
        here = nodes[todo]
        r = np.einsum("na,nai->ni", values, here)
        J = np.einsum("dna,nai->dni", first, here)
        along = (here @ r[..., None])[..., 0]
        G = np.einsum("dni,eni->den", J, J)
        S = ((first @ derivative) * along).sum(axis=3)
        new = (r * r).sum(axis=1) / 2
        noise = rounding[todo] * np.sqrt(2 * new)
        # The last step gains less than rounding: it makes the place exact, not the distance.
        allowed = np.where(last[todo], 4, 1) * noise
        good = new <= f[todo] + 1e-4 * part[todo] * slope[todo] + allowed
        part[todo] = np.where(good, 1, part[todo] / 4)
        ended = last[todo]
        i = todo[good]
        local[i], f[i] = trial[good], new[good]
        g = (J * r).sum(axis=2)[:, good]
        target[i], slope[i], decrease = _step(trial[good], g, G[..., good], S[..., good])
        last[i] = decrease <= noise[good]  # one more step of Newton's method is exact enough
        size = np.abs(target[todo] - local[todo]).max(axis=1)
        todo = todo[~ended & (part[todo] * size > 1e-15)]
        if not len(todo):
            break
    return local, np.sqrt(2 * f)


def _step(local: Array, g: Array, G: Array, S: Array) -> tuple[Array, Array, Array]:
    """Next point of the triangle for the gradient g and the Hessian G + S; slope and decrease."""
    target, H = _lowest(local, g, _convex(G, S)), G + S
    step = (target - local).T
    slope, curvature = (g * step).sum(axis=0), np.einsum("dn,den,en->n", step, H, step)
    # Where G + S is not convex, its minimum in that direction may lie further away: there, or on
    # the triangle's boundary. Where it is, only rounding says so, loudest along an edge.
    room, ahead = np.stack([1 - local.sum(axis=1), *local.T]), np.stack([step.sum(axis=0), *-step])
    used = np.divide(ahead, room, out=np.zeros_like(room), where=room > 0).max(axis=0)
    bend = np.divide(curvature.clip(0), -slope, out=np.ones_like(slope), where=slope < 0)
    share = np.maximum(used, bend)  # the step's share of the way to there
    share[(_det(H) > 0) & (H[0, 0] > 0)] = 1
    factor = np.where(share < 1 - 1e-9, 1 / np.maximum(share, 1e-9), 1)
    beyond = np.maximum(local + factor[:, None] * step.T, 0)
    beyond /= np.maximum(beyond.sum(axis=1), 1)[:, None]
    target = np.where(factor[:, None] > 1, beyond, target)
    return target, factor * slope, -factor * (slope + factor * curvature / 2)


def _convex(G: Array, S: Array) -> Array:
    """Make G + S positive definite: its smallest eigenvalue relative to G by modulus."""
    G = G + (1e-15 * (G[0, 0] + G[1, 1]) + 1e-300) * np.eye(2)[..., None]
    det = np.maximum(_det(G), 1e-300)
    mean = (G[1, 1] * S[0, 0] - 2 * G[0, 1] * S[0, 1] + G[0, 0] * S[1, 1]) / (2 * det)
    lowest = 1 + mean - np.sqrt(np.maximum(mean**2 - _det(S) / det, 0))
    shifted: Array = S + (1 + np.maximum(1e-6, np.abs(lowest)) - lowest) * G
    return shifted


def _det(H: Array) -> Array:
    return np.asarray(H[0, 0] * H[1, 1] - H[0, 1] ** 2)


def _lowest(local: Array, g: Array, H: Array) -> Array:
    """Where in the triangle g s + s H s / 2 is lowest, with s from `local`."""
    det = _det(H)
    newton = np.stack([H[0, 1] * g[1] - H[1, 1] * g[0], H[0, 1] * g[0] - H[0, 0] * g[1]])
    inside = local + (newton / np.where(det > 0, det, np.inf)).T
    free = (det > 0) & (inside >= 0).all(axis=1) & (inside.sum(axis=1) <= 1)
    slopes = g + np.einsum("den,cnd->cen", H, CORNERS[:, None] - local)  # at the corners
    curvature = np.einsum("cd,den,ce->cn", EDGES, H, EDGES)
    t = -np.einsum("cd,cdn->cn", EDGES, slopes) / np.maximum(curvature, 1e-300)
    on_edges = CORNERS[:, None] + np.clip(t, 0, 1)[..., None] * EDGES[:, None]
    steps = on_edges - local
    model = np.einsum("dn,cnd->cn", g, steps) + np.einsum("cnd,den,cne->cn", steps, H, steps) / 2
    best = on_edges[model.argmin(axis=0), np.arange(len(local))]
    return np.where(free[:, None], inside, best)
