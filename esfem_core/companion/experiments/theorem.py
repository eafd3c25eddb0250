"""[N] Theorem 2.1: its left-hand sides over a run, and over a grid of mesh and step sizes."""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

import esfem_core as ec
from esfem_core.errors import seminorm
from esfem_core.stepping import exact_state
from esfem_core.study import Experiment
from esfem_core.surfaces import displaced

__all__ = ["EXPERIMENTS", "Norms", "left_hand_sides", "nodal_sides"]


class Norms(NamedTuple):
    """Errors of one state that enter (2.24)-(2.26).

    Attributes
    ----------
    x, v : float
        H1 norms.
    u_l2 : float
        L2 norm.
    u_squared : float
        Square of the H1 norm.
    """

    x: float
    v: float
    u_l2: float
    u_squared: float


def left_hand_sides(
    states: Iterable[ec.State],
    norms: Callable[[ec.State], Norms],
    step: float,
    end: float,
    every: int = 1,
) -> dict[str, float]:
    """The left-hand sides of (2.24)-(2.26) over a run.

    Parameters
    ----------
    states : iterable of State
        The run, from t = 0 on; starting states do not count.
    norms : callable
        Errors of a state.
    step, end : float
        tau, and the time of the last state.
    every : int
        Look at every m-th step only, the last one included. The sum over time is then that of
        every m-th term, times m.

    Returns
    -------
    dict
        "x" and "v", the largest H1 norms; "u", the largest L2 norm plus
        (tau sum of squared H1 norms)^{1/2}.

    Examples
    --------
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    >>> run = ec.evolve(space, ec.problems.growing_sphere(), 2, 1 / 4, 1.0)
    >>> sides = left_hand_sides(run, lambda state: Norms(state.t, 0.0, 1.0, 4.0), 1 / 4, 1.0)
    >>> print("{x} {v} {u:.4f}".format(**sides))
    1.0 0.0 2.7321
    """
    x = v = u_l2 = sum_u = 0.0
    for n, state in enumerate(states):
        if state.v is None or (round(end / step) - n) % every:
            continue
        e = norms(state)
        x, v, u_l2 = max(x, e.x), max(v, e.v), max(u_l2, e.u_l2)
        sum_u += every * step * e.u_squared
    return {"x": x, "v": v, "u": u_l2 + float(np.sqrt(sum_u))}


def nodal_sides(order: int, degree: int, refinements: int, step: float) -> dict[str, float]:
    """The left-hand sides up to t = 1 for the expanding sphere of [N] 7.3, smooth coupling.

    The mesh is an icosahedron with displaced vertices; errors are those of nodal values.

    Parameters
    ----------
    order, degree, refinements : int
    step : float

    Returns
    -------
    dict
        "h" of the initial mesh, and what :func:`left_hand_sides` returns.

    Examples
    --------
    >>> sides = nodal_sides(order=2, degree=2, refinements=0, step=1 / 20)
    >>> print("{u:.0e} {v:.0e} {x:.0e}".format(**sides))
    2e+00 5e-01 2e-01
    """
    tri = displaced(ec.sphere("icosahedron", refinements), 0.2, ec.to_unit_sphere)
    space = ec.SurfaceSpace(tri, degree, ec.to_unit_sphere)
    problem = ec.problems.expanding_sphere()

    def norms(state: ec.State) -> Norms:
        exact = exact_state(space, problem, state.t)
        assert state.v is not None
        assert exact.v is not None
        M, A = space.mass_stiffness(exact.x)
        K, e_u = M + A, state.u - exact.u
        return Norms(
            x=seminorm(K, state.x - exact.x),
            v=seminorm(K, state.v - exact.v),
            u_l2=seminorm(M, e_u),
            u_squared=seminorm(K, e_u) ** 2,
        )

    run = ec.evolve(space, problem, order, step, 1.0, mass="extrapolated")
    return {"h": space.mesh_size(space.nodes), **left_hand_sides(run, norms, step, 1.0)}


EXPERIMENTS = [
    Experiment(
        name="nick_theorem",
        title="[N] Theorem 2.1: errors over a grid of mesh and step sizes",
        compute=nodal_sides,
        chains=[
            [
                {"order": order, "degree": 2, "refinements": refinements, "step": 1 / n}
                for n in (10, 20, 40, 80, 160, 320)
            ]
            for refinements in (1, 2, 3, 4)
            for order in (2, 3, 4)
        ],
    )
]
