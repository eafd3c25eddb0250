"""Mean curvature flow with evolved normal and curvature: closed forms, orders, equations."""

from functools import partial

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from temporal import fine_run, temporal_orders

import esfem_core as ec
from esfem_core.elements import nodal_average, smoothed
from esfem_core.study import final, observed_orders

TORUS = ec.exact_surfaces.Torus(1.0, 0.4)
ELLIPSOID = ec.exact_surfaces.Ellipsoid((1.3, 1.0, 0.8))
BETA = 0.1


def torus_space(n, m, degree=2):
    return ec.SurfaceSpace(ec.torus(1.0, 0.4, n, m), degree, TORUS.closest)


def ellipsoid_space(refinements=1, degree=2):
    tri = ec.sphere("icosahedron", refinements)
    tri.vertices = ELLIPSOID.closest(tri.vertices * ELLIPSOID.axes)
    return ec.SurfaceSpace(tri, degree, ELLIPSOID.closest)


def radius(t):
    """Of the tube of a torus that breathes."""
    return 0.4 + 0.1 * np.sin(2 * t)


def speed(t):
    return 0.2 * np.cos(2 * t)


def curvature(x, t):
    """H of the torus around the same circle that passes through x."""
    rho = np.hypot(x[..., 0], x[..., 1])
    s = np.hypot(rho - 1, x[..., 2])
    cosine = (rho - 1) / s
    return 1 / s + cosine / (1 + s * cosine)


def g(x, t):
    """With V = r' the law asks for g = r' + beta H."""
    return speed(t) + BETA * curvature(x, t)


def g_at(at):
    return g(at.points, at.t)


BREATHING = ec.Exact(
    lambda p, t: p + (radius(t) - 0.4) * TORUS.normal(p),
    lambda p, t: speed(t) * TORUS.normal(p),
    fields={"normal": lambda x, t: TORUS.normal(x), "H": curvature},
)
KLL = ec.laws.MeanCurvature(BETA, g, TORUS.normal, TORUS.mean_curvature)


def l2(space, x, e):
    return float(np.sqrt(np.sum(e * (space.mass(x) @ e))))


def torus_table(law, sizes, exact=BREATHING, degree=2, step=1 / 40):
    """Errors (x L2, x H1, v L2, v H1) at t = 1/2 on several meshes, their orders, and h."""
    rows, h = [], []
    for n, m in sizes:
        space, problem = torus_space(n, m, degree), ec.Problem(law=law, exact=exact)
        last = final(ec.evolve(space, problem, 3, step, 0.5))
        rows.append(ec.errors.compare(space, problem, last)[:4])
        h.append(space.mesh_size(space.nodes))
    errors = np.array(rows)
    return errors, [observed_orders(h, column) for column in errors.T]


@pytest.mark.filterwarnings("ignore:alpha = 0")
def test_quadratic_elements_on_a_torus_beside_dziuks_scheme():
    """Orders 4 and 3 against the nodal interpolant, where alpha = 0 has 2 and 1."""
    sizes = [(16, 8), (24, 12), (32, 16)]
    errors, orders = torus_table(KLL, sizes, step=1 / 100)
    assert min(orders[0][-1], orders[2][-1]) > 3.8
    assert min(orders[1][-1], orders[3][-1]) > 2.9
    finer = torus_table(KLL, sizes[-1:], step=1 / 200)[0][0]
    np.testing.assert_allclose(errors[-1], finer, rtol=0.05)  # the temporal error is small
    dziuk, low = torus_table(ec.laws.Regularised(0, BETA, g_at), sizes, step=1 / 80)
    assert (dziuk[-1, :2] > 100 * errors[-1, :2]).all()
    assert low[0][-1] == pytest.approx(2.1, abs=0.2)
    assert low[1][-1] == pytest.approx(1.1, abs=0.2)


