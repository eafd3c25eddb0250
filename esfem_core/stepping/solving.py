"""Solving the linear systems of a run: a solver for each kind, and what they have done."""

from collections import deque
from collections.abc import Callable, Hashable, Sequence

import numpy as np
from scipy.sparse import csr_array, issparse

from esfem_core.checks import Array, real_array, shown
from esfem_core.solvers import (
    DirectSolver,
    LaggedSolver,
    Solver,
    require_small_residual,
    right_hand_side,
)
from esfem_core.stepping.bdf import extrapolate

__all__ = ["Statistics", "Systems"]

GUESS = 5  # values that a first guess is extrapolated from, if there are so many


class Statistics:
    """What the linear solvers of one run have done so far; handed to :func:`esfem_core.evolve`.

    Attributes
    ----------
    solvers : dict
        Each kind of system, such as "law 1" or "u", and its solver.
    solves : dict of str to int
        How many systems of each kind were solved; several right-hand sides at once are one.

    Notes
    -----
    Printed, it tells how full the factors of "lagged" solvers are, in entries per unknown. CHOLMOD
    does not say, and ``solver="direct"`` keeps no factor: the one of a matrix of the run is printed
    by ``print(superlu(space.mass(x), space.elimination_order))`` with ``superlu`` of
    :mod:`esfem_core.solvers`; all its matrices have entries at the same places.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 3), 2, ec.to_unit_sphere)
    >>> statistics = ec.Statistics()
    >>> run = ec.evolve(
    ...     space, ec.problems.growing_sphere(), 2, 1 / 40, 0.5, statistics=statistics
    ... )
    >>> for state in run:
    ...     pass
    >>> statistics.solves, statistics.factorisations
    ({'law 1': 19, 'u': 19}, 2)
    """

    def __init__(self) -> None:
        self.solvers: dict[str, Solver] = {}
        self.solves: dict[str, int] = {}

    @property
    def iterations(self) -> int:
        """Iterations of all solvers."""
        return sum(int(getattr(solver, "iterations", 0)) for solver in self.solvers.values())

    @property
    def factorisations(self) -> int:
        """Factorisations of all solvers."""
        return sum(int(getattr(solver, "factorisations", 0)) for solver in self.solvers.values())

    def __repr__(self) -> str:
        lines = [f"{kind}: {n} solves, {self.solvers[kind]!r}" for kind, n in self.solves.items()]
        return "\n".join(lines) or "Statistics: nothing solved yet"


