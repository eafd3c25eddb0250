"""Heat on a surface from a mesh file: what is hot cools, what is cold warms, the mean stays."""

from pathlib import Path

import esfem_core as ec

# Any file of triangles will do: PLY, OBJ, STL, OFF, glTF; Gmsh, VTK and more with meshio.
path = Path("shape.ply")
if not path.exists():
    ec.torus(1.0, 0.4, 48, 20).export(path)
tri = ec.read_mesh(path)  # says what it found, and whether tri = ec.repair(tri) is needed
space = ec.SurfaceSpace(tri, degree=1)
print(space)

# The surface rests: every point p stays where it is. On it, du/dt = div(D grad u).
problem = ec.Problem(
    species={"u": ec.Species(lambda x: 20 + 10 * x[:, 0], diffusivity=0.5)},
    law=ec.laws.Prescribed(motion=lambda p, t: p),
)
for state in ec.evolve(space, problem, order=2, step=1 / 50, end=2.0):
    if round(state.t * 50) % 25 == 0:  # every half unit of time
        m, low, high = ec.measure(state), state.u.min(), state.u.max()
        print(f"t = {state.t:.1f}: mean {m.amount / m.area:.4f}, from {low:.3f} to {high:.3f}")
print(f"range at the end: {high - low:.4f}")
