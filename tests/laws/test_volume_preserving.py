"""Volume-preserving laws: drift of order p, falling area, the sphere in the end."""

import numpy as np
import pytest
from temporal import fine_run, temporal_orders

import esfem_core as ec
from esfem_core.study import final, observed_orders

ELLIPSOID = ec.exact_surfaces.Ellipsoid((1.3, 1.0, 0.8))
TRI = ec.sphere("icosahedron", 1)
TRI.vertices = ELLIPSOID.closest(TRI.vertices * ELLIPSOID.axes)
SPACE = ec.SurfaceSpace(TRI, 2, ELLIPSOID.closest)
LAWS = {
    "regularised": ec.laws.Regularised(0.1, 1.0),
    "mean curvature": ec.laws.MeanCurvature(1.0, None, ELLIPSOID.normal, ELLIPSOID.mean_curvature),
}
BY_LAW = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)


@BY_LAW
def test_the_volume_drifts_with_order_p(law):
    """Between the end of the starting values and t = 0.2, so that only the scheme counts."""
    problem = ec.Problem(law=ec.laws.VolumePreserving(law))
    for p in (1, 2, 3):
        drifts, steps = [], [1 / 100, 1 / 200, 1 / 400]
        for step in steps:
            states = list(ec.evolve(SPACE, problem, p, step, 0.2))
            volumes = [ec.measure(state).volume for state in (states[p - 1], states[-1])]
            drifts.append(abs(volumes[1] - volumes[0]))
        assert observed_orders(steps, drifts)[-1] > p - 0.3
        assert drifts[-1] < [2e-2, 2e-4, 1e-5][p - 1]


@BY_LAW
def test_the_area_falls_to_that_of_a_sphere(law):
    problem = ec.Problem(law=ec.laws.VolumePreserving(law))
    measures, states = [], list(ec.evolve(SPACE, problem, 3, 1 / 100, 2.0))
    measures = [ec.measure(state) for state in states]
    areas = np.array([m.area for m in measures])
    assert (np.diff(areas) < 1e-9).all()
    r = (3 * measures[-1].volume / (4 * np.pi)) ** (1 / 3)
    assert areas[-1] == pytest.approx(4 * np.pi * r**2, rel=2e-3)
    x = states[-1].x - states[-1].x.mean(axis=0)
    np.testing.assert_allclose(np.linalg.norm(x, axis=1), r, rtol=1e-2)
    assert measures[-1].volume == pytest.approx(measures[0].volume, rel=1e-3)


@BY_LAW
def test_no_volume_flows_through_the_extrapolated_surface(law):
    """Int v . nu = 0 there, also with a force."""
    forced = type(law)(**{**vars_of(law), "g": lambda at: at.points[..., 0] + 1})
    states = list(ec.evolve(SPACE, ec.Problem(law=ec.laws.VolumePreserving(forced)), 2, 0.01, 0.05))
    x = 2 * states[-2].x - states[-3].x
    v, normal = SPACE.evaluate(states[-1].v), SPACE.normals(x)
    flux = SPACE.integrate(x, (v * normal).sum(axis=-1))
    assert abs(flux) < 1e-9 * SPACE.integrate(x, abs((v * normal).sum(axis=-1)))


def test_the_pressure_is_the_mean_speed_over_the_surface_in_the_equations_too():
    """Normal and H are those of a force g - lambda, lambda the mean of g - beta H."""
    x = SPACE.nodes
    at = ec.Surface(SPACE, x, {"normal": x, "H": 2 + x[:, 0] ** 2})
    law = ec.laws.VolumePreserving(ec.laws.MeanCurvature(0.5, lambda x, t: 3 + x[:, 2]))
    pressure = at.mean(3 + SPACE.evaluate(x[:, 2]) - 0.5 * at["H"])
    same = ec.laws.MeanCurvature(0.5, lambda x, t: 3 + x[:, 2] - pressure)
    for name in ("normal", "H"):
        found = law.equations(0.1, x)[name].load(name, at)
        np.testing.assert_allclose(found, same.species[name].load(name, at), atol=1e-12)


def vars_of(law):
    names = ("alpha", "beta", "g", "normal", "curvature")
    return {name: getattr(law, name) for name in names if name in law.__dataclass_fields__}


def test_of_two_spheres_the_large_one_grows_at_the_cost_of_the_small_one():
    """R' = lambda - 2/R for both radii, with one lambda."""
    far, radii = np.array([3.0, 0, 0]), np.array([1.0, 0.7])
    small = ec.sphere("icosahedron", 1).apply_scale(0.7).apply_translation(far)

    def project(x):
        large = x[:, :1] < 1.5
        onto = ec.to_unit_sphere(np.where(large, x, x - far))
        return np.where(large, onto, far + 0.7 * onto)

    space = ec.SurfaceSpace(ec.sphere("icosahedron", 1) + small, 2, project)
    problem = ec.Problem(law=ec.laws.VolumePreserving(ec.laws.MeanCurvature()))
    first, *_, last = ec.evolve(space, problem, 2, 1 / 200, 0.03)
    for _ in range(300):  # Euler steps for the radii
        radii = radii + 1e-4 * (2 * radii.sum() / (radii @ radii) - 2 / radii)
    on_small = space.nodes[:, 0] > 1.5
    found = [
        np.linalg.norm(last.x[i] - c, axis=1).mean() for i, c in ((~on_small, 0), (on_small, far))
    ]
    np.testing.assert_allclose(found, radii, atol=5e-3)
    assert found[1] < 0.69 < 1.005 < found[0]
    assert ec.measure(last).volume == pytest.approx(ec.measure(first).volume, rel=1e-4)


