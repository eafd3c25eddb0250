"""What functions of a law or a species return, refused by shape or sign; and (2.20) itself."""

import functools
import operator

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve

import esfem_core as ec
from esfem_core.elements import NotFiniteError

SPACE = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)
AT = ec.Surface(SPACE, SPACE.nodes, SPACE.nodes[:, 2])


def test_a_step_of_the_regularised_law_leaves_no_residual():
    law = ec.laws.Regularised(0.5, 2.0, lambda at: 1 + at.u)
    tau, past = 0.1, -1.1 * SPACE.nodes  # new positions are tau v - past
    v = law.velocity(AT, {}, tau, past, lambda K, b: spsolve(K.tocsc(), b))
    assert np.abs(law.residual(AT, tau * v - past, v)).max() < 1e-12
    assert np.abs(law.residual(AT, SPACE.nodes, v)).max() > 1e-3  # the positions matter


@pytest.mark.parametrize("shape", [(32, 6, 1), (32,), (6,), (32, 6, 2)])
def test_a_speed_of_another_shape_is_refused(shape):
    law = ec.laws.Regularised(1.0, 1.0, lambda at: np.ones(shape))
    with pytest.raises(ValueError, match=r"g must return an array of shape \(32, 6\) or \(32, 6, "):
        law.load(AT)


def test_what_looks_like_values_and_flux_and_is_not_is_refused_with_what_was_meant():
    both = np.stack([AT.x[:, 0], AT.x[:, 1]], axis=-1)
    at = ec.Surface(SPACE, SPACE.nodes, {"u": both, "w": AT.x[:, 2]})
    apart = ec.Species(1.0, lambda at: (at.u[..., 0], at.u[..., 1]))
    with pytest.raises(ValueError, match=r"f of 'u' must .*\(32, 6, 2\), got two .* np\.stack\(\["):
        apart.load("u", at)
    listed = ec.Species(1.0, lambda at: [at["w"], at.grad("w")])
    with pytest.raises(
        TypeError, match=r"of 'w' must .*\(32, 6\) and \(32, 6, 3\): a pair is a tup"
    ):
        listed.load("w", at)


@pytest.mark.parametrize("lowest", [-0.1, 0.0])
def test_a_tensor_with_one_negative_eigenvalue_on_the_tangent_plane_is_refused(lowest):
    """The other one is positive, and that in the direction of the normal does not count."""
    nu = AT.normal
    first = np.cross(nu, [0.3, 0.5, 0.8])
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    second = np.cross(nu, first)
    tensor = sum(
        number * e[..., :, None] * e[..., None, :]
        for number, e in ((lowest, first), (1.0, second), (-5.0, nu))
    )
    species = ec.Species(1.0, diffusivity=lambda at: tensor)
    if lowest < 0:
        with pytest.raises(NotFiniteError, match=r"has the eigenvalue -0\.1 in element 0"):
            species.parts("u", AT)
    else:
        assert len(species.parts("u", AT)) == 1


def test_a_tensor_that_is_not_symmetric_is_not_called_indefinite():
    tensor = np.eye(3) + 4 * np.tri(3, k=-1)
    species = ec.Species(1.0, diffusivity=lambda at: np.broadcast_to(tensor, (32, 6, 3, 3)))
    with pytest.raises(ValueError, match=r"diffusivity of 'u' must be symmetric, but .* up to 4"):
        species.parts("u", AT)


AT_REST = ec.laws.Prescribed(motion=lambda p, t: p)


def steps(law=AT_REST, **species):
    """Two steps on 32 triangles with 66 nodes, for one species if there is something of it."""
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)
    given = {"u": ec.Species(1.0, **species)} if species else {}
    return list(ec.evolve(space, ec.Problem(species=given, law=law), 1, 0.01, 0.02))


def test_of_values_at_the_nodes_a_message_says_what_makes_them_values_at_the_points():
    advice = r"got \(66,\); of values F at the nodes, those .* are at\.space\.evaluate\(F\)$"
    for given in ("source", "rate", "diffusivity"):
        with pytest.raises(ValueError, match=advice):
            steps(**{given: lambda at: at.x[:, 0] ** 2})
    with pytest.raises(ValueError, match=r"got \(66, 3\); of values F at the nodes"):
        steps(source=lambda at: (None, at.x))
    with pytest.raises(ValueError, match=advice):
        steps(ec.laws.Regularised(g=lambda at: at.x[:, 0]))
    steps(source=lambda at: at.space.evaluate(at.x[:, 0]))
    with pytest.raises(ValueError, match=r"got \(65,\)$"):
        steps(source=lambda at: at.x[1:, 0])


def test_of_a_constant_tensor_a_message_says_how_it_is_one_at_each_point():
    C = np.diag([1.0, 2.0, 3.0])
    advice = r"a constant C is np\.broadcast_to\(C, \(\*at\.density\.shape, 3, 3\)\)$"
    with pytest.raises(ValueError, match=advice):
        steps(diffusivity=lambda at: C)
    steps(diffusivity=lambda at: np.broadcast_to(C, (*at.density.shape, 3, 3)))
    with pytest.raises(ValueError, match=r"shape \(3, 3\); a tensor is given by a function of at"):
        ec.Species(1.0, diffusivity=C)


def test_of_a_negative_diffusivity_a_message_says_where_it_can_come_from():
    """Of a porous medium, D = 2 u, an extrapolated u undershoots by rounding where it is zero."""
    advice = r"function of u, .* np\.maximum\(w, 0\) of w = at\.u is not negative"
    for D in (lambda at: at.u - 2, lambda at: np.multiply.outer(at.u - 2, np.eye(3))):
        with pytest.raises(ec.EvolutionError, match=advice):
            steps(diffusivity=D)


