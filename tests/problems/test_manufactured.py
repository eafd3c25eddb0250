"""Problems made for a solution: the operators, the orders, and what is refused."""

import sys

import numpy as np
import pytest
import sympy
from manufactured import FLOW, MovingSurface, T, X, numeric, torus_space

import esfem_core as ec
from esfem_core.problems.manufactured import Expressions, Geometry, Motion
from esfem_core.study import observed_orders

POSITIONS = ("x1", "x2", "x3")
UNIT = "x1**2 + x2**2 + x3**2 - 1"
STILL = ["p1", "p2", "p3"]
TORUS = "(sqrt(x1**2 + x2**2) - 1)**2 + x3**2 - (2/5)**2"
GROWN = ["p1*(1 + t)", "p2*(1 + t)", "p3*(1 + t)"]
GROWN_UNIT = "x1**2 + x2**2 + x3**2 - (1 + t)**2"


def at_points(space, t=0.0, x=None):
    return ec.Surface(space, space.nodes if x is None else x, space.nodes[:, 2], t)


# An oscillating torus: the tube breathes, the third axis is stretched, and all of it is sheared.
p, x = sympy.symbols("p1:4"), sympy.symbols("x1:4")
t = sympy.Symbol("t")
WIDTH = 1 + sympy.sin(2 * t) / 4
BEND = sympy.sin(t) / 2
BACK = [x[0] / WIDTH, x[1], x[2] - BEND * x[0] / WIDTH * x[1]]
OSCILLATING = (
    (sympy.sqrt(BACK[0] ** 2 + BACK[1] ** 2) - 1) ** 2 + BACK[2] ** 2 - sympy.Rational(4, 25)
)
MOTION = [WIDTH * p[0], p[1], p[2] + BEND * p[0] * p[1]]
SOLUTION = 2 + sympy.cos(2 * t) * x[0] * x[1] + sympy.exp(-t) * x[2]


def oscillating(**options):
    return ec.manufactured(OSCILLATING, MOTION, SOLUTION, **options)


