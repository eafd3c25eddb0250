"""Better triangles in a run: where an angle becomes small, the surface is triangulated anew."""

import warnings
from itertools import islice

import numpy as np

import esfem_core as ec

warnings.filterwarnings("ignore", category=ec.EvolutionWarning)  # thin triangles are the subject


def remeshing(space, problem, p, step, end, angle, h, ratio=np.inf, **options):
    """The states of a run, which goes on from p new states when angles or areas tell it to."""
    run, states, first = ec.evolve(space, problem, p, step, end, **options), [], None
    while run:
        rest, run = run, None
        for state in rest:
            yield state
            first, states = first or state, [*states, state][-p:]
            J = state.surface().density / first.surface().density  # what areas have become
            worn = ec.measure(state).min_angle < angle or J.max() > ratio * J.min()
            if len(states) == p and state.t < end and worn:
                states = ec.remeshed(states, h, problem)
                first = states[-1]
                options["start"] = states
                run = ec.evolve(first.space, problem, p, step, end, **options)
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
kept = list(ec.evolve(space, problem, 3, 1 / 20, 1.5))
made = list(remeshing(space, problem, 3, 1 / 20, 1.5, angle=15, h=0.35))
for name, states in (("kept", kept), ("made anew", made)):
    m = ec.measure(states[-1])
    angles = [ec.measure(state).min_angle for state in states]
    print(f"triangles {name}: smallest angle {min(angles):.1f}, area {m.area:.4f}")
change = ec.measure(made[-1]).amount / ec.measure(made[0]).amount - 1
print(f"amount changes by {abs(change):.0e}")
