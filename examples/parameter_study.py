"""A study of parameters: several processes, progress, and going on after an interruption."""

from itertools import islice

import esfem_core as ec
from esfem_core.companion import campaign


def area(alpha, beta):
    """Area at t = 1 of a sphere that grows by what it carries."""
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), degree=2, project=ec.to_unit_sphere)
    problem = ec.Problem(u0=lambda x: 1 + x[:, 2], g=lambda at: at.u, alpha=alpha, beta=beta)
    *_, last = ec.evolve(space, problem, order=2, step=1 / 20, end=1.0)
    return {"area": ec.measure(last).area}


# Each chain holds cases that are computed one after the other; chains run side by side.
study = campaign.Experiment(
    name="growth",
    title="area against regularisation and curvature",
    compute=area,
    chains=[[{"alpha": a, "beta": b} for b in (0.0, 0.1, 0.2)] for a in (0.1, 1.0)],
)
CASES = sum(map(len, study.chains))


def compute(most):
    """Compute what is not yet in results/growth.jsonl, and stop after so many outcomes."""
    done = 0
    for _, outcome, cases in islice(campaign.run([study], "results", jobs=2), most):
        if isinstance(outcome, Exception):
            raise outcome
        done += cases
        news = f"{outcome.parameters}" if outcome else "found in the file"
        print(f"{done}/{CASES}: {news}")


if __name__ == "__main__":  # the processes import this file
    compute(most=2)  # as if interrupted
    compute(most=CASES)
    rows = campaign.read("results/growth.jsonl")
    for row in sorted(rows, key=lambda row: tuple(row.parameters.values())):
        print(f"{row.parameters}: area {row.results['area']:.5f}")
