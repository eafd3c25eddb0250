"""What lines of door_table.py are made of, and what follows from them.

Wrong arguments (:func:`wrong`) and other spellings of right ones (:func:`equal`), of which
test_messages.py takes some and fuzz.py draws at random. A message is helpful if it names the
argument, says what is allowed ("must", "needs") and what was found; see :func:`helpful`.
"""

import re
from collections.abc import Callable
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

import esfem_core as ec

NAN, INF = float("nan"), float("inf")


class Argument(NamedTuple):
    """One argument: a good value, and the family of values that it belongs to."""

    good: Any
    family: str  # whole, number, array, points, function, option, flag, one, optional one, ...
    detail: Any = None
    optional: bool = False  # None is allowed
    called: tuple[str, ...] = ()  # other names that a message may use


class Door(NamedTuple):
    """A public function, with its arguments."""

    name: str
    function: Callable[..., Any]
    arguments: dict[str, Argument]


class Thing:
    """An object of no known type."""

    def __repr__(self):
        return "Thing()"


def number(good, *bad, optional=False, called=()):
    return Argument(good, "number", bad, optional, called)


def whole(good, *bad, optional=False, called=()):
    return Argument(good, "whole", bad, optional, called)


def array(good, *bad, optional=False, called=(), **free):
    """An array; what is free: finite=False, constant, before, after or rows=True.

    A number will do for a constant; before and after there may be further axes; any rows. Not free
    is only=True: nothing is converted, so that it must be an array of numbers.
    """
    return Argument(good, "array", (bad, free), optional, called)


def option(good):
    return Argument(good, "option")


def flag(good):
    return Argument(good, "flag")


def one(good, optional=False, called=()):
    """An object of one class."""
    return Argument(good, "one", None, optional, called)


def several(good):
    """A sequence of objects of one class."""
    return Argument(good, "several")


def function(good, optional=False, called=()):
    """A function whose values are not looked at, or not of a shape."""
    return Argument(good, "function", None, optional, called)


def returning(good, optional=False, called=(), constant=False, instead=(), any_shape=False):
    """A function that is called, whose values must be finite numbers of one shape.

    constant: it may return a number; instead: kinds that may stand for it, int, None or ndarray.
    """
    return Argument(good, "returning", (constant, instead, any_shape), optional, called)


def answering(good, instead=(), called=()):
    """Like `returning`, for a method: it is there, but may return what it must not."""
    return Argument(good, "answering", (False, instead, False), False, called)


def text(good, optional=False):
    return Argument(good, "text", None, optional)


def path(good, optional=False):
    return Argument(good, "path", None, optional)


# What no argument of a family may be ------------------------------------------------------------

NO_NUMBER = (None, "1", "", [], [1.0], {}, 1j, True, np.array([1.0]), np.array([]), Thing(), b"1",
             np.bool_(True), np.array("a"), lambda: 1)  # fmt: skip
NOT_FINITE = (NAN, INF, -INF, np.float64("nan"), np.float32("inf"), 10**400)
NO_OBJECT = (None, 1, 1.5, NAN, "a", [], {}, (), Thing(), np.ones(3), object, True)
NO_FUNCTION = (1, 1.5, "a", [], {}, np.ones(3), True, NAN, Thing())
NO_ARRAY = (None, "a", ["a"], [None], {}, Thing(), [[1, 2], [3]], np.array([1j]), 1j, b"a",
            [Thing()], np.array([], dtype=object), {1, 2}, lambda: 1)  # fmt: skip


