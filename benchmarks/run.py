"""Measure assembly, time steps, scaling and memory; keep them in the data of the companion.

Run from the root of the repository, on a machine that does nothing else (about 25 minutes):

    pip install -e ".[bench]"
    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/run.py

DOLFINx (Debian: python3-dolfinx) and Numba are compared with, too, where they are installed.
"""

import argparse
import json
import subprocess
import sys
import time
from contextlib import contextmanager, nullcontext
from functools import partial
from itertools import islice
from pathlib import Path

import beyond
import compiled_loop
import dolfinx_peer
import ngsolve
import ngsolve_peer
import numpy as np
import shapes
import textbook
from one_size import page_faults, run, sphere
from timing import in_turn, machine, seconds, summary

import esfem_core as ec
from esfem_core.companion.campaign import DATA
from esfem_core.elements import SurfaceSpace
from esfem_core.solvers import LaggedSolver, cholmod, factorise, superlu, times, using_threads
from esfem_core.study import final

RESULTS = DATA / "performance.json"
ONE_SIZE = Path(__file__).with_name("one_size.py")


def moved(space):
    """Nodes of the sphere, moved to another surface."""
    return space.nodes * [1, 1.2, 0.8] + 0.1 * np.sin(2 * space.nodes[:, [1, 2, 0]])


def assembly(repeats=15, threads=1):
    """Mass and stiffness matrix on a surface that moves between the calls."""
    rows = []
    for refinements in (5, 6, 7):
        space = sphere(refinements)
        peer = ngsolve_peer.Peer(space)
        x = moved(space)
        peer.move(x)
        ngsolve.SetNumThreads(threads)
        with using_threads(threads), ngsolve.TaskManager() if threads > 1 else nullcontext():
            row = in_turn(peer.assemble, lambda space=space, x=x: space.mass_stiffness(x), repeats)
        ngsolve.SetNumThreads(1)
        u, w = np.random.default_rng(0).standard_normal((2, len(x)))
        differences = []
        for matrix, form in zip(space.mass_stiffness(x), (peer.M, peer.A), strict=True):
            theirs = peer.coefficients(w) @ (peer.scipy(form) @ peer.coefficients(u))
            size = np.linalg.norm(w) * np.linalg.norm(matrix @ u)
            differences.append(abs(w @ (matrix @ u) - theirs) / size)
        rows.append(row | {"nodes": len(x), "difference": float(max(differences))})
        print(rows[-1], flush=True)
    return rows


def assembly_dolfinx(repeats=15):
    """The same beside DOLFINx in a process of its own, and with as many threads as processes."""
    reason = dolfinx_peer.reason_against()
    if reason:
        return {"skipped": reason}
    rows = []
    for threads in (1, 2):
        for refinements in (5, 6, 7):
            space = sphere(refinements)
            x = moved(space)
            peer = dolfinx_peer.Peer(space, x, threads)
            pairs, faults = [], []
            with using_threads(threads):
                for _ in range(repeats + 1):
                    peer.assemble()  # fill the caches again, for either side
                    theirs = peer.assemble()
                    space.mass_stiffness(x)
                    before = page_faults()
                    pairs.append([theirs, seconds(space.mass_stiffness, x)])
                    faults.append(page_faults() - before)
            peer.close()
            row = summary(*np.array(pairs[1:]).T) | {"nodes": len(x), "threads": threads}
            row |= {"faults": float(np.median(faults[1:])), "version": peer.version}
            if peer.forms:
                u, w = np.random.default_rng(0).standard_normal((2, len(x)))
                row["difference"] = max(
                    float(abs(w @ (matrix @ u) - form))
                    / float(np.linalg.norm(w) * np.linalg.norm(matrix @ u))
                    for matrix, form in zip(space.mass_stiffness(x), peer.forms, strict=True)
                )
            rows.append(row)
            print(row, flush=True)
    return rows


