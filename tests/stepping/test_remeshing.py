"""States on new triangles: amounts and topology kept, orders in space and in time, refusals."""

from functools import partial
from itertools import islice

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import esfem_core as ec
from esfem_core.companion import bunny
from esfem_core.elements.numbering import mirrored
from esfem_core.stepping.remeshing import transferred
from esfem_core.stepping.retriangulation import _flattened, triangulated
from esfem_core.study import observed_orders

AXES = np.array([1.0, 1.0, 2.5])


def ellipsoid(degree, refinements=1, **fields):
    """A state of a stretched sphere, with angles of about 24 degrees."""
    space = ec.SurfaceSpace(ec.sphere("icosahedron", refinements), degree, ec.to_unit_sphere)
    x = space.nodes * AXES
    values = {"u": 1 + x[:, 0] * x[:, 2], "pair": np.stack([x[:, 1], x[:, 2] ** 2], axis=1)}
    return ec.State(0.5, x, 2 * x, space=space, fields=values | fields)


def triangles(state):
    corners, faces = np.unique(state.space.cells[:, :3], return_inverse=True)
    return trimesh.Trimesh(state.x[corners], faces.reshape(-1, 3), process=False)


def amounts(state):
    M = state.space.mass(state.x)
    return {name: np.sum(M @ w, axis=0) for name, w in state.fields.items()}


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_triangles_become_better_and_amounts_and_topology_stay(degree):
    old = ellipsoid(degree)
    new = ec.remeshed(old, 0.45)
    q = ec.mesh_quality(triangles(new))
    ec.check_triangulation(triangles(new))
    assert (new.t, new.space.degree, q.euler) == (0.5, degree, 2)
    assert ec.measure(old).min_angle < 25 < 30 <= q.min_angle
    assert 0.85 * 0.45 < q.h_mean < 1.05 * 0.45
    for name, amount in amounts(old).items():
        assert np.abs(amounts(new)[name] / amount - 1)[np.abs(amount) > 1].max() < 1e-14
        assert np.abs(amounts(new)[name] - amount).max() < 1e-13
    if degree > 1:
        assert np.abs(new.v - 2 * new.x).max() < 1e-13
    assert np.array_equal(new.space.nodes, new.x)


@pytest.mark.parametrize("degree", [2, 3])
def test_every_new_node_lies_on_the_old_elements(degree):
    old = ellipsoid(degree)
    new = ec.remeshed(old, 0.45)
    on_old = old.space.probe(old.x, old.x, new.x)
    assert np.abs(on_old - new.x).max() < 1e-13


def test_without_a_length_edges_keep_their_mean():
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 2))
    old = ec.State(0.0, space.nodes * [1, 1, 1.4], None, space=space)
    before, after = (ec.mesh_quality(triangles(state)).h_mean for state in (old, ec.remeshed(old)))
    assert abs(after / before - 1) < 0.1


def test_the_same_state_gives_the_same_bits():
    one, other = (ec.remeshed(ellipsoid(2), 0.5) for _ in range(2))
    assert np.array_equal(one.x, other.x)
    assert np.array_equal(one.u, other.u)


def test_new_triangles_have_the_quadrature_of_the_old_ones():
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere, exactness=11)
    new = ec.remeshed(ec.State(0.0, space.nodes, None, space=space), 0.5)
    assert new.space.rule.exactness == space.rule.exactness == 11


def test_each_component_keeps_its_own_amount():
    tri = ec.sphere("icosahedron", 1)
    moved = trimesh.Trimesh(tri.vertices + np.array([4.0, 0, 0]), tri.faces, process=False)
    space = ec.SurfaceSpace(trimesh.util.concatenate([tri, moved]), 1)
    u = np.where(space.nodes[:, 0] > 2, 5.0, 1.0) + space.nodes[:, 2] ** 2
    old = ec.State(0.0, space.nodes, None, u, space=space)
    new = ec.remeshed(old, 0.4)
    for sign in (-1, 1):
        before, after = (
            (s.space.mass(s.x) @ s.u)[sign * (s.x[:, 0] - 2) > 0].sum() for s in (old, new)
        )
        assert after == pytest.approx(before, rel=1e-14)
    assert ec.mesh_quality(triangles(new)).euler == 4