@pytest.mark.parametrize(
    ("law", "exact"),
    [
        (ec.laws.MeanCurvature(BETA, g_at, TORUS.normal, TORUS.mean_curvature), BREATHING),
        (ec.laws.MeanCurvature(BETA, g), ec.Exact(BREATHING.x, BREATHING.v)),
    ],
    ids=["g(at)", "from the mesh"],
)
def test_orders_with_projected_g_and_with_initial_values_from_the_mesh(law, exact):
    _, orders = torus_table(law, [(16, 8), (24, 12)], exact)
    assert min(orders[0][-1], orders[2][-1]) > 3.5
    assert min(orders[1][-1], orders[3][-1]) > 2.9


@pytest.mark.parametrize(("degree", "low", "high"), [(1, 2.0, 2.0), (3, 4.0, 3.2)])
def test_orders_of_other_degrees(degree, low, high):
    """Order 2 in both norms for degree 1, outside the theory; k + 1 and k at least for degree 3."""
    _, orders = torus_table(KLL, [(16, 8), (24, 12), (32, 16)], degree=degree, step=1 / 80)
    assert orders[0][-1] > low
    assert orders[1][-1] > high


def coupled(law):
    return ec.Problem(species={"u": ec.Species(lambda x: 1 + x[:, 0] * x[:, 1])}, law=law)


ON_ELLIPSOID = coupled(
    ec.laws.MeanCurvature(0.5, lambda at: 0.3 * at.u, ELLIPSOID.normal, ELLIPSOID.mean_curvature)
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("space", "problem"),
    [(torus_space(12, 6), ec.Problem(law=KLL)), (ellipsoid_space(), ON_ELLIPSOID)],
    ids=["torus", "ellipsoid with g(u)"],
)
def test_orders_in_time(space, problem):
    """Of x, v, u, the normal and H, for all p."""
    fine = fine_run(space, problem, 1 / 1280, 0.4, settled=0.1)
    for p in range(1, 6):
        for name, order in temporal_orders(space, problem, p, [1 / 160, 1 / 320], fine).items():
            assert order == pytest.approx(p, abs=0.35), (p, name)


def test_a_sphere_shrinks_as_it_should():
    """r^2 = 1 - 4 beta t, nu = x/r, H = 2/r: by exact and by Euler starts, and from the mesh."""
    sphere = ec.exact_surfaces.Sphere()
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), 2, sphere.closest)
    exact = ec.Exact(
        lambda p, t: np.sqrt(1 - 4 * t) * p,
        lambda p, t: -2 / np.sqrt(1 - 4 * t) * p,
        fields={
            "normal": lambda x, t: ec.to_unit_sphere(x),
            "H": lambda x, t: 2 / np.linalg.norm(x, axis=-1),
        },
    )
    given = ec.laws.MeanCurvature(1.0, None, sphere.normal, sphere.mean_curvature)
    for law, start in [
        (given, "exact"),
        (given, "euler"),
        (ec.laws.MeanCurvature(1.0), "euler"),
    ]:
        problem = ec.Problem(law=law, exact=exact)
        last = final(ec.evolve(space, problem, 4, 1 / 400, 0.2, start=start))
        r = np.sqrt(0.2)
        np.testing.assert_allclose(np.linalg.norm(last.x, axis=1), r, rtol=4e-4)
        np.testing.assert_allclose(last["H"], 2 / r, rtol=4e-4)
        np.testing.assert_allclose(last["normal"], space.nodes, atol=4e-4)


