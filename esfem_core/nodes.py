"""Numbers and places of the nodes that a triangulation gets when its degree is raised."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from esfem_core.lagrange import node_indices

__all__ = ["number_cells", "place_nodes"]

Array = NDArray[np.float64]


def number_cells(faces: NDArray[np.int64], degree: int) -> NDArray[np.int64]:
    """Number the nodes of each element: vertices, then nodes on edges, then interior nodes."""
    n_vertices, n_cells, per_edge = int(faces.max()) + 1, len(faces), degree - 1
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges, number = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True)
    along = np.arange(per_edge)
    # Both neighbours number an edge's nodes from its smaller vertex to its larger.
    position = np.where((directed[:, 0] < directed[:, 1])[:, None], along, along[::-1])
    on_edges = n_vertices + number.reshape(-1, 1) * per_edge + position
    per_cell = per_edge * (per_edge - 1) // 2
    inside = np.arange(n_cells * per_cell).reshape(n_cells, per_cell)
    return np.hstack(
        [
            faces,
            on_edges.reshape(n_cells, 3 * per_edge),
            n_vertices + len(edges) * per_edge + inside,
        ]
    )


def place_nodes(
    vertices: Array,
    faces: NDArray[np.int64],
    cells: NDArray[np.int64],
    degree: int,
    project: Callable[[Array], Array] | None,
) -> Array:
    """Put nodes at equal distances on the flat triangles, then project the new ones."""
    barycentric = node_indices(degree) / degree
    nodes = np.empty((int(cells.max()) + 1, 3))
    nodes[cells] = barycentric @ vertices[faces]
    nodes[: len(vertices)] = vertices
    if project is None:
        return nodes
    new = nodes[len(vertices) :]
    moved = np.asarray(project(new.copy()), dtype=float)
    if moved.shape != new.shape:
        raise ValueError(f"project must return an array of shape {new.shape}, got {moved.shape}")
    if not np.isfinite(moved).all():
        i = int(np.argmin(np.isfinite(moved).all(axis=1)))
        raise ValueError(f"project returned {moved[i].tolist()} for the point {new[i].tolist()}")
    nodes[len(vertices) :] = moved
    return nodes
