r"""Central differences: the derivative of a function of one number.

The stencil of even order 2m uses the values at t + j h for j = -m, ..., m without j = 0:

    f'(t) = (1/h) sum_j w_j f(t + j h) + O(h^{2m}),
    w_j   = (-1)^{j+1} (m!)^2 / (j (m - j)! (m + j)!),    w_{-j} = -w_j,

which is exact for polynomials of degree 2m.
"""

from collections.abc import Callable
from math import factorial

import numpy as np
from numpy.typing import ArrayLike

from esfem_core.checks import Array, number, whole_number

__all__ = ["central_stencil", "derivative"]


def central_stencil(order: int) -> tuple[tuple[int, float], ...]:
    """Offsets j and weights w_j of the central difference of an even order.

    Parameters
    ----------
    order : int
        2m, even and positive.

    Returns
    -------
    tuple of 2m pairs (int, float)
        In the order of the offsets, -m to m without 0.

    Raises
    ------
    TypeError, ValueError
        If `order` is not an even positive integer.

    Examples
    --------
    >>> central_stencil(2)
    ((-1, -0.5), (1, 0.5))
    >>> central_stencil(4) == ((-2, 1 / 12), (-1, -2 / 3), (1, 2 / 3), (2, -1 / 12))
    True
    """
    order = whole_number("order", order, 2)
    if order % 2:
        raise ValueError(f"order of a central difference must be even, got {order}")
    m = order // 2

    def weight(j: int) -> float:
        # One quotient of two integers: correctly rounded.
        top, bottom = factorial(m) ** 2, j * factorial(m - j) * factorial(m + j)
        return (top if j % 2 else -top) / bottom

    return tuple((j, weight(j)) for j in range(-m, m + 1) if j)


def derivative(
    function: Callable[[float], ArrayLike], t: float = 0.0, *, order: int = 8, step: float = 0.01
) -> Array:
    """Derivative of a function of one number, by a central difference.

    Truncation leaves an error of about (step/scale)^order, where scale is the length on which the
    function varies, and rounding one of about 1e-16/step. With the defaults and a scale of one
    both are below 1e-13.

    Parameters
    ----------
    function : callable
        Takes a float and returns a number or an array, always of the same shape.
    t : float
        Where to differentiate.
    order : int
        Even and positive; as many values of `function` are taken.
    step : float
        h, positive.

    Returns
    -------
    float array
        Of the shape of the values.

    Raises
    ------
    TypeError, ValueError
        If `order` is not an even positive integer, `step` not positive, or `t` not finite.

    Examples
    --------
    >>> bool(abs(derivative(np.sin, 1.0) - np.cos(1.0)) < 1e-13)
    True
    >>> derivative(lambda s: np.array([s**2, s**4]), 1.0, order=4, step=0.5).round(12)
    array([2., 4.])
    """
    t, h = number("t", t), number("step", step, above=0)
    # A copy: the second call may write into the array that the first one has returned.
    parts = [
        w * (np.array(function(t + j * h)) - np.asarray(function(t - j * h)))
        for j, w in central_stencil(order)
        if j > 0
    ]
    return np.asarray(np.sum(parts, axis=0) / h)
