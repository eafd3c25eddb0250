"""A prescribed motion by positions or by a velocity field."""

import numpy as np
import pytest
import trimesh
from manufactured import FLOW, MovingSurface, numeric, torus_space

import esfem_core as ec

SPACE = torus_space(2, 10, 4)


def diffusion(start=None, **law):
    return ec.Problem(
        species={
            "u": ec.Species(lambda x: 2 + x[:, 0] * x[:, 1], lambda at: np.sin(at.points[..., 2]))
        },
        law=ec.laws.Prescribed(**law),
        exact=start,
    )


def test_the_flow_of_these_tests_is_its_own_inverse_backwards():
    assert FLOW.inverse_is_one()


def test_the_flow_of_these_tests_is_neither_rigid_nor_normal():
    """Tangential speeds and a divergence that are as large as the normal speed."""
    surface = MovingSurface()
    v, n = FLOW.velocity_field, numeric(surface.normal)
    divergence = numeric(surface.divergence(FLOW.velocity))
    x = FLOW.motion(SPACE.nodes, 0.3)
    normal_speed = np.sum(v(x, 0.3) * n(x, 0.3), axis=1)
    tangential = v(x, 0.3) - normal_speed[:, None] * n(x, 0.3)
    assert np.abs(normal_speed).max() > 0.1
    assert np.linalg.norm(tangential, axis=1).max() > 0.1
    assert np.ptp(divergence(x, 0.3)) > 0.1


@pytest.mark.parametrize("p", [1, 2, 4])
@pytest.mark.parametrize("start", ["euler", "states"])
def test_a_velocity_field_and_its_flow_are_the_same(p, start):
    flow = diffusion(motion=FLOW.motion)
    field = diffusion(velocity=FLOW.velocity_field)
    if start == "states":
        given = list(ec.evolve(SPACE, flow, p, 1 / 20, (p - 1) / 20, solver="direct"))
    else:
        given = "euler"
    runs = [
        list(ec.evolve(SPACE, one, p, 1 / 20, 0.5, start=given, solver="direct"))
        for one in (flow, field)
    ]
    for a, b in zip(*runs, strict=True):
        assert a.t == b.t
        for name in ("x", "u", "v"):
            one, other = getattr(a, name), getattr(b, name)
            if one is not None:
                np.testing.assert_allclose(other, one, rtol=0, atol=1e-9 * np.abs(one).max())


def test_velocities_are_difference_quotients_of_the_positions():
    """Of order p: the scheme's velocity is the field's at the nodes, up to the temporal error."""
    problem = diffusion(velocity=FLOW.velocity_field)
    for p in (1, 2, 3):
        *states, last = ec.evolve(SPACE, problem, p, 1 / 40, 0.5)
        chain = [last, *reversed(states)][: p + 1]
        quotient = 40 * sum(d * s.x for d, s in zip(ec.bdf.delta(p), chain, strict=True))
        np.testing.assert_allclose(last.v, quotient, rtol=0, atol=1e-12)
        error = np.abs(last.v - FLOW.velocity_field(last.x, last.t)).max()
        assert error < 2 * (1 / 40) ** p


def test_a_motion_that_does_not_start_on_the_surface_is_refused_with_advice():
    """A velocity given as a motion, above all."""
    message = (
        r"motion must start on the surface, X\(p, 0\) = p, but .*; "
        r"a velocity goes into laws.Prescribed\(velocity=v\)"
    )
    for wrong in (FLOW.velocity_field, lambda p, t: (1 + 1e-6) * p, lambda p, t: p + np.nan):
        with pytest.raises(ValueError, match=message):
            ec.evolve(SPACE, diffusion(motion=wrong), 1, 0.1, 0.5)


@pytest.mark.parametrize(
    ("law", "error", "message"),
    [
        ({}, ValueError, "exactly one of motion and velocity must be given"),
        ({"motion": lambda p, t: p, "velocity": lambda x, t: x}, ValueError, "exactly one of"),
        ({"motion": 1.0}, TypeError, "motion must be a function or None, got 1.0"),
        ({"velocity": "up"}, TypeError, "velocity must be a function or None, got 'up'"),
    ],
)
def test_refused_laws(law, error, message):
    with pytest.raises(error, match=message):
        ec.laws.Prescribed(**law)


