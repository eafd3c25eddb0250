"""Runs that go on from their own last states, as if they had never been interrupted."""

import dataclasses
import pickle
from fractions import Fraction

import numpy as np
import pytest
import trimesh

import esfem_core as ec

SPACE = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)
STEP = 0.1 / 3  # no multiple of it but the third is a short decimal
STEPS = 13
MASSES = ("updated", "extrapolated", "reassembled")


class Curved(ec.laws.Law):
    """V = u nu + w for a vector w that the law carries, with a slip of its nodes."""

    species = {  # noqa: RUF012
        "w": ec.Species(lambda x: 0.1 * x[:, [1, 2, 0]], lambda at: -at["w"], conserved=False),
        "m": ec.Species(lambda x: 1 + 0.2 * x[:, 2], diffusivity=0.3),
    }

    def velocity(self, at, new, tau, past, solve):
        b = at.load(at["m"][..., None] * at.normal) + at.M @ new["w"]
        return solve(at.matrix(1.0, 0.5), b)

    def slip(self, at):
        return 0.1 * np.cross([0, 0, 1], at.x)


def stretch(p, t):
    return p * [1 + 0.3 * np.sin(t), 1, np.exp(-t / 2)]


def reaction(at):
    a, b = at["a"], at["b"]
    return 0.1 - a + a**2 * b[..., 0] + 0.1 * np.sin(at.t)


TWO = {
    "a": ec.Species(lambda x: 1 + 0.3 * x[:, 0] * x[:, 1], reaction, rate=0.5, diffusivity=0.5),
    "b": ec.Species(
        lambda x: 0.9 + 0.1 * x[:, :2],
        lambda at: (0.9 - at["b"], 0.1 * at.grad("b")),
        diffusivity=[1.0, 0.2],
        conserved=False,
    ),
}

PROBLEMS = {
    "coupled": ec.Problem(
        lambda x: 1 + x[:, 0] * x[:, 1],
        f=lambda at: np.sin(at.u) + at.grad_u[..., 0] * at.t,
        g=lambda at: 1 + at.u + at.points[..., 2] * np.cos(3 * at.t),
        alpha=0.7,
        beta=0.3,
    ),
    "exact": ec.problems.expanding_sphere(),
    "motion": ec.Problem(lambda x: x[:, 0], lambda at: at.points[..., 0] * at.t, motion=stretch),
    "flow": ec.Problem(
        species={"u": ec.Species(lambda x: x[:, 0])},
        law=ec.laws.Prescribed(velocity=lambda x, t: x * [np.cos(t), 0.2, -0.3]),
    ),
    "two species": ec.Problem(
        species=TWO,
        law=ec.laws.Regularised(0.7, 0.3, lambda at: 0.5 * at["a"] * np.cos(at.t)),
    ),
    "two species on a motion": ec.Problem(species=TWO, law=ec.laws.Prescribed(stretch)),
    "law with functions": ec.Problem(species=TWO, law=Curved()),
    "surface alone": ec.Problem(g=lambda at: 2 + at.points[..., 0] + at.t),
}


def same(ours, theirs, atol=0.0):
    """All of two states; the velocities of starting states are not known."""
    assert ours.t == theirs.t
    assert list(ours.fields) == list(theirs.fields)
    for name in ours.fields:
        np.testing.assert_allclose(ours[name], theirs[name], rtol=0, atol=atol, err_msg=name)
    np.testing.assert_allclose(ours.x, theirs.x, rtol=0, atol=atol)
    if ours.v is not None and theirs.v is not None:
        np.testing.assert_allclose(ours.v, theirs.v, rtol=0, atol=30 * atol)  # divided by the step
    for name in theirs.products:
        a, b = ours.products[name], theirs.products[name]
        np.testing.assert_allclose(a, b, rtol=0, atol=atol)


def run(problem, p, **options):
    return list(ec.evolve(SPACE, problem, p, STEP, **{"end": STEPS * STEP} | options))


