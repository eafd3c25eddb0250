"""The same discretisation in NGSolve: quadratic elements on the same mesh, moved by a deformation.

NGSolve's basis is hierarchical (vertex functions and edge bubbles), ours nodal; both span the same
space, and :class:`Peer` converts between nodal values and NGSolve's coefficients.
"""

import netgen.meshing as nm
import ngsolve as ng
import numpy as np
import scipy.sparse as sp

INTEGRATION_ORDER = 4  # the 6-point rule on triangles, as in our default for quadratic elements


class Peer:
    """Mass and stiffness matrix on Γ_h[x] by NGSolve.

    Parameters
    ----------
    space : esfem_core.SurfaceSpace
        Of degree 2.
    """

    def __init__(self, space):
        self.space = space
        n_vertices = int(space.cells[:, :3].max()) + 1
        mesh = nm.Mesh(dim=3)
        points = [mesh.Add(nm.MeshPoint(nm.Pnt(*p))) for p in space.nodes[:n_vertices]]
        mesh.Add(nm.FaceDescriptor(surfnr=1, domin=1, domout=0, bc=1))
        for a, b, c in space.cells[:, :3]:
            mesh.Add(nm.Element2D(1, [points[a], points[b], points[c]]))
        self.mesh = ng.Mesh(mesh)
        self.fes = ng.H1(self.mesh, order=2)
        self.vector = ng.VectorH1(self.mesh, order=2)
        self._number_edges(n_vertices)

        self.base = space.nodes.copy()
        ends = self.edges[:, 1:]
        self.base[self.edges[:, 0]] = self.base[ends].mean(axis=1)
        self.deformation = ng.GridFunction(self.vector)
        self.mesh.SetDeformation(self.deformation)

        u, w = self.fes.TnT()
        ds = ng.ds(intrules={ng.TRIG: ng.IntegrationRule(ng.TRIG, INTEGRATION_ORDER)})
        self.ds = ds
        self.M = ng.BilinearForm(u * w * ds, symmetric=False)
        self.A = ng.BilinearForm(ng.grad(u).Trace() * ng.grad(w).Trace() * ds, symmetric=False)

    def _number_edges(self, n_vertices):
        """Edges as rows (our edge node, end, end) in NGSolve's order, and the bubbles' height."""
        cells = self.space.cells
        node_of = {}
        for column, (a, b) in zip((3, 4, 5), ((0, 1), (1, 2), (2, 0)), strict=True):
            for node, i, j in cells[:, [column, a, b]].tolist():
                node_of[min(i, j), max(i, j)] = node
        rows, dofs = [], []
        for edge in self.mesh.edges:
            i, j = sorted(v.nr for v in edge.vertices)
            rows.append((node_of[i, j], i, j))
            (dof,) = self.fes.GetDofNrs(edge)
            dofs.append(dof)
        self.edges, self.edge_dofs = np.array(rows), np.array(dofs)
        self.vertex_dofs = np.array(
            [self.fes.GetDofNrs(ng.NodeId(ng.VERTEX, i))[0] for i in range(n_vertices)]
        )
        bubble = ng.GridFunction(self.fes)
        bubble.vec[:] = 0
        bubble.vec[int(self.edge_dofs[0])] = 1
        touching = cells[(cells == self.edges[0, 0]).any(axis=1), :3]
        a, b, c = self.space.nodes[touching.T]
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
        mean = ng.Integrate(bubble * ng.ds, self.mesh) / area
        self.height = 3 * mean  # a quadratic bubble 4 l_i l_j has mean 1/3

    def coefficients(self, nodal):
        """NGSolve's coefficients, (ndof, ...), of nodal values (N, ...)."""
        out = np.empty_like(nodal)
        node, i, j = self.edges.T
        out[self.vertex_dofs] = nodal[: len(self.vertex_dofs)]
        out[self.edge_dofs] = (nodal[node] - (nodal[i] + nodal[j]) / 2) / self.height
        return out

    def nodal(self, coefficients):
        """Nodal values of NGSolve's coefficients."""
        out = np.empty_like(coefficients)
        node, i, j = self.edges.T
        out[: len(self.vertex_dofs)] = coefficients[self.vertex_dofs]
        out[node] = coefficients[self.edge_dofs] * self.height + (out[i] + out[j]) / 2
        return out

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


def evolve(space, order, step, n_steps, radius, solver="sparsecholesky"):
    """[N] (2.19)-(2.21) for the expanding sphere with the smooth coupling, alpha = beta = 1.

    As a user of NGSolve would write it: matrices and loads by symbolic forms on the deformed
    surface, both systems factorised in every step with the symbolic factorisation kept
    (``sparsecholesky``), or solved by NGSolve's conjugate gradients with the factorisation of an
    earlier step (``lagged``).

    Parameters
    ----------
    space : esfem_core.SurfaceSpace
    order, step, n_steps : int, float, int
    radius : callable
        t -> r, r'.
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