def assembly_compiled(repeats=25):
    """The same beside a compiled loop over the elements."""
    reason = compiled_loop.reason_against()
    if reason:
        return {"skipped": reason}
    rows = []
    for refinements in (4, 5, 6, 7):
        space = sphere(refinements)
        x, peer = moved(space), compiled_loop.Peer(space)
        row = in_turn(partial(peer.assemble, x), partial(space.mass_stiffness, x), repeats)
        differences = [
            abs(theirs - ours.data).max() / abs(ours.data).max()
            for theirs, ours in zip(peer.assemble(x), space.mass_stiffness(x), strict=True)
        ]
        rows.append(row | {"nodes": len(x), "difference": float(max(differences))})
        print(rows[-1], flush=True)
    return rows


def cores(threads=2, blocks=20, length=5):
    """A step on one thread and on several, two runs in turn, which must have the same bits."""
    rows = []
    for refinements in (4, 5, 6, 7):
        for mass in ("updated", "extrapolated"):
            space, problem = sphere(refinements), ec.problems.expanding_sphere()
            counts = (1, threads)
            runs = [
                ec.evolve(space, problem, 3, 1e-3, 0.9, mass=mass, threads=count)
                for count in counts
            ]
            for states in runs:
                run(states, 9)
            times = np.array([[warm(states, length) for states in runs] for _ in range(blocks)])
            one, several = (next(states) for states in runs)
            assert (one.x == several.x).all()
            assert (one.u == several.u).all()
            row = summary(*times.T) | {"nodes": len(space.nodes), "mass": mass, "threads": threads}
            rows.append(row)
            print(row, flush=True)
    return rows


def warm(states, length):
    """Seconds for a step, after one that fills the caches again."""
    run(states, 1)
    return run(states, length) / length


def step(solver, peer_solver, blocks=10, length=5):
    """A whole step of the coupled problem, in blocks of steps in turn.

    The ratio of the total times counts all that a run needs after its first steps, new
    factorisations too, which the median over the blocks may leave out.
    """
    rows = []
    for refinements in (4, 5, 6):
        space = sphere(refinements)
        problem = ec.problems.expanding_sphere()
        for tau in (1e-2, 1e-3):
            for order in (3, 5):
                n = order + 6 + blocks * (length + 1)
                theirs = ngsolve_peer.evolve(space, order, tau, n, peer_solver)
                ours = ec.evolve(
                    space, problem, order, tau, n * tau, mass="extrapolated", solver=solver
                )
                final(islice(ours, order))  # the starting states
                run(theirs, 6), run(ours, 6)
                times = []
                for _ in range(blocks):
                    run(theirs, 1)  # fill the caches again
                    peer = run(theirs, length)
                    run(ours, 1)
                    times.append([peer, run(ours, length)])
                (_, x, u), state = next(theirs), next(ours)
                row = summary(*(np.array(times) / length).T)
                peer, own = np.sum(times, axis=0)
                row |= {"nodes": len(x), "step": tau, "order": order, "total": peer / own}
                row["difference"] = float(max(abs(state.x - x).max(), abs(state.u - u).max()))
                rows.append(row)
                print(solver, peer_solver, row, flush=True)
    return rows


