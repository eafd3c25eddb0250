"""How good the triangles of a mesh are."""

import math
from dataclasses import dataclass

import numpy as np
import trimesh

from esfem_core.checks import Array
from esfem_core.surfaces.faults import check_is_trimesh
from esfem_core.surfaces.orientation import sides_of
from esfem_core.tables import html_table

__all__ = ["Quality", "angles_of", "mesh_quality"]


@dataclass(frozen=True)
class Quality:
    """Shape and size of triangles; displays as a table in a notebook.

    Attributes
    ----------
    vertices, triangles : int
    euler : int
        The Euler number V - E + F of the vertices that belong to triangles: on a closed mesh
        2 (components - handles).
    min_angle, max_angle : float
        In degrees; 60 for equilateral triangles.
    mean_ratio, min_ratio : float
        Ratio of radii 2 r_in/r_out, 1 for equilateral triangles, 0 for degenerate ones.
    h_min, h_mean, h_max : float
        Lengths of the edges, each of which counts once in the mean, also at a boundary.
    """

    vertices: int
    triangles: int
    euler: int
    min_angle: float
    max_angle: float
    mean_ratio: float
    min_ratio: float
    h_min: float
    h_mean: float
    h_max: float

    @property
    def uniformity(self) -> float:
        """h_max/h_min, infinite if an edge has no length."""
        return self.h_max / self.h_min if self.h_min > 0 else math.inf

    def _rows(self) -> list[tuple[str, str]]:
        return [
            ("vertices", str(self.vertices)),
            ("triangles", str(self.triangles)),
            ("Euler number", str(self.euler)),
            ("smallest angle", f"{self.min_angle:.1f}°"),
            ("largest angle", f"{self.max_angle:.1f}°"),
            ("ratio of radii, mean", f"{self.mean_ratio:.3f}"),
            ("ratio of radii, smallest", f"{self.min_ratio:.3f}"),
            ("edges", f"{self.h_min:.3g} … {self.h_max:.3g}, mean {self.h_mean:.3g}"),
            ("longest edge over shortest", f"{self.uniformity:.2f}"),
        ]

    def __str__(self) -> str:
        return "\n".join(f"{name}: {value}" for name, value in self._rows())

    def _repr_html_(self) -> str:
        return html_table(["quality", ""], self._rows()).text


def angles_of(corners: Array) -> Array:
    """Angles of triangles (T, 3, 3) at their corners, (T, 3), in radians.

    They are 0 at corners that coincide.

    Examples
    --------
    >>> np.degrees(angles_of(np.eye(3)[None])).round(10).tolist()
    [[60.0, 60.0, 60.0]]
    """
    after = np.roll(corners, -1, axis=1) - corners
    before = np.roll(corners, 1, axis=1) - corners
    sine = np.linalg.norm(np.cross(after, before), axis=2)
    cosine = (after * before).sum(axis=2) + 0.0  # of -0.0, arctan2 would make half a turn
    return np.asarray(np.arctan2(sine, cosine))


def mesh_quality(tri: trimesh.Trimesh) -> Quality:
    """Measure the triangles of a mesh.

    Parameters
    ----------
    tri : trimesh.Trimesh

    Returns
    -------
    Quality

    Raises
    ------
    TypeError, ValueError
        If `tri` is not a :class:`trimesh.Trimesh`, has no triangles, or triangles with corners
        that are missing or not finite.

    Examples
    --------
    >>> import esfem_core as ec
    >>> q = mesh_quality(ec.sphere("icosahedron", 3))
    >>> print(f"{q.euler} {q.min_angle:.1f} {q.mean_ratio:.3f} {q.uniformity:.2f}")
    2 54.1 0.987 1.19
    """
    check_is_trimesh("tri", tri)
    if len(tri.faces) == 0:
        raise ValueError("tri must have triangles, got none")
    vertices, faces = np.asarray(tri.vertices, dtype=float), np.asarray(tri.faces)
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError(
            f"tri must have triangles of its vertices, 0 to {len(vertices) - 1}, but they name "
            f"{faces.min()} to {faces.max()}"
        )
    corners = vertices[faces]
    if not np.isfinite(corners).all():
        i = int(faces[~np.isfinite(corners).all(axis=2)].min())
        raise ValueError(f"tri must have finite vertices, but vertex {i} is {vertices[i].tolist()}")
    _, scale = np.frexp(np.abs(corners).max())  # a power of 2: it rounds nothing
    corners = np.ldexp(corners, -scale)
    sides = np.roll(corners, -1, axis=1) - corners
    lengths = np.linalg.norm(sides, axis=2)
    double_area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    angles = np.degrees(angles_of(corners))
    products = lengths.sum(axis=1) * lengths.prod(axis=1)
    ratio = 4 * double_area**2 / np.where(products > 0, products, 1)  # 0 if corners coincide
    edges = sides_of(faces)
    return Quality(
        vertices=len(tri.vertices),
        triangles=len(tri.faces),
        euler=len(np.unique(faces)) - int(edges.edge.max()) - 1 + len(faces),
        min_angle=float(angles.min()),
        max_angle=float(angles.max()),
        mean_ratio=float(ratio.mean()),
        min_ratio=float(ratio.min()),
        h_min=float(np.ldexp(lengths.min(), scale)),
        h_mean=float(np.ldexp(np.average(lengths, weights=1 / edges.times.reshape(-1, 3)), scale)),
        h_max=float(np.ldexp(lengths.max(), scale)),
    )
