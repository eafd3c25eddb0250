"""Linear systems in which some unknowns are given: Dirichlet conditions."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from esfem_core.checks import Array, Ints
from esfem_core.elements import SurfaceSpace, with_data
from esfem_core.laws import Fixed, Species

__all__ = ["Condition", "Elimination", "conditions"]


class Elimination:
    """Takes given unknowns out of systems whose matrices have one pattern.

    With the unknowns split into free ones and given ones, K w = b of the free ones is
    K_ff w_f = b_f - K_fg w_g. The matrix keeps its size and its pattern, so that the solvers need
    not know: rows and columns of the given ones are zero but for the diagonal, which stays, as K
    does, symmetric and positive definite, and of the scale of the others.

    Parameters
    ----------
    pattern : (N, N) CSR array
    nodes : (B,) int array
        The given unknowns.

    Examples
    --------
    >>> K = csr_array(np.array([[2.0, 1, 1], [1, 2, 1], [1, 1, 2]]))
    >>> first = Elimination(K, np.array([0]))
    >>> first.without(K).toarray().tolist()
    [[2.0, 0.0, 0.0], [0.0, 2.0, 1.0], [0.0, 1.0, 2.0]]
    >>> solve = lambda K, b, guess: np.linalg.solve(K.toarray(), b)
    >>> first.solve(solve, K, np.ones(3), np.zeros(3), np.array([4.0, 0.0, 0.0])).tolist()
    [4.0, -1.0, -1.0]
    """

    def __init__(self, pattern: csr_array, nodes: Ints) -> None:
        self.nodes = nodes
        given = np.zeros(pattern.shape[0], dtype=bool)
        given[nodes] = True
        rows = np.repeat(np.arange(len(given)), np.diff(pattern.indptr))
        self._dropped = (given[rows] | given[pattern.indices]) & (rows != pattern.indices)

    def without(self, K: csr_array) -> csr_array:
        """The matrix for the free unknowns."""
        return with_data(K, np.where(self._dropped, 0.0, K.data))

    def solve(
        self,
        solve: Callable[[csr_array, Array, Array], Array],
        K: csr_array,
        b: Array,
        guess: Array,
        given: Array,
    ) -> Array:
        """Solve K w = b for the free unknowns.

        Parameters
        ----------
        solve : callable
            From matrix, right-hand side and first guess to the solution.
        K : (N, N) CSR array
        b, guess : (N, ...) float arrays
        given : (N, ...) float array
            The given values, and zero elsewhere.

        Returns
        -------
        (N, ...) float array
        """
        b, guess = b - K @ given, guess.copy()
        b[self.nodes] = guess[self.nodes] = 0.0
        w = np.array(solve(self.without(K), b, guess))
        w[self.nodes] = given[self.nodes]
        return w


class Condition(NamedTuple):
    """Where a species is given, and its values there."""

    elimination: Elimination
    fixed: Fixed

    def values(self, name: str, x: Array, t: float, shape: tuple[int, ...]) -> Array:
        """The given values of a species of this shape, (N, ...), and zero elsewhere.

        Raises what :meth:`esfem_core.laws.fixed.Fixed.at` does.
        """
        nodes, values = self.elimination.nodes, np.zeros(shape)
        values[nodes] = self.fixed.at(name, x[nodes], t, shape[1:])
        return values


def conditions(space: SurfaceSpace, species: Mapping[str, Species]) -> dict[str, Condition]:
    """The conditions of those species that have one; for equal nodes one elimination.

    Raises
    ------
    ValueError
        If nodes do not belong to this space.
    """
    known: dict[bytes, Elimination] = {}
    found = {}
    for name, one in species.items():
        if one.fixed is not None:
            nodes = one.fixed.nodes(name, space)
            key = nodes.tobytes()
            if key not in known:
                known[key] = Elimination(space.pattern, nodes)
            found[name] = Condition(known[key], one.fixed)
    return found
