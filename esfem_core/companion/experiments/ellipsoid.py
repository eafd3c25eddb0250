"""[LMV] Section 6, Example 1: Figures 1 to 3, and the same with quadratic elements."""

import warnings
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal

import esfem_core as ec
from esfem_core.checks import one_of
from esfem_core.problems import Evaluation, Solution
from esfem_core.study import Experiment
from esfem_core.surfaces import bisected_sphere

__all__ = ["EXPERIMENTS", "chain", "compute", "settled"]

Mesh = Literal["octahedron", "bisected"]

LINEAR: dict[str, Any] = {"degree": 1, "refinements": 7}  # 65,538 nodes, the paper's number
BISECTED: dict[str, Any] = {"degree": 1, "refinements": 14, "mesh": "bisected"}  # 65,538 nodes, too
QUADRATIC: dict[str, Any] = {"degree": 2, "refinements": 5}  # 16,386 nodes
HALVINGS = tuple(2**i for i in range(2, 10))  # tau from 1/4 to 1/512


def compute(
    *,
    solution: Solution,
    degree: int,
    refinements: int,
    evaluation: Evaluation,
    order: int,
    steps_per_unit: int,
    window: Sequence[float],
    mesh: Mesh = "octahedron",
) -> dict[str, float]:
    r"""Run one BDF method on the oscillating ellipsoid from t = 0, with exact starting values.

    Parameters
    ----------
    solution, evaluation : str
        Of :func:`esfem_core.problems.oscillating_ellipsoid`.
    degree, refinements : int
        Elements of this degree on an octahedron refined so often: 4^{r+1} + 2 nodes for linear
        elements, 4^{r+2} + 2 for quadratic ones (see `mesh`).
    order : int
        1 to 6.
    steps_per_unit : int
        1/tau.
    window : (float, float)
        Times over which the norms are taken; the run ends with the second.
    mesh : {"octahedron", "bisected"}
        Triangles cut into four of their own shape by each refinement, or into two
        (:func:`esfem_core.surfaces.shapes.bisected_sphere`).

    Returns
    -------
    dict
        "max_l2" and "sum_h1", the norms of Theorem 5.2 over the window
        (:func:`esfem_core.errors.time_norms`); "end_l2" and "end_h1", the norms at the end; "h",
        the longest edge of the initial mesh; "nodes".

    Raises
    ------
    ValueError
        If there is no such mesh, or the solver refuses an argument.

    Examples
    --------
    >>> fixed = {"solution": "oscillation", "evaluation": "lifted", "window": (1, 2)}
    >>> fixed |= {"degree": 2, "refinements": 3, "order": 2}
    >>> coarse, fine = (compute(**fixed, steps_per_unit=n)["max_l2"] for n in (8, 16))
    >>> print(f"{coarse / fine:.1f}")
    3.9
    """
    one_of("mesh", mesh, Mesh)
    tri = bisected_sphere(refinements) if mesh == "bisected" else ec.sphere(mesh, refinements)
    space = ec.SurfaceSpace(tri, degree, ec.to_unit_sphere)
    problem = ec.problems.oscillating_ellipsoid(solution, evaluation)
    last: deque[ec.State] = deque(maxlen=1)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "BDF6 has no multiplier")  # which is why it is run
        run = ec.evolve(space, problem, order, 1 / steps_per_unit, window[1])
    first, final = window
    max_l2, sum_h1 = ec.errors.time_norms(space, problem, _remember(run, last), (first, final))
    end = ec.errors.compare(space, problem, last[0])
    return {
        "max_l2": max_l2,
        "sum_h1": sum_h1,
        "end_l2": end.u_l2,
        "end_h1": end.u_h1,
        "h": space.mesh_size(space.nodes),
        "nodes": len(space.nodes),
    }


def _remember(states: Iterable[ec.State], last: "deque[ec.State]") -> Iterator[ec.State]:
    """Yield the states and keep the last ones."""
    for state in states:
        last.append(state)
        yield state


def settled(previous: Mapping[str, Any], current: Mapping[str, Any]) -> bool:
    """Whether no norm has changed by 2% or more: only the spatial error is left."""
    names = ("max_l2", "sum_h1", "end_l2", "end_h1")
    return all(abs(current[name] - previous[name]) < 0.02 * previous[name] for name in names)


def chain(parameters: Mapping[str, Any], halvings: Sequence[int]) -> list[dict[str, Any]]:
    """Parameters of the runs with the given numbers of steps per unit of time."""
    return [{**parameters, "steps_per_unit": n} for n in halvings]


def _window(name: str, title: str, solution: str, window: list[int]) -> Experiment:
    fixed: dict[str, Any] = {"solution": solution, "evaluation": "lifted", "window": window}
    return Experiment(
        name,
        title,
        compute,
        [
            chain(fixed | elements | {"order": order}, HALVINGS)
            for elements, orders in (
                (LINEAR, range(1, 6)),
                (QUADRATIC, range(1, 7)),
                (BISECTED, (4,)),
            )
            for order in orders
        ],
        settled,
    )


def _refinements(name: str, title: str) -> Experiment:
    fixed: dict[str, Any] = {"solution": "decay", "evaluation": "lifted", "window": [0, 1]}
    meshes = [LINEAR | {"refinements": r} for r in range(4, 8)]
    meshes += [BISECTED | {"refinements": n} for n in (8, 10, 12, 14)]
    meshes += [QUADRATIC | {"refinements": r} for r in range(2, 6)]
    chains = [
        chain(fixed | elements | {"order": order}, HALVINGS[1:])
        for elements in meshes
        for order in (1, 4, 5)
    ]
    return Experiment(name, title, compute, chains, settled)


EXPERIMENTS = [
    _window(
        "lmv_figure_1", "[LMV] Figure 1: exp(-6t) x1 x2, BDF1 to 5, t in [2, 4]", "decay", [2, 4]
    ),
    _refinements("lmv_figure_2", "[LMV] Figure 2: exp(-6t) x1 x2 at t = 1 on four meshes"),
    _window(
        "lmv_figure_3",
        "[LMV] Figure 3: cos(pi t) x1 x2, BDF1 to 5, t in [5, 7]",
        "oscillation",
        [5, 7],
    ),
]
