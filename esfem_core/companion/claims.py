"""Claims of a paper, the numbers that test them, and the verdict that follows.

A notebook measures something, says what the paper lets one expect, and ends the cell with `claim`.
A claim that fails as printed says how it fails; the measurements have to bear that out in the
build of the book, and a reader whose parameters they belong to is told that they do not. The
verdict is computed here and nowhere else; the companion book's ledger recomputes it from the same
numbers.
"""

from __future__ import annotations

import html
import json
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

from esfem_core.checks import iterable, number, one_of, shown, string
from esfem_core.companion.checking import STRICT
from esfem_core.tables import html_table

__all__ = [
    "CONFIRMED",
    "DIFFERS",
    "PROOF_ONLY",
    "SIGNS",
    "Claim",
    "Kind",
    "Measurement",
    "accepted",
    "anchor",
    "claim",
    "measure",
    "measure_order",
    "read_html",
]

Kind = Literal["contradicted", "not reproduced", "restricted", "misprint"]
"""How a claim fails as printed.

A "misprint" holds with the formula corrected. A "restricted" claim holds with a hypothesis, norm,
constant or regime that the text lacks. A "contradicted" one has a counterexample. What is "not
reproduced" was observed by the paper and is measured otherwise here.
"""

CONFIRMED = "confirmed"
PROOF_ONLY = "proof only"
DIFFERS = "differs from the book"
"""Said of a claim that a reader's parameters do not bear out; no verdict of the ledger."""

SIGNS = {
    "contradicted": "✗",
    "not reproduced": "≠",
    "restricted": "⊂",
    "misprint": "≈",
    CONFIRMED: "✓",
    PROOF_ONLY: "∎",
}
"""The verdicts, worst news first, each with a sign, so that none depends on colour alone."""

#: What the second group of measurements is called in a box.
_SECOND = {
    "contradicted": "instead",
    "not reproduced": "here",
    "restricted": "restricted",
    "misprint": "corrected",
}
_ID = re.compile(r"[A-Z]+-[A-Z]?\d+(\.\d+)*(-[a-z][a-z0-9]*)+")
_ACCEPTED = Path(__file__).parent / "data" / "verdicts.json"


@dataclass(frozen=True)
class Measurement:
    """A measured number and the bounds it has to keep; made by `measure`."""

    name: str
    value: float
    at_least: float | None = None
    at_most: float | None = None
    equals: float | None = None
    tol: float = 0.0

    @property
    def holds(self) -> bool:
        """Whether the value is finite and keeps every bound."""
        if not math.isfinite(self.value):
            return False
        return (
            (self.at_least is None or self.value >= self.at_least)
            and (self.at_most is None or self.value <= self.at_most)
            and (self.equals is None or abs(self.value - self.equals) <= self.tol)
        )

    @property
    def expected(self) -> str:
        """The bounds in words.

        Examples
        --------
        >>> measure("rate", 2.97, at_least=2.8, at_most=3.2).expected
        '≥ 2.8 and ≤ 3.2'
        """
        parts = []
        if self.at_least is not None:
            parts.append(f"≥ {self.at_least:.4g}")
        if self.at_most is not None:
            parts.append(f"≤ {self.at_most:.4g}")
        if self.equals is not None:
            parts.append(f"= {self.equals:.10g}" + (f" ± {self.tol:.1g}" if self.tol else ""))
        return " and ".join(parts)

    def __str__(self) -> str:
        """The number, its bounds, and whether it keeps them.

        Examples
        --------
        >>> print(measure("rate", 2.97, at_least=2.8))
        rate = 2.97 (≥ 2.8) ✓
        """
        return f"{self.name} = {self.value:.4g} ({self.expected}) {'✓' if self.holds else '✗'}"


