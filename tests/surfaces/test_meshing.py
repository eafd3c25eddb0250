"""Meshes of level sets: topology, quality, area, and refusals that say why."""

import re
import sys

import numpy as np
import pytest
from level_sets import BOXES, EULER, ellipsoid, torus, two_rings, unit_sphere

import esfem_core as ec
from esfem_core.study import observed_orders

BOX = BOXES[unit_sphere]


def name(d):
    return d.__name__


@pytest.mark.parametrize(("d", "h"), [(d, h) for d in BOXES for h in (0.2, 0.12)])
def test_meshes_have_the_topology_the_quality_and_the_place_that_are_promised(d, h):
    tri = ec.from_level_set(d, BOXES[d], h)
    ec.check_triangulation(tri)
    q = ec.mesh_quality(tri)
    assert q.euler == tri.euler_number == EULER[d]
    assert np.abs(d(np.array(tri.vertices))).max() < 1e-12
    assert q.min_angle >= 30
    assert q.mean_ratio >= 0.96
    assert q.h_min >= 0.6 * h
    assert q.h_max <= 1.6 * h
    assert 0.8 * h < q.h_mean < 1.05 * h
    gradient = np.array([d(tri.vertices + e) - d(tri.vertices - e) for e in 1e-6 * np.eye(3)]).T
    assert (np.sum(gradient * tri.vertex_normals, axis=1) > 0).all()


def areas(d, sizes, degree):
    """Areas of Γ_h, and the lengths h_max."""
    result = []
    for h in sizes:
        tri = ec.from_level_set(d, BOXES[d], h)
        space = ec.SurfaceSpace(tri, degree, ec.project_to_level_set(d))
        x = space.nodes
        assert np.abs(d(x)).max() < 1e-12
        M, _ = space.mass_stiffness(x)
        result.append((ec.mesh_quality(tri).h_mean, M.sum()))
    return np.transpose(result)


@pytest.mark.parametrize(
    ("d", "exact"), [(unit_sphere, 4 * np.pi), (torus, 4 * np.pi**2 * 0.4)], ids=["sphere", "torus"]
)
@pytest.mark.parametrize(("degree", "order"), [(1, 2), (2, 3), (3, 4)])
def test_area_converges_with_the_order_of_the_elements(d, exact, degree, order):
    """Order k + 1, for even k one more."""
    h, area = areas(d, [0.3, 0.2, 0.12], degree)
    error = np.abs(area / exact - 1)
    assert observed_orders(h[[0, -1]], error[[0, -1]])[0] > order - 0.15


def test_the_volume_of_an_ellipsoid_converges_from_below():
    errors, h = [], []
    for size in (0.3, 0.15):
        tri = ec.from_level_set(ellipsoid, BOXES[ellipsoid], size)
        errors.append(1 - tri.volume / (4 / 3 * np.pi * 1.4))
        h.append(ec.mesh_quality(tri).h_mean)
    assert min(errors) > 0
    assert observed_orders(h, errors)[0] > 1.85


def test_several_components_one_inside_another():
    """A shell: the inner sphere's normals point to its centre."""
    tri = ec.from_level_set(lambda x: np.abs(np.linalg.norm(x, axis=1) - 0.8) - 0.2, BOX, 0.2)
    assert tri.euler_number == 4
    assert tri.volume == pytest.approx(4 / 3 * np.pi * (1 - 0.6**3), rel=0.03)


def test_the_same_input_gives_the_same_mesh():
    first, second = (ec.from_level_set(torus, BOXES[torus], 0.2) for _ in range(2))
    assert np.array_equal(first.vertices, second.vertices)
    assert np.array_equal(first.faces, second.faces)


def test_functions_may_write_into_the_points_that_they_are_given():
    """Also if they leave single points alone."""

    def spoilt(values):
        def function(x):
            returned = values(x)
            x *= 2 - (len(x) == 1)
            return returned

        return function

    def gradient(x):
        return 2 * x

    tri = ec.from_level_set(unit_sphere, BOX, 0.5, gradient)
    same = ec.from_level_set(spoilt(unit_sphere), BOX, 0.5, spoilt(gradient))
    np.testing.assert_array_equal(tri.vertices, same.vertices)


def test_with_a_gradient_and_away_from_the_origin():
    centre = np.array([30.0, -20.0, 10.0])
    tri = ec.from_level_set(
        lambda x: unit_sphere(x - centre),
        np.array(BOX) + centre,
        0.25,
        gradient=lambda x: 2 * (x - centre),
    )
    np.testing.assert_allclose(np.linalg.norm(tri.vertices - centre, axis=1), 1, rtol=1e-13)


