"""Small inputs that once gave a wrong answer, no answer or advice that could not help."""

import itertools
import math
import threading
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

import esfem_core as ec
from esfem_core import solvers

BOX = [[-1.3] * 3, [1.3] * 3]


def ball(x):
    return np.linalg.norm(x, axis=1) - 1


@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_a_level_set_far_from_the_origin_is_meshed_like_one_at_it(offset):
    centre = np.full(3, offset)
    tri = ec.from_level_set(lambda x: ball(x - centre), centre + np.array(BOX), 0.5)
    assert len(tri.vertices) == len(ec.from_level_set(ball, BOX, 0.5).vertices)
    np.testing.assert_allclose(ball(tri.vertices - centre), 0, atol=1e-13 * max(1, 10 * offset))


def test_a_level_set_in_single_precision_is_told():
    def single(x):
        return np.linalg.norm(x.astype(np.float32), axis=1) - np.float32(1)

    for d in (single, lambda x: single(x).astype(float)):
        with pytest.raises(ValueError, match="values of d must be of double precision, got"):
            ec.from_level_set(d, BOX, 0.5)
    with pytest.raises(ValueError, match="values of d must be of double precision, got float32"):
        ec.project_to_level_set(single)(1.05 * np.eye(3))


def test_creases_surfaces_without_end_and_thin_ones_are_told_apart():
    with pytest.raises(ValueError, match="its gradient jumps: the surface has a crease there"):
        ec.from_level_set(lambda x: np.abs(x).max(axis=1) - 1, BOX, 0.4)
    with pytest.raises(
        ValueError, match="its gradient vanishes: the surface has a tip there or meets itself"
    ):  # touches itself at the origin
        ec.from_level_set(
            lambda x: x[:, 0] ** 2 + x[:, 1] ** 2 - x[:, 2] ** 2 * (1 - x[:, 2] ** 2),
            [[-1.6] * 3, [1.6] * 3],
            0.4,
        )
    with pytest.raises(ValueError, match=r"take a larger box$"):
        ec.from_level_set(ball, 0.7 * np.array(BOX), 0.4)
    with pytest.raises(ValueError, match="a surface without an end"):
        ec.from_level_set(lambda x: np.sin(2 * x).sum(axis=1), BOX, 0.4)
    with pytest.raises(ValueError, match=r"h must be smaller .* but zero at"):
        ec.from_level_set(lambda x: np.linalg.norm(x - 0.3, axis=1) - 0.01, BOX, 0.9)
    with pytest.raises(ValueError, match="there is no surface in the box"):
        ec.from_level_set(lambda x: 1 + (x**2).sum(axis=1), BOX, 0.9)


def test_mean_edges_of_meshes_are_in_the_range_that_is_stated():
    def torus(x):
        return np.hypot(np.hypot(x[:, 0], x[:, 1]) - 1, x[:, 2]) - 0.35

    for d, h in ((torus, 0.36), (ball, 0.7), (ball, 1.2)):
        tri = ec.from_level_set(d, [[-1.6] * 3, [1.6] * 3], h)
        assert 0.62 < ec.mesh_quality(tri).h_mean / h < 1.36


@pytest.mark.parametrize(("order", "step"), [(1, 0.02), (2, 0.02), (3, 0.04)])
def test_a_sphere_that_shrinks_to_a_point_stops_the_run(order, step):
    """Volumes stay positive until then; a point reflection leaves all normals as they are."""
    space = ec.SurfaceSpace(ec.sphere("icosahedron", 1))
    run = ec.evolve(space, ec.Problem(1.0, alpha=0.01, beta=1), order, step, 0.6, start="euler")
    states = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(ec.EvolutionError):
            states.extend(run)
    assert min(ec.measure(state).volume for state in states) > 0


