"""The same matrices in DOLFINx: quadratic elements and geometry, in a process of its own.

DOLFINx comes with an interpreter of its own (Debian: apt install python3-dolfinx), so this file is
both sides: imported, it starts that interpreter, alone or under mpirun; run as a script, it obeys
what it is told on its standard input.
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

PYTHON = "/usr/bin/python3"
OPTIONS = {"cffi_extra_compile_args": ["-O3", "-march=native"], "cffi_libraries": ["m"]}
DEGREE = 4  # of exactness of the quadrature: 6 points, as in our default for quadratic elements


def reason_against():
    """Why DOLFINx cannot be measured here, or None."""
    if not Path(PYTHON).exists():
        return f"no {PYTHON}"
    found = subprocess.run([PYTHON, "-c", "import dolfinx"], capture_output=True, text=True)
    return found.stderr.strip().rpartition("\n")[2] if found.returncode else None


class Peer:
    """Mass and stiffness matrix on Γ_h[x] by DOLFINx.

    Parameters
    ----------
    space : esfem_core.SurfaceSpace
        Of degree 2.
    x : (N, 3) float array
        Where its nodes are.
    processes : int
    """

    def __init__(self, space, x, processes=1):
        command = [PYTHON, __file__]
        if processes > 1:
            command = ["mpirun", "--allow-run-as-root", "-n", str(processes), *command]
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "mesh.npz"
            u, w = np.random.default_rng(0).standard_normal((2, len(x)))
            np.savez(path, nodes=space.nodes, cells=space.cells, x=x, u=u, w=w)
            self._process = subprocess.Popen(
                [*command, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )
            told = self._ask("describe")
        self.version, self.forms = told["version"], told["forms"]

    def assemble(self):
        """Seconds to assemble both matrices."""
        return self._ask("assemble")["seconds"]

    def close(self):
        """End the process."""
        self._process.communicate("end\n")

    def _ask(self, what):
        self._process.stdin.write(f"{what}\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError("the process with DOLFINx has ended")
        return json.loads(line)


def serve(path):
    """Make the matrices of a mesh once, then assemble them again and again."""
    import dolfinx
    import ufl
    from dolfinx import fem, mesh
    from dolfinx.fem.assemble import create_matrix
    from mpi4py import MPI

    comm = MPI.COMM_WORLD
    given = np.load(path)
    mine = slice(None) if comm.rank == 0 else slice(0)
    cells = given["cells"][:, [0, 1, 2, 4, 5, 3]]  # the edge opposite to corner 0 first
    element = ufl.VectorElement("Lagrange", ufl.Cell("triangle", geometric_dimension=3), 2)
    domain = mesh.create_mesh(comm, cells[mine], given["nodes"][mine], ufl.Mesh(element))
    original = np.array(domain.geometry.input_global_indices)
    domain.geometry.x[:] = given["x"][original]
    V = fem.FunctionSpace(domain, ("Lagrange", 2))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    dx = ufl.dx(domain, metadata={"quadrature_degree": DEGREE})
    forms = [
        fem.form(form * dx, jit_params=OPTIONS)
        for form in (u * w, ufl.inner(ufl.grad(u), ufl.grad(w)))
    ]
    matrices = [create_matrix(form) for form in forms]

    def assemble():
        comm.Barrier()
        start = time.perf_counter()
        for matrix, form in zip(matrices, forms, strict=True):
            matrix.set(0.0)
            fem.assemble_matrix(matrix, form)
            matrix.finalize()
        comm.Barrier()
        return time.perf_counter() - start

    def products():
        """Return w' M u and w' A u of the nodal values that were given, in one process."""
        if comm.size > 1:
            return None
        node_of_dof = np.empty(V.dofmap.index_map.size_local, int)
        node_of_dof[V.dofmap.list.array] = original[domain.geometry.dofmap.array]
        found = []
        for matrix in matrices:
            row = np.repeat(np.arange(len(matrix.indptr) - 1), np.diff(matrix.indptr))
            values = given["w"][node_of_dof[row]] * given["u"][node_of_dof[matrix.indices]]
            found.append(float(values @ matrix.data))
        return found

    def told():
        """The next line of the input, on all processes; to wait for it takes no processor."""
        if comm.rank == 0:
            line = sys.stdin.readline().strip()
            for other in range(1, comm.size):
                comm.send(line, other)
            return line
        while not comm.iprobe(0):
            time.sleep(5e-4)
        return comm.recv(source=0)

    while True:
        line = told()
        answer = None
        if line == "assemble":
            answer = {"seconds": assemble()}
        elif line == "describe":
            assemble()
            answer = {"version": dolfinx.__version__, "forms": products()}
        if answer is None:
            return
        if comm.rank == 0:
            print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    serve(sys.argv[1])
