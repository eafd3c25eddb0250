"""[N] 7.3 and 7.4: the expanding sphere, Figures 1 to 4, and how far Theorem 2.1 reaches."""

from collections.abc import Iterable, Sequence
from typing import Any, Literal

import numpy as np
import trimesh

import esfem_core as ec
from esfem_core.checks import Array, one_of
from esfem_core.companion.experiments.theorem import Norms, left_hand_sides
from esfem_core.problems import Coupling
from esfem_core.stepping import exact_state
from esfem_core.study import Experiment

__all__ = ["EXPERIMENTS", "errors_at_end", "lifted_sides", "make_space", "time_errors"]

Mesh = Literal["octahedron", "icosahedron", "distance"]

END = 1.0
SAMPLES = 20
AXIS = np.array([1.0, 2.0, 3.0]) / np.sqrt(14)  # of the turned meshes


def make_space(mesh: Mesh, refinements: int, degree: int, angle: float = 0.0) -> ec.SurfaceSpace:
    """Elements on the unit sphere, the mesh turned about (1, 2, 3).

    Parameters
    ----------
    mesh : {"octahedron", "icosahedron", "distance"}
        A refined solid, or a mesh of the distance function (:func:`esfem_core.from_level_set`)
        with edges of length 0.6/2^refinements.
    refinements, degree : int
    angle : float
        In radians. Edges of the octahedron lie on the coordinate planes if it is zero.

    Returns
    -------
    SurfaceSpace

    Raises
    ------
    ValueError
        If there is no such mesh.

    Examples
    --------
    >>> space = make_space("octahedron", 1, 2, angle=0.5)
    >>> len(space.nodes), bool(abs(space.nodes[0, 0] - 1) > 0.1)
    (66, True)
    """
    one_of("mesh", mesh, Mesh)
    if mesh == "distance":
        tri = ec.from_level_set(_distance, [[-1.3] * 3, [1.3] * 3], 0.6 / 2**refinements)
    else:
        tri = ec.sphere(mesh, refinements)
    if angle:
        turn = trimesh.transformations.rotation_matrix(angle, AXIS)[:3, :3]
        tri = trimesh.Trimesh(tri.vertices @ turn.T, tri.faces, process=False)
    return ec.SurfaceSpace(tri, degree, ec.to_unit_sphere)


def _distance(x: Array) -> Array:
    return np.asarray(np.linalg.norm(x, axis=1)) - 1


def errors_at_end(
    mesh: Mesh,
    refinements: int,
    degree: int,
    order: int,
    step: float,
    coupling: Coupling = "smooth",
    angle: float = 0.0,
) -> dict[str, float]:
    """Errors at T = 1 of one run with exact starting values.

    Parameters
    ----------
    mesh, refinements, degree, angle
        See :func:`make_space`.
    order, step
        See :func:`esfem_core.evolve`.
    coupling
        See :func:`esfem_core.problems.expanding_sphere`.

    Returns
    -------
    dict
        ``nodes``, ``h``; ``t``, the time reached, 1 unless the run had to stop; the errors at the
        nodes (:func:`esfem_core.errors.compare`) under their names; the lifted errors with
        ``_lifted`` appended; ``slope``, the largest norm of the gradient of x - x_* at a
        quadrature point. Errors are NaN if the run had to stop.

    Examples
    --------
    >>> errors = errors_at_end("octahedron", 1, 2, order=3, step=1 / 20)
    >>> print("{nodes} {x_l2:.0e} {u_l2:.0e} {u_l2_lifted:.0e}".format(**errors))
    66 8e-03 2e-02 2e-02
    """
    space = make_space(mesh, refinements, degree, angle)
    problem = ec.problems.expanding_sphere(coupling)
    out = {"nodes": len(space.nodes), "h": float(space.mesh_size(space.nodes))}
    try:
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            last = ec.study.final(ec.evolve(space, problem, order, step, END, mass="extrapolated"))
    except ec.EvolutionError as stop:
        fields = ec.errors.Errors._fields
        names = [*fields, *(f"{q}_lifted" for q in fields), "slope"]
        return out | {"t": stop.t} | dict.fromkeys(names, float("nan"))
    exact = exact_state(space, problem, END)
    slope = np.linalg.norm(space.gradient(exact.x, last.x - exact.x), axis=(2, 3)).max()
    lifted = ec.errors.lifted(space, problem, last)._asdict()
    return (
        out
        | {"t": last.t}
        | ec.errors.compare(space, problem, last)._asdict()
        | {f"{q}_lifted": error for q, error in lifted.items()}
        | {"slope": float(slope)}
    )


