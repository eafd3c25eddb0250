"""Quadrature on the reference triangle with corners (0, 0), (1, 0), (0, 1)."""

from typing import NamedTuple

import numpy as np
from scipy.special import roots_jacobi, roots_legendre

from esfem_core.checks import Array, frozen, whole_number

__all__ = ["TriangleRule", "triangle_rule"]

# Symmetric rules of Dunavant (1985), polished in 40 digits: exactness -> orbits of
# (weight, barycentric coordinates...), weights adding up to one. An orbit with no coordinate is
# the centroid, with one coordinate a the permutations of (a, a, 1 - 2a), with two those of
# (a, b, 1 - a - b).
_ORBITS: dict[int, tuple[tuple[float, ...], ...]] = {
    1: ((1.0,),),
    2: ((1 / 3, 1 / 6),),
    4: (
        (0.22338158967801146570, 0.44594849091596488632),
        (0.10995174365532186764, 0.091576213509770743460),
    ),
    6: (
        (0.11678627572637936603, 0.24928674517091042129),
        (0.050844906370206816921, 0.063089014491502228340),
        (0.082851075618373575194, 0.053145049844816947353, 0.31035245103378440542),
    ),
    8: (
        (0.14431560767778716825,),
        (0.095091634267284624794, 0.45929258829272315603),
        (0.10321737053471825028, 0.17056930775176020662),
        (0.032458497623198080311, 0.050547228317030975458),
        (0.027230314174434994265, 0.0083947774099576053372, 0.26311282963463811342),
    ),
}


# Odd, as the exactness of a product rule is: what a rule states can always be asked for again.
MOST_EXACTNESS = 101  # of a product of Gauss rules with 2,601 points


class TriangleRule(NamedTuple):
    """Points and weights on the reference triangle.

    Attributes
    ----------
    points : (Q, 2) float array
        Reference coordinates (xi, eta).
    weights : (Q,) float array
        Positive, adding up to the triangle's area 1/2.
    exactness : int
        Polynomials up to this degree are integrated exactly.
    """

    points: Array
    weights: Array
    exactness: int


def triangle_rule(exactness: int) -> TriangleRule:
    """Positive quadrature rule that integrates polynomials of a given degree exactly.

    Symmetric rules with 1, 3, 6, 12, 16 points up to degree 8; beyond, products of Gauss rules.

    Parameters
    ----------
    exactness : int
        Polynomial degree, 0 to 101.

    Returns
    -------
    TriangleRule
        Its `exactness` may be larger than asked for.

    Raises
    ------
    ValueError, TypeError
        If `exactness` is not one of 0, ..., 101.

    Examples
    --------
    >>> rule = triangle_rule(4)
    >>> len(rule.weights), round(float(rule.weights @ rule.points[:, 0] ** 4), 15)
    (6, 0.033333333333333)
    """
    exactness = whole_number("exactness", exactness, 0, MOST_EXACTNESS)
    for degree, orbits in _ORBITS.items():
        if degree >= exactness:
            return _symmetric_rule(degree, orbits)
    return _product_rule(exactness)


def _symmetric_rule(degree: int, orbits: tuple[tuple[float, ...], ...]) -> TriangleRule:
    points, weights = [], []
    for weight, *coordinates in orbits:
        match coordinates:
            case []:
                orbit = {(1 / 3, 1 / 3)}
            case [a]:
                orbit = {(a, a), (a, 1 - 2 * a), (1 - 2 * a, a)}
            case [a, b]:
                c = 1 - a - b
                orbit = {(a, b), (b, a), (a, c), (c, a), (b, c), (c, b)}
        points.extend(sorted(orbit))
        weights.extend([weight / 2] * len(orbit))
    return TriangleRule(frozen(np.array(points)), frozen(np.array(weights)), degree)


def _product_rule(degree: int) -> TriangleRule:
    """Gauss rule in s and Gauss-Jacobi rule in r on xi = r, eta = (1 - r) s."""
    n = degree // 2 + 1
    s, ws = roots_legendre(n)
    r, wr = roots_jacobi(n, 1, 0)  # weight 1 - r: the Jacobian of the collapse
    s, r = (1 + s) / 2, (1 + r) / 2
    xi = np.repeat(r, n)
    eta = np.outer(1 - r, s).ravel()
    weights = np.outer(wr / 4, ws / 2).ravel()
    return TriangleRule(frozen(np.column_stack([xi, eta])), frozen(weights), 2 * n - 1)
