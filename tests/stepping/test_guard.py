"""What is never yielded as good: surfaces inside out or degenerate, functions without bounds."""

import re
import warnings
from contextlib import nullcontext

import numpy as np
import pytest
import trimesh
from hemisphere import hemisphere

import esfem_core as ec
from esfem_core.elements import DegenerateElementError
from esfem_core.stepping import guard as guard_module
from esfem_core.stepping.guard import Guard

TRI = ec.sphere("icosahedron", 2)
SPACE = ec.SurfaceSpace(TRI)
X = SPACE.nodes
N = len(X)
STEP = r"step \d+, t = [\d.]+: "


def two(inner=0.5, shift=0.0, cavity=True):
    """Two spheres in one space, the second one of them the wall of a cavity."""
    other = TRI.copy()
    other.vertices = inner * other.vertices + [shift, 0, 0]
    if cavity:
        other.faces = other.faces[:, ::-1]
    return ec.SurfaceSpace(trimesh.util.concatenate([TRI, other]))


def guard(space=SPACE, growth=1e12, **fields):
    return Guard(space, space.nodes, fields, growth)


def normal_and_shape(corners):
    """Twice the areas as vectors, and 1 for an equilateral triangle, 0 for a flat one."""
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    squares = sum(((corners[j] - corners[j - 1]) ** 2).sum(axis=1) for j in range(3))
    return normal, 2 * np.sqrt(3) * np.linalg.norm(normal, axis=1) / squares