class Systems:
    """Solvers by the kind of system; made when a kind is met for the first time.

    Parameters
    ----------
    make_solver : callable
        Without arguments, makes a :class:`esfem_core.solvers.Solver`.
    pattern : (N, N) CSR array
        Of the matrices of the space.
    statistics : Statistics
        Where the solvers are kept.
    factor : float
        A power of two that matrices and right-hand sides are multiplied by, which changes no bit of
        the solutions: solvers tell a right-hand side of rounding by its size.
    """

    def __init__(
        self,
        make_solver: Callable[[], Solver],
        pattern: csr_array,
        statistics: Statistics,
        factor: float = 1.0,
    ) -> None:
        self._make, self._pattern, self._statistics = make_solver, pattern, statistics
        self._factor = factor
        self._names: dict[Hashable, str] = {}
        self._solutions: dict[str, deque[Array]] = {}

    def solve(self, kind: str, K: csr_array, b: Array, guess: Array) -> Array:
        """Solve K w = b from a first guess."""
        solvers, solves = self._statistics.solvers, self._statistics.solves
        if kind not in self._solutions:  # of this run
            self._solutions[kind] = deque(maxlen=GUESS)
            solvers[kind], solves[kind] = _checked_solver(self._make()), 0
        solves[kind] += 1
        K = self._conforming(K)
        if self._factor != 1:
            data = self._factor * K.data
            K, b = csr_array((data, K.indices, K.indptr), shape=K.shape), self._factor * b
        try:
            w = solvers[kind].solve(K, b, guess)
            if not isinstance(solvers[kind], DirectSolver | LaggedSolver):  # these test their own
                w = real_array("what the solver returns", w, b.shape)
                require_small_residual(K, b, w)
        except (FloatingPointError, np.linalg.LinAlgError) as error:
            raise np.linalg.LinAlgError(f"{_described(kind)}: {error}{_in_a_run(error)}") from error
        return w

    def solve_again(self, kind: str, K: csr_array, b: Array) -> Array:
        """Solve K w = b from what the last solutions of this kind let one expect."""
        b = right_hand_side(self._pattern.shape[0], b)
        last = self._solutions.get(kind, ())
        same = [w for w in last if w.shape == b.shape]
        w = self.solve(kind, K, b, extrapolate(same) if same else np.zeros_like(b))
        self._solutions[kind].appendleft(w)
        return w

    def _conforming(self, K: csr_array) -> csr_array:
        """The matrix with all entries of the pattern, also where they are zero."""
        if not issparse(K) or np.asarray(K.data).dtype.kind not in "fiu":
            raise TypeError(
                "the matrix of a law must be a sparse one of real numbers, such as "
                f"at.matrix(mass=1.0, stiffness=2.0), got {type(K).__name__} {shown(K)}"
            )
        if _same_places(K, self._pattern):
            return K
        full = self._pattern.copy()
        full.data = np.zeros(full.nnz)
        rows = np.repeat(np.arange(full.shape[0]), np.diff(full.indptr))
        places = full.shape[1] * rows.astype(np.int64) + full.indices
        entries = csr_array(K).tocoo()
        wanted = full.shape[1] * entries.row.astype(np.int64) + entries.col
        at = np.minimum(np.searchsorted(places, wanted), len(places) - 1)
        if K.shape != full.shape or not np.array_equal(places[at], wanted):
            raise ValueError(
                "the matrix of a law must have the shape of M and A and couple nodes of one "
                f"element only, got shape {K.shape}"
            )
        np.add.at(full.data, at, entries.data)
        return full


def _described(kind: str) -> str:
    """The linear system of a kind, in words."""
    law, _, number = kind.partition(" ")
    if law != "law" or not number.isdecimal():
        return f"the linear system of {kind}"
    which = ("first", "second", "third")[int(number) - 1] if int(number) < 4 else f"{number}th"
    return f"the linear system of {kind}, the {which} that the law solves in a step"


def _in_a_run(error: Exception) -> str:
    """What it means in a run that a matrix takes constants to zero."""
    if "takes constants to zero" not in str(error):
        return ""
    return (
        "; so it is if the surface has shrunk to a point within the step, or if a diffusivity "
        "times the step, or alpha, is far beyond the square of its size"
    )


def _checked_solver(solver: Solver) -> Solver:
    if isinstance(solver, type) or not callable(getattr(solver, "solve", None)):
        raise TypeError(
            "solver must be a function that makes an object with a method solve(A, b, guess), but "
            f"it returned {shown(solver)}"
        )
    return solver


def _same_places(K: csr_array, pattern: csr_array) -> bool:
    if K.format != "csr" or K.shape != pattern.shape:
        return False
    return K.indices is pattern.indices or (
        np.array_equal(K.indptr, pattern.indptr) and np.array_equal(K.indices, pattern.indices)
    )


def stacked(loads: Sequence[Array]) -> tuple[Array, Callable[[Array], list[Array]]]:
    """Right-hand sides (N, ...) side by side, (N, m), and what takes solutions apart again."""
    if len(loads) == 1:
        return loads[0], lambda w: [w]
    columns = [b.reshape(len(b), -1) for b in loads]
    ends = np.cumsum([c.shape[1] for c in columns])[:-1]

    def apart(w: Array) -> list[Array]:
        parts = np.split(w, ends, axis=1)
        return [part.reshape(b.shape) for part, b in zip(parts, loads, strict=True)]

    return np.hstack(columns), apart