def wrong(argument: Argument) -> list[tuple[str, Any]]:
    """Wrong values for an argument, each with a name."""
    good, detail = argument.good, argument.detail
    match argument.family:
        case "number":
            found = [*NO_NUMBER, *NOT_FINITE, *detail]
        case "whole":
            found = [*NO_NUMBER, *NOT_FINITE, 1.5, Fraction(3, 2), np.float32(0.5), *detail]
        case "array":
            bad, free = detail
            found = [*NO_ARRAY, *bad, *_spoilt(np.asarray(good), **free)]
            found += [] if free.get("constant") else [1.0, NAN]
            found += [np.asarray(good).tolist(), np.array(good, object)] if "only" in free else []
        case "option":
            found = [None, 1, "no such", "", [], b"a", NAN, Thing(), good.upper() + "x"]
        case "flag":
            found = [None, 2, "yes", [], NAN, np.array([True, False]), Thing(), 0.5]
        case "one":
            found = [v for v in NO_OBJECT if not isinstance(v, type(good))]
            found.append(type(good))
        case "several":
            found = [v for v in NO_OBJECT if not isinstance(v, type(good[0]))]
            found += [[None], [1, 2], ["a"], [Thing()], [*good, None]]
        case "function":
            found = [*NO_FUNCTION, None]
        case "returning" | "answering":
            constant, instead, any_shape = detail
            found = [*NO_FUNCTION, None] if argument.family == "returning" else []
            found = [v for v in found if not _stands(v, instead)]
            returning_functions = _wrongly_returning(good, constant, any_shape)
            if argument.family == "answering" and None in instead:
                returning_functions = [v for v in returning_functions if "none" not in v.__name__]
            found += returning_functions
        case "text":
            found = [1, NAN, [], Thing(), b"a", True]
        case "path":
            found = [1, 1.5, [], {}, Thing(), True, b"a.npz", "", "/no/such/folder/a.npz"]
        case _:
            found = list(detail)
    if argument.optional:
        found = [v for v in found if v is not None]
    return [(_name(v), v) for v in found]


def equal(argument: Argument) -> list[tuple[str, Any]]:
    """The good value in other spellings."""
    good = argument.good
    match argument.family:
        case "whole":
            kinds = (np.int64, np.int8, np.uint16, float, np.float32, Fraction, np.array)
            found: list[Any] = [kind(good) for kind in kinds]
        case "number":
            found = [np.float64(good), np.array(float(good)), np.longdouble(good)]
            found += [Fraction(good)] if good == float(Fraction(good)) else []
            found += [int(good)] if good == int(good) else []
        case "array":
            values = np.asarray(good)
            doubled = np.repeat(values, 2, axis=0) if values.ndim else values
            found = [np.asfortranarray(values)]
            found += [doubled[::2]] if values.ndim else []
            if "only" not in argument.detail[1]:
                found += [values.tolist(), values.astype(np.longdouble), values.astype(object)]
        case "flag":
            found = [np.bool_(good)]
        case "several":
            found = [tuple(good)]
        case _:
            found = []
    return [(_name(v), v) for v in found]


def _stands(value: Any, kinds: tuple[Any, ...]) -> bool:
    if isinstance(value, float) and np.isnan(value):
        return False
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return (
        (number and int in kinds)
        or (value is None and None in kinds)
        or (isinstance(value, np.ndarray) and np.ndarray in kinds)
    )


