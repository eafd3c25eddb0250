"""The surface finite element space S_h[x] ([N] Section 2.8).

Topology never changes; geometry is an (N, 3) array x of node positions. Γ_h[x] is "the space,
at x", and every method that depends on the geometry takes x as its first argument.
"""

from collections.abc import Callable
from functools import cached_property
from math import isqrt
from typing import Any, Literal

import numpy as np
import trimesh
from numpy.typing import ArrayLike
from scipy.sparse import csr_array

from esfem_core.checks import (
    Array,
    Bools,
    Ints,
    check_array,
    check_node_numbers,
    finite_array,
    flag,
    function,
    integer_array,
    one_of,
    read_only,
    real_array,
    shown,
    whole_number,
)
from esfem_core.elements.integrals import CHUNK, DegenerateElementError, ElementTables, Metric
from esfem_core.elements.lagrange import MOST_DEGREE, tabulate
from esfem_core.elements.numbering import (
    IN_ORDER,
    boundary_nodes,
    check_cells,
    flat_triangles,
    mirrored,
    number_cells,
    place_nodes,
)
from esfem_core.elements.probing import probe
from esfem_core.elements.quadrature import TriangleRule, triangle_rule
from esfem_core.elements.scatter import NodalSum, SparsePattern, keep_freed_memory
from esfem_core.solvers import Fronts, dissect, pieces, side_by_side
from esfem_core.surfaces import (
    boundary_advice,
    check_coordinates,
    check_triangulation,
    curved_elements,
    fault,
    normals_of,
    sides_of,
    turned_to_agree,
    turned_to_outside,
)

__all__ = ["NodeOrder", "SurfaceSpace"]

NodeOrder = Literal["vtk", "gmsh", "meshio"]  # on triangles these are one order
SHARED = ("nodes", "cells", "boundary_nodes", "rule", "neighbours", "elimination_order")
Entries = Callable[[slice, Metric], tuple[Array, ...]]


