"""Better triangles in a run: the surface of a state triangulated anew, all functions taken along.

A node of the new space is a point of the old one: an element and local coordinates there. These
stay the same for all states, so that the new nodes move as the particles of the old surface did,
and what is smooth in time remains so: a run of order p goes on from p states as from its own.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple, overload

import numpy as np
import trimesh
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from esfem_core.checks import Array, Ints, number, shown
from esfem_core.elements import (
    Surface,
    SurfaceSpace,
    TangentPlanes,
    closest_points,
    nodal_average,
    tabulate,
)
from esfem_core.problems import Problem
from esfem_core.stepping.checkpoints import space_of
from esfem_core.stepping.state import State
from esfem_core.surfaces import Evened, Guide, MeshingError, edges_of, evened, resized

__all__ = ["Transfer", "remeshed", "transferred", "triangulated"]

FEWEST = 20  # triangles that a component must have room for, as many as an icosahedron has
MOST = 10**6  # triangles
SPACING = 0.25  # of the points that stand for the old surface, over h
ROUNDS = 15
FINEST, RADII, SLOPE = 1 / 8, 0.7, 0.4  # of lengths of edges, see _share
LEAST_ANGLE = 15.0  # degrees: what is worse is no help
MAX_TURN, SLACK, LAST_TURN = 60.0, 15.0, 120.0  # degrees between old and new normals


@overload
def remeshed(states: State, h: float | None = None, problem: Problem | None = None) -> State: ...
@overload
def remeshed(
    states: Sequence[State], h: float | None = None, problem: Problem | None = None
) -> list[State]: ...
def remeshed(
    states: State | Sequence[State], h: float | None = None, problem: Problem | None = None
) -> State | list[State]:
    r"""States on better triangles, to go on with.

    The surface of the last state is triangulated anew, with edges of about the length h and, where
    the surface lets it, angles above 30 degrees: triangles are split and collapsed, edges flipped,
    vertices relaxed. All new nodes, of elements of the same degree k, are points of the old curved
    surface. Positions, velocities and functions are interpolated there, with errors O(h^{k+1}); the
    length of a vector field "normal" is interpolated apart from its direction.

    Each conserved function then gets the constant, on each component of the surface, that makes
    its amount, the sum of M(x) u, what it was. Among all corrections it has the least L2 norm.
    Where a scheme keeps the sum of other products (mass="extrapolated"), that is kept as well.

    Parameters
    ----------
    states : State or sequence of State
        Of one space, in the order of time: the last p of a run of order p. All go to the same new
        space, and their new nodes are the same particles. With one state a run of order 1 goes on.
    h : float, optional
        Length of edges; the mean of the last state's if None.
    problem : Problem, optional
        What is solved. Its species say which functions are conserved; if not given, those with
        products in a state are, or all functions if no state has been computed by a step.
        Needed if the problem knows positions by the initial ones, as ``Prescribed(motion=X)`` and
        exact solutions do: see below.

    Returns
    -------
    State or list of State
        Of a new space. Its nodes are the positions of the last state: slips and other forces that
        remember the initial surface start anew from there. For a problem with a motion or an exact
        solution they are the initial positions of the same particles, to an error of
        O(h^{k+1}), and positions of a motion X(p, t) are then those of X.

    Raises
    ------
    TypeError, ValueError
        If the states do not fit together, know no space, or lack a function of the problem. If h is
        not positive, or so large that the surface could not have the topology it has: a component
        has no room for twenty triangles, or turns by more than 60 degrees within one. If the new
        triangles are not fit on the initial surface, where that counts.
    MeshingError
        If some angle remains below 15 degrees.

    Examples
    --------
    An ellipsoid that has been stretched; the integral of u remains what it is:

    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), 2, ec.to_unit_sphere)
    >>> stretching = ec.laws.Prescribed(velocity=lambda x, t: x * [1, 0, 0])
    >>> problem = ec.Problem(species={"u": ec.Species(lambda x: 1 + x[:, 2])}, law=stretching)
    >>> states = list(ec.evolve(space, problem, order=2, step=0.1, end=1.0))
    >>> states = ec.remeshed(states[-2:], h=0.4)
    >>> *_, last = ec.evolve(states[-1].space, problem, 2, 0.1, end=1.2, start=states)
    >>> first = ec.measure(states[-1])
    >>> first.min_angle > 30, bool(abs(ec.measure(last).amount / first.amount - 1) < 1e-9)
    (True, True)
    """
    single = isinstance(states, State)
    if not single and not isinstance(states, Sequence):
        raise TypeError(f"states must be a State or a sequence of them, got {shown(states)}")
    given: list[State] = [states] if isinstance(states, State) else list(states)
    space = space_of(given)
    if problem is not None and not isinstance(problem, Problem):
        raise TypeError(f"problem must be a Problem, got {shown(problem)}")
    conserved = _conserved(given, problem)
    x = given[-1].x
    if h is None:
        edges = edges_of(_faces(space))
        h = float(edges.lengths(x).mean())
    h = number("h", h, above=0)
    transfer = triangulated(space, x, h)
    result = transferred(given, transfer, conserved, problem)
    return result[0] if single else result


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


def transferred(
    states: Sequence[State],
    transfer: Transfer,
    conserved: Sequence[str],
    problem: Problem | None = None,
) -> list[State]:
    """States on new nodes, all on the same.

    Parameters
    ----------
    states : sequence of State
        Of one space.
    transfer : Transfer
    conserved : sequence of str
        Names of functions whose amounts are kept.
    problem : Problem, optional
        See :func:`remeshed`.

    Returns
    -------
    list of State

    Raises
    ------
    ValueError
        If the new triangles are not fit.
    """
    old = space_of(states)
    P = transfer.interpolation
    from_start = problem is not None and _knows_paths(problem)
    nodes = P @ (old.nodes if from_start else states[-1].x)
    try:
        space = SurfaceSpace.from_nodes(nodes, transfer.cells, old.rule.exactness)
    except ValueError as error:
        if not from_start:
            raise
        raise ValueError(
            "the problem knows positions by the initial ones, but there the new triangles are "
            f"not fit ({error}); Prescribed(velocity=v), or a problem without exact solution, "
            "needs no initial surface"
        ) from error
    return [_on(space, state, transfer, conserved, problem) for state in states]


def _on(
    space: SurfaceSpace,
    state: State,
    transfer: Transfer,
    conserved: Sequence[str],
    problem: Problem | None,
) -> State:
    """One state on the new space."""
    old, P = state.space, transfer.interpolation
    assert old is not None
    x = P @ state.x
    law: Any = None if problem is None else problem.law
    if hasattr(law, "position"):
        x = law.position(space.nodes, state.t, (state.t, x))
    before = _components(old)
    after = before[old.cells[transfer.cell, 0]]
    M = space.mass(x)
    fields, products = {}, {}
    for name, w in state.fields.items():
        fields[name] = _interpolated(name, w, P)
        if name not in conserved:
            continue
        amounts = _sums(old.mass_times(state.x, w), before)
        fields[name] = _with_amounts(fields[name], amounts, M, after)
        if name in state.products:
            kept = _sums(state.products[name], before)
            products[name] = _with_sums(M @ fields[name], kept, M, after)
    v = None if state.v is None else P @ state.v
    return State(state.t, x, v, space=space, fields=fields, products=products, method=state.method)


def _interpolated(name: str, w: Array, P: csr_array) -> Array:
    """Values at the new nodes; a normal is not shortened by the mean of several directions."""
    new = np.asarray(P @ w.reshape(len(w), -1)).reshape(-1, *w.shape[1:])
    if name == "normal" and w.shape[1:] == (3,):
        length = P @ np.linalg.norm(w, axis=1)
        new *= (length / np.linalg.norm(new, axis=1))[:, None]
    return new


def _with_amounts(w: Array, amounts: Array, M: csr_array, component: Ints) -> Array:
    """Values with another constant on each component, so that 1'M w is as wanted."""
    size = _sums(M @ np.ones(len(w)), component)
    for _ in range(2):  # the second time for rounding
        missing = (amounts - _sums(M @ w, component)).T / size
        w = w + missing.T[component]
    return w