def test_a_run_on_a_mesh_conserves_mass():
    """Mass is conserved on a mesh without any symmetry."""
    tri = ec.from_level_set(two_rings, BOXES[two_rings], 0.25)
    space = ec.SurfaceSpace(tri, 2, ec.project_to_level_set(two_rings))
    problem = ec.Problem(u0=lambda x: 1 + x[:, 0], motion=lambda p, t: p)
    states = list(ec.evolve(space, problem, order=2, step=0.1, end=1.0))
    M, _ = space.mass_stiffness(space.nodes)
    amounts = [(M @ s.u).sum() for s in states]
    assert np.ptp(amounts) < 1e-7 * amounts[0]


def drops(x):
    """Two, whose tips meet at the origin."""
    return x[:, 0] ** 2 + x[:, 1] ** 2 - x[:, 2] ** 2 * (1 - x[:, 2] ** 2)


def moved(x, centre):
    return np.linalg.norm(x - centre, axis=1) - 1


REFUSED = {
    "no surface": ((unit_sphere, [[2, 2, 2], [3, 3, 3]], 0.2), "d is positive on the whole grid"),
    "all inside": (
        (unit_sphere, [[-0.2] * 3, [0.2] * 3], 0.2),
        "d is negative on the whole grid",
    ),
    "cut": (
        (unit_sphere, [[-1.3] * 3, [0.5, 1.3, 1.3]], 0.2),
        r"not closed in the box: d is .* at the boundary point \[0\.5, .*larger box",
    ),
    "inside out": ((lambda x: -unit_sphere(x), BOX, 0.2), "outside it must be positive"),
    "h negative": ((unit_sphere, BOX, -1.0), r"h must be a finite number > 0, got -1\.0"),
    "h nan": ((unit_sphere, BOX, np.nan), "h must be a finite number > 0, got nan"),
    "h tiny": ((unit_sphere, BOX, 1e-4), r"h must be larger for this box: with h = 0\.0001"),
    "h and the hole": (
        (lambda x: torus(x, r=0.9), [[-2.1, -2.1, -1.2], [2.1, 2.1, 1.2]], 0.9),
        "got 0.9, which is too large: on a grid of spacing .* Euler number 2 and 1 comp",
    ),
    "h and the curvature": (
        (two_rings, BOXES[two_rings], 0.4),
        r"got 0\.4, which is too large: .* turns by [\d.]+ degrees within a triangle",
    ),
    "between the points of the coarse grid": (
        (lambda x: np.linalg.norm(x - 0.1, axis=1) - 0.2, BOX, 0.5),
        r"h must be smaller for this surface, got 0\.5, .* has no point inside, one of half",
    ),
    "h and a thin tube": (
        (lambda x: torus(x, r=0.05), [[-1.2, -1.2, -0.2], [1.2, 1.2, 0.2]], 0.1),
        r"got 0\.1, which is too large",
    ),
    "a number for a box": ((unit_sphere, 1.0, 0.2), r"bounds must have shape \(2, 3\), got \(\)"),
    "a box without end": (
        (unit_sphere, [[0, 0, 0], [1, 1, np.inf]], 0.2),
        r"bounds must be finite, but bounds\[1, 2\] is inf",
    ),
    "corners swapped": ((unit_sphere, BOX[::-1], 0.2), "bounds must be the lower and the upper"),
    "double zero": ((lambda x: unit_sphere(x) ** 2, BOX, 0.2), "unsigned distance has no inside"),
    "unsigned": ((lambda x: abs(moved(x, 0.0123)), BOX, 0.2), "d must be negative inside, but"),
    "unsigned, zero at points of the grid": (
        (lambda x: abs(moved(x, 0.0)), [[-1.5] * 3, [1.5] * 3], 0.3),
        r"its least value on the grid is 0, at .* an unsigned distance has no inside",
    ),
    "zero": (
        (lambda x: 0 * x[:, 0], BOX, 0.2),
        "zero on the surface only, but is zero on the whole",
    ),
    "beside the box": (
        (unit_sphere, [[1.01, -1, -1], [2, 1, 1]], 0.2),
        "there is no surface in the box: d is positive on the whole grid",
    ),
    "triple zero": (
        (lambda x: unit_sphere(x) ** 3, BOX, 0.2),
        "its gradient vanishes on the surface",
    ),
    "zero gradient": ((unit_sphere, BOX, 0.2, lambda x: 0 * x), "gradient must be that of d"),
    "gradient inwards": ((unit_sphere, BOX, 0.5, lambda x: -x), "gradient must be that of d"),
    "gradient aside": ((unit_sphere, BOX, 0.5, lambda x: 2 * x + 0.3), "gradient must be that of"),
    "h smallest": ((unit_sphere, BOX, 5e-324), r"h must be larger for this box: .* inf points"),
    "h largest": ((unit_sphere, BOX, 1e300), r"h must be at most .*, twice .*, got 1e\+300"),
    "d large": (
        (lambda x: 1e300 * unit_sphere(x), BOX, 0.5),
        r"values of d must be up to 1e\+150, .* small number",
    ),
    "d small": (
        (lambda x: 1e-300 * unit_sphere(x), BOX, 0.5),
        r"gradient of d must be larger than 1e-150, but is \[.*: multiply d by a large number",
    ),
    "d smallest": ((lambda x: 1e-320 * unit_sphere(x), BOX, 0.5), "gradient of d must not vanish"),
    "box large": ((unit_sphere, 1e80 * np.array(BOX), 1e80), r"bounds must be up to 1e\+35"),
    "box small": ((unit_sphere, 1e-80 * np.array(BOX), 1e-80), "1e-35 or more apart"),
    "d constant within h": (
        (lambda x: np.linalg.norm(np.maximum(np.abs(x) - 0.8, 0), axis=1) - 0.1, BOX, 0.3),
        r"is zero at \[.*\], where d = -0\.1: no way leads .* for from_level_set h must be smaller",
    ),
    "spheres that touch": (
        (
            lambda x: np.linalg.norm(np.abs(x) - [0, 0, 0.6], axis=1) - 0.6,
            [[-1.5] * 3, [1.5] * 3],
            0.15,
        ),
        "on the surface: it has a tip there or meets itself, and no h is small enough",
    ),
    "a point where drops meet": (
        (drops, [[-1.6] * 3, [1.6] * 3], 0.16),
        "gradient vanishes: the surface has a tip there or meets itself, and no h is small",
    ),
    "a point where drops meet on a grid": (
        (drops, [[-1.6] * 3, [1.6] * 3], 0.2),
        "2 components, on one of half .* where the surface touches or crosses itself",
    ),
    "a tip": (
        (
            lambda x: np.hypot(np.hypot(x[:, 0], x[:, 1]) + 0.6, x[:, 2]) - 1.05,
            [[-1.2] * 3, [1.2] * 3],
            0.15,
        ),
        "turns by .* where the surface has a crease or a tip, or meets itself, no h is small",
    ),
    "edges": ((lambda x: np.abs(x).sum(axis=1) - 1, BOX, 0.2), "the surface has a crease there"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_surface_that_is_not_in_the_box_or_not_resolved_is_refused(case):
    arguments, message = REFUSED[case]
    with pytest.raises(ValueError, match=message):
        ec.from_level_set(*arguments)


@pytest.mark.parametrize("power", [-100, 100])
def test_a_surface_of_any_size_has_its_mesh(power):
    unit = 2.0**power
    tri = ec.from_level_set(lambda x: unit_sphere(x / unit), unit * np.array(BOX), 0.5 * unit)
    assert tri.euler_number == 2
    np.testing.assert_allclose(np.linalg.norm(tri.vertices, axis=1), unit, rtol=1e-13)


def test_what_cannot_be_reached_is_said():
    """Six vertices cannot have edges of length three on the unit sphere."""
    with pytest.raises(ec.MeshingError, match=r"got 3: a closed mesh of it has edges of 1\.4"):
        ec.from_level_set(unit_sphere, BOX, 3.0)


def test_without_scikit_image_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "skimage.measure", None)
    with pytest.raises(ImportError, match=r'scikit-image: pip install "esfem-core\[mesh\]"$'):
        ec.from_level_set(unit_sphere, BOX, 0.3)


def test_where_triangles_are_too_large_a_crease_is_thought_of():
    def balls(x):
        return np.minimum(*(np.linalg.norm(x - [c, 0, 0], axis=1) - 0.7 for c in (-0.6, 0.6)))

    with pytest.raises(ValueError, match=r"crease .*no h is small enough"):
        ec.from_level_set(balls, [[-1.6] * 3, [1.6] * 3], 0.15)


def test_a_smaller_h_that_is_advised_does():
    with pytest.raises(ValueError, match="try h = ") as found:
        ec.from_level_set(two_rings, BOXES[two_rings], 0.4)
    h = float(re.search(r"try h = ([\d.]+)", str(found.value))[1])
    assert 0.1 < h < 0.4
    ec.check_triangulation(ec.from_level_set(two_rings, BOXES[two_rings], h))
