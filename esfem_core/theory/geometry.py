r"""How far a discrete surface is from the exact one, in all the norms of a proof.

[N] Lemmas 5.2 to 5.4 and (6.3), [LMV] (5.5) to (5.10): distance and normal, the forms m, a and q,
the velocity of the lifted surface, the interpolation of functions. With d the signed distance, W
the Weingarten map at the closest point p, and D²d = W (I + d W)^{-1} at the point itself, which
[LMV] call :math:`\mathcal H`,

.. math::

    I - d\, D^2 d &= (I + d W)^{-1}, \\
    B_h &= \mathrm{Pr}_h\, (I - d\, D^2 d), \\
    R_h &= \frac1{\delta_h}\, \mathrm{Pr}\, (I - d\, D^2 d)\, \mathrm{Pr}_h\, (I - d\, D^2 d).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from esfem_core.checks import Array, finite_array, function, object_of
from esfem_core.elements import SurfaceSpace
from esfem_core.errors import unit_of
from esfem_core.surfaces import derivative
from esfem_core.surfaces.exact_surfaces import ExactSurface, Near
from esfem_core.theory.forms import Lift, lift, mass, near_of, stiffness

__all__ = [
    "GeometricErrors",
    "apply",
    "closest_point_derivative",
    "geometric_errors",
    "largest_norm",
    "lift_operators",
    "lifted_norm",
    "tangent_projection",
]

FAR = 1e8  # distance times curvature: 1 + d W loses the 1 in rounding
STILL = 1e-6  # how far a motion may take points at t = 0, over the largest coordinate
Function = Callable[[Array], Array]


class GeometricErrors(NamedTuple):
    """Errors of a discrete surface against the exact one.

    Attributes
    ----------
    distance, normal : float
        Largest distance and largest difference of the normals, [N] Lemma 5.2.
    m, a, q : float
        Largest weight of the differences of the forms, [N] Lemma 5.4.
    velocity : float
        L2 norm of v̂_h - v, the velocity of the lifted surface less that of the exact one.
    u_l2, u_h1 : float
        Errors of the lifted interpolant of u, [N] Lemma 5.3, and of its gradient.
    b : float
        L2 norm of (I - B_h) grad u, [N] (6.3).
    m_smooth, a_smooth : float
        Differences of the forms with the interpolant of u in both arguments.
    """

    distance: float
    normal: float
    m: float
    a: float
    q: float
    velocity: float
    u_l2: float
    u_h1: float
    b: float
    m_smooth: float
    a_smooth: float


def tangent_projection(normal: ArrayLike) -> Array:
    """Projections Pr = I - ν ν^T onto tangent planes.

    Parameters
    ----------
    normal : (..., 3) float array
        Unit normals.

    Returns
    -------
    (..., 3, 3) float array

    Raises
    ------
    TypeError, ValueError
        If they are not finite vectors.

    Examples
    --------
    >>> tangent_projection([0.0, 0.0, 1.0]).diagonal()
    array([1., 1., 0.])
    """
    nu = finite_array("normal", normal, ("...", 3))
    return np.asarray(np.eye(3) - nu[..., :, None] * nu[..., None, :])


def apply(matrices: Array, vectors: Array) -> Array:
    """Products of matrices (T, Q, 3, 3) with vectors (T, Q, 3), point by point."""
    matrices = finite_array("matrices", matrices, ("T", "Q", 3, 3))
    vectors = finite_array("vectors", vectors, (*matrices.shape[:2], 3))
    products: Array = np.einsum("tqij,tqj->tqi", matrices, vectors)
    return products


def largest_norm(tensors: Array) -> float:
    """Largest Frobenius norm of vectors (T, Q, 3) or matrices (T, Q, 3, 3); 0 if there are none."""
    tensors = finite_array("tensors", tensors, ("T", "Q", 3, "..."))
    axes, unit = -1 if tensors.ndim == 3 else (-2, -1), unit_of(tensors)
    return unit * float(np.linalg.norm(tensors / unit, axis=axes).max(initial=0.0))


def lifted_norm(space: SurfaceSpace, x: Array, onto: Lift, values: Array) -> float:
    """L2 norm over the exact surface of values at the lifted quadrature points.

    Parameters
    ----------
    space : SurfaceSpace
    x : (N, 3) float array
        Node positions.
    onto : Lift
        From :func:`esfem_core.theory.forms.lift`.
    values : (T, Q, ...) float array

    Returns
    -------
    float

    Raises
    ------
    TypeError, ValueError
        If an argument has the wrong type or shape, or values are not finite.
    esfem_core.DegenerateElementError
        If an element has no area or a position is not finite.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere, exactness=10)
    >>> onto = lift(space, space.nodes, ec.exact_surfaces.Sphere())
    >>> print(f"{lifted_norm(space, space.nodes, onto, onto.points) ** 2 / np.pi:.6f}")
    4.000000
    """
    object_of("space", space, SurfaceSpace)
    shape = object_of("onto", onto, Lift).ratio.shape
    values = finite_array("values", values, (*shape, "..."))
    unit = unit_of(values)
    total = ((values / unit) ** 2).reshape(*shape, -1).sum(axis=-1)
    return unit * float(np.sqrt(space.integrate(x, onto.ratio * total)))


def _shrinking(near: Near) -> Array:
    """I - d D²d = (I + d W)^{-1}, (..., 3, 3)."""
    stretching = np.eye(3) + near.distance[..., None, None] * near.weingarten
    return np.asarray(np.linalg.inv(stretching), dtype=float)


def closest_point_derivative(surface: ExactSurface, points: Array) -> Array:
    """Differential Dp = (I + d W)^{-1} Pr of the closest-point map p.

    A point that moves with velocity v beside a surface at rest has a closest point that moves
    with Dp v.

    Parameters
    ----------
    surface : ExactSurface
    points : (..., 3) float array

    Returns
    -------
    (..., 3, 3) float array

    Raises
    ------
    TypeError, ValueError
        If a point has no unique closest point, or is 1e8 radii of curvature away; or as by
        :func:`~esfem_core.theory.forms.near_of`.

    Examples
    --------
    >>> from esfem_core.surfaces.exact_surfaces import Sphere
    >>> closest_point_derivative(Sphere(), np.array([0.0, 0.0, 2.0])).diagonal()
    array([0.5, 0.5, 0. ])
    """
    near = near_of(surface, points)
    away = np.abs(near.distance) * np.linalg.norm(near.weingarten, axis=(-2, -1))
    if not (away < FAR).all():
        raise ValueError(
            f"points must be within {FAR:g} radii of curvature of the surface, but one is "
            f"{away.max():.2g} away"
        )
    return _shrinking(near) @ tangent_projection(near.normal)


def lift_operators(space: SurfaceSpace, x: Array, surface: ExactSurface) -> tuple[Array, Array]:
    """[LMV]'s B_h and R_h at the quadrature points.

    B_h takes the gradient of a lift to that of the function, (5.7); with R_h, which has the area
    ratio in it, the Dirichlet integral becomes one over the exact surface, (5.8).

    Parameters
    ----------
    space : SurfaceSpace
    x : (N, 3) float array
        Node positions.
    surface : ExactSurface

    Returns
    -------
    B, R : (T, Q, 3, 3) float arrays

    Raises
    ------
    TypeError, ValueError
        If a quadrature point has no unique closest point.

    Examples
    --------
    >>> import esfem_core as ec
    >>> from esfem_core.surfaces.exact_surfaces import Sphere
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1))
    >>> B, _ = lift_operators(space, space.nodes, Sphere())
    >>> lifted = lift(space, space.nodes, Sphere()).gradient
    >>> gradient = space.gradient(space.nodes, space.nodes[:, 2])
    >>> bool(abs(apply(B @ lifted, gradient) - gradient).max() < 1e-14)
    True
    """
    ratio = lift(space, x, surface).ratio  # which looks at the arguments
    near = near_of(surface, space.quadrature_points(x))
    shrinking = _shrinking(near)
    B = tangent_projection(space.normals(x)) @ shrinking
    R = tangent_projection(near.normal) @ shrinking @ B / ratio[..., None, None]
    return B, R


def _checked(name: str, given: Callable[..., Any]) -> Callable[..., Array]:
    """A function of points, and perhaps a time, that returns as many vectors, looked at."""
    function(name, given, "of points (..., 3)")

    def values(x: Array, *t: float) -> Array:
        called = f"{name}(x{', t' if t else ''})"
        return finite_array(called, given(x.copy(), *t), x.shape)

    return values


def geometric_errors(
    space: SurfaceSpace,
    surface: Callable[[float], ExactSurface],
    motion: Callable[[Array, float], Array],
    velocity: Function,
    u: Function,
    gradient: Function,
) -> GeometricErrors:
    """Measure all errors of a discrete surface that the proofs estimate, at time 0.

    Rates are differences with a step of 0.01, for motions on times of about one.

    Parameters
    ----------
    space : SurfaceSpace
        With nodes on ``surface(0)``.
    surface : callable
        ``surface(t)``, the exact surface at the time t.
    motion : callable
        ``motion(x, t)``, (..., 3): where the points x of ``surface(0)`` are at the time t.
    velocity : callable
        Of the points at time 0, (..., 3) to (..., 3).
    u, gradient : callable
        A smooth function in space, (..., 3) to (...), and its full gradient, (..., 3).

    Returns
    -------
    GeometricErrors

    Raises
    ------
    TypeError, ValueError
        If a quadrature point has no unique closest point, a function does not return finite values
        of the shape stated, or ``motion(x, 0)`` is not x.

    Examples
    --------
    >>> import esfem_core as ec
    >>> from esfem_core.surfaces.exact_surfaces import Sphere
    >>> found = geometric_errors(
    ...     ec.SurfaceSpace(ec.sphere("icosahedron", 2)),
    ...     surface=lambda t: Sphere(1 + t),
    ...     motion=lambda x, t: (1 + t) * x,
    ...     velocity=lambda x: x,
    ...     u=lambda x: x[..., 2],
    ...     gradient=lambda x: 0 * x + [0, 0, 1],
    ... )
    >>> print(f"{found.distance:.3f} {found.normal:.3f}")
    0.013 0.096
    """
    object_of("space", space, SurfaceSpace)
    function("surface", surface, "of a time")
    x = space.nodes
    onto = lift(space, x, surface(0.0))
    y = onto.points
    motion = _checked("motion", motion)
    if (away := np.abs(motion(x, 0.0) - x).max()) > STILL * np.abs(x).max():
        raise ValueError(
            f"motion must leave points where they are at t = 0, but moves one by {away:.3g}"
        )
    slope = _checked("gradient", gradient)(y)
    speed = _checked("velocity", velocity)(y)
    function("u", u, "of points (..., 3)")
    nodal, there = (finite_array("u(x)", u(p.copy()), p.shape[:-1]) for p in (x, y))
    tensor = onto.tensor - tangent_projection(space.normals(x))
    exact = apply(tangent_projection(onto.normal), slope)

    def excess(t: float) -> Array:  # (δ_h - 1) s
        moved = motion(x, t)
        return (lift(space, moved, surface(t)).ratio - 1) * space.density(moved)

    def lifted(t: float) -> Array:
        return surface(t).closest(space.quadrature_points(motion(x, t)))

    def norm(values: Array) -> float:
        return lifted_norm(space, x, onto, values)

    return GeometricErrors(
        distance=float(np.abs(onto.distance).max()),
        normal=largest_norm(space.normals(x) - onto.normal),
        m=float(np.abs(onto.ratio - 1).max()),
        a=largest_norm(tensor),
        q=float(np.abs(derivative(excess) / space.density(x)).max()),
        velocity=norm(derivative(lifted) - speed),
        u_l2=norm(space.evaluate(nodal) - there),
        u_h1=norm(apply(onto.gradient, space.gradient(x, nodal)) - exact),
        b=norm(apply(lift_operators(space, x, surface(0.0))[0], exact) - exact),
        m_smooth=float(abs(nodal @ (mass(space, x, onto.ratio - 1) @ nodal))),
        a_smooth=float(abs(nodal @ (stiffness(space, x, tensor) @ nodal))),
    )
