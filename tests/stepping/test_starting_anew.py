"""Where a law, a force or a coefficient changes, a run goes on at its order from one state."""

import warnings

import numpy as np
import pytest
import trimesh
from coupled import SPACE, coupled, growth

import esfem_core as ec

T = 0.5


def jumping(before=T + 1e-9):
    """A force, a source and a diffusivity that are others from T on."""
    return ec.Problem(
        species={
            "u": ec.Species(
                lambda x: 1 + x[:, 0] * x[:, 1],
                lambda at: (1.0 if at.t < before else -2.0) * at.u,
                diffusivity=lambda at: np.full(at.density.shape, 1.0 if at.t < before else 0.2),
            ),
            "free": ec.Species(lambda x: x[:, 2], conserved=False),
        },
        law=ec.laws.Regularised(
            0.5, 0.3, lambda at: growth(at) if at.t < before else -growth(at) / 2
        ),
    )


def run(problem, p, step, anew=True):
    if not anew:
        return list(ec.evolve(SPACE, problem, p, step, 1.0))[-1]
    *_, state = ec.evolve(SPACE, problem, p, step, T, start="euler")
    start = ec.started_anew(state, problem, p, step)
    return list(ec.evolve(SPACE, problem, p, step, 1.0, start=start))[-1]


@pytest.fixture(scope="module")
def fine():
    return run(jumping(), 5, 1 / 320)


def rates(problem, p, fine, **options):
    errors = [
        ec.errors.difference(SPACE, run(problem, p, 1 / n, **options), fine) for n in (40, 80)
    ]
    return [np.log2(getattr(errors[0], k) / getattr(errors[1], k)) for k in ("x_l2", "u_l2")]


@pytest.mark.parametrize("p", [1, 2, 3, 4])
def test_a_run_goes_on_across_a_jump_at_its_order(p, fine):
    """Positions and a density, on the same mesh."""
    for rate in rates(jumping(), p, fine):
        assert p - 0.35 < rate < p + 1.2


@pytest.mark.parametrize("p", [2, 3])
def test_one_run_across_a_jump_is_of_first_order(p, fine):
    """Of the positions, as `evolve` says; it is why the above is there."""
    rate, _ = rates(jumping(), p, fine, anew=False)
    assert 0.8 < rate < 1.3


def test_the_states_begin_with_the_given_one_and_keep_the_amount():
    problem = coupled()
    *_, state = ec.evolve(SPACE, problem, 3, 0.05, 0.4)
    start = ec.started_anew(state, problem, 4, 0.02)
    assert [s.t for s in start] == pytest.approx([0.4, 0.42, 0.44, 0.46], abs=1e-15)
    np.testing.assert_array_equal(start[0].x, state.x)
    amounts = [ec.measure(s).amount for s in start]
    np.testing.assert_allclose(amounts, amounts[0], rtol=1e-12)
    assert [s.t for s in ec.started_anew(state, problem, 1, 0.02)] == [0.4]


@pytest.mark.parametrize("conserved", [True, False])
def test_given_values_are_in_place_as_at_the_start_of_a_run(conserved):
    caps = np.flatnonzero(abs(SPACE.nodes[:, 2]) > 0.9)

    def given(x, t):
        return np.exp(-t) * x[:, :2] ** 2 + x[:, 2:]

    held = ec.Species(lambda x: given(x, 0.0), conserved=conserved, fixed=(caps, given))
    free = ec.Species(lambda x: 1 + x[:, 0] * x[:, 1])
    pushed = ec.laws.Regularised(1.0, 1.0, lambda at: 1 + at["free"])
    problem = ec.Problem(species={"u": held, "free": free}, law=pushed)
    *_, state = ec.evolve(SPACE, problem, 3, 0.05, 0.2, start="euler")
    anew = ec.started_anew(state, problem, 3, 0.05)
    run = ec.evolve(SPACE, problem, 3, 0.05, 0.4, start=anew)
    for found in (*anew, *run):
        np.testing.assert_array_equal(found.u[caps], given(found.x[caps], found.t))


