"""Compute the errors and write the meshes of the benchmark set: python benchmarks/set/make.py.

A few minutes on one core; needs the extras "files" and "symbolic". What the set is, says the page
"A benchmark set" of the book.
"""

import json
from pathlib import Path

import meshio
import numpy as np

import esfem_core as ec
from esfem_core.laws import MeanCurvature
from esfem_core.study import final

HERE = Path(__file__).parent
LEVELS = (1, 2, 3)
FINEST = LEVELS[-1]
ROUNDING = 1e-9
TORUS = ec.exact_surfaces.Torus(1.0, 0.4)
GROWN = "(1 + t/(4*sqrt(p1**2 + p2**2)))"


def sphere(level):
    """Octahedral mesh: 258, 1,026 and 4,098 nodes."""
    return ec.sphere("octahedron", level + 1), ec.to_unit_sphere


def torus(level):
    """256, 1,024 and 4,096 nodes."""
    return ec.torus(1.0, 0.4, 8 * 2**level, 2 * 2**level), TORUS.closest


def moving_torus():
    """A torus that grows and is sheared, with the source and the force that this needs."""
    return ec.manufactured(
        "(sqrt(x1**2 + x2**2) - 1 - t/4)**2 + (x3 - t*x1/2)**2 - (2/5)**2",
        [f"p1*{GROWN}", f"p2*{GROWN}", f"p3 + t/2*p1*{GROWN}"],
        "x1*x3 + exp(-t)",
        alpha=0.5,
        beta=0.2,
    )


def shrinking_torus():
    """Mean curvature flow, with normals and curvatures of the exact torus to start from."""
    law = MeanCurvature(normal=TORUS.normal, curvature=TORUS.mean_curvature)
    return ec.Problem(species={}, law=law)


PROBLEMS = {  # problem, mesh, end
    "lmv-1": (ec.problems.oscillating_ellipsoid, sphere, 1.0),
    "lmv-2": (ec.problems.baseball_bat, sphere, 1.0),
    "nick-7.3": (ec.problems.expanding_sphere, sphere, 1.0),
    "growing-sphere": (ec.problems.growing_sphere, sphere, 1.0),
    "shrinking-sphere": (ec.problems.shrinking_sphere, sphere, 0.5),
    "logistic-sphere": (ec.problems.logistic_sphere, sphere, 1.0),
    "moving-torus": (moving_torus, torus, 1.0),
    "shrinking-torus": (shrinking_torus, torus, 0.05),
}


def quadratic(surface, level):
    """The space of degree 2 on a mesh of the set."""
    tri, project = surface(level)
    return ec.SurfaceSpace(tri, 2, project)


def runs(end):
    """(Level, order, step): the meshes with small steps, the finest one with all orders."""
    yield from ((level, 4, end / 160) for level in LEVELS)
    yield from ((FINEST, order, end / n) for order in range(1, 6) for n in (20, 40))


def measured(space, problem, order, step, end, solver="lagged"):
    """Errors, or functionals where no solution is known."""
    start = "euler" if problem.exact is None else "exact"
    run = ec.evolve(
        space, problem, order, step, end, mass="extrapolated", start=start, solver=solver
    )
    last = final(run)
    if problem.exact is not None:
        return ec.errors.compare(space, problem, last)._asdict()
    at = last.surface()
    found = ec.measure(last)
    functionals = {"area": found.area, "volume": found.volume}
    return functionals | ({"u_square": float(at.integral(at.u**2))} if "u" in last.fields else {})


def rows():
    """All rows of errors.json: each number with how far another program of the scheme may be off.

    Errors have three digits, functionals eight; two units of the last one are what linear solvers
    of 1e-11 and other orders of summation leave open, generously.
    """
    for name, (make, surface, end) in PROBLEMS.items():
        problem = make()
        spaces = {level: quadratic(surface, level) for level in LEVELS}
        for level, order, step in runs(end):
            values = measured(spaces[level], problem, order, step, end)
            digits = 8 if problem.exact is None else 3
            row = {"problem": name, "mesh": f"{surface.__name__}_{level}", "order": order}
            row |= {"step": step, "measured": {k: rounded(v, digits) for k, v in values.items()}}
            print(json.dumps(row), flush=True)
            yield row


def rounded(value, digits):
    """A value to some digits, and two units of the last one; rounding errors are zeros."""
    if abs(value) < ROUNDING:
        return [0.0, ROUNDING]
    unit = float(f"1e{int(np.floor(np.log10(abs(value)))) - digits + 1}")
    return [float(f"{value:.{digits - 1}e}"), 2 * unit]


def write_meshes():
    """Elements of degree 2 with nodes on the surface, VTK's order."""
    (HERE / "meshes").mkdir(exist_ok=True)
    for surface in (sphere, torus):
        for level in LEVELS:
            space = quadratic(surface, level)
            mesh = meshio.Mesh(space.nodes, [("triangle6", space.cells)])
            mesh.write(HERE / "meshes" / f"{surface.__name__}_{level}.vtu")


if __name__ == "__main__":
    write_meshes()
    lines = ",\n".join(json.dumps(row) for row in rows())
    (HERE / "errors.json").write_text(f"[\n{lines}\n]\n")