class TestOperators:
    """On surfaces where all is known in closed form."""

    POINTS = np.random.default_rng(1).normal(size=(50, 3))

    def test_spherical_harmonics_are_eigenfunctions(self):
        points = ec.to_unit_sphere(self.POINTS)
        for text, degree in (("x3", 1), ("x1*x2", 2), ("x1*(5*x3**2 - 1)", 3)):
            radius = Expressions("d", "x1**2 + x2**2 + x3**2 - 4", POSITIONS, 1)
            w = Expressions("u", text, POSITIONS, 1).jet(2 * points, 0.0)
            on = Geometry.of(radius.jet(2 * points, 0.0))
            if degree == 3:  # not homogeneous: on the unit sphere only
                on = Geometry.of(Expressions("d", UNIT, POSITIONS, 1).jet(points, 0.0))
                w = Expressions("u", text, POSITIONS, 1).jet(points, 0.0)
            size = 1 if degree == 3 else 4
            expected = -degree * (degree + 1) / size * w.value
            assert on.laplacian(w.gradient, w.hessian) == pytest.approx(expected, abs=1e-12)

    def test_geometry_of_the_torus(self):
        exact = ec.exact_surfaces.Torus(1.0, 0.4)
        points = exact.closest(self.POINTS)
        on = Geometry.of(Expressions("d", TORUS, POSITIONS, 1).jet(points, 0.0))
        assert on.normal == pytest.approx(exact.normal(points), abs=1e-12)
        assert pytest.approx(exact.mean_curvature(points), abs=1e-11) == on.H
        assert on.divergence(np.broadcast_to(np.eye(3), on.P.shape)) == pytest.approx(2)

    def test_laplacian_of_an_angle_around_the_torus(self):
        """With R + r cos θ = ρ: lap w(θ) = (ρ w')'/(r² ρ), here for w = sin θ = x3/r."""
        points = ec.exact_surfaces.Torus(1.0, 0.4).closest(self.POINTS)
        on = Geometry.of(Expressions("d", TORUS, POSITIONS, 1).jet(points, 0.0))
        w = Expressions("u", "5*x3/2", POSITIONS, 1).jet(points, 0.0)
        rho = np.hypot(points[:, 0], points[:, 1])
        cos, sin = (rho - 1) / 0.4, points[:, 2] / 0.4
        expected = (-rho * sin - 0.4 * sin * cos) / (0.16 * rho)
        assert on.laplacian(w.gradient, w.hessian)[:, 0] == pytest.approx(expected, abs=1e-11)

    def test_velocity_and_its_derivatives_are_those_of_the_inverse_in_closed_form(self):
        path, points = Motion(MOTION), 0.5 * self.POINTS
        v = path.at(points, 0.7)
        velocity = Expressions("v", [str(w) for w in FLOW.velocity], POSITIONS, 3)
        expected = velocity.jet(points, 0.7)
        assert v.value == pytest.approx(expected.value, abs=1e-12)
        assert v.gradient == pytest.approx(expected.gradient, abs=1e-12)
        assert v.hessian == pytest.approx(expected.hessian, abs=1e-12)

    def test_source_is_that_of_the_symbolic_calculus(self):
        """The tests' own helper differentiates the whole formula, with the inverse of the flow."""
        surface, space = MovingSurface(), torus_space(2, 10, 4)
        u = SOLUTION.xreplace({**dict(zip(x, X, strict=True)), t: T})
        source = numeric(surface.source(u, sympy.Rational(3, 10)))
        at = at_points(space, 0.6, FLOW.motion(space.nodes, 0.6))
        problem = oscillating(diffusivity=0.3, prescribed=True)
        found = problem.species["u"].source(at)
        assert found == pytest.approx(source(at.points, 0.6), abs=1e-11)

    def test_sphere_needs_the_speed_of_the_ordinary_differential_equation(self):
        """[N] 7.3: r' + 2 alpha r'/r^2 + 2 beta/r along the normal, with r = 1 + t."""
        space = ec.SurfaceSpace(ec.sphere("octahedron", 2), 2, ec.to_unit_sphere)
        problem = ec.manufactured(GROWN_UNIT, GROWN, alpha=0.3, beta=0.2)
        at = at_points(space, 0.5, 1.5 * space.nodes)
        radial = ec.to_unit_sphere(at.points)
        length = np.linalg.norm(at.points, axis=-1, keepdims=True)
        v = length / 1.5  # of the extension v = x/(1 + t)
        expected = (v + 0.3 * 2 * v / length**2 + 0.2 * 2 / length) * radial
        assert problem.law.g(at) == pytest.approx(expected, abs=1e-12)


def tangential_part(d, motion, tri, t, closest, **options):
    """Largest tangential part of the force, against its normal part, at points of the surface."""
    problem = ec.manufactured(d, motion, **options)
    space = ec.SurfaceSpace(tri, 2, closest)
    at = at_points(space, t, problem.exact.x(space.nodes, t))
    force = problem.law.g(at)
    normal = Geometry.of(Expressions("d", d, POSITIONS, 1).jet(at.points, t)).normal
    along = np.sum(force * normal, axis=-1, keepdims=True)
    return np.abs(force - along * normal).max() / np.abs(along).max()


class TestForce:
    """The facts of the velocity law."""

    # The tube grows along its normals: v is normal, |v| = 1/4.
    RHO = "sqrt(p1**2 + p2**2)"
    TUBE = (
        f"p1*(1 + 5*t/8*({RHO} - 1)/{RHO})",
        f"p2*(1 + 5*t/8*({RHO} - 1)/{RHO})",
        "p3*(1 + 5*t/8)",
    )
    GROWN_TORUS = "(sqrt(x1**2 + x2**2) - 1)**2 + x3**2 - (2/5 + t/4)**2"
    TORUS = ec.exact_surfaces.Torus(1.0, 0.4)

    def test_of_a_normal_velocity_is_not_normal_on_a_torus(self):
        tri = ec.torus(1.0, 0.4, 10, 4)
        args = self.GROWN_TORUS, self.TUBE, tri, 0.3, self.TORUS.closest
        assert tangential_part(*args, alpha=0.1, beta=0.1) > 0.01
        assert tangential_part(*args, alpha=0.0, beta=0.1) < 1e-12

    def test_of_a_normal_velocity_is_normal_on_a_sphere(self):
        args = GROWN_UNIT, GROWN, ec.sphere("octahedron", 2), 0.5, ec.to_unit_sphere
        assert tangential_part(*args, alpha=1.0, beta=1.0) < 1e-12

    def test_does_not_depend_on_the_sign_of_d(self):
        space = torus_space(2, 10, 4)
        at = at_points(space, 0.4)
        one, other = (ec.manufactured(f"{s}({TORUS})", STILL) for s in ("", "-"))
        assert one.law.g(at) == pytest.approx(other.law.g(at), abs=1e-12)


