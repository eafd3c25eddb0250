"""The same discretization in NGSolve: the same mesh and degree, moved by a deformation.

NGSolve's basis is hierarchical (vertex functions and bubbles), ours nodal; both span the same
space, and :class:`Peer` converts between nodal values and NGSolve's coefficients. ``run.py``
compares its times, ``tests/peers`` its numbers.
"""

import netgen.meshing as nm
import ngsolve as ng
import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from esfem_core.elements import node_indices


class Peer:
    """Mass and stiffness matrix on Γ_h[x] by NGSolve.

    Parameters
    ----------
    space : esfem_core.SurfaceSpace
    exactness : int, optional
        Of NGSolve's own quadrature. Default: that of the space's; 4 and 6 are the same rules.
    """

    def __init__(self, space, exactness=None):
        self.space, k = space, space.degree
        n_vertices = int(space.cells[:, :3].max()) + 1
        mesh = nm.Mesh(dim=3)
        points = [mesh.Add(nm.MeshPoint(nm.Pnt(*p))) for p in space.nodes[:n_vertices]]
        mesh.Add(nm.FaceDescriptor(surfnr=1, domin=1, domout=0, bc=1))
        for a, b, c in space.cells[:, :3]:
            mesh.Add(nm.Element2D(1, [points[a], points[b], points[c]]))
        self.mesh = ng.Mesh(mesh)
        self.fes = ng.H1(self.mesh, order=k)
        self.vector = ng.VectorH1(self.mesh, order=k)
        self.to_nodal = self._basis_at_nodes()
        self._to_coefficients = splu(self.to_nodal.tocsc())

        self.base = np.empty_like(space.nodes)  # nodes of the flat triangles
        corners = space.nodes[space.cells[:, :3]]
        self.base[space.cells] = node_indices(k) / k @ corners
        self.deformation = ng.GridFunction(self.vector)
        self.mesh.SetDeformation(self.deformation)

        u, w = self.fes.TnT()
        rule = ng.IntegrationRule(ng.TRIG, space.rule.exactness if exactness is None else exactness)
        self.ds = ds = ng.ds(intrules={ng.TRIG: rule})
        self.M = ng.BilinearForm(u * w * ds, symmetric=False)
        self.A = ng.BilinearForm(ng.grad(u).Trace() * ng.grad(w).Trace() * ds, symmetric=False)

    def _basis_at_nodes(self):
        """NGSolve's functions at our nodes: rows of nodes, columns of coefficients."""
        # NGSolve's corners of the reference triangle are (1, 0), (0, 1), (0, 0).
        points = (node_indices(self.space.degree) / self.space.degree)[:, :2].tolist()
        rows, columns, values = [], [], []
        for cell, element in zip(self.space.cells, self.fes.Elements(ng.BND), strict=True):
            finite_element = self.fes.GetFE(ng.ElementId(element))
            rows.append(np.repeat(cell, len(cell)))
            columns.append(np.tile(element.dofs, len(cell)))
            values.append(np.array([finite_element.CalcShape(*p) for p in points]).ravel())
        rows, columns, values = map(np.concatenate, (rows, columns, values))
        # What several elements share has the same values in all of them: take the last.
        _, last = np.unique(rows.astype(np.int64) * self.fes.ndof + columns, return_index=True)
        n = len(self.space.nodes)
        return sp.csr_array((values[last], (rows[last], columns[last])), shape=(n, n))

    def coefficients(self, nodal):
        """NGSolve's coefficients, (ndof, ...), of nodal values (N, ...)."""
        return self._to_coefficients.solve(np.ascontiguousarray(nodal))

    def nodal(self, coefficients):
        """Nodal values of NGSolve's coefficients."""
        return self.to_nodal @ coefficients

    def dual(self, load):
        """The load vector of our basis, (N, ...), of one of NGSolve's."""
        return self._to_coefficients.solve(np.ascontiguousarray(load), trans="T")

    def move(self, x):
        """Set the deformation so that the surface is Γ_h[x]."""
        self.deformation.vec.FV().NumPy()[:] = self.coefficients(x - self.base).T.ravel()

    def assemble(self):
        """Assemble both matrices on the surface as it is."""
        self.M.Assemble()
        self.A.Assemble()

    def scipy(self, form):
        """A copy of a matrix of NGSolve as CSR."""
        rows, columns, values = form.mat.COO()
        n = self.fes.ndof
        return sp.csr_array((np.array(values), (np.array(rows), np.array(columns))), shape=(n, n))


def radius(t):
    """Radius of the expanding sphere and its rate."""
    return 1 + 0.5 * np.sin(np.pi * t), 0.5 * np.pi * np.cos(np.pi * t)


