r"""Multipliers and the matrix G of G-stability ([N] Section 4.1, [LMV] Section 3.3).

For polynomials delta and mu without a common divisor and with Re(delta/mu) > 0 in the unit disc
there are a positive definite G and real gamma_0, ..., gamma_p such that for all vectors

.. math::

    \Bigl\langle \sum_{i=0}^p \delta_i v_{p-i}, \sum_{j=0}^p \mu_j v_{p-j} \Bigr\rangle
    = \sum_{i,j=1}^p g_{ij} \bigl( \langle v_i, v_j \rangle
    - \langle v_{i-1}, v_{j-1} \rangle \bigr) + \Bigl| \sum_{i=0}^p \gamma_i v_i \Bigr|^2

([LMV] Lemma 3.1). On the unit circle Re(delta conj(mu)) is a polynomial F in x = cos(theta), and
the identity says that F is the squared modulus of gamma there. So gamma is a spectral factor of F,
and G follows from it by sums along diagonals. The zero of F at x = 1, there because delta(1) = 0,
and double zeros in (-1, 1), there at the smallest multiplier, are treated apart: near them gamma
itself is ill-conditioned, but its squared modulus, which is all that G needs, is not.
"""

import math
from fractions import Fraction
from functools import cache

import numpy as np
from numpy.polynomial import Polynomial, chebyshev
from numpy.typing import ArrayLike

from esfem_core.checks import Array, finite_array, number, whole_number
from esfem_core.stepping import bdf

__all__ = ["circle_polynomial", "g_matrix", "g_matrix_of", "gammas", "gammas_of", "smallest_eta"]

_LARGEST = 1e100  # coefficient
_ZERO = 1e-15  # a value of F at 1 or -1 this small, relative to its coefficients, is rounding
_BELOW_ONE = 1e-12  # closer to eta = 1 rounding decides whether G, singular there, is definite
_UNTOLD = 1e-13  # a value of F between its zeros this small may be rounding
_SPLIT = 1e-6  # real zeros of F at most this far apart are a double zero that rounding has split


def smallest_eta(p: int) -> float:
    r"""Smallest eta for which delta(z)/(1 - eta z) of BDF has positive real part in the unit disc.

    On the unit circle :math:`\operatorname{Re}[\delta(z) (1 - \eta/z)] = a(x) - \eta b(x)` with
    :math:`x = \operatorname{Re} z`, and b < 0 for x < 1. The smallest eta is the
    maximum of a/b, where a - eta b has a double zero, or 0 if that is negative (p = 1).

    Parameters
    ----------
    p : int
        Order of the backward difference formula, 1 to 5.

    Returns
    -------
    float
        The exact value, rounded up, so that the number returned is itself admissible.

    Raises
    ------
    TypeError, ValueError
        If `p` is not one of 1, ..., 5.

    Examples
    --------
    >>> [round(smallest_eta(p), 10) for p in range(1, 6)]
    [0.0, 0.0, 0.083592135, 0.287806557, 0.8159802251]
    """
    try:
        return _smallest_eta(whole_number("the order p", p, 1, 5))
    except ValueError as error:
        raise ValueError(f"{error}; for p >= 6 no linear multiplier 1 - eta z exists") from None


def g_matrix(p: int, eta: float) -> Array:
    """Matrix G of [LMV] Lemma 3.1 for BDF and the multiplier 1 - eta z.

    Parameters
    ----------
    p : int
        Order of the backward difference formula, 1 to 5.
    eta : float
        At least ``smallest_eta(p)`` and at most 1 - 1e-12: G tends to a singular matrix at 1.

    Returns
    -------
    (p, p) float array
        Symmetric positive definite; ``G[i-1, j-1]`` belongs to v_i and v_j, and v_p is the newest
        value. It goes with the gamma of :func:`gammas`; the lemma alone does not determine it.

    Raises
    ------
    TypeError, ValueError
        If `p` is not one of 1, ..., 5, or `eta` is not admissible.

    Examples
    --------
    >>> 4 * g_matrix(2, 0.0)
    array([[ 1., -2.],
           [-2.,  5.]])
    """
    return g_matrix_of(*_pair(p, eta))


def gammas(p: int, eta: float) -> Array:
    """Coefficients of the square in [LMV] Lemma 3.1 for BDF and the multiplier 1 - eta z.

    Parameters
    ----------
    p, eta
        As for :func:`g_matrix`.

    Returns
    -------
    (p+1,) float array
        ``gammas(p, eta)[i]`` belongs to v_i: the last one to the newest value.

    Raises
    ------
    TypeError, ValueError
        As of :func:`g_matrix`.

    Examples
    --------
    >>> gammas(2, 0.0)
    array([ 0.5, -1. ,  0.5])
    """
    return gammas_of(*_pair(p, eta))