MESHES = [(20, 8), (30, 12)]


def measured(problem, degree, n, m, order=4, step=1 / 80, end=0.25):
    space = torus_space(degree, n, m)
    *_, last = ec.evolve(space, problem, order, step, end)
    return ec.errors.compare(space, problem, last)


class TestOrders:
    @pytest.mark.parametrize(("degree", "proven"), [(1, 1), (2, 2), (3, 3)])
    def test_in_space_of_the_coupled_problem(self, degree, proven):
        """H1 of order k, L2 of order k + 1, on displaced meshes; superclose for k = 2."""
        problem = oscillating(alpha=0.1, beta=0.1)
        errors = [measured(problem, degree, n, m) for n, m in MESHES]
        for name in ("x", "v", "u"):
            for norm, least in (("l2", proven + 1), ("h1", proven)):
                values = [getattr(e, f"{name}_{norm}") for e in errors]
                [order] = observed_orders([1 / n for n, _ in MESHES], values)
                assert least - 0.3 < order < least + 1.3, (name, norm)

    @pytest.mark.parametrize("degree", [1, 2, 3])
    def test_in_space_on_a_prescribed_motion(self, degree):
        problem = oscillating(prescribed=True)
        errors = [measured(problem, degree, n, m) for n, m in MESHES]
        for name, least in (("u_l2", degree + 1), ("u_h1", degree)):
            [order] = observed_orders(
                [1 / n for n, _ in MESHES], [getattr(e, name) for e in errors]
            )
            assert least - 0.3 < order < least + 1.3, name

    @pytest.mark.slow
    def test_in_time(self):
        problem, space = oscillating(alpha=0.1, beta=0.1), torus_space(2, 10, 4)
        fine = list(ec.evolve(space, problem, 5, 1 / 320, 0.5, solver="direct"))[32:]
        steps, options = [1 / 80, 1 / 160], {"fine": fine, "solver": "direct"}
        for p in (1, 2, 3, 4):
            table = ec.study.time_study(space, problem, p, steps, 0.5, **options)
            for name in ("x_l2", "v_l2", "u_l2"):
                assert table.orders(name)[-1] == pytest.approx(p, abs=0.3), (p, name)


class TestExact:
    def test_origins_are_those_of_the_motion(self):
        exact, nodes = oscillating().exact, torus_space(2, 10, 4).nodes
        for time in (0.0, 0.3, 0.9):
            assert exact.origin(exact.x(nodes, time), time) == pytest.approx(nodes, abs=1e-12)

    def test_origins_are_found_along_a_path_of_times(self):
        """A turn by half a circle with the radius: from p = x alone, Newton's method gets lost."""
        turned = [
            "p1*cos(3*t*(p1**2 + p2**2)) - p2*sin(3*t*(p1**2 + p2**2))",
            "p1*sin(3*t*(p1**2 + p2**2)) + p2*cos(3*t*(p1**2 + p2**2))",
            "p3 + t*sin(2*p3)/3",
        ]
        path, points = Motion(turned), ec.to_unit_sphere(TestOperators.POINTS)
        moved = path.position.values(points, 1.0)
        assert np.isnan(path._newton(moved, moved, 1.0)).any()
        assert path.origin(moved, 1.0) == pytest.approx(points, abs=1e-12)

    def test_closest_points_are_on_the_surface_and_errors_can_be_lifted(self):
        problem, space = oscillating(alpha=0.1, beta=0.1), torus_space(2, 20, 8)
        state = ec.study.final(ec.evolve(space, problem, 3, 1 / 40, 0.25))
        lifted = ec.errors.lifted(space, problem, state)
        assert 0 < lifted.x_l2 < 0.01
        points = problem.exact.closest(1.01 * state.x, 0.25)
        level = numeric(MovingSurface().level_set)
        assert np.abs(level(points, 0.25)).max() < 1e-12

    def test_without_u_nothing_diffuses(self):
        problem = ec.manufactured(UNIT, STILL, alpha=0.0)
        assert dict(problem.species) == {}
        assert problem.exact.u is None