@pytest.mark.parametrize("p", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("mass", MASSES)
@pytest.mark.parametrize("name", PROBLEMS)
def test_the_same_bits_with_direct_solves(name, mass, p):
    problem, options = PROBLEMS[name], {"mass": mass, "solver": "direct"}
    whole = run(problem, p, **options)
    for cut in (p + 1, STEPS - 2):  # some and all of the last p states have products
        first = run(problem, p, end=whole[cut].t, **options)
        same(first[-1], whole[cut])
        again = run(problem, p, start=first[-p:], **options)
        assert len(again) == len(whole) - cut + p - 1
        for ours, theirs in zip(again, whole[cut - p + 1 :], strict=True):
            same(ours, theirs)


@pytest.mark.parametrize("p", [1, 3, 5])
@pytest.mark.parametrize("mass", MASSES)
def test_the_same_bits_after_every_single_step(mass, p):
    problem, options = PROBLEMS["two species"], {"mass": mass, "solver": "direct"}
    whole = run(problem, p, **options)
    states = whole[:p]
    for theirs in whole[p:]:
        *_, last = run(problem, p, start=states, end=theirs.t, **options)
        same(last, theirs)
        states = [*states[1:], last]


@pytest.mark.parametrize("p", [1, 4])
@pytest.mark.parametrize("mass", MASSES)
@pytest.mark.parametrize("name", PROBLEMS)
def test_nine_digits_with_the_iterative_solver(name, mass, p):
    whole = run(PROBLEMS[name], p, mass=mass)
    again = run(PROBLEMS[name], p, mass=mass, start=whole[p + 1 : 2 * p + 1])
    same(again[-1], whole[-1], atol=1e-9)


@pytest.mark.parametrize("mass", MASSES)
def test_the_same_bits_from_times_that_are_no_multiples_of_the_step(mass):
    problem, options = PROBLEMS["coupled"], {"mass": mass, "solver": "direct"}
    shifted = [dataclasses.replace(s, t=s.t + 0.0171) for s in run(problem, 3)[:3]]
    end = shifted[-1].t + 7 * STEP
    whole = run(problem, 3, start=shifted, end=end, **options)
    first = run(problem, 3, start=shifted, end=whole[6].t, **options)
    again = run(problem, 3, start=first[-3:], end=end, **options)
    assert [s.t for s in again] == [s.t for s in whole[4:]]
    same(again[-1], whole[-1])
    assert whole[-1].t == end


def test_the_same_bits_after_pickling():
    problem, options = PROBLEMS["two species"], {"mass": "extrapolated", "solver": "direct"}
    whole = run(problem, 4, **options)
    start = pickle.loads(pickle.dumps(whole[5:9]))
    same(run(problem, 4, start=start, **options)[-1], whole[-1])


def test_perturbations_go_on_with_the_numbers_of_their_steps():
    problem, seen = PROBLEMS["coupled"], []

    def perturbation(n):
        seen.append(n)
        return {"u": np.full(len(SPACE.nodes), 0.1 * np.sin(n)), "v": 0.1 * SPACE.nodes}

    options = {"solver": "direct", "perturbation": perturbation}
    whole = run(problem, 2, **options)
    seen.clear()
    again = run(problem, 2, start=whole[5:7], **options)
    assert seen == list(range(7, STEPS + 1))
    same(again[-1], whole[-1])


@pytest.mark.parametrize("p", [1, 2])
@pytest.mark.parametrize("mass", ["updated", "extrapolated"])
def test_an_amount_that_is_kept_is_kept_in_parts(mass, p):
    """Without the products M(x~) u of its states, a run of (2.19) in parts loses 6 % for p = 1."""
    problem = ec.Problem(lambda x: 1 + 0 * x[:, 0], g=lambda at: 2 * at.u, alpha=1, beta=0.1)
    space = ec.SurfaceSpace(ec.sphere("octahedron", 3))
    options = {"order": p, "step": 1 / 40, "mass": mass}

    def amount(state):
        return space.mass(state.x).sum(axis=0) @ state.u

    whole = list(ec.evolve(space, problem, end=1.0, **options))
    states = list(ec.evolve(space, problem, end=0.25, **options))
    for end in (0.5, 0.75, 1.0):
        states = list(ec.evolve(space, problem, end=end, start=states[-p:], **options))
    assert amount(states[-1]) == pytest.approx(amount(whole[-1]), rel=1e-9)
    if mass == "updated":
        assert amount(states[-1]) == pytest.approx(amount(whole[0]), rel=1e-12)
    bare = [dataclasses.replace(s) for s in whole[10 : 10 + p]]
    without = list(ec.evolve(space, problem, end=1.0, start=bare, **options))
    lost = abs(amount(without[-1]) / amount(whole[-1]) - 1)
    assert (lost > 1e-5) == (mass == "extrapolated")


def advised(message, **names):
    """What the advice at the end of a message makes."""
    return eval(str(message).rpartition("; ")[2].partition(" has it")[0], names)


@pytest.mark.parametrize("p", [1, 3])
def test_a_function_that_is_added_as_advised_leaves_the_history(p):
    """Without the products M(x~) u the amount was off by 2 % for p = 1."""
    problem = ec.Problem(1.0, g=lambda at: 2 * at.u, alpha=1, beta=0.1)
    species = {**problem.species, "w": ec.Species(0.0)}
    marked = ec.Problem(species=species, law=problem.law)
    options = {"order": p, "step": STEP, "mass": "extrapolated", "solver": "direct"}
    whole = list(ec.evolve(SPACE, problem, end=8 * STEP, **options))
    states = whole[4 - p : 4]
    with pytest.raises(ValueError, match=r"'w', it has 'u'; state\.with_functions\(") as e:
        ec.evolve(SPACE, marked, end=8 * STEP, start=states, **options)
    values = np.zeros(len(SPACE.nodes))
    start = [advised(e.value, state=state, values=values) for state in states]
    *_, last = ec.evolve(SPACE, marked, end=8 * STEP, start=start, **options)
    same(last, whole[-1].with_functions({"w": values}))


def test_a_velocity_that_is_not_known_is_not_advised():
    """It was None in starting states, which are no numbers."""
    states = run(PROBLEMS["coupled"], 1, end=STEP)
    dynamic = ec.Problem(1.0, law=ec.laws.Dynamic())
    for state, values in zip(states, ("values", "state.v"), strict=True):
        with pytest.raises(ValueError, match=rf"'velocity': {values}}}\)") as e:
            ec.evolve(SPACE, dynamic, 1, STEP, 1.0, start=[state])
        given = advised(e.value, state=state, values=np.zeros(state.x.shape))
        ec.evolve(SPACE, dynamic, 1, STEP, given.t + STEP, start=[given])


@pytest.mark.parametrize("p", [1, 2, 3])
def test_a_step_that_differs_by_rounding_does_not_lose_the_history(p):
    """(1 - t)/n for 0.1: with M(x) u in place of M(x~) u an amount grew by a tenth for p = 1."""
    problem = ec.Problem(1.0, g=lambda at: 2 * at.u, alpha=1, beta=0.1)
    space = ec.SurfaceSpace(ec.sphere("octahedron", 2))
    options = {"order": p, "mass": "extrapolated", "solver": "direct"}
    whole = list(ec.evolve(space, problem, step=0.1, end=1.0, start="euler", **options))
    states = whole[: p + 2]
    step = float(np.nextafter(0.1, 0))
    message = rf"^step must be .*, step=0\.1, got {step!r}: the amounts of 'u' .* M\(x~\) u, belong"
    with pytest.raises(ValueError, match=message) as e:
        ec.evolve(space, problem, step=step, end=1.0, start=states, **options)
    named = float(str(e.value).partition("step=")[2].partition(",")[0])
    *_, last = ec.evolve(space, problem, step=named, end=1.0, start=states, **options)
    same(last, whole[-1])
    # Where nothing is lost, nothing is refused.
    states = list(ec.evolve(space, problem, p, 0.1, 0.5))
    ec.evolve(space, problem, p, step, 1.0, start=states)
    bare = [dataclasses.replace(s) for s in whole]
    ec.evolve(space, problem, p, step, 1.0 + 0.1 * p, start=bare, mass="extrapolated")


@pytest.mark.parametrize(
    ("start", "error", "message"),
    [
        (lambda s: iter(s[:2]), TypeError, 'start must be "exact", "euler" or a sequence of stat'),
        (
            lambda s: [s[0], 1.0],
            TypeError,
            r"start\[1\] must be a State, got 1\.0",
        ),
        (lambda s: (SPACE, s), TypeError, r"pair .*: space, states = esfem_core\.load\(path\), t"),
        (
            lambda s: s[1::-1],
            ValueError,
            r"got times \[0\.03.*; start=states\[::-1\]$",
        ),
        (
            lambda s: [s[0], s[2]],
            ValueError,
            r"a step of 0\.0333333 apart, got times \[0\.0, ",
        ),
        (lambda s: s[::2], ValueError, r"; esfem_core\.respaced\(states, step, order\) makes such"),
        (
            lambda s: [s[0], dataclasses.replace(s[1], fields={"a": s[1]["a"]})],
            ValueError,
            r"start\[-1\] must have the function 'b', it has 'a'; state\.with_functions\(",
        ),
        (
            lambda s: [s[0], ec.State(s[1].t, s[1].x)],
            ValueError,
            r"start\[-1\] must have the function 'a', it has none",
        ),
        (
            lambda s: [s[0], dataclasses.replace(s[1], x=s[1].x[1:])],
            ValueError,
            r"x must have shape \(66, 3\), got \(65, 3\)",
        ),
        (
            lambda s: [
                dataclasses.replace(s[0], fields=s[0].fields | {"a": np.nan * s[0]["a"]}),
                s[1],
            ],
            ValueError,
            r"start\[-2\]\['a'\] must be finite, but start\[-2\]\['a'\]\[0\] is nan",
        ),
        (
            lambda s: [
                s[0],
                dataclasses.replace(s[1], fields=s[1].fields | {"a": s[1].x}),
            ],
            ValueError,
            r"start\[-2\]\['a'\] must have the shape \(66, 3\) that it has in the last state, got",
        ),
    ],
)
def test_states_to_start_from_are_refused_at_the_call(start, error, message):
    states = run(PROBLEMS["two species"], 2, end=3 * STEP)
    with pytest.raises(error, match=message):
        ec.evolve(SPACE, PROBLEMS["two species"], 2, STEP, 1.0, start=start(states))


@pytest.mark.parametrize("name", ["a", "b"])
def test_of_many_states_that_which_is_wrong_is_named(name):
    """The last p count: a number from the front would be that of another state."""
    states = run(PROBLEMS["two species"], 2, end=5 * STEP)
    bad = states[4]
    states[4] = dataclasses.replace(bad, fields=bad.fields | {name: np.nan * bad[name]})
    with pytest.raises(ValueError, match=r"^start\[-2\]\['.'\] must be finite") as found:
        ec.evolve(SPACE, PROBLEMS["two species"], 2, STEP, 1.0, start=states)
    named = eval(str(found.value).partition(" ")[0], {"start": states})
    assert np.isnan(named).all()


def test_states_in_another_order_are_taken_once_they_are_put_as_advised():
    problem = PROBLEMS["two species"]
    states = run(problem, 3, end=3 * STEP)[-3:]
    for mixed in (states[::-1], [states[1], states[0], states[2]]):
        with pytest.raises(ValueError, match=r"in the order of time") as found:
            ec.evolve(SPACE, problem, 3, STEP, 1.0, start=mixed)
        advised = eval(str(found.value).partition("start=")[2], {"states": mixed})
        ec.evolve(SPACE, problem, 3, STEP, 4 * STEP, start=advised)


def test_states_need_not_know_their_space(tmp_path):
    states = run(PROBLEMS["two species"], 2, end=3 * STEP)
    bare = [ec.State(s.t, s.x, s.v, fields=s.fields) for s in states]
    options = {"order": 2, "step": STEP, "end": 6 * STEP, "save": tmp_path / "run.npz", "every": 1}
    again = list(ec.evolve(SPACE, PROBLEMS["two species"], start=bare, **options))
    assert {state.space for state in again} == {SPACE}
    assert ec.load(tmp_path / "run.npz")[1][-1].t == again[-1].t


def test_functions_that_the_problem_does_not_have_are_left_behind(tmp_path):
    """Saved after every step: all states of a file have the same functions."""
    states = run(PROBLEMS["two species on a motion"], 2, end=3 * STEP)
    alone = ec.Problem(species={"a": ec.Species(1.0)}, law=ec.laws.Prescribed(stretch))
    options = {"order": 2, "step": STEP, "end": 6 * STEP, "save": tmp_path / "run.npz", "every": 1}
    again = list(ec.evolve(SPACE, alone, start=states, **options))
    assert {(*state.fields, *state.products) for state in again[1:]} == {("a", "a")}
    same(ec.load(tmp_path / "run.npz")[1][-1], again[-1])


def test_states_of_another_space_with_as_many_nodes_are_refused():
    linear = ec.SurfaceSpace(ec.sphere("octahedron", 2), 1)
    other = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)
    assert linear.nodes.shape == other.nodes.shape
    problem = ec.problems.growing_sphere()
    states = list(ec.evolve(other, problem, 2, 0.05, 0.2))
    message = (
        r"must be a state of this space, SurfaceSpace\(degree=1.*one of SurfaceSpace\(degree=2"
    )
    with pytest.raises(ValueError, match=r"start\[-2\] " + message):
        ec.evolve(linear, problem, 2, 0.05, 0.4, start=states)
    with pytest.raises(ValueError, match="state " + message):
        ec.errors.compare(linear, problem, states[-1])