def evolve(space, order, step, n_steps, solver="sparsecholesky"):
    """[N] (2.19)-(2.21) for the expanding sphere with the smooth coupling, alpha = beta = 1.

    As a user of NGSolve would write it: matrices and loads by symbolic forms on the deformed
    surface, both systems factorised in every step with the symbolic factorisation kept
    (``sparsecholesky``), or solved by NGSolve's conjugate gradients with the factorisation of an
    earlier step (``lagged``).

    Parameters
    ----------
    space : esfem_core.SurfaceSpace
    order, step, n_steps : int, float, int
    solver : {"sparsecholesky", "lagged"}

    Yields
    ------
    t, x, u
        Time and nodal values.
    """
    from esfem_core.stepping import bdf

    peer = Peer(space)
    fes, ds = peer.fes, peer.ds
    d, c = bdf.delta(order), bdf.gamma(order)
    a, dr_r, rate = (ng.Parameter(0.0) for _ in range(3))
    u_tilde = ng.GridFunction(fes)
    exact = a * ng.x * ng.y * ng.z
    w, vector_w = fes.TestFunction(), peer.vector.TestFunction()
    load_f = ng.LinearForm(rate * u_tilde * w.Trace() * ds)
    source = dr_r + u_tilde - exact
    load_g = ng.LinearForm(source * ng.specialcf.normal(3) * vector_w.Trace() * ds)

    def parameters(t):
        r, dr = radius(t)
        a.Set(np.exp(-(t**2)))
        dr_r.Set(dr + 2 * dr / r**2 + 2 / r)
        rate.Set(5 * dr / r - 2 * t + 12 / r**2)

    def values(t):
        r = radius(t)[0]
        x = r * space.nodes
        return x, np.exp(-(t**2)) * x.prod(axis=1)

    xs, us, Mus = [], [], []
    for n in range(order):
        x, u = values(n * step)
        peer.move(x)
        peer.M.Assemble()
        u = peer.coefficients(u)
        xs.insert(0, peer.coefficients(x))
        us.insert(0, u)
        Mus.insert(0, multiply(peer.M.mat, u))
    peer.A.Assemble()
    base = peer.coefficients(peer.base)
    systems = [_System(peer, solver) for _ in range(2)]

    for n in range(order, n_steps + 1):
        t = n * step
        parameters(t)
        x_tilde = sum(c[j] * xs[j] for j in range(order))
        u_tilde.vec.FV().NumPy()[:] = sum(c[j] * us[j] for j in range(order))
        peer.deformation.vec.FV().NumPy()[:] = (x_tilde - base).T.ravel()
        peer.assemble()
        load_f.Assemble()
        load_g.Assemble()
        past_x = sum(d[j] * xs[j - 1] for j in range(1, order + 1)) / step
        past_Mu = sum(d[j] * Mus[j - 1] for j in range(1, order + 1)) / step
        g = load_g.vec.FV().NumPy().reshape(3, -1).T
        K_past = np.column_stack(
            [multiply(peer.M.mat, col) + multiply(peer.A.mat, col) for col in past_x.T]
        )
        x = systems[0].solve(d[0] / step, d[0] / step + 1, g - K_past, x_tilde)
        f = load_f.vec.FV().NumPy()
        u = systems[1].solve(d[0] / step, 1.0, f - past_Mu, u_tilde.vec.FV().NumPy().copy())
        xs, us = [x, *xs[:-1]], [u, *us[:-1]]
        Mus = [multiply(peer.M.mat, u), *Mus[:-1]]
        yield t, peer.nodal(x), peer.nodal(u)


def multiply(matrix, values):
    """Matrix times NumPy vector."""
    v, out = matrix.CreateColVector(), matrix.CreateColVector()
    v.FV().NumPy()[:] = values
    out.data = matrix * v
    return out.FV().NumPy().copy()


class _System:
    """(m M + a A) x = b, one or several columns."""

    def __init__(self, peer, solver):
        self.peer, self.solver = peer, solver
        self.matrix = peer.M.mat.CreateMatrix()
        self.inverse = None

    def solve(self, m, a, b, guess):
        values = self.matrix.AsVector()
        values.data = float(m) * self.peer.M.mat.AsVector() + float(a) * self.peer.A.mat.AsVector()
        if self.inverse is None:
            self.inverse = self.matrix.Inverse(inverse="sparsecholesky")
        elif self.solver == "sparsecholesky":
            self.inverse.Update()  # keeps the symbolic factorisation
        columns = b.reshape(len(b), -1).T
        solve = self._direct if self.solver == "sparsecholesky" else self._lagged
        guesses = guess.reshape(len(b), -1).T
        return np.column_stack(
            [solve(*pair) for pair in zip(columns, guesses, strict=True)]
        ).reshape(b.shape)

    def _direct(self, b, guess):
        return multiply(self.inverse, b)

    def _lagged(self, b, guess):
        rhs, x = self.matrix.CreateColVector(), self.matrix.CreateColVector()
        rhs.FV().NumPy()[:] = b
        x.FV().NumPy()[:] = guess
        cg = ng.krylovspace.CGSolver(
            mat=self.matrix, pre=self.inverse, maxiter=40, tol=0, atol=1e-11 * rhs.Norm()
        )
        cg.Solve(rhs=rhs, sol=x, initialize=False)
        if cg.iterations > 12:
            self.inverse.Update()
        return x.FV().NumPy().copy()
