"""[N] 7.3 and 7.4: the expanding sphere, Figures 1 to 4, and how far Theorem 2.1 reaches."""

from collections.abc import Iterable, Sequence

import numpy as np
import trimesh
from numpy.typing import NDArray

from esfem_core import errors, problems
from esfem_core.companion.campaign import Experiment
from esfem_core.elements import SurfaceSpace
from esfem_core.errors import Errors
from esfem_core.stepping import EvolutionError, evolve
from esfem_core.study import final
from esfem_core.surfaces import from_level_set, sphere, to_unit_sphere

__all__ = ["EXPERIMENTS", "make_space", "run", "theorem", "time_errors"]

END = 1.0
SAMPLES = 20
AXIS = np.array([1.0, 2.0, 3.0]) / np.sqrt(14)  # of the turned meshes


def make_space(mesh: str, refinements: int, degree: int, angle: float = 0.0) -> SurfaceSpace:
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

    Examples
    --------
    >>> space = make_space("octahedron", 1, 2, angle=0.5)
    >>> len(space.nodes), bool(abs(space.nodes[0, 0] - 1) > 0.1)
    (66, True)
    """
    if mesh == "distance":
        tri = from_level_set(_distance, [[-1.3] * 3, [1.3] * 3], 0.6 / 2**refinements)
    else:
        tri = sphere(mesh, refinements)
    if angle:
        turn = trimesh.transformations.rotation_matrix(angle, AXIS)[:3, :3]
        tri = trimesh.Trimesh(tri.vertices @ turn.T, tri.faces, process=False)
    return SurfaceSpace(tri, degree, to_unit_sphere)


def _distance(x: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.linalg.norm(x, axis=1)) - 1


def run(
    mesh: str,
    refinements: int,
    degree: int,
    order: int,
    step: float,
    coupling: str = "smooth",
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
    >>> errors = run("octahedron", 1, 2, order=3, step=1 / 20)
    >>> print("{nodes} {x_l2:.0e} {u_l2:.0e} {u_l2_lifted:.0e}".format(**errors))
    66 8e-03 2e-02 2e-02
    """
    space, problem = (
        make_space(mesh, refinements, degree, angle),
        problems.expanding_sphere(coupling),
    )
    out = {"nodes": len(space.nodes), "h": float(space.mesh_size(space.nodes))}
    try:
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            last = final(evolve(space, problem, order, step, END))
    except EvolutionError as stop:
        names = [*Errors._fields, *(f"{q}_lifted" for q in Errors._fields), "slope"]
        return out | {"t": stop.t} | dict.fromkeys(names, float("nan"))
    x_exact = problem.exact.x(space.nodes, END)  # type: ignore[union-attr]
    slope = np.linalg.norm(space.gradient(x_exact, last.x - x_exact), axis=(2, 3)).max()
    return (
        out
        | {"t": last.t}
        | errors.compare(space, problem, last)._asdict()
        | {f"{q}_lifted": e for q, e in errors.lifted(space, problem, last)._asdict().items()}
        | {"slope": float(slope)}
    )


def theorem(mesh: str, refinements: int, degree: int, order: int, step: float) -> dict[str, float]:
    """The left-hand sides of [N] (2.24)-(2.26) over a run with exact starting values.

    Parameters
    ----------
    mesh, refinements, degree, order, step
        As for :func:`run`.

    Returns
    -------
    dict
        ``nodes``, ``h``; ``u``, ``v`` and ``x``, in time sampled about twenty times: the largest
        values, and for the sum in (2.24) every m-th term times m.

    Examples
    --------
    >>> sides = theorem("octahedron", 1, 2, order=3, step=1 / 20)
    >>> print("{u:.0e} {v:.0e} {x:.0e}".format(**sides))
    4e-01 2e-01 2e-01
    """
    space, problem = make_space(mesh, refinements, degree), problems.expanding_sphere()
    u_l2 = squares = v = x = 0.0
    every = max(1, round(1 / (SAMPLES * step)))
    for n, state in enumerate(evolve(space, problem, order, step, END)):
        if n >= order and (round(END / step) - n) % every == 0:
            e = errors.lifted(space, problem, state)
            squares += every * step * (e.u_l2**2 + e.u_h1**2)
            u_l2 = max(u_l2, e.u_l2)
            v, x = max(v, np.hypot(e.v_l2, e.v_h1)), max(x, np.hypot(e.x_l2, e.x_h1))
    return {
        "nodes": len(space.nodes),
        "h": float(space.mesh_size(space.nodes)),
        "u": u_l2 + float(np.sqrt(squares)),
        "v": float(v),
        "x": float(x),
    }


def time_errors(
    mesh: str,
    refinements: int,
    degree: int,
    fine: float,
    runs: Sequence[tuple[int, Sequence[float]]],
) -> dict[str, list[float]]:
    """Errors of time discretisation alone: distances at T = 1 from a run with p = 5.

    All runs start with states of that run, and all linear systems are solved directly.

    Parameters
    ----------
    mesh, refinements, degree
        See :func:`make_space`.
    fine : float
        Step of the run with p = 5.
    runs : sequence of (int, sequence of float)
        Orders p, and for each the steps, multiples of `fine`.

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
    space, problem = make_space(mesh, refinements, degree), problems.expanding_sphere()
    states = list(evolve(space, problem, 5, fine, END, start="euler", solver="direct"))
    out: dict[str, list[float]] = {}
    for p, steps in runs:
        for step in steps:
            k = round(step / fine)
            last = final(
                evolve(space, problem, p, step, END, start=states[: p * k : k], solver="direct")
            )
            for q, e in errors.difference(space, last, states[-1])._asdict().items():
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
    Experiment("nick_figures_1_3", "[N] Figures 1 and 3: convergence in time", run, FIGURES_1_3),
    Experiment("nick_figures_2_4", "[N] Figures 2 and 4: convergence in space", run, FIGURES_2_4),
    Experiment("nick_table", "[N] Theorem 2.1 for all p and k", theorem, TABLE),
    Experiment("nick_table_time", "[N] Theorem 2.1: orders in time", time_errors, [TIME_TABLE]),
    Experiment("nick_table_space", "[N] Theorem 2.1: orders in space", run, SPACE_TABLE),
    Experiment("nick_restrictions", "[N] Theorem 2.1 outside its restrictions", run, RESTRICTIONS),
    Experiment("nick_excluded", "[N] What Theorem 2.1 excludes: p = 1, k = 1", run, EXCLUDED),
    Experiment("nick_coupling", "[N] 7.3: the printed coupling on turned meshes", run, COUPLING),
]
"""Those of the chapter on the expanding sphere."""