class SurfaceSpace:
    """Continuous piecewise polynomials of degree k on a triangulated surface.

    Parameters
    ----------
    tri : trimesh.Trimesh
        Closed, oriented outwards; see :func:`esfem_core.check_triangulation`.
    degree : int
        Polynomial degree k of both functions and geometry, 1 to 12.
    project : callable, optional
        (n, 3) -> (n, 3), moves the new nodes from the flat triangles to the surface, as in
        [N] Section 7.1, for example :func:`esfem_core.to_unit_sphere`; by at most half of the
        longest side of a triangle there. The triangulation's own vertices stay where they are,
        unless `project_vertices` is true.
    exactness : int, optional
        Degree up to which the quadrature is exact on the reference triangle. Default 2k: mass and
        stiffness matrices of flat elements are then exact, and integrals of smooth functions over
        curved ones have an error of order 2k + 1 or better, below that of the geometry.
    project_vertices : bool
        Whether `project` moves the vertices, too: for triangulations that are only near the
        surface.
    boundary : bool
        Accept a surface with a boundary: edges that belong to one triangle only. Without, a hole
        in a mesh is an error. A run must then prescribe the motion, by
        :class:`esfem_core.laws.Prescribed`; conditions for functions at the boundary are natural,
        or those of ``Species(fixed=...)``.

    Attributes
    ----------
    nodes : (N, 3) float array
        Node positions on the initial surface, first the triangulation's vertices in their order.
    cells : (T, (k+1)(k+2)/2) int array
        Node numbers of each element in VTK's Lagrange order, triangles in their order.
    degree : int
    boundary_nodes : (B,) int array
        Nodes on edges of one element only, in increasing order; none on a closed surface.
    rule : TriangleRule
        Points and weights of the quadrature, Q of them.
    tables : ElementTables
        Basis functions and their products at these points.
    pattern : (N, N) CSR array
        The sparsity pattern of all matrices.

    Raises
    ------
    TypeError, ValueError
        If `tri` is unfit, a number out of range, or `project` does not return finite points of
        the shape it was given, or moves one too far, or makes elements fold back.

    Examples
    --------
    >>> import esfem_core as ec
    >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 2), degree=2, project=ec.to_unit_sphere)
    >>> space
    SurfaceSpace(degree=2, nodes=258, cells=128, quadrature points per cell=6)
    >>> M, A = space.mass_stiffness(space.nodes)
    >>> print(f"{M.sum() / (4 * np.pi):.6f}")
    0.999317

    A hemisphere: the equator consists of edges of the octahedral sphere.

    >>> tri = ec.sphere("octahedron", 2)
    >>> tri.update_faces(tri.triangles_center[:, 2] > 0)
    >>> tri.remove_unreferenced_vertices()
    >>> half = ec.SurfaceSpace(tri, 2, ec.to_unit_sphere, boundary=True)
    >>> len(half.boundary_nodes), float(np.abs(half.nodes[half.boundary_nodes, 2]).max())
    (32, 0.0)
    """

    def __init__(
        self,
        tri: trimesh.Trimesh,
        degree: int = 1,
        project: Callable[[Array], Array] | None = None,
        exactness: int | None = None,
        *,
        project_vertices: bool = False,
        boundary: bool = False,
    ) -> None:
        degree = whole_number("degree", degree, 1, MOST_DEGREE)
        check_triangulation(tri, boundary)
        rule = _rule(degree, exactness)
        flag("project_vertices", project_vertices)
        if project is not None:
            function("project", project, "of points (n, 3), or None")
        vertices = np.array(tri.vertices, dtype=float)
        faces = np.array(tri.faces, dtype=np.int64)
        cells = number_cells(faces, degree)
        if project_vertices and project is None:
            raise ValueError("project_vertices needs a project, (n, 3) -> (n, 3)")
        first = 0 if project_vertices else len(vertices)
        nodes = place_nodes(vertices, faces, cells, degree, project, first)
        if project_vertices and (found := fault(nodes[: len(vertices)], faces, boundary)):
            raise ValueError(
                f"project makes the triangulation unfit: {found.text}; tri must be so near the "
                "surface that no triangle folds over: project_vertices=False leaves its vertices"
            )
        self._set_up(nodes, cells, degree, rule)

    @classmethod
    def from_nodes(
        cls,
        nodes: ArrayLike,
        cells: ArrayLike,
        exactness: int | None = None,
        *,
        order: NodeOrder = "vtk",
        boundary: bool = False,
    ) -> "SurfaceSpace":
        """The space of given nodes and elements, curved or flat.

        Parameters
        ----------
        nodes : (N, 3) float array
        cells : (T, (k+1)(k+2)/2) int array
            Node numbers of each element; the degree k is that of their number. Elements that are
            oriented against their neighbours, or inwards, are turned: ``space.cells`` has all
            outwards, and cavities inwards. What is a cavity is told by the k² flat triangles
            between the nodes of each element. Where a shell is thinner than their distance from
            the elements, its two sides need elements of one size: else both may be turned.
        exactness : int, optional
            As for the class.
        order : {"vtk", "gmsh", "meshio"}
            Order of the nodes of an element. On triangles these three have the same: corners 0,
            1, 2, nodes on the edges from 0 to 1, from 1 to 2 and from 2 to 0, then the interior,
            which is the same pattern for k - 3.
        boundary : bool
            As for the class.

        Returns
        -------
        SurfaceSpace

        Raises
        ------
        TypeError, ValueError
            If an array has the wrong shape or type, a node belongs to no element or has
            coordinates beyond 1e75, all are less than 1e-70 across, the corners of the elements are
            no fit triangulation, or neighbours do not share the nodes on their edge.

        Examples
        --------
        >>> import esfem_core as ec
        >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 2), 3, ec.to_unit_sphere)
        >>> ec.SurfaceSpace.from_nodes(space.nodes, space.cells)
        SurfaceSpace(degree=3, nodes=578, cells=128, quadrature points per cell=12)
        """
        one_of("order", order, NodeOrder)
        boundary = flag("boundary", boundary)
        nodes = np.array(finite_array("nodes", nodes, ("N", 3)))
        cells = np.array(integer_array("cells", cells, ("T", "n")))
        degree = (isqrt(8 * cells.shape[1] + 1) - 3) // 2
        if degree < 1 or (degree + 1) * (degree + 2) // 2 != cells.shape[1]:
            raise ValueError(
                "cells must have 3, 6, 10, 15, 21, ... columns, the nodes of an element of degree "
                f"1, 2, 3, 4, 5, ...; got {cells.shape[1]}"
            )
        degree = whole_number("the degree of cells", degree, 1, MOST_DEGREE)
        check_node_numbers("cells", cells, len(nodes))
        unused = np.bincount(cells.ravel(), minlength=len(nodes)) == 0
        if unused.any():
            raise ValueError(
                f"nodes must belong to elements of cells, but node {np.argmax(unused)} belongs to "
                f"none ({unused.sum()} such nodes); "
                "used, numbers = np.unique(cells, return_inverse=True) gives nodes[used] and "
                "cells = numbers.reshape(cells.shape)"
            )
        check_coordinates("nodes", nodes, cells)
        corners, faces = np.unique(cells[:, :3], return_inverse=True)
        faces = faces.reshape(-1, 3)
        turned = _turned(faces, nodes, flat_triangles(cells, degree), boundary)
        cells[turned] = cells[turned][:, mirrored(degree)]
        faces[turned] = faces[turned][:, [0, 2, 1]]
        curved = nodes, flat_triangles(cells, degree)
        found = fault(nodes[corners], faces, boundary, curved)
        if found is not None:
            advice = found.advice
            if found.text.startswith("the surface is not closed"):
                advice = (
                    "neighbours must share their nodes, and SurfaceSpace.read makes one of nodes "
                    f"nearer than 1e-6 of the diagonal{boundary_advice(nodes[corners], faces)}"
                )
            elif "read_mesh" in advice:
                advice = (
                    "neighbours must share their nodes, as SurfaceSpace.read sees to, and the two "
                    "sides of a slit lie farther apart than 1e-6 of the diagonal"
                )
            elif found.text.startswith("the surface is not a manifold"):
                advice = "keep elements that make up the surface, each once: cells = cells[keep]"
            raise ValueError(
                f"cells must have corners that make a fit triangulation, but {found.text}; {advice}"
            )
        check_cells(cells, faces, degree, len(nodes))
        space = cls.__new__(cls)
        # Edges with two nodes and more may all be given backwards, which no neighbour contradicts.
        advice = f", or, if they are right, put those of an element {IN_ORDER}" * (degree >= 3)
        space._set_up(nodes, cells, degree, _rule(degree, exactness), advice)
        return space

    @classmethod
    def read(
        cls,
        source: Any,
        exactness: int | None = None,
        *,
        report: Callable[[str], object] | None = print,
        boundary: bool = False,
    ) -> "SurfaceSpace":
        """The space of the triangular elements of a file, of degree 1 to 12, curved as they are.

        Parameters
        ----------
        source : path, meshio.Mesh or PyVista data set
            Gmsh, VTK, VTU, Abaqus and what else meshio reads (``pip install "esfem-core[files]"``);
            elements of one degree, their nodes in the order that meshio gives them. Cells of a
            body and nodes outside of all elements are left out, and where neighbours do not share
            nodes, those at equal places become one, or within 1e-6 of the diagonal. Of an element
            given twice one is kept.
        exactness : int, optional
            As for the class.
        report : callable, optional
            Is told what was found and done, in lines of text.
        boundary : bool
            As for the class.

        Returns
        -------
        SurfaceSpace

        Raises
        ------
        FileNotFoundError, ImportError
            If there is no such file, or no meshio to read it.
        TypeError, ValueError
            If it cannot be read, holds other cells than triangles of one degree, or is not fit;
            see :meth:`from_nodes`.
        """
        if report is not None:
            function("report", report, "of a line of text, or None")
        found = curved_elements(source)
        [(_, cells)] = found.cells
        try:
            space = cls.from_nodes(
                found.points, cells, exactness, order="meshio", boundary=boundary
            )
        except (TypeError, ValueError) as error:
            raise type(error)(f"source, {found.name}: {error}") from error
        if report is not None:
            report(
                f"{found.name}: degree {space.degree}, {len(space.nodes)} nodes, {len(cells)} cells"
            )
            turned = int((space.cells != cells).any(axis=1).sum())
            if turned:
                found.notes.append(f"turned {turned} elements to agree and point outwards")
            for note in found.notes:
                report(note)
        return space

    def _set_up(
        self, nodes: Array, cells: Ints, degree: int, rule: TriangleRule, advice: str = ""
    ) -> None:
        """What both constructors do in the end."""
        keep_freed_memory()
        self.nodes, self.cells, self.degree, self.rule = nodes, cells, degree, rule
        self.boundary_nodes = boundary_nodes(cells, degree)
        self.tables = ElementTables(tabulate(degree, rule.points), rule)
        n_points = len(self.tables.gradients) // 2
        self._chunks = pieces(len(self.cells), max(CHUNK // n_points, 1))
        self._scatter = SparsePattern(self.cells, self.tables.pairs, len(self.nodes), self._chunks)
        self.pattern = self._scatter.pattern
        self._sum = NodalSum(self.cells, len(self.nodes))
        self._cells_last = np.ascontiguousarray(self.cells.T)  # (n, T)
        self._protect()
        self._check_elements(advice)

    def _protect(self) -> None:
        """Let nobody write to what matrices and states share; pickles do not keep that."""
        read_only(*(vars(self).get(name) for name in SHARED), vars(self.pattern))

    def __setstate__(self, kept: dict[str, Any]) -> None:
        vars(self).update(kept)
        self._protect()

    def _check_elements(self, advice: str) -> None:
        """Refuse curved elements that fold back: what is accepted has a mass matrix."""
        try:
            normal = self.normals(self.nodes)
        except DegenerateElementError as error:
            raise ValueError(
                f"nodes must make elements with an area at all quadrature points, but {error}"
            ) from error
        corners = self.cells[:, :3]
        cosine = np.einsum("tqi,ti->tq", normal, normals_of(self.nodes, corners))
        if not cosine.min() > 0:
            t = int(np.argmin(cosine.min(axis=1)))
            near = self.nodes[corners[t, 0]]
            raise ValueError(
                "nodes must make elements that do not fold back, but the normal of element "
                f"{t}, near {near.round(6).tolist()}, is turned by more than a right angle against "
                f"that of its flat triangle: place the nodes nearer to it{advice}"
            )

    def __repr__(self) -> str:
        return (
            f"SurfaceSpace(degree={self.degree}, nodes={len(self.nodes)}, "
            f"cells={len(self.cells)}, quadrature points per cell={len(self.rule.weights)})"
        )

    def mass_stiffness(self, x: Array) -> tuple[csr_array, csr_array]:
        r"""Mass and stiffness matrix on Γ_h[x] ([N] Section 2.10).

        .. math::

            M(x)_{ij} = \int_{\Gamma_h[x]} \varphi_i \varphi_j, \qquad
            A(x)_{ij} = \int_{\Gamma_h[x]} \nabla\varphi_i \cdot \nabla\varphi_j

        Parameters
        ----------
        x : (N, 3) float array
            Node positions.

        Returns
        -------
        M, A : (N, N) CSR arrays
            Symmetric, of one fixed sparsity pattern (shared index arrays), with fresh data. What
            changes the pattern in place, such as ``M.eliminate_zeros()``, needs ``M.copy()``.

        Raises
        ------
        TypeError, ValueError
            If `x` has another shape.
        DegenerateElementError
            If an element has no area or a position is not finite.
        """
        M, A = self.assemble(x, lambda _, g: self.tables.mass_stiffness(g), 2)
        return M, A

    def mass(self, x: Array) -> csr_array:
        """Mass matrix alone, in 0.55 to 0.75 of the time of both; see :meth:`mass_stiffness`.

        Raises
        ------
        TypeError, ValueError, DegenerateElementError
            As of :meth:`mass_stiffness`.
        """
        [M] = self.assemble(x, lambda _, g: (self.tables.mass @ g.s,), 1)
        return M

    def assemble(self, x: Array, entries: Entries, count: int) -> list[csr_array]:
        """Sum element entries into matrices.

        Parameters
        ----------
        x : (N, 3) float array
        entries : callable
            From a chunk of C elements and its metric on Γ_h[x], as :meth:`by_chunks` hands them
            out, to the entries of each matrix for the index pairs ``tables.pairs``, (P, C).
        count : int
            How many matrices.

        Returns
        -------
        list of (N, N) CSR arrays
        """
        metric = self._metrics(x)
        return self._scatter.matrices(lambda i: entries(*metric(i)), count)

    def interpolate(self, function: Callable[[Array], ArrayLike], x: Array) -> Array:
        """Nodal values of a function on Γ_h[x].

        Parameters
        ----------
        function : callable
            (N, 3) -> (N, ...), real and finite.
        x : (N, 3) float array

        Returns
        -------
        (N, ...) float array

        Raises
        ------
        ValueError, TypeError
            If `x` has another shape or is not finite, or the function does not return one row of
            finite real numbers for each point.

        Examples
        --------
        >>> import esfem_core as ec
        >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
        >>> space.interpolate(lambda x: x[:, 2] ** 2, space.nodes).max()
        np.float64(1.0)
        """
        x = finite_array("x", x, self.nodes.shape)
        if not callable(function):
            raise TypeError(f"function must be a function of points (N, 3), got {shown(function)}")
        values = finite_array("function(x)", function(x.copy()), (len(x), "..."))
        return np.array(values)

    def probe(self, x: Array, u: Array, points: ArrayLike) -> Array:
        """Values of a finite element function at the points of Γ_h[x] closest to given ones.

        See :func:`esfem_core.elements.probing.probe`.

        Parameters
        ----------
        x : (N, 3) float array
        u : (N, ...) float array
        points : (n, 3) float array

        Returns
        -------
        (n, ...) float array

        Raises
        ------
        TypeError, ValueError
            If an argument has the wrong shape or is not real and finite.

        Examples
        --------
        >>> import esfem_core as ec
        >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 2), 2, ec.to_unit_sphere)
        >>> space.probe(space.nodes, space.nodes[:, 2], [[0.0, 0.0, 3.0]]).round(12)
        array([1.])
        """
        return probe(self, x, u, points)

    def integrate(self, x: Array, values: ArrayLike) -> Array:
        """Integrals over Γ_h[x] of values at its quadrature points.

        Parameters
        ----------
        x : (N, 3) float array
        values : float or (T, Q, ...) float array
            A number stands for a constant: 1 gives the area.

        Returns
        -------
        (...) float array or float
            One integral for each component.

        Raises
        ------
        ValueError, TypeError
            If an argument has the wrong shape or is not real.
        DegenerateElementError
            If an element has no area or a position is not finite.

        Examples
        --------
        >>> import esfem_core as ec
        >>> space = ec.SurfaceSpace(ec.sphere("octahedron", 3), 2, ec.to_unit_sphere)
        >>> print(f"{space.integrate(space.nodes, 1) / (4 * np.pi):.6f}")
        0.999955
        >>> u = space.evaluate(space.nodes[:, 2] ** 2)
        >>> print(f"{space.integrate(space.nodes, u) / (4 * np.pi / 3):.6f}")
        0.999955
        """
        return self.integral_with(self.density(x), values)

    def integral_with(self, density: Array, values: ArrayLike) -> Array:
        """Integrals with the area density, (T, Q), of a surface."""
        check_array("density", density, (len(self.cells), len(self.rule.weights)))
        measure = density * self.rule.weights
        at_points = real_array("values", values, ("...",))
        if at_points.ndim == 0:
            return np.asarray(at_points * measure.sum())[()]
        at_points = real_array("values", at_points, (*measure.shape, "..."))
        total: Array = np.tensordot(measure, at_points, 2)[()]
        return total

    def load(self, x: Array, values: Array) -> Array:
        r"""Load vector on Γ_h[x], by quadrature.

        .. math:: b_j = \int_{\Gamma_h[x]} \text{values}\; \varphi_j

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
        TypeError, ValueError
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
        shape = (len(self.cells), len(self.rule.weights), "...")
        return self.load_with(self.density(x), real_array("values", values, shape))

    def mass_times(self, x: Array, u: Array) -> Array:
        r"""M(x) u, without the matrix.

        .. math:: (M(x) u)_j = \int_{\Gamma_h[x]} u_h \varphi_j

        Parameters
        ----------
        x : (N, 3) float array
        u : (N, ...) float array

        Returns
        -------
        (N, ...) float array

        Raises
        ------
        TypeError, ValueError, DegenerateElementError
            As of :meth:`load`.

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
        """Load vector with the area density, (T, Q), of a surface; values are (T, Q, ...)."""
        check_array("density", density, (len(self.cells), len(self.rule.weights)))
        check_array("values", values, (len(self.cells), len(self.rule.weights), "..."))
        density = density.T
        by_point = values.reshape(*values.shape[:2], -1).transpose(2, 1, 0)  # (m, Q, T)
        entries = np.empty((len(by_point), self.cells.shape[1], len(self.cells)))

        def fill(c: slice) -> None:
            np.matmul(self.tables.tests, density[:, c] * by_point[..., c], out=entries[..., c])

        side_by_side(fill, self._chunks, worth=by_point.size > 5 * 10**5)
        return self.sum_loads(entries, values.shape[2:])

    def sum_loads(self, entries: Array, trailing: tuple[int, ...]) -> Array:
        """Sum element entries (m, n, T) into nodal vectors (N, ...)."""
        return self._sum(entries).reshape(len(self.nodes), *trailing)

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
        TypeError, ValueError
            If `u` does not have one row per node.
        """
        local = self.local(u)
        return self.points_first(self.tables.values @ local, np.shape(u)[1:])

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
        TypeError, ValueError
            If an argument has the wrong shape.
        DegenerateElementError
            If an element has no area or a position is not finite.
        """
        local = self.local(u)
        out = np.empty((len(local), 3, len(self.rule.weights), len(self.cells)))

        def fill(c: slice, g: Metric) -> None:
            out[..., c] = self.tables.gradient(g, local[:, :, c])

        self.by_chunks(x, fill)
        return self.points_first(out.reshape(-1, *out.shape[2:]), (*np.shape(u)[1:], 3))

    def quadrature_points(self, x: Array) -> Array:
        """Quadrature points on Γ_h[x], as an array of shape (T, Q, 3).

        Raises
        ------
        TypeError, ValueError
            If `x` has another shape or is not real and finite.
        """
        return self.evaluate(finite_array("x", x, self.nodes.shape))

    def normals(self, x: Array) -> Array:
        """Unit outward normals of Γ_h[x] at the quadrature points, of shape (T, Q, 3).

        Raises
        ------
        TypeError, ValueError, DegenerateElementError
            As of :meth:`mass_stiffness`.
        """
        out = np.empty((3, len(self.rule.weights), len(self.cells)))

        def fill(c: slice, g: Metric) -> None:
            out[..., c] = g.normals()

        self.by_chunks(x, fill)
        return out.transpose(2, 1, 0)

    def density(self, x: Array) -> Array:
        """Area density of Γ_h[x] over the reference triangle, (T, Q).

        ``space.density(x) @ space.rule.weights`` are the areas of the elements.

        Raises
        ------
        TypeError, ValueError, DegenerateElementError
            As of :meth:`mass_stiffness`.
        """
        out = np.empty((len(self.rule.weights), len(self.cells)))

        def fill(c: slice, g: Metric) -> None:
            out[:, c] = g.s

        self.by_chunks(x, fill)
        return out.T

    def basis_gradients(self, x: Array) -> Array:
        """Surface gradients of the basis functions of each element, (T, Q, n, 3).

        The third index is that of ``cells``: ``basis_gradients(x)[t, q, a]`` is the gradient of the
        basis function of node ``cells[t, a]`` at quadrature point q of element t.

        Raises
        ------
        TypeError, ValueError, DegenerateElementError
            As of :meth:`mass_stiffness`.
        """
        n = self.cells.shape[1]
        out = np.empty((n, 3, len(self.rule.weights), len(self.cells)))

        def fill(c: slice, g: Metric) -> None:
            out[..., c] = self.tables.gradient(g, np.eye(n)[:, :, None])

        self.by_chunks(x, fill)
        return out.transpose(3, 2, 0, 1)

    @cached_property
    def neighbours(self) -> Ints:
        """Pairs of elements that have a side in common, (2, E)."""
        pairs: Ints = sides_of(self.cells[:, :3]).pairs().T // 3
        pairs.setflags(write=False)
        return pairs

    @cached_property
    def elimination_order(self) -> Ints:
        """Order of the nodes for sparse factorisations, (N,)."""
        order = dissect(self.cells, self.nodes, part_size=10).order
        order.setflags(write=False)
        return order

    @cached_property
    def fronts(self) -> Fronts:
        """What :func:`esfem_core.solvers.factorise` needs for matrices of this space."""
        return Fronts(dissect(self.cells, self.nodes), self.cells, self.pattern)

    def mesh_size(self, x: Array) -> float:
        """h: the longest distance of two corners of an element of Γ_h[x] ([N] Section 2.8).

        Raises
        ------
        TypeError, ValueError
            If `x` has another shape or is not real and finite.
        """
        corners = finite_array("x", x, self.nodes.shape)[self.cells[:, :3]]
        return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max())

    def by_chunks(self, x: Array, work: Callable[[slice, Metric], object]) -> None:
        """Call work(c, metric) for each chunk c of elements of Γ_h[x], on several threads.

        A chunk is a slice of ``cells``; see :func:`esfem_core.solvers.threads.side_by_side`.
        """
        metric = self._metrics(x)
        side_by_side(lambda i: work(*metric(i)), range(len(self._chunks)))

    def _metrics(self, x: Array) -> Callable[[int], tuple[slice, Metric]]:
        """What makes the metric of a chunk on Γ_h[x], from its number."""
        coordinates = np.ascontiguousarray(real_array("x", x, self.nodes.shape).T)

        def metric(i: int) -> tuple[slice, Metric]:
            c = self._chunks[i]
            nodes = coordinates.take(self._cells_last[:, c], axis=1)
            return c, self.tables.metric(nodes, c.start)

        return metric

    def local(self, u: Array) -> Array:
        """Nodal values by element, (m, n, T)."""
        u = real_array("u", u, (len(self.nodes), "..."))
        return np.ascontiguousarray(u.reshape(len(u), -1).T)[:, self._cells_last]

    @staticmethod
    def points_first(values: Array, trailing: tuple[int, ...]) -> Array:
        """Turn (m, Q, T) into (T, Q, ...)."""
        _, n_points, n_cells = values.shape
        return values.transpose(2, 1, 0).reshape(n_cells, n_points, *trailing)


def _turned(faces: Ints, nodes: Array, pieces: Ints, boundary: bool) -> Bools:
    """Which elements to turn; none if no turning helps."""
    none = np.zeros(len(faces), dtype=bool)
    times = sides_of(faces).times
    if len(faces) == 0 or (times > 2).any() or (not boundary and (times == 1).any()):
        return none
    return turned_to_outside(faces, nodes, pieces) if turned_to_agree(faces)[1].all() else none


def _rule(degree: int, exactness: int | None) -> TriangleRule:
    """The quadrature rule; too weak a one would make the mass matrix singular."""
    rule = triangle_rule(2 * degree if exactness is None else exactness)
    least = rule.exactness
    while not _independent(degree, triangle_rule(least)):
        least += 1
    if least > rule.exactness:
        raise ValueError(
            f"exactness must be {least} or more for elements of degree {degree}, got {exactness}: "
            f"{len(rule.weights)} points do not tell {(degree + 1) * (degree + 2) // 2} basis "
            "functions apart, and the mass matrix is singular"
        )
    return rule


def _independent(degree: int, rule: TriangleRule) -> bool:
    values = tabulate(degree, rule.points).values
    return bool(np.linalg.matrix_rank(values) == values.shape[1])
