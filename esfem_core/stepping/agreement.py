"""Whether motion, exact solution and slip belong to the surface that a run starts on."""

import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from esfem_core.checks import Array, finite_array, level_outside, real_array
from esfem_core.elements import Surface, SurfaceSpace, nodal_average
from esfem_core.laws import (
    Elastic,
    MeanCurvature,
    Prescribed,
    check_no_slip,
    check_normal_and_curvature,
    positions_of,
)
from esfem_core.problems import Exact, Problem
from esfem_core.stepping.guard import EvolutionWarning
from esfem_core.stepping.state import Method, State
from esfem_core.stepping.times import TOLERANCE
from esfem_core.surfaces import components, volumes

__all__ = [
    "check_exact",
    "check_exact_functions",
    "check_exact_surface",
    "check_motion_of_start",
    "check_normal_of_start",
    "check_on_exact_surface",
    "check_precision",
    "check_slip",
    "check_start_of_motion",
    "check_starts",
    "check_step_of_start",
    "innermost",
]

AT_START = 1e-8  # how far, relative to the size of the surface, X(p, 0) may be from p
LATER = 1e-6  # how far, likewise, exact values may be from a prescribed motion, or initial ones
SINGLE = 1e-6  # relative to the largest coordinate: single precision rounds by less
OFF_SURFACE = 0.5  # how far, relative to h, nodes may be from the exact surface
NEW_TRIANGLES = (
    "; new triangles know the initial surface by remeshed(states, h, problem), and "
    "Prescribed(velocity=v) goes on from where nodes are"
)
NOT_ON_IT = (
    "; SurfaceSpace(tri, degree, project) puts nodes on a surface, and new triangles know the "
    "initial one by remeshed(states, h, problem)"
)
SPEED = 1e-3  # how far, relative to the largest, exact velocities may be from d/dt exact.x
LOOKED_AT = (0.382, 0.618)  # shares of a run: a kink or a turning point is hardly at both
WITHIN = (1 / 8, 1 / 1000)  # of a step, to both sides: little rounding, or motions that are fast
NORMAL = 0.2  # share of a slip that may be normal: nodal normals of a coarse mesh are not exact
OWN_MASS = 1e-10  # how far, relatively, products M w may be from those with the state's own M
AT_REST = 1e-8  # slip of a component, relative to that of the surface, that may be rounding


def check_start_of_motion(space: SurfaceSpace, law: object) -> None:
    """Refuse a motion that is not at the nodes for t = 0.

    Raises
    ------
    ValueError
    """
    try:
        x = positions_of(law, space.nodes, 0.0, (0.0, space.nodes))
    except FloatingPointError as error:
        raise ValueError(
            f"motion must start on the surface, X(p, 0) = p, but {error}; a velocity "
            "goes into laws.Prescribed(velocity=v)"
        ) from error
    node, distance = _farthest(x, space.nodes, space.nodes)
    rounding = SINGLE * np.abs(space.nodes).max()
    is_single = np.abs(x - space.nodes).max() < rounding and np.array_equal(x, x.astype(np.float32))
    if distance > AT_START and is_single:
        raise ValueError(
            f"motion must start on the surface, X(p, 0) = p, but is off by {distance:.1g} of its "
            "size, by the rounding of single precision: compute it in double"
        )
    if not distance <= AT_START:
        raise ValueError(
            "motion must start on the surface, X(p, 0) = p, but X(p, 0) = "
            f"{x[node].tolist()} for the node p = {space.nodes[node].tolist()}; a velocity "
            f"goes into laws.Prescribed(velocity=v){NEW_TRIANGLES}"
        )


def innermost(law: object) -> object:
    """The law inside others, such as one at constant volume or with a slip.

    Examples
    --------
    >>> import esfem_core as ec
    >>> innermost(ec.laws.with_slip(ec.laws.VolumePreserving(ec.laws.Regularised()), "elastic"))
    Regularised(alpha=1.0, beta=1.0, g=None)
    """
    while hasattr(law, "law"):
        law = law.law
    return law


