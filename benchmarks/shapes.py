"""Meshes on which plane cuts, or fronts, may go wrong: ten steps of heat, set-up included.

Every mesh has some thousand vertices. The run is that of a user with default options, linear
elements on a surface at rest; the other solver is CHOLMOD.
"""

import numpy as np
import trimesh
from timing import seconds, summary
from trimesh import creation

import esfem_core as ec


def shapes():
    """Names and meshes."""
    ball = creation.icosphere(4)
    rng = np.random.default_rng(0)
    points = rng.standard_normal((6000, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    many = [creation.icosphere(2).apply_translation([3 * i, 0, 0]) for i in range(40)]
    return {
        "rings and hubs (cylinder)": creation.cylinder(1, 2, sections=3000),
        "a fan (cone)": creation.cone(1, 2, sections=3000),
        "long triangles between rings (annulus)": creation.annulus(0.5, 1, 1, sections=1500),
        "two hubs of 100 triangles (grid of angles)": creation.uv_sphere(count=[100, 100]),
        "a capsule": creation.capsule(4, 1, count=[100, 100]),
        "a needle": ball.copy().apply_scale([50, 1, 1]),
        "a long box": creation.box([200, 1, 1]).subdivide_to_size(1.5),
        "a thin ring (torus)": creation.torus(10, 0.1, major_sections=1200, minor_sections=5),
        "a plate with 400 holes": plate(20),
        "40 parts": trimesh.util.concatenate(many),
        "random triangles (convex hull)": trimesh.convex.convex_hull(points),
        "a sphere": ball,
    }


def plate(n):
    """A plate with n x n square holes, its faces cut into triangles."""
    filled = np.zeros((2 * n + 3, 2 * n + 3, 3), dtype=bool)
    filled[1:-1, 1:-1, 1] = True
    filled[2:-2:2, 2:-2:2, 1] = False
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    quads = []
    for axis in range(3):
        for side in (0, 1):
            outside = ~np.roll(filled, 1 - 2 * side, axis)
            cell = np.argwhere(filled & outside)
            square = np.zeros((4, 3), dtype=int)
            square[:, [(axis + 1) % 3, (axis + 2) % 3]] = corners
            square[:, axis] = side
            quads.append(cell[:, None] + (square if side else square[::-1]))
    quads = np.concatenate(quads)
    vertices, where = np.unique(quads.reshape(-1, 3), axis=0, return_inverse=True)
    quad = where.reshape(-1, 4)
    faces = np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])
    return trimesh.Trimesh(vertices.astype(float), faces, process=False)


def costs(repeats=5):
    """A row for each mesh: seconds for ten steps with CHOLMOD and with the default solver."""
    problem = ec.Problem(u0=lambda x: 1 + x[:, 0], motion=lambda p, t: p)
    for name, tri in shapes().items():
        pairs = [
            [seconds(_run, tri, problem, solver) for solver in ("cholmod", "lagged")]
            for _ in range(repeats)
        ]
        largest = ec.SurfaceSpace(tri).fronts.largest
        yield summary(*np.array(pairs).T) | {
            "name": name,
            "nodes": len(tri.vertices),
            "largest_front": largest,
        }


def _run(tri, problem, solver):
    """A space and ten steps on it."""
    for _ in ec.evolve(ec.SurfaceSpace(tri), problem, 1, 0.01, 0.1, solver=solver):
        pass