def test_a_normal_keeps_its_length_and_what_is_not_conserved_gets_no_constant():
    law = ec.laws.MeanCurvature(beta=0.1)
    problem = ec.Problem(1.0, law=law)
    space = ellipsoid(2).space
    states = list(ec.evolve(space, problem, 2, 0.01, 0.05))
    for given in (None, problem):
        new = ec.remeshed(states[-2:], 0.5, given)[-1]
        assert set(new.products) == {"u"}
        length = np.linalg.norm(new["normal"], axis=1)
        old = np.linalg.norm(states[-1]["normal"], axis=1)
        assert old.min() - 1e-12 < length.min() < length.max() < old.max() + 2e-4
        points = space.probe(states[-1].x, states[-1]["H"], new.x)
        assert np.abs(points - new["H"]).max() < 1e-12


def test_a_torus_stays_a_torus():
    torus = ec.exact_surfaces.Torus(1.0, 0.4)
    space = ec.SurfaceSpace(ec.torus(1.0, 0.4, 14, 10), 2, torus.closest)
    new = ec.remeshed(ec.State(0.0, space.nodes * [1, 1.6, 1], None, space=space), 0.35)
    assert ec.mesh_quality(triangles(new)).euler == 0
    assert ec.measure(new).min_angle > 28


def test_edges_are_shorter_where_the_surface_bends():
    """A waist of radius 0.2 with h = 0.5 keeps its size."""
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 3))
    p = space.nodes
    x = p * np.stack([0.2 + 0.8 * p[:, 2] ** 2] * 2 + [1.5 + 0 * p[:, 2]], axis=1)
    old = ec.State(0.0, x, None, space=space)
    new = ec.remeshed(old, 0.5)
    radius = np.hypot(new.x[:, 0], new.x[:, 1])[np.abs(new.x[:, 2]) < 0.15]
    assert len(radius) >= 8
    assert 0.17 < radius.min() < radius.max() < 0.23
    assert abs(ec.measure(new).volume / ec.measure(old).volume - 1) < 0.06


def test_on_a_sphere_edges_are_no_longer_than_half_its_radius():
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 2))
    new = ec.remeshed(ec.State(0.0, space.nodes, None, space=space), 1.1)
    assert ec.mesh_quality(triangles(new)).h_mean == pytest.approx(0.7 / np.sqrt(2), rel=0.1)


MASSES = ["updated", "extrapolated", "reassembled"]


@pytest.mark.parametrize("mass", MASSES)
def test_what_a_scheme_keeps_goes_on_being_kept(mass):
    problem = ec.Problem(lambda x: 1 + x[:, 0], g=lambda at: at.u, alpha=0.2, beta=0.1)
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
    options = {"mass": mass, "solver": "direct"}
    states = list(ec.evolve(space, problem, 2, 0.05, 0.3, **options))[-2:]
    new = ec.remeshed(states, 0.5)
    kept = [np.sum(s.products["u"]) for s in (*states, *new)]
    own = [amounts(s)["u"] for s in (*states, *new)]
    assert np.ptp([kept[1], kept[3]]) < 1e-13 > np.ptp([kept[0], kept[2]])
    assert np.ptp([own[1], own[3]]) < 1e-13 > np.ptp([own[0], own[2]])
    *_, last = ec.evolve(new[-1].space, problem, 2, 0.05, 0.5, start=new, **options)
    if mass != "reassembled":
        assert np.sum(last.products["u"]) == pytest.approx(kept[1], rel=1e-12)


TORUS = ec.exact_surfaces.Torus(1.0, 0.4)


def moving_torus():
    """The coupled problem on a torus that grows and is sheared."""
    d = "(sqrt(x1**2 + x2**2) - 1 - t/4)**2 + (x3 - t*x1/2)**2 - (2/5)**2"
    grown = "(1 + t/4/sqrt(p1**2 + p2**2))"
    motion = [f"p1*{grown}", f"p2*{grown}", f"p3 + t/2*p1*{grown}"]
    return ec.problems.manufactured(d, motion, "x1*x3 + exp(-t)", alpha=0.1, beta=0.1)


def moving_ellipsoid():
    """Diffusion on an ellipsoid whose motion is prescribed."""
    d = "(x1/(1 + t))**2 + x2**2 + (x3/(1 - t/4))**2 - 1"
    motion = ["(1 + t)*p1", "p2", "(1 - t/4)*p3"]
    return ec.problems.manufactured(d, motion, "x1*x3 + exp(-t)", prescribed=True)