@pytest.mark.parametrize("solver", ["lagged", "direct"])
def test_no_solver_is_slow_on_meshes_of_hubs_and_long_triangles(solver):
    """Cuts along the rings of a cylinder made one dense front of 2,400 rows."""
    space = ec.SurfaceSpace(trimesh.creation.cylinder(1, 2, sections=1200))
    assert space.fronts.largest < 200
    run = ec.evolve(space, ec.Problem(1.0, motion=lambda p, t: p), 1, 0.1, 0.1, solver=solver)
    np.testing.assert_allclose(list(run)[-1].u, 1.0, rtol=1e-9)


def test_html_of_names_and_cells_is_escaped():
    from esfem_core.study import ConvergenceTable
    from esfem_core.tables import Html, html_table

    bad = "<script>alert(1)</script>"
    table = ConvergenceTable(bad, np.array([0.1, 0.05]), {bad: np.array([1.0, 0.5])})
    assert bad not in table._repr_html_()
    text = html_table([bad, ""], [[bad, Html("<b>1</b>", "1")]], f'"><{bad}').text
    assert bad not in text
    assert "<b>1</b>" in text  # asked for as HTML
    space = ec.SurfaceSpace(ec.sphere("octahedron", 0))
    states = [ec.State(0.0, space.nodes, None, space.nodes[:, 0], space=space)]
    assert bad not in ec.animate(states, label=bad, title=bad).text


def test_factors_refuse_rows_that_do_not_fit_and_take_no_columns():
    pytest.importorskip("cholespy")
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    M, n = space.mass(space.nodes), len(space.nodes)
    for make in (solvers.superlu, solvers.cholmod):
        with pytest.raises(ValueError, match="b must have shape"):
            make(M).solve(np.ones(n + 50))
        assert make(M).solve(np.empty((n, 0))).shape == (n, 0)
    with pytest.raises(np.linalg.LinAlgError):
        solvers.cholmod(-M)


def test_answers_of_a_direct_solver_are_tested_by_their_residual():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    M, A = space.mass_stiffness(space.nodes)
    b = space.nodes[:, 0]
    skew = (M + A).tocsr()
    skew.data = skew.data * np.linspace(1, 2, skew.nnz)
    with pytest.raises(ValueError, match="must be symmetric and positive definite"):
        ec.DirectSolver().solve(skew, b, b)
    half = SimpleNamespace(solve=lambda b: solvers.superlu(M + A).solve(b) / 2)
    with pytest.raises(np.linalg.LinAlgError, match="must be symmetric and positive definite"):
        ec.DirectSolver(lambda A: half).solve(M + A, b, b)


@pytest.mark.parametrize(("degree", "distance"), [(1, 1e-3), (2, 1e-5), (1, 1e-6), (3, 1e-7)])
def test_needles_that_are_accepted_are_solved_by_every_solver(degree, distance):
    pytest.importorskip("cholespy")
    s = ec.sphere("icosahedron", 2)
    v, (a, b, _) = np.array(s.vertices), s.faces[0]
    v[a] = s.vertices[b] + distance * (s.vertices[a] - s.vertices[b])
    space = ec.SurfaceSpace(trimesh.Trimesh(v, s.faces, process=False), degree)
    problem = ec.Problem(u0=lambda x: 1 + x[:, 0], g=lambda at: 0.01 * at.u, alpha=1, beta=0)
    found = [
        list(ec.evolve(space, problem, 1, 0.05, 0.05, solver=name))[-1].x
        for name in ("direct", "lagged", "cholmod")
    ]
    for other in found[1:]:
        np.testing.assert_allclose(other, found[0], rtol=0, atol=1e-7)


def run_of(space, problem):
    return ec.evolve(space, problem, 2, 0.05, 0.3)


