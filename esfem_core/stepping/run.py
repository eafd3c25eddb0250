"""Runs: arguments checked, starting values made, steps taken."""

import math
import os
import warnings
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from typing import Literal, get_args

import numpy as np

from esfem_core.checks import (
    flag,
    function,
    items,
    level_outside,
    number,
    object_of,
    one_of,
    output_path,
    package,
    shown,
    whole_number,
)
from esfem_core.elements import SurfaceSpace
from esfem_core.laws import Prescribed, Regularised, check_no_slip
from esfem_core.problems import Problem
from esfem_core.solvers import (
    MOST_THREADS,
    DirectSolver,
    LaggedSolver,
    Solver,
    cholmod,
    factorise,
    superlu,
    using_threads,
)
from esfem_core.stepping.agreement import (
    check_exact,
    check_exact_functions,
    check_motion_of_start,
    check_normal_of_start,
    check_precision,
    check_slip,
    check_start_of_motion,
    check_starts,
    check_step_of_start,
    innermost,
)
from esfem_core.stepping.bdf import MOST_STEPS
from esfem_core.stepping.checkpoints import close_idle, saving, space_of
from esfem_core.stepping.guard import EvolutionWarning, Guard
from esfem_core.stepping.scheme import Perturbation, Scheme
from esfem_core.stepping.solving import Statistics, Systems
from esfem_core.stepping.start import euler_states, exact_starts, initial_state
from esfem_core.stepping.state import Mass, State, check_state
from esfem_core.stepping.times import TOLERANCE, count_steps, following
from esfem_core.stepping.units import (
    check_components,
    check_rates,
    check_units,
    factor_to_size_one,
)

__all__ = ["MASSES", "check_functions", "evolve"]

SolverName = Literal["lagged", "cholmod", "direct"]
StartName = Literal["exact", "euler"]
MASSES: tuple[Mass, ...] = get_args(Mass)
"""The choices of `mass` of :func:`evolve`."""

EVERY = 50  # steps from save to save if `every` is not given


