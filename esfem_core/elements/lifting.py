"""Functions on a discrete surface, carried to the exact one: lifts ([N] Section 2.12)."""

from collections.abc import Callable

import numpy as np

from esfem_core.checks import Array, real_array
from esfem_core.elements.lagrange import tabulate
from esfem_core.elements.probing import check_space
from esfem_core.elements.quadrature import triangle_rule
from esfem_core.elements.space import SurfaceSpace
from esfem_core.surfaces import central_stencil

__all__ = ["squared_differences"]

DISTANCE = 0.002  # between the points of a difference, measured in the reference triangle
STENCIL = central_stencil(4)


def squared_differences(
    space: SurfaceSpace,
    x: Array,
    closest: Callable[[Array], Array],
    w: Array,
    function: Callable[[Array], Array],
    exactness: int | None = None,
) -> tuple[Array, Array]:
    r"""Squared errors of a lift, and of its gradient.

    .. math::

        \int_\Gamma |w^l - \text{function}|^2, \qquad
        \int_\Gamma |\nabla_\Gamma (w^l - \text{function})|^2

    w^l(p(y)) = w(y) is the lift of the finite element function w on Γ_h[x] to Γ ([N] Section
    2.12), with the closest point p. With the element map Phi, the point p(Phi(xi)) runs through a
    piece of Γ, so both integrals are taken over the reference triangle with the metric of the
    tangents d p(Phi(xi))/d xi_i, and gradients are those on Γ. The derivatives of p(Phi) and of
    function(p(Phi)) are differences of order four, exact for polynomials of degree 4. The relative
    error that they leave in the area of a sphere is 3e-10 on the octahedron itself, and below 1e-10
    from its first refinement on.

    Parameters
    ----------
    space : SurfaceSpace
    x : (N, 3) float array
        Nodes near Γ.
    closest : callable
        p: closest points on Γ, (n, 3), of points, (n, 3).
    w : (N, m) float array
        Nodal values of m functions.
    function : callable
        Values, (n, m), of m functions at points, (n, 3), of Γ.
    exactness : int, optional
        Degree of the quadrature; 2k + 2 if None, since the difference behaves like a polynomial
        of degree k + 1.

    Returns
    -------
    (m,) float array, (m,) float array

    Raises
    ------
    TypeError, ValueError
        If `space` is no SurfaceSpace, x, w or what `closest` or `function` return are not real
        numbers of the stated shape, or `exactness` is not an integer >= 0.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 2), 2, ec.to_unit_sphere)
    >>> x1 = space.nodes[:, :1]
    >>> squares, gradients = squared_differences(
    ...     space, space.nodes, ec.to_unit_sphere, x1, lambda y: 0 * y[:, :1]
    ... )
    >>> print(np.round([squares[0] / (4 * np.pi / 3), gradients[0] / (8 * np.pi / 3)], 4))
    [0.9993 0.9993]
    """
    check_space(space)
    degree, n = space.degree, len(space.nodes)
    rule = triangle_rule(2 * degree + 2 if exactness is None else exactness)
    nodes = real_array("x", x, (n, 3))[space.cells]
    local = real_array("w", w, (n, "m"))[space.cells]
    m = local.shape[2]

    def on_surface(points: Array) -> tuple[Array, Array]:
        """Closest points and the function there, for points of the reference triangle."""
        near = (tabulate(degree, points).values @ nodes).reshape(-1, 3)
        # Copies: the next call may write into the array that this one returns.
        y = np.array(real_array("values of closest", closest(near), near.shape))
        f = np.array(real_array("values of function", function(y.copy()), (len(y), m)))
        shape = (len(nodes), len(points), -1)
        return y.reshape(shape), f.reshape(shape)

    def derivatives(direction: Array) -> list[Array]:
        """Of the closest points and of the function there, by differences."""
        samples = [on_surface(rule.points + n * DISTANCE * direction) for n, _ in STENCIL]
        weights = [weight / DISTANCE for _, weight in STENCIL]
        return [np.tensordot(weights, parts, 1) for parts in zip(*samples, strict=True)]

    basis = tabulate(degree, rule.points)
    error = basis.values @ local - on_surface(rule.points)[1]
    (t1, f1), (t2, f2) = (derivatives(direction) for direction in np.eye(2))
    e1, e2 = (d @ local - f for d, f in zip(basis.derivatives, (f1, f2), strict=True))

    # First fundamental form I = (E, F; F, G) of the lifted element, s = sqrt(det I). The squared
    # gradient on Γ is e^T I^{-1} e, which `gradients` has times s^2.
    E, F, G = ((a * b).sum(axis=2) for a, b in ((t1, t1), (t1, t2), (t2, t2)))
    s = np.sqrt(E * G - F * F)
    gradients = (G[..., None] * e1 - 2 * F[..., None] * e2) * e1 + E[..., None] * e2 * e2
    return (
        np.einsum("q,tq,tqm->m", rule.weights, s, error**2),
        np.einsum("q,tq,tqm->m", rule.weights, 1 / s, gradients),
    )
