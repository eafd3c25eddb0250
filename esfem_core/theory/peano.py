r"""Peano kernels: the errors of difference quotients and extrapolation as integrals.

A linear functional that is zero for polynomials of degree less than m and looks back p steps is

.. math:: E[y](t) = \tau^m \int_0^p \kappa(\theta)\, y^{(m)}(t - \theta\tau)\, d\theta

with a kernel that belongs to the coefficients alone. From Taylor's formula with the remainder as
an integral, :math:`\kappa(\theta) = E[(\cdot + \theta)_+^{m-1}]/(m-1)!` at t = 0 for
:math:`\tau = 1`: a piecewise polynomial with breaks at 0, 1, ..., p. A quotient that is divided by
:math:`\tau`, as that of BDF, has :math:`\tau^{m-1}` instead. [N] 6.2 and 6.3 and the
proof of [LMV] Theorem 5.1 use it to bound defects in time; here it is computed.
"""

from collections.abc import Sequence
from fractions import Fraction
from math import comb, factorial
from typing import TYPE_CHECKING

import numpy as np

from esfem_core.checks import whole_number
from esfem_core.stepping.bdf import delta_exact, gamma

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

__all__ = ["bdf_kernel", "extrapolation_kernel"]


def bdf_kernel(p: int, degree: int | None = None) -> "PPoly":
    r"""Kernel of the error of the BDF quotient.

    .. math::

        \frac1\tau \sum_{j=0}^p \delta_j\, y(t - j\tau) - y'(t)
        = \tau^q \int_0^p \kappa(\theta)\, y^{(q+1)}(t - \theta\tau)\, d\theta

    with q = p, or less for functions that have fewer derivatives. [LMV] in the proof of Theorem
    5.1 writes the error with the opposite sign, so that its sigma is -kappa.

    Parameters
    ----------
    p : int
        Order and number of steps, 1 to 30.
    degree : int, optional
        q = 1..p, which is also the degree of the pieces; p if None.

    Returns
    -------
    scipy.interpolate.PPoly
        kappa on [0, p], NaN outside. For q = p its integral is the error constant -1/(p+1).

    Raises
    ------
    TypeError, ValueError
        If `p` is not one of 1, ..., 30, or `degree` not one of 1, ..., p.

    Examples
    --------
    >>> kappa = bdf_kernel(2)
    >>> print(f"{kappa(0.5):.4f} {float(kappa.integrate(0, 2)):.4f}")
    -0.3125 -0.3333
    """
    p, q = _orders(p, degree)
    d = delta_exact(p)
    # E[(s + theta)_+^q] = sum_j delta_j (theta - j)_+^q - q theta^(q-1)
    terms = [(c, j, q) for j, c in enumerate(d)]
    return _truncated_powers([*terms, (Fraction(-q), 0, q - 1)], p, q)


def extrapolation_kernel(p: int, degree: int | None = None) -> "PPoly":
    r"""Kernel of the error of extrapolation from p values.

    .. math::

        \sum_{j=0}^{p-1} \gamma_j\, y(t - (j+1)\tau) - y(t)
        = \tau^q \int_0^p \kappa(\theta)\, y^{(q)}(t - \theta\tau)\, d\theta

    Parameters
    ----------
    p : int
        Number of values, 1 to 30.
    degree : int, optional
        q = 1..p; p if None. The pieces have degree q - 1.

    Returns
    -------
    scipy.interpolate.PPoly
        kappa on [0, p], NaN outside. For q = p its integral is -1.

    Raises
    ------
    TypeError, ValueError
        As for :func:`bdf_kernel`.

    Examples
    --------
    >>> kappa = extrapolation_kernel(2)  # 2 y(t - tau) - y(t - 2 tau)
    >>> print(f"{kappa(0.5):.4f} {float(kappa.integrate(0, 2)):.4f}")
    -0.5000 -1.0000
    """
    p, q = _orders(p, degree)
    g = [Fraction(int(c)) for c in gamma(p)]
    terms = [(c, j + 1, q - 1) for j, c in enumerate(g)]
    return _truncated_powers([*terms, (Fraction(-1), 0, q - 1)], p, q - 1)


def _orders(p: int, degree: int | None) -> tuple[int, int]:
    """Check p and q, which is p if not given."""
    p = whole_number("the order p", p, 1, 30)
    return p, p if degree is None else whole_number("degree", degree, 1, p)


def _truncated_powers(terms: Sequence[tuple[Fraction, int, int]], p: int, degree: int) -> "PPoly":
    """Sum of c (theta - j)_+^n / degree! on [0, p], from exact coefficients around each break."""
    coefficients = np.zeros((degree + 1, p))
    for piece in range(p):
        exact = [Fraction(0)] * (degree + 1)
        for c, j, n in terms:
            if j <= piece:
                for m in range(n + 1):  # (theta - piece)^m
                    exact[m] += c * comb(n, m) * Fraction(piece - j) ** (n - m)
        coefficients[:, piece] = [float(e / factorial(degree)) for e in reversed(exact)]
    from scipy.interpolate import PPoly  # a tenth of the package's start, for this alone

    return PPoly(coefficients, np.arange(p + 1.0), extrapolate=False)
