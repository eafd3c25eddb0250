"""Convergence studies: errors over a range of step or mesh sizes, and their observed orders."""

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from esfem_core import errors
from esfem_core.elements import SurfaceSpace
from esfem_core.problems import Problem
from esfem_core.stepping import State, evolve
from esfem_core.tables import html_table

__all__ = ["ConvergenceTable", "final", "observed_orders", "space_study", "time_study"]

Array = NDArray[np.float64]


def final(states: Iterable[State]) -> State:
    """Run to the end and return the last state.

    Raises
    ------
    ValueError
        If there are no states.
    """
    last = deque(states, maxlen=1)
    if not last:
        raise ValueError("there are no states")
    return last[0]


def observed_orders(sizes: Sequence[float] | Array, values: Sequence[float] | Array) -> Array:
    """Orders between neighbours, log(e_i/e_{i+1})/log(h_i/h_{i+1}).

    Parameters
    ----------
    sizes, values : (n,) sequences of positive floats

    Returns
    -------
    (n-1,) float array

    Examples
    --------
    >>> observed_orders([0.2, 0.1, 0.05], [4.0, 1.0, 0.25])
    array([2., 2.])
    """
    h, e = np.log(np.asarray(sizes, dtype=float)), np.log(np.asarray(values, dtype=float))
    orders: Array = (e[:-1] - e[1:]) / (h[:-1] - h[1:])
    return orders


@dataclass(frozen=True)
class ConvergenceTable:
    """Errors for a sequence of step sizes or mesh sizes; displays as a table in a notebook.

    Attributes
    ----------
    parameter : str
        What is refined: "tau" or "h".
    sizes : (n,) float array
    errors : dict of str to (n,) float array
        Keys are the fields of :class:`esfem_core.errors.Errors`.
    """

    parameter: str
    sizes: Array
    errors: dict[str, Array]

    def __getitem__(self, name: str) -> Array:
        return self.errors[name]

    def orders(self, name: str) -> Array:
        """Observed orders of one error between neighbouring sizes."""
        return observed_orders(self.sizes, self.errors[name])

    def select(self, *names: str) -> "ConvergenceTable":
        """The same table with some of the errors."""
        return ConvergenceTable(self.parameter, self.sizes, {n: self.errors[n] for n in names})

    def _cells(self) -> tuple[list[str], list[list[str]]]:
        header, columns = [self.parameter], [[f"{size:.4g}" for size in self.sizes]]
        for name, values in self.errors.items():
            header += [name, "order"]
            columns += [
                [f"{value:.2e}" for value in values],
                ["", *(f"{order:.2f}" for order in self.orders(name))],
            ]
        return header, [list(row) for row in zip(*columns, strict=True)]

    def __str__(self) -> str:
        header, rows = self._cells()
        return "\n".join("  ".join(f"{cell:>9}" for cell in row) for row in [header, *rows])

    def _repr_html_(self) -> str:
        header, rows = self._cells()
        return html_table(header, rows, "esfem-convergence").text


def time_study(
    space: SurfaceSpace,
    problem: Problem,
    order: int,
    steps: Sequence[float],
    end: float,
    reference: State | None = None,
    measure: errors.Measure = errors.compare,
    **options: Any,
) -> ConvergenceTable:
    """Errors at the end for several step sizes.

    Parameters
    ----------
    space : SurfaceSpace
    problem : Problem
    order : int
        p.
    steps : sequence of float
    end : float
    reference : State, optional
        Solution to compare with on the same space (see :func:`esfem_core.errors.difference`);
        the exact solution if None.
    measure : callable, optional
        How to compare with the exact solution: :func:`esfem_core.errors.compare`, at the nodes,
        or :func:`esfem_core.errors.lifted`, on the exact surface.
    **options
        Passed to :func:`esfem_core.evolve`.

    Returns
    -------
    ConvergenceTable

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 4, ec.to_unit_sphere)
    >>> problem = ec.problems.growing_sphere()
    >>> table = time_study(space, problem, 2, [1 / 20, 1 / 40, 1 / 80], 1.0)
    >>> print(table.select("x_l2"))
          tau       x_l2      order
         0.05   1.27e-02
        0.025   3.19e-03       2.00
       0.0125   7.82e-04       2.03
    """
    rows = []
    for step in steps:
        last = final(evolve(space, problem, order, step, end, **options))
        if reference is None:
            rows.append(measure(space, problem, last))
        else:
            rows.append(errors.difference(space, last, reference))
    return _table("tau", steps, rows)


def space_study(
    spaces: Sequence[SurfaceSpace],
    problem: Problem,
    order: int,
    step: float,
    end: float,
    measure: errors.Measure = errors.compare,
    **options: Any,
) -> ConvergenceTable:
    """Errors at the end for several meshes, against the exact solution.

    Parameters
    ----------
    spaces : sequence of SurfaceSpace
    problem : Problem
        With an exact solution.
    order : int
    step, end : float
    measure : callable, optional
        As for :func:`time_study`.
    **options
        Passed to :func:`esfem_core.evolve`.

    Returns
    -------
    ConvergenceTable
        Sizes are those of the initial meshes.
    """
    rows = [
        measure(space, problem, final(evolve(space, problem, order, step, end, **options)))
        for space in spaces
    ]
    return _table("h", [space.mesh_size(space.nodes) for space in spaces], rows)


def _table(
    parameter: str, sizes: Sequence[float], rows: Sequence[errors.Errors]
) -> ConvergenceTable:
    columns = {
        name: np.array([getattr(row, name) for row in rows]) for name in errors.Errors._fields
    }
    return ConvergenceTable(parameter, np.asarray(sizes, dtype=float), columns)