def check_precision(space: SurfaceSpace, law: object, first: State, step: float) -> None:
    """Refuse a motion in single precision, and a velocity field: no step is small enough for that.

    Raises
    ------
    TypeError
        Also if a velocity field returns no array of real numbers.
    ValueError
        If that has another shape.
    """
    if not isinstance(law, Prescribed):
        return
    if law.field is None:
        assert law.motion is not None
        _check_double("motion(p, t)", law.motion, space.nodes, (first.t, first.x), step)
        return
    with np.errstate(all="ignore"):  # what is not finite is refused when it is integrated
        given = law.field(first.x.copy(), first.t)
        real_array("velocity(x, t)", given, first.x.shape)
        v = np.asarray(given)  # as it is given
    if v.dtype in (np.float16, np.float32) and v.ndim == 2 and np.ptp(v, axis=0).any():
        raise TypeError(
            f"velocity(x, t) must be in double precision, got {v.dtype}: as its flow is integrated "
            "to 1e-12, the rounding of single precision makes it a field that is not smooth"
        )


def _check_double(
    name: str,
    motion: Callable[[Array, float], ArrayLike],
    nodes: Array,
    before: tuple[float, Array],
    step: float,
) -> None:
    """Refuse positions in single precision, also if they have been converted since.

    On the vertices of a file in single precision they may be right at the start, and only there.
    Numbers that move are all rounded so within a step, at a share of it that is no round number,
    if they are in single precision, and hardly else. What is not defined is refused elsewhere.
    """
    start, x = before
    with np.errstate(all="ignore"), suppress(ArithmeticError, ValueError):
        given = motion(nodes.copy(), start + LOOKED_AT[0] * step)
        moved = finite_array(name, given, nodes.shape)
        rounded = np.array_equal(moved, moved.astype(np.float32)) and not np.array_equal(moved, x)
        if rounded or np.asarray(given).dtype in (np.float16, np.float32):
            raise TypeError(
                f"{name} must be in double precision, but has the rounding of single: velocities, "
                "its differences over a step, would be off by 1e-7 of the positions over the step; "
                "compute it in double"
            )


def check_motion_of_start(space: SurfaceSpace, problem: Problem, last: State) -> None:
    """Refuse states whose nodes are not where a prescribed motion has them.

    Raises
    ------
    ValueError
    """
    law: object = problem.law
    if not hasattr(law, "position"):
        return
    x = positions_of(law, space.nodes, last.t, (last.t, last.x))
    node, distance = _farthest(x, last.x, last.x)
    if not distance <= AT_START:
        raise ValueError(
            f"start must hold states of this motion, but node {node} is at "
            f"{last.x[node].tolist()}, while X(p, t) = {x[node].tolist()} at t = {last.t:g}"
            f"{NEW_TRIANGLES}"
        )


def check_normal_of_start(space: SurfaceSpace, law: object, last: State) -> None:
    """Refuse a state for mean curvature flow with a normal or curvature of another surface.

    Those that a step has computed may be far off shortly before a singularity, where an
    uninterrupted run goes on as well.

    Raises
    ------
    ValueError
    """
    if last.method is None and isinstance(innermost(law), MeanCurvature):
        with suppress(ArithmeticError):  # degenerate elements are left to the step
            check_normal_and_curvature(Surface(space, last.x, last.fields, last.t), "start[-1]")