def evolve(
    space: SurfaceSpace,
    problem: Problem,
    order: int,
    step: float,
    end: float,
    *,
    mass: Mass = "updated",
    start: StartName | Sequence[State] | None = None,
    solver: SolverName | Callable[[], Solver] = "lagged",
    allow_unstable: bool = False,
    perturbation: Perturbation | None = None,
    growth: float = 1e12,
    statistics: Statistics | None = None,
    save: str | os.PathLike[str] | None = None,
    every: int = EVERY,
    threads: int | None = None,
) -> Iterator[State]:
    r"""Solve a problem on an evolving surface by surface finite elements and BDF.

    For the coupled system, [N] (2.19)-(2.21), with :math:`K = M + \alpha A` and the extrapolations
    :math:`\tilde x^n = \sum_j \gamma_j x^{n-1-j}` and :math:`\tilde u^n` likewise; this is
    ``mass="extrapolated"``, and by default the mass matrices of the first line are M(x^{n-j}):

    .. math::

        \frac1\tau \sum_{j=0}^p \delta_j M(\tilde x^{n-j}) u^{n-j} + A(\tilde x^n) u^n
            &= f(\tilde x^n, \tilde u^n) \\
        K(\tilde x^n) v^n + \beta A(\tilde x^n) x^n &= g(\tilde x^n, \tilde u^n) \\
        \frac1\tau \sum_{j=0}^p \delta_j x^{n-j} &= v^n

    Each step assembles M and A at x~^n (by default also M at x^n) and solves one (N, N) system for
    u and one for the three components of v. For a prescribed motion, [LMV] (3.1): the same without
    the last two lines, on the exact nodes x^n. Other species and laws take the places of u and of
    the second line.

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
        Final time, an integer number of steps (to a relative 1e-9) after the last starting state,
        and so at least (p - 1) steps after the first.
    mass : {"updated", "extrapolated", "reassembled"}
        Where the mass matrices of the species are taken; no difference for a prescribed motion
        without a slip, and the functions that a law carries always have those of (2.19).
        "updated": at x^n on every level, known before u^n is; of order p. It keeps the amount
        1' M(x^n) u^n of the surface itself. On three surfaces (the stored results
        ``nick_mass_order``) its temporal errors are 0.08 to 1.07 times those of (2.19) in x; in u
        0.66 to 1.71 times for p = 1, 0.76 to 2.93 times for p = 2, and at most 1.12 times for
        p >= 3: in u neither is better on the whole.
        "extrapolated": at x~^{n-j} on every level, which is (2.19), of order p; at levels j < p,
        where nothing can be extrapolated, at x^j. It keeps the amount 1' M(x~^n) u^n.
        "reassembled": at x~^n on the newest level and at the solution x^{n-j} on the others, which
        is [N] (7.2) as printed. Its defect has the additional term
        (delta_0/tau) (M(x~^n) - M(x^n)) u^n = O(tau^{p-1}), so its order in u is p - 1, and for
        p = 1 it misses the change of the mass altogether.
    start : {"exact", "euler"} or sequence of p or more states, optional
        Starting values at 0, tau, ..., (p-1) tau. "exact": nodal values of ``problem.exact``,
        the default if it is given with all functions; not for nodes that slip. "euler": linearly
        implicit Euler steps, extrapolated to order p, with updated mass matrices. Otherwise the
        states to start from, of which the last p count, a step apart: the run goes on from the last
        one. Functions that the problem does not have are left behind. From its own states it goes
        on as if it had not been interrupted, to the last bit with direct solves and else to the
        tolerance of the solver; :func:`esfem_core.respaced` makes states that are another step
        apart.
        BDF needs a past that obeys the same law: where a law, a force or a coefficient changes at a
        time T, and likewise where it jumps in one run, errors are O(tau) for every p, and for p > 1
        larger than those of Euler. There, end the run at T and go on with
        ``start=esfem_core.started_anew(states[-1], problem, order, step)``.
        Exact values at (p - 1) tau also restart the spatial error there: to compare runs with
        different steps on one mesh, start them all with "euler" or with states of the finest.
    solver : {"lagged", "cholmod", "direct"} or callable
        "lagged": conjugate gradients to a relative residual of 1e-11, preconditioned with a
        factorisation by :mod:`esfem_core.solvers.multifrontal` that is kept for many steps (by
        SuperLU on meshes of long triangles or hubs, where a front would be large).
        "cholmod": the same with the factorisation of CHOLMOD (extra ``fast``). "direct": a sparse
        factorisation in every step. The residual is that of the whole surface: on a component that
        is much smaller than another, the first two lose about 1e-10 times the ratio of the areas,
        "direct" nothing. Otherwise a function without arguments that makes a
        :class:`esfem_core.solvers.factors.Solver`, called for each kind of system, such as
        ``partial(LaggedSolver, rtol=1e-8, factorise=partial(factorise, fronts=space.fronts))``.
    allow_unstable : bool
        Let p >= 7 run; these methods are not zero-stable.
    perturbation : callable, optional
        ``perturbation(n)`` returns nodal vectors (r_u, r_v, r_x), of the shapes of u, v and x, that
        are added to the right-hand sides of (2.19), (2.20) and (2.21) in step n: the defects of
        [N] (4.1), see :mod:`esfem_core.theory.defects`; or a mapping from names, "v", "x" and those
        of species, to such vectors; a number is a constant one. Euler starting steps from n - 1 to
        n have those of n, too. With a prescribed motion, r_v and r_x do not count. Laws that solve
        no system for v, such as mean curvature flow, take no r_v but zero: their own functions,
        such as "normal" and "H", have perturbations instead.
    growth : float
        How much larger than at the start the values of a function may become before the run stops
        with an error, or infinity; at a factor of 1e6 it warns. What is zero at the start has no
        bound; what is zero but for rounding needs infinity. The bound begins anew with each start:
        in a run that goes on from its own states in pieces, each piece may grow so much, and only
        values beyond 1e100 are warned of.
    statistics : Statistics, optional
        Collects what the linear solvers do, to be read while the run goes on. Each run needs one
        of its own.
    save : path, optional
        A file that ends with ".npz", for the last p + 1 states: written as soon as the starting
        values are known, then every so many steps, and at the end or when the run fails or is left;
        see :func:`esfem_core.save`. ``space, states = esfem_core.load(path)`` and ``start=states``
        go on from there. A run is left when nothing refers to it: loop over the call itself, or
        call ``run.close()``. After an interrupt go on from the file, not from ``run``: if that came
        in a step, it is over, and a second loop over it does nothing.
    every : int
        Steps from save to save; only with `save`.
    threads : int, optional
        How many share the work of a step; the states are the same to the last bit. Default: what
        :func:`esfem_core.solvers.threads.thread_count` says: with the extra ``fast`` one for each
        processor, but 1 in worker processes and where ``OMP_NUM_THREADS=1``. Small meshes keep to
        one.

    Yields
    ------
    State
        The p starting states (v is None), each as soon as it is known, then one per step, the last
        at `end` itself. Their arrays are read-only.

    Raises
    ------
    TypeError, ValueError
        If an argument is out of range, or the surface has a boundary that is to be moved by another
        law than :class:`esfem_core.laws.Prescribed`; at the call, before anything is computed.
    TypeError, ValueError, KeyError
        In the loop, if a function of the problem, or `perturbation`, returns the wrong type or
        shape or asks for what is not there.
    FileNotFoundError, PermissionError
        If the directory of `save` does not exist, or cannot be written to.
    ImportError
        If the solver is "cholmod" and the extra ``fast`` is not installed.
    EvolutionError
        If a run meets a value that is not finite or has grown beyond `growth`, or a rate or
        diffusivity that is negative, if an element degenerates, or turns by more than a right angle
        within a step, a closed component of the surface turns inside out, or a linear system is not
        solved to its tolerance. The states yielded before are good, but for what a warning says. A
        surface that passes through itself is not noticed.

    Warns
    -----
    EvolutionWarning
        If `save` cannot be written; the run goes on, and an older file is untouched.
        Once each, and the run goes on: where an angle falls below 0.7 to 1 degree or values have
        grown by a factor of 1e6, or beyond 1e100, so that the run will hardly survive; and where
        the surface folds step by step, so that results mean little there from now on: neighbouring
        triangles come to enclose less than 60 degrees, or a normal inside a curved element to make
        more than a right angle with that of its flat triangle; and where a component with a
        boundary passes through a point and comes out inside out.
        At the call, for alpha = 0 with mean curvature and degree 2 or more, or with p = 4 or more,
        which is unstable; for a slip of which more than a fifth is normal; for alpha of
        :class:`esfem_core.laws.Regularised`, or a constant diffusivity times the step, of more
        than 1e8 area/(4 pi), where rounding takes amounts and the motion of the surface as a whole:
        see to the units; and for a rate that is so much larger at some places than at others, as a
        penalty is, that a "lagged" or "cholmod" solver may lose more than 1e-6 of the values at
        these in each step; and likewise for a component so small beside others, of 1e-4 of their
        area, that they may lose so much there.
    UserWarning
        At the call, for p = 6.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 3), 2, ec.to_unit_sphere)
    >>> problem = ec.problems.growing_sphere(alpha=1, beta=1, delta=1, u0=4)
    >>> *_, last = ec.evolve(space, problem, order=3, step=1 / 40, end=1.0)
    >>> radius = np.linalg.norm(last.x, axis=1)
    >>> print(f"{radius.mean():.4f} {np.linalg.norm(problem.exact.x(space.nodes, 1.0)[0]):.4f}")
    1.4314 1.4314
    """
    object_of("space", space, SurfaceSpace)
    object_of("problem", problem, Problem)
    order = _checked_order(order, flag("allow_unstable", allow_unstable))
    step = number("step", step, above=0)
    one_of("mass", mass, Mass)
    growth = _checked_growth(growth)
    if perturbation is not None:
        function("perturbation", perturbation, "perturbation(n) of the number of a step, or None")
    if statistics is not None:
        object_of("statistics", statistics, Statistics, "or None")
        _check_unused(statistics)
    every = whole_number("every", every, 1)
    if threads is not None:
        threads = whole_number("threads", threads, 1, MOST_THREADS)
    if save is None and every != EVERY:
        raise ValueError(f"every needs a file to save to, got every={every} without save=path")
    file = None if save is None else output_path("save", save, (".npz",))
    make_solver = _solver_factory(space, solver)
    given = _checked_start(space, problem, start, order, step)
    n_steps = _steps_after_start(given, order, step, end)
    _check_law(space, problem, order)
    if isinstance(given, list):
        check_motion_of_start(space, problem, given[-1])
        check_normal_of_start(space, problem.law, given[-1])
        check_step_of_start(space, given, (mass, order, step))
    systems = Systems(
        make_solver,
        space.pattern,
        Statistics() if statistics is None else statistics,
        factor_to_size_one(space),
    )
    scheme = Scheme(space, problem, mass, systems, perturbation)
    first = given[-1] if isinstance(given, list) else initial_state(space, problem)
    _check_fixed(scheme, first)
    if isinstance(given, str) and problem.exact is not None:
        check_exact(space, problem, step, end)
    if given == "exact":
        check_exact_functions(space, problem, first)
    check_starts(space, problem, given, order, step)
    check_precision(space, problem.law, first, step)
    check_slip(space, problem.law, first, order, step)
    check_units(space, problem, first, step)
    check_rates(problem, first, order, step, solver)
    check_components(space, problem, first, solver)
    guard = Guard(space, first.x, first.fields, growth)
    states = _run(scheme, order, step, n_steps, end, given, guard)
    if file is None:
        return _on_threads(states, threads)
    kept = saving(states, file, every, order, _before(space, problem, start, given))
    run = _on_threads(kept, threads)
    # A script may end with the run in a variable: when Python takes that, nothing can be saved.
    weakref.finalize(run, close_idle, kept)
    return run