def implicit_euler(steps=200, blocks=10):
    """Implicit Euler steps as in [LMV], on 4,098 linear nodes of their ellipsoid."""
    space = sphere(5, degree=1)

    def motion(p, t):
        return p * [np.sqrt(1 + 0.25 * np.sin(t)), 1, 1]

    problem = ec.Problem(u0=lambda x: x[:, 0] * x[:, 1], motion=motion)
    ours = ec.evolve(space, problem, 1, 1e-4, 1.0)
    u0 = problem.initial_values(space.nodes)["u"]
    theirs = textbook.evolve(space.cells, lambda t: motion(space.nodes, t), u0, 1e-4)
    next(ours)
    times = []
    for _ in range(blocks):
        times.append([run(theirs, steps // blocks), run(ours, steps // blocks)])
    row = summary(*(np.array(times) / (steps // blocks)).T)
    return row | {"difference": float(abs(next(ours).u - next(theirs)).max())}


def scaling():
    """Seconds per step and peak memory, each size in a process of its own."""
    rows = []
    for refinements in (4, 5, 6, 7, 8):
        command = [sys.executable, str(ONE_SIZE), str(refinements)]
        out = subprocess.run(command, capture_output=True, text=True, check=True)
        rows.append(json.loads(out.stdout))
        print(rows[-1], flush=True)
    return rows


def factorisations(repeats=9):
    """Factorise M + A, and solve with three right-hand sides."""
    rows = []
    for refinements in (4, 5, 6):
        space = sphere(refinements)
        M, A = space.mass_stiffness(space.nodes)
        K, order = M + A, space.elimination_order
        b = np.random.default_rng(0).standard_normal((3, len(order))).T
        for name, make in (
            ("SuperLU", partial(superlu, order=order)),
            ("CHOLMOD", partial(cholmod, order=order)),
            ("dense fronts, double", partial(factorise, fronts=space.fronts, dtype=float)),
            ("dense fronts, single", partial(factorise, fronts=space.fronts)),
        ):
            factor = make(K)
            residual = np.linalg.norm(K @ factor.solve(b) - b) / np.linalg.norm(b)
            row = {"nodes": len(b), "name": name, "residual": float(residual)}
            row["factorise"] = float(np.median([seconds(make, K) for _ in range(repeats)]))
            row["solve"] = float(np.median([seconds(factor.solve, b) for _ in range(5 * repeats)]))
            rows.append(row)
            print(row, flush=True)
    return rows


def breakdown(blocks=8, length=5):
    """Where the time of a step goes, by timing the calls inside it, with two solvers in turn."""
    rows = []
    for refinements in (4, 6):
        space, problem = sphere(refinements), ec.problems.expanding_sphere()
        end, runs = (blocks * (length + 1) + 10) * 1e-3, {}
        for solver in ("lagged", "cholmod"):
            options = {"mass": "extrapolated", "solver": solver}
            runs[solver] = ec.evolve(space, problem, 3, 1e-3, end, **options)
            run(runs[solver], 9)
        parts = ("assembly", "loads", "solve for v", "solve for u", "rest")
        spent = {solver: dict.fromkeys(parts, 0.0) for solver in runs}
        for _ in range(blocks):
            for solver, states in runs.items():
                run(states, 1)  # fill the caches again
                add_parts(states, length, spent[solver])
        for solver, sums in spent.items():
            per_step = {name: total / (blocks * length) for name, total in sums.items()}
            rows.append(per_step | {"nodes": len(space.nodes), "solver": solver})
            print(rows[-1], flush=True)
    return rows


def add_parts(states, n, spent):
    """Add the time of the parts of n steps."""
    before = sum(spent.values())
    with (
        # The pass over the elements makes matrices, normals, points and gradients.
        timed(SurfaceSpace, "assemble", spent, lambda *_: "assembly"),
        timed(SurfaceSpace, "evaluate", spent, lambda *_: "assembly"),
        timed(SurfaceSpace, "load_with", spent, lambda *_: "loads"),
        timed(LaggedSolver, "solve", spent, lambda A, b, _: f"solve for {'uv'[b.ndim - 1]}"),
    ):
        total = run(states, n)
    spent["rest"] += total - (sum(spent.values()) - before)


@contextmanager
def timed(owner, name, spent, label):
    """Add the time of every call of a method to spent[label(*arguments)]."""
    method = getattr(owner, name)

    def wrapper(self, *arguments):
        start = time.perf_counter()
        result = method(self, *arguments)
        spent[label(*arguments)] += time.perf_counter() - start
        return result

    setattr(owner, name, wrapper)
    try:
        yield
    finally:
        setattr(owner, name, method)


def limits():
    """How far the parts of a step are from what memory and arithmetic allow."""
    space = sphere(6)
    n_cells, n = space.cells.shape
    pairs, points = n * (n + 1) // 2, len(space.rule.weights)
    nnz = space.mass_stiffness(space.nodes)[0].nnz
    half = (nnz + len(space.nodes)) // 2
    # Read nodes by element, and an index for each element entry, twice; write the sums of both
    # matrices and read them with an index; write both matrices.
    moved = n_cells * n * (3 * 8 + 8) + 2 * n_cells * pairs * 4
    moved += 2 * (half * 16 + nnz * (8 + 8))
    flops = 2 * n_cells * points * (2 * n * 3 + pairs * 4) + 40 * n_cells * points
    source, target = np.ones((2, 8_000_000))
    square = np.ones((1500, 1500))
    copy = min(seconds(np.copyto, target, source) for _ in range(5))
    gemm = min(seconds(np.matmul, square, square) for _ in range(5))
    spent = np.median([seconds(space.mass_stiffness, space.nodes) for _ in range(15)])
    parts = [{"name": "M and A", "seconds": float(spent), "bytes": moved, "flops": flops}]
    for name, call, n_bytes, operations in other_parts(space):
        call()
        part = float(np.median([seconds(call) for _ in range(15)]))
        parts.append({"name": name, "seconds": part, "bytes": n_bytes, "flops": operations})
    return {
        "parts": parts,
        "nodes": len(space.nodes),
        "seconds": float(spent),
        "bytes": moved,
        "bandwidth": 2 * source.nbytes / copy,
        "flops": flops,
        "peak": 2 * 1500**3 / gemm,
    }


def other_parts(space):
    """Name, call, bytes that have to move and operations of what a step does besides M and A."""
    M, A = space.mass_stiffness(space.nodes)
    factor = factorise(M + A, space.fronts)
    n, (n_cells, n_local), n_points = len(space.nodes), space.cells.shape, len(space.rule.weights)
    values = space.evaluate(space.nodes)
    # Entries of the factor are read on the way up, but for the inverses, and on the way down.
    inverses = sum(
        (batch.own.stop - batch.own.start) ** 2 / batch.shape[0]
        for level in space.fronts.levels
        for batch in level.batches
    )
    entries = 2 * space.fronts.n_stored - inverses
    yield (
        "load of three functions",
        partial(space.load, space.nodes, values),
        3 * n_cells * 8 * (n_points + 2 * n_local) + n_cells * n_local * 4 + 24 * n,
        3 * n_cells * n_points * (1 + 2 * n_local),
    )
    yield (
        "a matrix times three vectors",
        partial(times, M, space.nodes),
        3 * (12 * M.nnz + 16 * n),
        6 * M.nnz,
    )
    yield (
        "a solve with the factor, three right-hand sides",
        partial(factor.solve, space.nodes),
        4 * entries + 2 * 3 * 12 * n,
        6 * entries,
    )


SUITE = {
    "assembly": assembly,
    "assembly_two_threads": partial(assembly, threads=2),
    "assembly_dolfinx": assembly_dolfinx,
    "assembly_compiled": assembly_compiled,
    "cores": cores,
    "step": lambda: step("lagged", "sparsecholesky"),
    "step_fast": lambda: step("cholmod", "sparsecholesky"),
    "step_lagged_peer": lambda: step("lagged", "lagged"),
    "implicit_euler": implicit_euler,
    "beyond": lambda: [row for r in (4, 5) for row in beyond.costs(sphere(r))],
    "shapes": lambda: list(shapes.costs()),
    "scaling": scaling,
    "factorisations": factorisations,
    "breakdown": breakdown,
    "limits": limits,
}


def main():
    """Run the suite, or the parts named, and keep what was measured."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", choices=[*SUITE, []], help="default: all")
    parser.add_argument(
        "--keep", type=Path, default=RESULTS, metavar="FILE", help="default: %(default)s"
    )
    given = parser.parse_args()
    parts, kept = given.parts or list(SUITE), given.keep
    ngsolve.SetNumThreads(1)
    results = json.loads(kept.read_text()) if kept.exists() else {}
    for part in parts:
        results[part] = SUITE[part]()
    results["machine"] = machine() | {"ngsolve": ngsolve.__version__}
    kept.parent.mkdir(exist_ok=True)
    kept.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