def test_components_must_fit_the_diffusivities():
    two = ec.Species(lambda x: x[:, :2], diffusivity=np.array([1.0, 50.0]))
    problem = ec.Problem(species={"b": two}, law=ec.laws.Prescribed(lambda p, t: p))
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    for values in (space.nodes[:, 0], space.nodes):
        start = [ec.State(0.0, space.nodes, fields={"b": values}, space=space)]
        with pytest.raises(ValueError, match=r"start\[-1\]\['b'\] must have 2 components"):
            ec.evolve(space, problem, 1, 0.1, 0.2, start=start)


@pytest.mark.parametrize("step", [np.float32(0.5), np.array(0.5), np.int64(1), Fraction(1, 2)])
def test_a_step_may_be_a_number_of_any_library(step, tmp_path):
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    run = ec.evolve(space, ec.problems.growing_sphere(), 1, step, 2.0, save=tmp_path / "run.npz")
    assert list(run)[-1].t == 2.0


WRONG = {
    "inwards": (-1.0, 2.0, r"start\[-1\]\['normal'\] must point outwards"),
    "of length 3": (3.0, 2.0, r"start\[-1\]\['normal'\] must .* have length one"),
    "the mean": (1.0, 1.0, r"start\[-1\]\['H'\] must be the sum .* but is about 0\.5 times"),
    "of the other sign": (1.0, -2.0, r"start\[-1\]\['H'\] must be .* but has the other sign"),
    "components": (1.0, SPACE.nodes, r"start\[-1\]\['H'\] must have shape \(66,\), got \(66, 3"),
}