def _on_threads(states: Iterator[State], threads: int | None) -> Iterator[State]:
    """The same states; only while one is computed, so many threads share the work."""
    with closing(states):  # type: ignore[type-var]
        while True:
            with using_threads(threads):
                state = next(states, None)
            if state is None:
                return
            yield state


def _run(
    scheme: Scheme,
    order: int,
    step: float,
    n_steps: int,
    end: float,
    given: StartName | list[State],
    guard: Guard,
) -> Iterator[State]:
    states: list[State] = []
    early = [0.0, *(t for _, t in _times(0.0, step, 1, order - 1, end if n_steps == 0 else None))]
    for state in _starting_states(scheme, early, step, given, guard):
        states.append(state)
        yield state
    history = scheme.history(order, step, states)
    first = 1 + (order - 1 if isinstance(given, str) else round(history.t / step))
    del given, states, state  # of a million nodes 0.1 GiB that nobody would use
    yield from scheme.steps(history, _times(history.t, step, first, n_steps, end), guard)


def _times(
    t: float, step: float, first: int, n_steps: int, end: float | None
) -> Iterator[tuple[int, float]]:
    """Numbers and times of steps; the last time is `end` itself."""
    numbers = range(first, first + n_steps)
    for n, time in zip(numbers, following(t, step), strict=False):
        yield n, float(end) if end is not None and n == first + n_steps - 1 else time