def test_a_sphere_stays_where_it_is():
    """Each law alone would shrink it."""
    sphere = ec.exact_surfaces.Sphere()
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), 2, sphere.closest)
    for law in (ec.laws.Regularised(0.1, 1.0), ec.laws.MeanCurvature(1.0)):
        problem = ec.Problem(law=ec.laws.VolumePreserving(law))
        last = final(ec.evolve(space, problem, 2, 1 / 100, 0.3))
        np.testing.assert_allclose(np.linalg.norm(last.x, axis=1), 1, atol=2e-3)


@pytest.mark.slow
@BY_LAW
def test_orders_in_time(law):
    species = {"u": ec.Species(lambda x: 1 + x[:, 0] * x[:, 1])}
    forced = type(law)(**{**vars_of(law), "g": lambda at: 0.3 * at.u})
    problem = ec.Problem(species=species, law=ec.laws.VolumePreserving(forced))
    fine = fine_run(SPACE, problem, 1 / 1280, 0.4, settled=0.1)
    for p in range(1, 6):
        for name, order in temporal_orders(SPACE, problem, p, [1 / 160, 1 / 320], fine).items():
            assert order == pytest.approx(p, abs=0.35), (p, name)


def test_what_a_law_of_ones_own_overrides_stays_overridden():
    class Still(ec.laws.MeanCurvature):
        """Its normal and curvature do not change."""

        @property
        def species(self):
            return {
                name: ec.Species(None, diffusivity=0.0, conserved=False) for name in super().species
            }

    class Filling(ec.laws.Regularised):
        """With a function whose equation has a source in each step."""

        @property
        def species(self):
            return {"q": ec.Species(1.0, diffusivity=0.0, conserved=False)}

        def equations(self, tau, past):
            return {"q": ec.Species(1.0, lambda at: 10.0, diffusivity=0.0, conserved=False)}

    def states(law):
        problem = ec.Problem(law=ec.laws.VolumePreserving(law))
        return list(ec.evolve(SPACE, problem, 1, 0.01, 0.02, solver="direct"))

    first, *_, last = states(Still())
    np.testing.assert_allclose(last["H"], first["H"], rtol=1e-12)
    np.testing.assert_allclose(states(Filling())[-1]["q"], 1.2, rtol=1e-12)


@pytest.mark.parametrize("g", [0.0, 0.5, 2.0])
def test_a_uniform_force_does_not_matter_whatever_a_law_of_ones_own_adds(g):
    class Wind(ec.laws.Regularised):
        def velocity(self, at, new, tau, past, solve):
            return super().velocity(at, new, tau, past, solve) + np.array([0.3, 0.0, 0.0])

    law = ec.laws.VolumePreserving(Wind(0.1, 0.0, lambda at: g))
    sphere = ec.SurfaceSpace(ec.sphere("octahedron", 2), 2, ec.to_unit_sphere)
    last = final(ec.evolve(sphere, ec.Problem(law=law), 2, 0.02, 0.2))
    np.testing.assert_allclose(last.x, sphere.nodes + np.array([0.06, 0, 0]), atol=1e-8)


def nothing(at, solve):
    return 0 * at.x


def each_component(at, solve):
    K, b = at.matrix(1.0, 1.0), at.load(at.normal)
    return np.stack([solve(K, b[:, i]) for i in range(3)], axis=1)


@pytest.mark.parametrize(
    ("solved", "found"), [(nothing, "nothing"), (each_component, r"b of shape \(66,\)")]
)
def test_a_law_of_ones_own_that_solves_otherwise_is_told_what_is_needed(solved, found):
    class Own(ec.laws.Regularised):
        def velocity(self, at, new, tau, past, solve):
            return solved(at, solve)

    law = ec.laws.VolumePreserving(Own())
    sphere = ec.SurfaceSpace(ec.sphere("octahedron", 2))
    message = rf"first solve\(K, b\) .* must .* shape \(N, 3\), .*Own\(.*\) solves for {found}$"
    with pytest.raises(ValueError, match=message):
        final(ec.evolve(sphere, ec.Problem(law=law), 1, 0.1, 0.1))


def test_one_factorisation_serves_both_parts():
    statistics = ec.Statistics()
    problem = ec.Problem(law=ec.laws.VolumePreserving(LAWS["regularised"]))
    final(ec.evolve(SPACE, problem, 1, 0.01, 0.1, solver="direct", statistics=statistics))
    assert statistics.solves == {"law 1": 10}
    assert statistics.factorisations == 10


@pytest.mark.parametrize(
    ("law", "found"),
    [
        (ec.laws.Dynamic(), r"Dynamic\(.*\)"),
        (3, "3"),
        (ec.laws.Dynamic, "the class Dynamic"),
        (ec.laws.Regularised, r"the class Regularised: write Regularised\(\.\.\.\)"),
        (
            ec.laws.with_slip(ec.laws.Regularised(), "elastic"),
            r"with_slip.*; slip comes last, with_slip\(VolumePreserving\(law\), w\)",
        ),
    ],
)
def test_other_laws_are_refused_and_no_advice_is_given_that_does_not_help(law, found):
    message = f"^law must be a Regularised or a MeanCurvature, got {found}$"
    with pytest.raises(TypeError, match=message):
        ec.laws.VolumePreserving(law)
