"""[N] 7.4, Figure 5: mass matrices at extrapolated or at computed positions, (2.19) or (7.2)."""

from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csr_array

import esfem_core as ec
from esfem_core.checks import Array, one_of, whole_number
from esfem_core.problems import Coupling
from esfem_core.stepping import Mass, exact_state
from esfem_core.study import Experiment

__all__ = ["EXPERIMENTS", "SURFACES", "compare_masses", "orders"]

MASSES: tuple[Mass, ...] = ("extrapolated", "reassembled", "updated")
TIMES = (0.5, 1.0)
AXES = np.array([1.0, 0.8, 0.6])  # of the ellipsoid


def compare_masses(
    *, refinements: int, steps_per_unit: int, coupling: Coupling = "smooth"
) -> dict[str, Any]:
    """Solve the expanding sphere with the three mass terms and compare.

    Norms are (L2^2 + H1 seminorm^2)^{1/2}, as in Figure 5. Quadratic elements on an octahedron,
    BDF3, exact starting values.

    Parameters
    ----------
    refinements : int
        Of the octahedron: 4^{r+2} + 2 nodes.
    steps_per_unit : int
        1/tau, even.
    coupling : {"smooth", "printed"}
        As for :func:`esfem_core.problems.expanding_sphere`.

    Returns
    -------
    dict
        "nodes", "h", and lists with values at t = 1/2 and t = 1. On Γ_h[x_*]: "difference" of
        (7.2) from (2.19) in u and "difference_x" in x, "difference_updated" of M(x^n) on all
        levels from (2.19); "error" and "error_x", those of (2.19) in u and x against the nodal
        interpolant; "size", the norm of the exact u. "lifted": the error in u on the exact surface
        (:func:`esfem_core.errors.lifted`). Errors of the other two mass terms have the suffixes
        "_reassembled" and "_updated".

    Raises
    ------
    ValueError
        If `steps_per_unit` is odd.

    Examples
    --------
    >>> row = compare_masses(refinements=1, steps_per_unit=80)
    >>> print(f"{row['difference'][0] / row['size'][0] * 80**2:.0f}")
    12
    """
    steps_per_unit = whole_number("steps_per_unit", steps_per_unit, 2)
    if steps_per_unit % 2:
        raise ValueError(f"steps_per_unit must be even, to meet t = 1/2, got {steps_per_unit}")
    space = ec.SurfaceSpace(ec.sphere("octahedron", refinements), 2, ec.to_unit_sphere)
    problem = ec.problems.expanding_sphere(coupling)
    runs = [
        ec.evolve(space, problem, 3, 1 / steps_per_unit, 1.0, mass=mass, start="exact")
        for mass in MASSES
    ]
    marks = [round(t * steps_per_unit) for t in TIMES]
    rows: list[dict[str, float]] = []
    for states in islice(zip(*runs, strict=True), marks[0], None, marks[1] - marks[0]):
        one, two, three = states
        exact = exact_state(space, problem, one.t)
        norm = partial(_norm, *space.mass_stiffness(exact.x))
        row = {
            "difference": norm(two.u - one.u),
            "difference_updated": norm(three.u - one.u),
            "difference_x": norm(two.x - one.x),
            "size": norm(exact.u),
        }
        for suffix, state in (("", one), ("_reassembled", two), ("_updated", three)):
            lifted = ec.errors.lifted(space, problem, state)
            row |= {
                f"error{suffix}": norm(state.u - exact.u),
                f"error_x{suffix}": norm(state.x - exact.x),
                f"lifted{suffix}": float(np.hypot(lifted.u_l2, lifted.u_h1)),
            }
        rows.append(row)
    return {
        **{name: [row[name] for row in rows] for name in rows[0]},
        "nodes": len(space.nodes),
        "h": space.mesh_size(space.nodes),
    }


def _norm(M: csr_array, A: csr_array, w: Array) -> float:
    """(L2^2 + H1 seminorm^2)^{1/2} of nodal values."""
    return float(np.hypot(ec.errors.seminorm(M, w), ec.errors.seminorm(A, w)))


class Setting(NamedTuple):
    """A problem, a mesh and the times between which runs are compared."""

    problem: Callable[[], ec.Problem]
    space: Callable[[], ec.SurfaceSpace]
    begin: float
    end: float


def _to_ellipsoid(x: Array) -> Array:
    return AXES * ec.to_unit_sphere(x / AXES)


def _ellipsoid_mesh() -> ec.SurfaceSpace:
    tri = ec.sphere("icosahedron", 1)
    tri.vertices = tri.vertices * AXES
    return ec.SurfaceSpace(tri, 2, _to_ellipsoid)


def _ellipsoid() -> ec.Problem:
    """An ellipsoid that grows by what it carries, more at one end; f = 0."""
    return ec.Problem(u0=lambda x: 3 + x[:, 0] + x[:, 1] * x[:, 2], g=lambda at: at.u)


