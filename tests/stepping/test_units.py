"""A warning, at the call, of numbers so large for the surface that rounding takes what is kept."""

import re
import warnings

import numpy as np
import pytest
import trimesh

import esfem_core as ec
from esfem_core.solvers import DirectSolver

SIZE = 1e-5  # of a cell in metres
TRI = ec.sphere("icosahedron", 1)
SMALL = ec.SurfaceSpace(TRI.copy().apply_scale(SIZE), 2, lambda x: SIZE * ec.to_unit_sphere(x))
UNIT = ec.SurfaceSpace(TRI, 2, ec.to_unit_sphere)
REST = ec.laws.Prescribed(motion=lambda p, t: p)
Regularised, Dynamic = ec.laws.Regularised, ec.laws.Dynamic


def warned(space, law=REST, step=0.05, **species):
    problem = ec.Problem(species=species, law=law)
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        ec.evolve(space, problem, 1, step, step)
    assert all(one.category is ec.EvolutionWarning for one in found)
    assert all(one.filename == __file__ for one in found)
    return [str(one.message) for one in found]


@pytest.mark.parametrize(
    ("law", "called"),
    [
        (Regularised(), "alpha, a squared length, is 1, 1e+10 times"),
        (ec.laws.VolumePreserving(Regularised()), "alpha, a squared length, is 1, 1e+10 times"),
        (ec.laws.with_slip(Regularised(), "elastic"), "alpha, a squared length, is 1, 1e+10 times"),
        (Dynamic(), "alpha, 1, times the step is 0.05, 5e+08 times"),
    ],
)
def test_laws_are_warned_of_by_their_alpha(law, called):
    [message] = warned(SMALL, law)
    assert message.startswith(f"{called} area/(4 pi)")
    assert message.endswith("a smaller number if it is as large in these")


def test_species_are_warned_of_by_name():
    """Each for itself, of the component that is largest."""
    u = ec.Species(1.0)
    q = ec.Species(np.ones((len(SMALL.nodes), 2)), diffusivity=[0.1, 2.0], conserved=False)
    slow = ec.Species(1.0, diffusivity=SIZE**2)
    about_u, about_q = warned(SMALL, u=u, q=q, slow=slow)
    assert about_u.startswith("the diffusivity of 'u', 1, times the step is 0.05, 5e+08 times")
    assert "of the amount of 'u' in each step" in about_u
    assert about_q.startswith("the diffusivity of 'q', 2, times the step is 0.1, 1e+09 times")
    assert "of the mean of 'q' in each step" in about_q


@pytest.mark.parametrize(("size", "many"), [(0.9e8, 0), (1.1e8, 1)])
def test_they_are_measured_by_the_surface(size, many):
    """Its flat triangles count, which have 0.93 of the area of this sphere."""
    size *= 0.928 * SIZE**2
    assert len(warned(SMALL, Regularised(size))) == many
    assert len(warned(SMALL, u=ec.Species(1.0, diffusivity=size / 0.05))) == many
    assert len(warned(SMALL, u=ec.Species(1.0, diffusivity=size), step=1.0)) == many


def test_nothing_is_said_where_nothing_is_lost_or_known():
    assert warned(UNIT, Regularised(), u=ec.Species(1.0)) == warned(UNIT, Dynamic()) == []
    function = ec.Species(1.0, diffusivity=lambda at: np.ones(at.density.shape))
    decaying = ec.Species(1.0, rate=1e6)
    somewhere = ec.Species(1.0, fixed=([0], 1.0))
    assert warned(SMALL, function=function, decaying=decaying, somewhere=somewhere) == []


@pytest.mark.filterwarnings("ignore:the diffusivity of 'u'")
@pytest.mark.parametrize("solver", ["lagged", "direct"])
@pytest.mark.parametrize("size", [1.0, 2.0**-20, 2.0**20])
def test_a_system_without_a_right_digit_is_refused_on_surfaces_of_every_size(size, solver):
    space = ec.SurfaceSpace(TRI.copy().apply_scale(size))
    u = ec.Species(lambda x: 1 + x[:, 2] / size, diffusivity=1e16 * size**2)
    with pytest.raises(ec.EvolutionError, match=r"system of u: no solution: x leaves .* of b"):
        list(ec.evolve(space, ec.Problem(species={"u": u}, law=REST), 1, 1.0, 1.0, solver=solver))


