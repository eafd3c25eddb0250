"""Numbers and places of the nodes of a triangulation whose degree is raised, [N] Section 7.1."""

from collections.abc import Callable

import numpy as np

from esfem_core.checks import Array, Ints, finite_array
from esfem_core.elements.lagrange import node_indices
from esfem_core.surfaces import sides_of

__all__ = [
    "IN_ORDER",
    "boundary_nodes",
    "check_cells",
    "flat_triangles",
    "mirrored",
    "number_cells",
    "place_nodes",
]

IN_ORDER = (
    "in the order of VTK, Gmsh and meshio: corners 0, 1, 2, then the edges from 0 to 1, from 1 to "
    "2, from 2 to 0, then the interior; another order is put right by cells[:, permutation]"
)
FARTHEST = 0.5  # an octahedron's nodes move by 0.3 of its sides to the sphere


def number_cells(faces: Ints, degree: int) -> Ints:
    """Number the nodes of each element: vertices, then nodes on edges, then interior nodes."""
    n_vertices, n_cells, per_edge = int(faces.max()) + 1, len(faces), degree - 1
    sides = sides_of(faces)
    along = np.arange(per_edge)
    # Both neighbours number an edge's nodes from its smaller vertex to its larger.
    position = np.where((sides.start < sides.end)[:, None], along, along[::-1])
    on_edges = n_vertices + sides.edge[:, None] * per_edge + position
    per_cell = per_edge * (per_edge - 1) // 2
    inside = np.arange(n_cells * per_cell).reshape(n_cells, per_cell)
    return np.hstack(
        [
            faces,
            on_edges.reshape(n_cells, 3 * per_edge),
            n_vertices + (sides.edge.max() + 1) * per_edge + inside,
        ]
    )


def check_cells(cells: Ints, faces: Ints, degree: int, n_nodes: int) -> None:
    """Refuse elements whose nodes do not fit together: a continuous function could not live there.

    Parameters
    ----------
    cells : (T, (k+1)(k+2)/2) int array
        In VTK's Lagrange order.
    faces : (T, 3) int array
        Their corners, numbered from 0 without gaps.
    degree : int
    n_nodes : int

    Raises
    ------
    ValueError
        With the first element that fails.
    """
    wanted = number_cells(faces, degree)
    if wanted.max() + 1 != n_nodes:
        raise ValueError(
            f"a surface of {len(cells)} such elements has {wanted.max() + 1} nodes, got "
            f"{n_nodes}: neighbours must share the nodes on their edge, and no others; "
            "SurfaceSpace.read makes one of nodes nearer than 1e-6 of the diagonal"
        )
    given = np.zeros(n_nodes, dtype=np.int64)
    given[wanted] = cells
    wrong = (given[wanted] != cells).any(axis=1)
    if wrong.any():
        raise ValueError(
            f"element {np.argmax(wrong)} does not have the nodes of its neighbours on their "
            f"common edge; the nodes of an element must be {IN_ORDER}"
        )
    if len(np.unique(given)) < n_nodes:
        raise ValueError("two nodes of the surface have one number: nodes must not be repeated")


def boundary_nodes(cells: Ints, degree: int) -> Ints:
    """Nodes on the edges that belong to one element only, (B,), in increasing order.

    Parameters
    ----------
    cells : (T, (k+1)(k+2)/2) int array
        In VTK's Lagrange order.
    degree : int
        The degree k.

    Examples
    --------
    >>> boundary_nodes(np.array([[0, 1, 2, 4, 5, 6], [2, 1, 3, 5, 7, 8]]), 2).tolist()
    [0, 1, 2, 3, 4, 6, 7, 8]
    """
    alone = (sides_of(cells[:, :3]).times == 1).reshape(-1, 3)
    inner = 3 + np.arange(3 * (degree - 1)).reshape(3, -1)
    ends = np.array([[0, 1], [1, 2], [2, 0]])
    on_side = np.hstack([ends, inner])  # local nodes of each side
    return np.unique(cells[:, on_side][alone])


def mirrored(degree: int) -> Ints:
    """Where the nodes of an element are found whose corners 1 and 2 change places.

    Examples
    --------
    >>> mirrored(2).tolist()
    [0, 2, 1, 5, 4, 3]
    """
    indices = node_indices(degree)
    place = {tuple(row): i for i, row in enumerate(indices.tolist())}
    return np.array([place[a, c, b] for a, b, c in indices.tolist()])


def place_nodes(
    vertices: Array,
    faces: Ints,
    cells: Ints,
    degree: int,
    project: Callable[[Array], Array] | None,
    first: int,
) -> Array:
    """Put nodes at equal distances on the flat triangles, then project those from `first` on."""
    barycentric = node_indices(degree) / degree
    nodes = np.empty((int(cells.max()) + 1, 3))
    nodes[cells] = barycentric @ vertices[faces]
    nodes[: len(vertices)] = vertices
    if project is None:
        return nodes
    new = nodes[first:]
    moved = finite_array("project(points)", project(new.copy()), new.shape)
    _check_near(moved, new, vertices, faces, cells, first)
    nodes[first:] = moved
    return nodes


def _check_near(
    moved: Array, new: Array, vertices: Array, faces: Ints, cells: Ints, first: int
) -> None:
    """Refuse a projection to another surface than that of the triangulation."""
    sides = vertices[faces] - vertices[np.roll(faces, 1, axis=1)]
    longest = np.zeros(len(new) + first)  # side of the triangles that a node belongs to
    np.maximum.at(longest, cells, np.linalg.norm(sides, axis=2).max(axis=1)[:, None])
    distance = np.linalg.norm(moved - new, axis=1)
    share = distance / longest[first:]
    if share.max(initial=0.0) > FARTHEST:
        i = int(np.argmax(share))
        raise ValueError(
            f"project must move nodes to the surface that the triangulation is near, by at most "
            f"{FARTHEST:g} times the longest side of a triangle there, but it moves "
            f"{new[i].round(6).tolist()} to {moved[i].round(6).tolist()}, by {share[i]:.3g} times: "
            "is it the projection to this surface, and the triangulation fine enough?"
        )


def flat_triangles(cells: Ints, degree: int) -> Ints:
    """Split each element of degree k into k² flat triangles between its nodes.

    Parameters
    ----------
    cells : (T, (k+1)(k+2)/2) int array
        Node numbers in VTK's Lagrange order.
    degree : int
        The degree k.

    Returns
    -------
    (k² T, 3) int array
        Triangles with the orientation of their element, the k² of an element in succession.

    Examples
    --------
    >>> flat_triangles(np.array([[0, 1, 2, 3, 4, 5]]), 2).tolist()
    [[0, 3, 5], [3, 4, 5], [3, 1, 4], [5, 4, 2]]
    """
    number = {(int(b), int(c)): i for i, (_, b, c) in enumerate(node_indices(degree))}
    local = []
    for c in range(degree):
        for b in range(degree - c):
            local.append([number[b, c], number[b + 1, c], number[b, c + 1]])
            if b + c < degree - 1:
                local.append([number[b + 1, c], number[b + 1, c + 1], number[b, c + 1]])
    return cells[:, np.array(local)].reshape(-1, 3)
