"""SciPy's integrator on the matrix-vector equations gives what BDF converges to, with order p.

The right-hand sides are written out here from M, A and loads, as [N] (2.16) and [LMV] (2.7) have
them; of the package's time stepping nothing is used.
"""

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.sparse.linalg import spsolve

import esfem_core as ec
from esfem_core.study import final, observed_orders

SPACE = ec.SurfaceSpace(ec.sphere("octahedron", 1))
N, END = len(SPACE.nodes), 0.5


def initial(x):
    return 1 + x[:, 0] + x[:, 1] * x[:, 2]


def source(at):
    return at.u * np.cos(at.t) - 0.3 * at.u**2


def force(at):
    return 0.5 * at.u - 0.2 * at.points[..., 2]


def motion(p, t):
    """An ellipsoid that turns and stretches."""
    turned = p @ np.array([[np.cos(t), np.sin(t), 0], [-np.sin(t), np.cos(t), 0], [0, 0, 1]])
    return turned * [1 + 0.3 * np.sin(2 * t), 1.0, 1 + 0.2 * t**2]


PRESCRIBED = ec.Problem(initial, f=source, motion=motion)
COUPLED = ec.Problem(initial, f=source, g=force, alpha=0.7, beta=0.4)


def diffusion(x, Mu, t):
    """u, Γ_h[x] and d/dt (M u) = f - A u."""
    M, A = SPACE.mass_stiffness(x)
    u = spsolve(M.tocsc(), Mu)
    at = ec.Surface(SPACE, x, u, t)
    return u, at, SPACE.load(x, source(at)) - A @ u


def prescribed_rate(t, Mu):
    return diffusion(motion(SPACE.nodes, t), Mu, t)[-1]


def coupled_rate(t, y):
    x, Mu = y[: 3 * N].reshape(N, 3), y[3 * N :]
    _, at, rate = diffusion(x, Mu, t)
    M, A = SPACE.mass_stiffness(x)
    g = SPACE.load(x, force(at)[..., None] * at.normal)
    v = spsolve((M + COUPLED.law.alpha * A).tocsc(), g - COUPLED.law.beta * (A @ x))
    return np.concatenate([v.ravel(), rate])


@cache
def limits():
    """Solutions of both problems: from a time to positions and u."""
    Mu = SPACE.mass(SPACE.nodes) @ initial(SPACE.nodes)
    start = np.concatenate([SPACE.nodes.ravel(), Mu])
    options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13, "dense_output": True}
    w = solve_ivp(prescribed_rate, (0, END), Mu, **options).sol
    y = solve_ivp(coupled_rate, (0, END), start, **options).sol

    def prescribed(t):
        x = motion(SPACE.nodes, t)
        return x, diffusion(x, w(t), t)[0]

    def coupled(t):
        x = y(t)[: 3 * N].reshape(N, 3)
        return x, diffusion(x, y(t)[3 * N :], t)[0]

    return {"prescribed": prescribed, "coupled": coupled}


@pytest.mark.parametrize("p", [1, 2, 3, 4, 5])
@pytest.mark.parametrize(
    ("name", "problem", "mass"),
    [("prescribed", PRESCRIBED, "updated"), ("coupled", COUPLED, "extrapolated")],
)
def test_bdf_converges_to_the_semidiscrete_solution_with_its_order(name, problem, mass, p):
    limit = limits()[name]
    x, u = limit(END)
    steps, errors = [END / 48, END / 96], []
    for step in steps:
        early = [(j * step, *limit(j * step)) for j in range(p)]
        start = [ec.State(t, *(y, None, w), space=SPACE) for t, y, w in early]
        last = final(
            ec.evolve(SPACE, problem, p, step, END, mass=mass, start=start, solver="direct")
        )
        errors.append([abs(last.x - x).max(), abs(last.u - u).max()])
    moving = [1] if name == "prescribed" else [0, 1]  # a prescribed motion is exact
    for column in np.array(errors).T[moving]:
        assert column[1] < 0.05**p
        assert observed_orders(steps, column)[0] == pytest.approx(p, abs=0.1 * p)
