"""One step after the other: the linearly implicit BDF method of [N] (2.19)-(2.21).

In each step the last p values are extrapolated to a surface x~ with functions on it, on which all
is assembled. Then come, in this order, the fields of the law, its velocity, the positions, and the
species of the problem, whose mass matrices may therefore be those of the new surface.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from esfem_core.checks import Array, real_array, shown
from esfem_core.elements import ElementError, Surface, SurfaceSpace
from esfem_core.laws import Part, Species, finite_nodal, positions_of, same_species
from esfem_core.problems import Problem
from esfem_core.stepping.agreement import innermost
from esfem_core.stepping.bdf import combine, delta, extrapolate
from esfem_core.stepping.elimination import Condition, Elimination, conditions
from esfem_core.stepping.guard import Guard
from esfem_core.stepping.solving import GUESS, Systems, stacked
from esfem_core.stepping.state import EvolutionError, Mass, Method, State

__all__ = ["Perturbation", "Scheme"]

Perturbation = Callable[[int], Mapping[str, Array] | tuple[Array, Array, Array]]
"""What is added to right-hand sides, by the number of a step; see :func:`esfem_core.evolve`."""

Functions = dict[str, Array]


class History:
    """The last p levels of positions, functions and products M w, newest first.

    Parameters
    ----------
    space : SurfaceSpace
    problem : Problem
    method : (str, int, float)
        Mass, order p and step.
    states : sequence of p states
        Oldest first. Where they have no products of this method, there is no extrapolation either:
        M(x^j) is taken.
    """

    def __init__(
        self, space: SurfaceSpace, problem: Problem, method: Method, states: Sequence[State]
    ) -> None:
        _, order, _ = self.method = method
        self.d = delta(order)
        self.normal: Array | None = None  # of the last extrapolated surface
        newest_first = list(reversed(states))
        self.t = newest_first[0].t
        self.x = deque((s.x for s in newest_first), maxlen=order)
        self.functions: dict[str, deque[Array]] = {}
        self.products: dict[str, deque[Array]] = {}
        # First guesses for the linear solver are extrapolated from more values than the scheme has.
        self.longer: dict[str, deque[Array]] = {}
        for name, species in problem.all_species.items():
            values = [s[name] for s in newest_first]
            self.functions[name] = deque(values, maxlen=order)
            self.longer[name] = deque(values, maxlen=max(order, GUESS))
            if species.conserved:
                products = (
                    s.products[name]
                    if s.method == method and name in s.products
                    else space.mass_times(s.x, s[name])
                    for s in newest_first
                )
                self.products[name] = deque(products, maxlen=order)

    def push(self, state: State) -> None:
        """Add a level; the oldest one goes."""
        self.t = state.t
        self.x.appendleft(state.x)
        for name, w in state.fields.items():
            self.functions[name].appendleft(w)
            self.longer[name].appendleft(w)
        for name, product in state.products.items():
            self.products[name].appendleft(product)


@dataclass
class Scheme:
    """The method on one space for one problem; its solvers are kept from step to step.

    Attributes
    ----------
    space : SurfaceSpace
    problem : Problem
    mass : {"updated", "extrapolated", "reassembled"}
        See :func:`esfem_core.evolve`.
    systems : Systems
    perturbation : callable, optional
    """

    space: SurfaceSpace
    problem: Problem
    mass: Mass
    systems: Systems
    perturbation: Perturbation | None = None
    _used: frozenset[tuple[str, str]] = frozenset()
    _conditions: dict[str, Condition] = field(init=False)

    def __post_init__(self) -> None:
        self._conditions = conditions(self.space, self.problem.all_species)

    def fixed(self, name: str, x: Array, t: float, values: Array) -> Array:
        """Nodal values of a species, with those in place that are given at positions x and time t.

        Raises
        ------
        ValueError, TypeError, FloatingPointError
            If given values have another shape, or are not real or not finite.
        """
        elimination = self._elimination(name)
        if elimination is None:
            return values
        values, nodes = values.copy(), elimination.nodes
        values[nodes] = self._given(name, x, t, values)[nodes]
        return values

    def history(self, order: int, step: float, states: Sequence[State]) -> History:
        """What the first step from p states needs of them."""
        return History(self.space, self.problem, (self.mass, order, step), states)

    def steps(
        self, history: History, times: Iterable[tuple[int, float]], guard: Guard
    ) -> Iterator[State]:
        """Step on from a history through the given (number, time) pairs."""
        for n, t in times:
            with naming_the_step(n, t):
                state = self._step(history, n, t)
                guard.look_at_surface(state.x)
                guard.warn_of_folds(state.x, self.space)
                guard.look_at_functions(state.x, state.fields)
            history.push(state)
            yield state

    def _step(self, history: History, n: int, t: float) -> State:
        """One step, [N] (2.19)-(2.21)."""
        d, (_, _, step) = history.d, history.method
        fields = {name: extrapolate(values) for name, values in history.functions.items()}
        law, extra = self.problem.law, self._extra(n, {k: w.shape for k, w in fields.items()})
        x_past = combine(d[1:], history.x)
        given = None
        if hasattr(law, "position"):
            given = positions_of(law, self.space.nodes, t, (history.t, history.x[0]))
        x_tilde = extrapolate(history.x) if given is None else given
        for made in (*fields.values(), *([x_tilde] if given is None else [])):
            made.setflags(write=False)  # nobody else has it, so that it need not be copied
        at = Surface(self.space, x_tilde, fields, t, expected=self._used)
        if given is None:
            history.normal = _not_turned(at, history.normal)
        w = law.slip(at) if hasattr(law, "slip") else None

        if given is None and "x" in extra:
            x_past = x_past - step * extra["x"]
        if w is not None:
            x_past = x_past - step * finite_nodal("the slip w(at)", w, x_past.shape)
        tau, past = step / d[0], x_past / d[0]

        own = self.problem.law_species
        if hasattr(law, "equations"):
            own = same_species(own, law.equations(tau, past))
        levels = _Levels(history, step, at, w, extra)
        functions, products = self._diffuse(own, levels, at.M, at.x)
        for array in functions.values():
            array.setflags(write=False)  # the law sees them
        r_v = [extra["v"]] if "v" in extra else []
        v = law.velocity(at, dict(functions), tau, past, self._law_solver(r_v))
        v = finite_nodal("the velocity of the law", v, at.x.shape)
        if given is None and any(rest.any() for rest in r_v):
            raise ValueError(_no_system_for_v(self.problem))
        x = (step * v - x_past) / d[0] if given is None else given

        M = self.space.mass(x) if self.mass == "updated" and given is None else at.M
        more = self._diffuse(self.problem.species, levels, M, x)
        functions |= more[0]
        products |= more[1]
        self._used = self._used | at.used
        for array in (x, *functions.values(), *products.values()):
            array.setflags(write=False)  # the law may keep v: a copy goes to the state
        return State.of_checked(
            t, x, v, space=self.space, fields=functions, products=products, method=history.method
        )

    def _diffuse(
        self, species: Mapping[str, Species], levels: "_Levels", M: csr_array, x: Array
    ) -> tuple[Functions, Functions]:
        """New values and products of some species, solved together where they share a matrix.

        M is the mass matrix of the newest level of conserved species, x the new positions.
        """
        at, weight = levels.at, levels.history.d[0] / levels.step
        loads: Functions = {}
        groups: dict[object, list[tuple[str, Part]]] = {}
        for name, one in species.items():
            loads[name] = levels.load(name, one)
            for i, part in enumerate(one.parts(name, at)):
                key = (one.conserved, part.key, self._elimination(name)) if part.key else (name, i)
                groups.setdefault(key, []).append((name, part))
        new = {name: np.empty_like(b) for name, b in loads.items()}
        for members in groups.values():
            first = species[members[0][0]]
            K = members[0][1].operator(weight, M if first.conserved else at.M, at)
            picked = [(name, (slice(None), *_index(part, loads[name]))) for name, part in members]
            b, apart = stacked([loads[name][index] for name, index in picked])
            guess, _ = stacked([levels.guess(name)[index] for name, index in picked])
            kind = " and ".join(_called(name, part) for name, part in members)
            solve = partial(self.systems.solve, kind)
            elimination = self._elimination(members[0][0])
            if elimination is not None:
                given, _ = stacked([self._given(name, x, at.t, new[name])[i] for name, i in picked])
                solve = partial(elimination.solve, solve, given=given)
            for (name, index), w in zip(picked, apart(solve(K, b, guess)), strict=True):
                new[name][index] = w
        products = {
            name: self.space.mass_times(x, new[name])
            if self.mass == "reassembled" and name in self.problem.species
            else M @ new[name]
            for name, one in species.items()
            if one.conserved
        }
        return new, products

    def _elimination(self, name: str) -> Elimination | None:
        """What takes the given values of a species out of its systems, if it has some."""
        condition = self._conditions.get(name)
        return None if condition is None else condition.elimination

    def _given(self, name: str, x: Array, t: float, like: Array) -> Array:
        return self._conditions[name].values(name, x, t, like.shape)

    def _law_solver(self, r_v: list[Array]) -> Callable[[csr_array, Array], Array]:
        """What a law gets to solve with; its first right-hand side takes up r_v."""
        count = 0

        def solve(K: csr_array, b: Array) -> Array:
            nonlocal count
            count += 1
            if r_v:
                extra = r_v.pop()
                _check_takes_up(b, extra)
                b = b.copy()
                b[:, : extra.shape[1]] += extra  # beside it may stand other right-hand sides
            return self.systems.solve_again(f"law {count}", K, b)

        return solve

    def _extra(self, n: int, shapes: Mapping[str, tuple[int, ...]]) -> Mapping[str, Array]:
        """Perturbations of step n by name, of these shapes."""
        if self.perturbation is None:
            return {}
        given: object = self.perturbation(n)
        if isinstance(given, tuple | list) and len(given) == 3:
            given = dict(zip("uvx", given, strict=True))
        if not isinstance(given, Mapping):
            raise TypeError(
                "perturbation must return three vectors (r_u, r_v, r_x) or a mapping from names "
                f"to vectors, but perturbation({n}) returned {shown(given)}"
            )
        known = {"v": self.space.nodes.shape, "x": self.space.nodes.shape, **shapes}
        for name in given:
            if name not in known:
                raise ValueError(
                    f"perturbation must be of {', '.join(map(repr, known))}, but perturbation({n}) "
                    f"returned one of {name!r}"
                )
        found = {}
        for name, vector in given.items():
            called, shape = f"perturbation({n})[{name!r}]", known[name]
            values = real_array(called, vector, ("...",))
            if values.ndim == 0:  # a constant
                values = np.full(shape, values)
            found[name] = finite_nodal(called, values, shape)
        return found


@dataclass
class _Levels:
    """What the equations of all species of a step are made of."""

    history: History
    step: float
    at: Surface
    slip: Array | None
    extra: Mapping[str, Array]

    def load(self, name: str, species: Species) -> Array:
        """Right-hand side of [N] (2.19): past values, sources, perturbation."""
        d, history = self.history.d, self.history
        if species.conserved:
            b = -combine(d[1:], history.products[name]) / self.step
        else:
            past: Array = -combine(d[1:], history.functions[name]) / self.step
            b = self.at.M @ past
        source = species.load(name, self.at)
        if source is not None:
            b += source
        if self.slip is not None:
            b += self._carried(name, species, self.slip)
        if name in self.extra:
            b += self.extra[name]
        return b

    def _carried(self, name: str, species: Species, slip: Array) -> Array:
        """What nodes that slip with w meet on their way: div(u w) phi, or (w . grad u) phi."""
        w = self.at.space.evaluate(slip)
        u = self.at[name]
        w = w.reshape(*w.shape[:2], *(1,) * (u.ndim - 2), 3)
        if species.conserved:
            return self.at.load(None, flux=-u[..., None] * w)
        return self.at.load((self.at.grad(name) * w).sum(axis=-1))

    def guess(self, name: str) -> Array:
        """What the new values will be, about."""
        return extrapolate(self.history.longer[name])


def _index(part: Part, b: Array) -> tuple[Any, ...]:
    return () if b.ndim == 1 else (part.components,)


def _called(name: str, part: Part) -> str:
    """A name for the components of a part."""
    if isinstance(part.components, slice):
        return name
    return f"{name}[{', '.join(map(str, np.flatnonzero(part.components)))}]"


def _no_system_for_v(problem: Problem) -> str:
    """What to say of an r_v that no system of the law has taken up."""
    law = innermost(problem.law)
    names = " or ".join(map(repr, problem.law_species or ["x"]))
    return (
        "perturbation must be of what is solved for: one of 'v' is added to the system that a law "
        f"solves for the velocity, but {type(law).__name__} solves none; perturb {names}"
    )


def _check_takes_up(b: Array, r_v: Array) -> None:
    """Refuse the right-hand side of a law that does not begin with the components of v.

    Examples
    --------
    >>> _check_takes_up(np.zeros(5), np.zeros((5, 3)))
    Traceback (most recent call last):
        ...
    ValueError: perturbation of 'v' is added to the first right-hand side that a law solves for,...
    """
    if b.ndim < 2 or b.shape[1] < r_v.shape[1]:
        raise ValueError(
            "perturbation of 'v' is added to the first right-hand side that a law solves for, "
            f"whose first columns are the components of v; the law gave one of shape {b.shape}: "
            f"solve(K, b) with b of shape {r_v.shape}, all components at once"
        )


def _not_turned(at: Surface, previous: Array | None) -> Array:
    """Return the normals, unless some element has turned over since the previous step.

    They are kept for a step, in single precision: on large meshes that is memory at its peak.
    """
    if previous is not None:
        turned = np.einsum("tqi,tqi->tq", at.normal, previous) <= 0
        if turned.any():
            element = int(np.argmax(turned.any(axis=1)))
            raise ElementError(
                f"element {element} has turned over: its normal changed by more than a right "
                "angle within a step; a smaller step, or a smaller rate of a slip, "
                "laws.Elastic(rate=...), may help",
                element,
            )
    return at.normal.astype(np.float32)


@contextmanager
def naming_the_step(n: int, t: float) -> Iterator[None]:
    """Say in which step and at which time numbers or elements went bad."""
    try:
        yield
    except ElementError as error:
        raise EvolutionError(str(error), n, t, error.element) from error
    except (FloatingPointError, np.linalg.LinAlgError) as error:
        raise EvolutionError(str(error), n, t) from error