class TestExpressions:
    def test_texts_and_symbols_of_any_assumption_are_the_same(self):
        at = at_points(torus_space(1, 10, 4))
        forces = []
        for options in ({}, {"real": True}, {"positive": True}):
            x1, x2, x3 = sympy.symbols("x1:4", **options)
            d = (sympy.sqrt(x1**2 + x2**2) - 1) ** 2 + x3**2 - sympy.Rational(4, 25)
            forces.append(ec.manufactured(d, sympy.symbols("p1:4", **options)).law.g(at))
        forces.append(ec.manufactured(TORUS, sympy.Matrix(sympy.symbols("p1:4"))).law.g(at))
        for force in forces:
            assert force == pytest.approx(ec.manufactured(TORUS, STILL).law.g(at), abs=1e-12)


class TestRefused:
    @pytest.mark.parametrize(
        ("d", "motion", "u", "message"),
        [
            ("x1**2 + y**2 - 1", STILL, None, "d must be an expression in x1, x2, x3, t, but has"),
            (UNIT, ["x1", "p2", "p3"], None, "motion must be an expression in p1, p2, p3, t"),
            (UNIT, STILL, "p1", "u must be an expression in x1, x2, x3, t, but has p1"),
            (UNIT, STILL, "f(x1)", "u must be an expression in x1, x2, x3, t, but has f"),
            ("x1 +* x2", STILL, None, "d must be an expression, got"),
            (UNIT, STILL, "abs(x1)", "u must be smooth and of functions that NumPy has, but it or"),
            (UNIT, STILL, "Max(x1, 0)", "u must be smooth and of functions that NumPy has"),
            (UNIT, STILL, "Mod(x1, 1)", "u has no form that NumPy can evaluate: "),
            (UNIT, STILL, "erf(x1)", "u must be smooth and of functions that NumPy has"),
            (UNIT, "p1", None, "motion must be three expressions"),
            (UNIT, ["p1", "p2"], None, "motion must be three expressions"),
            (UNIT, ["2*p1", "p2", "p3"], None, r"motion must have X\(p, 0\) = p, but takes"),
            (UNIT, GROWN, None, r"motion must stay on the surface, d\(X\(p, t\), t\) = 0, but at"),
            ("x1**2 + x2**2 + x3**2 + 1", STILL, None, "d must have zeros near the origin"),
            (f"({UNIT})**2", STILL, None, "is its gradient zero on the surface"),
            (UNIT, STILL, "Integral(x1**x1, (x1, 0, x2))", "u has no form that NumPy can evaluate"),
            (UNIT, {"p1", "p2", "p3"}, None, "motion must be three expressions"),
            (UNIT, dict.fromkeys(STILL), None, "motion must be three expressions"),
            (
                "x1**2 + x2**2 + x3**2 - (1 - 2*t)**2",
                ["p1*(1 - 2*t)", "p2*(1 - 2*t)", "p3*(1 - 2*t)"],
                None,
                r"motion must not pass through itself, but at t = 0\.618 .* is -0\.0132 times",
            ),
            (UNIT, ["p1/(1 - t)*(1 - t)", "p2*sqrt(1 - 2*t)", "p3"], None, "motion must stay"),
        ],
    )
    def test_with_the_name_of_what_is_wrong(self, d, motion, u, message):
        with pytest.raises(ValueError, match=message):
            ec.manufactured(d, motion, u)

    def test_what_is_no_expression(self):
        with pytest.raises(TypeError, match="d must be an expression in x1, x2, x3, t, got"):
            ec.manufactured("x1 < 0", STILL)
        with pytest.raises(TypeError, match="u must be an expression in x1, x2, x3, t, got Matrix"):
            ec.manufactured(UNIT, STILL, sympy.Matrix([x[0]]))

    def test_numbers_out_of_range(self):
        for name in ("alpha", "beta", "diffusivity", "until"):
            with pytest.raises(ValueError, match=f"{name} must be a finite number"):
                ec.manufactured(UNIT, STILL, "x1", **{name: -1})

    def test_a_law_where_the_motion_is_prescribed(self):
        for name in ("alpha", "beta"):
            with pytest.raises(ValueError, match=f"{name} must not be given where the motion is"):
                ec.manufactured(UNIT, STILL, "x1", prescribed=True, **{name: 1.0})

    def test_a_motion_that_ends_is_checked_until_the_time_that_is_given(self):
        d, shrinking = f"{UNIT} + 4*t", [f"{s}*sqrt(1 - 4*t)" for s in STILL]
        with pytest.raises(ValueError, match="until="):
            ec.manufactured(d, shrinking)
        problem = ec.manufactured(d, shrinking, alpha=0.0, until=0.2)
        space = ec.SurfaceSpace(ec.sphere("octahedron", 2), 2, ec.to_unit_sphere)
        at = at_points(space, 0.1, np.sqrt(0.6) * space.nodes)
        length = np.linalg.norm(at.points, axis=-1)
        assert np.linalg.norm(problem.law.g(at), axis=-1) == pytest.approx(
            2 / length - 2 * length / 0.6, abs=1e-12
        )

    def test_a_solution_that_ends_at_a_whole_number(self):
        """It is tried there, at t = 1, in numbers of Python, which know no infinity."""
        problem = ec.manufactured(UNIT, STILL, "x1/(1 - t)", until=0.2, prescribed=True)
        assert problem.exact.u(np.eye(3), 0.5) == pytest.approx([2.0, 0.0, 0.0])
        assert problem.exact.u(np.eye(3), 1.0)[0] == np.inf

    def test_a_motion_without_inverse(self):
        path = Motion(["p1*(1 - t)", "p2", "p3"])
        with pytest.raises(ValueError, match=r"motion has no inverse .* at t = 1"):
            path.origin(np.ones((2, 3)), 1.0)

    def test_without_sympy(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "sympy", None)
        with pytest.raises(ImportError, match=r'sympy: pip install "esfem-core\[symbolic\]"$'):
            ec.manufactured(UNIT, STILL)


