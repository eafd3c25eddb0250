"""[LMV] Section 6, Example 2: the baseball bat, its Figure 4 and what surrounds it."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from itertools import islice
from typing import Any

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

import esfem_core as ec
from esfem_core.checks import Array
from esfem_core.companion.revolution import cosine_mode
from esfem_core.study import Experiment

__all__ = [
    "EXPERIMENTS",
    "bat_space",
    "exact",
    "figure_4",
    "large_steps",
    "reference_at",
    "run_times",
    "small_steps",
    "space_errors",
    "time_errors",
]

ORDERS = (1, 2, 3, 4, 5)
UNIT = 1e-5
TURN = Rotation.from_rotvec([0.3, 0.5, 0.7]).as_matrix()


def bat_space(refinements: int, degree: int = 1, turned: bool = False) -> ec.SurfaceSpace:
    """Elements on the refined octahedron.

    Its edges lie on the plane x1 = 0 and its vertices at the poles, unless the mesh is turned
    about an axis that is in no plane of symmetry.

    Parameters
    ----------
    refinements, degree : int
    turned : bool
    """
    tri = ec.sphere("octahedron", refinements)
    if turned:
        tri = trimesh.Trimesh(tri.vertices @ TURN.T, tri.faces, process=False)
    return ec.SurfaceSpace(tri, degree, ec.to_unit_sphere)


def exact(space: ec.SurfaceSpace, times: Sequence[float]) -> list[Array]:
    """Nodal values of the solution from u0 = x1 x2, to about 1e-6 of its size.

    Parameters
    ----------
    space : SurfaceSpace
    times : sequence of float

    Returns
    -------
    list of (N,) float array
    """
    return [u(space.nodes) for u in _profiles(tuple(times))]


def _motion() -> Callable[[Array, float], Array]:
    """(6.2) of [LMV]."""
    law = ec.problems.baseball_bat().law
    assert isinstance(law, ec.laws.Prescribed)
    assert law.motion is not None
    return law.motion


@lru_cache
def _profiles(times: tuple[float, ...]) -> list[Any]:
    return cosine_mode(_motion(), lambda a: np.cos(a) * np.sin(a), times, degree=28)


def small_steps(
    space: ec.SurfaceSpace, problem: ec.Problem, small: float, large: float, end: float = 1.0
) -> list[ec.State]:
    """The paper's reference, BDF1 with small steps, at the multiples of the large step.

    Parameters
    ----------
    space : SurfaceSpace
    problem : Problem
    small, large : float
        Steps; `large` is a multiple of `small`.
    end : float

    Returns
    -------
    list of State
    """
    run = ec.evolve(space, problem, 1, small, end)
    return list(islice(run, 0, None, round(large / small)))


def reference_at(space: ec.SurfaceSpace, results: Mapping[str, Any], t: float) -> ec.State:
    """The reference at a time that :func:`figure_4` was asked to keep.

    Parameters
    ----------
    space : SurfaceSpace
        Of the run.
    results : mapping
        What :func:`figure_4` returned.
    t : float

    Returns
    -------
    State
    """
    u = np.array(results[f"u_{t:g}"]) * UNIT * results[f"max_{t:g}"]
    return ec.State(t, _motion()(space.nodes, t), None, u)


def large_steps(
    space: ec.SurfaceSpace,
    problem: ec.Problem,
    order: int,
    large: float,
    reference: Sequence[ec.State],
) -> list[ec.State]:
    """The paper's run of one order: starting values are those of the reference.

    The last of them is at 0.15 for p up to 4, so that 0.2 is the first value computed. BDF5, which
    the paper does not show here, needs the one at 0.2 as well. Starting states are part of the
    list.

    Parameters
    ----------
    space : SurfaceSpace
    problem : Problem
    order : int
    large : float
        The step.
    reference : sequence of State
        From :func:`small_steps`.

    Returns
    -------
    list of State
    """
    last = max(order, 4)
    return list(ec.evolve(space, problem, order, large, 1.0, start=reference[last - order : last]))


def figure_4(
    refinements: int, small: float, large: float, keep: Sequence[float] = ()
) -> dict[str, Any]:
    """Figure 4 in numbers: relative distances in L2 between its runs, at the large steps.

    A second component with u0 = 1 + x1 x2, whose integral is not zero, runs along.

    Parameters
    ----------
    refinements : int
        See :func:`bat_space`.
    small, large : float
        Steps of the paper's reference and of its runs.
    keep : sequence of float
        Times at which the reference is kept.

    Returns
    -------
    dict
        times : 0.2, ..., 1. bdf1, ..., bdf5 : distances from the paper's reference at these times;
        zero where a value of the reference starts a run. error_bdf1, ..., error_reference : the
        same from BDF5 with steps of 1/640. error_space : distance of the latter from the solution
        without a mesh. mass, mass_one : integrals of both initial values. drift, drift_one : their
        largest change in the runs of the figure, relative to the integral of ``|u|``. u_<t> :
        nodal values of the reference at the times to keep, integers in units of 1e-5 max_<t>.
    """
    space = bat_space(refinements)
    problem = ec.problems.baseball_bat(lambda x: (x[:, 0] * x[:, 1])[:, None] + [0.0, 1.0])
    reference = small_steps(space, problem, small, large)
    every = round(640 * large)
    fine = list(islice(ec.evolve(space, problem, 5, 1 / 640, 1.0, start="euler"), 0, None, every))
    runs = {f"bdf{p}": large_steps(space, problem, p, large, reference) for p in ORDERS}
    shown = range(4, len(fine))
    times = [fine[n].t for n in shown]

    def distances(run: Sequence[ec.State], others: Sequence[ec.State]) -> list[float]:
        return [
            _distance(space, run[n - len(others)].u[:, 0], others[n]) for n in shown
        ]  # runs end alike

    without_mesh = zip(exact(space, times), fine[4:], strict=True)
    mass, drift = _mass(space, [reference, *runs.values()])
    values = {t: reference[round(t / large)].u[:, 0] for t in keep}
    return {
        "times": times,
        **{name: distances(run, reference) for name, run in runs.items()},
        **{f"error_{name}": distances(run, fine) for name, run in runs.items()},
        "error_reference": distances(reference, fine),
        "error_space": [_distance(space, u, state) for u, state in without_mesh],
        "mass": mass[0],
        "mass_one": mass[1],
        "drift": drift[0],
        "drift_one": drift[1],
        **{f"max_{t:g}": float(abs(u).max()) for t, u in values.items()},
        **{
            f"u_{t:g}": np.rint(u / abs(u).max() / UNIT).astype(int).tolist()
            for t, u in values.items()
        },
    }


def _distance(space: ec.SurfaceSpace, u: Array, other: ec.State) -> float:
    """Of u from the first component of a state, relative to the latter, in L2."""
    M, _ = space.mass_stiffness(other.x)
    v = other.u[:, 0]
    return ec.errors.seminorm(M, u - v) / ec.errors.seminorm(M, v)


def _mass(
    space: ec.SurfaceSpace, runs: Iterable[Sequence[ec.State]]
) -> tuple[list[float], list[float]]:
    """1' M u at the start, and the largest change relative to 1' M |u|, by component."""
    totals: list[Array] = []
    sizes: list[Array] = []
    for state in (state for run in runs for state in run):
        weights = space.load(state.x, np.ones((len(space.cells), len(space.rule.weights))))
        totals.append(weights @ state.u)
        sizes.append(weights @ abs(state.u))
    drift = np.max(abs(np.array(totals) - totals[0]) / np.array(sizes), axis=0)
    return totals[0].tolist(), drift.tolist()


def time_errors(
    refinements: int, order: int, steps: Sequence[float], begin: float = 0.0
) -> dict[str, Any]:
    """Errors of time discretization on one mesh, against BDF5 with steps of 1/1280.

    Its states from the time `begin` on are also the starting values.

    Parameters
    ----------
    refinements : int
        See :func:`bat_space`.
    order : int
        p.
    steps : sequence of float
        Multiples of 1/160.
    begin : float
        A multiple of 1/160.

    Returns
    -------
    dict
        l2, h1 : relative errors at t = 1, one for each step.
    """
    space, fine = _fine_run(refinements)
    M, A = space.mass_stiffness(fine[-1].x)
    l2, h1 = [], []
    for step in steps:
        start = fine[round(160 * begin) :: round(160 * step)][:order]
        problem = ec.problems.baseball_bat()
        run = ec.evolve(space, problem, order, step, 1.0, start=start, solver="direct")
        e = ec.study.final(run).u - fine[-1].u
        l2.append(ec.errors.seminorm(M, e) / ec.errors.seminorm(M, fine[-1].u))
        h1.append(ec.errors.seminorm(A, e) / ec.errors.seminorm(A, fine[-1].u))
    return {"l2": l2, "h1": h1}


@lru_cache(maxsize=2)
def _fine_run(refinements: int) -> tuple[ec.SurfaceSpace, list[ec.State]]:
    space, problem = bat_space(refinements), ec.problems.baseball_bat()
    run = ec.evolve(space, problem, 5, 1 / 1280, 1.0, start="euler", solver="direct")
    return space, list(islice(run, 0, None, 8))


def space_errors(degree: int, turned: bool, refinements: int, step: float) -> dict[str, Any]:
    """Error of a mesh at t = 1, BDF5, against nodal values of the solution without a mesh.

    Parameters
    ----------
    degree, turned, refinements
        See :func:`bat_space`.
    step : float

    Returns
    -------
    dict
        h, nodes; l2, h1 : relative errors; waist : part of the elements with corners on both sides
        of x1 = 0; h1_waist : the error h1 of these elements alone.
    """
    space, problem = bat_space(refinements, degree, turned), ec.problems.baseball_bat()
    last = ec.study.final(ec.evolve(space, problem, 5, step, 1.0))
    (u,) = exact(space, [1.0])
    M, A = space.mass_stiffness(last.x)
    error, size = last.u - u, ec.errors.seminorm(A, u)
    side = space.nodes[space.cells[:, :3], 0]
    waist = (side.min(axis=1) < -1e-9) & (side.max(axis=1) > 1e-9)
    squares = (space.gradient(last.x, error) ** 2).sum(axis=2) * waist[:, None]
    return {
        "h": space.mesh_size(space.nodes),
        "nodes": len(space.nodes),
        "l2": ec.errors.seminorm(M, error) / ec.errors.seminorm(M, u),
        "h1": ec.errors.seminorm(A, error) / size,
        "waist": float(waist.mean()),
        "h1_waist": float(np.sqrt(space.load(last.x, squares).sum())) / size,
    }


def run_times(
    refinements: int, small: float, large: float, orders: Sequence[int], pieces: int
) -> dict[str, Any]:
    """Time of the reference over that of the runs with large steps, in one process.

    The reference is cut into pieces of equally many steps, and after each of them each of the cheap
    runs is timed once. Their starting values, which the paper takes from the reference, are not
    counted.

    Parameters
    ----------
    refinements : int
        See :func:`bat_space`.
    small, large : float
        Steps of the reference and of the cheap runs.
    orders : sequence of int
        p of the cheap runs.
    pieces : int
        Divides the number of steps of the reference.

    Returns
    -------
    dict
        bdf<p> : [lower quartile, median, upper quartile] of the ratio; steps, steps_large :
        numbers of steps; start : steps for the starting values, in times of the first cheap run;
        set_up : making mesh and space, in the same unit.
    """
    clock = time.perf_counter
    begin = clock()
    space, problem = bat_space(refinements), ec.problems.baseball_bat()
    set_up = clock() - begin

    start = small_steps(space, problem, large / 50, large, 3 * large)
    length = round(1 / small) // pieces
    run = ec.evolve(space, problem, 1, small, 1.0)
    next(run)
    reference = []
    cheap: dict[int, list[float]] = {p: [] for p in orders}
    for _ in range(pieces):
        begin = clock()
        for _ in islice(run, length):
            pass
        reference.append(clock() - begin)
        for p in orders:
            begin = clock()
            states = large_steps(space, problem, p, large, start)
            cheap[p].append(clock() - begin)
    whole = pieces * np.array(reference)
    unit = float(np.median(cheap[orders[0]]))
    return {
        **{f"bdf{p}": np.quantile(whole / cheap[p], [0.25, 0.5, 0.75]).tolist() for p in orders},
        "steps": length * pieces,
        "steps_large": len(states) - orders[-1],
        "start": 3 * large * float(np.median(whole)) / unit,
        "set_up": set_up / unit,
    }


_STEPS = [1 / 20, 1 / 40, 1 / 80, 1 / 160]
_KEEP = [0.05, 0.1, 0.15, 0.2, 0.6, 1.0]

EXPERIMENTS = [
    Experiment(
        "lmv_figure_4",
        "[LMV] Figure 4, baseball bat: distances from BDF1 with small steps",
        figure_4,
        [
            [{"refinements": 2, "small": 1 / 1000, "large": 1 / 20, "keep": []}],
            [{"refinements": 5, "small": 1e-4, "large": 1 / 20, "keep": _KEEP}],
        ],
    ),
    Experiment(
        "lmv_run_times",
        "[LMV] Example 2, baseball bat: time for the reference over time for large steps",
        run_times,
        [[{"refinements": 5, "small": 1e-4, "large": 1 / 20, "orders": [1, 2, 4], "pieces": 20}]],
    ),
    Experiment(
        "bat_time",
        "baseball bat: errors in time on one mesh",
        time_errors,
        [
            *([{"refinements": r, "order": p, "steps": _STEPS} for p in ORDERS] for r in (2, 5)),
            [{"refinements": 5, "order": p, "steps": _STEPS, "begin": 0.25} for p in ORDERS],
        ],
    ),
    Experiment(
        "bat_space",
        "baseball bat: errors in space, meshes that follow the kink and meshes that do not",
        space_errors,
        [
            [
                {"degree": k, "turned": turned, "refinements": r, "step": 1 / 320}
                for r in range(3 - k, 8 - k)
            ]
            for k in (1, 2)
            for turned in (False, True)
        ],
    ),
]