@pytest.mark.parametrize(
    ("law", "error", "message"),
    [
        (
            {"motion": lambda p, t: p[:, 0]},
            ValueError,
            r"motion\(p, t\) must have shape \(160, 3\)",
        ),
        ({"motion": lambda p, t: p * 1j}, TypeError, r"motion\(p, t\) must hold real numbers"),
        (
            {"velocity": lambda x, t: x[:, :2]},
            ValueError,
            r"velocity\(x, t\) must have shape \(160, 3\), got \(160, 2\)",
        ),
        ({"velocity": lambda x, t: x * 1j}, TypeError, r"velocity\(x, t\) must hold real numbers"),
    ],
)
def test_wrong_shapes_are_refused_by_name(law, error, message):
    with pytest.raises(error, match=message):
        list(ec.evolve(SPACE, diffusion(**law), 1, 0.1, 0.5))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_velocity_that_is_not_finite_stops_the_run(bad):
    def velocity(x, t):
        return np.where((t > 0.25) & (x[:, :1] > 1), bad, 0.1 * x)

    states = []
    with pytest.raises(
        ec.EvolutionError, match=r"velocity\(x, t\) is not finite at node \d+ near \["
    ):
        states.extend(ec.evolve(SPACE, diffusion(velocity=velocity), 1, 0.1, 0.5))
    assert [s.t for s in states] == [0.0, 0.1, 0.2]


def test_a_trial_that_overflows_is_a_shorter_step_and_not_the_end():
    """Points of the sphere are at rest; a first trial throws them to 1e127."""

    def back(x, t):
        return -1e4 * (np.sum(x * x, axis=1, keepdims=True) - 1) * x

    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), 1, ec.to_unit_sphere)
    law = ec.laws.Prescribed(velocity=back)
    x = law.position(space.nodes, 0.1, (0.0, space.nodes))
    np.testing.assert_allclose(x, space.nodes, rtol=0, atol=1e-12)


def test_a_velocity_is_not_asked_for_at_points_that_are_not_finite():
    def only_finite(x, t):
        assert np.isfinite(x).all()
        return -1e4 * (np.sum(x * x, axis=1, keepdims=True) - 1) * x

    x = 1.001 * np.eye(3)
    moved = ec.laws.Prescribed(velocity=only_finite).position(x, 0.1, (0.0, x))
    np.testing.assert_allclose(moved, np.eye(3), rtol=0, atol=1e-11)


def test_a_velocity_that_is_bad_at_the_start_is_asked_for_once():
    times = []

    def velocity(x, t):
        times.append(t)
        return x + np.nan if t >= 0.1 else 0 * x

    with pytest.raises(FloatingPointError, match=r"velocity\(x, t\) is not .* at t = 0\.1: it"):
        ec.laws.Prescribed(velocity=velocity).position(np.eye(3), 0.2, (0.1, np.eye(3)))
    assert times == [0.1]


def test_a_velocity_that_is_rough_comes_to_an_end(monkeypatch):
    monkeypatch.setattr("esfem_core.laws.prescribed.MOST_CALLS", 500)
    random = np.random.default_rng(0)
    law = ec.laws.Prescribed(velocity=lambda x, t: random.normal(size=x.shape))
    message = (
        r"the velocity cannot be integrated from t = 0 to 0\.1: after 500 evaluations t = .* is "
        "reached; it must be smooth"
    )
    with pytest.raises(FloatingPointError, match=message):
        law.position(np.eye(3), 0.1, (0.0, np.eye(3)))


def test_single_precision_is_named_before_a_step():
    """The integrator would make ever smaller steps, and the motion not begin at the nodes."""
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)
    turning = ec.laws.Prescribed(velocity=lambda x, t: np.cross([0, 0, 1], x).astype("float32"))
    with pytest.raises(TypeError, match=r"velocity\(x, t\) must be in double .*, got float32: as"):
        ec.evolve(space, ec.Problem(law=turning), 1, 0.1, 0.1)
    drifting = ec.laws.Prescribed(velocity=lambda x, t: np.ones(x.shape, "float32"))
    *_, last = ec.evolve(space, ec.Problem(species={}, law=drifting), 1, 0.1, 0.1)
    assert np.abs(last.x - space.nodes - 0.1).max() < 1e-15
    tri, away = ec.sphere("octahedron", 1), [100, 0, 0]
    far = ec.SurfaceSpace(trimesh.Trimesh(tri.vertices + away, tri.faces, process=False))
    for on in (space, far):
        growing = ec.Problem(motion=lambda p, t: ((1 + t) * p).astype("float32"))
        with pytest.raises(ValueError, match=r"motion must .* of its size, by the rounding"):
            ec.evolve(on, growing, 1, 0.1, 0.1)