def circle_polynomial(delta: ArrayLike, mu: ArrayLike) -> Polynomial:
    """Real part of delta(z) conj(mu(z)) on the unit circle, as a polynomial F in x = Re z.

    Parameters
    ----------
    delta, mu : sequences of float
        Real coefficients, those of the newest value (lowest power) first; the shorter sequence is
        filled up with zeros.

    Returns
    -------
    numpy.polynomial.Polynomial
        F. If mu has no zero in the closed disc, delta/mu has positive real part in the open disc if
        and only if F is not zero and F >= 0 on [-1, 1].

    Raises
    ------
    TypeError, ValueError
        If one is no sequence of finite numbers, or the largest of them is not between 1e-100 and
        1e100 in size.

    Examples
    --------
    >>> circle_polynomial([1.5, -2.0, 0.5], [1.0]).coef
    array([ 1., -2.,  1.])
    """
    d, m = _coefficients(delta, mu)
    product = np.convolve(d, m[::-1])  # of z^k for k = -p, ..., p
    series = product[len(d) - 1 :].copy()
    series[1:] += product[: len(d) - 1][::-1]  # z^k + z^(-k) = 2 T_k(x)
    return Polynomial(chebyshev.cheb2poly(series))


def gammas_of(delta: ArrayLike, mu: ArrayLike) -> Array:
    """Coefficients of the square for any two polynomials: a spectral factor of F.

    Parameters
    ----------
    delta, mu : sequences of float
        As for :func:`circle_polynomial`.

    Returns
    -------
    (p+1,) float array
        gamma_0, ..., gamma_p, where p is the larger degree; the last belongs to the newest value.
        Each zero of F outside [-1, 1] leaves a choice. Here gamma_0 >= 0 and sum_i gamma_i z^i has
        no zero in the open unit disc, which gives the largest G.

    Raises
    ------
    TypeError, ValueError
        If the real part of delta/mu is negative somewhere on the unit circle, or may be: several
        double zeros of F within 1e-3 or so of each other are lost in rounding.

    Examples
    --------
    >>> gammas_of([1, -1], [1]).round(4)  # backward Euler
    array([ 0.7071, -0.7071])
    """
    d, m = _coefficients(delta, mu)
    negative = (
        "delta and mu must have Re(delta/mu) >= 0, but Re(delta/mu) is negative on part of the "
        "unit circle, so that no G exists"
    )
    tiny = _ZERO * np.abs(d).sum() * np.abs(m).sum()
    F = circle_polynomial(d, m).trim(tiny)
    if np.abs(F.coef).max() <= tiny:
        return np.zeros(len(d))  # as for the trapezoidal rule
    whole, factor = F, np.ones(1, dtype=complex)
    for end in (1.0, -1.0):  # 1 - x = |1 - z|^2/2 and 1 + x = |1 + z|^2/2
        while abs(F(end)) <= _ZERO * np.abs(F.coef).sum():
            F //= Polynomial([-end, 1.0])
            factor = np.convolve(factor, [1.0, -end])
    roots = F.roots().astype(complex)
    on_circle = (roots.imag == 0) & (np.abs(roots) < 1)
    c = np.sort(roots.real[on_circle])
    if len(c) % 2 or np.any(c[1::2] - c[::2] > _SPLIT):
        at = f"cos(theta) = {c.round(6).tolist()}"
        ends = np.concatenate([[-1.0], c, [1.0]])
        if np.all(whole((ends[1:] + ends[:-1]) / 2) >= -_UNTOLD * np.abs(whole.coef).sum()):
            raise ValueError(
                "delta and mu must have Re(delta/mu) >= 0, but whether they have is lost in "
                f"rounding: the zeros of its numerator found at {at} are changes of sign or "
                "several double zeros close together"
            )
        raise ValueError(f"{negative}; its sign changes at {at}")
    for x in (c[::2] + c[1::2]) / 2:  # (cos(theta) - x)^2 = |1 - 2 x z + z^2|^2/4
        factor = np.convolve(factor, [1.0, -2 * x, 1.0])
    for x in roots[~on_circle]:  # cos(theta) - x = const. |1 - w z|^2, where (w + 1/w)/2 = x
        root = np.sqrt(x - 1) * np.sqrt(x + 1)
        factor = np.convolve(factor, [1.0, -1 / max(x + root, x - root, key=abs)])
    mean = d @ m  # of F over the circle, and so of |gamma|^2
    if mean <= 0:
        raise ValueError(negative)
    gamma = np.pad(factor.real, (0, len(d) - len(factor)))
    return np.asarray(gamma * np.sqrt(mean / (gamma @ gamma)))


