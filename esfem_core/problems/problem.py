"""The central question of the package: which species diffuse, and by which law they move."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from esfem_core.checks import (
    Array,
    check_arguments,
    check_nodes,
    finite_array,
    function,
    mapping,
    number,
    shown,
)
from esfem_core.laws import (
    Law,
    Prescribed,
    Regularised,
    Species,
    check_initial,
    check_law,
    check_of_surface,
)

__all__ = ["Exact", "Problem", "at_points"]

RESERVED = ("x", "v")  # names of positions and velocities
OF_INITIAL = "p has points (n, 3) of the initial surface, t is the time"
OF_PRESENT = "x has points (n, 3) of the surface at time t"
NORMAL = "normal"  # the name under which a law may carry the normal


class _Functions(NamedTuple):
    x: Callable[[Array, float], Array]
    v: Callable[[Array, float], Array]
    u: Callable[[Array, float], Array] | None = None
    closest: Callable[[Array, float], Array] | None = None
    origin: Callable[[Array, float], Array] | None = None
    fields: Mapping[str, Callable[[Array, float], Array]] = MappingProxyType({})


class Exact(_Functions):
    """An exact solution.

    Parameters
    ----------
    x : callable
        X(p, t): positions at time t, (n, 3), of points p, (n, 3), of the initial surface.
    v : callable
        v(p, t) = d/dt X(p, t): velocities, (n, 3), of the same points p of the initial surface.
    u : callable, optional
        u(x, t): values (n,) or (n, m) of the species "u" at points x, (n, 3), of the surface at
        time t.
    closest : callable, optional
        p(x, t): closest points, (n, 3), on the surface at time t, of points x, (n, 3), near it
        ([N] (2.2)). This and `origin` are needed for lifted errors only.
    origin : callable, optional
        The inverse of X: points p of the initial surface, (n, 3), with X(p, t) = x, for points x,
        (n, 3), of the surface at time t.
    fields : mapping of str to callable
        As `u`, for other species and for the fields of the law.

    Raises
    ------
    TypeError, ValueError
        If one is no function where one is needed, or one of other arguments, or u is given twice.
    """

    __slots__ = ()

    def __new__(  # noqa: D102 - documented by the class
        cls,
        x: Callable[[Array, float], Array],
        v: Callable[[Array, float], Array],
        u: Callable[[Array, float], Array] | None = None,
        closest: Callable[[Array, float], Array] | None = None,
        origin: Callable[[Array, float], Array] | None = None,
        fields: Mapping[str, Callable[[Array, float], Array]] = MappingProxyType({}),
    ) -> "Exact":
        function("x", x, "X(p, t) of points (n, 3) and a time")
        function("v", v, "v(p, t) of points (n, 3) and a time")
        check_arguments("x", x, "p, t", OF_INITIAL)
        check_arguments("v", v, "p, t", OF_INITIAL)
        for name, value in (("u", u), ("closest", closest), ("origin", origin)):
            if value is not None:
                function(name, value, f"{name}(x, t) of points (n, 3) and a time, or None")
                check_arguments(name, value, "x, t", OF_PRESENT)
        for name, value in mapping("fields", fields, "functions of (x, t)").items():
            function(f"fields[{name!r}]", value, "of points (n, 3) and a time")
            check_arguments(f"fields[{name!r}]", value, "x, t", OF_PRESENT)
        if u is not None and "u" in fields:
            raise ValueError("u must be given once, but is given as u and in fields")
        return super().__new__(cls, x, v, u, closest, origin, fields)

    def __getnewargs__(self) -> tuple[Any, ...]:  # for copies; a read-only view cannot be copied
        return (*self[:-1], dict(self.fields))

    @property
    def functions(self) -> dict[str, Callable[[Array, float], Array]]:
        """All of u and `fields` that are given, by name."""
        return dict(self.fields) if self.u is None else {"u": self.u, **self.fields}

    def nodal(self, nodes: Array, t: float) -> tuple[Array, Array, dict[str, Array]]:
        """Positions, velocities and all functions at the nodes.

        Parameters
        ----------
        nodes : (N, 3) float array
            On the initial surface.
        t : float

        Returns
        -------
        x, v : (N, 3) float arrays
        fields : dict of str to (N, ...) float array

        Raises
        ------
        ValueError, TypeError
            If the nodes are no such array or t no number, or a function does not return finite
            real numbers of the right shape.
        """
        check_nodes("nodes", nodes)
        _check_time(t)
        x = np.array(finite_array("exact.x", self.x(nodes.copy(), t), nodes.shape))
        v = np.array(finite_array("exact.v", self.v(nodes.copy(), t), nodes.shape))
        values = {
            name: _components(f"exact.{name}", given(x.copy(), t), len(x))
            for name, given in self.functions.items()
        }
        return x, v, values


def _check_time(t: float) -> None:
    number("t", t)


def at_points(
    given: Callable[[Array, float], Array],
) -> Callable[[Array, float], Array]:
    """A function of an exact solution that refuses what are no points or no time.

    Examples
    --------
    >>> at_points(lambda p, t: t * p)(np.eye(3), float("nan"))
    Traceback (most recent call last):
        ...
    ValueError: t must be a finite number, got nan
    """

    def checked(points: Array, t: float) -> Array:
        return given(finite_array("points", points, ("...", 3)), number("t", t))

    return checked


def _components(name: str, values: ArrayLike, n: int) -> Array:
    """Nodal values (n,) or (n, m), as an array of their own."""
    found = np.array(finite_array(name, values, (n, "...")))
    if found.ndim > 2 or found.size == 0:
        raise ValueError(f"{name} must have shape ({n},) or ({n}, m), got {found.shape}")
    return found


@dataclass(frozen=True, init=False, eq=False)
class Problem:
    r"""Species that diffuse on a surface, and the law by which it moves.

    ``Problem(u0, f, g, alpha, beta, diffusivity)`` is the coupled problem of [N], (2.7) and (2.8),
    with :math:`\partial^\bullet` the material derivative, H the sum of the principal curvatures
    (positive on a sphere) and nu the outward unit normal,

    .. math::

        \partial^\bullet u + u\, \nabla_\Gamma \cdot v - D \Delta_\Gamma u
            &= f(u, \nabla_\Gamma u), \\
        v - \alpha \Delta_\Gamma v + \beta H \nu &= g(u, \nabla_\Gamma u)\, \nu,

    and ``Problem(u0, f, motion=X)`` the one of [LMV], on a surface with a prescribed motion. They
    are short for ``Problem(species={"u": Species(...)}, law=...)``, which states any other.

    Parameters
    ----------
    u0 : callable, array or float, optional
        Initial values of "u": u0(x) at points (N, 3), returning (N,) or (N, m); or the nodal
        values; or a constant. Without them nothing diffuses.
    f, g : callable, optional
        ``f(at)`` and ``g(at)`` on a :class:`esfem_core.Surface`, at whose quadrature points
        ``at.u`` has shape (T, Q) or (T, Q, m); f returns the shape of u, g (T, Q) or (T, Q, 3).
        See :class:`esfem_core.Species` and :class:`esfem_core.laws.Regularised`. None is zero.
    alpha, beta : float
        Regularisation alpha >= 0, a squared length in the units of the nodes, and weight beta >= 0
        of mean curvature, a squared length per time; 1 if not given, so that a problem without g,
        motion and law shrinks its surface.
    diffusivity : float, (m,) array or callable
        D >= 0, a squared length per time in the units of the nodes; 1 if not given.
    motion : callable, optional
        X(p, t), positions at time t of the points p of the initial surface, X(p, 0) = p;
        ``lambda p, t: p`` for a surface at rest.
    exact : Exact, optional
        Exact solution, for starting values and errors.
    species : mapping of str to Species, optional
        Instead of u0, f and diffusivity. Any names of printable characters but
        "x", "v" and "normal".
    law : Law, optional
        Instead of g, alpha, beta and motion.

    Attributes
    ----------
    species : mapping of str to Species
    law : Law
    exact : Exact or None

    Raises
    ------
    ValueError, TypeError
        If a parameter is out of range, no function where one is needed, or given twice.

    Examples
    --------
    Mean curvature flow, regularised, with a diffusing substance that pushes outwards:

    >>> problem = Problem(lambda x: 1 + x[:, 0], g=lambda at: 2 * at.u, alpha=0.1, beta=1.0)

    Two species that react, on the surface that the first one drives:

    >>> import esfem_core as ec
    >>> problem = Problem(
    ...     species={
    ...         "a": ec.Species(1.0, lambda at: 0.1 - at["a"] + at["a"] ** 2 * at["b"]),
    ...         "b": ec.Species(0.9, lambda at: 0.9 - at["a"] ** 2 * at["b"], diffusivity=10),
    ...     },
    ...     law=ec.laws.Regularised(alpha=0.1, beta=0.01, g=lambda at: 0.4 * at["a"]),
    ... )
    """

    species: Mapping[str, Species] = field(default_factory=dict)
    law: Law = field(default_factory=Regularised)
    exact: Exact | None = None

    def __init__(
        self,
        u0: Callable[[Array], ArrayLike] | ArrayLike | None = None,
        f: Callable[..., Any] | None = None,
        g: Callable[..., Array] | None = None,
        alpha: float | None = None,
        beta: float | None = None,
        diffusivity: float | Array | Callable[..., Array] | None = None,
        motion: Callable[[Array, float], Array] | None = None,
        exact: Exact | None = None,
        *,
        species: Mapping[str, Species] | None = None,
        law: Law | None = None,
    ) -> None:
        if species is not None:
            _refuse(
                "species is given: write it into its Species",
                u0=u0, f=f, diffusivity=diffusivity,
            )  # fmt: skip
        elif u0 is None:
            _refuse("it belongs to a species, so give u0 as well", f=f, diffusivity=diffusivity)
            species = {}
        else:
            _function("f", f)
            check_of_surface("f", f)
            check_initial("u0", u0)
            species = {"u": Species(u0, f, None, 1.0 if diffusivity is None else diffusivity)}
        if law is not None:
            _refuse(
                "law is given: write it into the law", g=g, alpha=alpha, beta=beta, motion=motion
            )
            check_law(law)
        elif motion is not None:
            _refuse(
                "it belongs to a velocity law, but the motion is prescribed",
                g=g, alpha=alpha, beta=beta,
            )  # fmt: skip
            law = Prescribed(motion)
        else:
            law = Regularised(1.0 if alpha is None else alpha, 1.0 if beta is None else beta, g)
        if exact is not None and not isinstance(exact, Exact):
            raise TypeError(f"exact must be an Exact(x, v, u, ...), got {shown(exact)}")
        _check_names(species, law)
        object.__setattr__(self, "species", MappingProxyType(dict(species)))
        object.__setattr__(self, "law", law)
        object.__setattr__(self, "exact", exact)

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "species": dict(self.species)}  # a read-only view cannot be copied

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, species=MappingProxyType(state["species"]))

    @property
    def law_species(self) -> Mapping[str, Species]:
        """The functions that the law carries; a law of one's own need not say that it has none."""
        carried: Mapping[str, Species] = getattr(self.law, "species", {})
        return carried

    @property
    def all_species(self) -> dict[str, Species]:
        """Those of the law, then those of the problem."""
        return {**self.law_species, **self.species}

    def initial_values(self, x: Array) -> dict[str, Array]:
        """Nodal values at the nodes x, (N, 3), at the start.

        Of all species that have some; a law may make those of its own from the mesh.
        """
        check_nodes("x", x)
        return {
            name: species.initial_values(
                x, "u0" if name == "u" else f"the initial value of {name!r}"
            )
            for name, species in self.all_species.items()
            if species.initial is not None
        }


