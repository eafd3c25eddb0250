"""Mean curvature flow: a sphere that shrinks towards a point, and how well its radius is kept."""

import numpy as np

import esfem_core as ec

# v = -H nu, with the normal nu and the curvature H from equations of their own, which start from
# the mesh. The elements are of degree 2, as the theory wants (see the chapter "Velocity laws").
space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), degree=2, project=ec.to_unit_sphere)
problem = ec.Problem(species={}, law=ec.laws.MeanCurvature(beta=1.0))

# r^2 = 1 - 4 t: the sphere is a point at t = 1/4.
for state in ec.evolve(space, problem, order=3, step=1 / 400, end=0.24):
    if round(state.t * 400) % 16 == 0:
        r = np.linalg.norm(state.x, axis=1).mean()
        print(f"t = {state.t:.2f}: radius {r:.5f}, exact {np.sqrt(1 - 4 * state.t):.5f}")

print(f"area at the end: {ec.measure(state).area:.5f}, exact {4 * np.pi * 0.04:.5f}")