def g_matrix_of(delta: ArrayLike, mu: ArrayLike) -> Array:
    """Matrix G of [LMV] Lemma 3.1 for any two polynomials.

    Parameters
    ----------
    delta, mu : sequences of float
        As for :func:`circle_polynomial`.

    Returns
    -------
    (p, p) float array
        Symmetric positive definite, numbered as in :func:`g_matrix`.

    Raises
    ------
    TypeError, ValueError
        If Re(delta/mu) is not positive in the unit disc, or delta and mu have a common divisor with
        a zero in the closed unit disc. One whose zeros lie outside does no harm.

    Examples
    --------
    The trapezoidal rule, and BDF6 with the multiplier of Akrivis, Chen, Yu and Zhou (2021):

    >>> g_matrix_of([1, -1], [0.5, 0.5])
    array([[0.5]])
    >>> G = g_matrix_of(bdf.delta(6), [1, -13 / 9, 25 / 36, -1 / 9])
    >>> float(np.linalg.eigvalsh(G)[0].round(5))
    0.00836
    """
    d, m = (c[::-1] for c in _coefficients(delta, mu))  # in the order v_0, ..., v_p
    gamma = gammas_of(delta, mu)
    # R is G set at the lower right minus G set at the upper left
    R = (np.outer(d, m) + np.outer(m, d)) / 2 - np.outer(gamma, gamma)
    G = R[1:, 1:].copy()
    for i in range(len(G) - 2, -1, -1):
        G[i, :-1] += G[i + 1, 1:]
    G = (G + G.T) / 2
    lowest = np.linalg.eigvalsh(G).min(initial=np.inf)
    if lowest <= _ZERO * np.trace(G):
        raise ValueError(
            "delta and mu must have no common divisor with a zero in the closed unit disc, and mu "
            "no zero in the open one, but G is not positive definite (lowest eigenvalue "
            f"{lowest:.1e})"
        )
    return G


@cache
def _smallest_eta(p: int) -> float:
    d = bdf.delta(p)
    a, b = circle_polynomial(d, [1.0]), -circle_polynomial(d, [0.0, 1.0])
    stationary = (a.deriv() * b - a * b.deriv()).roots()
    inside = stationary.real[(abs(stationary.imag) < 1e-9) & (abs(stationary.real) < 1)]
    best = max((_eta_at(p, Fraction(float(x))) for x in inside), default=Fraction(0))
    eta = max(0.0, float(best))
    return eta if eta >= best else math.nextafter(eta, 1.0)


def _eta_at(p: int, x: Fraction) -> Fraction:
    # a/b in exact arithmetic; at a maximum, the error of x enters squared
    d, T = bdf.delta_exact(p), [Fraction(1), x]
    for _ in range(p):
        T.append(2 * x * T[-1] - T[-2])
    a = sum(c * T[j] for j, c in enumerate(d))
    return Fraction(a / sum(c * T[abs(j - 1)] for j, c in enumerate(d)))


def _pair(p: int, eta: float) -> tuple[Array, Array]:
    lowest, eta = smallest_eta(p), number("eta", eta, least=0, below=1)
    if eta < lowest:
        raise ValueError(
            f"eta = {eta!r} is not admissible for p = {p}: Re[delta(z)/(1 - eta z)] becomes "
            f"negative, so that no G exists; eta must be at least {lowest!r}"
        )
    if eta > 1 - _BELOW_ONE:
        raise ValueError(
            f"eta must be at most 1 - {_BELOW_ONE:g}, got 1 - {1 - eta:.1e}: at 1 G is singular, "
            "and rounding would decide whether it is positive definite"
        )
    return bdf.delta(p), np.array([1.0, -eta])


def _coefficients(delta: ArrayLike, mu: ArrayLike) -> tuple[Array, Array]:
    d, m = finite_array("delta", delta, ("n",)), finite_array("mu", mu, ("n",))
    for name, c in (("delta", d), ("mu", m)):
        if len(c) == 0:
            raise ValueError(f"{name} must hold at least one coefficient, got none")
        if np.abs(c).max() > _LARGEST:
            raise ValueError(
                f"{name} must hold coefficients up to {_LARGEST:g}, got {np.abs(c).max():.3g}: "
                "their products would overflow"
            )
        if np.abs(c).max() < 1 / _LARGEST:
            raise ValueError(
                f"{name} must hold a coefficient of {1 / _LARGEST:g} or more, got "
                f"{np.abs(c).max():.3g} at most: products would vanish"
            )
    n = max(len(d), len(m))
    return np.pad(d, (0, n - len(d))), np.pad(m, (0, n - len(m)))
