"""A smooth surface through the vertices of a triangulation of which nothing else is known.

Through each vertex i runs a graph over its tangent plane, a cubic polynomial fitted to the vertices
of two rings (:mod:`esfem_core.surfaces.graphs`). With h_i(p) the height of this graph above a point
p, measured along the normal n_i of the plane, the point p of a triangle with barycentric
coordinates b goes to

    S(p) = p + sum_i b_i h_i(p) n_i,

the mean of its places on the graphs of the three corners (X. Jiao, D. Wang, Eng. Comput. 28, 2012).
On an edge only its two ends count, so that neighbours agree there; at a vertex the graph passes
through it, so that it stays where it is.

Cubic graphs through points of a smooth surface are at a distance O(h^4) from it, and their normals
differ by O(h^3). So it is with S: the three places lie within O(h^3) of each other along the
surface, and hence their mean within O(h^6) of it.

An edge whose two triangles differ by more than a given angle is a crease. It cuts the triangles
around its ends into fans. Each fan has a graph of its own, and no fit looks across. From both sides
the crease goes to the curve where the two smooth surfaces meet, and its triangles go with it.

The rim of an open surface, the sides of one triangle each, goes to cubic curves through its
vertices, and from there to S; its triangles go with it.
"""

import numpy as np
import trimesh

from esfem_core.checks import Array, Ints, ReadOnly, finite_array, number, read_only
from esfem_core.surfaces.check import boundary_advice, check_triangulation
from esfem_core.surfaces.foot_points import FootPoints
from esfem_core.surfaces.graphs import Graphs, fit_graphs
from esfem_core.surfaces.orientation import Sides, fans, sides_of
from esfem_core.surfaces.quality import angles_of

__all__ = ["SmoothSurface", "smooth"]

ON_EDGE = 1e-10  # barycentric coordinates below are zero: from both sides the same point
TURNS = 4  # of Newton's method for the curve at a crease

# Where triangles do not resolve a surface, a fit must not tear it. None of these limits is active
# once the surface is resolved by triangles of bounded shape. Flat sides of bodies may have others,
# whose altitudes are of second order at a round edge: there a third of its arc's height is cut off.
DOUBTED, USELESS = 45.0, 75.0  # degrees between a graph and its triangles: weight 1, weight 0
TILTED = 0.5  # smallest cosine between a quarter of an element and its triangle
HALVINGS = 8  # of the weights of graphs, and of the room of arcs, where it is smaller
BENT = 0.08  # height of the arc of a crease, over its chord and the altitudes of its triangles
NO_MEAN = 1e-9  # length of a mean normal, in radians: triangles that face each other
FAR = 1e100  # beyond, products of coordinates are not finite
PARALLEL = 0.1  # squared difference of unit normals of two sides that hardly cross


def smooth(tri: trimesh.Trimesh, crease: float = 50.0, boundary: bool = False) -> "SmoothSurface":
    """Make the map that takes points near a triangulation to a smooth surface through its vertices.

    For surfaces that are known by their triangles only, as those of most files. On a smooth
    surface the distance is of order 4 and the normal of order 3, where facets have 2 and 1, so
    that elements of degree 2 and 3 keep their orders k + 1 and k. That is for triangles of bounded
    shape: beside long ones, as CAD programs make them, the surface can be farther off than the
    facets; compare the volumes.

    Parameters
    ----------
    tri : trimesh.Trimesh
        Closed, oriented outwards. Its vertices are kept: if they are noisy, so is the surface.
    crease : float
        In degrees, 0 to 180. Edges at which normals of triangles differ by more stay sharp, and
        no fit uses points beyond them. A body with flat sides remains what it is. 180 rounds all
        edges. Likewise a rim has a corner where it turns by more.
    boundary : bool
        Whether `tri` may have a boundary, for a space with ``boundary=True``. A smooth one becomes
        a curve at a distance of order 4 as well.

    Returns
    -------
    SmoothSurface
        A `project` for :class:`esfem_core.SurfaceSpace`.

    Raises
    ------
    TypeError, ValueError
        If `tri` is unfit, see :func:`esfem_core.check_triangulation`, `crease` is no number from 0
        to 180, or `boundary` is neither True nor False.

    Examples
    --------
    The area of a torus from its triangles, from these alone with curved elements, and with nodes
    on the torus itself:

    >>> import esfem_core as ec
    >>> tri = ec.torus(1.0, 0.4, n=40, m=16)
    >>> for project in (None, ec.smooth(tri), ec.exact_surfaces.Torus(1.0, 0.4).closest):
    ...     space = ec.SurfaceSpace(tri, 2, project)
    ...     print(f"{space.integrate(space.nodes, 1.0) / (4 * np.pi**2 * 0.4):.4f}")
    0.9910
    0.9987
    1.0000
    """
    _check_fit(tri, boundary)
    crease = number("crease", crease, least=0, most=180)
    return SmoothSurface(np.array(tri.vertices, float), np.array(tri.faces, np.int64), crease)


