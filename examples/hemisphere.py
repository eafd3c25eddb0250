"""Diffusion on a growing dome: insulated at its rim, or held at zero there."""

import numpy as np

import esfem_core as ec

# The equator of an octahedral sphere consists of edges: keep the triangles above it.
tri = ec.sphere("octahedron", refinements=3)
tri.update_faces(tri.triangles_center[:, 2] > 0)
tri.remove_unreferenced_vertices()
space = ec.SurfaceSpace(tri, degree=2, project=ec.to_unit_sphere, boundary=True)
print(space)
print(f"nodes on the boundary: {len(space.boundary_nodes)}")

# Points move by X(p, t) = r p with r^2 = 1 + t, and u' + u div v = lap u. Nothing passes the rim
# of "insulated" (the natural condition), and "cold" is zero there.
problem = ec.Problem(
    species={
        "insulated": ec.Species(lambda x: x[:, 2]),
        "cold": ec.Species(lambda x: x[:, 2], fixed=0.0),
    },
    law=ec.laws.Prescribed(motion=lambda p, t: np.sqrt(1 + t) * p),
)
for state in ec.evolve(space, problem, order=3, step=1 / 40, end=1.0):
    if round(state.t * 40) % 10 == 0:  # every quarter unit of time
        amounts = ec.measure(state).amounts
        listed = ", ".join(f"{name} {amount:.5f}" for name, amount in amounts.items())
        print(f"t = {state.t:.2f}: amounts {listed}")

# "cold" is known: (1 + t)^(-7/2) x3.
difference = state["cold"] - (1 + state.t) ** -3.5 * state.x[:, 2]
print(f"largest error of cold: {np.abs(difference).max():.1e}")
warm, cold = state["insulated"], state["cold"]
print(f"at the rim: insulated {warm[space.boundary_nodes].mean():.4f}", end=", ")
print(f"cold {np.abs(cold[space.boundary_nodes]).max():g}")
