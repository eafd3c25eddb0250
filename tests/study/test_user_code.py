"""A row of a reader's function depends on what the function reaches, and on no word beside it."""

import functools
import importlib
import linecache
import logging
import operator
import os
import random
import re
import sys
import types
from collections import OrderedDict, defaultdict, deque
from dataclasses import dataclass
from datetime import date
from decimal import Decimal
from enum import Enum
from fractions import Fraction
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from threading import Lock

import numpy as np
import pytest
import scipy
import scipy.stats
import sympy
from scipy.sparse import coo_array

import esfem_core as ec
from esfem_core.elements import Smoothing, TangentPlanes
from esfem_core.solvers import cholmod, superlu
from esfem_core.stepping import bdf
from esfem_core.study import dependencies, user_code
from esfem_core.study.dependencies import code_hash
from esfem_core.study.user_code import code_of, imports_of
from esfem_core.surfaces.balls import Balls

SOURCE = '''
import numpy as np
import esfem_core as ec

FACTOR, TABLE, OTHER = 2.0, np.arange(3), "other"
SPACE = ec.Problem(g=lambda at: at.u)


class Shape:
    """A shape."""
    sides = 3

    def area(self):
        return self.sides * FACTOR

    @property
    def half(self):
        return self.area() / 2


def helper(x):
    """Help."""
    return x + 1  # a comment


def unused(x):
    return OTHER


def compute(size, *, scale=TABLE):
    def inner(y):
        return helper(y)

    return {"n": inner(size), "area": Shape().half, "bdf": ec.bdf.delta(2)}
'''


def compute(source, name="notebook"):
    """The function of a notebook."""
    file = f"<cell {hash(source)}>"
    linecache.cache[file] = len(source), None, source.splitlines(keepends=True), file
    module = types.ModuleType(name)
    module.__file__ = file
    sys.modules[name] = module
    exec(compile_(source, file, "exec"), module.__dict__)
    return module.compute


compile_ = __builtins__["compile"] if isinstance(__builtins__, dict) else __builtins__.compile


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("FACTOR, TABLE, OTHER = 2.0", "FACTOR, TABLE, OTHER = 3.0"),
        ("np.arange(3)", "np.arange(4)"),
        ("sides = 3", "sides = 4"),
        ("x + 1", "x + 2"),
        ("self.area() / 2", "self.area() / 3"),
        ("ec.bdf.delta(2)", "ec.bdf.gamma(2)"),
        ("inner(size)", "inner(-size)"),
    ],
)
def test_what_the_function_reaches_counts(old, new):
    assert SOURCE.count(old) == 1
    assert code_of(compute(SOURCE.replace(old, new))) != code_of(compute(SOURCE))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("  # a comment", ""),
        ('"""Help."""', '"""Another help."""'),
        ('"""A shape."""', ""),
        ("return OTHER", "return 3"),
        ('"other"', '"else"'),
        ("x + 1", "(x +\n 1)"),
    ],
)
def test_words_layout_and_what_it_does_not_reach_do_not(old, new):
    assert SOURCE.count(old) == 1
    assert code_of(compute(SOURCE.replace(old, new))) == code_of(compute(SOURCE))


def test_the_name_of_the_module_does_not_count():
    assert code_of(compute(SOURCE, "first")) == code_of(compute(SOURCE, "second"))


def test_the_solver_counts_as_far_as_it_is_reached(monkeypatch):
    def own(order):
        return {"delta": ec.bdf.delta(order)}

    def other(order):
        return {"space": ec.SurfaceSpace}

    before = code_of(own), code_of(other)
    real = dependencies.hash_of
    changed = lambda m, n, p: "new" if n == "delta" else real(m, n, p)  # noqa: E731
    monkeypatch.setattr(dependencies, "hash_of", changed)
    assert code_of(own) != before[0]
    assert code_of(other) == before[1]