@dataclass(frozen=True, repr=False)
class Claim:
    """A claim with the measurements that test it; made by `claim`.

    In a notebook it shows itself as a small box, whose HTML carries the data for `read_html`.

    Attributes
    ----------
    id : str
    as_printed, corrected : tuple of Measurement
    kind : str or None
        How it fails as printed.
    note : str
    """

    id: str
    as_printed: tuple[Measurement, ...]
    corrected: tuple[Measurement, ...] = ()
    kind: Kind | None = None
    note: str = ""

    @property
    def verdict(self) -> str:
        """`CONFIRMED` if all measurements of the printed form hold, else the kind of failure.

        `DIFFERS` if the measurements do not bear out either.
        """
        if _fault(self):
            return DIFFERS
        return CONFIRMED if self.kind is None else self.kind

    def to_dict(self) -> dict[str, Any]:
        """Return the measurements and the kind as plain JSON data.

        Values that JSON cannot hold (NaN, infinity) become strings.

        Examples
        --------
        >>> nan = measure("error", float("nan"), at_most=1e-15)
        >>> c = claim("N-2.11-accuracy", nan, kind="contradicted", note="no number")
        >>> c.to_dict()["as_printed"][0]["value"]
        'nan'
        >>> Claim.from_dict(c.to_dict()).verdict
        'contradicted'
        """
        data = asdict(self)
        for m in (*data["as_printed"], *data["corrected"]):
            if not math.isfinite(m["value"]):
                m["value"] = str(m["value"])
        return data

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Claim:
        """Read back what `to_dict` wrote, with the same checks as `measure` and `claim`."""
        as_printed, corrected = (
            tuple(measure(**m) for m in data[group]) for group in ("as_printed", "corrected")
        )
        return _checked(cls(data["id"], as_printed, corrected, data["kind"], data["note"]))

    def lines(self) -> list[tuple[str, Measurement]]:
        """All measurements, each with the form of the claim that it is about."""
        printed = [("as printed", m) for m in self.as_printed]
        second = _SECOND[self.kind] if self.kind else "corrected"
        return printed + [(second, m) for m in self.corrected]

    def __repr__(self) -> str:
        lines = [f"{_sign(self.verdict)} {self.id}: {self.verdict}"]
        lines += [f"  {form}: {m}" for form, m in self.lines()]
        return "\n".join([*lines, f"  {self.note}"] if self.note else lines)

    def _repr_html_(self) -> str:
        verdict = self.verdict.replace(" ", "-")
        rows = (
            [m.name, form, f"{m.value:.4g}", m.expected, "✓ holds" if m.holds else "✗ fails"]
            for form, m in self.lines()
        )
        table = html_table(["measured", "form", "value", "must be", "result"], rows).text
        note = f"<p>{html.escape(self.note)}</p>" if self.note else ""
        return (
            f'<div class="esfem-claim esfem-{verdict}" id="check-{html.escape(anchor(self.id))}" '
            f'data-claim="{html.escape(json.dumps(self.to_dict()))}">'
            f'<p><span class="esfem-verdict">{_sign(self.verdict)} {self.verdict}</span> '
            f'claim <a href="ledger.html#claim-{html.escape(anchor(self.id))}">'
            f"{html.escape(self.id)}</a></p>"
            f"{table}{note}</div>"
        )


def _sign(verdict: str) -> str:
    return SIGNS.get(verdict, "?")


def anchor(id: str) -> str:
    """Return the part of an HTML anchor that stands for a claim.

    Examples
    --------
    >>> anchor("N-2.22-delta")
    'N-2_22-delta'
    """
    return id.replace(".", "_")  # dots end an id in CSS selectors, which scripts make of links