def _starting_states(
    scheme: Scheme, times: list[float], step: float, given: StartName | list[State], guard: Guard
) -> Iterator[State]:
    if given == "exact":
        yield from exact_starts(scheme.space, scheme.problem, times)
    elif given == "euler":
        yield from euler_states(replace(scheme, mass="updated"), times, step, guard)
    else:
        yield from given


def _checked_order(order: int, allow_unstable: bool) -> int:
    order = whole_number("order", order, 1, MOST_STEPS)
    if order >= 7 and not allow_unstable:
        raise ValueError(
            f"order must be 6 at most, got {order}: BDF{order} is not zero-stable, its errors grow "
            "exponentially with the number of steps; pass allow_unstable=True to see it fail"
        )
    if order == 6:
        warnings.warn(
            "BDF6 has no multiplier 1 - eta zeta: the stability proofs of both papers stop at 5",
            stacklevel=level_outside(),
        )
    return order


def _check_unused(statistics: Statistics) -> None:
    """Refuse what has served another run: of kinds that this one does not solve, numbers stayed."""
    if statistics.solves:
        raise ValueError(
            "statistics must be those of one run, but these have served another, with solves "
            f"{statistics.solves}: esfem_core.Statistics() makes new ones"
        )


def _checked_growth(growth: float) -> float:
    if isinstance(growth, float | np.floating | np.ndarray) and np.array_equal(growth, np.inf):
        return np.inf
    return number("growth", growth, above=1)