def test_interleaved_runs_and_threads_give_the_bits_of_runs_alone():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 2), 2, ec.to_unit_sphere)
    problems = ec.problems.growing_sphere(), ec.problems.expanding_sphere()
    alone = [list(run_of(space, problem)) for problem in problems]
    fresh = ec.SurfaceSpace(ec.sphere("octahedron", 2), 2, ec.to_unit_sphere)
    woven = zip(*itertools.zip_longest(*(run_of(fresh, p) for p in problems)), strict=True)
    threaded = [[], []]
    shared = ec.SurfaceSpace(ec.sphere("octahedron", 2), 2, ec.to_unit_sphere)
    threads = [
        threading.Thread(target=lambda i=i: threaded[i].extend(run_of(shared, problems[i])))
        for i in range(2)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for found in (list(woven), threaded):
        for states, wanted in zip(found, alone, strict=True):
            for state, other in zip(states, wanted, strict=True):
                np.testing.assert_array_equal(state.x, other.x)
                np.testing.assert_array_equal(state.u, other.u)


def test_a_run_that_is_left_has_saved_its_last_states(tmp_path):
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    run = ec.evolve(space, ec.problems.growing_sphere(), 2, 0.1, 1.0, save=tmp_path / "run.npz")
    for state in run:
        if state.t > 0.45:
            break
    run.close()
    _, states = ec.load(tmp_path / "run.npz")
    assert states[-1].t == state.t


def test_exact_solutions_of_another_surface_or_motion_are_refused():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    double = ec.Exact(lambda p, t: 2 * p, lambda p, t: 0 * p)
    with pytest.raises(ValueError, match="exact must belong to this surface"):
        ec.evolve(space, ec.Problem(law=ec.laws.Regularised(), exact=double), 1, 0.1, 0.2)
    torus = ec.SurfaceSpace(ec.torus())
    with pytest.raises(ValueError, match="exact must belong to this surface, but the node"):
        ec.evolve(torus, ec.problems.growing_sphere(), 1, 0.1, 0.2)
    still = ec.Exact(lambda p, t: p, lambda p, t: 0 * p)
    with pytest.raises(ValueError, match=r"exact must belong to the motion, but at t = 0\.1"):
        ec.evolve(space, ec.Problem(1.0, motion=lambda p, t: (1 + t) * p, exact=still), 1, 0.1, 0.2)


def moved(x, v, step=0.1, end=1.0, size=1.0):
    """Begin a run with exact positions and velocities on a sphere."""
    tri = ec.sphere("octahedron", 1)
    tri.apply_scale(size)
    problem = ec.Problem(species={}, law=ec.laws.Prescribed(motion=x), exact=ec.Exact(x, v))
    ec.evolve(ec.SurfaceSpace(tri), problem, 2, step, end)


WRONG_VELOCITIES = {
    "a field": (lambda p, t: np.exp(t) * p, lambda x, t: x),
    "a rotating field": (
        lambda p, t: np.c_[
            p[:, :1] * np.cos(t) - p[:, 1:2] * np.sin(t),
            p[:, :1] * np.sin(t) + p[:, 1:2] * np.cos(t),
            p[:, 2:],
        ],
        lambda x, t: np.cross([0, 0, 1], x),
    ),
    "twice as large": (lambda p, t: (1 + t) * p, lambda p, t: 2 * p),
    "none": (lambda p, t: (1 + t) * p, lambda p, t: 0 * p),
    "of a surface at rest": (lambda p, t: p, lambda p, t: 1e-3 * p),
    "none of a slow motion": (lambda p, t: (1 + 1e-4 * t) * p, lambda p, t: 0 * p),
}


@pytest.mark.parametrize(("x", "v"), WRONG_VELOCITIES.values(), ids=WRONG_VELOCITIES)
def test_an_exact_velocity_that_is_not_that_of_the_positions_is_refused(x, v):
    with pytest.raises(
        ValueError, match=r"exact\.v must be the velocity d/dt .* points p of the initial surface"
    ):
        moved(x, v)


RIGHT_VELOCITIES = {
    "at rest but for rounding": (
        lambda p, t: p * (np.sin(t) ** 2 + np.cos(t) ** 2),
        lambda p, t: 0 * p,
        {},
    ),
    "fast": (lambda p, t: p + np.sin(200 * t), lambda p, t: 200 * np.cos(200 * t) + 0 * p, {}),
    "long": (
        lambda p, t: p * (1 + np.sin(t) / 2),
        lambda p, t: p * np.cos(t) / 2,
        {"end": 1e5},
    ),
    "slow": (
        lambda p, t: p * (1 + 1e-9 * t),
        lambda p, t: p * 1e-9,
        {"step": 1e7, "end": 1e9},
    ),
    "small": (lambda p, t: p * (1 + t), lambda p, t: p, {"size": 1e-6}),
    "with a kink": (
        lambda p, t: p * (1 + max(t - 0.382, 0)),
        lambda p, t: p * (t > 0.382),
        {},
    ),
    "with a kink and rest": (
        lambda p, t: p * (1 + max(t - 0.62, 0)),
        lambda p, t: p * (t > 0.62),
        {},
    ),
    "only after the start": (
        lambda p, t: p * (1 + math.sqrt(t) ** 3),
        lambda p, t: p * 1.5 * math.sqrt(t),
        {},
    ),
}


@pytest.mark.parametrize(
    ("x", "v", "options"), RIGHT_VELOCITIES.values(), ids=list(RIGHT_VELOCITIES)
)
def test_an_exact_velocity_that_is_that_of_the_positions_is_taken(x, v, options):
    moved(x, v, **options)


def test_exact_velocities_are_not_asked_for_after_a_surface_has_vanished():
    def radius(t):
        return math.sqrt(1 - t)  # raises for t > 1

    space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    exact = ec.Exact(lambda p, t: radius(t) * p, lambda p, t: -p / (2 * radius(t)))
    problem = ec.Problem(law=ec.laws.Regularised(beta=1.0), exact=exact)
    ec.evolve(space, problem, 2, 0.1, 9.0, start="euler")


def test_exact_solutions_refuse_no_times_and_do_not_integrate_for_ever():
    exact = ec.problems.growing_sphere().exact
    np.testing.assert_allclose(exact.x(np.eye(3), 1e12), 2 * np.eye(3), atol=1e-9)  # at rest
    for t in (np.nan, np.inf, -5.0):
        with pytest.raises(ValueError, match=r"^t must"):
            exact.x(np.eye(3), t)
    with pytest.raises(ValueError, match=r"points must be finite"):
        exact.x(np.full((1, 3), np.nan), 0.1)


def test_quadrature_too_weak_for_the_degree_is_refused():
    with pytest.raises(ValueError, match=r"exactness must be 5 or more for elements of degree 3"):
        ec.SurfaceSpace(ec.sphere("octahedron", 0), 3, exactness=4)


def test_the_last_time_is_the_end_itself():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 0))
    for start in ("exact", "euler"):
        for end in (0.333333333333, 1 / 3 + 1e-11):
            run = ec.evolve(space, ec.problems.growing_sphere(), 2, 1 / 3, end, start=start)
            assert list(run)[-1].t == end


def test_equal_steps_of_a_study_are_refused_before_it_computes():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 0))
    with pytest.raises(ValueError, match=r"steps must be positive, neighbours different, got \["):
        ec.study.time_study(space, ec.problems.growing_sphere(), 1, [0.5, 0.5], 0.5)


def test_negative_squares_are_not_cut():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    M, A = space.mass_stiffness(space.nodes)
    assert ec.errors.seminorm(A, np.ones(len(space.nodes))) < 1e-7
    with pytest.raises(ValueError, match="matrix must be positive semidefinite, but has the squ"):
        ec.errors.seminorm(-M, space.nodes)
    with pytest.raises(ValueError, match="K must be positive definite, but has the pivot -0"):
        ec.defects.dual_norm(-M, space.nodes)


def test_an_end_before_the_first_step_is_refused():
    space = ec.SurfaceSpace(ec.sphere("octahedron", 0))
    with pytest.raises(ValueError, match="end/step must be an integer"):
        ec.evolve(space, ec.problems.growing_sphere(), 1, 1e16, 0.5)
