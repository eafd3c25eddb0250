"""Stored rows of one experiment as curves over the step, and where which error dominates.

Rows have the parameters ``order`` and ``steps_per_unit`` (1/tau), as those of
:mod:`esfem_core.companion.experiments.ellipsoid`. The spatial error of a mesh is read off from
BDF5 with its smallest step; the temporal error dominates where an error is at least twenty times
that large, so that space falsifies an order by less than 0.1.
"""

from collections.abc import Iterable
from itertools import pairwise
from typing import Any

import numpy as np

from esfem_core.checks import Array
from esfem_core.study import Row, observed_orders, select

__all__ = ["MARGIN", "curve", "floor", "orders_in_time", "where_space_begins"]

MARGIN = 20
"""How many times the spatial error an error must be, to be taken for a temporal one."""

_FINEST = 5  # order of the method whose smallest step leaves the spatial error


def curve(rows: Iterable[Row], norm: str, **parameters: Any) -> tuple[Array, Array]:
    """Steps and errors of the rows with these parameters, coarsest step first.

    Parameters
    ----------
    rows : iterable of Row
    norm : str
        Name of the result.
    **parameters
        As for :func:`esfem_core.study.select`.

    Returns
    -------
    steps, errors : (n,) float arrays
        Empty if there is no such row.

    Raises
    ------
    ValueError
        If there are several rows with one step: of two meshes, say.
    KeyError
        If a row does not have this result.

    Examples
    --------
    >>> rows = [Row({"order": 5, "steps_per_unit": n}, {"l2": 2.0**-n}, {}) for n in (8, 4)]
    >>> steps, errors = curve(rows, "l2", order=5)
    >>> print(steps, errors)
    [0.25  0.125] [0.0625     0.00390625]
    """
    found = select(rows, **parameters)
    for row in found:
        if norm not in row.results:
            known = ", ".join(map(repr, row.results)) or "none"
            raise KeyError(f"rows have no result {norm!r}, only {known}")
    points = sorted((-1 / r.parameters["steps_per_unit"], r.results[norm]) for r in found)
    for (step, _), (next_step, _) in pairwise(points):
        if step == next_step:
            given = ", ".join(f"{name} = {value!r}" for name, value in parameters.items())
            raise ValueError(
                f"rows must be one for each step, but two have {given and given + ', '}step "
                f"{-step:g}: another parameter must tell them apart"
            )
    steps, errors = np.array(points, dtype=float).reshape(-1, 2).T
    return -steps, errors


def floor(rows: Iterable[Row], norm: str, **selection: Any) -> float:
    """Return the spatial error of a mesh: the error of BDF5 with the smallest step.

    Raises
    ------
    LookupError
        If BDF5 was not run there.

    Examples
    --------
    >>> floor([Row({"order": 5, "steps_per_unit": 8}, {"l2": 0.25}, {})], "l2")
    0.25
    """
    _, errors = curve(rows, norm, **selection | {"order": _FINEST})
    if not len(errors):
        raise LookupError(f"there is no row of BDF5 with {selection}, which the floor is read from")
    return float(errors[-1])


def orders_in_time(rows: Iterable[Row], norm: str, order: int, **selection: Any) -> Array:
    """Orders between neighbouring steps, as far as the temporal error dominates.

    Parameters
    ----------
    rows : iterable of Row
    norm : str
        Name of the result.
    order : int
        Of the BDF method.
    **selection
        Mesh and elements.

    Returns
    -------
    (n,) float array
        Coarsest step first; empty if fewer than two steps are left.

    Examples
    --------
    >>> errors = {4: 0.1, 8: 0.0125, 16: 1e-5}
    >>> rows = [Row({"order": 5, "steps_per_unit": n}, {"l2": e}, {}) for n, e in errors.items()]
    >>> orders_in_time(rows, "l2", 5)
    array([3.])
    """
    rows = list(rows)
    steps, errors = curve(rows, norm, **selection, order=order)
    dominant = errors > MARGIN * floor(rows, norm, **selection)
    return observed_orders(steps[dominant], errors[dominant])


def where_space_begins(
    rows: Iterable[Row], norm: str, order: int, **selection: Any
) -> float | None:
    """Return the largest step with which half of the error or more is spatial.

    Returns
    -------
    float or None
        None if no step is small enough.

    Examples
    --------
    >>> errors = {4: 0.1, 8: 0.0125, 16: 0.01}
    >>> rows = [Row({"order": 5, "steps_per_unit": n}, {"l2": e}, {}) for n, e in errors.items()]
    >>> where_space_begins(rows, "l2", 5)
    0.125
    """
    rows = list(rows)
    steps, errors = curve(rows, norm, **selection, order=order)
    below = np.flatnonzero(errors < 2 * floor(rows, norm, **selection))
    return float(steps[below[0]]) if len(below) else None
