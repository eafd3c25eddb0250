"""Time and memory of steps on one mesh, in a process that has loaded nothing beside the solver.

python benchmarks/one_size.py 7   # refinements of the octahedron: 262,146 nodes
"""

import json
import resource
import sys
import time
from pathlib import Path

import numpy as np

import esfem_core as ec


def sphere(refinements, degree=2):
    """Aligned sphere with 4^(refinements + 2) + 2 nodes (degree 2)."""
    return ec.SurfaceSpace(ec.sphere("octahedron", refinements), degree, ec.to_unit_sphere)


def run(states, n):
    """Seconds for n steps."""
    start = time.perf_counter()
    for _ in range(n):
        next(states)
    return time.perf_counter() - start


def page_faults():
    """Pages of memory that the system has given to this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt


def main(refinements, steps=24):
    """Print seconds per step, for set-up and for the first step, and peak memory as JSON."""
    start = time.perf_counter()
    space, problem = sphere(refinements), ec.problems.expanding_sphere()
    states = ec.evolve(space, problem, 3, 1e-3, (steps + 8) * 1e-3, mass="extrapolated")
    setup = time.perf_counter() - start
    first = run(states, 4)  # three starting states and a step
    run(states, 4)
    before = page_faults()
    times = [run(states, 1) for _ in range(steps)]
    faults = (page_faults() - before) / steps
    status = Path("/proc/self/status").read_text()  # of this process alone, unlike getrusage
    peak = int(status.split("VmHWM:")[1].split()[0]) / 2**20
    row = {"nodes": len(space.nodes), "seconds": float(np.median(times)), "peak_gib": peak}
    print(json.dumps(row | {"setup": setup, "first": first, "faults": faults}))


if __name__ == "__main__":
    main(int(sys.argv[1]))