def _with_sums(b: Array, sums: Array, M: csr_array, component: Ints) -> Array:
    """Products with M and a constant on each component, so that 1'b is as wanted."""
    one = M @ np.ones(len(b))
    missing = (sums - _sums(b, component)).T / _sums(one, component)
    corrected: Array = b + (missing[..., component] * one).T
    return corrected


def _sums(b: Array, component: Ints) -> Array:
    """Sums of nodal entries (N, ...) over each component, (C, ...)."""
    total = np.zeros((component.max() + 1, *b.shape[1:]))
    for i in range(len(total)):
        total[i] = b[component == i].sum(axis=0)
    return total


def _components(space: SurfaceSpace) -> Ints:
    """Which component of the surface each node belongs to, (N,)."""
    labels = connected_components(space.pattern, directed=False)[1]
    return np.asarray(labels, dtype=np.int64)


def _conserved(states: Sequence[State], problem: Problem | None) -> list[str]:
    """Names of the functions whose amounts are to be kept."""
    present = states[-1].fields
    if problem is not None:
        missing = [name for name in problem.all_species if name not in present]
        if missing:
            known = ", ".join(map(repr, present)) or "none"
            raise ValueError(
                f"states must have the functions of the problem, but {missing[0]!r} is missing; "
                f"they have {known}"
            )
        return [name for name, species in problem.all_species.items() if species.conserved]
    if all(state.method is None for state in states):
        return list(present)
    return [name for name in present if any(name in state.products for state in states)]