def lifted_sides(
    mesh: Mesh, refinements: int, degree: int, order: int, step: float
) -> dict[str, float]:
    """The left-hand sides of [N] (2.24)-(2.26) over a run with exact starting values, lifted.

    Parameters
    ----------
    mesh, refinements, degree, order, step
        As for :func:`errors_at_end`.

    Returns
    -------
    dict
        ``nodes``, ``h``; ``u``, ``v`` and ``x``, in time sampled about twenty times: the largest
        values, and for the sum in (2.24) every m-th term times m.

    Examples
    --------
    >>> sides = lifted_sides("octahedron", 1, 2, order=3, step=1 / 20)
    >>> print("{u:.0e} {v:.0e} {x:.0e}".format(**sides))
    4e-01 2e-01 2e-01
    """
    space, problem = make_space(mesh, refinements, degree), ec.problems.expanding_sphere()

    def norms(state: ec.State) -> Norms:
        e = ec.errors.lifted(space, problem, state)
        x, v = np.hypot([e.x_l2, e.v_l2], [e.x_h1, e.v_h1])
        return Norms(float(x), float(v), e.u_l2, e.u_l2**2 + e.u_h1**2)

    every = max(1, round(1 / (SAMPLES * step)))
    run = ec.evolve(space, problem, order, step, END, mass="extrapolated")
    return {
        "nodes": len(space.nodes),
        "h": float(space.mesh_size(space.nodes)),
        **left_hand_sides(run, norms, step, END, every),
    }


def time_errors(
    mesh: Mesh,
    refinements: int,
    degree: int,
    fine: float,
    runs: Sequence[tuple[int, Sequence[float]]],
    coupling: Coupling = "smooth",
) -> dict[str, list[float]]:
    """Errors of time discretization alone: distances at T = 1 from a run with p = 5.

    All runs start with states of that run, and all linear systems are solved directly.

    Parameters
    ----------
    mesh, refinements, degree
        See :func:`make_space`.
    fine : float
        Step of the run with p = 5.
    runs : sequence of (int, sequence of float)
        Orders p, and for each the steps, multiples of `fine`.
    coupling
        See :func:`esfem_core.problems.expanding_sphere`.

    Returns
    -------
    dict
        For each p and each norm a list ``p<p>_<norm>``, one number for each step.

    Examples
    --------
    >>> e = time_errors("octahedron", 0, 2, 1 / 320, [(2, [1 / 40, 1 / 80])])
    >>> print("{:.1f}".format(np.log2(e["p2_v_l2"][0] / e["p2_v_l2"][1])))
    2.0
    """
    space = make_space(mesh, refinements, degree)
    problem = ec.problems.expanding_sphere(coupling)
    options: dict[str, Any] = {"mass": "extrapolated", "solver": "direct"}
    states = list(ec.evolve(space, problem, 5, fine, END, start="euler", **options))
    out: dict[str, list[float]] = {}
    for p, steps in runs:
        for step in steps:
            k = round(step / fine)
            start = states[: p * k : k]
            run = ec.evolve(space, problem, p, step, END, start=start, **options)
            last = ec.study.final(run)
            for q, e in ec.errors.difference(space, last, states[-1])._asdict().items():
                out.setdefault(f"p{p}_{q}", []).append(e)
    return out


Case = dict[str, float | str]


def _cases(
    meshes: Iterable[tuple[str, int]], steps: Iterable[int], **others: float | str
) -> list[Case]:
    return [
        {"mesh": mesh, "refinements": r, "step": 1 / n, **others}
        for mesh, r in meshes
        for n in steps
    ]


def _meshes(mesh: str, refinements: Iterable[int]) -> list[tuple[str, int]]:
    return [(mesh, r) for r in refinements]


def _doubling(first: int, last: int) -> list[int]:
    return [first * 2**j for j in range(last.bit_length()) if first * 2**j <= last]


FIGURES_1_3 = [
    _cases([("octahedron", 6)], _doubling(10, 320), degree=2, order=3, coupling="smooth"),
    _cases([("octahedron", 5)], _doubling(10, 320), degree=2, order=3, coupling="printed"),
    _cases([("icosahedron", 4)], _doubling(10, 320), degree=2, order=3, coupling="smooth"),
    _cases([("distance", 3)], _doubling(10, 320), degree=2, order=3, coupling="smooth"),
]