def test_values_that_a_function_encloses_count():
    def make(value):
        return lambda size: size * value

    codes = [code_of(make(v)) for v in (1, 2, "a", [1], {"a": 1}, {1, 2}, np.ones(2), np.ones(3))]
    assert len(set(codes)) == len(codes)
    assert code_of(make({"a", "b"})) == code_of(make({"b", "a"}))
    assert code_of(functools.partial(make, 1)) != code_of(functools.partial(make, 2))


@dataclass(frozen=True)
class Settings:
    degree: int
    law: object = None


class Colour(Enum):
    RED = 1
    BLUE = 2


LAW = ec.laws.Regularised(1, 1)


class Model:
    def __init__(self, rate):
        self.rate = rate

    def __call__(self, size):
        return size * self.rate


class Slots:
    __slots__ = ("rate",)

    def __init__(self, rate):
        self.rate = rate


class Entries(list):
    pass


class Money(float):
    def __repr__(self):
        return "money"


def with_attribute(made, rate):
    made.rate = rate
    return made


def sphere(u, motion=("p1", "p2", "p3")):
    return ec.manufactured("x1**2 + x2**2 + x3**2 - 1", motion, u)


def decorated(factor):
    """A function that a decorator of a parameter makes."""

    def raw(size):
        return size

    @functools.wraps(raw)
    def wrapper(size):
        return factor * raw(size)

    return wrapper


def space(refinements):
    return ec.SurfaceSpace(ec.sphere("octahedron", refinements))


def surface(radius):
    return ec.Surface(SPACE, radius * SPACE.nodes)