def _knows_paths(problem: Problem) -> bool:
    """Whether positions are known by the initial ones."""
    law = problem.law
    return problem.exact is not None or (
        hasattr(law, "position") and getattr(law, "motion", law) is not None
    )


def triangulated(space: SurfaceSpace, x: Array, h: float) -> Transfer:
    """Triangulate Γ_h[x] anew."""
    at = Surface(space, x)
    _check_room(at, h)
    share = _share(at, h)
    planes = TangentPlanes(at, SPACING * h * share[space.cells].min(axis=1))
    guide = Guide(planes.distance, planes.normal, planes.near, partial(planes.values, share))
    vertices, faces = x[_corners(space)], _faces(space)
    turn = _allowed_turn(at, planes.nodal)
    found = evened(*resized(vertices, faces, guide, h), guide, h, ROUNDS, turn)
    transfer = _transfer(space, x, planes.nodal, found, h, turn)
    if found.quality.min_angle < LEAST_ANGLE:
        raise MeshingError(
            f"after {ROUNDS} rounds the smallest angle is {found.quality.min_angle:.1f} degrees "
            f"(allowed: {LEAST_ANGLE:g}); a smaller h than {h:g} may help"
        )
    return transfer


def _share(at: Surface, h: float) -> Array:
    """Wanted lengths of edges over h at the nodes, (N,).

    They are 1, or less where the surface bends: `RADII` radii of curvature, but at least `FINEST` h
    and half the shortest edge of the old element, which says how well the surface is known. From
    there they grow with a slope of at most `SLOPE`.
    """
    space = at.space
    normal = nodal_average(at, at.normal)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    bending = np.linalg.norm(space.gradient(at.x, normal), axis=(2, 3)).max(axis=1)
    lengths = np.full(len(at.x), h)
    corners = at.x[space.cells[:, :3]]
    own = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).min(axis=1)
    least = np.clip(own / 2, FINEST * h, h)
    wanted = np.clip(RADII / np.maximum(bending, 1e-300), least, h)
    np.minimum.at(lengths, space.cells, wanted[:, None])

    # Paths over edges between nodes, from a point that is as far away from each as its length.
    i, j = space.pattern.nonzero()
    n, away = len(lengths), SLOPE * np.linalg.norm(at.x[i] - at.x[j], axis=1)
    graph = coo_array(
        (np.r_[away, lengths], (np.r_[i, np.full(n, n)], np.r_[j, np.arange(n)])), (n + 1, n + 1)
    )
    graded = np.asarray(dijkstra(graph.tocsr(), indices=[n]))[0, :n]
    return np.asarray(graded / h)


