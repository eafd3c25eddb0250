"""Steps as long as the motion allows: a pulse of growth at t = 1, and quiet before and after."""

import numpy as np

import esfem_core as ec


def adaptive(space, problem, p, step, end, tolerance):
    """Steps halved or lengthened by how well extrapolation foresees positions and functions."""
    states = list(ec.evolve(space, problem, p, step, (p - 1) * step))
    while end - states[-1].t > 1e-9 * step:
        step = min(step, end - states[-1].t)
        # The last ones are enough, and cost the same in every step.
        start = ec.respaced(states[-4 * p :], step, order=p)
        *_, new = ec.evolve(space, problem, p, step, start[-1].t + step, start=start)
        now, *before = ({"x": s.x, **s.fields} for s in (new, *start[::-1]))
        error = max(
            abs(w - sum(c * s[name] for c, s in zip(ec.bdf.gamma(p), before, strict=True))).max()
            / (abs(w).max() or 1.0)
            for name, w in now.items()
        )
        if error <= tolerance:
            states.append(new)
        step *= 1 / 2 if error > tolerance else 1 + 1 / p if error < tolerance / 4 else 1
    return states


space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), degree=2, project=ec.to_unit_sphere)
problem = ec.Problem(
    u0=lambda x: 1 + x[:, 2] / 2,
    g=lambda at: 8 * at.u / np.cosh(20 * (at.t - 1)) ** 2,
    alpha=0.1,
    beta=0.05,
)
states = adaptive(space, problem, p=3, step=1 / 20, end=2.0, tolerance=3e-3)
steps = np.diff([state.t for state in states])
amounts = [ec.measure(state).amount for state in states]
print(f"{len(steps)} steps, the shortest {steps.min():.4f}, the longest {steps.max():.3f}")
print(f"amount changes by {np.ptp(amounts) / amounts[0]:.0e}")

# As many equal steps, and many more to compare with.
*_, equal = ec.evolve(space, problem, 3, 2 / len(steps), 2.0)
*_, fine = ec.evolve(space, problem, 4, 1 / 400, 2.0)
for name, last in (("chosen", states[-1]), ("equal", equal)):
    print(f"error with {name} steps: {ec.errors.difference(space, last, fine).x_l2:.4f}")
