"""Every term of the equation of a species, by manufactured solutions on a moving torus.

The motion is prescribed, neither rigid nor normal to the surface; see :mod:`manufactured`.
"""

from functools import cache

import numpy as np
import pytest
import sympy
from manufactured import FLOW, MovingSurface, T, X, numeric, torus_space

import esfem_core as ec
from esfem_core.study import observed_orders, time_study

SURFACE = MovingSurface()
U = 2 + sympy.cos(2 * T) * X[0] * X[1] + sympy.exp(-T) * X[2]
TENSOR = sympy.Matrix([[2 + X[1] / 2, X[0] / 4, 0], [X[0] / 4, 1, T * X[2]], [0, T * X[2], 1 + T]])
W = sympy.Matrix([X[1] * X[2], sympy.sin(X[0] + T), 1 + X[2] ** 2])
tensor, w = numeric(TENSOR), numeric(W)

# Each case: what the symbolic source is told, and what the solver is told.
CASES = {
    "plain": ({}, {}),
    "not conserved": ({"conserved": False}, {"conserved": False}),
    "small constant D": ({"D": sympy.Rational(1, 10)}, {"diffusivity": 0.1}),
    "D(u)": ({"D": 1 + U / 2}, {"diffusivity": lambda at: 1 + at.u / 2}),
    "D(u), not conserved": (
        {"D": 1 + U / 2, "conserved": False},
        {"diffusivity": lambda at: 1 + at.u / 2, "conserved": False},
    ),
    "D a tensor": ({"D": TENSOR}, {"diffusivity": lambda at: tensor(at.points, at.t)}),
    "D = 0": ({"D": 0}, {"diffusivity": 0.0}),
    "D = 0, not conserved": ({"D": 0, "conserved": False}, {"diffusivity": 0, "conserved": False}),
    "flux": ({"flux": W}, {"flux": lambda at: w(at.points, at.t)}),
    "flux of u": ({"flux": U * W}, {"flux": lambda at: at.u[..., None] * w(at.points, at.t)}),
    "flux of grad u, not conserved": (  # explicit, so D u/100 must be below D/(2^p - 1)
        {"flux": U / 100 * SURFACE.surface_gradient(U), "conserved": False},
        {"flux": lambda at: 0.01 * at.u[..., None] * at.grad_u, "conserved": False},
    ),
    "rate": ({"rate": 7}, {"rate": 7.0}),
    "rate(u)": (
        {"rate": U * (2 + sympy.sin(X[1]))},
        {"rate": lambda at: at.u * (2 + np.sin(at.points[..., 1]))},
    ),
    "all of it": (
        {"rate": 2 * U, "D": U * TENSOR, "flux": W * U},
        {
            "rate": lambda at: 2 * at.u,
            "diffusivity": lambda at: at.u[..., None, None] * tensor(at.points, at.t),
            "flux": lambda at: at.u[..., None] * w(at.points, at.t),
        },
    ),
}


@cache
def problem(case):
    symbolic, given = CASES[case]
    f, given = numeric(SURFACE.source(U, **symbolic)), dict(given)
    flux = given.pop("flux", None)

    def source(at):
        values = f(at.points, at.t)
        return values if flux is None else (values, flux(at))

    exact_u = numeric(U)
    return ec.Problem(
        species={"u": ec.Species(lambda x: exact_u(x, 0.0), source, **given)},
        law=ec.laws.Prescribed(FLOW.motion),
        exact=ec.Exact(
            FLOW.motion, lambda p, t: FLOW.velocity_field(FLOW.motion(p, t), t), exact_u
        ),
    )


COARSE = torus_space(2, 10, 4)


@pytest.mark.parametrize(
    "case",
    [case if case == "all of it" else pytest.param(case, marks=pytest.mark.slow) for case in CASES],
)
def test_bdf_has_its_order_in_time(case):
    """Against a fine run on the same mesh, whose states also start the runs.

    The fine run starts some time before, so that the restart of the spatial error by its exact
    starting values has decayed. The direct solver, since errors of p = 5 come near to the
    tolerance of the iterative one.
    """
    fine = list(ec.evolve(COARSE, problem(case), 5, 1 / 320, 0.5, solver="direct"))[32:]
    for p in (1, 2, 3, 4, 5):
        steps = [1 / 80, 1 / 160] if p < 5 else [1 / 40, 1 / 80]
        table = time_study(COARSE, problem(case), p, steps, 0.5, fine=fine, solver="direct")
        slack = 0.3 if p < 5 else 0.45  # p = 5 is late where coefficients depend on u
        for name in ("u_l2", "u_h1"):
            assert table.orders(name)[-1] == pytest.approx(p, abs=slack), (p, name)


MESHES = {1: [(20, 8), (40, 16)], 2: [(20, 8), (30, 12)], 3: [(20, 8), (30, 12)]}
PROVEN = {1: (2, 1), 2: (3, 2), 3: (4, 3)}  # orders in L2 and H1


@pytest.mark.parametrize("degree", MESHES)
@pytest.mark.parametrize("case", CASES)
def test_elements_have_their_order_in_space(case, degree):
    """Orders k + 1 in L2, k in H1, and above for k = 2, against the nodal interpolant.

    Without diffusion, a conserved u has an order less: the divergence of the interpolated velocity
    is wrong by O(h^k), and nothing smooths that.
    """
    sizes, errors = [], []
    for n, m in MESHES[degree]:
        space = torus_space(degree, n, m)
        *_, last = ec.evolve(space, problem(case), 4, 1 / 80, 0.25)
        sizes.append(1 / n)
        errors.append(ec.errors.compare(space, problem(case), last))
    loss = 1 if case == "D = 0" else 0
    for name, proven in zip(("u_l2", "u_h1"), PROVEN[degree], strict=True):
        [order] = observed_orders(sizes, [getattr(e, name) for e in errors])
        assert proven - loss - 0.3 < order < proven + 1.2, name