class TestSurfaces:
    def test_moved_turned_and_stretched_ones_are_good(self):
        own, x = guard(), X.copy()
        rotation = trimesh.transformations.rotation_matrix(0.5, [1, 2, 3])[:3, :3]
        for _ in range(30):  # in steps; by more than a turn in all
            x = 1.1 * x @ rotation.T + [3, 1, 0]
            own.look_at_surface(x)
        own.look_at_surface(x * [1, 1, 0.1])

    def test_inside_out(self):
        """The map x -> -x leaves the normal of every triangle as it is."""
        own = guard()
        message = (
            r"the surface is inside out \(enclosed volume -4\.\d+\), near \[.*\]: it has shrunk "
            "to a point or passed through itself"
        )
        with pytest.raises(DegenerateElementError, match=message):
            own.look_at_surface(-X)
        with pytest.raises(DegenerateElementError, match="volume -4"):  # wherever it is
            own.look_at_surface(100 - X)
        own.look_at_surface(X)

    def test_mirrored(self):
        with pytest.raises(DegenerateElementError, match="has turned over: its normal") as error:
            guard().look_at_surface(X * [-1, 1, 1])
        normal = TRI.face_normals[error.value.element]
        assert abs(normal[0]) < np.sqrt(0.5)  # (n1, n2, n3) has become (n1, -n2, -n3)

    def test_one_turned_triangle(self):
        x = X.copy()
        corner = SPACE.cells[17, 0]
        x[corner] = 3 * x[SPACE.cells[17, 1:]].mean(axis=0) - 2 * x[corner]
        with pytest.raises(
            DegenerateElementError, match=r"element \d+ near \[.*\] has turned over"
        ) as error:
            guard().look_at_surface(x)
        assert corner in SPACE.cells[error.value.element]

    def test_normals_are_compared_with_those_of_the_step_before(self):
        """Half a turn at once is refused, in three steps it is a rotation."""
        own = guard()
        angles = [np.pi / 3, 2 * np.pi / 3, np.pi]
        turned = [
            X @ trimesh.transformations.rotation_matrix(a, [0, 0, 1])[:3, :3].T for a in angles
        ]
        with pytest.raises(DegenerateElementError, match="has turned over"):
            own.look_at_surface(turned[-1])
        for x in turned:
            own.look_at_surface(x)

    @pytest.mark.parametrize(
        "path",
        [
            pytest.param(lambda s: X * [1, 1, 1 - s], id="pressed flat, and on"),
            pytest.param(lambda s: X * (1 - s), id="shrunk to a point, and on"),
            pytest.param(
                lambda s: X + s * np.eye(N)[:, [7]] * (X[TRI.vertex_neighbors[7][0]] - X[7]),
                id="a vertex to the next, and on",
            ),
        ],
    )
    @pytest.mark.parametrize("step", [1 / 7, 1 / 30, 1 / 400, 1 / 2000])
    def test_what_need_not_be_looked_at_would_have_been_found_good(self, path, step, monkeypatch):
        """A guard that looks at every step says the same of the same step, in the same words."""

        def said():
            own, all_said = guard(), []
            for n in range(1, round(1.5 / step)):
                with warnings.catch_warnings(record=True) as warned:
                    warnings.simplefilter("always")
                    try:
                        own.look_at_surface(path(n * step))
                    except DegenerateElementError as error:
                        return [*all_said, (n, str(error))]
                all_said += [(n, str(w.message)) for w in warned]
            return all_said

        now_and_then = said()
        monkeypatch.setattr(Guard, "_safe_distance", lambda *_: 0.0)
        assert now_and_then == said() != []

    def test_no_move_within_the_safe_distance_spoils_a_triangle(self):
        """Each vertex goes to the opposite side, or out of the plane, and that side against it."""
        needle = TRI.copy()
        needle.vertices[7] += 0.96 * (X[TRI.vertex_neighbors[7][0]] - X[7])
        for tri in (TRI, needle, trimesh.creation.cylinder(0.1, 2)):
            space = ec.SurfaceSpace(tri)
            own = guard(space)
            corners = space.nodes[space.cells].swapaxes(0, 1)
            normal, shape = normal_and_shape(corners)
            a, b, c = corners
            along = (c - b) * ((a - b) * (c - b)).sum(axis=1, keepdims=True)
            down = b + along / ((c - b) ** 2).sum(axis=1, keepdims=True) - a
            for way in (
                down,
                normal,
                down + normal / np.sqrt(np.linalg.norm(normal, axis=1))[:, None],
            ):
                way = own._reach * way / np.abs(way).max(axis=1, keepdims=True)
                new_normal, new_shape = normal_and_shape(np.stack([a + way, b - way, c - way]))
                sizes = np.linalg.norm(normal, axis=1) * np.linalg.norm(new_normal, axis=1)
                assert ((normal * new_normal).sum(axis=1) > np.cos(np.pi / 6) * sizes).all()
                assert (new_shape > np.maximum(own._narrow, shape / 3)).all()

    def test_no_move_within_the_safe_distance_turns_a_thin_surface_inside_out(self):
        tri = ec.sphere("octahedron", 0)
        thin = trimesh.Trimesh(tri.vertices * [1, 1, 0.01], tri.faces, process=False)
        own = guard(ec.SurfaceSpace(thin))
        assert 0 < own._reach < 0.01
        moved = thin.vertices - own._reach * np.sign(thin.vertices)
        own._reach = 0.0
        own.look_at_surface(moved)

    def test_a_step_is_judged_by_itself_where_the_one_before_was_not_looked_at(self):
        """A turn by half a degree was not worth a look; by 89.7 degrees more is still allowed."""
        own = guard()
        turned = [
            X @ trimesh.transformations.rotation_matrix(np.deg2rad(a), [0, 0, 1])[:3, :3].T
            for a in (0.5, 90.2)
        ]
        assert np.abs(turned[0] - X).max() < own._reach
        for x in turned:
            own.look_at_surface(x)

    def test_degenerate_and_not_finite(self):
        flat = X.copy()
        a, b, c = SPACE.cells[11]
        flat[a] = (flat[b] + flat[c]) / 2
        with pytest.raises(DegenerateElementError, match=r"element 11 near \[.*\] is degenerate"):
            guard().look_at_surface(flat)
        with pytest.raises(DegenerateElementError, match=r"element \d+ near \[.*\] is degenerate"):
            guard().look_at_surface(X * [1, 0, 0])  # all of them at once
        for value in (np.nan, np.inf):
            x = X.copy()
            x[5, 2] = value
            with (
                np.errstate(invalid="ignore"),
                pytest.raises(
                    DegenerateElementError, match=r"element \d+ near .* is not finite"
                ) as e,
            ):
                guard().look_at_surface(x)
            assert 5 in SPACE.cells[e.value.element]