SPACE, EYE = space(1), scipy.sparse.csc_array(np.eye(3))
FORMATS = ("csr", "csc", "coo", "lil", "dok", "dia", "bsr")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (Model(1), Model(2)),
        (ec.laws.with_slip(LAW, "elastic"), ec.laws.with_slip(LAW, "harmonic")),
        (ec.laws.with_slip(LAW, np.sin), ec.laws.with_slip(LAW, np.cos)),
        (Model(space(0)), Model(space(1))),
        (space(0), space(1)),
        (space(0), ec.SurfaceSpace(ec.sphere("octahedron", 0), exactness=4)),
        (ec.sphere("octahedron", 0), ec.sphere("octahedron", 1)),
        (Fraction(1, 3), Fraction(2, 3)),
        (Decimal("0.1"), Decimal("0.2")),
        (b"a", b"b"),
        (range(3), range(4)),
        (slice(1), slice(2)),
        (Path("a"), Path("b")),
        (Colour.RED, Colour.BLUE),
        (date(2026, 1, 1), date(2026, 1, 2)),
        (re.compile("a"), re.compile("b")),
        (np.sin, np.cos),
        (functools.cache(lambda x: x + 1), functools.cache(lambda x: x + 2)),
        (np.vectorize(lambda x: x + 1), np.vectorize(lambda x: x + 2)),
        (max, min),
        (np.ma.array([1, 2], mask=[0, 0]), np.ma.array([1, 2], mask=[0, 1])),
        (np.array([1, None]), np.array([2, None])),
        (types.SimpleNamespace(a=1), types.SimpleNamespace(a=2)),
        (Settings(1), Settings(2)),
        (Settings(1, ec.laws.Regularised(1, 1)), Settings(1, ec.laws.Regularised(2, 1))),
        (ec.laws.MeanCurvature(1), ec.laws.MeanCurvature(2)),
        (ec.problems.growing_sphere(alpha=1), ec.problems.growing_sphere(alpha=2)),
        (ec.problems.growing_sphere(u0=4), ec.problems.growing_sphere(u0=5)),
        (ec.Problem(1.0, f=lambda at: at.u), ec.Problem(1.0, f=lambda at: 2 * at.u)),
        (Slots(1), Slots(2)),
        (Entries([1]), Entries([2])),
        (Entries([1]), [1]),
        (with_attribute(Entries(), 1), with_attribute(Entries(), 2)),
        (with_attribute(lambda: 0, 1), with_attribute(lambda: 0, 2)),
        (Money(1), Money(2)),
        (deque([1]), deque([2])),
        (defaultdict(int), defaultdict(list)),
        ({"a": 1, "b": 2}, {"b": 2, "a": 1}),
        (OrderedDict(a=1), {"a": 1}),
        (operator.itemgetter(1), operator.itemgetter(2)),
        ({1: 1}.get, {1: 2}.get),
        (np.linalg.norm, scipy.linalg.norm),
        (re.compile("a" * 300 + "b"), re.compile("a" * 300 + "c")),
        (np.vectorize(abs, otypes=[int]), np.vectorize(abs, otypes=[float])),
        (np.frompyfunc(lambda x: x + 1, 1, 1), np.frompyfunc(lambda x: x + 2, 1, 1)),
        (np.random.default_rng(1), np.random.default_rng(2)),
        (np.array([[1]]), np.matrix([[1]])),
        (np.arange(6).reshape(2, 3), np.arange(6).reshape(3, 2)),
        *(
            (coo_array(np.eye(2)).asformat(f), coo_array(2 * np.eye(2)).asformat(f))
            for f in FORMATS
        ),
        (coo_array((2, 3)), coo_array((3, 2))),
        (sympy.Symbol("x") + 1, sympy.Symbol("x") + 2),
        (sympy.Matrix([1, 2]), sympy.Matrix([1, 3])),
        (sympy.Integer(1), 1),
        (sympy.lambdify("x", "x + 1"), sympy.lambdify("x", "x + 2")),
        (sphere("x1"), sphere("x2")),
        (sphere("x1"), sphere("x1", ["p1*cos(t) - p2*sin(t)", "p1*sin(t) + p2*cos(t)", "p3"])),
        (
            ec.problems.oscillating_ellipsoid("decay"),
            ec.problems.oscillating_ellipsoid("oscillation"),
        ),
        (ec.LaggedSolver(price=8), ec.LaggedSolver(price=9)),
        (ec.DirectSolver(ec.solvers.superlu), ec.DirectSolver(ec.solvers.cholmod)),
        (decorated(1), decorated(2)),
        (functools.wraps(bdf.delta)(lambda: 1), functools.wraps(bdf.delta)(lambda: 2)),
        (functools.wraps(np.sum)(lambda: 1), functools.wraps(np.sum)(lambda: 2)),
        (TangentPlanes(surface(1), 0.1), TangentPlanes(surface(2), 0.1)),
        (TangentPlanes(surface(1), 0.1), TangentPlanes(surface(1), 0.2)),
        (Smoothing(surface(1)), Smoothing(surface(2))),
        (superlu(surface(1).M), superlu(surface(2).M)),
        (superlu(surface(1).M).solve, superlu(surface(2).M).solve),
        (scipy.sparse.linalg.splu(EYE), scipy.sparse.linalg.splu(2 * EYE)),
        (Balls(np.zeros((1, 3)), np.ones(1)), Balls(np.ones((1, 3)), np.ones(1))),
        ({"a": 1}.keys(), {"b": 1}.keys()),
        ({"a": 1}.values(), {"a": 2}.values()),
        ({"a": 1}.items(), {"a": 2}.items()),
        (memoryview(b"ab"), memoryview(b"ac")),
        (memoryview(b"abc")[1:], memoryview(b"abc")[:-1]),
        (compile_("x + 1", "", "eval"), compile_("x + 2", "", "eval")),
    ],
)
def test_another_value_of_a_name_is_other_code(old, new):
    def make(value):
        return lambda size: size * value

    assert code_of(make(old)) == code_of(make(old))
    assert code_of(make(old)) != code_of(make(new))