@pytest.mark.parametrize("converted", [False, True])
@pytest.mark.parametrize("step", [0.1, 1e-4])
def test_single_precision_is_named_on_vertices_in_single_precision(step, converted):
    """X(p, 0) is p there, and velocities were off by 8e-4 without a word."""
    tri = ec.sphere("icosahedron", 1)
    rounded = tri.vertices.astype("float32").astype(float)
    space = ec.SurfaceSpace(trimesh.Trimesh(rounded, tri.faces, process=False))

    def single(p, t):
        x = ((1 + t) * p).astype("float32")
        return x.astype(float) if converted else x

    message = r"must be in double precision, but has the rounding of single: .*compute it in double"
    grows = ec.Problem(1.0, motion=single)
    with pytest.raises(TypeError, match=r"^motion\(p, t\) " + message):
        ec.evolve(space, grows, 2, step, 10 * step)
    # Nor from a state whose positions are double: within a step they are not.
    double = ec.Problem(1.0, motion=lambda p, t: (1 + t) * p)
    state = ec.State(0.5, 1.5 * space.nodes, None, np.ones(len(space.nodes)), space=space)
    mixed = ec.Problem(1.0, motion=lambda p, t: (1 + t) * p if t == 0.5 else single(p, t))
    ec.evolve(space, double, 1, step, 0.5 + step, start=[state])
    with pytest.raises(TypeError, match=r"^motion\(p, t\) " + message):
        ec.evolve(space, mixed, 1, step, 0.5 + step, start=[state])


@pytest.mark.parametrize("away", [0, 100])
@pytest.mark.parametrize("step", [0.1, 1e-4])
def test_an_exact_solution_in_single_precision_is_named_as_such(step, away):
    """Its velocity was called wrong, or its surface another one."""
    tri = ec.sphere("octahedron", 1)
    space = ec.SurfaceSpace(trimesh.Trimesh(tri.vertices + away, tri.faces, process=False))

    def exact(kind):
        return ec.Exact(
            lambda p, t: (away + (1 + t) * (p - away)).astype(kind),
            lambda p, t: p - away,
            u=lambda x, t: 1 + 0 * x[:, 0],
        )

    law = ec.laws.Regularised()
    with pytest.raises(TypeError, match=r"^exact\.x\(p, t\) must .*: .*compute it in double"):
        ec.evolve(space, ec.Problem(1.0, law=law, exact=exact("float32")), 2, step, 10 * step)
    ec.evolve(space, ec.Problem(1.0, law=law, exact=exact("float64")), 2, step, 10 * step)


def test_round_numbers_that_rest_or_move_are_not_taken_for_single_precision():
    tri = ec.sphere("octahedron", 1)
    rounded = tri.vertices.astype("float32").astype(float)
    corners = ec.sphere("octahedron", 0)
    for space in (
        ec.SurfaceSpace(trimesh.Trimesh(rounded, tri.faces, process=False)),
        ec.SurfaceSpace(corners),
    ):
        for motion in (
            lambda p, t: p,
            lambda p, t: p + np.array([t, 0, 0]),
            lambda p, t: p * 2**t,
            lambda p, t: p + max(t - 0.4, 0),
        ):
            *_, last = ec.evolve(space, ec.Problem(1.0, motion=motion), 1, 0.25, 0.5)
            ec.evolve(space, ec.Problem(1.0, motion=motion), 1, 0.25, 1.0, start=[last])


def test_a_velocity_of_another_shape_is_refused_before_a_step():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    for returned in ([[1.0, 2.0, 3.0], [1.0]], np.ones(3)):
        law = ec.laws.Prescribed(velocity=lambda x, t, values=returned: values)
        with pytest.raises(ValueError, match=r"velocity\(x, t\) must have shape \(18, 3\)"):
            ec.evolve(space, ec.Problem(species={}, law=law), 1, 0.1, 0.1)


def test_a_motion_that_is_not_finite_stops_the_run():
    def motion(p, t):
        return np.where((t > 0.25) & (p[:, :1] > 1), np.nan, (1 + t) * p)

    states = []
    with pytest.raises(ec.EvolutionError, match="not finite"):
        states.extend(ec.evolve(SPACE, diffusion(motion=motion), 1, 0.1, 0.5))
    assert [s.t for s in states] == [0.0, 0.1, 0.2]