@pytest.mark.parametrize(
    ("motion", "rate"), [(lambda x, t: x * [1, 1, 1 - 0.99 * t], 0.0), (lambda x, t: x, 50.0)]
)
def test_warnings_point_to_the_loop_over_the_run(motion, rate):
    problem = ec.Problem(
        law=ec.laws.Prescribed(motion=motion),
        u0=lambda x: np.ones(len(x)),
        f=lambda at: rate * at.u,
    )
    with pytest.warns(ec.EvolutionWarning) as caught:
        list(ec.evolve(SPACE, problem, 1, 0.01, 1.0 if rate == 0 else 0.5))
    assert caught[0].filename == __file__


class TestSeveralComponents:
    def test_one_of_two_is_inside_out(self):
        space = two(shift=4.0, cavity=False)
        own, x = guard(space), space.nodes.copy()
        own.look_at_surface(x)
        x[N:] = 8 - x[N:]
        message = r"component 1 of the surface is inside out \(enclosed volume -0\.5"
        with pytest.raises(DegenerateElementError, match=message) as error:
            own.look_at_surface(x)
        assert error.value.element >= len(TRI.faces)

    def test_a_cavity_may_stay_one(self):
        space = two()
        own, x = guard(space), space.nodes.copy()
        own.look_at_surface(0.5 * x)
        x[N:] *= 0.01
        own.look_at_surface(x.copy())
        x[N:] *= -1
        message = r"component 1 of the surface is inside out \(enclosed volume 5\.\d+e-07\)"
        with pytest.raises(DegenerateElementError, match=message):
            own.look_at_surface(x)

    def test_a_run_with_a_cavity_ends_when_the_cavity_closes(self):
        """Both walls move inwards with speed 1; the inner one has the radius 1/2."""

        def g(at):
            speed = np.ones(at.density.shape)  # the normal points into the cavity
            speed[: len(TRI.faces)] = -1
            return speed

        problem, states = ec.Problem(g=g, alpha=0, beta=0), []
        with pytest.raises(ec.EvolutionError, match=r"is inside out|has turned over") as error:
            states.extend(ec.evolve(two(), problem, 1, 0.09, 0.9))
        assert error.value.element >= len(TRI.faces)
        assert [round(s.t, 2) for s in states] == [0.0, 0.09, 0.18, 0.27, 0.36, 0.45]


def needle(share):
    """The sphere with an edge that has shrunk to this share of its length."""
    x, (a, b, _) = X.copy(), SPACE.cells[11]
    x[a] = x[b] + share * (x[a] - x[b])
    return x


class TestNarrowAngles:
    def test_they_are_worth_one_warning(self):
        own = guard()
        message = r"element \d+ near \[.*\] has an angle below one degree: the run will hardly"
        with pytest.warns(ec.EvolutionWarning, match=message):
            own.look_at_surface(needle(0.004))
        own.look_at_surface(needle(0.003))  # warnings are errors here

    @pytest.mark.parametrize(("degrees", "good"), [(55, True), (65, False)])
    def test_they_turn_by_60_degrees_at_most(self, degrees, good):
        own, x = guard(), needle(0.004)
        axis = np.cross(TRI.face_normals[11], [0.3, 0.5, 0.8])
        turn = trimesh.transformations.rotation_matrix(np.radians(degrees), axis)[:3, :3]
        with pytest.warns(ec.EvolutionWarning, match="angle below one degree"):
            own.look_at_surface(x)
        message = r"element \d+ near \[.*\], with an angle below one degree, has turned over"
        with nullcontext() if good else pytest.raises(DegenerateElementError, match=message):
            own.look_at_surface(x @ turn.T)
        guard().look_at_surface(X @ turn.T)  # others may

    def test_a_mesh_that_has_them_at_the_start_is_not_worth_one(self):
        thin = TRI.copy()
        thin.vertices = thin.vertices * [1, 1, 0.002]
        space = ec.SurfaceSpace(thin)
        own = guard(space)
        own.look_at_surface(1.5 * space.nodes)
        with pytest.warns(ec.EvolutionWarning, match="angle below one degree"):
            own.look_at_surface(space.nodes * [1, 1, 0.1])


def shear(x, t):
    """Layers of the sphere turn around its axis, neighbours in opposite directions."""
    return np.sin(4 * x[:, 2])[:, None] * np.cross([0, 0, 1], x)


def moved(**how):
    return ec.Problem(species={}, law=ec.laws.Prescribed(**how))


