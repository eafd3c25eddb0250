"""Convergence studies: errors over a range of step or mesh sizes, and their observed orders."""

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from esfem_core.checks import (
    Array,
    finite_array,
    frozen,
    function,
    items,
    iterable,
    mapping,
    named,
    number,
    object_of,
    real_array,
    string,
    whole_number,
)
from esfem_core.elements import SurfaceSpace
from esfem_core.errors import Errors, Measure, compare, difference, lifted
from esfem_core.problems import Problem
from esfem_core.stepping import State, check_state, evolve, same_time
from esfem_core.tables import html_table, text_table

__all__ = ["ConvergenceTable", "final", "observed_orders", "space_study", "time_study"]


def final(states: Iterable[State]) -> State:
    """Run to the end and return the last state.

    Raises
    ------
    ValueError
        If there are no states.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
    >>> final(ec.evolve(space, ec.problems.shrinking_sphere(), 2, 0.1, 0.5))
    State(t=0.5, nodes=162, fields: u)
    """
    iterable("states", states, "States")
    last = deque(states, maxlen=1)
    if not last:
        raise ValueError("states must hold at least one, got none")
    return object_of("the last of states", last[0], State)


def observed_orders(sizes: ArrayLike, values: ArrayLike) -> Array:
    """Orders between neighbours, log(e_i/e_{i+1})/log(h_i/h_{i+1}).

    Parameters
    ----------
    sizes : (n,) sequence of float
        Positive, neighbours different.
    values : (n,) sequence of float
        Not negative.

    Returns
    -------
    (n-1,) float array
        NaN beside a value that is zero, NaN or infinite.

    Raises
    ------
    TypeError, ValueError
        If the shapes differ or a number is out of range.

    Examples
    --------
    >>> observed_orders([0.2, 0.1, 0.05], [4.0, 1.0, 0.25])
    array([2., 2.])
    """
    h = finite_array("sizes", sizes, ("n",))
    e = real_array("values (one for each of sizes)", values, (len(h),))
    if np.any(h <= 0) or np.any(h[1:] == h[:-1]):
        raise ValueError(f"sizes must be positive, neighbours different, got {h.tolist()}")
    if np.any(e < 0):
        raise ValueError(f"values must not be negative, got {e.tolist()}")
    return _orders(h, e)


def _orders(sizes: Array, values: Array) -> Array:
    """Orders where there are some, and NaN elsewhere."""
    h, e = (np.log(np.where((a > 0) & (a < np.inf), a, np.nan)) for a in (sizes, values))
    refined = h[:-1] - h[1:]
    return np.asarray((e[:-1] - e[1:]) / np.where(refined == 0, np.nan, refined))


