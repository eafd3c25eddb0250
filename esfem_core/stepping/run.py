"""Runs: arguments checked, starting values made, steps taken."""

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray

from esfem_core.elements import SurfaceSpace
from esfem_core.problems import Problem
from esfem_core.solvers import DirectSolver, LaggedSolver, Solver, cholmod, multifrontal, superlu
from esfem_core.stepping.scheme import Perturbation, march
from esfem_core.stepping.start import euler_states, exact_state
from esfem_core.stepping.state import State

__all__ = ["MASSES", "evolve"]

Array = NDArray[np.float64]
MASSES = ("extrapolated", "reassembled", "updated")
"""Where the mass matrices are taken, see :func:`evolve`."""
SOLVERS = ("lagged", "cholmod", "direct")


def evolve(
    space: SurfaceSpace,
    problem: Problem,
    order: int,
    step: float,
    end: float,
    *,
    mass: str = "extrapolated",
    start: str | Sequence[State] | None = None,
    solver: str | Callable[[], Solver] = "lagged",
    allow_unstable: bool = False,
    perturbation: Perturbation | None = None,
) -> Iterator[State]:
    r"""Solve a problem on an evolving surface by surface finite elements and BDF.

    For the coupled system, [N] (2.19)-(2.21): with the extrapolations
    x~ = sum_j gamma_j x^{n-1-j} and u~ likewise::

        (1/tau) sum_j delta_j M(x~^{n-j}) u^{n-j} + A(x~^n) u^n = f(x~^n, u~^n)
        K(x~^n) v^n + beta A(x~^n) x^n = g(x~^n, u~^n),     K = M + alpha A
        (1/tau) sum_j delta_j x^{n-j} = v^n

    Each step assembles once and solves one (N, N) system for u and one for the three components
    of v. For a prescribed motion, [LMV] (3.1): the same without the last two lines, on the exact
    nodes x^n.

    Parameters
    ----------
    space : SurfaceSpace
        Its nodes are the initial positions.
    problem : Problem
    order : int
        Order p = 1..5 of the BDF method and of extrapolation. 6 is allowed with a warning: it is
        stable in practice, but no multiplier 1 - eta zeta, on which both papers' proofs rest,
        exists for it.
    step : float
        Step size tau.
    end : float
        Final time, an integer multiple of `step` (to 1e-9) of at least p - 1 steps, and not before
        the last starting state.
    mass : {"extrapolated", "reassembled", "updated"}
        Where the mass matrices are taken; no difference for a prescribed motion.
        "extrapolated": at x~^{n-j} on every level, which is (2.19), of order p.
        "reassembled": at x~^n on the newest level and at the solution x^{n-j} on the others, which
        is [N] (7.2) as printed. Its defect has the additional term
        (delta_0/tau) (M(x~^n) - M(x^n)) u^n = O(tau^{p-1}), so its order in u is p - 1, and for
        p = 1 it misses the change of the mass altogether.
        "updated": at x^n on every level, known before u^n is; of order p.
    start : {"exact", "euler"} or sequence of p states, optional
        Starting values at 0, tau, ..., (p-1) tau. "exact": nodal values of ``problem.exact``,
        the default if it is given. "euler": linearly implicit Euler steps, extrapolated to
        order p, with updated mass matrices. Otherwise the states to start from, a step apart; the
        last one's time, a multiple of the step, is where the run goes on.
        Exact values at (p - 1) tau also restart the error of space there: to compare runs with
        different steps on one mesh, start them all with "euler" or with states of the finest.
    solver : {"lagged", "cholmod", "direct"} or callable
        "lagged": conjugate gradients to a relative residual of 1e-11, preconditioned with a
        factorisation by :mod:`esfem_core.solvers.multifrontal` that is kept for many steps.
        "cholmod": the same with the factorisation of CHOLMOD (extra ``fast``). "direct": a sparse
        factorisation in every step. Otherwise a function without arguments that makes a
        :class:`esfem_core.solvers.factors.Solver`, called for each kind of system, such as
        ``partial(LaggedSolver, rtol=1e-8, factorise=partial(factorise, fronts=space.fronts))``.
    allow_unstable : bool
        Let p >= 7 run; these methods are not zero-stable.
    perturbation : callable, optional
        ``perturbation(n)`` returns nodal vectors (r_u, r_v, r_x), of the shapes of u, v and x, that
        are added to the right-hand sides of (2.19), (2.20) and (2.21) in step n: the defects of
        [N] (4.1), see :mod:`esfem_core.theory.defects`. With a prescribed motion, r_u alone counts.

    Yields
    ------
    State
        The p starting states (v is None), then one per step, at t_n = n step. Their arrays are
        never written to again.

    Raises
    ------
    ValueError
        If an argument is out of range; at the call, before anything is computed.
    ImportError
        If the solver is "cholmod" and the extra ``fast`` is not installed.
    EvolutionError
        If a run meets a value that is not finite, or an element degenerates or turns over.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 2), 2, ec.to_unit_sphere)
    >>> problem = ec.problems.growing_sphere(alpha=1, beta=1, delta=1, u0=4)
    >>> *_, last = ec.evolve(space, problem, order=3, step=1 / 20, end=1.0)
    >>> radius = np.linalg.norm(last.x, axis=1)
    >>> print(f"{radius.mean():.4f} {np.linalg.norm(problem.exact.x(space.nodes, 1.0)[0]):.4f}")
    1.4314 1.4314
    """
    _check_order(order, allow_unstable)
    n_steps = _count_steps(step, end, order)
    if mass not in MASSES:
        raise ValueError(f"mass must be one of {MASSES}, got {mass!r}")
    if not (callable(solver) or solver in SOLVERS):
        raise ValueError(
            f"solver must be one of {SOLVERS} or a function that makes one, got {solver!r}"
        )
    if solver == "cholmod" and find_spec("cholespy") is None:
        raise ImportError('solver="cholmod" needs the package cholespy: the extra "fast"')
    if start is None:
        start = "exact" if problem.exact is not None else "euler"
    if start == "exact" and problem.exact is None:
        raise ValueError('start="exact" needs a problem with an exact solution')
    if isinstance(start, str) and start not in ("exact", "euler"):
        raise ValueError(f'start must be "exact", "euler" or a sequence of states, got {start!r}')
    if not isinstance(start, str):
        _check_states(start, order, step, n_steps)
    steps = partial(march, space, problem, make_solver=_solver_factory(space, solver))
    return _run(space, problem, order, step, n_steps, start, mass, steps, perturbation)


