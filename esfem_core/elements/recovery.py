"""Finite element functions from values at quadrature points, such as those of a discrete normal.

The textbook's mean curvature is M^{-1} A x, from the identity -lap x = H nu. For k = 1 it converges
weakly, but its nodal values need not: on spheres from an icosahedron they are 34 % too large at the
twelve vertices with five triangles, on however fine a mesh. What converges at each node is
:func:`normal_and_curvature`.
"""

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from esfem_core.checks import Array, real_array
from esfem_core.elements.space import SurfaceSpace
from esfem_core.elements.surface import Surface, check_is_surface
from esfem_core.solvers import superlu
from esfem_core.surfaces import components, normals_of, smooth

__all__ = ["Smoothing", "nodal_average", "normal_and_curvature", "smoothed", "smoothed_divergence"]

LENGTH = 0.2  # squared length of smoothing, in squared sides of an element
FLAT = 1e-2  # area over squared sides, doubled: below it a smooth surface may not be found
SWEEPS = 3


def nodal_average(at: Surface, values: ArrayLike) -> Array:
    """A finite element function close to values at the quadrature points; no system is solved.

    On each element it is their least squares fit by a polynomial of degree k, and at a node the
    mean over the elements that share it, weighted by their areas. Values of a finite element
    function are kept exactly, those of a smooth function to an order of k + 1 in L2 and k in H1.

    Parameters
    ----------
    at : Surface
    values : (T, Q, ...) float array

    Returns
    -------
    (N, ...) float array

    Raises
    ------
    ValueError, TypeError
        If `at` is no surface, or `values` has the wrong shape or is not real.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
    >>> at = ec.Surface(space, space.nodes, space.nodes[:, 2])
    >>> bool(np.allclose(nodal_average(at, at.u), space.nodes[:, 2], rtol=0, atol=1e-14))
    True
    """
    check_is_surface(at)
    space = at.space
    values = real_array("values", values, (*at.density.shape, "..."))
    basis, weights = space.tables.values, space.rule.weights
    fit = np.linalg.solve(basis.T * weights @ basis, basis.T * weights)  # (n, Q)
    area = at.density @ weights
    by_point = values.reshape(*values.shape[:2], -1).transpose(2, 1, 0)  # (m, Q, T)
    total = space.sum_loads(area * (fit @ by_point), values.shape[2:])
    share = space.sum_loads(np.tile(area, (1, len(fit), 1)), ())
    average: Array = (total.T / share).T
    return average


def smoothed(at: Surface, values: ArrayLike) -> Array:
    r"""A smooth finite element function close to rough values at the quadrature points.

    Normals of an interpolated surface of degree k = 2 have an error of order 2 that changes its
    sign within each element. With h the mean side of the elements of a component,

    .. math:: I - (I - S)^3, \qquad S = (M + c h^2 A)^{-1} M,

    takes most of it away and itself has an error of order 6, on a closed surface; at a boundary,
    where it takes the derivative across for zero, one of order 1. Details of a component that are
    much smaller than its h are lost: the curvature of an ellipsoid with the axes 6, 1 and 1, of
    5,120 stretched triangles, is off by 14 % at its tips.

    Parameters
    ----------
    at : Surface
    values : (T, Q, ...) float array

    Returns
    -------
    (N, ...) float array

    Raises
    ------
    ValueError, TypeError
        If `at` is no surface, or `values` has the wrong shape or is not real.

    Examples
    --------
    Normals of a torus from its quadratic interpolant:

    >>> import esfem_core as ec
    >>> torus = ec.exact_surfaces.Torus()
    >>> space = ec.SurfaceSpace(ec.torus(n=24, m=12), 2, torus.closest)
    >>> at, exact = ec.Surface(space, space.nodes), torus.near(space.nodes).normal
    >>> errors = [f(at, at.normal) - exact for f in (nodal_average, smoothed)]
    >>> print("{:.1e} {:.1e}".format(*(np.sqrt(np.sum(e * (at.M @ e))) for e in errors)))
    2.4e-02 6.6e-03
    """
    check_is_surface(at)
    return Smoothing(at)(at.load(values))


