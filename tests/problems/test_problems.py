"""Exact solutions fulfil their equations; problems refuse what makes no sense."""

import copy
import dataclasses
import pickle
from types import SimpleNamespace

import numpy as np
import pytest
import sympy

import esfem_core as ec
from esfem_core.problems.spheres import _lambert_of_exponential


def sources(problem, u, x, t):
    """F and g for values of u at points of one's own."""
    at = SimpleNamespace(u=u, points=x, t=t)
    return problem.species["u"].source(at), problem.law.g(at)


def test_expanding_sphere_symbolically():
    """[N] 7.3 derived again by sympy: f from the diffusion equation, g from the velocity law."""
    t, alpha, beta = sympy.symbols("t alpha beta", positive=True)
    q = sympy.symbols("x1:4")
    r, a = 1 + sympy.sin(sympy.pi * t) / 2, sympy.exp(-(t**2))

    def laplace_beltrami(w, radius):
        """Of a function given near the sphere: Laplacian - H d/dn - d^2/dn^2."""
        n = [s / radius for s in q]
        first = sum(n[i] * sympy.diff(w, q[i]) for i in range(3))
        second = sum(n[i] * n[j] * sympy.diff(w, q[i], q[j]) for i in range(3) for j in range(3))
        return sum(sympy.diff(w, s, 2) for s in q) - 2 / radius * first - second

    u = a * q[0] * q[1] * q[2]
    along = u.subs({s: r * s for s in q}, simultaneous=True)
    material = sympy.diff(along, t).subs({s: s / r for s in q}, simultaneous=True)
    f = material + 2 * sympy.diff(r, t) / r * u - laplace_beltrami(u, r)
    v = [sympy.diff(r, t) / r * s for s in q]
    g = [(v[i] - alpha * laplace_beltrami(v[i], r)) * r / q[i] + 2 * beta / r for i in range(3)]

    rng = np.random.default_rng(0)
    for time in (0.0, 0.3, 0.9):
        problem = ec.problems.expanding_sphere(alpha=0.7, beta=1.9)
        x = float(r.subs(t, time)) * ec.to_unit_sphere(rng.standard_normal((5, 3)))
        values = problem.exact.u(x, time)
        for point, value, f_value, g_value in zip(
            x,
            values,
            *sources(problem, values, x, time),
            strict=True,
        ):
            at = {t: time, alpha: 0.7, beta: 1.9, **dict(zip(q, point, strict=True))}
            assert value == pytest.approx(float(u.subs(at)), rel=1e-14)
            assert f_value == pytest.approx(float(f.subs(at)), rel=1e-12)
            for component in g:
                assert g_value == pytest.approx(float(component.subs(at)), rel=1e-11)


@pytest.mark.parametrize("coupling", ["smooth", "printed", "none"])
def test_couplings_agree_on_the_solution(coupling):
    problem = ec.problems.expanding_sphere(coupling)
    x = problem.exact.x(ec.to_unit_sphere(np.random.default_rng(0).standard_normal((9, 3))), 0.4)
    _, reference = sources(ec.problems.expanding_sphere("none"), np.zeros(9), x, 0.4)
    _, g = sources(problem, problem.exact.u(x, 0.4), x, 0.4)
    np.testing.assert_allclose(g, reference, rtol=1e-13)


@pytest.mark.parametrize("alpha", [0.0, 1e-3, 0.5, 1.0, 3.0])
@pytest.mark.parametrize("beta", [0.5, 1.0])
def test_shrinking_sphere(alpha, beta):
    problem = ec.problems.shrinking_sphere(alpha, beta, u0=2.0)
    p = np.array([[0.6, 0.0, 0.8]])
    for t in (0.0, 0.1, 0.2, *(() if alpha == 0 else (1.0, 5.0))):
        r = np.linalg.norm(problem.exact.x(p, t))
        if r == 0:  # exp(-t/alpha) is too small for a float
            assert alpha == 1e-3
            continue
        if alpha:
            assert r**2 / 2 + 2 * alpha * np.log(r) == pytest.approx(0.5 - 2 * beta * t, abs=1e-13)
        else:
            assert r**2 == pytest.approx(1 - 4 * beta * t)
        speed = problem.exact.v(p, t) @ p.T
        assert speed * (1 + 2 * alpha / r**2) == pytest.approx(-2 * beta / r, rel=1e-12)
        assert problem.exact.u(r * p, t) == pytest.approx(2.0 / r**2, rel=1e-13)