def torus_space(finer):
    n = round(28 * finer)
    return ec.SurfaceSpace(ec.torus(1.0, 0.4, n, n // 2), 2, TORUS.closest)


def sphere_space(finer):
    return ec.SurfaceSpace(
        ec.sphere("icosahedron", round(np.log2(finer)) + 2), 2, ec.to_unit_sphere
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make_problem", "make_space", "h", "finer"),
    [(moving_torus, torus_space, 0.21, 1.5), (moving_ellipsoid, sphere_space, 0.3, 2)],
)
def test_the_order_in_space_across_a_change_of_triangles(make_problem, make_space, h, finer):
    """Degree 2: errors of position and u, on the exact surface, fall with order 3.

    On coarser meshes the edges are those that the bending of the surface asks for, not h.
    """
    problem, errors = make_problem(), []
    for factor in (1, finer):
        states = list(ec.evolve(make_space(factor), problem, 3, 0.05, 0.15))
        states = ec.remeshed(states[-3:], h / factor, problem)
        space = states[-1].space
        *_, last = ec.evolve(space, problem, 3, 0.05, 0.3, start=states)
        found = ec.errors.lifted(space, problem, last)
        errors.append([found.x_l2, found.u_l2])
    assert (np.log(np.divide(*errors)) / np.log(finer) > 2.6).all()


def test_flat_elements_keep_the_second_order_and_their_vertices_the_fourth():
    """On an ellipsoid, from 320 to 1280 elements, against the mean edges that came out."""
    exact = ec.exact_surfaces.Ellipsoid((1.3, 1.0, 0.8))
    errors, sizes = [], []
    for level in (2, 3):
        space = ec.SurfaceSpace(ec.sphere("icosahedron", level))
        x = space.nodes * [1.3, 1.0, 0.8]
        new = ec.remeshed(ec.State(0.0, x, None, x[:, 0] * x[:, 2], space=space), 1.44 / 2**level)
        at = new.surface()
        near = exact.closest(at.points.reshape(-1, 3)).reshape(at.points.shape)
        distance = ((at.points - near) ** 2).sum(axis=2)
        u = (at.u - near[..., 0] * near[..., 2]) ** 2
        off = np.linalg.norm(exact.closest(new.x) - new.x, axis=1).max()
        errors.append([np.sqrt(at.mean(distance)), np.sqrt(at.mean(u)), off])
        sizes.append(ec.mesh_quality(triangles(new)).h_mean)
    orders = np.log(np.divide(*errors)) / np.log(np.divide(*sizes))
    assert (orders > [1.95, 1.95, 3.5]).all()


def test_flat_triangles_of_a_sphere_do_not_shrink_when_made_anew_again_and_again():
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 2))
    first = state = ec.State(0.0, space.nodes, None, space=space)
    for _ in range(4):
        state = ec.remeshed(state, 0.3)
    assert abs(ec.measure(state).volume / ec.measure(first).volume - 1) < 0.01
    assert np.abs(np.linalg.norm(state.x, axis=1) - 1).max() < 3e-3


LAWS = {
    "regularised": ec.laws.Regularised(0.2, 0.1, lambda at: at["u"]),
    "mean curvature": ec.laws.MeanCurvature(0.1, lambda at: at["u"]),
    "velocity": ec.laws.Prescribed(velocity=lambda x, t: x * [1, 0, np.cos(3 * t)]),
}


@pytest.mark.parametrize("law", LAWS)
def test_orders_in_time_across_a_change_of_triangles(law):
    """With one map for all steps: a map that is chosen anew differs by jumps."""
    problem = ec.Problem(species={"u": ec.Species(lambda x: 1 + x[:, 0] / 2)}, law=LAWS[law])
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
    run = partial(ec.evolve, solver="direct")
    first = list(run(space, problem, 4, 1 / 160, 0.4))
    transfer = triangulated(space, first[-1].x, 0.55)

    def continued(p, step, states):
        new = transferred(states[-p:], transfer, ["u"], problem)
        *_, last = run(new[-1].space, problem, p, step, 0.8, start=new)
        return last

    fine = continued(4, 1 / 160, first)
    for p in (1, 2, 3):
        errors = []
        for n in (10, 20):
            last = continued(p, 1 / n, list(run(space, problem, p, 1 / n, 0.4)))
            errors.append([np.abs(last.x - fine.x).max(), np.abs(last.u - fine.u).max()])
        orders = np.log2(np.divide(*errors))
        assert (orders[0 if law != "velocity" else 1 :] > p - 0.45).all(), (p, orders)


