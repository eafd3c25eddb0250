"""Whether a function that comes with its derivatives is smooth on a surface: no jump, no kink.

Derivatives of a formula do not show where it switches: those of atan2 are smooth where it jumps by
2 pi, and the second ones of a kink lack what stands there. So differences along short segments s
are compared with derivatives, ::

    e = |F(x + s) - F(x) - s . (DF(x) + DF(x + s))/2|  for F = w and F = Dw,

which is of third order in s where F is smooth, and stays near the jump of F, however short s is,
where that crosses one. Where w has a kink, Dw jumps.
"""

from collections.abc import Callable

import numpy as np

from esfem_core.checks import Array

__all__ = ["find_break", "walks"]

STEP = 0.03  # length of a segment, relative to the distance from the origin
STEPS = 20  # of a walk
BENT = 0.1  # how far, relative to its length, a segment may lead away from the surface
HALVINGS = 15  # of a segment: what is steep over a millionth of the surface counts as a jump
JUMP = 0.01  # the least that counts, relative to the range of F on a walk
ROUNDING = 1e-9  # what ranges over less, relative to F or absolutely, is a constant

_Derivatives = Callable[[Array], tuple[Array, Array, Array]]


def walks(x: Array, correction: Callable[[Array], Array]) -> Array:
    """Walks on a surface, as straight as can be.

    Parameters
    ----------
    x : (n, 3) float array
        Where they begin.
    correction : callable
        The Newton step, (n, 3), to the surface from points (n, 3) near it.

    Returns
    -------
    (STEPS + 1, n, 3) float array
        Where the surface is too strongly curved for a step, it is halved, and tried next time.
    """
    way = np.random.default_rng(1).normal(size=x.shape)
    length = STEP * np.linalg.norm(x, axis=1, keepdims=True)
    found = [x]
    for _ in range(STEPS):
        way *= length / np.linalg.norm(way, axis=1, keepdims=True)
        to = x + way
        for _ in range(3):
            to = to + correction(to)
        straight = np.linalg.norm(to - x - way, axis=1, keepdims=True) <= BENT * length
        way = np.where(straight, to - x, way)
        length = np.where(straight, length, length / 2)
        x = np.where(straight, to, x)
        found.append(x)
    return np.stack(found)


def find_break(function: _Derivatives, path: Array) -> Array | None:
    """A point near which a function jumps or has a kink, if a walk crosses that place.

    Parameters
    ----------
    function : callable
        Of points (..., 3): w, (..., m), and its derivatives, (..., m, 3) and (..., m, 3, 3).
    path : (K, n, 3) float array
        The walks.

    Returns
    -------
    (3,) float array or None

    Examples
    --------
    The ramp max(0, x1) on a line:

    >>> path = np.linspace([[-1.0, 1.0, 0.0]], [[1.0, 1.0, 0.0]], 20)
    >>> def ramp(x):
    ...     up = (x[..., :1] > 0) * 1.0
    ...     slope = up[..., None] * [1, 0, 0]
    ...     return up * x[..., :1], slope, 0 * slope[..., None] * np.ones(3)
    >>> bool(abs(find_break(ramp, path)[0]) < 1e-5)
    True
    """
    with np.errstate(all="ignore"):  # what is not finite is refused where it is used
        for order in (0, 1):
            F, _ = _pair(function, order, path)
            least = JUMP * (np.ptp(F, axis=0) + ROUNDING * (1 + np.abs(F).max(axis=0)))
            least = np.tile(least, (len(path) - 1, 1))
            a, b = path[:-1].reshape(-1, 3), path[1:].reshape(-1, 3)
            for _ in range(HALVINGS):
                rest, change = _rest(function, order, a, b)
                least = np.fmax(least, JUMP * change)  # a range that the walk has stepped over
                jumps = (rest >= least).any(axis=1)  # not where it is not finite
                a, b, least = a[jumps], b[jumps], least[jumps]
                if not len(a):
                    break
                middle = (a + b) / 2
                left, right = (_rest(function, order, *s)[0] for s in ((a, middle), (middle, b)))
                first = ((left / least).max(axis=1) >= (right / least).max(axis=1))[:, None]
                a, b = np.where(first, a, middle), np.where(first, middle, b)
            else:
                found: Array = a[0]
                return found
    return None


def _pair(function: _Derivatives, order: int, x: Array) -> tuple[Array, Array]:
    """F, (..., c), and DF, (..., c, 3): w and its gradient, or the gradient and its own."""
    F, DF = function(x)[order : order + 2]
    shape = (*x.shape[:-1], 3**order * DF.shape[x.ndim - 1])
    return F.reshape(shape), DF.reshape(*shape, 3)


def _rest(function: _Derivatives, order: int, a: Array, b: Array) -> tuple[Array, Array]:
    """What is called e above, and |F(b) - F(a)|, both (n, c), of segments from a to b, (n, 3)."""
    (F, DF), (G, DG) = _pair(function, order, a), _pair(function, order, b)
    expected = np.einsum("nci,ni->nc", (DF + DG) / 2, b - a)
    return np.abs(G - F - expected), np.abs(G - F)