def test_shrinking_sphere_without_regularisation_vanishes():
    problem = ec.problems.shrinking_sphere(alpha=0)
    with pytest.raises(ValueError, match=r"vanishes at t = 0\.25, asked for t = 0\.3"):
        problem.exact.x(np.eye(3), 0.3)


def test_lambert_where_the_exponential_overflows():
    for w in (700.0, 1e4):
        y = _lambert_of_exponential(w)
        assert y + np.log(y) == pytest.approx(w, rel=1e-15)


@pytest.mark.parametrize("parameters", [(1, 1, 1, 4), (0.5, 2.0, 1.5, 3.0), (0, 1, 0.5, 6)])
def test_growing_sphere(parameters):
    """The implicit solution: t = int (r^2 + 2 alpha)/(delta u0 - 2 beta r) dr, by quadrature."""
    alpha, beta, delta, u0 = parameters
    problem = ec.problems.growing_sphere(alpha, beta, delta, u0)
    p = np.array([[0.0, 1.0, 0.0]])
    nodes, weights = np.polynomial.legendre.leggauss(40)
    for t in (0.0, 0.1, 0.5):
        r = problem.exact.x(p, t)[0, 1]
        s = 1 + (r - 1) * (nodes + 1) / 2
        integral = (r - 1) / 2 * weights @ ((s**2 + 2 * alpha) / (delta * u0 - 2 * beta * s))
        assert integral == pytest.approx(t, abs=1e-12)
        speed = problem.exact.v(p, t)[0, 1]
        assert speed * (1 + 2 * alpha / r**2) + 2 * beta / r == pytest.approx(delta * u0 / r**2)


@pytest.mark.parametrize("t", [0.25, 0.5, 0.6, 1.0])
def test_a_tiny_radius_is_as_exact_as_a_large_one(t):
    """Without a source both spheres are one; the radius falls from 0.24 to 3e-33."""
    p = np.array([[1.0, 0.0, 0.0]])
    integrated = ec.problems.growing_sphere(0.01, 1.0, delta=0).exact.x(p, t)[0, 0]
    closed = ec.problems.shrinking_sphere(0.01, 1.0).exact.x(p, t)[0, 0]
    assert integrated == pytest.approx(closed, rel=5e-12, abs=0)


ONE = ec.Species(1.0)
LAW = ec.laws.Regularised(alpha=0.5)