def _sphere_mesh() -> ec.SurfaceSpace:
    return ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)


SURFACES = {
    "growing sphere": Setting(ec.problems.growing_sphere, _sphere_mesh, 0.25, 1.0),
    "ellipsoid": Setting(_ellipsoid, _ellipsoid_mesh, 0.25, 1.0),
    "expanding sphere": Setting(
        lambda: ec.problems.expanding_sphere("smooth"), _sphere_mesh, 0.0, 0.5
    ),
}
"""Their problems have no explicit time, except that of the expanding sphere, which begins at 0."""


@lru_cache(maxsize=1)
def _fine_run(surface: str, fine: int) -> tuple[ec.Problem, ec.SurfaceSpace, list[ec.State]]:
    """The run that all orders are compared with, from time 0 at `begin`."""
    make_problem, make_space, begin, end = SURFACES[surface]
    problem, space = make_problem(), make_space()
    past = ec.evolve(
        space, problem, 5, 1 / fine, end, mass="extrapolated", start="euler", solver="direct"
    )
    states = [ec.State(s.t - begin, s.x, s.v, s.u) for s in islice(past, round(begin * fine), None)]
    return problem, space, states


def orders(*, surface: str, order: int, steps_per_unit: Sequence[int], fine: int) -> dict[str, Any]:
    """Distances in time from a fine run on the same mesh, 162 nodes, for the three mass terms.

    Starting values are those of the fine run (p = 5, mass="extrapolated"), on the growing sphere
    and the ellipsoid past the layer in which a discrete initial value settles. Direct solves.

    Parameters
    ----------
    surface : str
        Key of `SURFACES`.
    order : int
        p.
    steps_per_unit : sequence of int
        Values of 1/tau, divisors of `fine`.
    fine : int
        1/tau of the fine run.

    Returns
    -------
    dict
        For each mass term lists over the steps: "<mass>_u", "<mass>_x", L2 norms of the
        distances, and "<mass>_u_h1"; where f = 0 also "<mass>_amount", the relative change of the
        integral of u over Γ_h[x^n] from begin to end.

    Raises
    ------
    ValueError
        If there is no such surface, or a number of steps does not divide `fine`.

    Examples
    --------
    >>> row = orders(surface="ellipsoid", order=2, steps_per_unit=[40, 80], fine=320)
    >>> for mass in ("updated", "reassembled"):
    ...     coarse, fine = row[f"{mass}_u"]
    ...     print(f"{mass}: {coarse / fine:.1f}")
    updated: 4.0
    reassembled: 2.0
    """
    one_of("surface", surface, tuple(SURFACES))
    if any(fine % n for n in steps_per_unit):
        raise ValueError(f"steps_per_unit must divide fine = {fine}, got {list(steps_per_unit)}")
    problem, space, states = _fine_run(surface, fine)

    def amount(state: ec.State) -> float:
        return float(space.load(state.x, space.evaluate(state.u)).sum())

    results: dict[str, list[float]] = {}
    for mass in MASSES:
        for steps in steps_per_unit:
            every = fine // steps
            run = ec.evolve(
                space,
                problem,
                order,
                1 / steps,
                states[-1].t,
                mass=mass,
                start=states[: order * every : every],
                solver="direct",
            )
            last = ec.study.final(run)
            e = ec.errors.difference(space, last, states[-1])
            row = {"u": e.u_l2, "u_h1": e.u_h1, "x": e.x_l2}
            if problem.species["u"].source is None:
                row["amount"] = amount(last) / amount(states[0]) - 1
            for name, value in row.items():
                results.setdefault(f"{mass}_{name}", []).append(value)
    return results


EXPERIMENTS = [
    Experiment(
        "nick_figure_5",
        "[N] Figure 5: (2.19) and (7.2) on the expanding sphere, BDF3",
        compare_masses,
        [
            [
                {"refinements": r, "steps_per_unit": n}
                for n in (20, 40, 80, 160, 320, 640)[: 6 if r < 6 else 5]
            ]
            for r in (2, 3, 4, 5, 6)
        ]
        + [
            [
                {"refinements": r, "steps_per_unit": n, "coupling": "printed"}
                for n in (20, 40, 80, 160, 320)
            ]
            for r in (3, 4, 5)
        ],
    ),
    Experiment(
        "nick_mass_order",
        "[N] (7.2): its order, p = 1 to 5, on three surfaces",
        orders,
        [
            [
                {
                    "surface": surface,
                    "order": p,
                    "steps_per_unit": [20, 40, 80, 160, 320, 640],
                    "fine": 2560,
                }
                for p in range(1, 6)
            ]
            for surface in SURFACES
        ],
    ),
]
