"""Halves of spheres: surfaces with a boundary, and problems on one that moves."""

import dataclasses

import numpy as np

import esfem_core as ec

AXES = ("1 + sin(t)/4", "1", "1 + t/2")
LEVEL = " + ".join(f"(x{i}/({axis}))**2" for i, axis in enumerate(AXES, 1)) + " - 1"
MOTION = tuple(f"p{i}*({axis})" for i, axis in enumerate(AXES, 1))
NATURAL = "exp(-2*t)*(1 + x1*x2 + x3**2)"  # even in x3: no flux at the equator
FIXED = "exp(-2*t)*(1 + x1*x2 + x3 + x1*x3)"  # neither values nor fluxes are zero there


def upper_half(tri):
    """The triangles above the plane x3 = 0."""
    tri = tri.copy()
    tri.update_faces(tri.triangles_center[:, 2] > 0)
    tri.remove_unreferenced_vertices()
    return tri


def hemisphere(refinements, degree=1):
    """Space on the upper half of the unit sphere; the equator consists of edges."""
    tri = upper_half(ec.sphere("octahedron", refinements))
    return ec.SurfaceSpace(tri, degree, ec.to_unit_sphere, boundary=True)


def moving(u):
    """Diffusion with the solution u on half an ellipsoid, whose equator stays in its plane.

    With values at the boundary, unless u fulfils the natural condition.
    """
    made = ec.manufactured(LEVEL, MOTION, u, prescribed=True)
    fixed = None if u == NATURAL else made.exact.u
    species = dataclasses.replace(made.species["u"], fixed=fixed)
    return ec.Problem(species={"u": species}, law=made.law, exact=made.exact)


def growing(fixed):
    """The same in closed form on half a sphere of radius r = 1 + t/2.

    u is cos(3 t) times harmonic polynomials Y of degree l, 1 and x1 x2, and x3 where there are
    values at the boundary: Y' + Y div v - lap Y is ((l + 2) r'/r + l (l + 1)/r^2) Y.
    """

    def parts(x):
        return 1 + 0 * x[..., 0], x[..., 2] * fixed, x[..., 0] * x[..., 1]

    def exact(x, t):
        return np.cos(3 * t) * sum(parts(x))

    def source(at):
        r, c, s = 1 + at.t / 2, np.cos(3 * at.t), np.sin(3 * at.t)
        factors = (c * ((n + 2) / (2 * r) + n * (n + 1) / r**2) - 3 * s for n in range(3))
        return sum(a * y for a, y in zip(factors, parts(at.points), strict=True))

    def motion(p, t):
        return (1 + t / 2) * p

    return ec.Problem(
        species={
            "u": ec.Species(lambda x: exact(x, 0), source, fixed=exact if fixed else None),
        },
        law=ec.laws.Prescribed(motion),
        exact=ec.Exact(motion, lambda p, t: p / 2, exact),
    )
