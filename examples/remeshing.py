"""Better triangles in a run: where an angle becomes small, the surface is triangulated anew."""

import warnings
from itertools import islice

import numpy as np

import esfem_core as ec

warnings.filterwarnings("ignore", category=ec.EvolutionWarning)  # thin triangles are the subject


def worn(state, first, angle, ratio):
    """Whether an angle has become small, or areas have changed differently since the first."""
    J = state.surface().density / first.surface().density
    return ec.measure(state).min_angle < angle or J.max() > ratio * J.min()


def remeshing(space, problem, p, step, end, angle, h, ratio=np.inf):
    """The states of a run, which goes on from p new states whenever triangles are worn."""
    run, states, first = ec.evolve(space, problem, p, step, end), [], None
    while run:
        rest, run = run, None
        for state in rest:
            yield state
            first, states = first or state, [*states, state][-p:]
            if len(states) == p and state.t < end and worn(state, first, angle, ratio):
                states = ec.remeshed(states, h, problem)
                first = states[-1]
                run = ec.evolve(first.space, problem, p, step, end, start=states)
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

# Under mean curvature flow the tips of an ellipsoid crowd with good angles: areas tell.
long = ec.exact_surfaces.Ellipsoid((1.0, 1.0, 3.0))
tri = ec.sphere("icosahedron", 2)
tri.vertices = long.closest(tri.vertices * long.axes)
space = ec.SurfaceSpace(tri, 2, long.closest)
shrinking = ec.Problem(law=ec.laws.MeanCurvature())
kept = []
try:
    kept.extend(ec.evolve(space, shrinking, 2, 1 / 200, 0.43))
except ec.EvolutionError:
    print(f"ellipsoid kept: ends at t = {kept[-1].t:.3f}")
*_, last = remeshing(space, shrinking, 2, 1 / 200, 0.43, angle=15, h=None, ratio=4)
m = ec.measure(last)
print(f"ellipsoid made anew: t = {m.t:.3f}, volume {m.volume:.4f}, angle {m.min_angle:.0f}")
