"""Level sets for tests: a sphere, an ellipsoid, a torus and a surface with two holes."""

import numpy as np


def unit_sphere(x):
    return (x**2).sum(axis=1) - 1


def ellipsoid(x):
    return (x**2 / [4, 1, 0.49]).sum(axis=1) - 1


def torus(x, centre=0.0, r=0.4):
    return np.hypot(np.hypot(x[:, 0] - centre, x[:, 1]) - 1, x[:, 2]) - r


def two_rings(x, k=0.1):
    """Two tori whose tubes overlap, blended."""
    return -k * np.logaddexp(-torus(x, 1.1) / k, -torus(x, -1.1) / k)


BOXES = {
    unit_sphere: [[-1.3, -1.3, -1.3], [1.3, 1.3, 1.3]],
    ellipsoid: [[-2.3, -1.3, -1.0], [2.3, 1.3, 1.0]],
    torus: [[-1.6, -1.6, -0.6], [1.6, 1.6, 0.6]],
    two_rings: [[-2.8, -1.7, -0.8], [2.8, 1.7, 0.8]],
}
EULER = {unit_sphere: 2, ellipsoid: 2, torus: 0, two_rings: -2}
