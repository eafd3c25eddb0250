"""The scanned surface is found wherever the package is, and fit for a space."""

import esfem_core as ec
from esfem_core.companion import bunny


def test_the_bunny_is_closed_and_accepted_as_it_is():
    tri = bunny()
    ec.check_triangulation(tri)
    quality = ec.mesh_quality(tri)
    assert (quality.vertices, quality.triangles, quality.euler) == (1839, 3674, 2)
    assert len(ec.SurfaceSpace(tri).nodes) == 1839


def test_the_bunny_is_a_new_object_each_time():
    first = bunny()
    first.apply_scale(2)
    assert bunny().area < 0.3 * first.area
