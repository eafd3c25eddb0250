r"""The bilinear forms m, a, q of [N] 5.2 and [LMV] 5 on discrete and on exact surfaces.

On Γ_h[x], for finite element functions with nodal vectors w, z and a velocity v

.. math::

    m(w, z) = \int_{\Gamma_h} w z = w^T M z, \qquad
    a(w, z) = \int_{\Gamma_h} \nabla w \cdot \nabla z = w^T A z, \qquad
    q(v; w, z) = \int_{\Gamma_h} (\nabla \cdot v)\, w z.

On the exact surface Γ they act on lifts, w^l(p(y)) = w(y) with the closest-point map p. The
integrals are pulled back to Γ_h[x], where Γ is only another weight: the area ratio for m, a
tensor for a. So each form here is a matrix that :func:`mass` or :func:`stiffness` assembles.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigh
from scipy.sparse import csc_array, csr_array, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from esfem_core.checks import Array, finite_array, flag, object_of, shown
from esfem_core.elements import Surface, SurfaceSpace, check_tensors
from esfem_core.errors import square_matrix
from esfem_core.surfaces.exact_surfaces import ExactSurface, Near

__all__ = [
    "Lift",
    "check_definite",
    "check_surface",
    "check_symmetric",
    "deformation",
    "divergence",
    "lift",
    "mass",
    "mass_rate",
    "near_of",
    "relative_norm",
    "stiffness",
    "stiffness_rate",
]

TOLERANCE = 1e-9  # relative, of the eigenvalue that is iterated for
ROUNDING = 1e-10  # relative to the largest entry; a form may be a small difference of norms
PIVOT = 1e-12  # relative to the diagonal; smaller ones are what rounding leaves of zero
DENSE = 1000  # up to this size all eigenvalues cost less than the iteration for one


def mass(space: SurfaceSpace, x: Array, weight: ArrayLike | None = None) -> csr_array:
    r"""Matrix of m with a weight.

    .. math:: M_{ij} = \int_{\Gamma_h[x]} \text{weight}\; \varphi_i \varphi_j

    Parameters
    ----------
    space : SurfaceSpace
    x : (N, 3) float array
        Node positions.
    weight : (T, Q) float array, optional
        At the quadrature points; 1, which gives the mass matrix of m, if None. With
        ``lift(space, x, surface).ratio`` it is the matrix of m on the exact surface.

    Returns
    -------
    (N, N) CSR array

    Raises
    ------
    TypeError, ValueError
        If an argument has the wrong shape or is not finite.
    esfem_core.DegenerateElementError
        If an element has no area or a position is not finite.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), 2, ec.to_unit_sphere)
    >>> M = mass(space, space.nodes, space.quadrature_points(space.nodes)[..., 2] ** 2)
    >>> print(f"{M.sum() / (4 * np.pi / 3):.3f}")
    1.000
    """
    at = Surface(space, x)
    if weight is None:
        return space.mass(x)
    return at.matrix(finite_array("weight", weight, at.density.shape))


def stiffness(space: SurfaceSpace, x: Array, tensor: ArrayLike | None = None) -> csr_array:
    r"""Matrix of a with a tensor.

    .. math::

        A_{ij} = \int_{\Gamma_h[x]} \nabla\varphi_i \cdot \text{tensor}\, \nabla\varphi_j

    Parameters
    ----------
    space : SurfaceSpace
    x : (N, 3) float array
        Node positions.
    tensor : (T, Q, 3, 3) float array, optional
        Symmetric, at the quadrature points; the identity, which gives the stiffness matrix of a,
        if None. With ``lift(space, x, surface).tensor`` it is the matrix of a on the exact surface.

    Returns
    -------
    (N, N) CSR array

    Raises
    ------
    TypeError, ValueError
        If an argument has the wrong shape or is not finite, or a tensor is not symmetric.
    esfem_core.DegenerateElementError
        If an element has no area or a position is not finite.
    """
    at = Surface(space, x)
    if tensor is None:
        return space.mass_stiffness(x)[1]
    tensor = finite_array("tensor", tensor, (*at.density.shape, 3, 3))
    check_tensors("tensor", tensor)
    return at.matrix(stiffness=tensor)


def divergence(space: SurfaceSpace, x: Array, v: ArrayLike) -> Array:
    """Surface divergence of the field with nodal values v on Γ_h[x], at the quadrature points.

    Parameters
    ----------
    space : SurfaceSpace
    x, v : (N, 3) float arrays
        Node positions and nodal velocities.

    Returns
    -------
    (T, Q) float array

    Raises
    ------
    TypeError, ValueError
        If an argument has the wrong shape or is not finite.
    esfem_core.DegenerateElementError
        If an element has no area or a position is not finite.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
    >>> x = space.nodes
    >>> div = divergence(space, x, 0.5 * x)
    >>> bool(np.allclose(div, 1, rtol=0, atol=1e-12))
    True
    """
    return np.asarray(np.trace(_velocity_gradient(space, x, v), axis1=-2, axis2=-1))


def deformation(space: SurfaceSpace, x: Array, v: ArrayLike) -> Array:
    r"""The matrix D(v) by which a motion with velocity v changes the Dirichlet integral.

    .. math:: D(v) = \operatorname{tr}(E)\, I - (E + E^T), \qquad E = \nabla_{\Gamma_h} v

    [N] Lemma 3.1 (i); see :func:`stiffness_rate`.

    Parameters
    ----------
    space, x, v
        As for :func:`divergence`.

    Returns
    -------
    (T, Q, 3, 3) float array

    Raises
    ------
    TypeError, ValueError
        As for :func:`divergence`.
    esfem_core.DegenerateElementError
        As for :func:`divergence`.
    """
    E = _velocity_gradient(space, x, v)
    trace = np.trace(E, axis1=-2, axis2=-1)[..., None, None]
    return np.asarray(trace * np.eye(3) - E - np.swapaxes(E, -1, -2))


def _velocity_gradient(space: SurfaceSpace, x: Array, v: ArrayLike) -> Array:
    object_of("space", space, SurfaceSpace)
    return space.gradient(x, finite_array("v", v, space.nodes.shape))


def mass_rate(space: SurfaceSpace, x: Array, v: ArrayLike) -> csr_array:
    r"""Matrix of q ([N] 5.2), the rate of change of the mass matrix.

    [N] Lemma 3.1 (i): if the nodes move with velocities v, then

    .. math::

        \frac{\mathrm d}{\mathrm dt}\, w^T M(x)\, z = q(x; v; w, z)
        = \int_{\Gamma_h[x]} (\nabla \cdot v)\, w z.

    Parameters
    ----------
    space, x, v
        As for :func:`divergence`.

    Returns
    -------
    (N, N) CSR array

    Raises
    ------
    TypeError, ValueError
        As for :func:`divergence`.
    esfem_core.DegenerateElementError
        As for :func:`divergence`.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
    >>> growth = mass_rate(space, space.nodes, 0.5 * space.nodes)
    >>> bool(abs(growth - mass(space, space.nodes)).max() < 1e-15)
    True
    """
    return mass(space, x, divergence(space, x, v))


def stiffness_rate(space: SurfaceSpace, x: Array, v: ArrayLike) -> csr_array:
    r"""Matrix of b, the rate of change of the stiffness matrix.

    [N] Lemma 3.1 (i): if the nodes move with velocities v, then

    .. math::

        \frac{\mathrm d}{\mathrm dt}\, w^T A(x)\, z = b(x; v; w, z)
        = \int_{\Gamma_h[x]} \nabla w \cdot D(v)\, \nabla z

    with D(v) from :func:`deformation`.

    Parameters
    ----------
    space, x, v
        As for :func:`divergence`.

    Returns
    -------
    (N, N) CSR array

    Raises
    ------
    TypeError, ValueError
        As for :func:`divergence`.
    esfem_core.DegenerateElementError
        As for :func:`divergence`.

    Examples
    --------
    The Dirichlet integral does not change when a surface is scaled:

    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
    >>> bool(abs(stiffness_rate(space, space.nodes, space.nodes)).max() < 1e-13)
    True
    """
    return stiffness(space, x, deformation(space, x, v))


class Lift(NamedTuple):
    """The closest-point map from Γ_h[x] to an exact surface Γ at the quadrature points.

    Attributes
    ----------
    points : (T, Q, 3) float array
        Closest points p.
    normal : (T, Q, 3) float array
        Normal of Γ at p.
    distance : (T, Q) float array
        Signed distance of the quadrature points from Γ.
    ratio : (T, Q) float array
        Area on Γ per area on Γ_h; [LMV]'s δ_h. The integral over Γ of a function f is that of
        ``ratio * f(points)`` over Γ_h.
    gradient : (T, Q, 3, 3) float array
        Matrix that takes the gradient of w on Γ_h to the gradient of its lift on Γ; the inverse
        of [LMV]'s B_h between the tangent planes, see (5.7).
    """

    points: Array
    normal: Array
    distance: Array
    ratio: Array
    gradient: Array

    @property
    def tensor(self) -> Array:
        """(T, Q, 3, 3) tensor of a on Γ, pulled back to Γ_h."""
        return self.ratio[..., None, None] * (np.swapaxes(self.gradient, 2, 3) @ self.gradient)


def lift(space: SurfaceSpace, x: Array, surface: ExactSurface) -> Lift:
    r"""Compute the closest-point map from Γ_h[x] to an exact surface, and its differential.

    With d the distance, ν and ν_h the normals and W the Weingarten map at p,

    .. math::

        \text{ratio} = \frac{\nu_h \cdot \nu}{\det(I + d W)}, \qquad
        \text{gradient} = (I + d W) \Bigl( I - \frac{\nu_h \nu^T}{\nu_h \cdot \nu} \Bigr).

    Parameters
    ----------
    space : SurfaceSpace
    x : (N, 3) float array
        Node positions.
    surface : ExactSurface

    Returns
    -------
    Lift

    Raises
    ------
    TypeError, ValueError
        If a quadrature point has no unique closest point, Γ_h[x] is not oriented like the surface,
        or a surface of the reader's own does not return a :class:`Near` of finite arrays.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere, exactness=10)
    >>> onto = lift(space, space.nodes, ec.exact_surfaces.Sphere())
    >>> print(f"{mass(space, space.nodes, onto.ratio).sum() / (4 * np.pi):.8f}")
    1.00000000
    """
    object_of("space", space, SurfaceSpace)
    points = space.quadrature_points(x)
    near = near_of(surface, points)
    normal_h = space.normals(x)
    cosine = np.sum(normal_h * near.normal, axis=-1)
    stretch = np.eye(3) + near.distance[..., None, None] * near.weingarten
    if not (least := cosine.min()) > 0:
        raise ValueError(
            "surface must be oriented as the space at x is, but at "
            f"{points[cosine == least][0].round(6).tolist()} the cosine of their normals is "
            f"{least:.3g}"
        )
    oblique = normal_h[..., :, None] * near.normal[..., None, :] / cosine[..., None, None]
    return Lift(
        near.points,
        near.normal,
        near.distance,
        cosine / np.linalg.det(stretch),
        stretch @ (np.eye(3) - oblique),
    )


def near_of(surface: ExactSurface, points: Array) -> Near:
    """What a surface says of points (..., 3), looked at: a reader's own may say anything.

    Raises
    ------
    TypeError, ValueError
        If a point has no unique closest point, or a surface of the reader's own does not return a
        :class:`Near` of finite arrays.

    Examples
    --------
    >>> from esfem_core.surfaces.exact_surfaces import Sphere
    >>> near_of(Sphere(), np.array([[0.0, 0.0, 3.0]])).distance
    array([2.])
    """
    check_surface(surface)
    points = finite_array("points", points, ("...", 3))
    near = object_of("surface.near(x)", surface.near(points), Near)
    shape = points.shape
    shapes = {"points": shape, "distance": shape[:-1], "normal": shape, "weingarten": (*shape, 3)}
    return Near(
        *(
            finite_array(f"surface.near(x).{name}", getattr(near, name), wanted)
            for name, wanted in shapes.items()
        )
    )


def relative_norm(form: csr_array, norm: csr_array, seminorm: bool = False) -> float:
    r"""Smallest c with ``|w^T form z| <= c |w| |z|`` for all w and z.

    It is the largest absolute value of the eigenvalues of ``form w = λ norm w``, with nine digits.

    Parameters
    ----------
    form : (N, N) sparse array
        Symmetric.
    norm : (N, N) sparse array
        Symmetric and positive definite: ``|w|^2 = w^T norm w``.
    seminorm : bool
        If True, `norm` vanishes on constants and is positive on all else, as a stiffness matrix of
        a connected surface is, and `form` vanishes on constants, too.

    Returns
    -------
    float

    Raises
    ------
    TypeError, ValueError
        If the shapes differ, a matrix is not symmetric, `norm` is not positive definite, or with
        ``seminorm=True`` one does not vanish on constants or `norm` vanishes on more than those.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    >>> M, A = space.mass_stiffness(space.nodes)
    >>> print(f"{relative_norm(-3 * M, M):.6f} {relative_norm(2 * A, A, seminorm=True):.6f}")
    3.000000 2.000000
    """
    form, norm = (
        square_matrix(name, given).astype(float) for name, given in (("form", form), ("norm", norm))
    )
    flag("seminorm", seminorm)
    if form.shape != norm.shape:
        raise ValueError(f"form and norm must have one shape, got {form.shape} and {norm.shape}")
    if form.shape[0] <= seminorm:
        raise ValueError(f"form must have {1 + seminorm} rows or more, got shape {form.shape}")
    rounding = ROUNDING * max(abs(form).max(), abs(norm).max())
    for name, matrix in (("form", form), ("norm", norm)):
        check_symmetric(name, matrix, rounding)
        if seminorm and abs(matrix.sum(axis=1)).max() > rounding:
            raise ValueError(f"with seminorm=True {name} must vanish on constants, but does not")
    if seminorm:  # constants make no difference: functions that vanish at the first node will do
        parts = connected_components(norm, directed=False)[0]
        if parts > 1:
            raise ValueError(
                "with seminorm=True norm must vanish on constants only, but vanishes on all that "
                f"are constant on each of {parts} components"
            )
        form, norm = form[1:, 1:], norm[1:, 1:]
    check_definite("norm", norm)
    if not abs(form).max() > 0:  # an eigenvalue solver would start from a vector that is zero
        return 0.0
    if form.shape[0] <= DENSE:
        values = eigh(form.toarray(), norm.toarray(), eigvals_only=True)
        return float(np.abs(values).max())
    inverse = LinearOperator(norm.shape, splu(norm.tocsc()).solve, dtype=float)
    start = np.random.default_rng(0).normal(size=form.shape[0])
    # The extreme eigenvalues are often close together: a wide subspace, no more digits than needed.
    values = eigsh(
        form,
        1,
        norm,
        which="LM",
        v0=start,
        ncv=60,
        tol=TOLERANCE,
        return_eigenvectors=False,
        Minv=inverse,
    )
    return float(abs(values[0]))


def check_surface(surface: ExactSurface) -> None:
    """Refuse what is no exact surface.

    Examples
    --------
    >>> check_surface("sphere")
    Traceback (most recent call last):
        ...
    TypeError: surface must be an ExactSurface, got 'sphere'
    """
    if not isinstance(surface, ExactSurface):
        raise TypeError(f"surface must be an ExactSurface, got {shown(surface)}")


def check_symmetric(name: str, matrix: csr_array, rounding: float | None = None) -> None:
    """Refuse what is no symmetric matrix, up to a rounding error of its entries.

    Examples
    --------
    >>> check_symmetric("K", csr_array(np.array([[1.0, 0.5], [0.0, 1.0]])))
    Traceback (most recent call last):
        ...
    ValueError: K must be symmetric, but is not
    """
    square_matrix(name, matrix)
    if rounding is None:
        rounding = ROUNDING * float(abs(matrix).max())
    if abs(matrix - matrix.T).max() > rounding:
        raise ValueError(f"{name} must be symmetric, but is not")


def check_definite(name: str, matrix: csr_array) -> None:
    """Refuse a symmetric matrix with a pivot that is not positive beyond rounding.

    Examples
    --------
    >>> check_definite("K", csr_array(np.array([[1.0, -1.0], [-1.0, 1.0]])))
    Traceback (most recent call last):
        ...
    ValueError: K must be positive definite, but has the pivot 0, relative to its diagonal
    """
    diagonal = square_matrix(name, matrix).diagonal()
    least = float(diagonal.min())
    if least > 0:
        root = diags_array(1 / np.sqrt(diagonal))
        scaled = csc_array(root @ matrix @ root)
        options = {"SymmetricMode": True}
        try:
            lu = splu(scaled, "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
            least = float(lu.U.diagonal().min())
        except RuntimeError:  # a pivot is exactly zero
            least = 0.0
    if not least > PIVOT:
        raise ValueError(
            f"{name} must be positive definite, but has the pivot {least:.3g}, relative to its "
            "diagonal"
        )
