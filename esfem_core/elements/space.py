"""The surface finite element space S_h[x] ([N] 2.8).

Topology never changes; geometry is an (N, 3) array x of node positions. Γ_h[x] is "the space,
at x", and every method that depends on the geometry takes x as its first argument.
"""

from collections.abc import Callable, Iterator
from functools import cached_property
from typing import NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.sparse import csr_array

from esfem_core.elements.integrals import ElementTables, Metric, chunks
from esfem_core.elements.lagrange import tabulate
from esfem_core.elements.numbering import number_cells, place_nodes
from esfem_core.elements.quadrature import triangle_rule
from esfem_core.elements.scatter import NodalSum, SparsePattern
from esfem_core.solvers import Fronts, dissect
from esfem_core.surfaces import check_triangulation

__all__ = ["Assembly", "SurfaceSpace"]

Array = NDArray[np.float64]


class Assembly(NamedTuple):
    """What a time step needs on Γ_h[x]; made by :meth:`SurfaceSpace.assemble`.

    Attributes
    ----------
    M, A : (N, N) CSR arrays
        Mass and stiffness matrix.
    density : (Q, T) float array
        Area density at the quadrature points.
    normals, points : (T, Q, 3) float arrays
    u : (T, Q, ...) float array
    grad_u : (T, Q, ..., 3) float array
    """

    M: csr_array
    A: csr_array
    density: Array = np.empty(0)
    normals: Array = np.empty(0)
    points: Array = np.empty(0)
    u: Array = np.empty(0)
    grad_u: Array = np.empty(0)