def curved(refinements, degree):
    return ec.SurfaceSpace(ec.sphere("icosahedron", refinements), degree, ec.to_unit_sphere)


class TestFolds:
    """Triangles that come to lie on each other in many steps, in none of which one turns over."""

    MESSAGE = (
        r"element \d+ near \[.*\] lies on element \d+, with 5\d degrees between them: the surf"
    )

    @pytest.mark.parametrize("degree", [1, 2])
    def test_a_sphere_that_is_wound_up_is_worth_one_warning(self, degree):
        with pytest.warns(ec.EvolutionWarning, match=self.MESSAGE) as caught:
            *_, last = ec.evolve(curved(1, degree), moved(velocity=shear), 2, 0.05, 1.5)
        assert len(caught) == 1
        assert ec.measure(last).area > 1.1 * 4 * np.pi  # which is that of the sphere

    @pytest.mark.parametrize("degree", [2, 3])
    def test_nodes_inside_of_elements_fold_these_alone(self, degree):
        """The corners stay, and with them all that the flat triangles tell."""
        space = curved(1, degree)
        ways = np.random.default_rng(0).standard_normal(space.nodes.shape)
        ways[np.unique(space.cells[:, :3])] = 0

        def X(p, t):
            return ec.to_unit_sphere(p + t * ways[: len(p)]) if len(p) == len(ways) else p

        with pytest.warns(ec.EvolutionWarning, match="has a normal at more than a right") as caught:
            list(ec.evolve(space, moved(motion=X), 1, 0.05, 0.5))
        assert len(caught) == 1

    @pytest.mark.parametrize(
        ("space", "problem", "step"),
        [
            (curved(1, 2), ec.problems.growing_sphere(), 0.05),
            (curved(2, 1), ec.problems.baseball_bat(), 0.1),
            (curved(2, 2), ec.problems.baseball_bat(), 0.05),
            (curved(1, 2), ec.Problem(species={}, law=ec.laws.MeanCurvature()), 0.02),
        ],
        ids=["growing sphere", "bat", "bat, k = 2", "mean curvature"],
    )
    def test_surfaces_that_elements_follow_are_worth_none(self, space, problem, step):
        *_, last = ec.evolve(space, problem, 2, step, 10 * step)  # warnings are errors here
        assert last.t == pytest.approx(10 * step)

    def test_what_is_sharp_at_the_start_is_no_fold(self):
        """The rim of a lens, unless it becomes sharper still."""
        lens = TRI.copy()
        lens.vertices = lens.vertices * [1, 1, 0.05]
        space = ec.SurfaceSpace(lens)
        own = guard(space)

        def look(x):
            own.look_at_surface(x)
            own.warn_of_folds(x, space)

        look(2 * space.nodes)
        look(space.nodes * [1, 1, 0.7])
        with pytest.warns(ec.EvolutionWarning, match="lies on element"):
            look(space.nodes * [1, 1, 0.4])

    def test_they_are_looked_for_where_triangles_are(self, monkeypatch):
        looked = []
        monkeypatch.setattr(guard_module, "fold_of", lambda *a: looked.append(a))
        own = guard()
        for x in (X + 0.4 * own._reach, X + 0.8 * own._reach, 1.5 * X, 1.5 * X):
            own.look_at_surface(x)
            own.warn_of_folds(x, SPACE)
        assert len(looked) == 1

    def test_a_run_that_goes_on_from_a_save_says_what_a_whole_one_says(self, tmp_path):
        """Good states give no warning; folded ones are folded still."""
        space, problem = curved(1, 1), moved(velocity=shear)

        def warned_at(run):
            with pytest.warns(ec.EvolutionWarning, match="lies on element") as caught:
                return next(state for state in run if caught)

        def gone_on(states):
            ec.save(tmp_path / "run.npz", states)
            loaded, states = ec.load(tmp_path / "run.npz")
            return ec.evolve(loaded, problem, 2, 0.05, states[-1].t + 0.5, start=states)

        good = list(ec.evolve(space, problem, 2, 0.05, 0.5))  # warnings are errors here
        first = warned_at(ec.evolve(space, problem, 2, 0.05, 1.0))
        assert first.t == warned_at(gone_on(good)).t == pytest.approx(0.85)
        with pytest.warns(ec.EvolutionWarning, match="lies on element"):
            folded = list(gone_on(good))
        assert warned_at(gone_on(folded)).t == pytest.approx(1.05)


