"""A force that jumps: a sphere that grows, and from t = 1/2 on shrinks."""

import numpy as np

import esfem_core as ec

ALPHA = 0.1
T = 1 / 2  # the time of the jump


def force(at):
    """Number g of the law: 1 up to T, -1/2 from then on."""
    return np.full(at.density.shape, 1.0 if at.t < T + 1e-9 else -0.5)


def radius_error(state):
    """Against r - 2 alpha/r = 1 - 2 alpha + (integral of g): (1 + 2 alpha/r^2) r' = g."""
    c = 1 - 2 * ALPHA + T - (state.t - T) / 2
    exact = (c + np.sqrt(c**2 + 8 * ALPHA)) / 2
    return abs(np.linalg.norm(state.x, axis=1).mean() - exact)


space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), degree=6, project=ec.to_unit_sphere)
problem = ec.Problem(g=force, alpha=ALPHA, beta=0.0)
for p in (1, 2, 3):
    for name in ("in one run", "started anew"):
        errors = []
        for n in (40, 80):
            if name == "in one run":
                *_, last = ec.evolve(space, problem, p, 1 / n, end=1.0)
            else:
                *_, state = ec.evolve(space, problem, p, 1 / n, end=T)
                start = ec.started_anew(state, problem, p, 1 / n)
                *_, last = ec.evolve(space, problem, p, 1 / n, end=1.0, start=start)
            errors.append(radius_error(last))
        order = np.log2(errors[0] / errors[1])
        print(f"p = {p}, {name}: {errors[0]:.1e} {errors[1]:.1e}, order {order:.2f}")
