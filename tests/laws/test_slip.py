"""Nodes that slip: what does not change, what is kept, and triangles that stay good."""

import gc
import weakref

import numpy as np
import pytest
import trimesh
from temporal import fine_run, temporal_orders

import esfem_core as ec
from esfem_core.elements import Smoothing, nodal_average
from esfem_core.study import final


def ellipsoid_space(axes, refinements):
    tri = ec.sphere("icosahedron", refinements).apply_scale(axes)
    return ec.SurfaceSpace(tri, 2, ec.exact_surfaces.Ellipsoid(axes).closest)


SPHERE = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 6, ec.to_unit_sphere)
COARSE = ec.SurfaceSpace(ec.sphere("icosahedron", 2), 2, ec.to_unit_sphere)
REST = {
    "prescribed": ec.laws.Prescribed(velocity=lambda x, t: 0 * x),
    "regularised": ec.laws.Regularised(0.5, 1.0, lambda at: 2 + 0 * at.density),
    "mean curvature": ec.laws.MeanCurvature(
        1.0, lambda at: 2 + 0 * at.density, lambda x: x, lambda x: 0 * x[:, 0] + 2
    ),
    "dynamic": ec.laws.Dynamic(0.0, 0.5, 1.0, lambda at: 2 + 0 * at.density),
}


def turn(at):
    """Unevenly in space, as a rigid motion would hide much."""
    return np.cross(np.outer(1 + at.x[:, 2] ** 2, [0, 0, 1]), at.x)


BY_LAW = pytest.mark.parametrize("law", REST.values(), ids=REST)
BOTH = {
    "u": ec.Species(lambda x: 2 + x[:, 0]),
    "w": ec.Species(lambda x: 2 + x[:, 0], conserved=False),
}


@BY_LAW
def test_a_turning_mesh_on_a_resting_sphere(law):
    """The nodes turn, the sphere rests, and u = 2 + e^{-2t} x1, as if they did not."""
    problem = ec.Problem(species=BOTH, law=ec.laws.with_slip(law, turn))
    last = final(ec.evolve(SPHERE, problem, 3, 1 / 160, 0.5))
    np.testing.assert_allclose(np.linalg.norm(last.x, axis=1), 1, atol=1e-5)
    x, y, z = SPHERE.nodes.T
    angle = 0.5 * (1 + z**2)
    turned = [x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle), z]
    np.testing.assert_allclose(last.x, np.transpose(turned), atol=2e-5)
    for name in BOTH:
        np.testing.assert_allclose(last[name], 2 + np.exp(-1.0) * last.x[:, 0], atol=2e-5)


@pytest.mark.slow
@BY_LAW
def test_orders_in_time_of_a_turning_mesh(law):
    """Order p for all, also where tension is implicit in the new positions."""
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
    problem = ec.Problem(species=BOTH, law=ec.laws.with_slip(law, turn))
    fine = fine_run(space, problem, 1 / 1280, 0.4, settled=0.1)
    for p in range(1, 6):
        orders = temporal_orders(space, problem, p, [1 / 160, 1 / 320], fine)
        for name in ("x", "u", "w"):  # the particles rest to rounding
            assert orders[name] > p - 0.4, (p, name)


def test_a_prescribed_velocity_is_taken_at_its_own_time_also_under_a_slip():
    """That of the old time has order one."""
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    lift = ec.laws.Prescribed(velocity=lambda x, t: 0 * x + [0, 0, np.cos(t)])
    problem = ec.Problem(law=ec.laws.with_slip(lift, lambda at: 0 * at.x))
    ends = [final(ec.evolve(space, problem, 3, step, 1.0)).x for step in (1 / 20, 1 / 40)]
    errors = [abs(x - space.nodes - [0, 0, np.sin(1.0)]).max() for x in ends]
    assert np.log2(errors[0] / errors[1]) > 2.5


