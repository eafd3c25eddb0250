"""What a run yields, and how it stops."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from esfem_core.checks import (
    Array,
    check_string,
    finite_array,
    frozen,
    mapping,
    number,
    object_of,
    one_of,
    real_array,
    shown,
    whole_number,
)
from esfem_core.elements import Surface, SurfaceSpace
from esfem_core.surfaces import check_coordinates

__all__ = ["EvolutionError", "Mass", "State", "check_state", "known_space", "same_space"]


Mass = Literal["updated", "extrapolated", "reassembled"]
"""Where mass matrices are taken, see `mass` of :func:`esfem_core.evolve`."""

Method = tuple[str, int, float]


@dataclass(frozen=True, init=False, eq=False)
class State:
    """The discrete solution at one time; its arrays are read-only.

    Parameters
    ----------
    t : float
    x : (N, 3) float array
        Node positions.
    v : (N, 3) float array, optional
        Nodal velocities, from (2.21).
    u : (N,) or (N, m) float array, optional
        Nodal values of the species "u"; short for an entry of `fields`.
    space : SurfaceSpace, optional
    fields : mapping of str to (N, ...) float array, optional
        Nodal values of all species, and of the fields of the law.
    products : mapping of str to (N, ...) float array, optional
        M w for the conserved fields w, with the mass matrices that the scheme takes (see `mass` of
        :func:`esfem_core.evolve`): what a run needs to go on exactly.
    method : (str, int, float), optional
        The scheme that `products` belong to: mass, order and step. Another one makes its own.

    Attributes
    ----------
    t, x, v, space, fields, products, method
        v is None in starting states, which no step has computed. ``state["name"]`` is any of
        `fields`, and ``state.u`` that of the species "u".

    Raises
    ------
    TypeError, ValueError
        If an array has the wrong shape or is not real, or u is given twice.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 2))
    >>> *_, last = ec.evolve(space, ec.problems.growing_sphere(), order=1, step=0.1, end=0.2)
    >>> last
    State(t=0.2, nodes=66, fields: u)
    >>> print(f"{last.surface().integral(1.0) > 4 * np.pi}")
    True
    """

    t: float
    x: Array
    v: Array | None
    space: SurfaceSpace | None = None
    fields: Mapping[str, Array] = field(default_factory=dict)
    # Not handed on by dataclasses.replace: they belong to these values of x and the functions.
    products: Mapping[str, Array] = field(init=False)
    method: Method | None = field(init=False)

    def __init__(
        self,
        t: float,
        x: Array,
        v: Array | None = None,
        u: Array | None = None,
        *,
        space: SurfaceSpace | None = None,
        fields: Mapping[str, Array] | None = None,
        products: Mapping[str, Array] | None = None,
        method: Method | None = None,
    ) -> None:
        given = {} if fields is None else dict(mapping("fields", fields, "nodal values"))
        kept = {} if products is None else mapping("products", products, "nodal vectors")
        if u is not None:
            if "u" in given:
                raise ValueError(
                    "u must be given once, but is given as u and in fields; "
                    "state.with_functions({'u': u}) changes it"
                )
            given["u"] = u
        x = real_array("x", x, ("N", 3))
        n = len(x)
        if space is not None:
            n = len(object_of("space", space, SurfaceSpace, "or None").nodes)
            x = real_array("x", x, (n, 3))
        self._keep(
            number("t", t),
            x,
            None if v is None else real_array("v", v, (n, 3)),
            space,
            {name: real_array(name, w, (n, "...")) for name, w in given.items()},
            {name: real_array(f"products[{name!r}]", w, (n, "...")) for name, w in kept.items()},
            None if method is None else _checked_method(method),
        )
        _check_components(self.fields)

    @classmethod
    def of_checked(
        cls,
        t: float,
        x: Array,
        v: Array,
        *,
        space: SurfaceSpace,
        fields: Mapping[str, Array],
        products: Mapping[str, Array],
        method: Method,
    ) -> "State":
        """A state of real arrays that fit, such as a step has made; nothing is looked at again."""
        state = object.__new__(cls)
        state._keep(t, x, v, space, fields, products, method)
        return state

    def _keep(
        self,
        t: float,
        x: Array,
        v: Array | None,
        space: SurfaceSpace | None,
        fields: Mapping[str, Array],
        products: Mapping[str, Array],
        method: Method | None,
    ) -> None:
        """Take values as attributes; nobody can write to the arrays any more."""
        kept = {
            "t": t,
            "x": frozen(x),
            "v": None if v is None else frozen(v),
            "space": space,
            "fields": MappingProxyType({name: frozen(w) for name, w in fields.items()}),
            "products": MappingProxyType({name: frozen(w) for name, w in products.items()}),
            "method": method,
        }
        for name, value in kept.items():
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        names = ", ".join(self.fields) or "none"
        return f"State(t={self.t:g}, nodes={len(self.x)}, fields: {names})"

    def __getstate__(self) -> dict[str, object]:
        """For pickles and copies, which cannot hold read-only views of mappings."""
        return vars(self) | {"fields": dict(self.fields), "products": dict(self.products)}

    def __setstate__(self, kept: Mapping[str, Any]) -> None:
        self._keep(**kept)

    @property
    def u(self) -> Array:
        """Nodal values of the species "u"."""
        return self["u"]

    def __getitem__(self, name: str) -> Array:
        """Nodal values of a species or of a field of the law."""
        check_string("name", name)
        try:
            return self.fields[name]
        except KeyError:
            known = ", ".join(map(repr, self.fields)) or "none"
            raise KeyError(f"the state has no function {name!r}, only {known}") from None

    def with_functions(self, functions: Mapping[str, Array]) -> "State":
        """Return the state with further functions, or with other values of those that it has.

        All else stays, also what a run needs to go on exactly, `products` and `method`, which
        dataclasses.replace drops; but products of functions that have other values.

        Parameters
        ----------
        functions : mapping of str to (N, ...) float array
            Nodal values.

        Returns
        -------
        State

        Raises
        ------
        TypeError, ValueError
            If an array has the wrong shape or is not real.

        Examples
        --------
        >>> import esfem_core as ec
        >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 2))
        >>> *_, last = ec.evolve(space, ec.problems.growing_sphere(), order=1, step=0.1, end=0.2)
        >>> last.with_functions({"w": last.x[:, 2]})
        State(t=0.2, nodes=66, fields: u, w)
        """
        others = mapping("functions", functions, "nodal values")
        return State(
            self.t,
            self.x,
            self.v,
            space=self.space,
            fields={**self.fields, **others},
            products={name: b for name, b in self.products.items() if name not in others},
            method=self.method,
        )

    def surface(self) -> Surface:
        """Return the surface with all functions on it, for integrals and pictures."""
        return Surface(known_space(self), self.x, self.fields, self.t)


def _check_components(fields: Mapping[str, Array]) -> None:
    """Refuse functions without components: what is written of them cannot be read again."""
    for name, values in fields.items():
        if 0 in values.shape[1:]:
            raise ValueError(f"{name} must have at least one component, got shape {values.shape}")


def _checked_method(method: object) -> Method:
    """Mass, order and step."""
    if not isinstance(method, tuple) or len(method) != 3:
        raise TypeError(f"method must be a triple (mass, order, step), got {shown(method)}")
    mass, order, step = method
    return (
        one_of("the mass of method", mass, Mass),
        whole_number("the order of method", order, 1),
        number("the step of method", step, above=0),
    )


def check_state(space: SurfaceSpace, state: State, name: str = "state") -> None:
    """Refuse what is no state of this space.

    Parameters
    ----------
    space : SurfaceSpace
    state : State
    name : str
        What the message calls it.

    Raises
    ------
    TypeError
        If it is no state.
    ValueError
        If it is a state of another space, an array has not one row for each node of the space, a
        function more than one index beside that, a product belongs to no function, something is
        not finite, or a node beyond 1e75, where areas are no numbers.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 0))
    >>> check_state(space, State(0.0, space.nodes[:5], None, space.nodes[:5, 0]))
    Traceback (most recent call last):
        ...
    ValueError: state.x must have shape (6, 3), got (5, 3)
    """
    object_of("space", space, SurfaceSpace)
    object_of(name, state, State)
    if not (state.space is None or same_space(state.space, space)):
        raise ValueError(
            f"{name} must be a state of this space, {space!r}, but it is one of {state.space!r} "
            "with other nodes, elements or quadrature"
        )
    n = len(space.nodes)
    x = finite_array(f"{name}.x", state.x, (n, 3))
    check_coordinates(f"{name}.x", x, space.cells)
    if state.v is not None:
        finite_array(f"{name}.v", state.v, (n, 3))
    for key, values in state.fields.items():
        called = f"{name}.u" if key == "u" else f"{name}[{key!r}]"
        w = finite_array(called, values, ("N", "..."))
        if w.ndim > 2 or len(w) != n:
            raise ValueError(f"{called} must have shape ({n},) or ({n}, m), got {w.shape}")
    for key, product in state.products.items():
        called = f"{name}.products[{key!r}]"
        if key not in state.fields or product.shape != state.fields[key].shape:
            raise ValueError(f"{called} belongs to no function")
        finite_array(called, product, ("N", "..."))


def known_space(state: State, name: str = "state") -> SurfaceSpace:
    """The space of a state; refuses what is none, and one that has none."""
    space = object_of(name, state, State).space
    if space is None:
        raise ValueError(f"{name} must know its space, but has none: State(..., space=space)")
    return space


def same_space(one: SurfaceSpace, other: SurfaceSpace) -> bool:
    """Whether two spaces have the same elements, nodes and quadrature."""
    return one is other or (
        one.rule.exactness == other.rule.exactness
        and np.array_equal(one.cells, other.cells)
        and np.array_equal(one.nodes, other.nodes)
    )


class EvolutionError(RuntimeError):
    """A run cannot go on; the states it has yielded are good.

    Attributes
    ----------
    step : int
        Number n of the step that failed.
    t : float
        Its time.
    element : int or None
        Row of ``space.cells`` where the trouble was first seen, if it has a place.
    """

    def __init__(self, reason: str, step: int, t: float, element: int | None = None) -> None:
        super().__init__(reason, step, t, element)
        self.reason, self.step, self.t, self.element = reason, step, t, element

    def __str__(self) -> str:
        return f"step {self.step}, t = {self.t:.6g}: {self.reason}"