@pytest.mark.parametrize("p", [1, 2, 3])
def test_a_step_solves_the_equations_as_they_are_written(p):
    """Assembled from their definition, with g(u), by other means than the law's."""
    space, law, step = ellipsoid_space(), ON_ELLIPSOID.law, 0.01
    states = list(ec.evolve(space, ON_ELLIPSOID, p, step, step * (p + 2), solver="direct"))
    new, past = states[-1], states[-2 : -2 - p : -1]
    gamma, delta = ec.bdf.gamma(p), ec.bdf.delta(p)
    x, nu, H, u = (
        sum(c * w for c, w in zip(gamma, values, strict=True))
        for values in zip(*((s.x, s["normal"], s["H"], s.u) for s in past), strict=True)
    )
    M, A = space.mass_stiffness(x)
    square = (space.gradient(x, nu) ** 2).sum(axis=(2, 3)) / (space.evaluate(nu) ** 2).sum(axis=2)
    grad_g = 0.3 * space.gradient(x, u)
    at = ec.Surface(space, x)
    loads = {
        "normal": at.load(0.5 * square[..., None] * space.evaluate(nu) - grad_g),
        "H": at.load(square * space.evaluate(0.5 * H - 0.3 * u), grad_g),
    }
    for name, load in loads.items():
        change = sum(d * s[name] for d, s in zip(delta, [new, *past], strict=True)) / step
        residual = M @ change + 0.5 * A @ new[name] - load
        assert abs(residual).max() < 1e-11 * abs(M @ change).max()
    v = (0.3 * u - law.beta * new["H"])[:, None] * new["normal"]
    np.testing.assert_allclose(new.v, v, atol=1e-12)


def test_initial_values_from_the_mesh_have_order_three():
    """L2 errors of normal and curvature on an ellipsoid, where those of the elements have 2."""
    errors, h = [], []
    for refinements in (2, 3):
        space = ellipsoid_space(refinements)
        values = ec.laws.MeanCurvature().initial(ec.Surface(space, space.nodes))
        near = ELLIPSOID.near(space.nodes)
        errors.append(
            [
                l2(space, space.nodes, values["normal"] - near.normal),
                l2(space, space.nodes, values["H"] - near.mean_curvature),
            ]
        )
        h.append(space.mesh_size(space.nodes))
    for column in np.array(errors).T:
        assert observed_orders(h, column)[0] > 2.7


def test_initial_values_of_a_level_set():
    level_set = ec.exact_surfaces.LevelSet(lambda x: (x**2 / np.square([1.3, 1, 0.8])).sum(1) - 1)
    x = ellipsoid_space().nodes
    np.testing.assert_allclose(level_set.normal(x), ELLIPSOID.normal(x), atol=1e-9)
    np.testing.assert_allclose(level_set.mean_curvature(x), ELLIPSOID.mean_curvature(x), rtol=1e-8)


def test_averages_keep_finite_element_functions():
    space = ellipsoid_space()
    at = ec.Surface(space, space.nodes, np.random.default_rng(0).standard_normal((162, 2)))
    np.testing.assert_allclose(nodal_average(at, at.u), at.fields["u"], atol=1e-13)
    np.testing.assert_allclose(smoothed(at, np.ones(at.density.shape)), 1, atol=1e-12)


def test_a_step_solves_one_system_with_four_right_hand_sides():
    statistics = ec.Statistics()
    space, law = torus_space(12, 6), ec.laws.MeanCurvature(BETA, g_at)
    final(ec.evolve(space, ec.Problem(law=law), 1, 0.01, 0.1, statistics=statistics))
    assert statistics.solves == {"normal and H": 10}


def test_a_run_that_goes_on_gives_the_same_bits():
    space = ellipsoid_space()
    run = {"order": 3, "step": 0.01, "end": 0.1, "solver": "direct"}
    states = list(ec.evolve(space, ON_ELLIPSOID, **run))
    again = final(ec.evolve(space, ON_ELLIPSOID, **run, start=states[4:7]))
    for name in ("normal", "H", "u"):
        np.testing.assert_array_equal(again[name], states[-1][name])
    np.testing.assert_array_equal(again.x, states[-1].x)


def test_refused():
    with pytest.raises(ValueError, match="beta must be a finite number > 0, got 0"):
        ec.laws.MeanCurvature(0)
    with pytest.raises(TypeError, match=r"g must be a function g\(at\) or g\(x, t\), or None"):
        ec.laws.MeanCurvature(1.0, 3.0)
    space, lacking = torus_space(12, 6), ec.Exact(BREATHING.x, BREATHING.v)
    with pytest.raises(ValueError, match="needs exact values of 'normal', 'H'"):
        ec.evolve(space, ec.Problem(law=KLL, exact=lacking), 1, 0.1, 0.1, start="exact")
    wrong = ec.Problem(law=ec.laws.MeanCurvature(1.0, lambda x, t: x))
    with pytest.raises(ValueError, match=r"g\(x, t\) must have shape \(288,\)"):
        final(ec.evolve(space, wrong, 1, 0.1, 0.1))