def test_a_motion_goes_on_with_its_own_positions():
    problem = ec.problems.oscillating_ellipsoid("oscillation")
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), 3, ec.to_unit_sphere)
    errors = []
    for n in (16, 32):
        states = list(ec.evolve(space, problem, 3, 1 / n, 0.5))
        states = ec.remeshed(states[-3:], 0.3, problem)
        new = states[-1].space
        for state in states:
            assert np.abs(state.x - problem.law.motion(new.nodes, state.t)).max() < 1e-15
        *_, last = ec.evolve(new, problem, 3, 1 / n, 1.0, start=states)
        errors.append(ec.errors.compare(new, problem, last).u_l2)
    assert observed_orders([1 / 16, 1 / 32], errors)[0] > 2.7
    alone = ec.remeshed(states[-3:], 0.3)
    with pytest.raises(ValueError, match=r"remeshed\(states, h, problem\)"):
        ec.evolve(alone[-1].space, problem, 3, 1 / 32, 1.0, start=alone)


def test_new_states_are_saved_and_have_other_steps(tmp_path):
    problem = ec.Problem(lambda x: 1 + x[:, 0], g=lambda at: at.u, alpha=0.2, beta=0.1)
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
    states = ec.remeshed(list(ec.evolve(space, problem, 2, 0.1, 0.5))[-3:], 0.5)
    ec.save(tmp_path / "run.npz", states)
    again, read = ec.load(tmp_path / "run.npz")
    start = ec.respaced(read, 0.05, order=2)
    *_, last = ec.evolve(again, problem, 2, 0.05, 0.6, start=start)
    assert ec.measure(last).amount == pytest.approx(ec.measure(states[-1]).amount, rel=1e-11)


def worn(state, first, angle, ratio):
    """Whether an angle has become small, or areas have changed differently since the first."""
    J = state.surface().density / first.surface().density
    return ec.measure(state).min_angle < angle or J.max() > ratio * J.min()


def remeshing(space, problem, p, step, end, angle, h, ratio=np.inf):
    """The states of a run, which goes on from p new states whenever triangles are worn."""
    run, states, first = ec.evolve(space, problem, p, step, end), [], None
    while run:
        rest, run = run, None
        for state in rest:
            yield state
            first, states = first or state, [*states, state][-p:]
            if len(states) == p and state.t < end and worn(state, first, angle, ratio):
                states = ec.remeshed(states, h, problem)
                first = states[-1]
                run = ec.evolve(first.space, problem, p, step, end, start=states)
                run = islice(run, p, None)  # the first p are those it starts from
                break


def test_the_recipe_keeps_angles_where_a_whirl_makes_triangles_thin():
    def stirring(at):
        x, y, z = np.moveaxis(at.points, -1, 0)
        whirl = np.sin(2 * z)[..., None] * np.stack([-y, x, 0 * z], axis=-1)
        return 2 * at.u[..., None] * whirl + 0.02 * at.normal

    problem = ec.Problem(
        species={"u": ec.Species(lambda x: 1 + x[:, 0] / 2, diffusivity=0.1)},
        law=ec.laws.Regularised(0.02, 0.01, stirring),
    )
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), 2, ec.to_unit_sphere)
    with pytest.warns(ec.EvolutionWarning, match="lies on element"):
        *_, kept = ec.evolve(space, problem, 2, 1 / 20, 1.0)
    states = list(remeshing(space, problem, 2, 1 / 20, 1.0, 15, 0.4))
    assert [state.t for state in states] == pytest.approx(np.arange(21) / 20)
    assert len({id(state.space) for state in states}) > 2
    first, last = ec.measure(states[0]), ec.measure(states[-1])
    assert ec.measure(kept).min_angle < 8 < 12 < min(ec.measure(s).min_angle for s in states)
    assert last.amount == pytest.approx(first.amount, rel=1e-10)
    assert last.volume == pytest.approx(ec.measure(kept).volume, rel=5e-3)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::esfem_core.EvolutionWarning")
