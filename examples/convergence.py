"""A convergence study in time and in space, against an exact solution."""

import esfem_core as ec
from esfem_core.study import space_study, time_study

# The thesis' experiment: a sphere of radius 1 + sin(pi t)/2 that carries u = exp(-t^2) x1 x2 x3.
problem = ec.problems.expanding_sphere()


def sphere(refinements, degree):
    return ec.SurfaceSpace(ec.sphere("icosahedron", refinements), degree, ec.to_unit_sphere)


# In time: elements of degree 4, so that what is left is the error of BDF2.
times = time_study(sphere(1, degree=4), problem, 2, [1 / 20, 1 / 40, 1 / 80], end=1.0)
print("BDF2, errors at the nodes, in L2")
print(times.select("x_l2", "u_l2"))

# In space: BDF4 with small steps. These errors are measured on the exact surface; the theorem says
# h^2 in H1 for elements of degree 2.
spaces = [sphere(refinements, degree=2) for refinements in (1, 2, 3)]
meshes = space_study(spaces, problem, 4, 1 / 80, end=1.0, measure=ec.errors.lifted)
print("degree 2, errors on the exact surface")
print(meshes.select("u_l2", "u_h1"))

print(f"order in time: {times.orders('u_l2')[-1]:.2f}")
print(f"order in space, H1: {meshes.orders('u_h1')[-1]:.2f}")