@pytest.mark.parametrize("p", [2, 3])
def test_another_law_gets_the_functions_that_it_makes(p):
    """A sphere of radius 3/2 shrinks by its mean curvature, as one that begins there."""
    grows = ec.Problem(1.0, motion=lambda q, t: q * (1 + t))
    shrinks = ec.Problem(species={"u": ec.Species(1.0)}, law=ec.laws.MeanCurvature())
    *_, state = ec.evolve(SPACE, grows, p, 1 / 20, T)
    start = ec.started_anew(state, shrinks, p, 1 / 20)
    *_, last = ec.evolve(SPACE, shrinks, p, 1 / 20, 0.75, start=start)
    begins = ec.SurfaceSpace.from_nodes(state.x, SPACE.cells)
    shrinks = ec.Problem(species={"u": ec.Species(state.u)}, law=ec.laws.MeanCurvature())
    *_, other = ec.evolve(begins, shrinks, p, 1 / 20, 0.25)
    np.testing.assert_allclose(last.x, other.x, rtol=0, atol=1e-9)
    np.testing.assert_allclose(last.u, other.u, rtol=0, atol=1e-9)


def test_the_advice_for_its_steps_can_be_followed():
    """It told of another solver, and of a bound on growth, but took neither."""
    rest = ec.laws.Prescribed(motion=lambda q, t: q)
    big = ec.sphere("icosahedron", 2)
    small = trimesh.Trimesh(1e-4 * big.vertices + [3, 0, 0], big.faces, process=False)
    space = ec.SurfaceSpace(trimesh.util.concatenate([big, small]))
    values = np.r_[1 + big.vertices[:, 0], np.ones(len(big.vertices))]
    on_small = np.arange(len(values)) >= len(big.vertices)

    def decay(at):
        return np.where(at.points[..., 0] > 2.5, -at.u, 0.0)

    problem = ec.Problem(species={"u": ec.Species(values, decay)}, law=rest)
    state = ec.State(0.0, space.nodes, None, values, space=space)
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        rough = ec.started_anew(state, problem, 3, 0.05)[-1]
    assert len(found) == 1
    assert str(found[0].message).endswith('Take solver="direct"')
    assert found[0].filename == __file__
    start = ec.started_anew(state, problem, 3, 0.05, solver="direct")
    *_, whole = ec.evolve(space, problem, 3, 0.05, 0.1, start="euler", solver="direct")
    np.testing.assert_allclose(start[-1].u[on_small], whole.u[on_small], rtol=1e-9)
    assert abs(rough.u / whole.u - 1)[on_small].max() > 1e-6

    zero = ec.State(0.0, SPACE.nodes, None, 1e-17 * SPACE.nodes[:, 0], space=SPACE)
    after = ec.Problem(species={"u": ec.Species(0.0, lambda at: 1.0)}, law=rest)
    with pytest.raises(ec.EvolutionError, match="growth=inf lets it go on"):
        ec.started_anew(zero, after, 2, 0.05)
    with pytest.warns(ec.EvolutionWarning, match="has grown to 0.05") as grown:
        last = ec.started_anew(zero, after, 3, 0.05, growth=np.inf)[1]
    assert len(grown) == 1
    np.testing.assert_allclose(last.u, 0.05, rtol=1e-9)