@pytest.mark.parametrize("solver", ["lagged", "direct"])
def test_a_smaller_surface_runs_with_the_same_bits(solver):
    """Whatever systems are multiplied by: a law that is homogeneous, scaled by a power of two."""

    def run(size):
        space = ec.SurfaceSpace(TRI.copy().apply_scale([1.2 * size, size, size]))
        law = Regularised(size**2, size**2, lambda at: size * at.u)
        u = ec.Species(lambda x: 1 + x[:, 0] / size, diffusivity=size**2)
        *_, last = ec.evolve(
            space, ec.Problem(species={"u": u}, law=law), 1, 0.1, 0.3, solver=solver
        )
        return last

    small, large = run(2.0**-20), run(1.0)
    np.testing.assert_array_equal(small.u, large.u)
    np.testing.assert_array_equal(2.0**20 * small.x, large.x)


CAP = ec.SurfaceSpace(ec.sphere("icosahedron", 3), 1, ec.to_unit_sphere)


def penalty(size):
    """A rate, or source, on a cap."""
    return lambda at: np.where(at.points[..., 0] > 0.8, size, 0.0)


def at_the_end(species, solver, steps=20):
    """Values, and warnings of this file's calls."""
    problem = ec.Problem(species={"u": species}, law=REST)
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        *_, last = ec.evolve(CAP, problem, 1, 0.05, 0.05 * steps, solver=solver)
    assert all(one.filename == __file__ for one in found)
    return last.u, [str(one.message) for one in found]


@pytest.mark.parametrize(("size", "loses", "warns"), [(1e5, 1e-9, 0), (1e8, 1e-4, 1)])
def test_a_penalty_is_warned_of_where_it_takes_digits_at_other_places(size, loses, warns):
    species = ec.Species(lambda x: 1 + x[:, 0] / 2, rate=penalty(size), source=penalty(size))
    u, said = at_the_end(species, "lagged")
    exact, nothing = at_the_end(species, "direct")
    assert len(said) == warns
    assert nothing == []
    off = np.abs(u - exact).max()
    assert warns * 1e-6 < off < loses
    if warns:
        assert said[0].startswith("the rate of 'u' is so much larger at some places than at others")
        assert "each step may lose up to 4e-05 of 'u': solver='lagged' leaves" in said[0]


def test_the_advice_against_a_penalty_is_right():
    """The direct solver does what dense matrices do, and given values are kept without a rate."""
    species = ec.Species(1.0, rate=penalty(1e12), source=lambda at: penalty(1e12)(at) * 2)
    u, _ = at_the_end(species, "direct", 1)
    at = ec.Surface(CAP, CAP.nodes)
    K = (20 * at.M + at.A + at.matrix(mass=penalty(1e12)(at))).toarray()
    b = 20 * at.M @ np.ones(len(u)) + at.load(2 * penalty(1e12)(at))
    np.testing.assert_allclose(u, np.linalg.solve(K, b), rtol=1e-10)
    cap = np.flatnonzero(CAP.nodes[:, 0] > 0.8)
    v, nothing = at_the_end(ec.Species(1.0, fixed=(cap, 2.0)), "lagged", 1)
    assert nothing == []
    assert (v[cap] == 2).all()


def two_spheres(radius, refinements=(2, 2)):
    """A unit sphere and a small one beside it."""
    large, small = (ec.sphere("icosahedron", n) for n in refinements)
    small.apply_scale(radius).apply_translation([2.0, 0, 0])
    return ec.SurfaceSpace(trimesh.util.concatenate([large, small]))


def growing(radius):
    """Both spheres grow and cool, on scales of the small one."""
    u = ec.Species(
        lambda x: 2 + np.where(x[:, 0] > 1.5, x[:, 1] / radius, 0),
        lambda at: -0.3 * at.u,
        diffusivity=0.3 * radius**2,
    )
    square = radius**2
    law = Regularised(0.01 * square, 0.02 * square, lambda at: 0.1 * radius * at.u)
    return ec.Problem(species={"u": u}, law=law)