def check_starts(
    space: SurfaceSpace, problem: Problem, start: str | Sequence[State], order: int, step: float
) -> None:
    """Refuse starting states of which a closed component is inside out against the space.

    A run looks at what happens from its last starting state on only.

    Parameters
    ----------
    space : SurfaceSpace
    problem : Problem
    start : "exact", "euler" or sequence of State
        For "exact" with an exact solution. Euler steps are looked at when they are made.
    order : int
    step : float

    Raises
    ------
    ValueError
    """
    at: list[tuple[str, Array]] = []
    if not isinstance(start, str):
        at = [(f"start[{i - len(start)}]", state.x) for i, state in enumerate(start)]
    elif start == "exact" and problem.exact is not None:
        nodes = space.nodes
        # What is no number there is refused when the states are made.
        with np.errstate(all="ignore"), suppress(ArithmeticError, ValueError):
            for t in (n * step for n in range(1, order)):
                x = finite_array("exact.x", problem.exact.x(nodes.copy(), t), nodes.shape)
                at.append((f"exact.x(p, t) at t = {t:g}", x))
    if not at:
        return
    component = components(space.cells[:, :3])
    at_boundary = np.isin(space.cells[:, :3], space.boundary_nodes).any(axis=1)
    is_open = np.isin(np.arange(component.max() + 1), component[at_boundary])
    before = volumes(space.nodes, space.cells[:, :3], component)
    for name, x in at:
        volume = volumes(x, space.cells[:, :3], component)
        turned = (volume * before < 0) & ~is_open
        if turned.any():
            i = int(np.argmax(turned))
            which = f"component {i} of the surface" if len(volume) > 1 else "the surface"
            raise ValueError(
                f"{name} must be oriented as the nodes of the space are, but {which} is inside out "
                f"there: it encloses a volume of {volume[i]:.3g}, with the nodes of the space "
                f"{before[i]:.3g}"
            )


def check_step_of_start(space: SurfaceSpace, start: Sequence[State], method: Method) -> None:
    """Refuse a step that differs from that of the states by rounding, if that loses their history.

    Products M(x~) w belong to a step and are not taken for another one. If that is another one but
    for rounding, nobody wants M(x) w in their place, with other amounts.

    Parameters
    ----------
    space : SurfaceSpace
    start : sequence of State
        With the functions of the problem.
    method : (str, int, float)
        Of the run: mass, order and step.

    Raises
    ------
    ValueError
    """
    *scheme, step = method
    for state in start:
        *own_scheme, own = state.method or method
        if own_scheme != scheme or own == step or abs(own - step) > TOLERANCE * step:
            continue
        for name, kept in state.products.items():
            without = space.mass_times(state.x, state[name])
            if np.abs(kept - without).max() > OWN_MASS * np.abs(kept).max():
                raise ValueError(
                    f"step must be that of the states in start to the last bit, step={own!r}, got "
                    f"{step!r}: the amounts of {name!r} that they keep, M(x~) {name}, belong to "
                    "that step, and another one, even by rounding, does without them"
                )


def check_exact(space: SurfaceSpace, problem: Problem, t: float, end: float) -> None:
    """Refuse an exact solution of another surface or motion, or with another velocity than its own.

    Parameters
    ----------
    space : SurfaceSpace
    problem : Problem
        With an exact solution.
    t : float
        When to compare it with a prescribed motion: after the first step.
    end : float
        Of the run, within which its velocity is compared with its positions.

    Raises
    ------
    TypeError
        If its positions are in single precision.
    ValueError
    """
    exact, nodes = problem.exact, space.nodes
    assert exact is not None
    _check_double("exact.x(p, t)", exact.x, nodes, (0.0, nodes), t)
    check_exact_surface(space, problem)
    if hasattr(problem.law, "position"):
        x = positions_of(problem.law, nodes, t, (0.0, nodes))
        wanted = finite_array("exact.x", exact.x(nodes.copy(), t), nodes.shape)
        node, distance = _farthest(wanted, x, nodes)
        if not distance <= LATER:
            raise ValueError(
                f"exact must belong to the motion, but at t = {t:g} exact.x(p, t) = "
                f"{wanted[node].tolist()} and the motion has {x[node].tolist()} for the node p = "
                f"{nodes[node].tolist()}"
            )
    _check_exact_velocity(exact, nodes, t, end)


