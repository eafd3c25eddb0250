"""What is refused at the door, and the array types of the package: each once.

A check takes the name of an argument and its value, and returns the value as the type that the
code behind it relies on. Its message says the name, what is allowed and what was found.

A function called ``check_...`` refuses input, by TypeError or ValueError, and does nothing else:
stored results depend on the code of their runs, but not on such calls (see
:mod:`esfem_core.study.dependencies`). What may end a run, which a result may tell, or send an
algorithm another way, is called ``require_...``.
"""

import inspect
import math
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import import_module
from numbers import Integral, Real
from pathlib import Path
from typing import Any, TypeVar, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "Array",
    "Bools",
    "Ints",
    "ReadOnly",
    "check_arguments",
    "check_array",
    "check_even",
    "check_node_numbers",
    "check_nodes",
    "check_string",
    "finite_array",
    "flag",
    "frozen",
    "function",
    "integer_array",
    "items",
    "iterable",
    "level_outside",
    "mapping",
    "named",
    "number",
    "object_of",
    "one_of",
    "output_path",
    "package",
    "path_of",
    "read_only",
    "real_array",
    "shown",
    "string",
    "whole_number",
]

Array = NDArray[np.float64]
"""An array of double precision."""

Ints = NDArray[np.int64]
"""An array of integers."""

Bools = NDArray[np.bool_]
"""An array of truth values."""

OF_CONDITION = "; np.where(condition, 1.0, 0.0) makes numbers of a condition"

Kind = TypeVar("Kind")

EXACT = 2.0**53  # floats from here on do not tell integers apart
LARGEST = 2**63 - 1  # integer: beyond, arrays cannot hold it


def shown(value: object) -> str:
    """A value as a message shows it: short, arrays by their shape.

    Examples
    --------
    >>> shown(np.float64(0.5)), shown("x"), shown(np.zeros((2, 3)))
    ('0.5', "'x'", 'an array of shape (2, 3)')
    """
    if isinstance(value, np.ndarray) and value.dtype.kind != "U":  # which is no string
        value = _entry(value)
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape}"
    if isinstance(value, type):
        return f"the class {value.__name__}"
    text = str(value) if isinstance(value, np.generic) else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def whole_number(name: str, value: object, least: int, most: int | None = None) -> int:
    """An integer in a range; numbers of any library with an integer value are integers.

    Parameters
    ----------
    name : str
        What the message calls it.
    value : object
    least, most : int
        Both allowed.

    Returns
    -------
    int

    Raises
    ------
    TypeError
        If it is no real number.
    ValueError
        If it is no integer or outside the range.

    Examples
    --------
    >>> whole_number("degree", np.float32(2), 1)
    2
    >>> whole_number("degree", 1.5, 1)
    Traceback (most recent call last):
        ...
    ValueError: degree must be an integer >= 1, got 1.5
    """
    allowed = f"an integer >= {least}" if most is None else f"an integer from {least} to {most}"
    found = _real(value)
    if found is None:
        raise TypeError(f"{name} must be {allowed}, got {shown(value)}")
    if not -math.inf < found < math.inf or found != int(found):
        raise ValueError(f"{name} must be {allowed}, got {shown(value)}")
    if found < least or found > (LARGEST if most is None else most):
        if most is None and found > LARGEST:
            allowed += f" and <= {LARGEST}"
        raise ValueError(f"{name} must be {allowed}, got {shown(value)}")
    return int(found)


def number(
    name: str,
    value: object,
    *,
    above: float | None = None,
    least: float | None = None,
    below: float | None = None,
    most: float | None = None,
) -> float:
    """A finite real number in a range.

    Parameters
    ----------
    name : str
        What the message calls it.
    value : object
    above, below : float, optional
        Bounds that are not allowed themselves.
    least, most : float, optional
        Bounds that are allowed.

    Returns
    -------
    float

    Raises
    ------
    TypeError
        If it is no real number.
    ValueError
        If it is not finite or outside the range.

    Examples
    --------
    >>> number("step", 0.1, above=0)
    0.1
    >>> number("step", float("nan"), above=0)
    Traceback (most recent call last):
        ...
    ValueError: step must be a finite number > 0, got nan
    """
    found = _real(value)
    if (
        found is not None
        and -math.inf < _as_float(found) < math.inf
        and (above is None or found > above)
        and (least is None or found >= least)
        and (below is None or found < below)
        and (most is None or found <= most)
    ):
        return _as_float(found)
    bounds = ((">", above), (">=", least), ("<", below), ("<=", most))
    allowed = " and ".join(f"{sign} {bound:g}" for sign, bound in bounds if bound is not None)
    text = f"{name} must be a finite number{f' {allowed}' if allowed else ''}, got {shown(value)}"
    raise TypeError(text) if found is None else ValueError(text)