def told(space, problem, solver):
    """The last state, and what a run says of components."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        *_, last = ec.evolve(space, problem, 3, 0.05, 0.5, solver=solver)
    assert all(one.filename == __file__ for one in found)
    return last, [str(one.message) for one in found if "component" in str(one.message)]


@pytest.mark.parametrize("solver", ["lagged", "cholmod"])
@pytest.mark.parametrize(
    ("radius", "refinements", "least", "most"),
    [(1e-1, (2, 2), 0, 1e-8), (1e-3, (2, 2), 1e-6, 1e-4), (1e-3, (3, 0), 1e-7, 2e-5)],
)
def test_a_small_component_is_warned_of_where_it_loses_digits(
    solver, radius, refinements, least, most
):
    if solver == "cholmod":
        pytest.importorskip("cholespy")
    space = two_spheres(radius, refinements)
    there = space.nodes[:, 0] > 1.5
    exact, nothing = told(space, growing(radius), "direct")
    last, said = told(space, growing(radius), solver)
    assert nothing == []
    off = abs(last.u - exact.u)[there].max() / abs(exact.u[there]).max()
    assert least < off < most
    assert len(said) == (radius < 1e-2)
    for text in said:
        assert re.match("component 1 of the surface has (1e-06|8e-07) of its area, so little", text)
        assert f"solver={solver!r} leaves a residual" in text
        lost = float(re.search(r"share of about (\S+) of the values there", text)[1])
        assert off < lost < 20 * off


def test_what_a_small_component_cannot_lose_is_not_warned_of():
    """Where no system is solved, and where triangles are small but the surface is one."""
    space, species = two_spheres(1e-3), {"u": ec.Species(1.0)}
    assert told(space, ec.Problem(species={}, law=REST), "lagged")[1] == []
    assert len(told(space, ec.Problem(species=species, law=REST), "lagged")[1]) == 1
    assert told(space, ec.Problem(species=species, law=REST), DirectSolver)[1] == []
    tri = ec.sphere("icosahedron", 2)
    corner = tri.faces[0]
    x = tri.vertices.copy()
    x[corner] = x[corner].mean(axis=0) + 1e-3 * (x[corner] - x[corner].mean(axis=0))
    one = ec.SurfaceSpace(trimesh.Trimesh(x, tri.faces, process=False))
    assert told(one, ec.Problem(species=species, law=REST), "lagged")[1] == []


def everywhere(size):
    return lambda at: np.full(at.density.shape, size)


@pytest.mark.parametrize(
    "species",
    [
        {"rate": 1e12, "source": everywhere(1e12)},
        {"rate": everywhere(1e12), "source": everywhere(1e12)},
        {"rate": everywhere(1e12)},
        {"rate": 1e12, "source": penalty(1e12)},
        {"rate": penalty(1e8)},  # to zero: nothing is large on the right
        {"rate": penalty(1e8), "source": everywhere(1e8)},  # so is u where there is no rate
        {"rate": penalty(1e8), "source": lambda at: (None, 0 * at.grad_u), "diffusivity": [2.0]},
    ],
    ids=["number", "everywhere", "decay", "source", "sink", "growing", "flux"],
)
def test_rates_that_cost_no_digits_are_not_warned_of(species):
    ones = np.ones((len(CAP.nodes), 1)) if "diffusivity" in species else 1.0
    u, said = at_the_end(ec.Species(ones, **species), "lagged", 2)
    exact, _ = at_the_end(ec.Species(ones, **species), "direct", 2)
    assert [text for text in said if "rate" in text] == []
    assert np.abs(u - exact).max() < 1e-10 * np.abs(exact).max()


def test_a_rate_of_several_components_is_warned_of_and_a_faulty_one_left_to_the_step():
    def source(at):
        return np.stack([0 * at.density, penalty(1e9)(at)], axis=-1)

    species = ec.Species(np.ones((len(CAP.nodes), 2)), rate=penalty(1e9), source=source)
    [text] = at_the_end(species, "lagged", 1)[1]
    assert "may lose up to 0.0005 of 'u'" in text
    run = ec.evolve(
        CAP,
        ec.Problem(species={"u": ec.Species(1.0, rate=lambda at: -at.u)}, law=REST),
        1,
        0.1,
        0.1,
    )
    with pytest.raises(ec.EvolutionError, match="rate of 'u' must not be negative"):
        list(run)