@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("kind", ["alone", "volume", "slip"])
def test_a_normal_and_a_curvature_of_another_surface_are_refused(kind, wrong):
    """They ran in silence, though the law refuses such when a run begins."""
    law = ec.laws.MeanCurvature()
    if kind == "volume":
        law = ec.laws.VolumePreserving(law)
    if kind == "slip":
        law = ec.laws.with_slip(law, "elastic")
    length, H, message = WRONG[wrong]
    x = SPACE.nodes
    fields = {"normal": length * x, "H": np.zeros(len(x)) + H if np.ndim(H) == 0 else H}
    problem = ec.Problem(law=law)
    right = ec.State(0.0, x, space=SPACE, fields={"normal": x, "H": np.full(len(x), 2.0)})
    state = ec.State(0.1, x, space=SPACE, fields=fields)
    with pytest.raises(ValueError, match=message):
        ec.evolve(SPACE, problem, 1, 0.01, 0.2, start=[state])
    with pytest.raises(ValueError, match=message):
        ec.started_anew(state, problem, 2, 0.01)
    ec.evolve(SPACE, problem, 1, 0.01, 0.1, start=[right])


def test_a_degenerate_state_is_left_to_the_step():
    """It was looked at for its normal before, and ended in another error."""
    x = SPACE.nodes.copy()
    corners = SPACE.cells[0, :3]
    x[SPACE.cells[0]] = x[corners[0]]
    fields = {"normal": SPACE.nodes, "H": np.full(len(x), 2.0)}
    state = ec.State(0.0, x, space=SPACE, fields=fields)
    run = ec.evolve(SPACE, ec.Problem(law=ec.laws.MeanCurvature()), 1, 0.01, 0.1, start=[state])
    with pytest.raises(ec.EvolutionError, match="is degenerate"):
        list(run)