def test_a_method_depends_on_the_attributes_of_its_object():
    assert code_of(Model(1).__call__) == code_of(Model(1).__call__)
    assert code_of(Model(1).__call__) != code_of(Model(2).__call__)


def test_which_of_the_objects_that_it_uses_a_name_stands_for_counts():
    coarse, fine = space(0), space(1)

    def make(chosen):
        return lambda: (coarse, fine, chosen)

    assert code_of(make(coarse)) == code_of(make(coarse))
    assert code_of(make(coarse)) != code_of(make(fine))


def test_a_decorated_function_counts_with_its_decorator():
    assert code_of(decorated(1)) == code_of(decorated(1))
    assert code_of(decorated(1)) != code_of(decorated(2))


def test_a_function_with_the_name_of_one_of_the_package_is_none():
    wrapped = functools.wraps(bdf.delta)(lambda order: 2 * bdf.delta(order))
    assert not dependencies.is_of_package(wrapped)
    assert code_of(wrapped) != code_hash(bdf.delta)


CLASSES = """
from collections import namedtuple
from enum import Enum
from functools import cached_property, partialmethod, singledispatch


class Meta(type):
    def made(cls):
        return 1


class Kept(metaclass=Meta):
    @cached_property
    def value(self):
        return 2

    def power(self, n):
        return n

    square = partialmethod(power, 3)

    @property
    def size(self):
        return self.power(1)

    @size.setter
    def size(self, value):
        self.length = value + 8


class Point(namedtuple("Pair", "x y")):
    def size(self):
        return self.x + 4


class Colour(Enum):
    RED = "red"

    def shade(self):
        return 5


class Entries(list):
    def total(self):
        return 6


@singledispatch
def kind(x):
    return x


@kind.register
def _(x: int):
    return 7


RED, POINT, ENTRIES = Colour.RED, Point(1, 2), Entries([1])


def compute(size):
    return Kept().value, POINT.size(), RED.shade(), ENTRIES.total(), kind(size)
"""


@pytest.mark.parametrize(
    "text",
    [
        "return 1",
        "return 2",
        "power, 3",
        "self.x + 4",
        "return 5",
        "return 6",
        "return 7",
        "value + 8",
    ],
)
def test_all_that_stands_in_a_class_counts(text):
    assert CLASSES.count(text) == 1
    other = CLASSES.replace(text, text[:-1] + "9")
    assert code_of(compute(CLASSES)) == code_of(compute(CLASSES))
    assert code_of(compute(other)) != code_of(compute(CLASSES))


def test_the_base_of_a_class_counts():
    """Of classes with the same name and text."""

    def own(base):
        class Own(base):
            pass

        return lambda: Own()

    def base(value):
        class Base:
            factor = value

        return Base

    assert code_of(own(base(1))) == code_of(own(base(1)))
    assert code_of(own(base(1))) != code_of(own(base(2)))


@pytest.mark.parametrize(
    "line",
    [
        "from helpers import helper; return helper()",
        "import helpers; return helpers.helper()",
        "import helpers as other; return other.helper()",
        "import helpers as other; return getattr(other, 'helper')()",
        "return (lambda: MODULE.helper())()",
        "return CALL()",
        "return vars(MODULE)",
    ],
)
def test_modules_of_the_user_count_where_they_are_used(line, monkeypatch):
    helpers = types.ModuleType("helpers")
    monkeypatch.setitem(sys.modules, "helpers", helpers)
    source = (
        f"import helpers as MODULE\nCALL = lambda: MODULE.helper()\ndef compute():\n    {line}\n"
    )
    codes = []
    for value in (1, 1, 2):
        exec(f"def helper(value={value}): return value", helpers.__dict__)
        codes.append(code_of(compute(source)))
    assert codes[0] == codes[1] != codes[2]