def _check_fit(tri: trimesh.Trimesh, boundary: bool) -> None:
    """Refuse an unfit mesh; of one with holes say how it has a smooth surface, too."""
    try:
        check_triangulation(tri, boundary)
    except ValueError as error:
        if boundary or not boundary_advice(np.array(tri.vertices), np.array(tri.faces)):
            raise
        raise ValueError(
            f"{error}, and with project = ec.smooth(tri, boundary=True) "
            "ec.SurfaceSpace(tri, 2, project, boundary=True) puts nodes on a smooth surface"
        ) from None


class SmoothSurface(ReadOnly):
    """A smooth surface through the vertices of a triangulation, made by :func:`smooth`.

    Called with points, (n, 3), it takes them to the closest points of the flat triangles, and these
    to the smooth surface.

    Attributes
    ----------
    vertices : (V, 3) float array
    faces : (T, 3) int array
    creases : (E, 2) int array
        Vertices at the ends of the edges that stay sharp.

    Examples
    --------
    >>> import esfem_core as ec
    >>> surface = ec.smooth(ec.sphere("icosahedron", 2))
    >>> surface
    SmoothSurface(vertices=162, triangles=320, creases=0)
    >>> points = np.array([[2.0, 0.0, 0.0], [0.0, 0.6, 0.8]])
    >>> np.linalg.norm(surface(points), axis=1).round(3)
    array([1.   , 0.999])
    >>> surface.normal(points).round(2) + 0.0
    array([[1. , 0. , 0. ],
           [0. , 0.6, 0.8]])
    """

    def __init__(self, vertices: Array, faces: Ints, crease: float) -> None:
        self.vertices, self.faces = vertices, faces
        flat = _Flat(vertices[faces])
        sides = sides_of(faces)
        pairs = sides.pairs()
        sharp = flat.turns(pairs) > np.radians(crease)

        # Side 3t + n of triangle t runs from its corner n to the next.
        self._across = np.full(faces.size, -1)
        self._across[pairs[sharp].ravel()] = pairs[sharp][:, ::-1].ravel()
        self._room = flat.room(pairs)
        self._rim = _Rim(vertices, sides, crease)
        start, end = _corners(pairs[sharp, 0])
        self.creases = np.sort(np.stack([faces.flat[start], faces.flat[end]], axis=1), axis=1)

        label = fans(faces, pairs[~sharp])
        _, first, fan = np.unique(label, return_index=True, return_inverse=True)
        self._fan = fan.reshape(-1, 3)
        normals = flat.mean_normals(self._fan)
        self._graphs = fit_graphs(vertices[faces.flat[first]], normals, self._fan)
        self._trust = flat.trust(self._graphs, self._fan)
        self._foot = FootPoints(flat.corners)
        self._calm(flat)
        read_only(vars(self))

    def __repr__(self) -> str:
        return (
            f"SmoothSurface(vertices={len(self.vertices)}, triangles={len(self.faces)}, "
            f"creases={len(self.creases)})"
        )

    def __call__(self, points: Array) -> Array:
        """Points of the smooth surface.

        Parameters
        ----------
        points : (n, 3) float array
            On the triangles or near; n may be 0.

        Returns
        -------
        (n, 3) float array

        Raises
        ------
        TypeError, ValueError
            If the points are not finite, of another shape, or farther away than 1e100.
        """
        return self._place(*self._locate(points))

    def normal(self, points: Array) -> Array:
        """Outward unit normals at the same points, the means of those of three graphs.

        Parameters
        ----------
        points : (n, 3) float array

        Returns
        -------
        (n, 3) float array
            On a crease, that of one of the two sides.

        Raises
        ------
        TypeError, ValueError
            If the points are not finite, of another shape, or farther away than 1e100.
        """
        triangle, b = self._locate(points)
        near, _ = self._along_creases(triangle, b)
        normals = self._graphs.slopes(self._fan[triangle], near[:, None])
        return _unit((b[..., None] * _unit(normals)).sum(axis=1))

    def _locate(self, points: Array) -> tuple[Ints, Array]:
        """Triangles, (n,), and barycentric coordinates there, (n, 3)."""
        x = finite_array("points", points, ("n", 3))
        if (farthest := float(np.abs(x).max(initial=0))) > FAR:
            size = float(np.abs(self.vertices).max())
            raise ValueError(
                f"points must be near the surface, with coordinates up to {size:.3g}, but one has "
                f"the coordinate {farthest:.3g}"
            )
        triangle, b = self._foot(x)
        b[b < ON_EDGE] = 0
        return triangle, b / b.sum(axis=1, keepdims=True)

    def _place(self, triangle: Ints, b: Array) -> Array:
        """S, (n, 3)."""
        near, rest = self._along_creases(triangle, b)
        return near + self._step(self._fan[triangle], b, near) + rest

    def _calm(self, flat: "_Flat") -> None:
        """Go back towards the flat triangles where elements on S would fold over."""
        triangle = np.repeat(np.arange(len(self.faces)), 3)
        middles = np.tile((1 - np.eye(3)[[2, 0, 1]]) / 2, (len(self.faces), 1))
        for _ in range(HALVINGS):
            places = self._place(triangle, middles).reshape(-1, 3, 3)
            tilted = flat.tilts(places) < TILTED
            if not tilted.any():
                return
            self._trust[np.unique(self._fan[tilted])] /= 2
            sides = 3 * np.flatnonzero(tilted)[:, None] + np.arange(3)
            across = self._across[sides]
            self._room[np.unique([*sides.ravel(), *across[across >= 0]])] /= 2

    def _step(self, graph: Ints, b: Array, points: Array) -> Array:
        """sum_i b_i h_i n_i at points (n, 3), for graphs and weights (n, 2 or 3)."""
        heights = b * self._trust[graph] * self._graphs.heights(graph, points[:, None])
        return np.asarray((heights[..., None] * self._graphs.normals[graph]).sum(axis=1))

    def _along_creases(self, triangle: Ints, b: Array) -> tuple[Array, Array]:
        """Points of the triangles, moved along with creases, and what is to be added to S there.

        A crease's chord goes to its curve. The triangle goes along, by the square of the share
        that the ends of the edge have in b: 1 on this edge, 0 at the corner opposite; on the
        other two edges the crease's own end stays, and so do they. There S differs from the curve
        by O(h^4), or more if a limit is active; the rest takes that away, by the same share. The
        rim goes to its own curve in the same way, and from there to S.
        """
        near = np.einsum("nc,nci->ni", b, self._foot.corners[triangle])
        rest = np.zeros_like(near)
        for i, j in ((0, 1), (1, 2), (2, 0)):
            share = b[:, i] + b[:, j]
            side = 3 * triangle + i
            rows = np.flatnonzero((self._across[side] >= 0) & (share > 0))
            ends = b[rows][:, [i, j]] / share[rows, None]
            square = share[rows, None] ** 2
            chord, curve = self._curve(side[rows], ends)
            near[rows] += square * (curve - chord)
            rest[rows] -= square * self._step(self._fan[triangle[rows]][:, [i, j]], ends, curve)
            rows = np.flatnonzero((self._rim.number[side] >= 0) & (share > 0))
            ends = b[rows][:, [i, j]] / share[rows, None]
            off = self._in_its_room(side[rows], ends, self._rim.off(side[rows], ends[:, 1]))
            near[rows] += share[rows, None] ** 2 * off
        return near, rest

    def _curve(self, side: Ints, b: Array) -> tuple[Array, Array]:
        """Points of creases' chords with shares b, (m, 2), of their ends, and of the curves.

        Both are (m, 3). The point of the curve is the closest one on both sides' graphs, found by
        Newton's method with the mean normals of the ends on each side.
        """
        start, end = _corners(side)
        last, first = _corners(self._across[side])  # the other side runs against this one
        ends = self.vertices[np.stack([self.faces.flat[start], self.faces.flat[end]], axis=1)]
        chord = np.einsum("me,mei->mi", b, ends)
        graphs = [self._fan.flat[np.stack(c, axis=1)] for c in ((start, end), (first, last))]
        one, other = (
            _unit(np.einsum("me,mei->mi", b, self._graphs.normals[graph])) for graph in graphs
        )
        off = np.zeros_like(chord)
        for _ in range(TURNS):
            steps = [self._step(graph, b, chord + off) for graph in graphs]
            p, q = (steps[0] * one).sum(axis=1), (steps[1] * other).sum(axis=1)
            # The sum and the difference of two unit normals are at a right angle. Where a crease
            # ends inside of the surface, both sides have one normal there.
            for height, direction in ((p + q, one + other), (p - q, one - other)):
                square = np.maximum((direction * direction).sum(axis=1), PARALLEL)
                off += (height / square)[:, None] * direction
        return chord, chord + self._in_its_room(side, b, off)

    def _in_its_room(self, side: Ints, b: Array, off: Array) -> Array:
        """Steps off chords from points with shares b, (m, 2), shorter where sides lack the room."""
        far = np.linalg.norm(off, axis=1)
        allowed = 4 * b.prod(axis=1) * self._room[side]  # the whole room in the middle
        return np.asarray(np.minimum(1, allowed / np.maximum(far, 1e-300))[:, None] * off)


