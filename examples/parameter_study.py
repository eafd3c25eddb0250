"""A study of parameters: several processes, progress, and going on where it stopped."""

import esfem_core as ec


def area(alpha, beta):
    """Area at t = 1 of a sphere that grows by what it carries."""
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), degree=2, project=ec.to_unit_sphere)
    problem = ec.Problem(u0=lambda x: 1 + x[:, 2], g=lambda at: at.u, alpha=alpha, beta=beta)
    *_, last = ec.evolve(space, problem, order=2, step=1 / 20, end=1.0)
    return {"area": ec.measure(last).area}


if __name__ == "__main__":  # the processes read this file
    few = ec.study.grid(alpha=(0.1,), beta=(0.0, 0.1))
    ec.study.run(few, area, "results", workers=2, progress=print)

    # A study that is made larger goes on, and so does one that was interrupted or killed: each
    # finished case is a line of results/area.jsonl.
    cases = ec.study.grid(alpha=(0.1, 1.0), beta=(0.0, 0.1, 0.2))
    found = ec.study.run(cases, area, "results", workers=2, progress=print)
    for row in found.rows:
        print(f"{row.parameters}: area {row.results['area']:.5f}")
