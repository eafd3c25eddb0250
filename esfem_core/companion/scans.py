"""A surface that somebody else has scanned: the Stanford bunny.

The file ``data/stanford_bunny.ply`` holds a closed version of it, reduced from 35,947 to 1,839
vertices; by whom is not known. The bunny was scanned by the Stanford Computer Graphics Laboratory
(G. Turk, M. Levoy, SIGGRAPH 1994) and comes from the Stanford 3D Scanning Repository,
https://graphics.stanford.edu/data/3Dscanrep/. It is not under this package's licence. The terms of
the repository: it may be used for research, mirrored and redistributed free of charge, and pictured
in scholarly publications, with credit to the laboratory; commercial use needs its permission.
"""

import trimesh

from esfem_core.companion.campaign import DATA

__all__ = ["bunny"]


def bunny() -> trimesh.Trimesh:
    """The Stanford bunny, closed, with 1,839 vertices and 3,674 triangles.

    About ten units tall. Its triangles are those of a scan, with angles between 13 and 150 degrees.

    Returns
    -------
    trimesh.Trimesh

    Examples
    --------
    >>> import esfem_core as ec
    >>> tri = bunny()
    >>> ec.mesh_quality(tri).euler, f"{tri.area:.1f}"
    (2, '218.7')
    """
    return trimesh.load_mesh(DATA / "stanford_bunny.ply")