class _Rim(ReadOnly):
    """Cubic curves through the two ends of a side of the rim and the vertices before and after.

    Through p, a, b runs the parabola that is t (1 - t) |ab|^2 [p, a, b] off the chord ab, with the
    divided difference [p, a, b] of second order; the mean of that and the one through a, b, q, with
    weights that are linear along the rim, 1 and 0 at p, is the cubic curve through all four
    (Neville). At a corner there is the other parabola alone, or the chord.
    """

    def __init__(self, vertices: Array, sides: Sides, crease: float) -> None:
        rim = np.flatnonzero(sides.times == 1)
        self.number = np.full(len(sides.times), -1)
        self.number[rim] = np.arange(len(rim))
        start, end = sides.start[rim], sides.end[rim]
        starting, ending = np.zeros((2, len(vertices)), dtype=np.int64)
        starting[start] = ending[end] = np.arange(len(rim))
        before, after = ending[start], starting[end]

        chord = vertices[end] - vertices[start]
        length = np.linalg.norm(chord, axis=1)
        turn = _unit(chord) - _unit(chord)[before]
        bend = turn / (length + length[before])[:, None]
        corner = np.linalg.norm(turn, axis=1) > 2 * np.sin(np.radians(crease) / 2)
        bends, corners = np.stack([bend, bend[after]]), np.stack([corner, corner[after]])[..., None]
        self.bends = np.where(corners, np.where(corners[::-1], 0, bends[::-1]), bends)
        self.lengths = np.stack([length[before], length, length[after]])
        read_only(vars(self))

    def off(self, side: Ints, t: Array) -> Array:
        """From points of the chords, at shares t, (m,), of their lengths, to the curves, (m, 3)."""
        number = self.number[side]
        before, length, after = self.lengths[:, number]
        weight = ((before + t * length) / (before + length + after))[:, None]
        bend = (1 - weight) * self.bends[0, number] + weight * self.bends[1, number]
        return np.asarray(-(t * (1 - t) * length**2)[:, None] * bend)


