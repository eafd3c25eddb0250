"""Diffusion on a moving surface of revolution, reduced to one dimension.

A second way to solutions that :func:`esfem_core.evolve` computes on triangulations. It shares
nothing with them: no mesh of triangles, no BDF.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.polynomial import legendre

from esfem_core.checks import Array, finite_array, whole_number

__all__ = ["cosine_mode"]

Motion = Callable[[Array, float], Array]
STEP = 0.02


def cosine_mode(
    motion: Motion, profile: Callable[[Array], Array], times: Sequence[float], degree: int = 20
) -> list[Callable[[Array], Array]]:
    r"""Solve u' + u div v - lap u = 0 for u = U(θ, t) cos φ on a surface of revolution.

    θ is the angle from the axis x1 and φ the angle around it, of the point of the unit sphere from
    which a material point comes. With the meridian (X, R)(θ, t) of the surface and the length
    density l = ``|d(X, R)/dθ|``, integration over φ leaves::

        d/dt int U W R l dθ + int (U_θ W_θ / l^2 + U W / R^2) R l dθ = 0,  U = 0 at the poles.

    In space two polynomials meet at θ = π/2, where the motion may have a kink; elsewhere it should
    be smooth in θ, and the error then decays exponentially with the degree. The method in time is
    Radau's of order five, with steps of at most 1/50.

    Parameters
    ----------
    motion : callable
        X(p, t), positions of points p, (n, 3), of the unit sphere, as in
        :class:`esfem_core.Problem`; it must commute with rotations about the axis x1.
    profile : callable
        U(θ, 0) of angles (n,), zero at the poles.
    times : sequence of float
        Not decreasing, not negative.
    degree : int
        Of the polynomials on both halves, 2 or more.

    Returns
    -------
    list of callables
        For each time, u at points of the unit sphere: (n, 3) -> (n,).

    Raises
    ------
    TypeError, ValueError
        If there are no times, or they decrease or are negative, or the degree is no integer of 2 or
        more.

    Examples
    --------
    On the unit sphere at rest x1 x2 is an eigenfunction, and decays like exp(-6t):

    >>> (u,) = cosine_mode(lambda p, t: p, lambda a: np.cos(a) * np.sin(a), [0.5])
    >>> print(f"{u(np.array([[0.6, 0.8, 0.0]]))[0] / (0.48 * np.exp(-3)):.6f}")
    1.000000
    """
    degree = whole_number("degree", degree, 2)
    ends: list[float] = finite_array("times", times, ("n",)).tolist()
    if not ends or np.any(np.diff([0.0, *ends]) < 0):
        raise ValueError(f"times must be one or more that do not decrease from 0 on, got {ends}")
    halves = _Halves(degree)

    M, _ = halves.mass_stiffness(motion, 0.0)
    t, y = 0.0, M @ profile(halves.angles)[1:-1]
    solutions = []
    for end in ends:
        n = int(np.ceil((end - t) / STEP))
        for k in range(n):
            y = _radau(halves, motion, t + (end - t) * k / n, (end - t) / n, y)
        t = end
        M, _ = halves.mass_stiffness(motion, t)
        solutions.append(halves.function(np.asarray(np.linalg.solve(M, y), dtype=float)))
    return solutions


def _radau(halves: "_Halves", motion: Motion, t: float, step: float, y: Array) -> Array:
    """One step for y' = -A M^{-1} y, y = M U, by the method of three stages and order five."""
    c = np.array([(4 - np.sqrt(6)) / 10, (4 + np.sqrt(6)) / 10, 1.0])
    k = np.arange(1, 4)
    a = (c[:, None] ** k / k) @ np.linalg.inv(c[:, None] ** (k - 1))  # collocation at c
    stages = [halves.mass_stiffness(motion, t + step * ci) for ci in c]
    generators = [-np.linalg.solve(M, A).T for M, A in stages]
    n = len(y)
    system = np.eye(3 * n)
    for i, G in enumerate(generators):
        system[i * n : (i + 1) * n] -= step * np.kron(a[i], G)
    slopes = np.linalg.solve(system, np.concatenate([G @ y for G in generators]))
    result: Array = y + step * a[-1] @ slopes.reshape(3, n)
    return result


class _Halves:
    """Continuous functions of θ, polynomials on [0, π/2] and on [π/2, π], zero at both ends."""

    def __init__(self, degree: int) -> None:
        self.degree = degree
        nodes: Array = -np.cos(np.pi * np.arange(degree + 1) / degree)  # Chebyshev's, on [-1, 1]
        self._modes = np.linalg.inv(legendre.legvander(nodes, degree))
        self.angles = np.unique(np.round(self._angle(nodes), 15))
        self.cells = np.add.outer([0, degree], np.arange(degree + 1))
        points, self._weights = legendre.leggauss(degree + 10)
        self._values = self._basis(points)
        slopes = legendre.legval(points, legendre.legder(self._modes)).T
        self._slopes = 4 / np.pi * slopes

    @staticmethod
    def _angle(s: Array) -> Array:
        """θ of the points s in [-1, 1] of both halves, (2, n)."""
        return np.pi / 4 * (np.add.outer([1.0, 3.0], s))

    def _basis(self, s: Array) -> Array:
        values: Array = legendre.legval(s, self._modes).T
        return values

    def mass_stiffness(self, motion: Motion, t: float) -> tuple[Array, Array]:
        """Matrices of both integrals, without the poles."""
        meridian = np.column_stack([np.cos(self.angles), np.sin(self.angles), 0 * self.angles])
        x = motion(meridian, t)[self.cells, :2]  # (2, n, 2)
        radius = np.einsum("qn,cn->cq", self._values, x[..., 1])
        length = np.linalg.norm(np.einsum("qn,cnk->cqk", self._slopes, x), axis=-1)
        area = np.pi / 4 * self._weights * radius * length
        M, A = np.zeros((2, len(self.angles), len(self.angles)))
        V, D = self._values, self._slopes
        for cell, a, r, ell in zip(self.cells, area, radius, length, strict=True):
            at = np.ix_(cell, cell)
            M[at] += V.T * a @ V
            A[at] += D.T * (a / ell**2) @ D + V.T * (a / r**2) @ V
        return M[1:-1, 1:-1], A[1:-1, 1:-1]

    def function(self, inner: Array) -> Callable[[Array], Array]:
        """U = U(θ) cos φ on the unit sphere, from values of U at the inner nodes."""
        U = np.r_[0, inner, 0][self.cells]

        def u(p: Array) -> Array:
            sine = np.hypot(p[:, 1], p[:, 2])
            theta = np.arctan2(sine, p[:, 0])
            half = (theta > np.pi / 2).astype(int)
            s = 4 / np.pi * theta - np.array([1, 3])[half]
            value = np.sum(self._basis(s) * U[half], axis=1)
            cosine = np.divide(p[:, 1], sine, out=np.zeros_like(sine), where=sine > 0)
            result: Array = value * cosine
            return result

        return u