def test_a_run_towards_a_singularity_goes_on_from_its_states():
    """There the computed normal and curvature are far from those of the surface."""
    problem = ec.Problem(law=ec.laws.MeanCurvature())
    states = []
    with pytest.raises(ec.EvolutionError):
        states.extend(ec.evolve(SPACE, problem, 1, 0.002, 0.3, solver="direct"))
    *_, before, last = states
    with pytest.raises(ValueError, match="must be the sum of the principal curvatures"):
        ec.evolve(SPACE, problem, 1, 0.002, 0.3, start=[dataclasses.replace(last)])
    run = ec.evolve(SPACE, problem, 1, 0.002, 0.3, start=[before], solver="direct")
    next(run)
    same(next(run), last)
    ec.evolve(SPACE, problem, 1, 0.002, 0.3, start=[last])


def turned(x, which=slice(None)):
    """Point reflection, which leaves every normal as it is and turns the volume around."""
    x = x.copy()
    x[which] = 2 * x[which].mean(axis=0) - x[which]
    return x


def starting(space, problem, positions, **options):
    states = [ec.State(0.1 * n, x, None, np.ones(len(x))) for n, x in enumerate(positions)]
    return ec.evolve(space, problem, len(states), 0.1, 1.0, start=states, **options)


@pytest.mark.parametrize("which", [[0], [1], [0, 1]], ids=["the first", "the last", "both"])
def test_starting_states_that_are_inside_out_are_refused(which):
    """They would run with normals that point inwards."""
    x = [turned(SPACE.nodes) if n in which else SPACE.nodes for n in (0, 1)]
    message = (
        rf"start\[{which[0] - 2}\] must be oriented as the nodes of the space are, but the surface "
        r"is inside out there: it encloses a volume of -[\d.]+, with the nodes of the space \d"
    )
    with pytest.raises(ValueError, match=message):
        starting(SPACE, ec.Problem(1.0), x)