FIGURES_2_4 = [
    _cases(_meshes("octahedron", range(1, 7)), [240], degree=2, order=5, coupling="smooth"),
    _cases(_meshes("icosahedron", range(5)), [240], degree=2, order=5, coupling="smooth"),
    _cases(_meshes("distance", range(4)), [240], degree=2, order=5, coupling="smooth"),
    _cases(_meshes("octahedron", range(1, 6)), [640], degree=2, order=3, coupling="smooth"),
    _cases(_meshes("octahedron", range(1, 6)), [640], degree=2, order=3, coupling="printed"),
]

# tau^p is proportional to h^k: both parts of the bound fall by 2^k with each refinement.
TABLE = [
    [
        {"mesh": "icosahedron", "refinements": r, "degree": k, "order": p}
        | {"step": 1 / round(20 * 2 ** (r * k / p))}
        for r in refinements
    ]
    for k, refinements in ((2, range(4)), (3, range(4)), (4, range(3)))
    for p in (2, 3, 4, 5)
]
TIME_TABLE = [
    {"mesh": "icosahedron", "refinements": r, "degree": k, "fine": 1 / 1280}
    | {"runs": [[p, [1 / n for n in (20, 40, 80, 160, 320)]] for p in (1, 2, 3, 4, 5)]}
    for k, r in ((2, 2), (3, 1), (4, 1))
]
# For the rates of 7.4, whose coupling needs edges on the coordinate planes.
TIME_PRINTED = [
    {"mesh": "octahedron", "refinements": r, "degree": 2, "fine": 1 / 1280}
    | {"runs": [[3, [1 / n for n in (20, 40, 80, 160, 320)]]], "coupling": "printed"}
    for r in (2, 3, 4)
]
SPACE_TABLE = [
    _cases(_meshes("icosahedron", range(4)), [320], degree=k, order=5) for k in (1, 2, 3, 4)
]

RESTRICTIONS = [
    _cases([("octahedron", r)], _doubling(first, last), degree=2, order=2)
    for r, first, last in (
        (1, 10, 20480),
        (2, 10, 2560),
        (3, 10, 2560),
        (4, 10, 1280),
        (5, 10, 640),
        (6, 5, 80),
    )
]
# What the theorem excludes: p = 1 and k = 1.
EXCLUDED = [
    *(_cases([("octahedron", r)], _doubling(10, 640), degree=2, order=1) for r in (1, 3, 5)),
    *(_cases([("octahedron", r)], _doubling(10, 640), degree=1, order=2) for r in (2, 4, 6)),
]

# Where g is evaluated near 0/0, the last digits decide: no small meshes, which tests recompute.
COUPLING = [
    [
        case | {"angle": angle}
        for angle in angles
        for case in _cases(_meshes(mesh, refinements), [160], degree=2, order=3, coupling=coupling)
    ]
    for mesh, refinements, coupling, angles in (
        ("octahedron", range(6), "printed", [0.0, 1e-9, 1e-6, 1e-3]),
        ("octahedron", range(3, 6), "printed", [0.01, 0.1, 0.3, 1.0]),
        ("icosahedron", range(2, 5), "printed", [0.0, 0.1, 0.3, 1.0]),
        ("distance", range(2, 4), "printed", [0.0]),
        ("octahedron", range(6), "smooth", [0.0, 0.3]),
        ("icosahedron", range(5), "smooth", [0.0, 0.3]),
    )
]

EXPERIMENTS = [
    Experiment(
        "nick_figures_1_3", "[N] Figures 1 and 3: convergence in time", errors_at_end, FIGURES_1_3
    ),
    Experiment(
        "nick_figures_2_4", "[N] Figures 2 and 4: convergence in space", errors_at_end, FIGURES_2_4
    ),
    Experiment("nick_table", "[N] Theorem 2.1 for all p and k", lifted_sides, TABLE),
    Experiment(
        "nick_table_time",
        "[N] Theorem 2.1: orders in time",
        time_errors,
        [TIME_TABLE, TIME_PRINTED],
    ),
    Experiment("nick_table_space", "[N] Theorem 2.1: orders in space", errors_at_end, SPACE_TABLE),
    Experiment(
        "nick_restrictions",
        "[N] Theorem 2.1 outside its restrictions",
        errors_at_end,
        RESTRICTIONS,
    ),
    Experiment(
        "nick_excluded", "[N] What Theorem 2.1 excludes: p = 1, k = 1", errors_at_end, EXCLUDED
    ),
    Experiment(
        "nick_coupling", "[N] 7.3: the printed coupling on turned meshes", errors_at_end, COUPLING
    ),
]
"""Those of the chapter on the expanding sphere."""