def test_a_shrinking_surface_gets_new_triangles_where_its_tips_crowd():
    """An ellipsoid under mean curvature flow: without them an element turns over at t = 0.4."""
    long = ec.exact_surfaces.Ellipsoid((1.0, 1.0, 3.0))
    tri = ec.sphere("icosahedron", 2)
    tri.vertices = long.closest(tri.vertices * long.axes)
    space = ec.SurfaceSpace(tri, 2, long.closest)
    problem = ec.Problem(law=ec.laws.MeanCurvature())
    with pytest.raises(ec.EvolutionError, match="turned over"):
        list(ec.evolve(space, problem, 2, 1 / 200, 0.42))
    states = list(remeshing(space, problem, 2, 1 / 200, 0.42, 15, None, ratio=4))
    last = ec.measure(states[-1])
    assert last.t == pytest.approx(0.42)
    assert min(ec.measure(state).min_angle for state in states) > 15
    assert last.volume == pytest.approx(0.0917, abs=8e-4)


def test_a_needle_that_grows_keeps_its_angles():
    """A force along the axis draws the ball out to ten times its size within t = 1.25."""
    law = ec.laws.Regularised(
        0.05, 0.05, lambda at: 3 * at.u[..., None] * at.points * np.array([0, 0, 1])
    )
    species = {"u": ec.Species(lambda x: 1 + x[:, 2] / 2, diffusivity=0.1)}
    problem = ec.Problem(species=species, law=law)
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 2, ec.to_unit_sphere)
    states = list(remeshing(space, problem, 2, 1 / 40, 0.9, 19, 0.5, ratio=6))
    assert min(ec.measure(state).min_angle for state in states) > 17
    assert np.ptp(states[-1].x[:, 2]) > 9
    assert len(states[-1].space.cells) > 600
    assert ec.measure(states[-1]).amount == pytest.approx(ec.measure(states[0]).amount, rel=1e-9)


@pytest.mark.slow
def test_a_scan_with_ears_that_it_does_not_resolve_gets_new_triangles():
    scan = bunny()
    space = ec.SurfaceSpace(scan)
    new = ec.remeshed(ec.State(0.0, space.nodes, None, space=space), 0.6)
    assert ec.measure(new).min_angle > 25
    assert ec.mesh_quality(triangles(new)).euler == 2
    assert abs(ec.measure(new).volume / scan.volume - 1) < 5e-3


def test_elements_that_fold_become_flat_and_the_others_stay():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), 3, ec.to_unit_sphere)
    which = np.arange(len(space.cells)) == 5
    x = _flattened(space, which) @ space.nodes
    flat = np.unique(space.cells[5])
    kept = np.setdiff1d(np.arange(len(x)), flat)
    corners = x[space.cells[5, :3]]
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    assert np.array_equal(x[kept], space.nodes[kept])
    assert np.abs((x[flat] - corners[0]) @ normal).max() < 1e-15
    assert np.abs(x[space.cells[5, :3]] - space.nodes[space.cells[5, :3]]).max() < 1e-15


BALL = ec.SurfaceSpace(ec.sphere("icosahedron", 1))
OCTA = ec.SurfaceSpace(ec.sphere("octahedron", 1))
TRI = ec.sphere("octahedron", 1)
TRI.update_faces(TRI.triangles_center[:, 2] > 0)
TRI.remove_unreferenced_vertices()
DOME = ec.SurfaceSpace(TRI, boundary=True)
STATE = ec.State(0.0, BALL.nodes, None, 1 + BALL.nodes[:, 0], space=BALL)


def ball(x, **fields):
    return ec.State(0.0, x, None, space=BALL, fields=fields)


@pytest.mark.parametrize(
    ("arguments", "error", "text"),
    [
        ((5,), TypeError, "states must be a State or a sequence of them, got 5"),
        (([5],), TypeError, r"states\[0\] must be a State, got 5"),
        (([],), ValueError, "states must hold at least one State"),
        ((ec.State(0.0, BALL.nodes, None),), ValueError, "must know its space"),
        (
            (ec.State(0.0, DOME.nodes, None, space=DOME),),
            ValueError,
            "must be on a closed surface, but theirs has a boundary of 8 nodes",
        ),
        (([STATE, STATE],), ValueError, "in the order of time"),
        ((ball(BALL.nodes, normal=0 * BALL.nodes),), ValueError, "node 0, .* its .normal. is zero"),
        ((ball(BALL.nodes, normal=-BALL.nodes),), ValueError, "must point outwards, not inwards"),
        ((ec.State(0.0, OCTA.nodes * [1, 1, 0], space=OCTA),), ValueError, "node .* around cancel"),
        ((STATE, 0), ValueError, "h must be a finite number > 0, got 0"),
        ((STATE, "0.1"), TypeError, "h must be a finite number > 0, got '0.1'"),
        ((STATE, 2.0), ValueError, "h must be at most 1.1.*, so that the surface, .*got 2"),
        ((STATE, 1e-6), ValueError, "h must be at least 0.00.*at most 1000000 triangles"),
        ((STATE, 0.3, "problem"), TypeError, "problem must be a Problem, got 'problem'"),
        (
            (STATE, 0.3, ec.Problem(1.0, law=ec.laws.MeanCurvature())),
            ValueError,
            "'normal' is missing; they have 'u'",
        ),
    ],
)
def test_refusals_say_what_would_be_right(arguments, error, text):
    with pytest.raises(error, match=text):
        ec.remeshed(*arguments)


