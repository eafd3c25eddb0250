r"""Mean curvature flow with the normal and the curvature evolved.

For a surface that moves with v = V nu, the normal nu and H = div nu, the sum of the principal
curvatures, obey (G. Huisken 1984, with :math:`|A|^2 = |\nabla_\Gamma \nu|^2`)

.. math::

    \partial^\bullet \nu = -\nabla_\Gamma V, \qquad
    \partial^\bullet H = -\Delta_\Gamma V - |A|^2 V.

With :math:`V = g - \beta H` and :math:`\nabla_\Gamma H = \Delta_\Gamma \nu + |A|^2 \nu` they become
parabolic,

.. math::

    \partial^\bullet \nu &= \beta \Delta_\Gamma \nu + \beta |A|^2 \nu - \nabla_\Gamma g, \\
    \partial^\bullet H &= \beta \Delta_\Gamma H + \beta |A|^2 H - \Delta_\Gamma g - |A|^2 g,

which B. Kovács, B. Li, C. Lubich discretize (Numer. Math. 143, 2019, for g = 0; Interfaces Free
Bound. 22, 2020, for g = g(u)), with optimal order in H1 for k >= 2 and 2 <= p <= 5. Here v is
the nodal product (g - beta H) nu of the evolved functions, and ``|A|^2`` is
``|grad nu|^2/|nu|^2``.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from inspect import Parameter, signature
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from esfem_core.checks import Array, ReadOnly, finite_array, frozen, function, number, real_array
from esfem_core.elements import (
    Surface,
    SurfaceSpace,
    nodal_average,
    normal_and_curvature,
    smoothed_divergence,
)
from esfem_core.laws.law import Law, Solve
from esfem_core.laws.species import Species
from esfem_core.laws.values import Once, check_of_points, finite_nodal, values_at

__all__ = ["MeanCurvature", "check_normal_and_curvature"]

OFF = 0.5  # from length one: values that have evolved are not exact
SHARE = 0.7  # of the curvature of the surface, at least: meshes of 24 nodes and more have 0.97

Initial = Callable[[Array], ArrayLike] | Array


@dataclass(frozen=True, eq=False)
class MeanCurvature(ReadOnly, Law):
    r"""v = (g - beta H) nu, with nu and H from equations of their own.

    It carries the functions "normal", (N, 3), and "H", (N,), which are not those of the discrete
    surface but of one order more. Degree 1 runs, but is outside the theory.

    Parameters
    ----------
    beta : float
        Weight of the mean curvature H, positive.
    g : callable, optional
        Speed along the normal: ``g(x, t)`` at points (N, 3), returning (N,); or ``g(at)`` on a
        :class:`esfem_core.Surface`, (T, Q), which may depend on species. Either may return a
        number, which holds everywhere. Its gradient is that of a finite element function: of the
        nodal values of g(x, t), or of the nodal averages of g(at), see
        :func:`esfem_core.elements.recovery.nodal_average`. Two arguments without defaults make it
        g(x, t), one makes it g(at). None is zero.
    normal, curvature : callable or array, optional
        Initial values: of points (N, 3) of the initial surface, or nodal ones; such as the methods
        `normal` and `mean_curvature` of an exact surface in
        :mod:`esfem_core.surfaces.exact_surfaces`. The curvature is the sum of the principal ones,
        2/r on a sphere, not their mean. None takes them from the mesh by
        :func:`esfem_core.elements.recovery.normal_and_curvature`.

    Raises
    ------
    ValueError, TypeError
        If a parameter is out of range or no function where one is needed; when a run begins, if
        the normal points inwards or is far from length one, or the curvature has the other sign or
        is about half of that of the surface, as the mean of the principal ones is. What g returns
        is looked at in a run, see :func:`esfem_core.evolve`.

    Examples
    --------
    A shrinking sphere, r^2 = 1 - 4 t:

    >>> import esfem_core as ec
    >>> sphere = ec.exact_surfaces.Sphere()
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 3), 2, sphere.closest)
    >>> law = ec.laws.MeanCurvature(normal=sphere.normal, curvature=sphere.mean_curvature)
    >>> *_, last = ec.evolve(space, ec.Problem(law=law), order=3, step=1 / 200, end=0.1)
    >>> print(f"{np.linalg.norm(last.x, axis=1).mean() ** 2:.4f} {last['H'].mean() ** -2:.4f}")
    0.6000 0.1500
    """

    beta: float = 1.0
    g: Callable[..., ArrayLike] | None = None
    normal: Initial | None = None
    curvature: Initial | None = None
    _known: Callable[[Surface], Array | None] = field(init=False, repr=False)
    _first: Callable[[SurfaceSpace], tuple[Array, Array]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "beta", number("beta", self.beta, above=0))
        if self.g is not None:
            _takes_points(function("g", self.g, "g(at) or g(x, t), or None"))
        for name, shape in (("normal", ("N", 3)), ("curvature", ("N",))):
            value = getattr(self, name)
            check_of_points(name, value)
            if value is not None and not callable(value):
                own = finite_array(name, value, shape)
                if not own.size:
                    raise ValueError(f"{name} must hold a value for each node, got none")
                object.__setattr__(self, name, frozen(own))
        object.__setattr__(self, "_known", Once(self._forcing))
        object.__setattr__(self, "_first", Once(_of_nodes))

    @property
    def species(self) -> Mapping[str, Species]:
        """The normal and the mean curvature; `initial` has their initial values."""
        options: dict[str, Any] = {"diffusivity": self.beta, "conserved": False}
        return {
            "normal": Species(None, self._normal_source, **options),
            "H": Species(None, self._curvature_source, **options),
        }

    def initial(self, at: Surface) -> Mapping[str, Array]:
        """Normal and curvature, from the mesh where they are not given.

        Raises
        ------
        TypeError, ValueError
            If the given normal is not that of the surface, outwards and of length one, or the
            curvature has the other sign or is too small.
        """
        normal, H = _given("normal", self.normal, at, (3,)), _given("curvature", self.curvature, at)
        if normal is not None:
            _check_outward(at, normal)
        if H is not None:
            _check_sign(at, H)
        if normal is None:
            normal, own = self._own(at)
        elif H is None:
            own = smoothed_divergence(at, normal)
        if H is not None:
            _check_sum(at, normal, H)
        return {"normal": normal, "H": own if H is None else H}

    def velocity(
        self, at: Surface, new: Mapping[str, Array], tau: float, past: Array, solve: Solve
    ) -> Array:
        """(g - beta H) nu at the nodes."""
        speed = -self.beta * new["H"]
        g = self.forcing(at)
        if g is not None:
            speed = speed + g
        v: Array = speed[:, None] * new["normal"]
        return v

    def forcing(self, at: Surface) -> Array | None:
        """Nodal values of g, computed once for each surface; None if g is zero."""
        return self._known(at)

    def _own(self, at: Surface) -> tuple[Array, Array]:
        """Normal and curvature of the mesh; those of a space's own nodes are computed once.

        A run asks for them when it is checked and when it begins.
        """
        if np.array_equal(at.x, at.space.nodes):
            return self._first(at.space)
        return normal_and_curvature(at)

    def _normal_source(self, at: Surface) -> Array:
        """Beta |A|^2 nu - grad g."""
        values = self.beta * _squared_weingarten(at)[..., None] * at["normal"]
        g = self.forcing(at)
        if g is not None:
            values -= at.space.gradient(at.x, g)
        return values

    def _curvature_source(self, at: Surface) -> Array | tuple[Array, Array]:
        """|A|^2 (beta H - g) - div(grad g)."""
        square, g = _squared_weingarten(at), self.forcing(at)
        if g is None:
            return self.beta * square * at["H"]
        values = square * (self.beta * at["H"] - at.space.evaluate(g))
        return values, at.space.gradient(at.x, g)

    def _forcing(self, at: Surface) -> Array | None:
        if self.g is None:
            return None
        if _takes_points(self.g):
            g = real_array("g(x, t)", self.g(at.x.copy(), at.t), ("...",))
            shape = (len(at.x),)
            return finite_nodal("g(x, t)", np.full(shape, g) if g.ndim == 0 else g, shape)
        return nodal_average(at, values_at("g", self.g(at), at, [()]))


def check_normal_and_curvature(at: Surface, name: str) -> None:
    """Refuse a normal and a curvature of a state as MeanCurvature refuses those that it is given.

    Parameters
    ----------
    at : Surface
        With the functions "normal" and "H".
    name : str
        What messages call the state.

    Raises
    ------
    ValueError

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 2))
    >>> at = Surface(space, space.nodes, {"normal": -space.nodes, "H": 0 * space.nodes[:, 0] + 2})
    >>> check_normal_and_curvature(at, "start[-1]")
    Traceback (most recent call last):
        ...
    ValueError: start[-1]['normal'] must point outwards and have length one, but at node 0, ...
    """
    called = f"{name}['H']"
    H = finite_array(called, at.fields["H"], (len(at.x),))
    normal = finite_array(f"{name}['normal']", at.fields["normal"], at.x.shape)
    _check_outward(at, normal, f"{name}['normal']")
    _check_sign(at, H, called)
    _check_sum(at, normal, H, called)


def _of_nodes(space: SurfaceSpace) -> tuple[Array, Array]:
    normal, H = normal_and_curvature(Surface(space, space.nodes))
    return frozen(normal), frozen(H)


def _check_outward(at: Surface, normal: Array, called: str = "normal") -> None:
    """Refuse what is far from the normal of the mesh: the surface would move another way."""
    length = np.linalg.norm(normal, axis=1)
    off = np.abs(length - 1) > OFF
    bad = off | ((normal * nodal_average(at, at.normal)).sum(axis=1) <= 0)
    if bad.any():
        i = int(np.argmax(bad))
        raise ValueError(
            f"{called} must point outwards and have length one, but at node "
            f"{i}, {at.x[i].tolist()}, it is {normal[i].tolist()}"
        )


def _check_sign(at: Surface, H: Array, called: str = "curvature") -> None:
    """Refuse a curvature of the other sign: the integral of H x.nu is twice the area."""
    off = at.points - at.mean(at.points)
    if at.integral(at.space.evaluate(H) * (off * at.normal).sum(axis=-1)) < 0:
        raise ValueError(
            f"{called} must be the sum of the principal curvatures, positive for a sphere, but "
            "has the other sign"
        )


def _check_sum(at: Surface, normal: Array, H: Array, called: str = "curvature") -> None:
    """Refuse the mean of the principal curvatures: the surface would move at half the speed.

    With D = div nu, H is about int H^2 / int H D times the curvature of the surface. Where it has
    folds finer than the mesh, D is too small, but never too large: no right curvature is refused.
    """
    D = np.trace(at.space.gradient(at.x, normal), axis1=-2, axis2=-1)
    values = at.space.evaluate(H)
    square, product = float(at.integral(values**2)), float(at.integral(values * D))
    if product >= 0 and not square > SHARE * product:
        share = square / product if product else 0.0
        raise ValueError(
            f"{called} must be the sum of the principal curvatures, 2/r on a sphere, but is about "
            f"{share:.2g} times that of the surface; the sum is twice their mean"
        )


def _given(
    name: str, values: Initial | None, at: Surface, trailing: tuple[int, ...] = ()
) -> Array | None:
    """Nodal values that are given as such or as a function."""
    shape = (len(at.x), *trailing)
    if values is None:
        return None
    if callable(values):
        return finite_array(f"{name}(x)", values(at.x.copy()), shape)
    return finite_array(name, values, shape)


def _squared_weingarten(at: Surface) -> Array:
    """|A|^2, the sum of the squares of the principal curvatures, (T, Q).

    Divided by |nu|^2, which is 1 up to errors: with |grad nu|^2 alone, a normal of length 1 + eps
    on a resting sphere grows like exp(4 beta t/r^2), with the quotient every length is at rest.
    """
    A, nu = at.grad("normal"), at["normal"]
    square: Array = np.einsum("tqij,tqij->tq", A, A) / np.einsum("tqi,tqi->tq", nu, nu)
    return square


def _counted(g: Callable[..., Any], needed: int) -> str:
    """What a message says of the number of arguments that g needs."""
    if any(p.kind is Parameter.VAR_POSITIONAL for p in signature(g).parameters.values()):
        return "*args, which do not say which: write lambda at: g(at), or lambda x, t: g(x, t)"
    return str(needed or "none")


def _takes_points(g: Callable[..., Any]) -> bool:
    """Whether g is called with (x, t) and not with a surface."""
    kinds = (Parameter.POSITIONAL_ONLY, Parameter.POSITIONAL_OR_KEYWORD)
    try:
        taken = [p for p in signature(g).parameters.values() if p.kind in kinds]
    except ValueError:  # some builtins do not tell
        return False
    needed = sum(p.default is Parameter.empty for p in taken)
    if needed not in (1, 2):
        raise ValueError(
            "g must be g(at) or g(x, t), with one or two arguments without defaults, got "
            f"{_counted(g, needed)}"
        )
    if needed == 1 and [p.name for p in taken[1:2]] == ["t"]:
        raise ValueError("g must be g(x, t) without a default for t, or g(at), which has at.t")
    return needed == 2