@pytest.mark.parametrize("conserved", [True, False])
def test_components_are_carried_as_each_is_by_itself(conserved):
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)
    species = {
        "a": ec.Species(lambda x: 2 + x[:, 0], conserved=conserved),
        "b": ec.Species(lambda x: x[:, 1] * x[:, 2], conserved=conserved),
        "both": ec.Species(
            lambda x: np.stack([2 + x[:, 0], x[:, 1] * x[:, 2]], axis=1), conserved=conserved
        ),
    }
    problem = ec.Problem(species=species, law=ec.laws.with_slip(REST["prescribed"], turn))
    last = final(ec.evolve(space, problem, 2, 0.05, 0.3, solver="direct"))
    np.testing.assert_allclose(last["both"], np.stack([last["a"], last["b"]], axis=1), atol=1e-12)


U = {"u": ec.Species(lambda x: 1 + x[:, 0] * x[:, 1])}
MOVING = {
    "prescribed": ec.laws.Prescribed(velocity=lambda x, t: x * [0.3, 0, -0.2]),
    "regularised": ec.laws.Regularised(0.1, 0.5, lambda at: at.u),
    "mean curvature": ec.laws.MeanCurvature(0.5, lambda at: at.u),
    "dynamic": ec.laws.Dynamic(0.0, 0.3, 0.5, lambda at: at.u),
    "volume": ec.laws.VolumePreserving(ec.laws.Regularised(0.1, 0.5, lambda at: at.u)),
    "curvature and volume": ec.laws.VolumePreserving(ec.laws.MeanCurvature(0.5, lambda at: at.u)),
}


@pytest.mark.parametrize("slip", [None, turn, "elastic"], ids=["none", "turn", "elastic"])
@pytest.mark.parametrize("law", MOVING.values(), ids=MOVING)
def test_amounts_are_kept_under_every_law(law, slip):
    law = law if slip is None else ec.laws.with_slip(law, slip)
    run = ec.evolve(COARSE, ec.Problem(species=U, law=law), 3, 0.01, 0.1, solver="direct")
    amounts = [COARSE.mass_times(state.x, state.u).sum() for state in run]
    assert np.ptp(amounts) < 1e-11 * abs(amounts[0])


def test_the_surface_does_not_depend_on_the_slip():
    """Curvature flow of an ellipsoid: area, volume and H of two runs agree, as h^k allows."""
    axes = (1.2, 1.0, 0.9)
    space, ellipsoid = ellipsoid_space(axes, 2), ec.exact_surfaces.Ellipsoid(axes)
    law = ec.laws.MeanCurvature(0.5, None, ellipsoid.normal, ellipsoid.mean_curvature)
    runs = []
    for one in (
        law,
        ec.laws.with_slip(law, "elastic"),
        ec.laws.with_slip(law, ec.laws.Elastic(40)),
    ):
        runs.append(final(ec.evolve(space, ec.Problem(1.0, law=one), 3, 1 / 200, 0.2)))
    for state in runs[1:]:
        assert abs(state.x - runs[0].x).max() > 1e-3
        for name in ("area", "volume"):
            values = [getattr(ec.measure(s), name) for s in (state, runs[0])]
            assert values[0] == pytest.approx(values[1], rel=1e-4)


def smallest_angle(space, x):
    corners = x[space.cells[:, :3]]
    a = np.roll(corners, -1, axis=1) - corners
    b = np.roll(corners, 1, axis=1) - corners
    cosine = (a * b).sum(-1) / (np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1))
    return np.degrees(np.arccos(cosine)).min()


@pytest.mark.parametrize(("order", "step"), [(1, 0.09), (2, 0.06), (3, 0.05)])
def test_a_step_that_is_too_long_for_the_elastic_slip_is_warned_of(order, step):
    rest = ec.laws.Prescribed(velocity=lambda x, t: 0 * x)
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
    most = ec.laws.Elastic().largest_step(order)
    with pytest.warns(
        ec.EvolutionWarning, match=f"step must be below {most:.3g} with .* got {step:g}"
    ):
        ec.evolve(
            space, ec.Problem(1.0, law=ec.laws.with_slip(rest, "elastic")), order, step, 3 * step
        )
    for law in (ec.laws.with_slip(rest, ec.laws.Elastic(rate=1.0)), rest):
        ec.evolve(space, ec.Problem(1.0, law=law), order, step, 3 * step)