def _check_exact_velocity(exact: Exact, nodes: Array, step: float, end: float) -> None:
    """Refuse an exact velocity that is nowhere near the difference quotients of the positions.

    One time at which nodes move as v says is enough, since at another the motion may have a kink.
    Where `exact` is not defined, after a surface has vanished, nothing is compared.

    Raises
    ------
    ValueError
    """
    size = float(np.abs(nodes - nodes.mean(axis=0)).max())
    rounding = 1e-14 * float(np.abs(nodes).max())
    found = {}
    for t, d in product((share * end for share in LOOKED_AT if end > 0), WITHIN):
        with np.errstate(all="ignore"), suppress(ArithmeticError, ValueError):
            before, after = t - d * step, t + d * step
            v, x, y = (
                finite_array(f"exact.{name}", getattr(exact, name)(nodes.copy(), s), nodes.shape)
                for name, s in (("v", t), ("x", before), ("x", after))
            )
            rate = (y - x) / (after - before)
            off = np.linalg.norm(v - rate, axis=1)
            speed = max(np.linalg.norm(w, axis=1).max() for w in (v, rate))
            least = LATER * size / end + rounding / (d * step)
            node = int(np.argmax(off))
            if off[node] > SPEED * speed + least:
                found[t] = nodes[node].tolist(), v[node].tolist(), rate[node].tolist()
            elif speed > least:
                return
            else:
                found.pop(t, None)
    if found:
        t, (p, given, wanted) = next(iter(found.items()))
        raise ValueError(
            f"exact.v must be the velocity d/dt exact.x(p, t), but at t = {t:.3g} exact.v(p, t) = "
            f"{given} and exact.x moves with {wanted} for the node p = {p}: like exact.x, "
            "v(p, t) is given points p of the initial surface, not where they are at t"
        )


def check_exact_surface(space: SurfaceSpace, problem: Problem) -> None:
    """Refuse an exact solution of another surface than that of the nodes.

    Parameters
    ----------
    space : SurfaceSpace
    problem : Problem
        With an exact solution.

    Raises
    ------
    ValueError
    """
    exact = problem.exact
    assert exact is not None
    nodes = space.nodes
    x = finite_array("exact.x", exact.x(nodes.copy(), 0.0), nodes.shape)
    node, distance = _farthest(x, nodes, nodes)
    if not distance <= LATER:
        raise ValueError(
            "exact must belong to this surface, X(p, 0) = p, but exact.x(p, 0) = "
            f"{x[node].tolist()} for the node p = {nodes[node].tolist()}{NOT_ON_IT}"
        )
    check_on_exact_surface(space, problem, nodes, 0.0)


def check_on_exact_surface(space: SurfaceSpace, problem: Problem, x: Array, t: float) -> None:
    """Refuse positions of nodes off the exact surface at t, where closest points tell.

    Parameters
    ----------
    space : SurfaceSpace
    problem : Problem
        With an exact solution.
    x : (N, 3) float array
    t : float

    Raises
    ------
    ValueError
    """
    assert problem.exact is not None
    if problem.exact.closest is None:
        return
    y = finite_array("exact.closest", problem.exact.closest(x.copy(), t), x.shape)
    off = np.linalg.norm(y - x, axis=1)
    node, h = int(np.argmax(off)), space.mesh_size(x)
    if not off[node] <= OFF_SURFACE * h:
        raise ValueError(
            f"exact must belong to this surface, but the node {x[node].tolist()} has a distance of "
            f"{off[node]:.3g} from the exact surface at t = {t:g}, with triangles of h = {h:.3g}"
            f"{NOT_ON_IT}"
        )