class TestFunctions:
    def test_a_function_may_grow_a_millionfold(self):
        own = guard(u=np.linspace(-2, 1, N))
        own.look_at_functions(X, {"u": np.linspace(0, 2e6, N)})

    @pytest.mark.parametrize("sign", [1, -1])
    def test_more_is_worth_one_warning_each(self, sign):
        own = guard(u=np.ones(N), w=2 * X)
        u, w = np.ones(N), 2 * X
        u[7], w = sign * 2e6, w.copy()
        w[9, 1] = sign * 3e6
        where = r"near \[ *-?[\d.]+ +-?[\d.]+ +-?[\d.]+\]: the step is too large"
        with pytest.warns(ec.EvolutionWarning) as caught:
            own.look_at_functions(X, {"u": u, "w": w})
        own.look_at_functions(X, {"u": u, "w": w})
        assert len(caught) == 2
        texts = [
            r"u has grown to 2e\+06, 2e\+06 times its largest value at the start, at node 7",
            r"w has grown to 3e\+06, 2e\+06 times its largest value at the start, at node 9",
        ]
        for warning, text in zip(caught, texts, strict=True):
            assert re.search(f"{text} {where}", str(warning.message))

    def test_more_than_what_is_allowed_is_an_error(self):
        own = guard(growth=100, u=np.ones(N))
        own.look_at_functions(X, {"u": np.full(N, 99.0)})
        with pytest.warns(ec.EvolutionWarning, match="u has grown"):
            guard(u=np.ones(N)).look_at_functions(X, {"u": np.full(N, 1e12)})
        with pytest.raises(
            FloatingPointError,
            match=r"u has grown to 1\.1e\+12, .* \(allowed: growth = 1e\+12 times; growth=inf lets",
        ):
            guard(u=np.ones(N)).look_at_functions(X, {"u": np.full(N, 1.1e12)})

    def test_a_function_that_starts_from_zero_has_no_bound_but_must_be_finite(self):
        own = guard(growth=2, u=np.zeros(N))
        for size in (0.0, 1e-300, 1.0, 1e99):
            own.look_at_functions(X, {"u": np.full(N, size)})
        with pytest.raises(FloatingPointError, match="u is not finite"):
            own.look_at_functions(X, {"u": np.full(N, np.inf)})

    @pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
    def test_what_is_not_finite_has_a_place(self, value):
        w = np.zeros((N, 2))
        w[30, 1] = value
        with pytest.raises(FloatingPointError, match=r"w is not finite at node 30 near \[.*\]"):
            guard(w=np.ones((N, 2))).look_at_functions(X, {"w": w})


