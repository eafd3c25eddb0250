"""Mean curvature flow: a sphere that shrinks towards a point, and how well its radius is kept."""

import numpy as np

import esfem_core as ec

# v = -H nu is the regularised law with alpha = 0, Dziuk's scheme of 1990. The elements are linear:
# with degree 2 and more it loses orders, except on spheres (see "Where this stands").
space = ec.SurfaceSpace(ec.sphere("icosahedron", 4), degree=1)
problem = ec.Problem(species={}, law=ec.laws.Regularised(alpha=0.0, beta=1.0))

# r^2 = 1 - 4 t: the sphere is a point at t = 1/4.
for state in ec.evolve(space, problem, order=3, step=1 / 400, end=0.24):
    if round(state.t * 400) % 16 == 0:
        r = np.linalg.norm(state.x, axis=1).mean()
        print(f"t = {state.t:.2f}: radius {r:.5f}, exact {np.sqrt(1 - 4 * state.t):.5f}")

print(f"area at the end: {ec.measure(state).area:.5f}, exact {4 * np.pi * 0.04:.5f}")