@pytest.mark.parametrize("p", [1, 2])
def test_all_states_have_the_functions_of_the_problem(p, tmp_path):
    """The first one kept others, so that no list of them could be saved or respaced."""
    grows = ec.Problem(1.0, motion=lambda q, t: q * (1 + t))
    *_, state = ec.evolve(SPACE, grows, 2, 0.05, T)
    flow = ec.Problem(law=ec.laws.MeanCurvature())
    start = ec.started_anew(state, flow, p, 0.01)
    assert [list(s.fields) for s in start] == [["normal", "H"]] * p
    ec.save(tmp_path / "run.npz", start)
    assert len(ec.load(tmp_path / "run.npz")[1]) == p
    ec.respaced(start, 0.005)
    ec.remeshed(start, 0.6, flow)
    ec.save_series(tmp_path / "run.pvd", start)
    with pytest.raises(ValueError, match=r"^state must have the function 'w', it has 'u'"):
        ec.started_anew(state, ec.Problem(species={"w": ec.Species(1.0)}), p, 0.01)


@pytest.mark.parametrize("name", ["H", "normal"])
def test_a_species_is_not_taken_for_a_function_of_the_law(name):
    """As "H" for hydrogen: the sphere shrank five times as fast as it should."""
    rest = ec.laws.Prescribed(motion=lambda q, t: q)
    there = {name: np.full(len(SPACE.nodes), 10.0)}
    state = ec.State(0.1, SPACE.nodes, space=SPACE, fields=there)
    if name == "H":
        before = ec.Problem(species={"H": ec.Species(10.0)}, law=rest)
        *_, state = ec.evolve(SPACE, before, 2, 0.01, 0.1)
    flow = ec.Problem(law=ec.laws.MeanCurvature())
    for ours, theirs in zip(
        ec.started_anew(state, flow, 2, 0.005),
        ec.started_anew(ec.State(0.1, SPACE.nodes, space=SPACE), flow, 2, 0.005),
        strict=True,
    ):
        np.testing.assert_allclose(ours["H"], theirs["H"], rtol=1e-12)
        np.testing.assert_allclose(ours["normal"], theirs["normal"], rtol=0, atol=1e-12)


def test_the_dynamic_law_goes_on_with_the_velocity_of_the_state():
    """As the message says: nothing else makes it."""
    grows = ec.Problem(1.0, motion=lambda q, t: q * (1 + t))
    coasts = ec.Problem(law=ec.laws.Dynamic(alpha=0.1))
    *_, state = ec.evolve(SPACE, grows, 2, 0.05, T)
    with pytest.raises(ValueError, match=r"^state .*'velocity', it .*'velocity': state\.v}\)"):
        ec.started_anew(state, coasts, 2, 0.05)
    state = state.with_functions({"velocity": state.v})
    start = ec.started_anew(state, coasts, 2, 0.05)
    assert np.linalg.norm(start[1].x, axis=1).mean() > np.linalg.norm(state.x, axis=1).mean() + 0.04


def test_what_it_is_given_is_looked_at():
    problem = coupled()
    state = next(ec.evolve(SPACE, problem, 1, 0.05, 0.4))
    with pytest.raises(TypeError, match="problem must be"):
        ec.started_anew(state, None, 2, 0.1)
    with pytest.raises(TypeError, match="state must be a State"):
        ec.started_anew(None, problem, 2, 0.1)
    with pytest.raises(ValueError, match="step must be a finite number > 0"):
        ec.started_anew(state, problem, 2, 0)
    with pytest.raises(ValueError, match="order must be an integer from 1 to"):
        ec.started_anew(state, problem, 0, 0.1)


def test_states_of_another_law_name_it():
    """Of the normal, which mean curvature flow makes."""
    *_, state = ec.evolve(SPACE, coupled(), 1, 0.05, 0.1)
    flow = ec.Problem(law=ec.laws.MeanCurvature())
    with pytest.raises(ValueError, match=r"'normal', .*; esfem_core\.started_anew\(state, problem"):
        ec.evolve(SPACE, flow, 1, 0.01, 0.2, start=[state])
    start = ec.started_anew(state, flow, 1, 0.01)
    assert [s.t for s in ec.evolve(SPACE, flow, 1, 0.01, 0.11, start=start)] == [0.1, 0.11]