def _real(value: object) -> int | float | None:
    """A real number of any library, or None."""
    if isinstance(value, float):  # also NumPy's, which is one
        return float(value)
    value = _entry(value)
    if isinstance(value, bool | np.bool_ | np.timedelta64) or not isinstance(value, Real):
        return None  # a time span passes for an integer with NumPy, in whatever unit it is
    try:
        return int(value) if isinstance(value, Integral) else float(value)
    except OverflowError:
        return math.inf  # larger than any float


def one_of(name: str, value: object, options: Any) -> str:
    """One of some strings, given as a sequence or as a ``Literal``.

    Examples
    --------
    >>> one_of("kind", "cube", ("octahedron", "icosahedron"))
    Traceback (most recent call last):
        ...
    ValueError: kind must be "octahedron" or "icosahedron", got 'cube'
    """
    allowed: Sequence[str] = get_args(options) or options
    if not isinstance(value, str) or value not in allowed:
        *most, last = (f'"{option}"' for option in allowed)
        text = f"{', '.join(most)} or {last}" if most else last
        raise ValueError(f"{name} must be {text}, got {shown(value)}")
    return value


def object_of(name: str, value: object, kind: type[Kind], advice: str = "") -> Kind:
    """An object of a class.

    Examples
    --------
    >>> object_of("path", 3, Path, "Path(text) makes one")
    Traceback (most recent call last):
        ...
    TypeError: path must be a Path, got 3; Path(text) makes one
    """
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AEIO" else "a"
        advice = advice and f"; {advice}"
        raise TypeError(f"{name} must be {article} {kind.__name__}, got {shown(value)}{advice}")
    return value


def function(name: str, value: object, of: str) -> Callable[..., Any]:
    """A function.

    Examples
    --------
    >>> function("project", 5, "of points (n, 3)")
    Traceback (most recent call last):
        ...
    TypeError: project must be a function of points (n, 3), got 5
    """
    if not callable(value):
        raise TypeError(f"{name} must be a function {of}, got {shown(value)}")
    return value


def check_arguments(name: str, value: object, taken: str, given: str) -> None:
    """Refuse a function that cannot be called with so many arguments; what is none is for others.

    Parameters
    ----------
    name : str
        What the message calls it.
    value : object
        Of builtins, and of wrappers that take ``*args``, nothing is known.
    taken : str
        The arguments, such as "x, t".
    given : str
        What they are.

    Examples
    --------
    >>> check_arguments("motion", lambda t: t, "p, t", "p has the points (N, 3), t is the time")
    Traceback (most recent call last):
        ...
    TypeError: motion must be a function of (p, t), got one of (t); p has the points (N, 3), t is
    the time
    """
    if not callable(value):
        return
    try:
        signature = inspect.signature(value, follow_wrapped=False)
    except (TypeError, ValueError):  # some builtins do not tell
        return
    try:
        signature.bind(*taken.split(", "))
    except TypeError:
        found = ", ".join(str(p.replace(annotation=p.empty)) for p in signature.parameters.values())
        raise TypeError(
            f"{name} must be a function of ({taken}), got one of ({found}); {given}"
        ) from None


def flag(name: str, value: object) -> bool:
    """True or False.

    Examples
    --------
    >>> flag("conserved", "no")
    Traceback (most recent call last):
        ...
    TypeError: conserved must be True or False, got 'no'
    """
    found = _entry(value)
    if not isinstance(found, bool | np.bool_):
        raise TypeError(f"{name} must be True or False, got {shown(value)}")
    return bool(found)


