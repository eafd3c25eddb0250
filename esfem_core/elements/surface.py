"""One surface and the functions on it: what sources, coefficients and velocity laws see.

In (2.19)-(2.21) of [N] everything is assembled on one surface Γ_h[x~], with one set of functions.
A :class:`Surface` is that surface. What is asked of it is computed on first use and kept until the
surface is let go; a time scheme tells it what the step before asked for, so that all of that comes
out of one pass over the elements.
"""

from collections.abc import Mapping, Set
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array

from esfem_core.checks import Array, frozen, mapping, number, object_of, real_array, shown
from esfem_core.elements.integrals import Metric
from esfem_core.elements.scatter import combination
from esfem_core.elements.space import SurfaceSpace

__all__ = ["Surface", "check_tensors"]

SYMMETRY = 1e-10  # largest asymmetry of a tensor, relative to its largest entry
CURVATURE = "; esfem_core.elements.normal_and_curvature(at)[1] is the mean curvature, nodal"

Key = tuple[str, str]
MATRICES, NORMAL, POINTS, DENSITY = ((name, "") for name in ("matrices", "normal", "points", "s"))


class Surface:
    """Γ_h[x], with finite element functions on it.

    Parameters
    ----------
    space : SurfaceSpace
    x : (N, 3) float array
        Node positions.
    fields : mapping of str to (N, ...) float array, or one such array, optional
        Nodal values of functions by name; an array is the function "u".
    t : float
        The time.
    expected : set, optional
        What will be asked for, as ``used`` of another surface says it.

    Attributes
    ----------
    space, x, t
        As given; x read-only, like all arrays here.
    fields : mapping of str to (N, ...) float array
    M, A : (N, N) CSR arrays
        Mass and stiffness matrix on Γ_h[x].
    points, normal : (T, Q, 3) float arrays
        Quadrature points and the unit outward normals there.
    density : (T, Q) float array
        Area on Γ_h[x] per area of the reference triangle.
    u, grad_u : (T, Q, ...) and (T, Q, ..., 3) float arrays
        Values and surface gradient of the function "u"; ``at["name"]`` and ``at.grad("name")`` are
        those of any.
    used : set
        What has been asked for so far.

    Raises
    ------
    ValueError, TypeError
        If an array has the wrong shape or is not real.
    KeyError
        If a function is asked for that is not given.
    DegenerateElementError
        On first use of something, if an element has no area or a position is not finite.

    Examples
    --------
    Area, volume and an energy of a function:

    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 4), 2, ec.to_unit_sphere)
    >>> at = ec.Surface(space, space.nodes, space.nodes[:, 2])
    >>> print(f"{at.integral(1) / (4 * np.pi):.4f}")
    1.0000
    >>> print(f"{at.integral((at.points * at.normal).sum(-1)) / (4 * np.pi):.4f}")
    1.0000
    >>> print(f"{at.integral((at.grad_u**2).sum(-1)) / (8 * np.pi / 3):.4f}")
    1.0000
    """

    def __init__(
        self,
        space: SurfaceSpace,
        x: Array,
        fields: Mapping[str, Array] | Array | None = None,
        t: float = 0.0,
        *,
        expected: Set[Key] = frozenset(),
    ) -> None:
        object_of("space", space, SurfaceSpace)
        self.space, self.t = space, number("t", t)
        self.x = frozen(real_array("x", x, space.nodes.shape))
        if fields is None:
            fields = {}
        elif not isinstance(fields, Mapping):
            fields = {"u": fields}
        mapping("fields", fields, "nodal values")
        shape = (len(space.nodes), "...")
        self.fields: Mapping[str, Array] = MappingProxyType(
            {name: frozen(real_array(name, values, shape)) for name, values in fields.items()}
        )
        self.used: set[Key] = set()
        self._expected = expected
        self._known: dict[Key, Any] = {}

    def __repr__(self) -> str:
        names = ", ".join(
            f"{name} {values.shape[1:] or ''}".strip() for name, values in self.fields.items()
        )
        return f"Surface(t={self.t:g}, nodes={len(self.x)}, fields: {names or 'none'})"

    def __getstate__(self) -> dict[str, Any]:
        # A read-only view cannot be copied, and what is known can be computed again.
        return {**vars(self), "fields": dict(self.fields), "_known": {}}

    def __setstate__(self, state: dict[str, Any]) -> None:
        fields = {name: frozen(values) for name, values in state["fields"].items()}
        vars(self).update(state, x=frozen(state["x"]), fields=MappingProxyType(fields))

    @property
    def M(self) -> csr_array:
        """Mass matrix."""
        matrix: csr_array = self._get(MATRICES)[0]
        return matrix

    @property
    def A(self) -> csr_array:
        """Stiffness matrix."""
        matrix: csr_array = self._get(MATRICES)[1]
        return matrix

    @property
    def points(self) -> Array:
        """Quadrature points, (T, Q, 3)."""
        return self._array(POINTS)

    @property
    def normal(self) -> Array:
        """Unit outward normals, (T, Q, 3)."""
        return self._array(NORMAL)

    @property
    def density(self) -> Array:
        """Area density, (T, Q)."""
        return self._array(DENSITY)

    @property
    def u(self) -> Array:
        """Values of "u", (T, Q, ...)."""
        return self["u"]

    @property
    def grad_u(self) -> Array:
        """Surface gradient of "u", (T, Q, ..., 3)."""
        return self.grad("u")

    def __getitem__(self, name: str) -> Array:
        """Values of a function at the quadrature points, (T, Q, ...).

        Raises
        ------
        TypeError, KeyError
            As of :meth:`grad`.
        """
        return self._function("value", name)

    def grad(self, name: str) -> Array:
        """Surface gradient of a function at the quadrature points, (T, Q, ..., 3).

        The last index is that of the derivative.

        Raises
        ------
        TypeError, KeyError
            If `name` is no string, or no function of this surface.
        """
        return self._function("gradient", name)

    def integral(self, values: ArrayLike) -> Array:
        """Integrals over Γ_h[x] of values (T, Q, ...), or of a constant: (...).

        See :meth:`SurfaceSpace.integrate`.

        Raises
        ------
        TypeError, ValueError
            If `values` has the wrong shape or is not real.
        """
        return self.space.integral_with(self.density, values)

    def mean(self, values: ArrayLike) -> Array:
        """Mean values over Γ_h[x], (...).

        Raises
        ------
        TypeError, ValueError
            As of :meth:`integral`.
        """
        mean: Array = self.integral(values) / self.integral(1.0)
        return mean

    def load(self, values: ArrayLike | None, flux: ArrayLike | None = None) -> Array:
        r"""Load vector of values and a flux.

        .. math:: b_j = \int \text{values}\; \varphi_j + \text{flux} \cdot \nabla\varphi_j

        Parameters
        ----------
        values : float or (T, Q, ...) float array, or None for zero
            At the quadrature points; a number stands for a constant.
        flux : (T, Q, ..., 3) float array, optional
            Only its tangential part counts.

        Returns
        -------
        (N, ...) float array

        Raises
        ------
        ValueError, TypeError
            If an array has the wrong shape or is not real.

        Examples
        --------
        The weak form of the Laplace-Beltrami operator:

        >>> import esfem_core as ec
        >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
        >>> at = ec.Surface(space, space.nodes, space.nodes[:, 2])
        >>> b = at.load(None, flux=at.grad_u)
        >>> bool(np.allclose(b, at.A @ space.nodes[:, 2], rtol=0, atol=1e-14))
        True
        """
        points = self.density.shape
        along = None if flux is None else real_array("flux", flux, (*points, "..."))
        at_points = real_array("values", 0.0 if values is None else values, ("...",))
        if at_points.ndim == 0:
            number("values", at_points)
            trailing = () if along is None else along.shape[2:-1]
            at_points = np.full((*points, *trailing), at_points)
        at_points = real_array("values", at_points, (*points, "..."))
        b = self.space.load_with(self.density, at_points)
        if along is not None:
            b += self._flux_load(real_array("flux", along, (*at_points.shape, 3)))
        return b

    def matrix(self, mass: ArrayLike = 0.0, stiffness: ArrayLike = 0.0) -> csr_array:
        r"""Matrix of mass and stiffness with weights.

        .. math::

            K_{ij} = \int_{\Gamma_h[x]} \text{mass}\; \varphi_i \varphi_j
            + \nabla\varphi_i \cdot \text{stiffness}\, \nabla\varphi_j

        Parameters
        ----------
        mass : float or (T, Q) float array
            Weight at the quadrature points.
        stiffness : float, or (T, Q) or (T, Q, 3, 3) float array
            Weight, or symmetric tensor.

        Returns
        -------
        (N, N) CSR array
            In the pattern of M and A.

        Raises
        ------
        ValueError, TypeError
            If an array has the wrong shape or is not real, or a tensor not symmetric.

        Examples
        --------
        >>> import esfem_core as ec
        >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
        >>> at = ec.Surface(space, space.nodes)
        >>> K = at.matrix(mass=2.0, stiffness=np.full(at.density.shape, 3.0))
        >>> bool(abs(K - (2 * at.M + 3 * at.A)).max() < 1e-14)
        True
        """
        if np.isscalar(mass) and np.isscalar(stiffness):
            a, b = number("mass", mass), number("stiffness", stiffness)
            return combination(a, self.M, b, self.A)
        mass = real_array("mass", mass, ("...",))
        stiffness = real_array("stiffness", stiffness, ("...",))
        points = self.density.shape
        weight = _weight("mass", mass, points, tensors=False)
        tensor = _weight("stiffness", stiffness, points, tensors=True)
        tables = self.space.tables

        def entries(c: slice, g: Metric) -> tuple[Array]:
            return tables.weighted(g, _part(weight, c), _part(tensor, c))

        [matrix] = self.space.assemble(self.x, entries, 1)
        return matrix

    def _flux_load(self, flux: Array) -> Array:
        n_cells, n_points, *trailing, _ = flux.shape
        by_point = flux.reshape(n_cells, n_points, -1, 3).transpose(2, 3, 1, 0)  # (m, 3, Q, T)
        entries = np.empty((len(by_point), self.space.cells.shape[1], n_cells))

        def fill(c: slice, g: Metric) -> None:
            entries[..., c] = self.space.tables.flux_load(g, by_point[..., c])

        self.space.by_chunks(self.x, fill)
        return self.space.sum_loads(entries, tuple(trailing))

    def _function(self, kind: str, name: str) -> Array:
        _check_name(name)
        if name not in self.fields:
            known = ", ".join(map(repr, self.fields)) or "none"
            raise KeyError(
                f"there is no function {name!r} on this surface, only {known}"
                f"{CURVATURE * (name == 'H')}"
            )
        return self._array((kind, name))

    def _array(self, key: Key) -> Array:
        array: Array = self._get(key)
        return array

    def _get(self, key: Key) -> Any:
        self.used.add(key)
        if key not in self._known:
            self._compute({key} | {k for k in self._expected if k not in self._known})
        return self._known[key]

    def _compute(self, keys: set[Key]) -> None:
        """Everything that is asked for, in one pass over the elements."""
        space, tables = self.space, self.space.tables
        for kind, name in keys:
            if kind == "value" and name in self.fields:
                self._known[kind, name] = _read_only(space.evaluate(self.fields[name]))
        names = [name for kind, name in keys if kind == "gradient" and name in self.fields]
        local = [space.local(self.fields[name]) for name in names]
        if not names and not keys & {MATRICES, NORMAL, POINTS, DENSITY}:
            return
        size = len(space.rule.weights), len(space.cells)
        density = np.empty(size)
        normal = np.empty((3, *size)) if NORMAL in keys else None
        points = np.empty((3, *size)) if POINTS in keys else None
        gradients = [np.empty((len(u), 3, *size)) for u in local]

        def entries(c: slice, g: Metric) -> tuple[Array, ...]:
            density[:, c] = g.s
            for gradient, u in zip(gradients, local, strict=True):
                gradient[..., c] = tables.gradient(g, u[:, :, c])
            if normal is not None:
                normal[..., c] = g.normals()
            if points is not None:
                points[..., c] = tables.values @ g.nodes
            return tables.mass_stiffness(g) if MATRICES in keys else ()

        matrices = space.assemble(self.x, entries, 2 if MATRICES in keys else 0)
        if matrices:
            for matrix in matrices:
                matrix.data.setflags(write=False)
            self._known[MATRICES] = matrices
        self._known[DENSITY] = _read_only(density.T)
        for key, array in ((NORMAL, normal), (POINTS, points)):
            if array is not None:
                self._known[key] = _read_only(array.transpose(2, 1, 0))
        for name, gradient in zip(names, gradients, strict=True):
            trailing = (*self.fields[name].shape[1:], 3)
            first = space.points_first(gradient.reshape(-1, *size), trailing)
            self._known["gradient", name] = _read_only(first)


