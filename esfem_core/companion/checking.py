"""What a chapter states beside its claims: the book's build insists on it, a reader is told."""

import os
from collections.abc import Iterator

from esfem_core.checks import shown, string

__all__ = ["STRICT", "expect"]

STRICT = "ESFEM_STRICT"  # environment variable, set by the build of the book and by its tests


def expect(holds: object, statement: str) -> None:
    """Check a statement of the text, which holds for the numbers that the book was written with.

    A reader may change a degree or a step: then the statement may fail, and the chapter goes on.

    Parameters
    ----------
    holds : bool
        Whether it holds; also of NumPy, and no array of more than one element.
    statement : str
        In words, as it should be.

    Raises
    ------
    AssertionError
        If it does not hold and the environment variable ESFEM_STRICT is set.
    TypeError
        If `holds` is a function or an iterator, which are true whatever they say, or `statement` no
        string.
    ValueError
        If `holds` is an array of more than one element.

    Examples
    --------
    >>> expect(1 + 1 == 2, "one and one are two")

    What does not hold is printed as: differs from the book: "one and one are three" does not hold
    here.
    """
    string("statement", statement)
    if callable(holds) or isinstance(holds, Iterator):
        raise TypeError(f"holds must be a truth value, got {shown(holds)}")
    if getattr(holds, "size", 1) != 1:
        raise ValueError(f"holds must be one truth value, got {shown(holds)}")
    if holds:
        return
    if os.environ.get(STRICT):
        raise AssertionError(statement)
    print(f'differs from the book: "{statement}" does not hold here')
