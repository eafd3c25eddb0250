"""Times of the steps, the same however often a run is interrupted."""

import math
from collections.abc import Iterator
from fractions import Fraction

from esfem_core.checks import number

__all__ = ["check_told_apart", "count_steps", "following", "later", "same_time"]

LARGEST = 10**6  # denominators up to here tell apart all fractions that a double can mean
NEAR = 1000  # below it two such fractions, at least 1e-12 apart, are never rounded to one double
TOLERANCE = 1e-9
SHORTEST = 1e-140  # products of two shorter steps leave the range of numbers
APART = 1e-3  # of a step, what the rounding of the times may take from it
ROUNDING = 1e-12  # of a time, after many steps; what differs by more is not the same


def later(t: float, step: float) -> float:
    """The time a step after t, rounded once from the fractions that both numbers stand for.

    0.1 means 1/10: so times are the nearest numbers to n/10 from wherever one counts, and a run
    that goes on from a state in the middle sees the same times as one in one go.

    Examples
    --------
    >>> 0.1 + 0.1 + 0.1, later(later(0.1, 0.1), 0.1)
    (0.30000000000000004, 0.3)
    """
    tau = _meant(step)
    return float(_meant(t, tau.denominator) + tau)


def following(t: float, step: float) -> Iterator[float]:
    """The times after t: ``later(t, step)``, the one later than that, and so on.

    Examples
    --------
    >>> from itertools import islice
    >>> list(islice(following(0.1, 0.1), 3))
    [0.2, 0.3, 0.4]
    """
    tau = _meant(step)
    exact = _meant(t, tau.denominator)
    while True:
        exact += tau
        t = float(exact)
        yield t
        if exact.denominator > LARGEST or abs(t) > NEAR:  # else that is what t means
            exact = _meant(t, tau.denominator)


def _meant(value: float, unit: int | None = None) -> Fraction:
    """The fraction that a number stands for: a multiple of 1/unit if it can be, or a simple one.

    Far from zero, where rounding is coarse, many simple ones round to a number, and the nearest is
    the number itself: sums with it would be rounded the same way again and again, and drift.
    """
    if unit is not None and unit <= LARGEST:
        multiple = Fraction(round(Fraction(value) * unit), unit)
        if float(multiple) == value:
            return multiple
    # Fractions with denominators up to n are 1/n^2 apart; at most one must round to the number.
    most = math.isqrt(int(1 / math.ulp(max(1.0, abs(value)))))
    simple = Fraction(value).limit_denominator(max(1, min(LARGEST, most)))
    return simple if float(simple) == value else Fraction(value)


def same_time(t: float, other: float) -> bool:
    """Whether two times differ by the rounding of the steps that lead to them at most.

    However small they are: a step of 1e-10 is as good as one of 1.

    Examples
    --------
    >>> same_time(0.1 + 0.1 + 0.1, 0.3), same_time(2e-10, 3e-10)
    (True, False)
    """
    return abs(t - other) <= ROUNDING * max(abs(t), abs(other))


def check_told_apart(t: float, step: float) -> None:
    """Refuse steps that are lost in the rounding of the times, or below 1e-140.

    Examples
    --------
    >>> check_told_apart(1.7e9, 1e-3)
    >>> check_told_apart(1.7e9, 1e-7)
    Traceback (most recent call last):
        ...
    ValueError: step must be larger against the time, t = 1.7e+09, got 1e-07: the times of such
    steps are not told apart; count time from near the start of the run
    """
    if step < SHORTEST:
        raise ValueError(
            f"step must be at least {SHORTEST:g}, got {step:g}: measure time in another unit"
        )
    if abs(t - later(t, -step) - step) > APART * step:
        raise ValueError(
            f"step must be larger against the time, t = {t:g}, got {step:g}: the times of such "
            "steps are not told apart; count time from near the start of the run"
        )


def count_steps(start: float, step: float, end: float) -> int:
    """Number of steps from start to end.

    Raises
    ------
    ValueError, TypeError
        If a number is not finite, the step is not positive, the end before the start, the number of
        steps not an integer to a relative 1e-9 and the rounding of the times, or the step lost in
        that.

    Examples
    --------
    >>> count_steps(0.0, 1 / 40, 1.0)
    40
    """
    step, end = number("step", step, above=0), number("end", end)
    quotient = (end - start) / step
    if not quotient < 2.0**53:
        raise ValueError(
            f"step must be larger: end/step is {quotient:.3g}, too many steps, got {step!r}"
        )
    n_steps = round(quotient)
    if n_steps < 0:
        raise ValueError(f"end must not be before the start at t = {start!r}, got {end!r}")
    check_told_apart(start, step)
    check_told_apart(end, step)
    nothing = n_steps == 0 and not same_time(start, end)
    rounded = math.ulp(max(abs(start), abs(end))) / step
    if nothing or abs(quotient - n_steps) > TOLERANCE * max(1, n_steps) + rounded:
        between = f"({end!r} - {start!r})/{step!r}" if start else f"{end!r}/{step!r}"
        raise ValueError(f"end/step must be an integer, got {between} = {quotient!r}")
    return n_steps