def test_a_node_that_is_fixed_twice_is_named():
    species = ec.Species(1.0, fixed=([5, 2, 5], 1.0))
    with pytest.raises(ValueError, match="must not be repeated, but 5 is"):
        species.fixed.nodes("u", SPACE)


def test_of_a_negative_coefficient_a_message_names_functions_that_are_there():
    species = {"a": ec.Species(1.0), "bee": ec.Species(1.0, rate=lambda at: -at["bee"])}
    problem = ec.Problem(species=species, law=ec.laws.Prescribed(lambda p, t: p))
    advice = r"function of 'a' or 'bee', .* of w = at\['a'\] or at\['bee'\] is not negative"
    with pytest.raises(ec.EvolutionError, match=advice):
        list(ec.evolve(SPACE, problem, 1, 0.1, 0.1))
    bare = ec.Surface(SPACE, SPACE.nodes)
    with pytest.raises(NotFiniteError, match="rate of 'u' must not be negative, got -1"):
        ec.Species(1.0, rate=lambda at: -np.ones(at.density.shape)).parts("u", bare)


ASYMMETRIC = np.eye(3) + np.tri(3, k=-1)
WRONG_COEFFICIENTS = {
    "negative": (lambda at: -np.ones(at.density.shape), "must not be negative"),
    "not finite": (lambda at: np.full(at.density.shape, np.nan), "returned nan in element 0"),
    "of another shape": (lambda at: np.ones(5), "must return an array of shape"),
    "no numbers": (lambda at: None, "returns must hold real numbers"),
    "indefinite": (lambda at: np.multiply.outer(-at["b"], np.eye(3)), "must be positive semidef"),
    "asymmetric": (lambda at: np.multiply.outer(at["b"], ASYMMETRIC), "must be symmetric"),
}


@pytest.mark.parametrize("kind", WRONG_COEFFICIENTS)
@pytest.mark.parametrize("of", ["rate", "diffusivity"])
def test_of_several_species_a_message_names_that_of_the_wrong_coefficient(of, kind):
    given, message = WRONG_COEFFICIENTS[kind]
    if of == "rate" and kind in ("indefinite", "asymmetric"):  # a rate is no tensor
        message = "must return an array of shape"
    species = {"a": ec.Species(1.0, rate=lambda at: at["a"]), "b": ec.Species(1.0, **{of: given})}
    problem = ec.Problem(species=species, law=AT_REST)
    with pytest.raises((ValueError, TypeError, ec.EvolutionError), match=f"{of} of 'b' {message}"):
        list(ec.evolve(SPACE, problem, 1, 0.1, 0.1))


OF_PAPER = {
    "u, du, x, t": lambda u, du, x, t: u,
    "x, t": lambda x, t: x[:, 0],
    "": lambda: 1.0,
    "at, *, k": lambda at, *, k: k * at.u,
}
TAKE_A_SURFACE = {
    "f": lambda f: ec.Problem(1.0, f=f, motion=lambda p, t: p),
    "source": lambda f: ec.Species(1.0, f),
    "rate": lambda f: ec.Species(1.0, rate=f),
    "diffusivity": lambda f: ec.Problem(1.0, diffusivity=f),
    "g": lambda f: ec.Problem(1.0, g=f),
    "w": lambda f: ec.laws.with_slip(ec.laws.Regularised(), f),
}


@pytest.mark.parametrize("arguments", OF_PAPER)
@pytest.mark.parametrize("name", TAKE_A_SURFACE)
def test_functions_with_the_arguments_of_the_papers_are_told_what_they_are_given(name, arguments):
    says = (
        rf"^{name} must be a function of \(at\), got one of \(.*\); at is the Surface, with at\.u"
    )
    with pytest.raises(TypeError, match=says):
        TAKE_A_SURFACE[name](OF_PAPER[arguments])
    TAKE_A_SURFACE[name](lambda at, scale=2.0: scale * at.u)
    TAKE_A_SURFACE[name](lambda *given: given[0].u)
    TAKE_A_SURFACE[name](functools.partial(lambda k, at: k * at.u, 2.0))
    TAKE_A_SURFACE[name](operator.attrgetter("u"))


def test_a_wrapper_that_passes_on_other_arguments_is_taken_as_it_is():
    def of_points(x, t):
        return x[..., 0] + t

    @functools.wraps(of_points)
    def of_surface(at):
        return of_points(at.points, at.t)

    ec.Species(1.0, of_surface)


def test_functions_of_points_and_of_points_and_a_time_are_told_apart():
    def three(x, t, more):
        return x

    for make in (
        lambda f: ec.Problem(f),
        ec.Species,
        ec.laws.Dynamic,
        lambda f: ec.laws.MeanCurvature(normal=f),
        lambda f: ec.laws.MeanCurvature(curvature=f),
    ):
        with pytest.raises(TypeError, match=r"must be a function of \(x\), got one of \(x, t\); x"):
            make(lambda x, t: x)
    for make in (
        lambda f: ec.Problem(motion=f),
        lambda f: ec.laws.Prescribed(velocity=f),
        lambda f: ec.Species(1.0, fixed=f),
        lambda f: ec.Species(1.0, fixed=([1, 2], f)),
    ):
        with pytest.raises(TypeError, match=r"must be a function of \([px], t\), got one of \(x"):
            make(three)