def test_the_largest_step_of_the_elastic_slip_is_a_little_below_the_limit_of_its_roots():
    """Of x' = -kappa x with x extrapolated: sum 2^j/j over 2^p - 1, where a root is -1."""
    for p in range(1, 7):
        limit = sum(2**j / j for j in range(1, p + 1)) / (2**p - 1)
        assert 0.8 < ec.laws.Elastic(1.0, area=0.0).largest_step(p) / limit < 0.87


@pytest.mark.parametrize("order", [0, -3, 1.5, "2", None, True])
def test_the_largest_step_is_that_of_an_order(order):
    error = ValueError if type(order) in (int, float) else TypeError
    with pytest.raises(error, match=f"order must be an integer >= 1, got {order!r}"):
        ec.laws.Elastic().largest_step(order)
    assert ec.laws.Elastic().largest_step(7) == ec.laws.Elastic().largest_step(6)


def test_a_law_with_a_slip_does_not_keep_the_spaces_of_its_runs():
    law = ec.laws.with_slip(ec.laws.Regularised(1.0, 1.0, None), "elastic")
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)
    for state in ec.evolve(space, ec.Problem(species={}, law=law), 1, 0.05, 0.1):
        last = state.t
    assert last == 0.1
    gone = weakref.ref(space)
    del space, state
    gc.collect()
    assert gone() is None


@pytest.mark.parametrize("area", [0.0, 1.5])
def test_the_elastic_slip_is_what_it_is_said_to_be(area):
    """W = -rate P B P f with B = s (M + s A)^{-1}, f by differences of the energy."""
    tri = ec.sphere("icosahedron", 0).apply_scale(3.0)
    space = ec.SurfaceSpace(tri, 2, lambda x: 3 * ec.to_unit_sphere(x))
    rng = np.random.default_rng(0)
    x = 2 * space.nodes * [1.2, 1, 0.8] + 0.1 * rng.uniform(-1, 1, space.nodes.shape)
    n = ec.to_unit_sphere(space.nodes + 0.3 * rng.uniform(-1, 1, space.nodes.shape))
    weights, density = space.rule.weights, space.density(space.nodes)
    M, A = (matrix.toarray() for matrix in space.mass_stiffness(space.nodes))
    mean = (space.density(x) * weights).sum() / M.sum()  # of the quotient of areas

    def energy(y):
        squares = (space.density(y) / density) ** 2 * density * weights
        return 0.5 * np.sum(y * (A @ y)) + 0.5 * area * squares.sum() / mean

    f = np.zeros_like(x)
    for i in np.ndindex(x.shape):
        step = np.zeros_like(x)
        step[i] = 1e-4
        f[i] = (energy(x + step) - energy(x - step)) / 2e-4

    def tangential(w):
        return w - (w * n).sum(axis=1, keepdims=True) * n

    s = M.sum() / (4 * np.pi)
    w = -7 * tangential(np.linalg.solve(M / s + A, tangential(f)))
    found = ec.laws.Elastic(7.0, area)(ec.Surface(space, x, {"normal": 2 * n}))
    np.testing.assert_allclose(found, w, rtol=0, atol=1e-6 * abs(w).max())


SMALL, CENTRE = 0.1, np.array([4.0, 0, 0])  # a sphere of this radius beside the unit sphere