class _Flat:
    """What is needed of flat triangles with given corners, (T, 3, 3)."""

    def __init__(self, corners: Array) -> None:
        self.corners = corners
        self.sides = np.roll(corners, -1, axis=1) - corners  # from each corner to the next
        self.normals = _unit(np.cross(self.sides[:, 0], self.sides[:, 1]))

    def turns(self, pairs: Ints) -> Array:
        """Angles between the normals of neighbours, (E,), for pairs of sides, (E, 2)."""
        one, other = self.normals[pairs.T // 3]
        sine = np.linalg.norm(np.cross(one, other), axis=1)
        return np.asarray(np.arctan2(sine, (one * other).sum(axis=1)))

    def room(self, pairs: Ints) -> Array:
        """How far the curve of a crease may be from its chord, for each side, (3T,)."""
        length = np.linalg.norm(self.sides, axis=2)
        double_area = np.linalg.norm(np.cross(self.sides[:, 0], self.sides[:, 1]), axis=1)
        room = BENT * np.minimum(length, double_area[:, None] / length).ravel()
        room[pairs] = room[pairs].min(axis=1, keepdims=True)
        return np.asarray(room)

    def mean_normals(self, fan: Ints) -> Array:
        """Unit normals of fans, (F, 3): means over the triangles, weighted by their angles."""
        angles = angles_of(self.corners)
        total = np.zeros((int(fan.max()) + 1, 3))
        np.add.at(total, fan, angles[..., None] * self.normals[:, None])
        one = np.empty_like(total)
        one[fan] = self.normals[:, None]
        no_mean = np.linalg.norm(total, axis=1) < NO_MEAN
        return _unit(np.where(no_mean[:, None], one, total))

    def trust(self, graphs: Graphs, fan: Ints) -> Array:
        """Weights of graphs, (F,): less than 1 where one turns away from triangles of its fan."""
        slopes = _unit(graphs.slopes(fan[:, :, None], self.corners[:, None]))
        cosine = np.einsum("tabi,ti->tab", slopes, self.normals).min(axis=2)
        least = np.ones(len(graphs.origin))
        np.minimum.at(least, fan, cosine)
        tilt = np.degrees(np.arccos(np.clip(least, -1, 1)))
        return np.asarray(np.clip((USELESS - tilt) / (USELESS - DOUBTED), 0, 1))

    def tilts(self, middles: Array) -> Array:
        """Cosines between triangles and their most tilted quarters, (T,).

        The quarters are those between the corners and places of the middles of the sides.
        """
        before = np.roll(middles, 1, axis=1)  # of the side that ends at a corner
        first = np.concatenate([self.corners, middles[:, :1]], axis=1)
        second = np.concatenate([middles, middles[:, 1:2]], axis=1)
        third = np.concatenate([before, middles[:, 2:]], axis=1)
        quarters = _unit(np.cross(second - first, third - first))
        cosines = np.einsum("tqi,ti->tq", quarters, self.normals)
        return np.asarray(cosines.min(axis=1))


def _corners(side: Ints) -> tuple[Ints, Ints]:
    """The corners, numbered as sides are, at which sides start and end."""
    return side, side - side % 3 + (side + 1) % 3


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