def measure(
    name: str,
    value: float | str,
    at_least: float | None = None,
    at_most: float | None = None,
    equals: float | None = None,
    tol: float | None = None,
) -> Measurement:
    """Put a measured number beside the bounds that it must keep.

    Parameters
    ----------
    name : str
        What was measured, in a few words.
    value : float or str
        The number. NaN and infinity are accepted and never hold.
    at_least, at_most : float, optional
        Bounds; the interval is closed.
    equals, tol : float, optional
        A target and the largest absolute distance allowed from it (0 if not given).

    Raises
    ------
    TypeError, ValueError
        If the value is no number, there is no bound, a bound is no finite number, the bounds
        exclude each other, or `tol` is negative or comes without `equals`.

    Examples
    --------
    >>> measure("rate of the position error", 2.97, at_least=2.8).holds
    True
    >>> measure("number of coefficients", 3, equals=4).holds
    False
    >>> measure("error", float("nan"), at_most=1).holds
    False
    """
    if not string("name", name).strip():
        raise ValueError("a measurement needs a name")
    if at_least is None and at_most is None and equals is None:
        raise ValueError(f"{name!r}: say what is expected with at_least, at_most or equals")
    given = {"at_least": at_least, "at_most": at_most, "equals": equals}
    low, high, target = (
        None if bound is None else number(f"{key} of {name!r}", bound)
        for key, bound in given.items()
    )
    distance = 0.0 if tol is None else number(f"tol of {name!r}", tol, least=0)
    if low is not None and high is not None and low > high:
        raise ValueError(f"{name!r}: no number is at least {low} and at most {high}")
    if target is None and distance > 0:
        raise ValueError(f"{name!r}: tol is the distance allowed from equals, which is missing")
    return Measurement(name, _value(name, value), low, high, target, distance)


def _value(name: str, value: object) -> float:
    """A number of any library, or what JSON has in place of those that are not finite."""
    if isinstance(value, str) and value not in ("nan", "inf", "-inf"):
        raise TypeError(f"the value of {name!r} must be a number, got {shown(value)}")
    try:
        return float(value)  # type: ignore[arg-type]
    except OverflowError:
        return math.inf
    except (TypeError, ValueError):
        raise TypeError(f"the value of {name!r} must be a number, got {shown(value)}") from None


def measure_order(
    name: str, observed: float, order: float, below: float = 0.25, above: float | None = None
) -> Measurement:
    """Put an observed order of convergence beside one that is claimed as observed: two bounds.

    "The error falls like the square of h" says that it does not fall faster, either; "the error is
    O(h^2)" does not, and is a case for `measure` with ``at_least``.

    Parameters
    ----------
    name : str
        What was measured.
    observed, order : float
        The measured order, and the claimed one.
    below, above : float
        How far it may stay below and go beyond; `above` is `below` if not given.

    Returns
    -------
    Measurement

    Raises
    ------
    TypeError, ValueError
        As by `measure`, and if `below` or `above` is negative.

    Examples
    --------
    >>> measure_order("order of u", 2.9, 3).holds, measure_order("order of u", 3.9, 3).holds
    (True, False)
    >>> measure_order("order of u", 3.4, 3, below=0.25, above=0.5).expected
    '≥ 2.75 and ≤ 3.5'
    """
    below = number(f"below of {name!r}", below, least=0)
    above = below if above is None else number(f"above of {name!r}", above, least=0)
    target = number(f"order of {name!r}", order)
    return measure(name, observed, at_least=target - below, at_most=target + above)