@pytest.mark.parametrize("slip", ["elastic", "harmonic"])
@pytest.mark.parametrize("degree", [1, 2])
def test_components_slip_as_each_does_alone(slip, degree):
    """Both are sheared alike, each in its own unit of length."""

    def shear(x, t):
        size = np.where(x[:, :1] > 2, SMALL, 1.0)
        y = (x - CENTRE * (size < 1)) / size
        return size * 0.5 * np.sin(y[:, [1, 2, 0]])

    large = ec.sphere("icosahedron", 3 - degree)
    small = large.copy().apply_scale(SMALL).apply_translation(CENTRE)
    law = ec.laws.with_slip(ec.laws.Prescribed(velocity=shear), slip)

    def run(tri):
        space = ec.SurfaceSpace(tri, degree)
        states = ec.evolve(space, ec.Problem(species={}, law=law), 2, 0.02, 0.6, solver="direct")
        return final(states).x, space.nodes

    x, nodes = run(trimesh.util.concatenate([small, large]))
    for mesh, size, of_mesh in ((small, SMALL, nodes[:, 0] > 2), (large, 1.0, nodes[:, 0] < 2)):
        alone, same = run(mesh)
        np.testing.assert_array_equal(nodes[of_mesh], same)
        np.testing.assert_allclose(x[of_mesh], alone, rtol=0, atol=1e-11 * size)


STRETCHED = ec.Surface(COARSE, COARSE.nodes * [1.5, 1, 0.7])


def test_the_harmonic_slip_is_the_elastic_one_without_areas():
    rest = REST["prescribed"]
    elastic, harmonic = (
        ec.laws.with_slip(rest, w).slip(STRETCHED) for w in ("elastic", "harmonic")
    )
    np.testing.assert_array_equal(elastic, ec.laws.Elastic()(STRETCHED))
    np.testing.assert_array_equal(harmonic, ec.laws.Elastic(area=0)(STRETCHED))
    assert abs(elastic - harmonic).max() > 1e-2


@pytest.mark.parametrize(
    ("field", "without", "least"),
    [
        (lambda x, t: np.cross(np.outer(3 * np.sin(2 * x[:, 2]), [0, 0, 1]), x), 6, 25),
        (lambda x, t: x @ np.array([[0, 0, 0], [2, 0, 0], [0, 0, 0.0]]), 12, 25),
        (lambda x, t: x * [1.2, -0.6, -0.6], 10, 17),
    ],
    ids=["twist", "shear", "stretch"],
)
@pytest.mark.filterwarnings("ignore:.* lies on element:esfem_core.EvolutionWarning")  # twist
def test_elastic_slip_keeps_triangles_good(field, without, least):
    """Smallest angles of 54 degrees at the start; the shapes are stretched up to sixfold."""
    law = ec.laws.Prescribed(velocity=field)
    angles = []
    for one in (law, ec.laws.with_slip(law, "elastic")):
        last = final(ec.evolve(COARSE, ec.Problem(1.0, law=one), 2, 1 / 100, 1.0))
        angles.append(smallest_angle(COARSE, last.x))
    assert angles[0] < without
    assert angles[1] > least


@pytest.mark.slow
@pytest.mark.parametrize("slip", ["elastic", "harmonic"])
def test_orders_in_time_with_the_built_in_slips(slip):
    law = ec.laws.with_slip(ec.laws.Regularised(0.1, 1.0, lambda at: 0.3 * at.u), slip)
    space = ellipsoid_space((1.3, 1.0, 0.8), 1)
    problem = ec.Problem(lambda x: 1 + x[:, 0] * x[:, 1], law=law)
    fine = fine_run(space, problem, 1 / 1280, 0.4, settled=0.1)
    for p in range(1, 5):
        for name, order in temporal_orders(space, problem, p, [1 / 160, 1 / 320], fine).items():
            assert order == pytest.approx(p, abs=0.45), (p, name)


def test_a_normal_of_the_law_is_vectors():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)
    x, slip = space.nodes * [1.5, 1, 1], ec.laws.Elastic()
    own = slip(ec.Surface(space, x))
    scalar = slip(ec.Surface(space, x, {"normal": x[:, 0]}))
    np.testing.assert_array_equal(scalar, own)
    vectors = slip(ec.Surface(space, x, {"normal": x}))
    assert abs((vectors * x).sum(axis=1)).max() < 1e-12 < abs((own * x).sum(axis=1)).max()


