"""Turing patterns on a growing sphere: Schnakenberg's kinetics, and growth by the activator."""

import numpy as np

import esfem_core as ec

GAMMA, D = 100.0, 10.0  # the larger gamma, the smaller the spots


def feed(at):
    return GAMMA * (0.1 - at["a"] + at["a"] ** 2 * at["b"])


def consume(at):
    return GAMMA * (0.9 - at["a"] ** 2 * at["b"])


def near(value, seed):
    """A little disorder about the steady state, which is unstable."""
    return lambda x: value + 0.05 * np.random.default_rng(seed).normal(size=len(x))


problem = ec.Problem(
    species={
        "a": ec.Species(near(1.0, seed=1), source=feed),
        "b": ec.Species(near(0.9, seed=2), source=consume, diffusivity=D),
    },
    law=ec.laws.Regularised(alpha=0.05, beta=0.02, g=lambda at: 0.25 * at["a"]),
)
space = ec.SurfaceSpace(ec.sphere("icosahedron", 3), degree=1, project=ec.to_unit_sphere)

for state in ec.evolve(space, problem, order=2, step=1 / 200, end=1.0):
    if round(state.t * 200) % 40 == 0:
        a = state["a"]
        area = ec.measure(state).area
        print(f"t = {state.t:.1f}: a from {a.min():.3f} to {a.max():.3f}, area {area:.4f}")

print(f"contrast at the end: {a.max() - a.min():.4f}")