def _checked_start(
    space: SurfaceSpace,
    problem: Problem,
    start: StartName | Sequence[State] | None,
    order: int,
    step: float,
) -> StartName | list[State]:
    """How to start, or the states to start from."""
    exact = problem.exact
    missing = [n for n in problem.all_species if exact is None or n not in exact.functions]
    if start is None:
        start = "euler" if exact is None or missing else "exact"
    if isinstance(start, str):
        if start not in get_args(StartName):
            raise ValueError(
                f'start must be "exact", "euler" or a sequence of states, got {start!r}'
            )
        if start == "exact" and exact is None:
            raise ValueError('start="exact" needs a problem with an exact solution')
        if start == "exact" and missing:
            raise ValueError(
                f'start="exact" needs exact values of {", ".join(map(repr, missing))}: '
                "Exact(..., fields={name: function})"
            )
        return start
    if isinstance(start, tuple) and start and isinstance(start[0], SurfaceSpace):
        raise TypeError(
            "start must be a sequence of states, got a pair of a space and states: "
            "space, states = esfem_core.load(path), then start=states"
        )
    if not isinstance(start, Sequence):
        raise TypeError(
            f'start must be "exact", "euler" or a sequence of states, got {shown(start)}'
        )
    states = items("start", start, State, least=0)
    if len(states) < order:
        raise ValueError(
            f"start must hold p = {order} states or more, got {len(states)}; "
            "esfem_core.started_anew(state, problem, order, step) makes them of one"
        )
    states = states[-order:]
    for i, state in enumerate(states):
        check_state(space, state, f"start[{i - order}]")
        check_functions(f"start[{i - order}]", problem, state)
    for i, state in enumerate(states):
        for key in problem.all_species:
            if state[key].shape != (shape := states[-1][key].shape):
                raise ValueError(
                    f"start[{i - order}][{key!r}] must have the shape {shape} that it has in the "
                    f"last state, got {state[key].shape}"
                )
    times = [state.t for state in states]
    wanted = [times[-1] - j * step for j in reversed(range(order))]
    # Each of the times is rounded, and so are sums of the step.
    tolerance = TOLERANCE * step + order * math.ulp(max(map(abs, times)))
    if not np.allclose(times, wanted, rtol=0, atol=tolerance):
        if times != sorted(times):
            raise ValueError(
                f"start must hold states in the order of time, got times {times}; start="
                f"{_in_order(times)}"
            )
        raise ValueError(
            f"start must hold states that are a step of {step:g} apart, got times {times}; "
            "esfem_core.respaced(states, step, order) makes such"
        )
    return [_of_problem(space, problem, state) for state in states]


def _in_order(times: list[float]) -> str:
    """What puts states in the order of time."""
    turned = times[::-1] == sorted(times)
    return "states[::-1]" if turned else "sorted(states, key=lambda state: state.t)"


def check_functions(name: str, problem: Problem, state: State) -> None:
    """Refuse a state that lacks a function of the problem, or has other components of it.

    Parameters
    ----------
    name : str
        What the message calls the state.
    problem : Problem
    state : State

    Raises
    ------
    ValueError
    """
    for key, species in problem.all_species.items():
        if key not in state.fields:
            known = ", ".join(map(repr, state.fields)) or "none"
            values = "state.v" if key == "velocity" and state.v is not None else "values"
            # Past values that do not come from the equations cost the method its order.
            advice = (
                f"state.with_functions({{{key!r}: {values}}}) has it, and for order 2 or more "
                "esfem_core.started_anew(that, problem, order, step) makes the others of it"
            )
            if key in problem.law_species and species.initial is None:
                advice = "esfem_core.started_anew(state, problem, order, step) makes it"
            raise ValueError(f"{name} must have the function {key!r}, it has {known}; {advice}")
        trailing = state[key].shape[1:]
        if np.ndim(species.diffusivity) == 1 and np.shape(species.diffusivity) != trailing:  # type: ignore[arg-type]
            raise ValueError(
                f"{name}[{key!r}] must have {np.size(species.diffusivity)} components, one for "  # type: ignore[arg-type]
                f"each diffusivity, got shape {state[key].shape}"
            )


