"""[N] Theorem 2.1: the errors of a whole run over a grid of mesh and step sizes."""

import numpy as np

import esfem_core as ec
from esfem_core.companion.campaign import Experiment
from esfem_core.errors import seminorm
from esfem_core.surfaces import displaced
from esfem_core.theory.defects import interpolant, values_of

__all__ = ["EXPERIMENTS", "errors_of_a_run"]


def errors_of_a_run(
    order: int, degree: int, refinements: int, step: float, end: float = 1.0
) -> dict[str, float]:
    """Norms of (2.24)-(2.26) for the expanding sphere of [N] 7.3 with the smooth coupling.

    The mesh is an icosahedron with displaced vertices; errors are those of nodal values.

    Parameters
    ----------
    order, degree, refinements : int
    step, end : float

    Returns
    -------
    dict
        "h" of the initial mesh; "x" and "v", the largest H1 norms, and "u", the largest L2 norm
        plus the H1 norms summed over time.
    """
    tri = displaced(ec.sphere("icosahedron", refinements), 0.2, ec.to_unit_sphere)
    space = ec.SurfaceSpace(tri, degree, ec.to_unit_sphere)
    problem = ec.problems.expanding_sphere()
    worst, sum_u = np.zeros(3), 0.0
    for state in ec.evolve(space, problem, order, step, end):
        if state.v is None:
            continue
        x, u, v = values_of(interpolant(space, problem, state.t))
        M, A = space.mass_stiffness(x)
        K, e_u = M + A, state.u - u
        errors = seminorm(K, state.x - x), seminorm(K, state.v - v), seminorm(M, e_u)
        worst = np.maximum(worst, errors)
        sum_u += step * seminorm(K, e_u) ** 2
    names = dict(zip("xvu", worst.tolist(), strict=True))
    names["u"] += float(np.sqrt(sum_u))
    return {"h": space.mesh_size(space.nodes), **names}


EXPERIMENTS = [
    Experiment(
        name="nick_theorem",
        title="[N] Theorem 2.1: errors over a grid of mesh and step sizes",
        compute=errors_of_a_run,
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