def _refuse(reason: str, **given: object) -> None:
    """Nothing may be given in two ways."""
    for name, value in given.items():
        if value is not None:
            raise ValueError(f"{name} must not be given here: {reason}")


def _function(name: str, value: object) -> None:
    if value is not None and not callable(value):
        raise TypeError(f"{name} must be a function of a Surface or None, got {shown(value)}")


def _check_names(species: Mapping[str, Species], law: Law) -> None:
    if not isinstance(species, Mapping):
        raise TypeError(f"species must be a mapping from names to Species, got {shown(species)}")
    carried = mapping("species of the law", getattr(law, "species", {}), "Species")
    for of, group in (("species", species), ("species of the law", carried)):
        for name, one in group.items():
            if not isinstance(name, str) or name in RESERVED:
                raise ValueError(f"a {of} must have a name other than x and v, got {name!r}")
            if not name or not name.isprintable():
                raise ValueError(
                    f"a {of} must have a name of printable characters, at least one, got {name!r}"
                )
            if not isinstance(one, Species):
                raise TypeError(f"{of}[{name!r}] must be a Species, got {shown(one)}")
    for name in species:
        if name in carried:
            raise ValueError(
                f"the law has a function {name!r} of its own: give the species another name"
            )
        if name == NORMAL:
            raise ValueError(
                f"a species must have another name than {name!r}: slips and remeshed take that for "
                "the normal of the surface, which only a law can carry"
            )