def _weight(
    name: str, values: ArrayLike, points: tuple[int, ...], *, tensors: bool
) -> Array | float:
    """A coefficient with the elements last: a number, (Q, T) or (3, 3, Q, T)."""
    if np.ndim(values) == 0:
        return number(name, values)
    if tensors and np.ndim(values) == 4:
        tensor = real_array(name, values, (*points, 3, 3))
        check_tensors(name, tensor)
        return tensor.transpose(2, 3, 1, 0)
    return real_array(name, values, points).T


def _check_name(name: object) -> None:
    """Refuse what is no name of a function, such as what takes coordinates of points."""
    if not isinstance(name, str):
        raise TypeError(
            f"name must be a string, got {shown(name)}: a Surface is no array of points; "
            "at.points[..., 0] has the first coordinates of the quadrature points, (T, Q), "
            'at["u"] the values of u there, and at.x are the nodes, (N, 3)'
        )


def check_is_surface(at: Surface) -> None:
    """Refuse what is no surface.

    Examples
    --------
    >>> check_is_surface(None)
    Traceback (most recent call last):
        ...
    TypeError: at must be a Surface, got None
    """
    object_of("at", at, Surface)


def check_tensors(name: str, tensor: Array) -> None:
    """Refuse tensors, (..., 3, 3), that are not symmetric up to rounding.

    Examples
    --------
    >>> check_tensors("D", np.array([[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]))
    Traceback (most recent call last):
        ...
    ValueError: D must be symmetric, but entries (i, j) and (j, i) of the tensors differ by up to...
    """
    skew = float(np.abs(tensor - np.swapaxes(tensor, -2, -1)).max(initial=0.0))
    if skew > SYMMETRY * float(np.abs(tensor).max(initial=0.0)):
        raise ValueError(
            f"{name} must be symmetric, but entries (i, j) and (j, i) of the tensors differ by up "
            f"to {skew:.3g}"
        )


def _part(weight: Array | float, c: slice) -> Array | float:
    return weight[..., c] if isinstance(weight, np.ndarray) else weight


def _read_only(array: Array) -> Array:
    """A view that cannot be written to; the array itself stays as it is."""
    view = array.view()
    view.setflags(write=False)
    return view