def smoothed_divergence(at: Surface, normal: ArrayLike) -> Array:
    """The mean curvature H = div nu, the sum of the principal ones, of nodal normals.

    Parameters
    ----------
    at : Surface
        At a boundary, if it has one, the error is of order 1 as that of :func:`smoothed`.
    normal : (N, 3) float array

    Returns
    -------
    (N,) float array

    Raises
    ------
    ValueError, TypeError
        If `at` is no surface, or `normal` has the wrong shape or is not real.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), 2, ec.to_unit_sphere)
    >>> H = smoothed_divergence(ec.Surface(space, space.nodes), space.nodes)
    >>> print(f"{H.min():.3f} {H.max():.3f}")
    2.000 2.000
    """
    check_is_surface(at)
    gradient = at.space.gradient(at.x, real_array("normal", normal, at.x.shape))
    return smoothed(at, np.trace(gradient, axis1=-2, axis2=-1))


def normal_and_curvature(at: Surface) -> tuple[Array, Array]:
    """Nodal unit normals and mean curvatures of the surface that a discrete one is near.

    The normal of the elements, smoothed, and the divergence of that, smoothed. Flat triangles
    know no curvature: for k = 1 both are those of elements of degree 2 on the smooth surface
    through the vertices, :func:`esfem_core.smooth`, taken at the vertices.

    The curvature's error in L2 has an order of about 2 on regular refinements, more on those of an
    icosahedron, and for k = 1 and 2 about 1 on irregular triangles. It then mostly is far below
    that of M^{-1} A x, but on coarse meshes, of an ellipsoid of 320 triangles with k = 2, say, it
    can be above.

    Parameters
    ----------
    at : Surface
        Closed.

    Returns
    -------
    (N, 3) float array, (N,) float array

    Raises
    ------
    TypeError
        If `at` is no surface.
    ValueError
        If the surface has a boundary: there the curvature would not converge; if its triangles are
        so flat that no smooth surface through their vertices is found.

    Examples
    --------
    The vertices of a sphere where five triangles meet, of flat triangles:

    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 3))
    >>> at = ec.Surface(space, space.nodes)
    >>> five = np.bincount(space.cells.ravel()) == 5
    >>> textbook = np.linalg.norm(superlu(at.M).solve(at.A @ at.x), axis=1)
    >>> print(f"{textbook[five].mean():.3f} {normal_and_curvature(at)[1][five].mean():.3f}")
    2.682 2.002
    """
    check_is_surface(at)
    if len(at.space.boundary_nodes):
        raise ValueError(
            "at must be a closed surface, but has a boundary: near it the curvature of smoothed "
            "normals does not converge"
        )
    n = len(at.x)
    if at.space.degree == 1:
        curved = _curved(trimesh.Trimesh(at.x, at.space.cells, process=False))
        at = Surface(curved, curved.nodes)
    normal = smoothed(at, at.normal)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return normal[:n], smoothed_divergence(at, normal)[:n]


def _curved(tri: trimesh.Trimesh) -> SurfaceSpace:
    """Elements on the smooth surface; triangles are refused that are too flat for one."""
    edges = np.roll(tri.triangles, -1, axis=1) - tri.triangles
    double_area = np.linalg.norm(normals_of(tri.vertices, tri.faces), axis=1)
    shape = double_area / (edges**2).sum((1, 2))
    t = int(np.argmin(shape))
    try:
        return SurfaceSpace(tri, 2, smooth(tri))
    except ValueError as error:
        if shape[t] > FLAT:
            raise
        raise ValueError(
            "the mean curvature at the start cannot be had from triangles so flat as triangle "
            f"{t}, near {tri.triangles[t, 0].round(6).tolist()}: give the law normal= and "
            "curvature=, those of an exact surface, or make better triangles"
        ) from error


class Smoothing:
    """The smoothing of :func:`smoothed` for many functions on one surface.

    Parameters
    ----------
    at : Surface
    """

    def __init__(self, at: Surface) -> None:
        component = components(at.space.cells[:, :3])
        area = np.bincount(component, at.density @ at.space.rule.weights)
        square = 4 / np.sqrt(3) * (area / np.bincount(component))[component]  # h^2
        weight = np.broadcast_to(LENGTH * square[:, None], at.density.shape)
        self._M = at.M
        self._factor = superlu(at.matrix(1.0, weight), order=at.space.elimination_order)

    def __call__(self, load: Array) -> Array:
        """The smooth function, (N, ...), of a load vector int values phi_j, (N, ...)."""
        b = load.reshape(len(load), -1)
        w = np.zeros_like(b)
        for _ in range(SWEEPS):
            w += self._factor.solve(b - self._M @ w)
        return w.reshape(load.shape)
