"""[N] 7.4: what a second assembly of the mass matrix adds to the run time of a step."""

import time
from collections.abc import Iterator
from functools import partial
from itertools import islice
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
from scipy.sparse import coo_array, csr_array

import esfem_core as ec
from esfem_core.checks import Array, number
from esfem_core.elements import tabulate
from esfem_core.study import Experiment

__all__ = ["EXPERIMENTS", "assemble_by_element", "runtime"]

STEPS_PER_ROUND = 40


def runtime(
    *, refinements: int, solver: Literal["lagged", "direct"], seconds: float
) -> dict[str, Any]:
    """Time the second assembly of a step against the step, in turn in one process.

    Expanding sphere, quadratic elements, p = 3, tau = 1/160. A round is the first 40 steps, with
    all factorisations; what is compared is done in turn within each step.

    Parameters
    ----------
    refinements : int
        Of the octahedron.
    solver : str
        Of :func:`esfem_core.evolve`.
    seconds : float
        How long to measure at least; there are at least three rounds.

    Returns
    -------
    dict
        Medians over the rounds, in seconds per step: "step" of (2.19), "assembly", all that is
        assembled in it, "matrix", M(x^n) u^n with a newly assembled matrix (and the stiffness
        matrix, which comes with it), "load", the same as a load vector. First quartile, median
        and third quartile of ratios: "share" of the assembly in the step; "with_matrix" and
        "with_load", the step with either addition to the step alone; "updated", a step with
        M(x^n) at all levels to one of (2.19). The same with assembly element by element, M(x^n)
        alone being the addition: "share_by_element", "with_matrix_by_element". "nodes", "rounds".

    Raises
    ------
    ValueError
        If the seconds are negative, or the solver refuses an argument.

    Examples
    --------
    >>> row = runtime(refinements=0, solver="lagged", seconds=0.1)
    >>> low, median, high = row["with_matrix"]
    >>> 1 < low <= median <= high
    True
    """
    seconds = number("seconds", seconds, least=0)
    space = ec.SurfaceSpace(ec.sphere("octahedron", refinements), 2, ec.to_unit_sphere)
    problem, order = ec.problems.expanding_sphere("smooth"), 3
    runs = [
        partial(ec.evolve, space, problem, order, 1 / 160, 1.0, mass=mass, solver=solver)
        for mass in ("extrapolated", "updated")
    ]
    rounds: list[Array] = []
    by_element: list[list[float]] = []
    start = time.perf_counter()
    while len(rounds) < 3 or time.perf_counter() - start < seconds:
        plain, updated = (islice(run(), order, None) for run in runs)
        state, times = _round(space, plain, updated)
        rounds.append(times)
        by_element.append(_by_element_times(space, problem, state))
    step, step_updated, assembly, matrix, load = np.array(rounds).T
    all_slow, mass_slow = np.array(by_element).T
    step_slow = step - assembly + all_slow
    return {
        "nodes": len(space.nodes),
        "rounds": len(rounds),
        "step": float(np.median(step)),
        "assembly": float(np.median(assembly)),
        "matrix": float(np.median(matrix)),
        "load": float(np.median(load)),
        "share": _quartiles(assembly / step),
        "with_matrix": _quartiles(1 + matrix / step),
        "with_load": _quartiles(1 + load / step),
        "updated": _quartiles(step_updated / step),
        "share_by_element": _quartiles(all_slow / step_slow),
        "with_matrix_by_element": _quartiles(1 + mass_slow / step_slow),
    }


def _round(
    space: ec.SurfaceSpace, plain: Iterator[ec.State], updated: Iterator[ec.State]
) -> tuple[ec.State, Array]:
    """The last state of a round, and mean times: steps of both runs, assembly, matrix, load."""
    clock = np.empty((STEPS_PER_ROUND, 6))
    for row in clock:
        row[0] = time.perf_counter()
        state = next(plain)
        row[1] = time.perf_counter()
        next(updated)
        row[2] = time.perf_counter()
        _assembled(space, state)
        row[3] = time.perf_counter()
        space.mass_stiffness(state.x)[0] @ state.u
        row[4] = time.perf_counter()
        space.load(state.x, space.evaluate(state.u))
        row[5] = time.perf_counter()
    return state, np.diff(clock).mean(axis=0)