def test_names_that_begin_with_an_underscore_count_in_a_module_that_is_handed_on(monkeypatch):
    helpers = types.ModuleType("helpers")
    monkeypatch.setitem(sys.modules, "helpers", helpers)
    function = compute("import helpers as MODULE\ndef compute():\n    return vars(MODULE)\n")
    helpers._log, helpers._lock = logging.getLogger("helpers"), Lock()
    codes = []
    for helpers._factor in (2, 2, 100):
        helpers.__cached__ = object()
        codes.append(code_of(function))
    assert codes[0] == codes[1] != codes[2]


@pytest.mark.parametrize(
    "line",
    [
        "import esfem_core as q; return q.bdf.delta(2)",
        "from esfem_core.stepping import bdf; return bdf.delta(2)",
        "from esfem_core.stepping.bdf import delta; return delta(2)",
        "return ec.bdf.delta(2)",
        "return CALL()",
    ],
)
@pytest.mark.parametrize("place", [ec.__file__, "/python/site-packages/esfem_core/__init__.py"])
def test_the_package_counts_where_it_is_used_also_when_it_is_installed(line, place, monkeypatch):
    monkeypatch.setattr(ec, "__file__", place)
    user_code._is_library.cache_clear()
    source = (
        f"import esfem_core as ec\nCALL = lambda: ec.bdf.delta(2)\ndef compute():\n    {line}\n"
    )
    before, real = code_of(compute(source)), dependencies.hash_of
    changed = lambda m, n, p: "new" if n == "delta" else real(m, n, p)  # noqa: E731
    monkeypatch.setattr(dependencies, "hash_of", changed)
    assert code_of(compute(source)) != before
    user_code._is_library.cache_clear()


def test_arguments_of_functions_without_a_name_count():
    assert code_of(lambda a, b: a - b) != code_of(lambda b, a: b - a)
    assert code_of(lambda a: a) != code_of(lambda *a: a)


def test_the_default_of_a_keyword_counts():
    def scaled(factor):
        return lambda n, *, by=factor: by * n

    assert code_of(scaled(2)) == code_of(scaled(2))
    assert code_of(scaled(2)) != code_of(scaled(3))


def test_the_order_of_sets_does_not_count():
    assert list({0, 8}) != list({8, 0})
    assert code_of(lambda n: n in {0, 8}) == code_of(lambda n: n in {8, 0})

    def make(value):
        return lambda: value

    assert code_of(make({0, 8})) == code_of(make({8, 0}))
    assert code_of(make({(0,), Model(8)})) == code_of(make({Model(8), (0,)}))


def test_long_chains_of_objects_end():
    def chain(last):
        first = model = Model(0)
        for rate in (*range(2000), last):
            model.next = model = Model(rate)
        return lambda: first

    assert code_of(chain(1)) == code_of(chain(1))
    assert code_of(chain(1)) != code_of(chain(2))


class Squares:
    def __init__(self, matrix):
        self.matrix, self.solver, self.again = matrix, ec.LaggedSolver(), functools.cache(abs)
        self.each = np.vectorize(abs, otypes=[float])
        self.surface = ec.Surface(space(0), space(0).nodes)

    @functools.cached_property
    def square(self):
        return self.matrix + self.matrix


def test_what_objects_have_computed_in_the_meantime_does_not_count():
    used = Squares(coo_array(np.eye(3)).tocsr())
    before = code_of(lambda: used)
    assert used.square.nnz == 3
    assert used.solver.solve(used.matrix, np.ones(3), np.zeros(3)).sum() == 3
    assert used.again(1) == used.each([1])[0] == 1
    assert used.surface.M.nnz
    assert code_of(lambda: used) == before


@pytest.mark.parametrize(
    "used",
    [
        scipy.stats.norm,
        random.gauss,
        random.random,
        np.random.normal,
        os.environ,
        functools.partial(np.random.uniform, 1),
    ],
)
def test_what_is_other_in_every_process_does_not_count(used, monkeypatch):
    def compute():
        return used

    before = code_of(compute)
    random.random()
    np.random.normal()  # noqa: NPY002
    monkeypatch.setenv("ESFEM_TEST", "1")
    assert code_of(compute) == before