SPHERE = ec.exact_surfaces.Sphere()


@pytest.mark.parametrize(
    "normal",
    [
        lambda x: -x,
        lambda x: 3 * x,
        lambda x: 0 * x,
        lambda x: np.cross(x, [0, 0, 1]),
        lambda x: np.where(np.arange(len(x))[:, None] == 5, -x, x),
    ],
)
def test_what_is_no_outward_normal_is_refused_before_a_step(normal):
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)
    for given in (normal, normal(space.nodes)):
        law = ec.laws.MeanCurvature(1.0, None, given, SPHERE.mean_curvature)
        with pytest.raises(
            ValueError, match="normal must point outwards and have length one, but at"
        ):
            next(iter(ec.evolve(space, ec.Problem(law=law), 1, 0.1, 0.1)))


def test_a_curvature_of_the_other_sign_is_refused_before_a_step():
    space = torus_space(12, 6)
    law = ec.laws.MeanCurvature(1.0, None, TORUS.normal, lambda x: -TORUS.mean_curvature(x))
    with pytest.raises(
        ValueError, match=r"curvature must be .* positive for a sphere, but has the o"
    ):
        next(iter(ec.evolve(space, ec.Problem(law=law), 1, 0.1, 0.1)))


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("normal", [None, TORUS.normal])
def test_the_mean_of_the_principal_curvatures_is_no_curvature(normal, degree):
    """On the coarsest torus, too, where the sum itself is taken."""
    space = ec.SurfaceSpace(ec.torus(n=6, m=4), degree, TORUS.closest)
    at = ec.Surface(space, space.nodes)
    ec.laws.MeanCurvature(1.0, None, normal, TORUS.mean_curvature).initial(at)
    half = ec.laws.MeanCurvature(1.0, None, normal, lambda x: TORUS.mean_curvature(x) / 2)
    with pytest.raises(
        ValueError, match=r"sum of .* 2/r on a sphere, but is about 0\.(49|5) times"
    ):
        half.initial(at)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_curvature_is_that_of_the_surface_however_far_away_it_lies(sign):
    """Its sign and size are looked at on the surface moved to the origin."""
    tri = ec.surfaces.displaced(ec.sphere("icosahedron", 2), 0.2, ELLIPSOID.closest)
    space = ec.SurfaceSpace(tri)
    given = ELLIPSOID.normal(space.nodes), ELLIPSOID.mean_curvature(space.nodes)
    law = ec.laws.MeanCurvature(normal=given[0], curvature=given[1])
    found = law.initial(ec.Surface(space, space.nodes + np.array([sign * 1e7, 0, 0])))
    np.testing.assert_array_equal(found["H"], given[1])


def test_no_curvature_at_all_is_refused():
    space = torus_space(8, 5)
    flat = ec.laws.MeanCurvature(curvature=np.zeros(len(space.nodes)))
    with pytest.raises(ValueError, match="but is about 0 times that of the surface"):
        flat.initial(ec.Surface(space, space.nodes))


def test_a_curvature_that_the_mesh_does_not_resolve_is_taken():
    disk = ec.exact_surfaces.Ellipsoid((1, 1, 0.1))  # of curvature 110 at the rim
    tri = ec.sphere("octahedron", 1)
    tri.vertices = tri.vertices * [1, 1, 0.1]
    space = ec.SurfaceSpace(tri, 1)
    law = ec.laws.MeanCurvature(normal=disk.normal, curvature=disk.mean_curvature)
    assert law.initial(ec.Surface(space, space.nodes))["H"].max() > 100


