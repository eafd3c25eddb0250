"""The same matrices by a compiled loop over the elements: what Numba would gain.

The entries of an element are computed by loops of known length, which the compiler unrolls, and
added to where they belong in the CSR arrays; where that is, is known beforehand.
"""

from importlib.util import find_spec

import numpy as np


def reason_against():
    """Why the loop cannot be measured here, or None."""
    return None if find_spec("numba") else "no Numba: pip install numba"


class Peer:
    """Mass and stiffness matrix on Γ_h[x].

    Parameters
    ----------
    space : esfem_core.SurfaceSpace
        Of degree 2 or more.
    """

    def __init__(self, space):
        tables = space.tables
        points = len(space.rule.weights)
        d1, d2 = tables.gradients.reshape(2, points, -1)
        K = [k.T.copy() for k in np.split(tables.stiffness, 3, axis=1)]
        places = _places(space.cells, tables.pairs, space.pattern)
        self._loop = _loop(*d1.shape, tables.pairs.shape[1])
        self._arguments = (space.cells, d1, d2, tables.mass.T.copy(), *K, places)
        self._data = np.empty((2, space.pattern.nnz))

    def assemble(self, x):
        """The entries of M and A on Γ_h[x] in the order of the pattern, (2, nnz)."""
        self._data[:] = 0.0
        self._loop(x, *self._arguments, *self._data)
        return self._data


def _places(cells, pairs, pattern):
    """Where the entries (a, b) and (b, a) of each element belong, (T, P, 2)."""
    n = pattern.shape[0]
    rows = np.repeat(np.arange(n), np.diff(pattern.indptr))
    keys = n * rows + pattern.indices
    a, b = cells[:, pairs[0]], cells[:, pairs[1]]
    return np.searchsorted(keys, np.stack([n * a + b, n * b + a], axis=-1))


def _loop(n_points, n, n_pairs):
    """The loop for elements with n nodes, compiled when it is called for the first time."""
    import numba

    @numba.njit(fastmath=True, boundscheck=False)
    def loop(x, cells, d1, d2, mass, K1, K2, K3, places, M, A):
        corner = np.empty((n, 3))
        m, a = np.empty(n_pairs), np.empty(n_pairs)
        for e in range(len(cells)):
            for i in range(n):
                for k in range(3):
                    corner[i, k] = x[cells[e, i], k]
            m[:] = 0.0
            a[:] = 0.0
            for q in range(n_points):
                E = F = G = 0.0
                for k in range(3):
                    t1 = t2 = 0.0
                    for i in range(n):
                        t1 += d1[q, i] * corner[i, k]
                        t2 += d2[q, i] * corner[i, k]
                    E += t1 * t1
                    F += t1 * t2
                    G += t2 * t2
                s = np.sqrt(E * G - F * F)
                E, F, G = E / s, F / s, G / s
                for p in range(n_pairs):
                    m[p] += s * mass[q, p]
                    a[p] += G * K1[q, p] + F * K2[q, p] + E * K3[q, p]
            p = 0
            for i in range(n):
                for j in range(i, n):
                    for place in places[e, p, : 1 if i == j else 2]:
                        M[place] += m[p]
                        A[place] += a[p]
                    p += 1

    return loop