def test_a_component_of_a_starting_state_may_not_be_inside_out_but_a_cavity_is():
    inner = ec.sphere("octahedron", 1).apply_scale(0.5)
    inner.faces = inner.faces[:, ::-1]
    both = trimesh.util.concatenate([ec.sphere("octahedron", 1), inner])
    space = ec.SurfaceSpace(both)
    starting(space, ec.Problem(1.0), [space.nodes])
    of_cavity = np.linalg.norm(space.nodes, axis=1) < 0.6
    with pytest.raises(ValueError, match=r"start\[-1\] must .* but component 1 of the surface is"):
        starting(space, ec.Problem(1.0), [turned(space.nodes, of_cavity)])


def test_exact_starting_states_are_not_inside_out():
    problem = ec.problems.growing_sphere()

    def after(function):
        return lambda p, t: function(p, t) * (1 if t == 0 else -1)

    exact = problem.exact._replace(x=after(problem.exact.x), v=after(problem.exact.v))
    wrong = dataclasses.replace(problem, exact=exact)
    ec.evolve(SPACE, wrong, 1, 0.1, 0.4)  # its one starting state is right
    with pytest.raises(ValueError, match=r"exact.x\(p, t\) at t = 0.1 must be oriented as the no"):
        ec.evolve(SPACE, wrong, 3, 0.1, 0.4)
