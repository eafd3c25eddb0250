"""Better triangles in a run: the surface of a state triangulated anew, all functions taken along.

A node of the new space is a point of the old one: an element and local coordinates there. These
stay the same for all states, so that the new nodes move as the particles of the old surface did,
and what is smooth in time remains so: a run of order p goes on from p states as from its own.
"""

from collections.abc import Sequence
from typing import Any, overload

import numpy as np
import trimesh
from scipy.sparse import csr_array

from esfem_core.checks import Array, Ints, number, object_of, shown
from esfem_core.elements import SurfaceSpace
from esfem_core.laws import positions_of
from esfem_core.problems import Problem
from esfem_core.stepping.checkpoints import space_of
from esfem_core.stepping.retriangulation import Transfer, triangulated
from esfem_core.stepping.state import State, known_space
from esfem_core.surfaces import components, edges_of, smooth

__all__ = ["remeshed", "transferred"]


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
    surface; for k = 1, of the smooth one through its vertices, :func:`esfem_core.smooth`, so that a
    smooth surface does not shrink each time. Creases are not kept: edges and corners are cut off,
    and conserved functions grow by what the area loses. Positions, velocities and functions are
    interpolated, with errors O(h^{k+1}); the length of a vector field "normal" is interpolated
    apart from its direction. Where the old triangles do not resolve the surface, curved elements
    that would fold over become flat.

    Smallest angles do not tell all. Where a surface shrinks towards a tip, its particles come close
    to each other with good angles, and small errors grow to spikes: there the areas of the
    elements, compared with those at the start, say when it is time.

    Each conserved function then gets the constant, on each component of the surface, that makes
    its amount, the sum of M(x) u, what it was. Among all corrections it has the least L2 norm.
    Where a scheme keeps the sum of other products (mass="extrapolated"), that is kept as well.

    It takes as long as about a hundred steps of a run with k = 2, and as several hundred with
    k = 1, whose steps are short.

    Parameters
    ----------
    states : State or sequence of State
        Of one space, in the order of time: the last p of a run of order p. All go to the same new
        space, and their new nodes are the same particles. With one state a run of order 1 goes on.
    h : float, optional
        Length of edges; the mean of the last state's if None. Where the surface bends, edges are
        shorter: up to 0.7/√(κ₁² + κ₂²) with the principal curvatures κ, half the radius on a
        sphere, so that a larger h changes nothing there; but not below h/32 and half the shortest
        edge of the old element. From there they grow by 0.4 of the distance at most.
    problem : Problem, optional
        What is solved. Its species say which functions are conserved; if not given, those with
        products in a state are, or all functions if no state has been computed by a step.
        Needed if the problem knows positions by the initial ones, as ``Prescribed(motion=X)`` and
        exact solutions do: see below. Without it nobody sees that a species is fixed at nodes that
        are given by number, ``fixed=(nodes, values)``: these are others afterwards.

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
        If the states do not fit together, know no space, have a boundary, or lack a function of
        the problem, or the problem fixes one at nodes that are given by number. If h is
        not positive, or so small that there were more than a million triangles, or so large that
        the surface could not have the topology it has: a component has no room for twenty
        triangles, or turns by more than 60 degrees within one, or two sides are so near each other
        that new triangles cross over. If the new triangles are not fit on
        the initial surface, where that counts. If a node has no normal, or a vector field "normal"
        points inwards.
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
    if len(space.boundary_nodes):
        raise ValueError(
            "states must be on a closed surface, but theirs has a boundary of "
            f"{len(space.boundary_nodes)} nodes: new triangles would not keep that"
        )
    if problem is not None:
        object_of("problem", problem, Problem, "or None")
    conserved = _conserved(given, problem)
    _check_fixed(problem)
    x = given[-1].x
    if h is None:
        h = float(edges_of(space.cells[:, :3]).lengths(x).mean())
    h = number("h", h, above=0)
    normal = given[-1].fields.get("normal")
    if normal is not None and normal.shape != x.shape:
        normal = None  # a function that is called so, and no vector field
    transfer = triangulated(space, x, h, normal)
    result = transferred(given, transfer, conserved, problem)
    return result[0] if single else result


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
    nodes = _placed(old, old.nodes if from_start else states[-1].x, P)
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
    old, P = known_space(state), transfer.interpolation
    x = _placed(old, state.x, P)
    law: Any = None if problem is None else problem.law
    if hasattr(law, "position"):
        x = positions_of(law, space.nodes, state.t, (state.t, x))
    component = components(old.cells[:, :3])
    before = np.empty(len(old.nodes), dtype=np.int64)
    before[old.cells] = component[:, None]
    after = component[transfer.cell]
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


def _placed(old: SurfaceSpace, x: Array, P: csr_array) -> Array:
    """Positions of the new nodes for positions x of the old ones.

    On flat triangles they would lie below the surface that these stand for, by O(h^2) and each
    time anew. They go to the smooth surface through the vertices, which is O(h^4) from it.
    """
    y = np.asarray(P @ x)
    if old.degree > 1:
        return y
    return smooth(trimesh.Trimesh(x, old.cells, process=False))(y)


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


def _check_fixed(problem: Problem | None) -> None:
    """Refuse values at nodes that are given by number: the new nodes have other numbers."""
    for name, species in ({} if problem is None else problem.all_species).items():
        if species.fixed is not None and species.fixed.where is not None:
            raise ValueError(
                f"problem must not fix {name!r} at nodes that are given by their numbers, which "
                "mean other nodes afterwards: remeshed(states, h, ...) for a problem without that, "
                "then Species(fixed=(nodes, values)) with nodes of states[-1].space"
            )


def _knows_paths(problem: Problem) -> bool:
    """Whether positions are known by the initial ones."""
    law = problem.law
    return problem.exact is not None or (
        hasattr(law, "position") and getattr(law, "motion", law) is not None
    )
