"""The formulas of the benchmark set, as its file prints them, are those of the package."""

import json
import re
from collections.abc import Iterable
from types import SimpleNamespace

import numpy as np
import pytest
import sympy
from sympy.parsing import sympy_parser
from test_benchmark_set import SET, make

PROBLEMS = json.loads((SET / "problems.json").read_text())["problems"]
READ = (
    *sympy_parser.standard_transformations,
    sympy_parser.convert_xor,  # x^2
    sympy_parser.implicit_multiplication,  # a x
)
FUNCTIONS = {"sqrt": sympy.sqrt, "exp": sympy.exp, "sin": sympy.sin, "max": sympy.Max}
t, u, r, dr = sympy.symbols("t u r r_prime")
ORIGIN, X = sympy.symbols("p1:4"), sympy.symbols("x1:4")
TIME = 0.3
random = np.random.default_rng(0)
POINTS = random.uniform(0.5, 1.0, (1, 20, 3)) * random.choice([-1, 1], (1, 20, 3))  # on no surface
VALUES = random.normal(size=(1, 20))
ONES = np.ones_like(VALUES)
AT = SimpleNamespace(points=POINTS, u=VALUES, t=TIME)


class Formulas:
    """The formulas of a problem; "a x1, a = exp(-t)" is one in which a is defined for all."""

    def __init__(self, name):
        self.given = PROBLEMS[name]
        texts = [text for text in self.given.values() if isinstance(text, str)]
        parts = [part for text in texts for part in re.split(r", (?=\w+ = )", text)[1:]]
        self.definitions = dict(part.split(" = ", 1) for part in parts)

    def __getitem__(self, key):
        return self.read(re.split(r", (?=\w+ = )", self.given[key])[0])

    def read(self, text):
        names = {match: self.value(match) for match in re.findall(r"[A-Za-z]\w*'?", text)}
        known = {name.replace("'", "_prime"): value for name, value in names.items()}
        return sympy_parser.parse_expr(text.replace("'", "_prime"), known, READ)

    def value(self, name):
        letter = name.removesuffix("'")
        if letter in self.definitions:
            meant = self.read(self.definitions[letter])
            return meant if letter == name else sympy.diff(meant, t)
        if letter in ("alpha", "beta"):
            return sympy.Float(self.given[letter])
        return FUNCTIONS.get(name) or sympy.Symbol(name.replace("'", "_prime"))


def numbers(formula, space=X, points=POINTS, radius=1.0):
    """Values of a formula, or of three, at points."""
    formulas = [*formula] if isinstance(formula, Iterable) else [formula]
    function = sympy.lambdify([*space, t, u, r], formulas, "numpy", cse=True)
    found = function(*np.moveaxis(points, -1, 0), TIME, VALUES, radius)
    columns = [np.broadcast_to(column, VALUES.shape) for column in found]
    return np.stack(columns, axis=-1) if len(formulas) > 1 else columns[0]


def assert_same(given, expected):
    np.testing.assert_allclose(given, expected, rtol=1e-11, atol=1e-12)


@pytest.fixture(params=PROBLEMS)
def name(request):
    return request.param


@pytest.fixture
def problem(name):
    return make.PROBLEMS[name][0]()


@pytest.fixture
def formulas(name):
    return Formulas(name)


@pytest.mark.parametrize("name", [name for name in PROBLEMS if name != "moving-torus"])
def test_right_hand_sides_are_the_printed_ones_also_off_the_surface(problem, formulas):
    source = problem.species["u"].source if problem.species else None
    for key, function in {"f": source, "g": getattr(problem.law, "g", None)}.items():
        printed = numbers(formulas[key]) if key in formulas.given else 0.0
        assert_same(printed * ONES, function(AT) if function else 0 * ONES)
    for key in {"alpha", "beta"} & set(formulas.given):
        assert getattr(problem.law, key) == formulas.given[key]


@pytest.mark.parametrize(
    "name", [n for n, given in PROBLEMS.items() if "X" in given or "x" in given]
)
def test_motions_and_solutions_are_the_printed_ones(problem, formulas):
    given, exact = formulas.given, problem.exact
    if "u at t = 0" in given:
        assert_same(numbers(formulas["u at t = 0"])[0], problem.species["u"].initial(POINTS[0]))
    if "with" in given.get("x", ""):  # no formula of the radius: below
        return
    moved = formulas["X"] if "X" in given else [formulas["x"].subs("p", q) for q in ORIGIN]
    if exact is None:
        assert_same(numbers(moved, ORIGIN)[0], problem.law.motion(POINTS[0], TIME))
        return
    assert_same(numbers(moved, ORIGIN), exact.x(POINTS, TIME))
    assert_same(numbers([sympy.diff(x, t) for x in moved], ORIGIN), exact.v(POINTS, TIME))
    assert_same(numbers(formulas["u"]), exact.u(POINTS, TIME))


@pytest.mark.parametrize("name", ["growing-sphere", "shrinking-sphere"])
def test_radii_obey_the_printed_equations(problem, formulas):
    position, equation = formulas.given["x"].split(" with ")
    left, right = map(formulas.read, equation.split(" = "))
    exact, unit = problem.exact, np.array([[1.0, 0, 0]])
    size, speed = exact.x(unit, TIME)[0, 0], exact.v(unit, TIME)[0, 0]
    assert position == "r p"
    assert_same(numbers(formulas["u"], radius=size), exact.u(POINTS, TIME))
    residual = (left - right).subs(u, formulas["u"]).subs({r: size, dr: speed})
    assert abs(residual) < 1e-12


@pytest.mark.parametrize("name", ["moving-torus"])
def test_source_and_force_of_the_torus_are_the_printed_ones_also_off_the_surface(problem, formulas):
    x, w, v, d = sympy.Matrix(X), formulas["u"], sympy.Matrix(formulas["velocity"]), formulas["d"]

    def grad(function):
        return sympy.Matrix([function]).jacobian(x).T

    n = grad(d) / grad(d).norm()
    P = sympy.eye(3) - n * n.T
    H = (P * sympy.hessian(d, X)).trace() / grad(d).norm()

    def lap(function):
        return (P * sympy.hessian(function, X)).trace() - H * n.dot(grad(function))

    f = sympy.diff(w, t) + v.dot(grad(w)) + w * (P * v.jacobian(x)).trace() - lap(w)
    alpha, beta = formulas.given["alpha"], formulas.given["beta"]
    assert (problem.law.alpha, problem.law.beta) == (alpha, beta)
    assert_same(numbers(f), problem.species["u"].source(AT))
    force = v - alpha * v.applyfunc(lap) + beta * H * n
    assert_same(numbers([*force]), problem.law.g(AT))

    moved = dict(zip(X, formulas["X"], strict=True))
    rates = [sympy.diff(q, t) for q in moved.values()]
    assert_same(numbers([*v.subs(moved)], ORIGIN), numbers(rates, ORIGIN))
    assert_same(numbers(d.subs(moved), ORIGIN, make.TORUS.closest(POINTS)), 0 * ONES)
