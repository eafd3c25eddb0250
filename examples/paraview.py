"""Curved elements for ParaView: a series of VTU files, written while the run goes on."""

from pathlib import Path

import esfem_core as ec

tri = ec.sphere("octahedron", refinements=3)
space = ec.SurfaceSpace(tri, degree=2, project=ec.to_unit_sphere)
problem = ec.Problem(u0=lambda x: 1 + x[:, 0] * x[:, 1], g=lambda at: at.u, alpha=0.1, beta=0.1)

# Open growth.pvd in ParaView, also while this runs: it holds the times, and the files beside it
# hold the surface as Lagrange triangles with u and the velocity v. Every fourth state is enough.
states = ec.evolve(space, problem, order=2, step=1 / 40, end=1.0)
last = ec.save_series("growth.pvd", (s for n, s in enumerate(states) if n % 4 == 0), normals=True)

files = sorted(Path().glob("growth_*.vtu"))
print(f"{len(files)} files, the last one {files[-1].name} at t = {last.t:g}")
print(f"area {ec.measure(last).area:.4f}")
