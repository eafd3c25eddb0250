"""A run that is saved while it goes on, read back, and continued as if nothing had happened."""

import numpy as np

import esfem_core as ec

space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), degree=2, project=ec.to_unit_sphere)
problem = ec.Problem(u0=lambda x: 1 + x[:, 2], g=lambda at: at.u, alpha=0.2, beta=0.1)
# With the direct solver the bits are the same; the default agrees to about nine digits.
options = {"order": 3, "step": 1 / 40, "solver": "direct"}

# The last states are on disk after every tenth step, and when the loop ends, here at t = 0.6.
for state in ec.evolve(space, problem, end=1.0, save="run.npz", every=10, **options):
    if state.t > 0.59:
        break

# Later, perhaps in another session. The file holds numbers; the problem is stated again.
space, states = ec.load("run.npz")
print(f"saved up to t = {states[-1].t:g}")
*_, last = ec.evolve(space, problem, end=1.0, start=states, **options)

*_, whole = ec.evolve(space, problem, end=1.0, **options)  # for comparison
print(
    f"difference: {np.abs(last.x - whole.x).max():g} in x, {np.abs(last.u - whole.u).max():g} in u"
)
print(f"area {ec.measure(last).area:.5f} at t = {last.t:g}")