def _by_element_times(space: ec.SurfaceSpace, problem: ec.Problem, state: ec.State) -> list[float]:
    """Times of the assembly element by element: of all, and of M alone."""
    times = []
    for source in (problem, None):
        begin = time.perf_counter()
        assemble_by_element(space, state, source)
        times.append(time.perf_counter() - begin)
    return times


def _quartiles(ratio: Array) -> list[float]:
    return [float(q) for q in np.quantile(ratio, [0.25, 0.5, 0.75])]


def _assembled(space: ec.SurfaceSpace, state: ec.State) -> None:
    """All that a step assembles, in one pass."""
    wanted = {("matrices", ""), ("normal", ""), ("points", ""), ("value", "u"), ("gradient", "u")}
    ec.Surface(space, state.x, state.fields, state.t, expected=wanted).M  # noqa: B018 - computed here


def _sources(problem: ec.Problem | None) -> tuple[Any, Any]:
    """Right-hand sides f and g of the coupled problem."""
    if problem is None:
        return None, None
    assert isinstance(problem.law, ec.laws.Regularised)
    return problem.species["u"].source, problem.law.g


def assemble_by_element(
    space: ec.SurfaceSpace, state: ec.State, problem: ec.Problem | None = None
) -> tuple[list[csr_array], list[Array]]:
    """Assemble in a loop over the elements, as the formulas of [N] 7.1 and 7.2 are written.

    Parameters
    ----------
    space : SurfaceSpace
    state : State
        Surface, and function that f and g get.
    problem : Problem, optional
        With f and g.

    Returns
    -------
    matrices, loads : lists
        The mass matrix; with a problem also the stiffness matrix and the loads of f and g nu.

    Examples
    --------
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)
    >>> [M], _ = assemble_by_element(space, ec.State(0.0, space.nodes, None, space.nodes[:, 0]))
    >>> bool(abs(M - space.mass_stiffness(space.nodes)[0]).max() < 1e-15)
    True
    """
    phi, derivatives = tabulate(space.degree, space.rule.points)
    cells, n_basis = space.cells, phi.shape[1]
    entries = np.empty((1 if problem is None else 2, len(cells), n_basis, n_basis))
    loads = [] if problem is None else [np.zeros(len(state.x)), np.zeros_like(state.x)]
    f, g = _sources(problem)
    for e, cell in enumerate(cells):
        D = (derivatives @ state.x[cell]).transpose(1, 2, 0)  # (Q, 3, 2)
        normal = np.cross(D[..., 0], D[..., 1])
        density = np.linalg.norm(normal, axis=1)
        weights = (space.rule.weights * density)[:, None]
        entries[0, e] = phi.T @ (weights * phi)
        if problem is not None:
            # (7.1): the columns of D, completed by the unit normal, inverted and transposed.
            square = np.concatenate([D, (normal / density[:, None])[..., None]], axis=2)
            gradients = np.linalg.inv(square)[:, :2].transpose(0, 2, 1) @ derivatives.transpose(
                1, 0, 2
            )  # (Q, 3, n)
            entries[1, e] = np.einsum("qia,qib,q->ab", gradients, gradients, weights[:, 0])
            u, y = phi @ state.u[cell], phi @ state.x[cell]
            # What f and g see, of one element.
            at = SimpleNamespace(
                u=u[None], grad_u=(gradients @ state.u[cell])[None], points=y[None], t=state.t
            )
            loads[0][cell] += phi.T @ (weights[:, 0] * f(at)[0])
            force = g(at)[0][:, None] * normal / density[:, None]
            loads[1][cell] += phi.T @ (weights * force)
    rows, columns = np.repeat(cells, n_basis, axis=1).ravel(), np.tile(cells, n_basis).ravel()
    shape = (len(state.x), len(state.x))
    matrices = [coo_array((m.ravel(), (rows, columns)), shape=shape).tocsr() for m in entries]
    return matrices, loads


EXPERIMENTS = [
    Experiment(
        "nick_mass_runtime",
        "[N] 7.4: run time of a second assembly (measure on a quiet machine)",
        runtime,
        [
            [{"refinements": r, "solver": solver, "seconds": 10.0} for r in refinements]
            for solver, refinements in (("lagged", (2, 3, 4, 5, 6)), ("direct", (2, 3, 4, 5)))
        ],
    ),
]