class SurfaceSpace:
    """Continuous piecewise polynomials of degree k on a closed triangulated surface.

    Parameters
    ----------
    tri : trimesh.Trimesh
        Closed, oriented outwards; see :func:`esfem_core.check_triangulation`.
    degree : int
        Polynomial degree k of both functions and geometry, 1 or more.
    project : callable, optional
        (n, 3) -> (n, 3), moves the new nodes from the flat triangles to the surface, as in
        [N] 7.1, for example :func:`esfem_core.to_unit_sphere`. The triangulation's own vertices
        stay where they are.
    exactness : int, optional
        Degree up to which the quadrature is exact on the reference triangle. Default 2k: mass and
        stiffness matrices of flat elements are then exact, and integrals of smooth functions over
        curved ones have an error of order 2k + 1 or better, below that of the geometry.

    Attributes
    ----------
    nodes : (N, 3) float array
        Node positions on the initial surface, first the triangulation's vertices in their order.
    cells : (T, (k+1)(k+2)/2) int array
        Node numbers of each element in VTK's Lagrange order, triangles in their order.
    degree : int
    rule : TriangleRule
        Points and weights of the quadrature, Q of them.

    Raises
    ------
    TypeError, ValueError
        If `tri` is unfit, a number out of range, or `project` does not return finite points of
        the shape it was given.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 2), degree=2, project=ec.to_unit_sphere)
    >>> space
    SurfaceSpace(degree=2, nodes=258, cells=128, quadrature points per cell=6)
    >>> M, A = space.mass_stiffness(space.nodes)
    >>> print(f"{M.sum() / (4 * np.pi):.6f}")
    0.999317
    """

    def __init__(
        self,
        tri: trimesh.Trimesh,
        degree: int = 1,
        project: Callable[[Array], Array] | None = None,
        exactness: int | None = None,
    ) -> None:
        if degree != int(degree) or degree < 1:
            raise ValueError(f"degree must be an integer >= 1, got {degree!r}")
        check_triangulation(tri)
        self.degree = int(degree)
        self.rule = triangle_rule(2 * self.degree if exactness is None else exactness)
        basis = tabulate(self.degree, self.rule.points)
        vertices, faces = np.array(tri.vertices, dtype=float), np.array(tri.faces, dtype=np.int64)
        self.cells = number_cells(faces, self.degree)
        self.nodes = place_nodes(vertices, faces, self.cells, self.degree, project)
        self._tables = ElementTables(basis, self.rule)
        self._chunks = list(chunks(len(self.cells), len(self._tables.gradients) // 2))
        self._pattern = SparsePattern(self.cells, self._tables.pairs, len(self.nodes), self._chunks)
        self._sum = NodalSum(self.cells, len(self.nodes))
        self._cells_last = np.ascontiguousarray(self.cells.T)  # (n, T)

    def __repr__(self) -> str:
        return (
            f"SurfaceSpace(degree={self.degree}, nodes={len(self.nodes)}, "
            f"cells={len(self.cells)}, quadrature points per cell={len(self.rule.weights)})"
        )

    def mass_stiffness(self, x: Array) -> tuple[csr_array, csr_array]:
        """Mass and stiffness matrix on Γ_h[x] ([N] 2.10).

        M(x)_ij = int phi_i phi_j,  A(x)_ij = int grad phi_i . grad phi_j.

        Parameters
        ----------
        x : (N, 3) float array
            Node positions.

        Returns
        -------
        M, A : (N, N) CSR arrays
            Symmetric, of one fixed sparsity pattern (shared index arrays), with fresh data.

        Raises
        ------
        ValueError
            If `x` has another shape.
        DegenerateElementError
            If an element has no area or a position is not finite.
        """
        at = self.assemble(x)
        return at.M, at.A

    def assemble(self, x: Array, u: Array | None = None) -> "Assembly":
        """Compute in one pass over Γ_h[x] what a time step needs there.

        Parameters
        ----------
        x : (N, 3) float array
        u : (N, ...) float array, optional
            Nodal values of a function to evaluate at the quadrature points.

        Returns
        -------
        Assembly
            Without `u`, only its matrices.

        Raises
        ------
        ValueError
            If an argument has the wrong shape.
        DegenerateElementError
            If an element has no area or a position is not finite.
        """
        if u is None:
            return Assembly(
                *self._pattern.matrices(self._tables.mass_stiffness(g) for _, g in self._metrics(x))
            )
        n_cells, n_points = len(self.cells), len(self.rule.weights)
        local = self._local(u)
        gradient = np.empty((len(local), 3, n_points, n_cells))
        normals, points = np.empty((2, 3, n_points, n_cells))
        density = np.empty((n_points, n_cells))

        def entries() -> Iterator[tuple[Array, Array]]:
            for c, g in self._metrics(x):
                gradient[..., c] = self._tables.gradient(g, local[:, :, c])
                normals[..., c], density[:, c] = g.normals(), g.s
                points[..., c] = self._tables.values @ g.nodes
                yield self._tables.mass_stiffness(g)

        return Assembly(
            *self._pattern.matrices(entries()),
            density,
            normals.transpose(2, 1, 0),
            points.transpose(2, 1, 0),
            self._points_first(self._tables.values @ local, np.shape(u)[1:]),
            self._points_first(gradient.reshape(-1, n_points, n_cells), (*np.shape(u)[1:], 3)),
        )

    def load(self, x: Array, values: Array) -> Array:
        """Load vector b_j = int_{Γ_h[x]} values phi_j, by quadrature.

        Parameters
        ----------
        x : (N, 3) float array
        values : (T, Q, ...) float array
            Integrand at the quadrature points.

        Returns
        -------
        (N, ...) float array

        Raises
        ------
        ValueError
            If an argument has the wrong shape.
        DegenerateElementError
            If an element has no area or a position is not finite.

        Examples
        --------
        >>> import esfem_core as ec
        >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
        >>> b = space.load(space.nodes, np.ones((len(space.cells), 6)))
        >>> M, A = space.mass_stiffness(space.nodes)
        >>> bool(np.allclose(b, M @ np.ones(len(b)), rtol=0, atol=1e-15))
        True
        """
        values = np.asarray(values, dtype=float)
        expected = (len(self.cells), len(self.rule.weights))
        if values.shape[:2] != expected:
            raise ValueError(f"values must have shape {(*expected, '...')}, got {values.shape}")
        return self.load_with(self.density(x).T, values)

    def mass_times(self, x: Array, u: Array) -> Array:
        """M(x) u = (int u_h phi_j)_j, without the matrix.

        Parameters
        ----------
        x : (N, 3) float array
        u : (N, ...) float array

        Returns
        -------
        (N, ...) float array

        Examples
        --------
        >>> import esfem_core as ec
        >>> space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
        >>> M = space.mass_stiffness(space.nodes)[0]
        >>> b = space.mass_times(space.nodes, space.nodes[:, 2])
        >>> bool(np.allclose(b, M @ space.nodes[:, 2], rtol=0, atol=1e-15))
        True
        """
        return self.load(x, self.evaluate(u))

    def load_with(self, density: Array, values: Array) -> Array:
        """Load vector with the area density, (Q, T), of an :class:`Assembly`."""
        by_point = values.reshape(*values.shape[:2], -1).transpose(2, 1, 0)  # (m, Q, T)
        entries = self._tables.tests @ (density * by_point)
        return self._sum(entries).reshape(-1, *values.shape[2:])

    def evaluate(self, u: Array) -> Array:
        """Values of a finite element function at the quadrature points.

        Parameters
        ----------
        u : (N, ...) float array
            Nodal values.

        Returns
        -------
        (T, Q, ...) float array

        Raises
        ------
        ValueError
            If `u` does not have one row per node.
        """
        local = self._local(u)
        return self._points_first(self._tables.values @ local, np.shape(u)[1:])

    def gradient(self, x: Array, u: Array) -> Array:
        """Surface gradient of a finite element function at the quadrature points of Γ_h[x].

        Parameters
        ----------
        x : (N, 3) float array
        u : (N, ...) float array
            Nodal values.

        Returns
        -------
        (T, Q, ..., 3) float array
            The last index is that of the derivative: for a vector field ``[..., i, j]`` is the
            j-th tangential derivative of component i.

        Raises
        ------
        ValueError
            If an argument has the wrong shape.
        DegenerateElementError
            If an element has no area or a position is not finite.
        """
        local = self._local(u)
        out = np.empty((len(local), 3, len(self.rule.weights), len(self.cells)))
        for c, g in self._metrics(x):
            out[..., c] = self._tables.gradient(g, local[:, :, c])
        return self._points_first(out.reshape(-1, *out.shape[2:]), (*np.shape(u)[1:], 3))

    def quadrature_points(self, x: Array) -> Array:
        """Quadrature points on Γ_h[x], as an array of shape (T, Q, 3)."""
        return self.evaluate(np.asarray(x))

    def normals(self, x: Array) -> Array:
        """Unit outward normals of Γ_h[x] at the quadrature points, of shape (T, Q, 3)."""
        out = np.empty((3, len(self.rule.weights), len(self.cells)))
        for c, g in self._metrics(x):
            out[..., c] = g.normals()
        return out.transpose(2, 1, 0)

    def density(self, x: Array) -> Array:
        """Area density of Γ_h[x] over the reference triangle, (T, Q): the area is w @ density.T."""
        out = np.empty((len(self.rule.weights), len(self.cells)))
        for c, g in self._metrics(x):
            out[:, c] = g.s
        return out.T

    def basis_gradients(self, x: Array) -> Array:
        """Surface gradients of the basis functions of each element, (T, Q, n, 3).

        The third index is that of ``cells``: ``basis_gradients(x)[t, q, a]`` is the gradient of the
        basis function of node ``cells[t, a]`` at quadrature point q of element t.
        """
        n = self.cells.shape[1]
        out = np.empty((n, 3, len(self.rule.weights), len(self.cells)))
        for c, g in self._metrics(x):
            out[..., c] = self._tables.gradient(g, np.eye(n)[:, :, None])
        return out.transpose(3, 2, 0, 1)

    @cached_property
    def elimination_order(self) -> NDArray[np.int64]:
        """Order of the nodes for sparse factorisations, (N,)."""
        return dissect(self.cells, self.nodes, part_size=10).order

    @cached_property
    def fronts(self) -> Fronts:
        """What :func:`esfem_core.solvers.factorise` needs for matrices of this space."""
        return Fronts(dissect(self.cells, self.nodes), self.cells, self._pattern.pattern)

    def mesh_size(self, x: Array) -> float:
        """h: the longest distance between two corners of an element of Γ_h[x] ([N] 2.8)."""
        corners = np.asarray(x)[self.cells[:, :3]]
        return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max())

    def _metrics(self, x: Array) -> Iterator[tuple[slice, Metric]]:
        """Metrics on Γ_h[x], chunk by chunk of elements."""
        x = np.asarray(x, dtype=float)
        if x.shape != self.nodes.shape:
            raise ValueError(f"x must have shape {self.nodes.shape}, got {x.shape}")
        coordinates = np.ascontiguousarray(x.T)
        for c in self._chunks:
            nodes = coordinates.take(self._cells_last[:, c], axis=1)
            yield c, self._tables.metric(nodes, c.start)

    def _local(self, u: Array) -> Array:
        """Nodal values by element, (m, n, T)."""
        u = np.asarray(u, dtype=float)
        if u.ndim == 0 or len(u) != len(self.nodes):
            raise ValueError(f"u must have {len(self.nodes)} rows, one per node, got {u.shape}")
        return np.ascontiguousarray(u.reshape(len(u), -1).T)[:, self._cells_last]

    @staticmethod
    def _points_first(values: Array, trailing: tuple[int, ...]) -> Array:
        """Turn (m, Q, T) into (T, Q, *trailing)."""
        _, n_points, n_cells = values.shape
        return values.transpose(2, 1, 0).reshape(n_cells, n_points, *trailing)