def _of_problem(space: SurfaceSpace, problem: Problem, state: State) -> State:
    """The state as those have it that follow: with its space, and functions of the problem only."""
    names = list(problem.all_species)
    if state.space is not None and list(state.fields) == names:
        return state
    return State(
        state.t,
        state.x,
        state.v,
        space=space,
        fields={name: state[name] for name in names},
        products={name: b for name, b in state.products.items() if name in names},
        method=state.method,
    )


def _before(
    space: SurfaceSpace,
    problem: Problem,
    start: StartName | Sequence[State] | None,
    given: StartName | list[State],
) -> list[State]:
    """The state before those to start from, if there is one of the same space and functions."""
    if isinstance(start, str | None) or isinstance(given, str) or len(start) == len(given):
        return []
    state = start[-len(given) - 1]
    try:
        check_state(space, state)
        check_functions("state", problem, state)
        state = _of_problem(space, problem, state)
        space_of([state, *given])
    except ValueError:
        return []
    return [state]


def _steps_after_start(given: StartName | list[State], order: int, step: float, end: float) -> int:
    if not isinstance(given, str):
        return count_steps(given[-1].t, step, end)
    n_steps = count_steps(0.0, step, end) - (order - 1)
    if n_steps < 0:
        raise ValueError(
            f"end must be at least (p - 1) step = {(order - 1) * step!r} for order p = {order}, "
            f"got {end!r}"
        )
    return n_steps


def _check_law(space: SurfaceSpace, problem: Problem, order: int) -> None:
    law: object = problem.law
    if hasattr(law, "position"):
        check_start_of_motion(space, law)
        if isinstance(law, Prescribed):
            check_no_slip(law, "with_slip(Prescribed(velocity=v), w) lets the nodes go")
    elif len(space.boundary_nodes):
        raise ValueError(
            f"law must prescribe the motion of a surface with a boundary, got {law!r}: an equation "
            "for the velocity, or a slip along the surface, needs a condition at the boundary, "
            "which no law states; laws.Prescribed(motion=X) or (velocity=v) moves it"
        )
    law = innermost(law)
    if isinstance(law, Regularised) and law.alpha == 0 < law.beta:
        _warn_of_no_alpha(space, order)


def _check_fixed(scheme: Scheme, first: State) -> None:
    """Refuse given values that do not fit at the start here, not in the first step."""
    for name, values in first.fields.items():
        try:
            scheme.fixed(name, first.x, first.t, values)
        except FloatingPointError as error:
            raise ValueError(str(error)) from error


def _warn_of_no_alpha(space: SurfaceSpace, order: int) -> None:
    if order > 3:  # delta(z) + kappa (1 - z)^p has roots in the unit disk
        text = (
            f"alpha = 0 with beta > 0 is unstable for p = {order}: nodes move along the surface "
            "until elements turn over; take p <= 3 or alpha > 0"
        )
    elif space.degree > 1:
        text = (
            "alpha = 0 with beta > 0 (mean curvature flow by Dziuk's scheme) is outside the "
            f"theory: elements of degree {space.degree} lose two orders except on spheres"
        )
    else:
        return
    warnings.warn(text, EvolutionWarning, stacklevel=level_outside())


def _solver_factory(
    space: SurfaceSpace, solver: SolverName | Callable[[], Solver]
) -> Callable[[], Solver]:
    if callable(solver):
        return solver
    if not isinstance(solver, str) or solver not in get_args(SolverName):
        raise ValueError(
            f'solver must be "lagged", "cholmod", "direct" or a function that makes one, got '
            f"{shown(solver)}"
        )
    if solver == "cholmod":
        package('solver="cholmod" needs cholespy', "cholespy", "fast")
    if solver == "lagged":
        return partial(LaggedSolver, factorise=partial(factorise, fronts=space.fronts))
    order = space.elimination_order
    if solver == "cholmod":
        return partial(LaggedSolver, factorise=partial(cholmod, order=order))
    return partial(DirectSolver, partial(superlu, order=order))