@dataclass(frozen=True, eq=False)
class ConvergenceTable:
    """Errors for a sequence of step sizes or mesh sizes; displays as a table in a notebook.

    ``table["x_l2"]`` are the errors of that name, one for each size.

    Parameters
    ----------
    parameter : str
        What is refined: "tau" or "h".
    sizes : (n,) float array
    errors : mapping of str to (n,) float array
        Such as the fields of :class:`esfem_core.errors.Errors`. Sequences become arrays, all are
        copied and read-only, and so is the mapping.

    Raises
    ------
    TypeError, ValueError
        If a size is not positive, or a column does not have one number for each size.

    Examples
    --------
    A table for other programs has a row for each size:

    >>> import tempfile
    >>> from pathlib import Path
    >>> import esfem_core as ec
    >>> table = ConvergenceTable("h", [0.5, 0.25], {"x": [0.1, 0.02], "u": [0.3, 0.06]})
    >>> each = zip(table.sizes, *table.errors.values())
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     ec.save_table(f"{folder}/h.csv", (dict(zip(["h", *table.errors], row)) for row in each))
    ...     print(Path(folder, "h.csv").read_text())
    h,x,u
    0.5,0.1,0.3
    0.25,0.02,0.06
    """

    parameter: str
    sizes: Array
    errors: Mapping[str, Array]

    def __post_init__(self) -> None:
        sizes = finite_array("sizes", self.sizes, ("n",))
        if np.any(sizes <= 0):
            raise ValueError(f"sizes must be positive, got {sizes.tolist()}")
        string("parameter", self.parameter)
        errors = mapping("errors", self.errors, "one number for each size")
        columns = {
            n: real_array(f"errors[{n!r}] (one for each of sizes)", e, (len(sizes),))
            for n, e in errors.items()
        }
        self._keep(self.parameter, sizes, columns)

    def _keep(self, parameter: str, sizes: Array, errors: Mapping[str, Array]) -> None:
        """Take values as attributes; nobody can write to the arrays or add one any more."""
        columns = MappingProxyType({name: frozen(e) for name, e in errors.items()})
        vars(self).update(parameter=parameter, sizes=frozen(sizes), errors=columns)

    def __getstate__(self) -> dict[str, Any]:
        """For pickles and copies, which cannot hold read-only views of mappings."""
        return vars(self) | {"errors": dict(self.errors)}

    def __setstate__(self, kept: Mapping[str, Any]) -> None:
        self._keep(**kept)

    @classmethod
    def of(
        cls,
        parameter: str,
        sizes: ArrayLike,
        rows: Sequence[Errors | Mapping[str, float]],
    ) -> "ConvergenceTable":
        """Make a table of rows, one for each size, with the same names in each.

        Parameters
        ----------
        parameter : str
        sizes : (n,) sequence of float
        rows : sequence of n :class:`esfem_core.errors.Errors` or mappings

        Returns
        -------
        ConvergenceTable

        Raises
        ------
        TypeError, ValueError
            If a row is neither, there are no rows, their number is not that of the sizes, or their
            names differ.

        Examples
        --------
        >>> print(ConvergenceTable.of("h", [0.2, 0.1], [{"area": 4e-3}, {"area": 1e-3}]))
                h       area      order
              0.2   4.00e-03
              0.1   1.00e-03       2.00
        """
        found = [
            named(f"rows[{i}]", row)
            for i, row in enumerate(iterable("rows", rows, "Errors or mappings"))
        ]
        if not found:
            raise ValueError("rows must hold at least one row, got none")
        names = list(found[0])
        if any(list(row) != names for row in found):
            raise ValueError(f"rows must all have the names {names}, got others")
        return cls(
            parameter,
            finite_array("sizes", sizes, ("n",)),
            {name: np.array([row[name] for row in found]) for name in names},
        )

    @classmethod
    def join(cls, tables: Mapping[str, "ConvergenceTable"], name: str) -> "ConvergenceTable":
        """One error of several tables side by side.

        Parameters
        ----------
        tables : mapping of str to ConvergenceTable
            With the names of the new columns, and the same sizes.
        name : str
            The error to take from each.

        Returns
        -------
        ConvergenceTable

        Raises
        ------
        TypeError, ValueError
            If there are no tables, or they differ in sizes or parameter.
        KeyError
            If one does not have this error.

        Examples
        --------
        >>> first = ConvergenceTable("tau", [0.2, 0.1], {"u_l2": [4e-2, 2e-2]})
        >>> second = ConvergenceTable("tau", [0.2, 0.1], {"u_l2": [4e-3, 1e-3]})
        >>> print(ConvergenceTable.join({"p = 1": first, "p = 2": second}, "u_l2"))
              tau      p = 1      order      p = 2      order
              0.2   4.00e-02              4.00e-03
              0.1   2.00e-02       1.00   1.00e-03       2.00
        """
        if not mapping("tables", tables, "ConvergenceTables"):
            raise ValueError("tables must hold at least one table to join, got none")
        for key, table in tables.items():
            object_of(f"tables[{key!r}]", table, cls)
        one = next(iter(tables.values()))
        for key, table in tables.items():
            if table.parameter != one.parameter or not np.array_equal(table.sizes, one.sizes):
                raise ValueError(f"tables to join must have the same sizes, {key!r} has others")
        return cls(one.parameter, one.sizes, {key: table[name] for key, table in tables.items()})

    def __getitem__(self, name: str) -> Array:
        string("name", name)
        try:
            return self.errors[name]
        except KeyError:
            known = ", ".join(map(repr, self.errors)) or "none"
            raise KeyError(f"the table has no error {name!r}, only {known}") from None

    def orders(self, name: str) -> Array:
        """Observed orders of one error between neighbouring sizes, see :func:`observed_orders`.

        NaN where there is none: also beside a value that is negative, as a difference of two
        volumes may be, and between equal sizes.
        """
        return _orders(self.sizes, self[name])

    def select(self, *names: str) -> "ConvergenceTable":
        """The same table with some of the errors."""
        return ConvergenceTable(self.parameter, self.sizes, {n: self[n] for n in names})

    def _cells(self) -> tuple[list[str], list[list[str]]]:
        header, columns = [self.parameter], [[f"{size:.4g}" for size in self.sizes]]
        for name, values in self.errors.items():
            header += [name, "order"]
            columns += [
                [_cell(value, ".2e") for value in values],
                ["", *(_cell(order, "z.2f") for order in self.orders(name))][: len(values)],
            ]
        return header, [list(row) for row in zip(*columns, strict=True)]

    def __str__(self) -> str:
        return text_table(*self._cells(), least=9)

    def _repr_html_(self) -> str:
        header, rows = self._cells()
        return html_table(header, rows, "esfem-convergence").text