class TestGrowthInRuns:
    PROBLEM = ec.Problem(1.0, f=lambda at: 100 * at.u, motion=lambda p, t: p)

    def test_a_run_in_pieces_warns_of_what_is_no_quantity(self):
        """None of the pieces reaches the bound of its own."""
        unstable = ec.Problem(1.0, f=lambda at: -1000 * at.u, motion=lambda p, t: p)
        states = list(ec.evolve(SPACE, unstable, 1, 0.05, 0.05))
        said = []
        for _ in range(22):
            with warnings.catch_warnings(record=True) as found:
                warnings.simplefilter("always")
                end = states[-1].t + 0.15
                states = list(ec.evolve(SPACE, unstable, 1, 0.05, end, start=states[-1:]))
            said.append([str(one.message) for one in found])
        assert abs(states[-1].u).max() > 1e110
        assert not any(said[:19])
        assert all(text.startswith("u has grown to ") for [text] in said[20:])
        assert "a run that goes on from states begins anew to compare values" in said[-1][0]

    def test_values_that_are_huge_from_the_start_have_not_grown(self):
        own = guard(u=np.full(N, 1e200))
        own.look_at_functions(X, {"u": np.full(N, 1.5e200)})

    def test_a_run_warns_once_and_stops_at_the_bound(self):
        states = []
        with (
            pytest.warns(ec.EvolutionWarning, match="u has grown to") as caught,
            pytest.raises(ec.EvolutionError, match=STEP + r".*growth = 1e\+12 times") as error,
        ):
            states.extend(ec.evolve(SPACE, self.PROBLEM, 1, 0.1, 10.0))
        # Each step multiplies by 11: 11^6 > 1e6 and 11^12 > 1e12.
        assert len(caught) == 1
        assert error.value.step == len(states) == 12
        assert abs(states[-1].u).max() == pytest.approx(11.0**11, rel=1e-9)

    @pytest.mark.parametrize(("growth", "steps"), [(100, 2), (1e3, 3), (11.0**5 * 1.001, 6)])
    def test_the_bound_is_the_users(self, growth, steps):
        states = []
        with pytest.raises(ec.EvolutionError, match="u has grown to") as error:
            states.extend(ec.evolve(SPACE, self.PROBLEM, 1, 0.1, 10.0, growth=growth))
        assert error.value.step == len(states) == steps

    def test_a_pulse_from_nothing_has_the_amount_of_its_source(self):
        """From values of 1e-44 in the first step to the integral of the pulse."""
        problem = ec.Problem(
            0.0, f=lambda at: np.exp(-(((at.t - 0.5) / 0.05) ** 2)), motion=lambda p, t: p
        )
        *_, last = ec.evolve(SPACE, problem, 2, 0.01, 1.0)
        np.testing.assert_allclose(last.u, 0.05 * np.sqrt(np.pi), rtol=1e-9)

    def test_what_is_zero_but_for_rounding_is_let_on_as_the_message_says(self):
        problem = ec.Problem(lambda x: 1e-16 * x[:, 0], f=lambda at: 1.0, motion=lambda p, t: p)
        with pytest.raises(ec.EvolutionError, match=r"growth=inf lets it go on, such as from val"):
            list(ec.evolve(SPACE, problem, 1, 0.1, 1.0))
        with pytest.warns(ec.EvolutionWarning, match="u has grown to"):
            *_, last = ec.evolve(SPACE, problem, 1, 0.1, 1.0, growth=np.inf)
        np.testing.assert_allclose(last.u, 1.0, rtol=1e-9)

    @pytest.mark.parametrize("infinity", [np.float32("inf"), np.float64("inf"), np.array(np.inf)])
    def test_infinity_may_be_a_number_of_any_library(self, infinity):
        with pytest.warns(ec.EvolutionWarning, match="u has grown to"):
            *_, last = ec.evolve(SPACE, self.PROBLEM, 1, 0.1, 1.5, growth=infinity)
        np.testing.assert_allclose(last.u, 11.0**15, rtol=1e-9)

    @pytest.mark.parametrize("growth", [1, 0.5, -np.inf, np.nan])
    def test_bounds_that_are_none_are_refused(self, growth):
        with pytest.raises(ValueError, match="growth must be a finite number > 1, got"):
            ec.evolve(SPACE, self.PROBLEM, 1, 0.1, 10.0, growth=growth)


@pytest.mark.filterwarnings("ignore::esfem_core.EvolutionWarning")
def test_a_reaction_that_is_too_fast_for_its_step_is_named():
    """Two reacting substances, at rest: fine with steps of 5, unstable with steps of 50."""

    def f(at):
        a, b = np.moveaxis(at.u, -1, 0)
        return np.stack([-a * b**2 + 0.04 * (1 - a), a * b**2 - 0.1 * b], axis=-1)

    u0 = np.where(X[:, 2:] > 0.9, [[0.5, 0.25]], [[1.0, 0.0]])
    D = np.array([2e-3, 1e-3])
    problem = ec.Problem(u0, f=f, motion=lambda p, t: p, diffusivity=D)
    assert abs(list(ec.evolve(SPACE, problem, 2, 5, 500))[-1].u).max() < 1.1
    states = []
    with pytest.raises(
        ec.EvolutionError,
        match=STEP + r"u has grown to .*e\+\d\d, .* at node \d+ near \[.*\]: the step is too",
    ):
        states.extend(ec.evolve(SPACE, problem, 2, 50, 500))
    assert 2 <= len(states) < 11
    assert max(abs(s.u).max() for s in states) < 1e12