def string(name: str, value: object) -> str:
    """A string.

    Examples
    --------
    >>> string("title", None)
    Traceback (most recent call last):
        ...
    TypeError: title must be a string, got None
    """
    if not isinstance(value, str):
        raise TypeError(f"{name} must be a string, got {shown(value)}")
    return value


def mapping(name: str, value: object, to: str) -> Mapping[str, Any]:
    """A mapping from names.

    Examples
    --------
    >>> mapping("fields", {1: 2}, "nodal values")
    Traceback (most recent call last):
        ...
    TypeError: fields must be a mapping from names to nodal values, got {1: 2}
    """
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise TypeError(f"{name} must be a mapping from names to {to}, got {shown(value)}")
    return value


def named(name: str, row: Any) -> dict[str, Any]:
    """What a NamedTuple or a mapping says by name, such as a row of a table.

    Examples
    --------
    >>> from typing import NamedTuple
    >>> class Area(NamedTuple):
    ...     area: float
    >>> named("row", Area(2.0)), named("row", {"area": 2.0})
    ({'area': 2.0}, {'area': 2.0})
    """
    if hasattr(row, "_asdict") and not isinstance(row, type):
        row = row._asdict()
    return dict(mapping(name, row, "numbers"))


def items(name: str, values: object, kind: type[Kind], least: int = 1) -> list[Kind]:
    """Objects of one class, as a list.

    Examples
    --------
    >>> items("paths", [Path("a"), None], Path)
    Traceback (most recent call last):
        ...
    TypeError: paths[1] must be a Path, got None
    """
    plural = f"{kind.__name__}s"
    each = iterable(name, values, plural)
    found = [object_of(f"{name}[{i}]", value, kind) for i, value in enumerate(each)]
    if len(found) < least:
        fewest = f"one {kind.__name__}" if least == 1 else f"{least} {plural}"
        raise ValueError(f"{name} must hold at least {fewest}, got {len(found) or 'none'}")
    return found


def iterable(name: str, values: object, of: str) -> Iterable[Any]:
    """Something to go through, whose members are looked at as they come.

    Examples
    --------
    >>> iterable("states", 3, "States")
    Traceback (most recent call last):
        ...
    TypeError: states must be a sequence of States, got 3
    """
    if isinstance(values, str | bytes | Mapping | type) or not isinstance(values, Iterable):
        raise TypeError(f"{name} must be a sequence of {of}, got {shown(values)}")
    return values


def path_of(name: str, path: object, of: str) -> Path:
    """A path, of something that need not be there.

    Raises
    ------
    TypeError
        If it is no path.
    ValueError
        If nothing can be there: it is too long, holds a NUL, or its links lead in a circle; if one
        may not look there; or if it begins with the "~" of one's home, which only shells replace.

    Examples
    --------
    >>> path_of("folder", None, "a folder")
    Traceback (most recent call last):
        ...
    TypeError: folder must be the path of a folder, got None
    """
    text = os.fspath(path) if isinstance(path, str | os.PathLike) else None
    if not isinstance(text, str):
        raise TypeError(f"{name} must be the path of {of}, got {shown(path)}")
    try:
        os.stat(text)
    except (FileNotFoundError, NotADirectoryError):
        pass
    except (OSError, ValueError) as error:  # too long, links in a circle, a NUL
        reason = getattr(error, "strerror", None) or error
        raise ValueError(f"{name} must be the path of {of}, got {text!r}: {reason}") from None
    if text != os.path.expanduser(text):
        raise ValueError(
            f"{name} must be the path of {of}, got {text!r}: only shells replace ~ by your "
            f"home; Path({text!r}).expanduser() does it here"
        )
    return Path(text)