def test_the_length_of_the_normal_is_at_rest_where_the_surface_is():
    """A normal of length 1 + eps neither grows nor decays on a sphere that a force holds."""
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), 2, ec.to_unit_sphere)
    sphere = ec.exact_surfaces.Sphere()

    def longer(x):
        return 1.01 * sphere.normal(x)

    law = ec.laws.VolumePreserving(ec.laws.MeanCurvature(1.0, None, longer, sphere.mean_curvature))
    last = final(ec.evolve(space, ec.Problem(law=law), 2, 1 / 50, 1.0, start="euler"))
    length = np.linalg.norm(last["normal"], axis=1)
    assert abs(length - 1.01).max() < 1e-3  # exp(4) times 0.01 without the division


def test_a_speed_that_is_a_number_holds_at_all_points():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)
    ends = [
        final(ec.evolve(space, ec.Problem(law=ec.laws.MeanCurvature(1.0, g)), 1, 0.01, 0.02)).x
        for g in (lambda x, t: 2, lambda x, t: np.full(len(x), 2.0))
    ]
    np.testing.assert_array_equal(*ends)
    for wrong, text in ((None, "None"), ("2", "'2'"), (2j, "2j")):
        problem = ec.Problem(law=ec.laws.MeanCurvature(1.0, lambda x, t, wrong=wrong: wrong))
        with pytest.raises(TypeError, match=rf"g\(x, t\) must hold real numbers, got .*{text}"):
            final(ec.evolve(space, problem, 1, 0.01, 0.02))


def test_a_law_of_ones_own_may_have_another_forcing():
    class Pushed(ec.laws.MeanCurvature):
        def forcing(self, at):
            return np.full(len(at.x), 2.0)

    space = ec.SurfaceSpace(ec.sphere("octahedron", 2), 2, ec.to_unit_sphere)
    for law in (Pushed(), ec.laws.VolumePreserving(Pushed())):
        last = final(ec.evolve(space, ec.Problem(law=law), 2, 0.01, 0.1))
        np.testing.assert_allclose(np.linalg.norm(last.x, axis=1), 1, atol=2e-3)


def test_arguments_without_defaults_tell_functions_of_points_from_those_of_a_surface():
    for wrong, found in ((lambda: 0.0, "none"), (lambda x, t, u: 0.0, "3")):
        message = rf"g must be g\(at\) or g\(x, t\), .* without defaults, got {found}"
        with pytest.raises(ValueError, match=message):
            ec.laws.MeanCurvature(g=wrong)
    with pytest.raises(
        ValueError, match=r"got \*args, which .* write lambda at: g\(at\), or lambda"
    ):
        ec.laws.MeanCurvature(g=lambda *given: 0.0)
    with pytest.raises(ValueError, match="without a default for t"):
        ec.laws.MeanCurvature(g=lambda x, t=0.0: 2 + np.sin(t))
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), 1, ec.to_unit_sphere)
    at = ec.Surface(space, space.nodes, {}, 2.0)
    scaled = partial(lambda x, t, scale: scale * t * np.ones(len(x)), scale=3.0)
    assert ec.laws.MeanCurvature(g=scaled).forcing(at) == pytest.approx(6.0)
    of_surface = ec.laws.MeanCurvature(g=lambda at, scale=2.0: scale * at.t)
    assert of_surface.forcing(at) == pytest.approx(4.0)


@pytest.mark.parametrize("thin", [False, True])
def test_normal_and_curvature_of_a_mesh_are_computed_once_for_a_run(thin, monkeypatch):
    calls = []

    def counted(tri):
        calls.append(tri)
        return ec.smooth(tri)

    monkeypatch.setattr("esfem_core.elements.recovery.smooth", counted)
    tri = trimesh.creation.uv_sphere(1, count=[6, 200]) if thin else ec.sphere("icosahedron", 2)
    space, law = ec.SurfaceSpace(tri), ec.laws.MeanCurvature(beta=1e-6)
    state = next(ec.evolve(space, ec.Problem(law=law), 1, 1e-4, 2e-4))
    assert len(calls) == 1
    moved = law.initial(ec.Surface(space, 2 * space.nodes))  # another surface, not the nodes'
    assert len(calls) == 2
    assert_allclose(moved["H"], state["H"] / 2, rtol=1e-6)