def test_own_generators_count():
    def make(value):
        return lambda: value

    assert code_of(make(random.Random(1).random)) != code_of(make(random.Random(2).random))
    assert code_of(make(random.random)) != code_of(make(random.gauss))


def test_the_count_of_symbols_does_not_count():
    def make(formula):
        x, y = sympy.symbols("x y")
        made = sympy.lambdify([(x, y), sympy.Function("f")(x)], formula)
        return lambda: made

    assert code_of(make("x + y")) == code_of(make("x + y"))
    assert code_of(make("x + y")) != code_of(make("y - x"))


def test_what_cannot_be_pickled_counts_by_its_class():
    def make(value):
        return lambda: value

    one, two = Lock(), open(__file__)  # noqa: SIM115
    with two:
        assert code_of(make(one)) == code_of(make(Lock()))
        assert code_of(make(one)) != code_of(make(two))


def test_what_nothing_tells_from_others_is_another_one_at_each_look():
    pytest.importorskip("cholespy")
    factor = cholmod(surface(1).M)
    assert code_of(lambda: factor) != code_of(lambda: factor)


def test_a_compiled_module_of_the_user_counts_by_its_file(tmp_path, monkeypatch):
    def compute():
        return kernel.scaled

    def whole():
        return vars(kernel)

    codes, file = [], tmp_path / f"kernel{EXTENSION_SUFFIXES[-1]}"
    for text in ("one", "one", "two"):
        kernel = types.ModuleType("kernel")
        kernel.__file__ = str(file)
        kernel.scaled = type("scaled", (), {"__module__": "kernel"})
        file.write_text(text)
        monkeypatch.setitem(sys.modules, "kernel", kernel)
        codes.append([code_of(compute), code_of(kernel.scaled), code_of(whole)])
        file.write_text("made anew while it is loaded")
        assert code_of(compute) == codes[-1][0]
    assert codes[0] == codes[1]
    assert not set(codes[1]) & set(codes[2])


def test_what_a_space_or_a_mesh_has_computed_in_the_meantime_does_not_count():
    used, tri = space(1), ec.sphere("octahedron", 1)
    before = code_of(lambda: (used, tri))
    assert used.fronts
    assert tri.area
    assert code_of(lambda: (used, tri)) == before


def law(x):
    return 2 * x


def other_law(x):
    return 3 * x


def test_a_dict_of_functions_counts_and_names_in_a_text_do_not(monkeypatch):
    laws = {"law": law}

    def chosen(name, x):
        return laws[name](x)

    def looked_up(name, x):
        return globals()[name](x)

    before = code_of(chosen), code_of(looked_up)
    laws["law"] = other_law
    monkeypatch.setitem(globals(), "law", other_law)
    assert code_of(chosen) != before[0]
    assert code_of(looked_up) == before[1]  # as its docstring says


def test_recursion_ends():
    def even(n):
        return n == 0 or odd(n - 1)

    def odd(n):
        return n != 0 and even(n - 1)

    assert len(code_of(even)) == 12


def test_a_function_of_the_package_is_read_from_its_file():
    assert code_of(bdf.delta) == code_hash(bdf.delta)


def shaded(tri):
    tri.visual.vertex_colors = np.full((len(tri.vertices), 4), 7, dtype=np.uint8)


