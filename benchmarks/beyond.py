"""What a run may do besides the plain steps of one function, in units of a plain step."""

import tempfile
from functools import partial
from pathlib import Path

import numpy as np
from timing import seconds, summary

import esfem_core as ec

ORDER, STEP = 3, 1e-3


def costs(space, blocks=12):
    """Rows of what was done, the seconds it took, and those of a plain step before and after.

    Parameters
    ----------
    space : SurfaceSpace
        Of the unit sphere.
    blocks : int
        Of steps that are timed, in turn with plain ones.
    """
    plain = _run(space, _growing(1))
    runs = {
        "a step with two species, one matrix": _run(space, _growing(2)),
        "a step with two species, two matrices": _run(space, _growing(2, apart=True)),
        "a step with four species, one matrix": _run(space, _growing(4)),
        "a step of mean curvature flow (KLL)": _run(space, _shrinking()),
    }
    tasks = {name: partial(next, run) for name, run in runs.items()}
    past = [next(plain) for _ in range(ORDER)]
    with tempfile.TemporaryDirectory() as folder:
        series = ec.SeriesWriter(Path(folder, "run.pvd"))
        tasks["a state written for ParaView"] = partial(series.write, past[-1])
        tasks["three states saved to go on from"] = partial(ec.save, Path(folder, "run.npz"), past)
        tasks["new triangles for three states"] = partial(ec.remeshed, past)
        for name, task in tasks.items():
            often = name in runs
            pairs = [
                [_seconds(partial(next, plain), 5), _seconds(task, 5 if often else 1)]
                for _ in range(blocks if often else 3)
            ]
            yield _row(space, name, *np.array(pairs).T)


def _growing(number, apart=False):
    """A sphere that grows with its first species; several react with each other."""
    names = ["u", *(f"w{i}" for i in range(1, number))]
    species = {
        name: ec.Species(
            lambda x, i=i: 1 + 0.1 * x[:, i % 3],
            source=lambda at: 0.1 * at[names[-1]] - 0.1 * at["u"],
            diffusivity=1.0 + i * apart,
        )
        for i, name in enumerate(names)
    }
    return ec.Problem(species=species, law=ec.laws.Regularised(g=lambda at: at["u"], beta=1.0))


def _shrinking():
    return ec.Problem(species={}, law=ec.laws.MeanCurvature(beta=1.0))


def _run(space, problem):
    """A run that has taken its first steps."""
    states = ec.evolve(space, problem, ORDER, STEP, 2000 * STEP)
    for _ in range(ORDER + 6):
        next(states)
    return states


def _seconds(task, times):
    """Seconds of one call, after another one that fills the caches if there are several."""
    if times > 1:
        task()
    return sum(seconds(task) for _ in range(times)) / times


def _row(space, name, plain, other):
    """Medians, and the ratio in steps with its quartiles."""
    found = summary(other, plain)
    row = {"name": name, "nodes": len(space.nodes), "step": found.pop("ours")}
    return row | {"seconds": found.pop("peer")} | found
