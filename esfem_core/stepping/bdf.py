"""Coefficients of the backward difference formulas and of extrapolation ([N] (2.22), [LMV] (3.2)).

Newest value first throughout. (The sum in [N] (2.18) runs the other way, from the oldest value;
(2.22) and 2.11.1 run from the newest, and only that is an extrapolation.)
"""

from collections.abc import Iterable, Sequence
from fractions import Fraction
from functools import lru_cache
from math import comb

import numpy as np

from esfem_core.checks import Array, iterable, number, real_array, shown, whole_number

__all__ = ["combine", "delta", "delta_exact", "extrapolate", "gamma"]

MOST_STEPS = 100  # the coefficients are beyond 1e28 there, and no step can be made with them


def delta(p: int) -> Array:
    r"""Coefficients of the p-step backward difference formula ([N] (2.22), [LMV] (3.2)).

    .. math::

        \delta(z) = \sum_{j=0}^p \delta_j z^j = \sum_{l=1}^p \frac{(1 - z)^l}{l}, \qquad
        \frac1\tau \sum_{j=0}^p \delta_j\, y(t - j\tau) = y'(t) + O(\tau^p)

    Summed in exact rationals.

    Parameters
    ----------
    p : int
        Order and number of steps, 1 to 100. Zero-stable for p <= 6 only.

    Returns
    -------
    (p+1,) float array
        ``delta(p)[j]`` belongs to t - j tau.

    Raises
    ------
    TypeError, ValueError
        If `p` is not one of 1, ..., 100.

    Examples
    --------
    >>> delta(2)
    array([ 1.5, -2. ,  0.5])
    """
    return np.array([float(c) for c in delta_exact(p)])


def gamma(p: int) -> Array:
    r"""Coefficients of extrapolation from the p last values ([N] (2.22)).

    .. math::

        \gamma(z) = \sum_{j=0}^{p-1} \gamma_j z^j = \frac{1 - (1 - z)^p}{z}, \qquad
        \sum_{j=0}^{p-1} \gamma_j\, y(t - (j+1)\tau) = y(t) + O(\tau^p)

    Parameters
    ----------
    p : int
        Number of values, 1 to 100.

    Returns
    -------
    (p,) float array
        ``gamma(p)[j]`` belongs to t - (j+1) tau.

    Raises
    ------
    TypeError, ValueError
        If `p` is not one of 1, ..., 100.

    Examples
    --------
    >>> gamma(3)
    array([ 3., -3.,  1.])
    """
    return np.array(_gamma(whole_number("the order p", p, 1, MOST_STEPS)))


@lru_cache
def _gamma(p: int) -> tuple[float, ...]:
    return tuple((-1.0) ** j * comb(p, j + 1) for j in range(p))


def delta_exact(p: int) -> tuple[Fraction, ...]:
    """Coefficients of :func:`delta` as exact fractions.

    Raises
    ------
    TypeError, ValueError
        As of :func:`delta`.
    """
    return _delta_exact(whole_number("the order p", p, 1, MOST_STEPS))


@lru_cache
def _delta_exact(p: int) -> tuple[Fraction, ...]:
    return tuple(
        sum(((-1) ** j * Fraction(comb(m, j), m) for m in range(max(j, 1), p + 1)), Fraction(0))
        for j in range(p + 1)
    )


def extrapolate(values: Sequence[Array]) -> Array:
    r"""Extrapolate equidistant values to the next, [N] (2.18).

    .. math:: \sum_{j=0}^{p-1} \gamma_j\, \text{values}[j]

    Parameters
    ----------
    values : sequence of arrays of one shape
        p of them, up to 100, newest first: the polynomial through them has degree p - 1.

    Returns
    -------
    array of this shape

    Raises
    ------
    TypeError, ValueError
        If there is none, or they are not real arrays of one shape.

    Examples
    --------
    >>> extrapolate([np.array([4.0]), np.array([1.0]), np.array([0.0])])  # of t^2
    array([9.])
    """
    if not isinstance(values, Sequence) or not len(values):
        raise TypeError(f"values must be a sequence of arrays of one shape, got {shown(values)}")
    if len(values) > MOST_STEPS:
        raise ValueError(f"values must be {MOST_STEPS} or fewer, got {len(values)}")
    return combine(_gamma(len(values)), values)


def combine(coefficients: Iterable[float], values: Iterable[Array]) -> Array:
    """Sum of coefficients[j] values[j], summed in this order.

    Parameters
    ----------
    coefficients : iterable of float
    values : iterable of arrays of one shape

    Raises
    ------
    ValueError
        If there is not one value for each coefficient, their shapes differ, or a coefficient is
        not finite.
    TypeError
        If a coefficient is no real number, or a value does not hold such.

    Examples
    --------
    >>> combine(delta(2), [np.array([4.0]), np.array([1.0]), np.array([0.0])])  # 2 t at t = 2
    array([4.])
    """
    _check_iterables(coefficients, values)
    weights = list(coefficients)
    _check_weights(weights)
    arrays = [real_array(f"values[{j}]", value, ("...",)) for j, value in enumerate(values)]
    if not len(weights) == len(arrays) > 0:
        raise ValueError(
            f"values must hold one array for each of {len(weights)} coefficients, at least one, "
            f"got {len(arrays)}"
        )
    total: Array = weights[0] * arrays[0]
    shape = np.shape(total)
    for j in range(1, len(arrays)):
        if np.shape(arrays[j]) != shape:  # NumPy would repeat the smaller one
            raise ValueError(
                f"values must have one shape, but values[{j}] has {np.shape(arrays[j])} and "
                f"values[0] has {shape}"
            )
        total += weights[j] * arrays[j]
    return total


def _check_iterables(coefficients: object, values: object) -> None:
    iterable("coefficients", coefficients, "numbers")
    iterable("values", values, "arrays of one shape")


def _check_weights(weights: Sequence[float]) -> None:
    for j, weight in enumerate(weights):
        number(f"coefficients[{j}]", weight)