def _allowed_turn(at: Surface, normal: Array) -> float:
    """Cosine of 60 degrees, or of more where the surface turns by more within old elements."""
    cells = at.space.cells[:, :3]
    cosine = np.einsum("ti,tai->ta", _planes(at.x[cells]), normal[cells]).min()
    found = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return float(np.cos(np.radians(np.clip(found + SLACK, MAX_TURN, LAST_TURN))))


def _planes(corners: Array) -> Array:
    """Unit normals of triangles (T, 3, 3)."""
    n = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(n / np.linalg.norm(n, axis=1, keepdims=True))


def _transfer(
    space: SurfaceSpace, x: Array, normal: Array, found: Evened, h: float, turn: float
) -> Transfer:
    """Give new triangles nodes on the old surface, and check that they follow it."""
    vertices = closest_points(space, x, found.vertices).points
    flat = SurfaceSpace(trimesh.Trimesh(vertices, found.faces, process=False), space.degree)
    at = closest_points(space, x, flat.nodes)
    values = tabulate(space.degree, at.local).values
    rows = np.arange(0, values.size + 1, values.shape[1])
    shape = len(flat.nodes), len(space.nodes)
    P = csr_array((values.ravel(), space.cells[at.cell].ravel(), rows), shape)

    corners = vertices[found.faces]
    plane = _planes(corners)
    n: Array = np.asarray(P @ normal)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    cosine = np.einsum("ti,tai->ta", plane, n[flat.cells])
    curved = Surface(flat, np.asarray(P @ x)).normal
    cosine = np.hstack([cosine, np.einsum("ti,tqi->tq", plane, curved)]).min(axis=1)
    worst = int(np.argmin(cosine))
    component = _components(space)[space.cells[at.cell, 0]]
    torn = (component[flat.cells] != component[flat.cells[:, :1]]).any(axis=1)
    if torn.any() or not cosine[worst] > turn:
        worst = int(np.argmax(torn)) if torn.any() else worst
        place = corners[worst].mean(axis=0).round(3).tolist()
        raise ValueError(
            f"h = {h:g} is too large for this surface: a triangle near {place} does not follow it"
        )
    return Transfer(flat.cells, at.cell, P)


def _check_room(at: Surface, h: float) -> None:
    """Refuse a length that leaves a component too few triangles, or would make too many."""
    component = _components(at.space)[at.space.cells[:, 0]]
    areas = np.bincount(component, at.density @ at.space.rule.weights)
    triangle = np.sqrt(3) / 4
    limit = float(np.sqrt(areas.min() / (FEWEST * triangle)))
    if h > limit:
        which = "the surface" if len(areas) == 1 else "the smallest component"
        raise ValueError(
            f"h must be at most {limit:.3g}, so that {which}, of area {areas.min():.3g}, has room "
            f"for {FEWEST} triangles, got {h:g}"
        )
    expected = float(areas.sum()) / (triangle * h**2)
    if expected > MOST:
        least = float(np.sqrt(areas.sum() / (MOST * triangle)))
        raise ValueError(
            f"h must be at least {least:.3g}, so that there are at most {MOST} triangles, got {h:g}"
        )


def _corners(space: SurfaceSpace) -> Ints:
    """Numbers of the nodes that are corners of elements."""
    return np.unique(space.cells[:, :3])


def _faces(space: SurfaceSpace) -> Ints:
    """Triangles between these, (T, 3)."""
    faces = np.searchsorted(_corners(space), space.cells[:, :3])
    return np.asarray(faces, dtype=np.int64)