def check_exact_functions(space: SurfaceSpace, problem: Problem, first: State) -> None:
    """Refuse exact values that are not the initial values, which they stand for.

    Parameters
    ----------
    space : SurfaceSpace
    problem : Problem
        With an exact solution of all its functions, for nodes that do not slip.
    first : State
        With the initial values.

    Raises
    ------
    ValueError
    """
    assert problem.exact is not None
    check_no_slip(problem.law, 'exact values are those of nodes without: start="euler"')
    values = problem.exact.nodal(space.nodes, 0.0)[2]
    for name, w in first.fields.items():
        if values[name].shape != w.shape:
            raise ValueError(
                f"exact.{name} must have the shape {w.shape} of the initial values of {name!r}, "
                f"got {values[name].shape}"
            )
        if problem.all_species[name].initial is None:
            continue  # made by the law, from the mesh
        off = np.abs(values[name] - w)
        if not off.max() <= LATER * np.abs(w).max():
            node = int(np.argmax(off)) // w[0].size
            raise ValueError(
                f"exact.{name} must have the initial values of {name!r} at t = 0, but at the node "
                f"{space.nodes[node].tolist()} it is {values[name][node].tolist()} and they are "
                f'{w[node].tolist()}: start="euler" begins with these'
            )


def check_slip(space: SurfaceSpace, law: object, first: State, order: int, step: float) -> None:
    """Look at the slip of a law on the surface that a run starts from.

    Raises
    ------
    TypeError, ValueError
        If it is not finite or has the wrong shape.

    Warns
    -----
    EvolutionWarning
        If a good part of it is normal on a component, or the step too long for it.
    """
    if not hasattr(law, "slip"):
        return
    given = getattr(law, "w", None)
    if isinstance(given, Elastic) and step > (most := given.largest_step(order)):
        warnings.warn(
            f"the step must be below {most:.3g} with the slip {given!r}, which is explicit, for "
            f"order {order}, got {step:g}: with more, nodes run away; a smaller rate allows longer "
            "steps",
            EvolutionWarning,
            stacklevel=level_outside(),
        )
    at = Surface(space, first.x, first.fields, first.t)
    w = law.slip(at)
    if w is None:
        return
    w = finite_array("the slip w(at)", w, at.x.shape)
    w = w / (np.abs(w).max() or 1.0)  # its squares are finite
    normal = nodal_average(at, at.normal)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    share, where = _largest_share((w * normal).sum(axis=1), np.linalg.norm(w, axis=1), space)
    if share > NORMAL and isinstance(given, Elastic):
        warnings.warn(
            f"of the slip {given!r} at the start {share:.0%}{where} is normal to the mesh: its "
            "nodes run away, since the step is too long for this slip, or the normal that the law "
            "evolves is far from that of the mesh; start before that, with a smaller step or rate",
            EvolutionWarning,
            stacklevel=level_outside(),
        )
    elif share > NORMAL:
        warnings.warn(
            f"the slip w must be tangential, but {share:.0%} of it{where} is normal: it moves the "
            "surface and not only its nodes; w - (w . nu) nu leaves the tangential part, with "
            "normals nu at the nodes from esfem_core.elements.nodal_average(at, at.normal), each "
            "divided by its length",
            EvolutionWarning,
            stacklevel=level_outside(),
        )


def _largest_share(part: Array, whole: Array, space: SurfaceSpace) -> tuple[float, str]:
    """What a part of nodal values is of the whole, on the component where it is most; and where."""
    component = np.empty(len(whole), dtype=int)
    component[space.cells] = components(space.cells[:, :3])[:, None]
    parts, wholes = (np.sqrt(np.bincount(component, w**2)) for w in (part, whole))
    shares = parts / np.maximum(wholes, AT_REST * np.linalg.norm(whole) or 1.0)
    i = int(np.argmax(shares))
    return float(shares[i]), f" on component {i} of the surface" if len(shares) > 1 else ""


def _farthest(x: Array, y: Array, surface: Array) -> tuple[int, float]:
    """The node whose positions are farthest apart, and how far relative to a surface's size."""
    size = float(np.abs(surface - surface.mean(axis=0)).max())
    distance = np.linalg.norm(x - y, axis=1)
    node = int(np.argmax(distance))
    return node, float(distance[node]) / size
