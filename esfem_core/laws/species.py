"""What diffuses on the surface, and is carried with it: one equation of [N] (2.7) each."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array

from esfem_core.checks import (
    Array,
    ReadOnly,
    check_even,
    check_nodes,
    finite_array,
    flag,
    frozen,
    function,
    number,
    shown,
)
from esfem_core.elements import NotFiniteError, Surface, check_tensors, combination
from esfem_core.laws.fixed import Fixed
from esfem_core.laws.values import check_of_points, check_of_surface, values_at

__all__ = ["Part", "Species", "check_initial"]

NEGATIVE = 1e-12  # eigenvalues of diffusion tensors this far below zero, relatively, are rounding


class Part(NamedTuple):
    """Components of a species that have one operator.

    Attributes
    ----------
    components : slice or (m,) bool array
        Which ones, of the trailing index of u.
    diffusivity, rate : float, or (T, Q) or (T, Q, 3, 3) float array
    """

    components: Any
    diffusivity: Any
    rate: Any

    def operator(self, weight: float, M: csr_array, at: Surface) -> csr_array:
        """Weight M + (stiffness matrix of the diffusivity) + (mass matrix of the rate).

        The last two on the surface `at`; M may belong to another one.
        """
        if np.ndim(self.diffusivity) == 0 and np.ndim(self.rate) == 0:
            K = combination(weight, M, self.diffusivity, at.A)
            return K if self.rate == 0 else combination(1.0, K, self.rate, at.M)
        rest = at.matrix(self.rate, self.diffusivity)
        return combination(weight, M, 1.0, rest)

    @property
    def key(self) -> tuple[object, object] | None:
        """Equal for parts with equal operators; None if the operator is one of its own."""
        constant = np.ndim(self.diffusivity) == 0 and np.ndim(self.rate) == 0
        return (float(self.diffusivity), float(self.rate)) if constant else None


@dataclass(frozen=True, eq=False)
class Species(ReadOnly):
    r"""A substance that diffuses on the surface and is carried with it.

    It solves

    .. math::

        \partial^\bullet u + u \nabla_\Gamma \cdot v - \nabla_\Gamma \cdot (D \nabla_\Gamma u)
        + \text{rate}\; u = \text{source} - \nabla_\Gamma \cdot \text{flux}

    weakly, tested with :math:`\varphi`,

    .. math::

        \frac{\mathrm d}{\mathrm dt} \int u \varphi
        + \int D \nabla_\Gamma u \cdot \nabla_\Gamma \varphi + \text{rate}\; u \varphi
        = \int \text{source}\; \varphi + \text{flux} \cdot \nabla_\Gamma \varphi

    which for D = 1 without rate and flux is [N] (2.7) and [LMV] (2.1). In time, D, rate, source and
    flux are those of the extrapolated surface and functions; u itself is implicit, so that a large
    rate needs no small step, while a source -k u is stable for k tau < 2, 4/3, 20/21, 32/45,
    256/465 (p = 1, ..., 5) only. A flux c grad u is explicit, too: a method is stable for every
    step if abs(c) < D/(2^p - 1), and is not if c < -D/(2^p - 1). So is cross-diffusion, fluxes
    -D12 grad b of a species a and -D21 grad a of b: stable for every step if
    abs(D12 D21) < D11 D22/(2^p - 1)^2, while beyond, if D12 D21 > 0, only steps below a multiple of
    h^2/D are. A constant matrix D = T diag(d) T^-1 with d >= 0 needs no such flux: T^-1 (a, b) is
    one species of two components with ``diffusivity=d``. Explicit, too, is transport, a flux u a or
    a slip w = -a of the nodes: it is stable on every mesh for tau abs(a)^2 < 2 D, 1.22 D, 0.46 D,
    0.15 D, 0.046 D (p = 1, ..., 5). Where D is smaller take p = 3 or 4, which are stable for
    tau omega < 0.63, 0.54 as well, with a frequency omega of about 2.4, 6.5, 11 times abs(a)/h for
    k = 1, 2, 3; p = 1, 2 and 5 have no such range. A velocity that the nodes follow,
    ``laws.Prescribed(velocity=a)``, has no limit of this kind.

    D = 0 is well posed, but a conserved species then feels the divergence of the interpolated
    velocity undamped: its order in space is k in L2.

    At a boundary with conormal mu the natural condition is mu . (D grad u - flux) = 0: nothing
    passes, and without source the amount of a conserved species is kept. With `fixed`, u itself is
    given there and the weak form holds for phi that are zero there (Dirichlet's condition); what
    passes changes the amount.

    Parameters
    ----------
    initial : callable, array, float or None
        Initial values: of points (N, 3), returning (N,) or (N, m); or the nodal values; or a
        constant. None for a function of a law that makes its own from the mesh, see
        :meth:`esfem_core.laws.law.Law.initial`.
    source : callable, optional
        ``source(at)`` on a :class:`esfem_core.Surface`: values of the shape of u there, (T, Q) or
        (T, Q, m); or a pair (values, flux), values possibly None, flux (T, Q, 3) or (T, Q, m, 3),
        of which the tangential part counts. None is zero.
    rate : float or callable, optional
        Not negative, taken implicitly: a number, or ``rate(at)`` of shape (T, Q). None is zero.
    diffusivity : float, (m,) array or callable
        D >= 0, a squared length per time in the units of the nodes: a number, one for each
        component, or ``diffusivity(at)`` of shape (T, Q), or (T, Q, 3, 3), symmetric and positive
        semidefinite on the tangent planes.
    conserved : bool
        If False, the equation has no u div v: for quantities like a temperature of its own, or a
        normal vector, that are carried, but not diluted.
    fixed : float, callable or pair, optional
        Values at the boundary: a number, or ``fixed(x, t)`` of the positions, (B, 3), of its nodes
        at time t, returning (B,) or (B, m). Or a pair (nodes, values): numbers of nodes, (B,), or a
        bool for each, (N,), on a part of the boundary or anywhere; and a number, (B, ...) values or
        a function. Steps keep them exactly; `initial` stays as it is: other values there are a jump
        at the start. None for the natural condition.

    Raises
    ------
    ValueError, TypeError
        If a parameter is out of range or no function where one is needed. What functions return is
        looked at in a run, see :func:`esfem_core.evolve`.

    Examples
    --------
    >>> import esfem_core as ec
    >>> ec.Species(1.0, source=lambda at: -at.u, diffusivity=0.1).conserved
    True

    Warm at one half of the boundary of a hemisphere, insulated at the other:

    >>> tri = ec.sphere("octahedron", 2)
    >>> tri.update_faces(tri.triangles_center[:, 2] > 0)
    >>> tri.remove_unreferenced_vertices()
    >>> space = ec.SurfaceSpace(tri, 2, ec.to_unit_sphere, boundary=True)
    >>> b = space.boundary_nodes
    >>> warm = b[space.nodes[b, 0] >= 0]
    >>> law = ec.laws.Prescribed(motion=lambda p, t: (1 + t) * p)
    >>> species = {"u": ec.Species(1.0, conserved=False, fixed=(warm, lambda x, t: 1 + t))}
    >>> problem = ec.Problem(species=species, law=law)
    >>> *_, last = ec.evolve(space, problem, order=2, step=1 / 10, end=1.0)
    >>> bool((last.u[warm] == 2).all()), bool(last.u.min() < 2)
    (True, True)
    """

    initial: Callable[[Array], ArrayLike] | ArrayLike | None
    source: Callable[[Surface], Any] | None = None
    rate: float | Callable[[Surface], Array] | None = None
    diffusivity: float | Array | Callable[[Surface], Array] = 1.0
    conserved: bool = True
    fixed: Any = None

    def __post_init__(self) -> None:
        if self.source is not None:
            function("source", self.source, "of a Surface or None")
        check_of_surface("source", self.source)
        check_of_surface("rate", self.rate)
        check_of_surface("diffusivity", self.diffusivity)
        _check_one_rate(self.rate)
        if self.rate is not None and not callable(self.rate):
            object.__setattr__(self, "rate", number("rate", self.rate, least=0))
        check_even("diffusivity", self.diffusivity)
        if not callable(self.diffusivity):
            if np.ndim(self.diffusivity) == 0:
                D = number("diffusivity", self.diffusivity, least=0)
                object.__setattr__(self, "diffusivity", D)
            else:
                if np.ndim(self.diffusivity) > 1:
                    raise ValueError(
                        "diffusivity must be a number or one for each component, got shape "
                        f"{np.shape(self.diffusivity)}; a tensor is given by a function of at, "
                        "returning (T, Q, 3, 3)"
                    )
                values = finite_array("diffusivity", self.diffusivity, ("m",))
                if len(values) == 0 or values.min() < 0:
                    raise ValueError(
                        "diffusivity must hold a number >= 0 for each component, got "
                        f"{values.tolist()}"
                    )
        check_initial("initial", self.initial)
        for name in ("initial", "diffusivity"):
            value = getattr(self, name)
            if isinstance(value, np.ndarray | list | tuple):
                object.__setattr__(self, name, frozen(np.asarray(value)))
        object.__setattr__(self, "conserved", flag("conserved", self.conserved))
        if self.fixed is not None:
            object.__setattr__(self, "fixed", Fixed.of(self.fixed))

    def initial_values(self, x: Array, name: str = "initial") -> Array:
        """Nodal values at the nodes x, (N, 3), at the start.

        Parameters
        ----------
        x : (N, 3) float array
        name : str
            What messages call them.

        Returns
        -------
        (N,) or (N, m) float array

        Raises
        ------
        ValueError, TypeError
            If x is no such array; if they are not real, finite or not one row for each node, or if
            D has another number of components.
        """
        check_nodes("x", x)
        values: Any = self.initial(x.copy()) if callable(self.initial) else self.initial
        _check_numbers(name, values)
        values = finite_array(name, values, ("...",))
        if values.ndim == 0:
            values = np.full(len(x), values)
        if values.ndim > 2 or values.shape[:1] != x.shape[:1] or values.size == 0:
            raise ValueError(
                f"{_called(name)} must give a number or one row for each of {len(x)} nodes, shape "
                f"({len(x)},) or ({len(x)}, m); got {np.shape(values)}"
            )
        u = np.array(values)
        D: Any = self.diffusivity
        if np.ndim(D) == 1 and np.shape(D) != u.shape[1:]:
            raise ValueError(
                f"diffusivity must have one number for each component of {_called(name)}: "
                f"diffusivity has shape {np.shape(D)}, but {_called(name)} has "
                f"{u.shape[1:] or 'one component, (N,)'}"
            )
        return u

    def parts(self, name: str, at: Surface) -> list[Part]:
        """The components of the species of this name in groups of equal diffusivity."""
        called = f"the rate of {name!r}"
        rate = self._coefficient(called, 0.0 if self.rate is None else self.rate, at, [()])
        D = self.diffusivity
        if callable(D):
            called = f"the diffusivity of {name!r}"
            D = self._coefficient(called, D, at, [(), (3, 3)])
            if D.ndim == 4:
                check_tensors(called, D)  # eigvalsh reads one half only
                _require_definite(called, D, at)
        elif np.ndim(D) == 1:
            return [Part(np.equal(D, value), float(value), rate) for value in np.unique(D)]
        return [Part(slice(None), D, rate)]

    def load(self, name: str, at: Surface) -> Array | None:
        """Load vector of source and flux, (N, ...); None if there is no source."""
        if self.source is None:
            return None
        called = f"the source{' f' if name == 'u' else ''} of {name!r}"
        returned = self.source(at)
        if returned is None:
            raise TypeError(
                f"{called} must return numbers, but returned None: is a return missing? Zero is 0.0"
            )
        trailing = at.fields[name].shape[1:]
        _check_pair(called, returned, at, trailing)
        flux = None
        if isinstance(returned, tuple):
            if len(returned) != 2:
                raise ValueError(
                    f"{called} must return values or a pair (values, flux), got "
                    f"{len(returned)} of them; components stand side by side in one array, "
                    "np.stack([...], axis=-1)"
                )
            returned, flux = returned
            if flux is not None:
                flux = values_at(f"{called} (flux)", flux, at, [(*trailing, 3)])
        if returned is not None:
            returned = values_at(called, returned, at, [trailing])
        elif flux is None:
            return None
        return at.load(returned, flux)

    @staticmethod
    def _coefficient(
        name: str, given: Any, at: Surface, trailing: Sequence[tuple[int, ...]]
    ) -> Any:
        if not callable(given):
            return given
        values = values_at(name, given(at), at, trailing)
        if values.ndim == 2 and values.min() < 0:
            element, point = np.argwhere(values < 0)[0].tolist()
            raise NotFiniteError(
                f"{name} must not be negative, got {values[element, point]:.6g} in element "
                f"{element}; {_undershoot(at)}",
                element,
            )
        return values


def _undershoot(at: Surface) -> str:
    """Where negative coefficients can come from, as an end of a message."""
    of_u = "u", "at.u"
    every = [of_u if w == "u" else (repr(w), f"at[{w!r}]") for w in at.fields] or [of_u]
    names, values = (" or ".join(words) for words in zip(*every, strict=True))
    return (
        f"where it is a function of {names}, extrapolated values can undershoot: np.maximum(w, 0) "
        f"of w = {values} is not negative"
    )


def _called(name: str) -> str:
    """What a message calls initial values; a species "u" may have come without the name u0."""
    return "the initial value u0 of 'u'" if name == "u0" else name


def _check_numbers(name: str, values: ArrayLike) -> None:
    finite_array(_called(name), values, ("...",))


def _check_one_rate(rate: object) -> None:
    if isinstance(rate, list | tuple) or (isinstance(rate, np.ndarray) and rate.ndim > 0):
        raise TypeError(
            f"rate must be a finite number >= 0, one for all components, or a function, got "
            f"{shown(rate)}; components with rates of their own are species of their own"
        )


def check_initial(name: str, value: object) -> None:
    """Refuse what can be no initial values; None and functions are for later.

    Examples
    --------
    >>> check_initial("u0", "one")
    Traceback (most recent call last):
        ...
    TypeError: u0 must be a function of points (N, 3), nodal values or a number, got 'one'
    """
    if value is None or callable(value):
        check_of_points(name, value)
        return
    check_even(name, value)
    if isinstance(value, np.ndarray | list | tuple) and np.size(value):
        finite_array(name, value, ("...",))
        return
    try:
        number(name, value)
    except TypeError:
        raise TypeError(
            f"{name} must be a function of points (N, 3), nodal values or a number, got "
            f"{shown(value)}"
        ) from None


def _check_pair(called: str, returned: object, at: Surface, trailing: tuple[int, ...]) -> None:
    """Refuse what looks like a pair (values, flux) and is none, or is none and is meant as one."""
    if not isinstance(returned, tuple | list) or len(returned) != 2:
        return
    points = at.density.shape
    shapes = [np.shape(one) for one in returned if isinstance(one, np.ndarray)]
    if isinstance(returned, tuple) and trailing and shapes == [points, points]:
        raise ValueError(
            f"{called} must return one array of shape {(*points, *trailing)}, got two of shape "
            f"{points}: a tuple is (values, flux), components stand side by side, "
            "np.stack([...], axis=-1)"
        )
    if isinstance(returned, list) and len(set(shapes)) == 2:
        raise TypeError(
            f"{called} must return values or a pair (values, flux), got a list of two arrays, of "
            f"shapes {shapes[0]} and {shapes[1]}: a pair is a tuple"
        )


def _require_definite(name: str, D: Array, at: Surface) -> None:
    """Diffusion tensors must not have a negative eigenvalue on the tangent plane."""
    P = np.eye(3) - at.normal[..., :, None] * at.normal[..., None, :]
    lowest = np.linalg.eigvalsh(P @ D @ P)[..., 0]
    bad = lowest < -NEGATIVE * np.abs(D).max()
    if bad.any():
        element = int(np.argmax(bad.any(axis=1)))
        raise NotFiniteError(
            f"{name} must be positive semidefinite on the tangent planes, but has the "
            f"eigenvalue {lowest[element].min():.6g} in element {element}; {_undershoot(at)}",
            element,
        )
