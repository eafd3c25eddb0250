"""A long run of generated arguments: `make fuzz` writes book/assets/fuzz.csv.

A case is a function of ``door_table.py`` and one of its arguments, which gets a wrong kind,
another spelling of the right value, or anything that hypothesis makes up. What comes out is right,
refused with a message that helps, or anything else; the last must not be.
"""

import argparse
import csv
import signal
import sys
import warnings
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from door_table import doors
from doors import Door, equal, helpful, may, same, wrong
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

TABLE = Path(__file__).parents[1] / "book" / "assets" / "fuzz.csv"
COSTLY = {  # integer-like floats could ask for millions of vertices, or for days
    "from_level_set",
    "sphere",
    "bisected_sphere",
    "defects",
    "animate",
    "plot",
    "time_study",
}  # nothing made up
SECONDS = 20  # of a processor
HEAD = ["function", "tried", "right", "refused with a helpful message", "anything else"]


class Case(NamedTuple):
    """One call: which function, which argument, what it gets, and what that is."""

    door: Door
    key: str
    value: Any
    shown: str
    kind: str  # wrong, equal, made up


NUMBERS = st.one_of(
    st.floats(0.05, 20), st.floats(-20, -0.05), st.sampled_from([0.0, float("nan"), float("inf")])
)
WHOLE = st.one_of(st.integers(-3, 5), st.integers(10**12), st.integers(None, -(10**6)))
KINDS = [np.float64, np.float32, np.int64, np.complex128, np.bool_, "U3"]


def _made_up(family: str) -> st.SearchStrategy[Any]:
    shapes = arrays.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4)
    some = st.sampled_from(KINDS).flatmap(lambda kind: arrays.arrays(kind, shapes))
    if family == "whole":
        return st.one_of(WHOLE, NUMBERS, st.text(max_size=3))
    if family == "number":
        return st.one_of(
            NUMBERS,
            st.integers(-5, 5),
            st.fractions(-5, 5, max_denominator=16),
            st.complex_numbers(),
        )
    return st.one_of(some, st.lists(st.floats(), max_size=3))


@cache
def _table() -> list[tuple[Door, str, str, list[tuple[str, Any]]]]:
    """Functions, arguments, kinds of cases and their values."""
    rows = []
    for door in doors():
        for key, argument in door.arguments.items():
            rows.append((door, key, "wrong", wrong(argument)))
            rows.append((door, key, "equal", equal(argument)))
            if argument.family in ("number", "whole", "array") and door.name not in COSTLY:
                rows.append((door, key, "made up", []))
    return [row for row in rows if row[3] or row[2] == "made up"]


@st.composite
def cases(draw: Any) -> Case:
    """Draw a case."""
    door, key, kind, values = draw(st.sampled_from(_table()))
    if kind == "made up":
        value = draw(_made_up(door.arguments[key].family))
        return Case(door, key, value, repr(value), kind)
    shown, value = draw(st.sampled_from(values))
    return Case(door, key, value, shown, kind)


def outcome(case: Case) -> tuple[str, str]:
    """What comes out, "right", "refused" or "else", and how to tell a person."""
    door, key, argument = case.door, case.key, case.door.arguments[case.key]
    text = f"{door.name}: {key} = {case.shown[:80]}"
    try:
        signal.setitimer(signal.ITIMER_PROF, SECONDS)  # a case without end is named, and counted
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            result = door.function(**{**_good(door), key: case.value})
    except Exception as error:  # whatever it is, it is looked at
        if case.kind != "equal" and helpful(error, key, argument):
            return "refused", text
        return "else", f"{text}: {type(error).__name__}: {error}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        if (pyplot := sys.modules.get("matplotlib.pyplot")) is not None:
            pyplot.close("all")
    right = {
        "wrong": False,
        "equal": case.kind != "equal" or same(result, _wanted(door.name, key)),
        "made up": may(argument, case.value),
    }[case.kind]
    return ("right", text) if right else ("else", f"{text}: accepted")


def _good(door: Door) -> dict[str, Any]:
    return {key: a.good for key, a in door.arguments.items() if not a.optional}


@cache
def _wanted(name: str, key: str) -> Any:
    door = next(d for d in doors() if d.name == name)
    return door.function(**{**_good(door), key: door.arguments[key].good})


def _stop(*_: object) -> None:
    raise RuntimeError(f"not finished after {SECONDS} s")


signal.signal(signal.SIGPROF, _stop)


def run(n_cases: int, first: int) -> tuple[Counter[tuple[str, str]], list[str]]:
    """Try that many cases; how often what came out, by function, and what else came."""
    counts: Counter[tuple[str, str]] = Counter()
    strange: list[str] = []

    @seed(first)
    @settings(
        max_examples=n_cases,
        deadline=None,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(cases())
    def attack(case: Case) -> None:
        kind, text = outcome(case)
        counts[case.door.name, kind] += 1
        if kind == "else":
            strange.append(text)

    attack()
    return counts, strange


def main() -> None:
    """Run, write the table, and fail if anything else came out."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    given_arguments = parser.parse_args()
    if given_arguments.cases < 1:
        parser.error("--cases must be 1 or more")
    matplotlib.use("agg")
    counts: Counter[tuple[str, str]] = Counter()
    strange: list[str] = []
    part = 0
    while counts.total() < given_arguments.cases:
        more, texts = run(2000, given_arguments.seed + part)
        counts, strange, part = counts + more, strange + texts, part + 1
        print(*texts, f"{counts.total()} cases, {len(strange)} strange", sep="\n", flush=True)
    kinds = ("right", "refused", "else")
    rows = [
        [name, sum(counts[name, k] for k in kinds), *(counts[name, k] for k in kinds)]
        for name in sorted({name for name, _ in counts}, key=lambda name: (name.lower(), name))
    ]
    totals = ["all", *(sum(row[i] for row in rows) for i in range(1, 5))]
    with TABLE.open("w", encoding="utf8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([HEAD, *rows, totals])
    for row in [*rows, totals]:
        print(f"{row[0]:30} {row[1]:7} {row[2]:7} {row[3]:7} {row[4]:7}")
    sys.exit(bool(strange))


if __name__ == "__main__":
    main()