@pytest.mark.parametrize(("order", "step"), [(1, 0.02), (2, 0.02), (3, 0.04)])
@pytest.mark.filterwarnings("ignore::esfem_core.EvolutionWarning")
def test_a_sphere_does_not_shrink_through_a_point(order, step):
    """It is gone at t = 0.27. Order 1 creeps up to the point, where u has grown too large."""
    problem, states = ec.Problem(1.0, alpha=0.01, beta=1), []
    message = "the surface is inside out .* shrunk to a point"
    if order == 1:
        message = (
            r"u has grown to .*, or the surface shrinks to a point, .* it is \d\.\de-0\d across"
        )
    with pytest.raises(ec.EvolutionError, match=STEP + message) as error:
        states.extend(ec.evolve(SPACE, problem, order, step, 0.6, start="euler"))
    assert 0.25 < error.value.t < 0.6
    for state in states:
        assert trimesh.Trimesh(state.x, TRI.faces, process=False).volume > 0


OCTAHEDRON = ec.SurfaceSpace(ec.sphere("octahedron", 2))


@pytest.mark.parametrize(
    ("motion", "step", "message"),
    [
        (lambda p, t: p * (1 - 2 * t / 0.21), 0.03, "the surface is inside out"),
        (lambda p, t: p if t < 0.1 else p * [-1, 1, 1], 0.03, "has turned over"),
        (
            lambda p, t: np.where(np.arange(len(p))[:, None] == 0, p * (1 - 20 * t), p),
            0.21,
            "has turned over",
        ),
    ],
    ids=["through a point", "mirrored", "one vertex through the other side"],
)
def test_a_prescribed_motion_that_turns_the_surface_over_stops(motion, step, message):
    problem = ec.Problem(lambda x: 1 + x[:, 0], motion=motion)
    with pytest.raises(ec.EvolutionError, match=STEP + f".*{message}") as error:
        list(ec.evolve(OCTAHEDRON, problem, 1, step, 0.21))
    assert error.value.element is not None


def dumbbell(x):
    balls = [np.linalg.norm(x - [c, 0, 0], axis=1) - 1 for c in (-1.5, 1.5)]
    neck = np.hypot(x[:, 1], x[:, 2]) - 0.3 + 50 * np.maximum(np.abs(x[:, 0]) - 1.5, 0) ** 3
    return -0.1 * np.logaddexp.reduce([-v / 0.1 for v in (*balls, neck)])


@pytest.mark.parametrize(("order", "last"), [(1, 0.09), (2, 0.06)])
@pytest.mark.filterwarnings("ignore:.* lies on element:esfem_core.EvolutionWarning")
def test_a_dumbbell_ends_at_its_pinch(order, last):
    """In no state the neck has come out on the other side of its axis, which it does at 0.095."""
    tri = ec.from_level_set(dumbbell, [[-2.8, -1.3, -1.3], [2.8, 1.3, 1.3]], 0.15)
    space, problem, states = ec.SurfaceSpace(tri), ec.Problem(1.0, alpha=0), []
    with pytest.raises(ec.EvolutionError, match=STEP + r"element \d+ .*has turned over"):
        states.extend(ec.evolve(space, problem, order, 0.01, 0.3))
    assert states[-1].t == pytest.approx(last)
    for state in states:
        normals = trimesh.Trimesh(state.x, tri.faces, process=False).vertex_normals
        outwards = (normals * state.x * [0, 1, 1]).sum(axis=1)
        assert outwards[abs(state.x[:, 0]) < 0.2].min() > 0


@pytest.mark.parametrize(
    "motion", [lambda p, t: p * (1 - 2 * t / 0.21), lambda p, t: (1 - 2 * (t > 0.1)) * p]
)
def test_a_surface_with_a_boundary_that_passes_through_a_point_is_warned_of(motion):
    space = hemisphere(2)
    problem = ec.Problem(lambda x: 1 + x[:, 0], motion=motion)
    with pytest.warns(ec.EvolutionWarning, match="turned within its plane"):
        list(ec.evolve(space, problem, order=1, step=0.03, end=0.21))


def test_a_surface_with_a_boundary_may_turn_and_shrink():
    space = hemisphere(2)
    watch = guard(space)
    c, s = np.cos(1.5), np.sin(1.5)
    watch.look_at_surface(0.1 * space.nodes @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]))