def test_without_a_normal_of_the_law_a_smoothed_one_is_taken():
    begin = ec.Surface(COARSE, COARSE.nodes)
    normal = Smoothing(begin)(begin.M @ nodal_average(STRETCHED, STRETCHED.normal))
    slip = ec.laws.Elastic()(STRETCHED)
    assert abs((slip * normal).sum(axis=1)).max() < 1e-12
    with_normal = ec.Surface(COARSE, STRETCHED.x, {"normal": normal})
    np.testing.assert_array_equal(slip, ec.laws.Elastic()(with_normal))


class Turning(ec.laws.Regularised):
    """A law of one's own with a slip."""

    def slip(self, at):
        return turn(at)


def test_an_exact_solution_is_that_of_nodes_that_do_not_slip():
    """With exact starting values the path of a node has a kink: order 2 for every p."""
    exact = ec.Exact(
        x=lambda p, t: p,
        v=lambda p, t: 0 * p,
        u=lambda x, t: np.exp(-2 * t) * x[:, 0],
        closest=lambda x, t: ec.to_unit_sphere(x),
        origin=lambda x, t: x,
    )
    rest = ec.laws.Prescribed(velocity=lambda x, t: 0 * x)
    species = {"u": ec.Species(lambda x: x[:, 0])}
    problem = ec.Problem(species=species, law=ec.laws.with_slip(rest, turn), exact=exact)
    space = ec.SurfaceSpace(ec.sphere("octahedron", 2), 4, ec.to_unit_sphere)
    with pytest.raises(ValueError, match=r'have no slip.*values are .* without: start="euler"'):
        ec.evolve(space, problem, 3, 1 / 40, 0.5)

    def off(step):
        last = final(ec.evolve(space, problem, 3, step, 0.5, start="euler"))
        with pytest.raises(ValueError, match=r"no slip.*; compare state.u with exact.u"):
            ec.errors.compare(space, problem, last)
        with pytest.raises(ValueError, match=r"no slip.*; compare state.u with exact.u"):
            ec.errors.lifted(space, problem, last)
        return abs(np.linalg.norm(last.x, axis=1) - 1).max()

    assert np.log2(off(1 / 40) / off(1 / 80)) > 2.7


def test_refused():
    law = ec.laws.Regularised()
    with pytest.raises(ValueError, match='w must be "elastic" or "harmonic", got \'smooth\''):
        ec.laws.with_slip(law, "smooth")
    with pytest.raises(TypeError, match="w must be a function of a Surface or a name, got"):
        ec.laws.with_slip(law, 3)
    with pytest.raises(TypeError, match=r"got the class Elastic: Elastic\(\) is one"):
        ec.laws.with_slip(law, ec.laws.Elastic)
    with pytest.raises(ValueError, match="law must have no slip, but"):
        ec.laws.with_slip(ec.laws.with_slip(law, "elastic"), turn)
    with pytest.raises(ValueError, match="law must have no slip, but"):
        ec.laws.with_slip(Turning(), turn)
    with pytest.raises(ValueError, match=r"no slip.*: it comes last, with_slip\(Vol"):
        ec.laws.VolumePreserving(Turning())
    with pytest.raises(ValueError, match="law must let its nodes go, but it prescribes their"):
        ec.laws.with_slip(ec.laws.Prescribed(motion=lambda p, t: p), turn)
    own = type("Own", (ec.laws.Prescribed,), {"slip": lambda self, at: turn(at)})
    with pytest.raises(ValueError, match=r"no slip.*: with_slip\(Prescribed\(velocity=v\), w\)"):
        ec.evolve(COARSE, ec.Problem(law=own(velocity=lambda x, t: 0 * x)), 1, 0.1, 0.1)
    short = ec.laws.with_slip(law, lambda at: at.x[:, 0])
    with pytest.raises(ValueError, match=r"w\(at\) must have shape \(642, 3\), got \(642,\)"):
        final(ec.evolve(COARSE, ec.Problem(law=short), 1, 0.1, 0.1))