def claim(
    id: str,
    *as_printed: Measurement,
    corrected: Sequence[Measurement] = (),
    kind: Kind | None = None,
    note: str = "",
) -> Claim:
    """State a claim of a paper together with the measurements that decide it.

    Parameters
    ----------
    id : str
        Its row in the ledger, ``<paper>-<number>-<word>``, such as ``"N-2.22-delta"``.
    *as_printed : Measurement
        Measurements of the statement exactly as printed; at least one.
    corrected : sequence of Measurement
        Where the printed statement fails: measurements of what holds in its place.
    kind : {"contradicted", "not reproduced", "restricted", "misprint"}, optional
        How the statement fails as printed. None claims that it holds.
    note : str
        A sentence on how the two differ, or on the range of what was measured.

    Returns
    -------
    Claim
        Its verdict is "confirmed" if all of `as_printed` hold, and otherwise its kind. Where the
        measurements do not bear that out, it is `DIFFERS`, and a line is printed.

    Raises
    ------
    AssertionError
        If the environment variable ESFEM_STRICT is set, as in the build of the book and its tests:
        the measurements do not bear out the verdict (one of `as_printed` fails and there is no
        `kind`; all of them hold and there is one; one of `corrected` fails), or the verdict is not
        the one that `accepted` has. A reader, who may have changed a parameter, is told.
    TypeError, ValueError
        If the id is malformed, a measurement is missing or none, the kind is unknown, a misprint or
        a restricted claim has no `corrected`, or a claim of the other two kinds has neither
        `corrected` nor a note.

    Examples
    --------
    >>> claim("N-2.22-delta", measure("largest difference", 1e-16, at_most=1e-15))
    ✓ N-2.22-delta: confirmed
      as printed: largest difference = 1e-16 (≤ 1e-15) ✓
    >>> printed, other = measure("order", 0, at_least=3), measure("order", 3, at_least=3)
    >>> claim("N-2.18-extrapolation", printed, corrected=[other], kind="misprint").verdict
    'misprint'
    """
    others = tuple(iterable("corrected", corrected, "measurements"))
    found = _well_formed(Claim(id, as_printed, others, kind, note))
    in_the_book = accepted().get(id)
    if fault := _fault(found):
        text = f"claim {id} {fault}"
    elif found.verdict != in_the_book:
        text = f"claim {id}: {found.verdict} here, {in_the_book or 'unknown'} in the book"
    else:
        return found
    if os.environ.get(STRICT):
        raise AssertionError("\n".join([f"{text}:", *_measured(found)]))
    if fault and in_the_book:  # a reader's parameters; a claim that the book lacks is its author's
        text = (
            f'differs from the book: claim {id} is "{in_the_book}" there, '
            "which the numbers measured here do not bear out"
        )
    print(text)
    return found


def _checked(found: Claim) -> Claim:
    """The claim, if it is well formed and its measurements bear out its verdict."""
    if fault := _fault(_well_formed(found)):
        raise AssertionError("\n".join([f"claim {found.id} {fault}:", *_measured(found)]))
    return found


def _well_formed(found: Claim) -> Claim:
    name = string("id", found.id)
    string("note", found.note)
    if not _ID.fullmatch(name):
        raise ValueError(
            f"{name!r} is not a claim id: write <paper>-<number>-<word>, such as 'N-2.22-delta'"
        )
    if not found.as_printed:
        raise ValueError(
            f"claim {name}: at least one measurement of the statement as printed is needed"
        )
    for m in (*found.as_printed, *found.corrected):
        if not isinstance(m, Measurement):
            raise ValueError(f"claim {name}: expected measure(...), got {m!r}")
    if found.kind is not None:
        one_of(f"kind of claim {name}", found.kind, Kind)
        if not found.corrected and found.kind in ("misprint", "restricted"):
            raise ValueError(f"claim {name}: measure what holds instead: corrected=[...]")
        if not found.corrected and not found.note:
            raise ValueError(f"claim {name}: say what holds instead, in corrected=[...] or a note")
    return found


def _fault(found: Claim) -> str:
    """How the measurements contradict the verdict; empty if they do not."""
    holds = all(m.holds for m in found.as_printed)
    if not holds and found.kind is None:
        return "fails as printed and does not say its kind"
    if holds and (found.kind or found.corrected):
        return "holds as printed, and has nothing to correct"
    if not all(m.holds for m in found.corrected):
        return "fails in its corrected form"
    return ""


def _measured(found: Claim) -> list[str]:
    return [f"  {m}" for m in (*found.as_printed, *found.corrected)]


@cache
def accepted() -> dict[str, str]:
    """The verdict on each claim that the book has, by id, in the order of the ledger.

    A verdict that changes is a finding or a fault, and should be looked at before it is accepted.

    Examples
    --------
    >>> accepted()["N-2.22-delta"]
    'confirmed'
    """
    found: dict[str, str] = json.loads(_ACCEPTED.read_text("utf8"))
    return found


def read_html(text: str) -> Iterator[Claim]:
    """Yield the claims in a piece of HTML, read from their measurements.

    Examples
    --------
    >>> c = claim("N-2.22-delta", measure("difference < 1", 1e-16, at_most=1e-15))
    >>> list(read_html(f"<p>{c._repr_html_()}</p>")) == [c]
    True
    """
    for data in re.findall(r'data-claim="([^"]*)"', text):
        yield Claim.from_dict(json.loads(html.unescape(data)))
