"""A row of a reader's function depends on what the function reaches, and on no word beside it."""

import functools
import linecache
import re
import sys
import types
from dataclasses import dataclass
from datetime import date
from decimal import Decimal
from enum import Enum
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import esfem_core as ec
from esfem_core.stepping import bdf
from esfem_core.study.user_code import code_of

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
    from esfem_core.study import dependencies

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


def space(refinements):
    return ec.SurfaceSpace(ec.sphere("octahedron", refinements))


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


def test_what_a_space_or_a_mesh_has_computed_in_the_meantime_does_not_count():
    used, tri = space(1), ec.sphere("octahedron", 1)
    before = code_of(lambda: (used, tri))
    assert used.fronts
    assert tri.area
    assert code_of(lambda: (used, tri)) == before


def test_recursion_ends():
    def even(n):
        return n == 0 or odd(n - 1)

    def odd(n):
        return n != 0 and even(n - 1)

    assert len(code_of(even)) == 12


def test_a_function_of_the_package_is_read_from_its_file():
    from esfem_core.study.dependencies import code_hash

    assert code_of(bdf.delta) == code_hash(bdf.delta)