def _cell(value: float, spec: str) -> str:
    return "–" if np.isnan(value) else format(value, spec)


def time_study(
    space: SurfaceSpace,
    problem: Problem,
    order: int,
    steps: Sequence[float] | Array,
    end: float,
    reference: State | None = None,
    measure: Measure = compare,
    *,
    fine: Sequence[State] | None = None,
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
        At least one.
    end : float
    reference : State, optional
        Solution to compare with on the same space (see :func:`esfem_core.errors.difference`);
        the exact solution if None.
    measure : callable, optional
        How to compare with the exact solution: :func:`esfem_core.errors.compare`, at the nodes,
        or :func:`esfem_core.errors.lifted`, on the exact surface. Not with `reference` or `fine`.
    fine : sequence of State, optional
        A run with a constant step, of which all `steps` are multiples, that ends at `end`. Its
        last state is the reference, and each run starts with states of it, the first at
        ``fine[0].t``. What separates the runs at the end is then the temporal error alone, of
        order p; other starts would add errors of their own.
    **options
        Passed to :func:`esfem_core.evolve`. `statistics` are in the end those of the last run.

    Returns
    -------
    ConvergenceTable

    Raises
    ------
    TypeError, ValueError
        If an argument is out of range or there is nothing to compare with, before a run begins.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 4, ec.to_unit_sphere)
    >>> problem = ec.problems.growing_sphere()
    >>> table = time_study(space, problem, 2, [1 / 20, 1 / 40, 1 / 80], 1.0)
    >>> print(table.select("x_l2"))
          tau       x_l2      order
         0.05   7.31e-03
        0.025   1.78e-03       2.03
       0.0125   4.26e-04       2.07

    The temporal error of BDF3 alone, of a problem without an exact solution:

    >>> space, problem = ec.SurfaceSpace(ec.sphere("octahedron", 2)), ec.problems.baseball_bat()
    >>> fine = list(ec.evolve(space, problem, 5, 1 / 320, 1.0))
    >>> print(time_study(space, problem, 3, [1 / 40, 1 / 80], 1.0, fine=fine).select("u_l2"))
          tau       u_l2      order
        0.025   9.40e-06
       0.0125   1.08e-06       3.12
    """
    order, taus, end = whole_number("order", order, 1), _sizes("steps", steps), number("end", end)
    if reference is not None:
        object_of("reference", reference, State, "or None")
        check_state(space, reference, "reference")
    starts: list[dict[str, Any]] = [{} for _ in taus]
    if fine is not None:
        if reference is not None or "start" in options:
            raise ValueError("fine gives the reference and the starting values: leave those out")
        fine = items("fine", fine, State, 2)
        reference = fine[-1]
        starts = [{"start": _every(fine, tau)[:order]} for tau in taus]
    if reference is not None and not same_time(reference.t, end):
        name = "reference" if fine is None else "fine"
        raise ValueError(f"{name} must end at t = {end:g}, but ends at t = {reference.t:g}")
    _check_comparable(problem, reference, measure)
    runs = [  # made before the first one begins, so that all arguments are checked
        evolve(space, problem, order, tau, end, **start, **options)
        for tau, start in zip(taus, starts, strict=True)
    ]
    return ConvergenceTable.of(
        "tau",
        taus,
        [
            named("what measure returns", measure(space, problem, last))
            if reference is None
            else difference(space, last, reference)._asdict()
            for last in map(final, runs)
        ],
    )


def _every(fine: Sequence[State], tau: float) -> Sequence[State]:
    """States of a run, tau apart."""
    step = number("the step of fine", fine[1].t - fine[0].t, above=0)
    for i, state in enumerate(fine):
        if abs(state.t - fine[0].t - i * step) > 1e-6 * step:
            raise ValueError(
                f"fine must have a constant step, but t = {state.t:g} is no multiple of {step:g} "
                f"after t = {fine[0].t:g}: give every state of the run"
            )
    k = round(tau / step)
    if k < 1 or abs(tau - k * step) > 1e-9 * tau:
        raise ValueError(f"steps must be multiples of the step {step:g} of fine, got {tau:g}")
    return fine[::k]


def space_study(
    spaces: Sequence[SurfaceSpace],
    problem: Problem,
    order: int,
    step: float,
    end: float,
    measure: Measure = compare,
    **options: Any,
) -> ConvergenceTable:
    """Errors at the end for several meshes, against the exact solution.

    Parameters
    ----------
    spaces : sequence of SurfaceSpace
        At least one.
    problem : Problem
        With an exact solution.
    order : int
    step, end : float
    measure : callable, optional
        As for :func:`time_study`.
    **options
        Passed to :func:`esfem_core.evolve`. `statistics` are in the end those of the last run.

    Returns
    -------
    ConvergenceTable
        Sizes are those of the initial meshes.

    Raises
    ------
    TypeError, ValueError
        As for :func:`time_study`.

    Examples
    --------
    With a prescribed motion the nodes are exact, and an error of zero has no order:

    >>> import esfem_core as ec
    >>> spaces = [ec.SurfaceSpace(ec.sphere("octahedron", n), 1, ec.to_unit_sphere) for n in (2, 3)]
    >>> problem = ec.problems.oscillating_ellipsoid("oscillation")
    >>> print(space_study(spaces, problem, 2, 1 / 20, 1.0).select("x_l2", "u_l2"))
            h       x_l2      order       u_l2      order
       0.5774   0.00e+00              2.32e-02
       0.3015   0.00e+00          –   8.16e-03       1.61
    """
    spaces = items("spaces", spaces, SurfaceSpace)
    sizes = _sizes("mesh sizes of spaces", [space.mesh_size(space.nodes) for space in spaces])
    _check_comparable(problem, None, measure)
    runs = [evolve(space, problem, order, step, end, **options) for space in spaces]
    return ConvergenceTable.of(
        "h",
        sizes,
        [
            named("what measure returns", measure(space, problem, final(run)))
            for space, run in zip(spaces, runs, strict=True)
        ],
    )


def _sizes(name: str, values: ArrayLike) -> list[float]:
    sizes: list[float] = finite_array(name, values, ("n",)).tolist()
    if not sizes:
        raise ValueError(f"{name} must hold at least one number, got none")
    if min(sizes) <= 0 or any(a == b for a, b in pairwise(sizes)):
        raise ValueError(f"{name} must be positive, neighbours different, got {sizes}")
    return sizes


def _check_comparable(problem: Problem, reference: State | None, measure: Measure) -> None:
    function("measure", measure, "measure(space, problem, state)")
    object_of("problem", problem, Problem)
    exact = problem.exact
    if reference is not None and measure is not compare:
        raise ValueError(
            "measure compares with the exact solution: leave it out with reference or fine"
        )
    if reference is not None or measure not in (compare, lifted):
        return
    if exact is None:
        raise ValueError("problem must have an exact solution to compare with, but has none")
    if measure is lifted and (exact.closest is None or exact.origin is None):
        raise ValueError(
            "measure=lifted needs an exact solution with closest points and origins: problem must "
            "have Exact(x, v, u, closest, origin)"
        )