def _check_order(order: int, allow_unstable: bool) -> None:
    if order != int(order) or order < 1:
        raise ValueError(f"order must be an integer >= 1, got {order!r}")
    if order >= 7 and not allow_unstable:
        raise ValueError(
            f"BDF{order} is not zero-stable: its errors grow exponentially with the number of "
            "steps; pass allow_unstable=True to see it fail"
        )
    if order == 6:
        warnings.warn(
            "BDF6 has no multiplier 1 - eta zeta: the stability proofs of both papers stop at 5",
            stacklevel=3,
        )


def _count_steps(step: float, end: float, order: int) -> int:
    if not (np.isfinite(step) and step > 0):
        raise ValueError(f"step must be positive and finite, got {step!r}")
    if not (np.isfinite(end) and end >= 0):
        raise ValueError(f"end must be finite and not negative, got {end!r}")
    n_steps = round(end / step)
    if abs(end / step - n_steps) > 1e-9 * max(1, n_steps):
        raise ValueError(f"end/step must be an integer, got {end!r}/{step!r} = {end / step!r}")
    if n_steps < order - 1:
        raise ValueError(
            f"end must be at least (p - 1) step = {(order - 1) * step:g} for p = {order}, "
            f"got {end!r}"
        )
    return n_steps


def _check_states(start: Sequence[State], order: int, step: float, n_steps: int) -> None:
    if len(start) != order:
        raise ValueError(f"start must hold p = {order} states, got {len(start)}")
    times = [s.t for s in start]
    last = round(times[-1] / step)
    wanted = [(last - j) * step for j in reversed(range(order))]
    if not np.allclose(times, wanted, rtol=1e-9, atol=1e-9 * step) or last > n_steps:
        raise ValueError(
            f"start must hold states at successive multiples of the step {step:g}, up to the end "
            f"{n_steps * step:g}; got times {times}"
        )


def _solver_factory(
    space: SurfaceSpace, solver: str | Callable[[], Solver]
) -> Callable[[], Solver]:
    if callable(solver):
        return solver
    if solver == "lagged":
        return partial(LaggedSolver, factorise=partial(multifrontal.factorise, fronts=space.fronts))
    order = space.elimination_order
    if solver == "cholmod":
        return partial(LaggedSolver, factorise=partial(cholmod, order=order))
    return partial(DirectSolver, partial(superlu, order=order))


March = Callable[..., Iterator[State]]


def _run(
    space: SurfaceSpace,
    problem: Problem,
    order: int,
    step: float,
    n_steps: int,
    start: str | Sequence[State],
    mass: str,
    steps: March,
    perturbation: Perturbation | None,
) -> Iterator[State]:
    if start == "exact":
        states = [replace(exact_state(space, problem, n * step), v=None) for n in range(order)]
    elif start == "euler":
        states = euler_states(space, problem, order, step, steps)
    else:
        states = list(start)  # type: ignore[arg-type]
    yield from states
    last = round(states[-1].t / step)
    times = ((n, n * step) for n in range(last + 1, n_steps + 1))
    yield from steps(order, step, states, times, mass, perturbation=perturbation)