def test_a_function_called_normal_need_not_be_one():
    for w in (BALL.nodes[:, 0], BALL.nodes[:, :2]):
        assert ec.remeshed(ball(BALL.nodes, normal=w))["normal"].shape[1:] == w.shape[1:]


def test_a_normal_that_is_too_long_everywhere_stays_as_long():
    new = ec.remeshed(ball(BALL.nodes, normal=1.25 * BALL.nodes), 0.5)
    np.testing.assert_allclose(np.linalg.norm(new["normal"], axis=1), 1.25, rtol=1e-4)


def test_the_largest_length_is_allowed():
    with pytest.raises(ValueError, match="at most") as refused:
        ec.remeshed(STATE, 5.0)
    limit = float(str(refused.value).split("at most ")[1].split(",")[0])
    assert len(ec.remeshed(STATE, limit).space.cells) >= 8


def test_a_length_that_is_too_large_for_a_thin_shell_is_called_so():
    """And not a mesh unfit that only the remeshing has."""
    around = ec.SurfaceSpace(ec.sphere("icosahedron", 2), 2, ec.to_unit_sphere)
    turn = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
    nodes = np.vstack([around.nodes, 0.985 * around.nodes @ turn])
    inner = len(around.nodes) + around.cells[:, mirrored(2)]
    space = ec.SurfaceSpace.from_nodes(nodes, np.vstack([around.cells, inner]))
    state = ec.State(0.0, space.nodes, None, space=space, fields={"u": np.ones(len(nodes))})
    with pytest.raises(ValueError, match=r"^h = 0\.25 is too large for this surface") as refused:
        ec.remeshed(state, 0.25)
    assert "tri" not in str(refused.value).split()


def test_values_at_numbered_nodes_are_not_moved_to_other_nodes():
    cap = np.flatnonzero(BALL.nodes[:, 2] > 0.5)
    rest = ec.laws.Prescribed(velocity=lambda x, t: 0 * x)

    def problem(**options):
        return ec.Problem(species={"u": ec.Species(0.0, conserved=False, **options)}, law=rest)

    with pytest.raises(ValueError, match="must not fix 'u' at nodes that are given by their numb"):
        ec.remeshed(STATE, 0.4, problem(fixed=(cap, 1.0)))
    new = ec.remeshed(STATE, 0.4, problem())  # as the message says
    cap = np.flatnonzero(new.space.nodes[:, 2] > 0.5)
    *_, last = ec.evolve(new.space, problem(fixed=(cap, 1.0)), 1, 0.1, 0.2, start=[new])
    assert (last.u[cap] == 1).all()


def test_new_triangles_must_be_fit_where_the_motion_begins():
    def motion(p, t):  # within t = 1 the sphere is drawn out and twisted once around its axis
        a, c = np.cos(3 * t * p[:, 2]), np.sin(3 * t * p[:, 2])
        turned = [a * p[:, 0] - c * p[:, 1], c * p[:, 0] + a * p[:, 1], (1 + t) * p[:, 2]]
        return np.stack(turned, axis=1)

    problem = ec.Problem(1.0, motion=motion)
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 2), 2, ec.to_unit_sphere)
    states = list(ec.evolve(space, problem, 1, 0.1, 1.0))
    new = ec.remeshed(states[-1], 0.4, problem)
    *_, last = ec.evolve(new.space, problem, 1, 0.1, 1.1, start=[new])
    assert ec.measure(last).amount == pytest.approx(ec.measure(states[0]).amount, rel=1e-9)