class WithNormal:
    """A law that carries a function of its own."""

    species = {"n": ec.Species(lambda x: x, conserved=False)}  # noqa: RUF012

    def velocity(self, at, new, tau, past, solve):
        return new["n"]


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"alpha": -1.0}, ValueError, r"alpha must be a finite number >= 0, got -1\.0"),
        ({"beta": np.inf}, ValueError, "beta must be a finite number >= 0, got inf"),
        ({"alpha": "1"}, TypeError, "alpha must be a finite number >= 0, got '1'"),
        ({"diffusivity": -1.0}, ValueError, r"diffusivity must be a finite number >= 0, got -1\.0"),
        (
            {"diffusivity": np.array([1.0, -1.0])},
            ValueError,
            r"diffusivity must hold a number >= 0 for each component, got \[1\.0, -1\.0\]",
        ),
        (
            {"diffusivity": np.array([])},
            ValueError,
            r"diffusivity must hold a number >= 0 for each component, got \[\]",
        ),
        (
            {"diffusivity": [1.0, np.nan]},
            ValueError,
            r"diffusivity must be finite, but diffusivity\[1\] is nan",
        ),
        (
            {"diffusivity": [1.0, np.ones(2)]},
            ValueError,
            r"diffusivity must have rows of one length, got \[1\.0, array",
        ),
        ({"f": 3.0}, TypeError, r"f must be a function of a Surface or None, got 3\.0"),
        ({"g": 3.0}, TypeError, r"g must be a function of a Surface or None, got 3\.0"),
        ({"motion": 3.0}, TypeError, r"motion must be a function or None, got 3\.0"),
        (
            {"exact": lambda p, t: p},
            TypeError,
            r"exact must be an Exact\(x, v, u, \.\.\.\), got <function",
        ),
        ({"law": "dynamic"}, TypeError, "law must have a method velocity, .*; got 'dynamic'"),
        (
            {"law": SimpleNamespace(species={})},
            TypeError,
            r"law must have a method velocity, .*; got namespace\(species=\{\}\)",
        ),
        ({"law": SimpleNamespace(velocity=3)}, TypeError, "law must have a method velocity"),
    ],
)
def test_problem_refuses(arguments, error, message):
    with pytest.raises(error, match=message):
        ec.Problem(u0=lambda x: x[:, 0], **arguments)


@pytest.mark.parametrize("name", ["g", "alpha", "beta"])
def test_a_prescribed_motion_has_no_parameters_of_a_velocity_law(name):
    value = (lambda at: at.u) if name == "g" else 1.0
    message = f"{name} must not be given here: .* but the motion is prescribed"
    with pytest.raises(ValueError, match=message):
        ec.Problem(1.0, motion=lambda p, t: p, **{name: value})


