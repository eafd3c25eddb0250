"""A surface that moves with one of the three species on it."""

import numpy as np

import esfem_core as ec

SPACE = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)


def growth(at):
    return 1 + at["u"] + at.points[..., 2] * np.cos(3 * at.t)


def coupled(**more):
    """A surface that moves with one of its species; two components, and one that is not kept."""
    return ec.Problem(
        species={
            "u": ec.Species(lambda x: 1 + x[:, 0] * x[:, 1], **more),
            "pair": ec.Species(lambda x: x[:, :2] + 2, lambda at: -at["pair"], diffusivity=[1, 2]),
            "free": ec.Species(lambda x: x[:, 2], conserved=False),
        },
        law=ec.laws.Regularised(0.5, 0.3, growth),
    )