@pytest.mark.parametrize(
    "change",
    [
        lambda tri: setattr(tri, "units", "millimeters"),
        lambda tri: tri.metadata.update(length=7),
        lambda tri: tri.vertex_attributes["u0"].__setitem__(3, 5.0),
        lambda tri: tri.face_attributes.update(part=np.arange(len(tri.faces))),
        lambda tri: setattr(tri, "density", 3.0),
        lambda tri: setattr(tri, "center_mass", [0, 0, 1]),
        lambda tri: setattr(tri, "start", 2 * tri.vertices),
        lambda tri: setattr(tri, "other", ec.sphere("octahedron", 0)),
        shaded,
    ],
)
def test_what_a_mesh_was_given_counts_and_where_its_file_stood_does_not(change):
    """Units and attributes could be changed, and the rows of before were taken for today's."""
    tri = ec.sphere("octahedron", 1)
    tri.units, tri.vertex_attributes["u0"] = "meters", np.ones(18)
    before = code_of(lambda: tri)
    assert tri.volume, tri.visual.vertex_colors  # caches
    tri.metadata["file_path"] = "/home/of/another/sphere.ply"
    assert code_of(lambda: tri) == before
    change(tri)
    assert code_of(lambda: tri) != before


def module(path, text, monkeypatch):
    """A module in a file, imported."""
    path.write_text(text)
    monkeypatch.syspath_prepend(path.parent)
    monkeypatch.delitem(sys.modules, path.stem, raising=False)
    importlib.invalidate_caches()
    monkeypatch.setitem(sys.modules, path.stem, importlib.import_module(path.stem))
    return sys.modules[path.stem]


EDITED = "N = 3\n\ndef other():\n    return 1\n\ndef compute(size):\n    return {'n': N * size}\n"


@pytest.mark.parametrize(
    ("old", "new", "same"),
    [("N * size", "N + size", False), ("N = 3", "# Lines\n\nN = 3", True), ("N = 3\n", "", True)],
)
def test_what_is_loaded_counts_and_not_what_the_file_says_by_now(
    tmp_path, monkeypatch, old, new, same
):
    loaded = module(tmp_path / "edited.py", EDITED, monkeypatch)
    before = code_of(loaded.compute)
    (tmp_path / "edited.py").write_text(EDITED.replace(old, new))
    assert (code_of(loaded.compute) == before) is same
    assert loaded.compute(2) == {"n": 6}


@pytest.mark.parametrize(
    ("old", "new", "same"),
    [
        ("N * size", "N + size", False),
        ("N = 3", "N = 4", False),
        ("return 1", "return 2", True),
        ("N = 3", "# Lines\n\nN = 3", True),
    ],
)
def test_imports_tell_whether_two_processes_have_loaded_the_same(
    tmp_path, monkeypatch, old, new, same
):
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    before = imports_of(module(tmp_path / "edited.py", EDITED, monkeypatch).compute)
    edited = EDITED.replace(old, new)
    after = imports_of(module(tmp_path / "edited.py", edited, monkeypatch).compute)
    assert before.keys() == after.keys() == {f"edited.compute ({sys.implementation.cache_tag})"}
    assert (before == after) is same


def test_what_differs_from_machine_to_machine_is_no_import(tmp_path, monkeypatch):
    text = EDITED.replace("N = 3", "import os\nN = os.getpid()")
    made = module(tmp_path / "machine.py", text, monkeypatch)
    before = imports_of(made.compute)
    monkeypatch.setattr(made, "N", 3)
    assert imports_of(made.compute) == before


@pytest.mark.parametrize("module", ["installed_here", "installed_too", "mine_here"])
def test_what_pip_has_put_into_another_folder_is_a_library(tmp_path, monkeypatch, module):
    (tmp_path / "installed_here").mkdir()
    for file in ("installed_here/__init__.py", "installed_too.py", "mine_here.py"):
        (tmp_path / file).write_text("N = 1\n")
    (tmp_path / "some-1.0.dist-info").mkdir()
    record = "installed_here/__init__.py,sha256=x,5\ninstalled_too.py,sha256=y,5\n"
    (tmp_path / "some-1.0.dist-info" / "RECORD").write_text(f"{record}other/mine_here.py,,\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert user_code._is_library.__wrapped__(module) == module.startswith("installed")
