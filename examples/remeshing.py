"""Better triangles in a run: where an angle becomes small, the surface is triangulated anew."""

from itertools import islice

import numpy as np

import esfem_core as ec


def remeshing(space, problem, p, step, end, angle, h):
    """The states of a run, which goes on from p new states whenever an angle is too small."""
    run, states = ec.evolve(space, problem, p, step, end), []
    while run:
        rest, run = run, None
        for state in rest:
            yield state
            states = [*states, state][-p:]
            if len(states) == p and state.t < end and ec.measure(state).min_angle < angle:
                states = ec.remeshed(states, h, problem)
                run = ec.evolve(states[-1].space, problem, p, step, end, start=states)
                run = islice(run, p, None)  # the first p are those it starts from
                break


def stretched(x, t):
    """A velocity that draws the sphere out and shears it."""
    return x * [1.0, -0.5, -0.5] + np.sin(x[:, :1]) * [0, 1, 0]


space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), degree=2, project=ec.to_unit_sphere)
problem = ec.Problem(
    species={"u": ec.Species(lambda x: 1 + x[:, 2], diffusivity=0.1)},
    law=ec.laws.Prescribed(velocity=stretched),
)
options = {"p": 3, "step": 1 / 20, "end": 1.5}
kept = list(ec.evolve(space, problem, 3, 1 / 20, 1.5))
made = list(remeshing(space, problem, **options, angle=15, h=0.35))
for name, states in (("kept", kept), ("made anew", made)):
    m = ec.measure(states[-1])
    angles = [ec.measure(state).min_angle for state in states]
    print(f"triangles {name}: smallest angle {min(angles):.1f}, area {m.area:.4f}")
spaces = {id(state.space): len(state.space.cells) for state in made}
print(f"elements: {', '.join(map(str, spaces.values()))}")
change = ec.measure(made[-1]).amount / ec.measure(made[0]).amount - 1
print(f"amount changes by {abs(change):.0e}")