def _spoilt(
    values: np.ndarray,
    finite=True,
    constant=False,
    before=False,
    after=False,
    rows=False,
    only=False,
) -> list[Any]:
    """Arrays that differ from a good one in shape or kind."""
    found: list[Any] = [values.astype(complex), values.astype(str)]
    found += [np.ma.masked_array(values, mask=np.ones(values.shape, bool)), values > 0]
    found += [] if after else [values[..., None]]
    found += [] if before else [values[None]]
    if not rows:
        found += [values[:-1], np.concatenate([values, values[:1]]), values[:0]]
    if values.ndim > 1:
        found += [] if after else [values[..., :-1], values.ravel()]
        found += [values.T] if values.shape[0] != values.shape[-1] and not before else []
    if finite and values.size:
        for bad in (NAN, INF):
            copy = np.array(values, dtype=float)
            copy.flat[copy.size // 2] = bad
            found.append(copy)
    return found


def _wrongly_returning(good: Callable[..., Any], constant: bool, any_shape: bool) -> list[Any]:
    """Functions that return what they must not."""

    def made(name: str, change: Callable[[Any], Any]) -> Callable[..., Any]:
        def returns(*args):
            return change(good(*args))

        returns.__wrapped__ = good  # with its signature
        returns.__name__ = f"returns_{name}"
        return returns

    changes: dict[str, Callable[[Any], Any]] = {
        "none": lambda v: None,
        "text": lambda v: "a",
        "texts": lambda v: np.asarray(v).astype(str),
        "complex": lambda v: np.asarray(v) * (1 + 1j),
        "fewer": lambda v: np.asarray(v)[:-1],
        "nan": lambda v: np.asarray(v) * NAN,
        "infinity": lambda v: np.asarray(v) * 0 + INF,
        "one axis more": lambda v: np.asarray(v)[..., None, None, None],
        "thing": lambda v: Thing(),
        "empty": lambda v: [],
        "ragged": lambda v: [[1, 2], [3]],
        "masked": lambda v: np.ma.masked_all(np.shape(v)),
    }
    if not constant:
        changes["a number"] = lambda v: 1.0
    if any_shape:
        del changes["one axis more"]
    return [made(name, change) for name, change in changes.items()]


def _name(value: Any) -> str:
    if isinstance(value, np.ndarray):
        kind = "masked " if isinstance(value, np.ma.MaskedArray) else ""
        bad = "" if value.dtype.kind != "f" or np.isfinite(value).all() else " not finite"
        return f"{kind}{value.dtype}{value.shape}{bad}"
    if callable(value):
        return getattr(value, "__name__", "function")
    text = repr(value)
    return f"{type(value).__name__}: {text if len(text) < 40 else text[:37] + '...'}"


# What came out ----------------------------------------------------------------------------------

ALLOWED = re.compile(r"\bmust\b|\bneeds?\b")
FOUND = re.compile(r"\bgot\b|\bbut\b|\bis\b|\bhas\b|\bare\b|\breturned\b")


def helpful(error: BaseException, name: str, argument: Argument) -> bool:
    """Whether a message names the argument, what is allowed and what was found."""
    message = str(error)
    kinds = TypeError | ValueError | ArithmeticError | FileNotFoundError | ec.EvolutionError
    names = (name, *argument.called)
    named = any(re.search(rf"(?<!\w){re.escape(n)}(?!\w)", message) for n in names)
    said = ALLOWED.search(message) and FOUND.search(message)
    return bool(isinstance(error, kinds) and named and said)


def may(argument: Argument, value: Any) -> bool:
    """Whether a value could be right for an argument, as far as kind and shape tell."""
    match argument.family:
        case "number" | "whole":
            if isinstance(value, bool | np.bool_ | str) or np.ndim(value) > 0:
                return False
            try:
                return bool(np.isfinite(float(value)))
            except (TypeError, ValueError, OverflowError):
                return False
        case "array":
            _, free = argument.detail
            found, wanted = np.asarray(value), np.asarray(argument.good)
            if found.dtype.kind not in "fiu" or np.ma.isMaskedArray(value):
                return False
            if free.get("finite", True) and not np.isfinite(found).all():
                return False
            free_axes = {"before", "after", "rows", "constant"} & set(free)
            return bool(free_axes) or found.shape == wanted.shape
    return True


def same(one: Any, other: Any) -> bool:
    """Whether two results are equal to the last bit, as far as they hold numbers."""
    if isinstance(one, np.ndarray | np.generic | float | int):
        first, second = np.asarray(one), np.asarray(other)
        if first.dtype.kind not in "fiu":
            return first.shape == second.shape and bool((first == second).all())
        return bool(np.array_equal(first, second, equal_nan=True))
    if isinstance(one, ec.State):
        return same(
            [one.t, one.x, *one.fields.values()], [other.t, other.x, *other.fields.values()]
        )
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, dict):
        return list(one) == list(other) and same(list(one.values()), list(other.values()))
    if hasattr(one, "faces"):
        return same([one.vertices, one.faces], [other.vertices, other.faces])
    if hasattr(one, "indptr"):
        return same([one.data, one.indices], [other.data, other.indices])
    return type(one) is type(other)