@pytest.mark.parametrize(
    ("name", "value"), [("u0", 1.0), ("f", lambda at: at.u), ("diffusivity", 0.5)]
)
def test_a_species_is_not_given_twice(name, value):
    message = f"{name} must not be given here: species is given: write it into its Species"
    with pytest.raises(ValueError, match=message):
        ec.Problem(species={"u": ONE}, **{name: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [("g", lambda at: at.u), ("alpha", 1.0), ("beta", 0.0), ("motion", lambda p, t: p)],
)
def test_a_law_is_not_given_twice(name, value):
    message = f"{name} must not be given here: law is given: write it into the law"
    with pytest.raises(ValueError, match=message):
        ec.Problem(1.0, law=LAW, **{name: value})


@pytest.mark.parametrize(("name", "value"), [("f", lambda at: at.u), ("diffusivity", 0.5)])
def test_without_initial_values_there_is_no_species_to_belong_to(name, value):
    with pytest.raises(ValueError, match=f"{name} must not be given here: .* so give u0 as well"):
        ec.Problem(**{name: value})


@pytest.mark.parametrize("name", ["x", "v", 3])
def test_species_are_not_called_like_positions_and_velocities(name):
    message = f"a species must have a name other than x and v, got {name!r}"
    with pytest.raises(ValueError, match=message):
        ec.Problem(species={name: ONE})


@pytest.mark.parametrize("name", ["", "u\nv", "u\tv", "u\0", "\ud800"])
def test_names_of_species_can_be_printed_and_written(name):
    with pytest.raises(ValueError, match=r"a species must have a name of printable characters"):
        ec.Problem(species={name: ONE})
    own = SimpleNamespace(species={name: ONE}, velocity=lambda *given: 0.0)
    with pytest.raises(ValueError, match=r"a species of the law must have a name of printable"):
        ec.Problem(law=own)
    ec.Problem(species={"Ca²⁺ in/out": ONE, "濃度": ONE})


def test_a_species_is_not_called_like_the_normal_for_which_slips_and_remeshed_would_take_it():
    with pytest.raises(ValueError, match="a species must have another name than 'normal': slips"):
        ec.Problem(species={"normal": ONE})
    with pytest.raises(ValueError, match="the law has a function 'normal' of its own"):
        ec.Problem(species={"normal": ONE}, law=ec.laws.MeanCurvature())


def test_species_are_species_and_not_those_of_the_law():
    with pytest.raises(TypeError, match=r"species\['c'\] must be a Species, got 1\.0"):
        ec.Problem(species={"c": 1.0})
    with pytest.raises(ValueError, match="the law has a function 'n' of its own: give the species"):
        ec.Problem(species={"n": ONE}, law=WithNormal())


@pytest.mark.parametrize("wrong", [lambda t: t, lambda x: x, lambda x, y, z, t: x, lambda: 0.0])
@pytest.mark.parametrize("name", ["x", "v", "u", "closest", "origin", "w"])
def test_functions_of_an_exact_solution_take_points_and_a_time(name, wrong):
    def given(f):
        return {"fields": {"w": f}} if name == "w" else {name: f}

    right = {"x": lambda p, t: p, "v": lambda p, t: 0 * p}
    called = r"fields\['w'\]" if name == "w" else name
    taken, of = ("p, t", "of the initial surface") if name in "xv" else ("x, t", "at time t")
    message = rf"^{called} must be a function of \({taken}\), got one of \(.*\); .* {of}"
    with pytest.raises(TypeError, match=message):
        ec.Exact(**right | given(wrong))
    for f in (lambda x, t, scale=2.0: x, lambda *both: both[0], np.multiply):
        ec.Exact(**right | given(f))


def test_an_exact_u_is_not_given_twice():
    """One of the two would silently be left out."""
    motion = (lambda p, t: p), (lambda p, t: 0 * p)
    with pytest.raises(ValueError, match="u must be given once, but is given as u and in fields"):
        ec.Exact(*motion, u=lambda x, t: x[:, 0], fields={"u": lambda x, t: x[:, 1]})
    exact = ec.Exact(*motion, fields={"u": lambda x, t: x[:, 1]})
    np.testing.assert_array_equal(exact.nodal(np.eye(3), 0.0)[2]["u"], [0, 1, 0])


def test_a_law_needs_a_motion_or_a_velocity_and_not_both():
    message = "exactly one of motion and velocity must be given"
    for given in ({}, {"motion": lambda p, t: p, "velocity": lambda x, t: x}):
        with pytest.raises(ValueError, match=message):
            ec.laws.Prescribed(**given)


def test_the_short_form_is_a_species_and_a_law():
    def f(at):
        return at.u

    def g(at):
        return at.u

    short = ec.Problem(4.0, f, g, alpha=0.5, beta=0.25, diffusivity=2.0)
    [(name, species)] = short.species.items()
    assert (name, species.initial, species.source, species.diffusivity) == ("u", 4.0, f, 2.0)
    assert (species.rate, species.conserved) == (None, True)
    assert short.law == ec.laws.Regularised(0.5, 0.25, g)
    assert ec.Problem().law == ec.laws.Regularised(1.0, 1.0, None)
    assert dict(ec.Problem().species) == {}
    assert not hasattr(short, "f")
    assert list(ec.Problem(species={"a": ONE}, law=WithNormal()).all_species) == ["n", "a"]


def test_problems_cannot_be_changed_but_replaced():
    given = {"a": ONE}
    problem = ec.Problem(species=given, law=LAW)
    given["b"] = ONE
    assert list(problem.species) == ["a"]
    with pytest.raises(TypeError, match="does not support item assignment"):
        problem.species["b"] = ONE
    with pytest.raises(dataclasses.FrozenInstanceError):
        problem.law = LAW
    other = dataclasses.replace(problem, law=ec.laws.Regularised(2.0))
    assert (other.law.alpha, problem.law.alpha) == (2.0, 0.5)
    assert dict(other.species) == dict(problem.species)


def test_unknown_coupling():
    with pytest.raises(
        ValueError, match='coupling must be "smooth", "printed" or "none", got \'tight\''
    ):
        ec.problems.expanding_sphere("tight")


def test_initial_values():
    x = ec.to_unit_sphere(np.random.default_rng(0).standard_normal((4, 3)))

    def u(u0, **more):
        return ec.Problem(u0=u0, **more).initial_values(x)["u"]

    assert u(np.arange(4)).tolist() == [0, 1, 2, 3]
    assert u(2).tolist() == [2, 2, 2, 2]
    assert ec.Problem().initial_values(x) == {}
    np.testing.assert_array_equal(u(lambda x: x), x)
    message = r"u0 of 'u' must give a number or one row .*\(4,\) or \(4, m\); got "
    for values, shape in [(np.arange(3), r"\(3,\)"), (np.zeros((4, 2, 2)), r"\(4, 2, 2\)")]:
        with pytest.raises(ValueError, match=message + shape):
            u(values)
    with pytest.raises(ValueError, match=r"u0 of 'u' must be finite, but .* u0 of 'u'\[0\] is nan"):
        u(lambda x: np.full(len(x), np.nan))
    with pytest.raises(
        ValueError, match=r"u0 must have rows of one length, got \[\[1\], \[1, 2\]\]"
    ):
        u([[1], [1, 2]])
    with pytest.raises(TypeError, match="u0 must hold real numbers, got complex128"):
        u(1j * x)
    for columns, found in [(slice(0, 3), r"\(3,\)"), (0, r"one component, \(N,\)")]:
        with pytest.raises(ValueError, match=rf"shape \(2,\), but the .* u0 of 'u' has {found}"):
            u(x[:, columns], diffusivity=np.ones(2))
    one = ec.Problem(species={"u": ec.Species(lambda x: np.ones(5))})
    with pytest.raises(ValueError, match=r"^the initial value u0 of 'u' must give a number or"):
        one.initial_values(x)
    two = ec.Problem(species={"c": ec.Species(np.arange(3))})
    with pytest.raises(ValueError, match="the initial value of 'c' must give a number or one row"):
        two.initial_values(x)


def test_initial_values_get_points_of_their_own():
    nodes = np.zeros((4, 3))

    def writes(x):
        x += 1
        return x[:, 0]

    np.testing.assert_array_equal(ec.Problem(writes).initial_values(nodes)["u"], np.ones(4))
    assert not nodes.any()


@pytest.mark.parametrize("time", [np.nan, np.inf, "1"])
@pytest.mark.parametrize("problem", [ec.problems.growing_sphere(), ec.problems.shrinking_sphere()])
def test_exact_radii_are_refused_at_times_that_are_none(problem, time):
    with pytest.raises((ValueError, TypeError), match="t must be a finite number"):
        problem.exact.x(np.eye(3), time)


@pytest.mark.parametrize("name", ["delta", "u0", "alpha"])
def test_parameters_of_the_growing_sphere_are_finite(name):
    with pytest.raises(ValueError, match=f"{name} must be a finite number"):
        ec.problems.growing_sphere(**{name: np.nan})


def test_problems_exact_solutions_and_surfaces_can_be_copied():
    bat = copy.deepcopy(ec.problems.baseball_bat())
    assert set(bat.species) == {"u"}
    with pytest.raises(TypeError):
        bat.species["v"] = None
    problem = pickle.loads(pickle.dumps(ec.Problem(np.ones(6), law=ec.laws.Dynamic(np.ones(3)))))
    for array in (problem.species["u"].initial, problem.law.v0):
        assert (array == 1).all()
        assert not array.flags.writeable
    space = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    at = pickle.loads(pickle.dumps(ec.Surface(space, space.nodes, space.nodes[:, 0])))
    assert np.array_equal(at.fields["u"], space.nodes[:, 0])