SWITCHES = {  # and when they are crossed
    "Piecewise((x1, x1 > 0), (0, True))": "0",
    "100 + Piecewise((1, x3 > 1/5), (0, True))": "0",
    "atan2(x2, x1)": "0",
    "asin(sin(3*x1))": "0",
    "atan(tan(3*x1))": "0",
    "Piecewise((x1, x1 > 0), (x1 + t*x1, True))": "0.382",
}


@pytest.mark.parametrize("u", SWITCHES)
def test_a_solution_with_a_jump_or_a_kink_is_refused(u):
    """Its derivatives, as a formula has them, do not know of it."""
    with pytest.raises(ValueError, match=f"u must be smooth, but at t = {SWITCHES[u]} it jumps or"):
        ec.manufactured(UNIT, STILL, u, prescribed=True)


def test_a_motion_or_a_level_set_with_a_kink_is_refused():
    angle = "t*Piecewise((p3, p3 > 0), (0, True))"
    turned = [f"p1*cos({angle}) - p2*sin({angle})", f"p1*sin({angle}) + p2*cos({angle})", "p3"]
    with pytest.raises(ValueError, match=r"motion must be smooth, but at t = 0\.382 it jumps"):
        ec.manufactured(UNIT, turned, prescribed=True)
    cap = "x1**2 + x2**2 + x3**2 - 1 + Piecewise((x3, x3 > 0), (0, True))"
    with pytest.raises(ValueError, match=r"d must be smooth, but at t = 0 it jumps or"):
        ec.manufactured(cap, STILL, prescribed=True)


@pytest.mark.parametrize(
    "u",
    [
        "tanh(10000*x1)",
        "sin(300*x1*x2)",
        "sin(x1)**2 + cos(x1)**2 - 1",  # rounding and nothing else
        "Piecewise(((1 - cos(x1))/x1**2, Ne(x1, 0)), (1/2, True))",  # rounding near x1 = 0
        "cos(atan2(x2, x1))*sqrt(x1**2 + x2**2)",
        "x1**9",
        "1e8 + x1",
    ],
)
def test_a_solution_that_is_smooth_is_taken_however_it_is_written(u):
    assert ec.manufactured(UNIT, STILL, u, prescribed=True).exact is not None