def output_path(name: str, path: object, suffixes: Sequence[str]) -> Path:
    """A file to be written, in a directory that exists, so that no run ends with a lost result.

    A link is followed, also to a file that is not there yet, as ``open`` does.

    Parameters
    ----------
    name : str
        What the message calls it.
    path : str or path-like
    suffixes : sequence of str
        What it may end with, such as ``(".npz",)``.

    Returns
    -------
    Path
        Absolute: a run that changes the working folder on its way goes on writing to one place.

    Raises
    ------
    TypeError
        If it is no path.
    ValueError
        If it ends otherwise, is a directory or write-protected, or is refused by :func:`path_of`.
    FileNotFoundError, NotADirectoryError
        If its directory does not exist, or is a file.
    PermissionError
        If its directory cannot be written to.

    Examples
    --------
    >>> output_path("path", "run.txt", (".npz",))
    Traceback (most recent call last):
        ...
    ValueError: path must end with ".npz", got 'run.txt'
    """
    file = path_of(name, path, "a file")
    if file.suffix.lower() not in suffixes:
        allowed = " or ".join(f'"{suffix}"' for suffix in suffixes)
        raise ValueError(f"{name} must end with {allowed}, got {str(file)!r}")
    if file.is_dir():
        raise ValueError(f"{name} must be a file, but {str(file)!r} is a directory")
    if file.exists() and not file.is_file():
        raise ValueError(f"{name} must be a file, but {str(file)!r} is a device or a pipe")
    if file.exists() and not os.access(file, os.W_OK):  # to replace it, its directory would do
        raise ValueError(
            f"{name} must be a file that can be written to, but {str(file)!r} is write-protected; "
            "choose another place, or take the protection off"
        )
    parent = Path(os.path.realpath(file)).parent if file.is_symlink() else file.parent
    if not parent.exists():
        raise FileNotFoundError(
            f"{name} must be in a directory that is there, but the directory {str(parent)!r} "
            "does not exist; make it first"
        )
    if not parent.is_dir():
        raise NotADirectoryError(f"{name} must be in a directory, but {str(parent)!r} is a file")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise PermissionError(
            f"{name} must be in a directory that can be written to, but {str(parent)!r} cannot; "
            "choose another place"
        )
    return file.absolute()


