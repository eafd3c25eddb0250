"""A warning, at the call, of numbers so large for the surface that rounding takes what is kept."""

import warnings

import numpy as np
import pytest

import esfem_core as ec

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