def package(need: str, module: str, extra: str) -> Any:
    """A module that only some functions need; where it is missing, how it is installed.

    Parameters
    ----------
    need : str
        What needs it, as the message begins.
    module : str
    extra : str
        The extra of this package that installs it.

    Returns
    -------
    module

    Raises
    ------
    ImportError

    Examples
    --------
    >>> package("films need Kinema", "kinema", "pictures")
    Traceback (most recent call last):
        ...
    ImportError: films need Kinema: pip install "esfem-core[pictures]"
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise ImportError(
            f'{need}: pip install "esfem-core[{extra}]"', name=module.partition(".")[0]
        ) from error


def frozen(values: Array) -> Array:
    """The array as it is, if nobody can write to it, or else a copy.

    Examples
    --------
    >>> x = np.zeros(3)
    >>> y = frozen(x)
    >>> x += 1
    >>> y.sum(), y.flags.writeable, frozen(y) is y
    (np.float64(0.0), False, True)
    """
    array = base = values
    while isinstance(base.base, np.ndarray) and not base.flags.writeable:
        base = base.base
    # Memory of another object, such as a file, may change whatever NumPy says; bytes do not.
    elsewhere = base.base is not None and not isinstance(base.base, bytes)
    if base.flags.writeable or elsewhere:
        array = array.copy()
        array.setflags(write=False)
    return array


def read_only(*held: object) -> None:
    """Nobody can write any more to arrays, nor to those in dicts and tuples.

    Examples
    --------
    >>> x, y = np.zeros(3), np.zeros(3)
    >>> read_only(x, {"a": (y, 1)})
    >>> x.flags.writeable, y.flags.writeable
    (False, False)
    """
    for value in held:
        if isinstance(value, np.ndarray):
            value.setflags(write=False)
        elif isinstance(value, dict | tuple):
            read_only(*(value.values() if isinstance(value, dict) else value))


class ReadOnly:
    """An object whose arrays are read-only, also when it was unpickled or copied.

    Pickles and copies of arrays can be written to.
    """

    def __setstate__(self, kept: dict[str, Any]) -> None:
        vars(self).update(kept)
        read_only(kept)


def real_array(name: str, values: ArrayLike, shape: Sequence[int | str]) -> Array:
    """Real numbers of a shape, as an array of floats; complex ones are refused, not cut.

    Parameters
    ----------
    name : str
        What the message calls it.
    values : array_like
    shape : sequence of int or str
        A letter stands for any length, "..." at one end for any further axes.

    Returns
    -------
    float array
        Not a copy where `values` is one already.

    Raises
    ------
    TypeError
        If they are no real numbers.
    ValueError
        If the shape is another.

    Examples
    --------
    >>> real_array("x", [[0, 0, 1]], ("N", 3))
    array([[0., 0., 1.]])
    >>> real_array("x", [1.0, 2.0], ("N", 3))
    Traceback (most recent call last):
        ...
    ValueError: x must have shape (N, 3), got (2,)
    """
    # What the steps of a run hand over needs no more than a look.
    if type(values) is np.ndarray and values.dtype == float and _fits(values.shape, shape):
        return values
    try:
        array = _array_of(name, values)
    except ValueError as error:  # rows of different lengths
        raise ValueError(
            f"{name} must have shape {_text(shape)}, but its rows have none: {error}"
        ) from None
    if array.dtype.kind == "O" and array.size:  # numbers of other libraries, such as fractions
        found = [_real(value) for value in array.flat]
        if None not in found:
            array = np.array([_as_float(v) for v in found]).reshape(array.shape)
    if array.dtype.kind not in "fiu":
        raise TypeError(
            f"{name} must hold real numbers, got {array.dtype} ({shown(values)})"
            f"{OF_CONDITION * (array.dtype == bool)}"
        )
    if not _fits(array.shape, shape):
        raise ValueError(f"{name} must have shape {_text(shape)}, got {array.shape}")
    return np.asarray(array, dtype=float)


def check_array(name: str, values: object, shape: Sequence[int | str]) -> None:
    """Refuse what is no array of real numbers of a shape, where none is converted.

    Examples
    --------
    >>> check_array("density", [[1.0]], ("T", "Q"))
    Traceback (most recent call last):
        ...
    TypeError: density must be an array of shape (T, Q), got [[1.0]]
    """
    if not isinstance(values, np.ndarray):
        raise TypeError(f"{name} must be an array of shape {_text(shape)}, got {shown(values)}")
    if values.dtype.kind not in "fiu":  # fractions are, once they are converted
        raise TypeError(
            f"{name} must hold real numbers, got {values.dtype} ({shown(values)})"
            f"{OF_CONDITION * (values.dtype == bool)}"
        )
    real_array(name, values, shape)


def check_nodes(name: str, x: object) -> None:
    """Refuse what are no positions of nodes, where none are converted.

    Examples
    --------
    >>> check_nodes("x", np.zeros((1, 5, 3)))
    Traceback (most recent call last):
        ...
    ValueError: x must have shape (N, 3), got (1, 5, 3)
    """
    check_array(name, x, ("N", 3))
    if not len(finite_array(name, x, ("N", 3))):  # type: ignore[arg-type]
        raise ValueError(f"{name} must hold at least one node, got none")


def check_string(name: str, value: object) -> None:
    """Refuse what is no string, before it is looked for in a mapping.

    Examples
    --------
    >>> check_string("name", ["u"])
    Traceback (most recent call last):
        ...
    TypeError: name must be a string, got ['u']
    """
    string(name, value)


def check_even(name: str, values: object) -> None:
    """Refuse lists in lists of different lengths, which are no array: NumPy does not say whose.

    Examples
    --------
    >>> check_even("u0", [[1.0], [1.0, 2.0]])
    Traceback (most recent call last):
        ...
    ValueError: u0 must have rows of one length, got [[1.0], [1.0, 2.0]]
    """
    try:
        _array_of(name, values)
    except ValueError:
        raise ValueError(f"{name} must have rows of one length, got {shown(values)}") from None


def finite_array(name: str, values: ArrayLike, shape: Sequence[int | str]) -> Array:
    """Like :func:`real_array`; refuses NaN and infinity as well, and says where they are.

    Examples
    --------
    >>> finite_array("x", [[0.0, np.nan, 1.0]], ("N", 3))
    Traceback (most recent call last):
        ...
    ValueError: x must be finite, but x[0, 1] is nan
    """
    array = real_array(name, values, shape)
    finite = np.isfinite(array)
    if not finite.all():
        raise ValueError(f"{name} must be finite, but {_first(name, array, ~finite)}")
    return array


def integer_array(name: str, values: ArrayLike, shape: Sequence[int | str]) -> Ints:
    """Like :func:`finite_array`, for integers; those of type float are integers, too.

    Examples
    --------
    >>> integer_array("faces", [[0.0, 1.0, 2.0]], ("T", 3))
    array([[0, 1, 2]])
    >>> integer_array("faces", [[0, 1, 0.5]], ("T", 3))
    Traceback (most recent call last):
        ...
    ValueError: faces must hold integers, but faces[0, 2] is 0.5
    """
    if type(values) is np.ndarray and values.dtype == np.int64 and _fits(values.shape, shape):
        return values.copy()
    array = finite_array(name, values, shape)
    large = np.abs(array) >= EXACT
    if large.any():
        raise ValueError(f"{name} must hold integers below 2**53, but {_first(name, array, large)}")
    integers = array.astype(np.int64)
    wrong = integers != array
    if wrong.any():
        raise ValueError(f"{name} must hold integers, but {_first(name, array, wrong)}")
    return integers


def check_node_numbers(name: str, numbers: Ints, n: int) -> None:
    """Refuse integers that are not numbers of n nodes.

    Examples
    --------
    >>> check_node_numbers("cells", np.array([[0, 1, 3]]), 3)
    Traceback (most recent call last):
        ...
    ValueError: cells must hold numbers of nodes, 0 to 2, got 0 to 3
    """
    if numbers.size and not 0 <= numbers.min() <= numbers.max() < n:
        raise ValueError(
            f"{name} must hold numbers of nodes, 0 to {n - 1}, got {numbers.min()} to "
            f"{numbers.max()}"
        )


def level_outside() -> int:
    """Which stacklevel a warning needs to show the line of the user, outside of this package.

    Such as the loop over a run: the first caller that is none of our modules.
    """
    level, frame = 1, sys._getframe(1)
    while frame.f_back and frame.f_globals.get("__name__", "").startswith("esfem_core."):
        level, frame = level + 1, frame.f_back
    return level


def _entry(value: object) -> object:
    """The one entry of an array without axes, such as files hold; any other value as it is."""
    return value[()] if isinstance(value, np.ndarray) and value.ndim == 0 else value


def _array_of(name: str, values: object) -> NDArray[Any]:
    """What NumPy makes of values, without masks, which it drops; ValueError if rows differ."""
    if _masked(values):
        raise TypeError(f"{name} must hold real numbers, got a masked array: its holes have none")
    try:
        return np.asarray(values)
    except (TypeError, RuntimeError) as error:  # those of other libraries may not be copied
        raise TypeError(f"{name} must hold real numbers, got {shown(values)}: {error}") from error


def _masked(values: object, axes: int = 64) -> bool:
    """Whether values are a masked array, or lists that hold one; arrays have at most 64 axes."""
    if isinstance(values, list | tuple):
        return axes > 0 and any(_masked(v, axes - 1) for v in values if type(v) is not float)
    return isinstance(values, np.ma.MaskedArray)


def _as_float(value: object) -> float:
    found = _real(value)
    try:
        return math.nan if found is None else float(found)
    except OverflowError:
        return math.inf


def _first(name: str, array: Array, bad: Bools) -> str:
    index = tuple(np.argwhere(bad)[0].tolist())
    where = f"[{', '.join(map(str, index))}]" if index else ""
    return f"{name}{where} is {array[index]}"


def _fits(found: Sequence[int], shape: Sequence[int | str]) -> bool:
    if found == shape or shape == ("...",):
        return True
    if "..." in shape:
        if len(found) < len(shape) - 1:
            return False
        if shape[0] == "...":
            shape, found = shape[1:], found[len(found) - len(shape) + 1 :]
        else:
            shape, found = shape[:-1], found[: len(shape) - 1]
    return len(found) == len(shape) and all(
        isinstance(n, str) or n == m for n, m in zip(shape, found, strict=True)
    )


def _text(shape: Sequence[int | str]) -> str:
    return f"({', '.join(map(str, shape))}{',' if len(shape) == 1 else ''})"
