"""Claims of a paper, the numbers that test them, and the verdict that follows.

A notebook measures something, says what the paper lets one expect, and ends the cell with `claim`.
The verdict is computed from the measurements here and nowhere else; the companion book's ledger
recomputes it from the same numbers.
"""

from __future__ import annotations

import html
import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from esfem_core.checks import number

__all__ = [
    "CONFIRMED",
    "CORRECTED",
    "NOT_CONFIRMED",
    "SIGNS",
    "Claim",
    "Measurement",
    "anchor",
    "claim",
    "measure",
    "read_html",
]

CONFIRMED = "confirmed"
CORRECTED = "confirmed with a correction"
NOT_CONFIRMED = "not confirmed"

_ID = re.compile(r"[A-Z]+-[A-Z]?\d+(\.\d+)*(-[a-z][a-z0-9]*)+")
#: A sign for each verdict, so that none depends on colour alone.
SIGNS = {CONFIRMED: "✓", CORRECTED: "≈", NOT_CONFIRMED: "✗"}


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


@dataclass(frozen=True, repr=False)
class Claim:
    """A claim with the measurements that test it; made by `claim`.

    In a notebook it shows itself as a small box, whose HTML carries the data for `read_html`.
    """

    id: str
    as_printed: tuple[Measurement, ...]
    corrected: tuple[Measurement, ...] = ()
    note: str = ""

    @property
    def verdict(self) -> str:
        """`CONFIRMED`, `CORRECTED` or `NOT_CONFIRMED`, computed from the measurements."""
        if all(m.holds for m in self.as_printed):
            return CONFIRMED
        if self.corrected and all(m.holds for m in self.corrected):
            return CORRECTED
        return NOT_CONFIRMED

    def to_dict(self) -> dict[str, Any]:
        """Return the measurements, without a verdict, as plain JSON data.

        Values that JSON cannot hold (NaN, infinity) become strings.

        Examples
        --------
        >>> c = claim("N-2.22-delta", measure("error", float("nan"), at_most=1e-15))
        >>> c.to_dict()["as_printed"][0]["value"]
        'nan'
        >>> Claim.from_dict(c.to_dict()).verdict
        'not confirmed'
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
            [measure(**m) for m in data[group]] for group in ("as_printed", "corrected")
        )
        return claim(data["id"], *as_printed, corrected=corrected, note=data["note"])

    def _lines(self) -> list[tuple[str, Measurement]]:
        printed = [("as printed", m) for m in self.as_printed]
        return printed + [("corrected", m) for m in self.corrected]

    def __repr__(self) -> str:
        lines = [f"{SIGNS[self.verdict]} {self.id}: {self.verdict}"]
        lines += [
            f"  {form}: {m.name} = {m.value:.4g} ({m.expected}) {'✓' if m.holds else '✗'}"
            for form, m in self._lines()
        ]
        return "\n".join([*lines, f"  {self.note}"] if self.note else lines)

    def _repr_html_(self) -> str:
        kind = self.verdict.replace(" ", "-")
        rows = "".join(
            f"<tr><td>{html.escape(m.name)}</td><td>{form}</td><td>{m.value:.4g}</td>"
            f"<td>{html.escape(m.expected)}</td><td>{'✓ holds' if m.holds else '✗ fails'}</td></tr>"
            for form, m in self._lines()
        )
        note = f"<p>{html.escape(self.note)}</p>" if self.note else ""
        return (
            f'<div class="esfem-claim esfem-{kind}" id="check-{anchor(self.id)}" '
            f'data-claim="{html.escape(json.dumps(self.to_dict()))}">'
            f'<p><span class="esfem-verdict">{SIGNS[self.verdict]} {self.verdict}</span> '
            f'claim <a href="ledger.html#claim-{anchor(self.id)}">{self.id}</a></p>'
            '<div class="esfem-table"><table><thead><tr>'
            "<th>measured</th><th>form</th><th>value</th><th>must be</th><th>result</th>"
            f"</tr></thead><tbody>{rows}</tbody></table></div>{note}</div>"
        )


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
    name
        What was measured, in a few words.
    value
        The number. NaN and infinity are accepted and never hold.
    at_least, at_most
        Bounds; the interval is closed.
    equals, tol
        A target and the largest absolute distance allowed from it (0 if not given).

    Raises
    ------
    TypeError, ValueError
        If there is no bound, a bound is no finite number, the bounds exclude each other, or `tol`
        is negative or comes without `equals`.

    Examples
    --------
    >>> measure("rate of the position error", 2.97, at_least=2.8).holds
    True
    >>> measure("number of coefficients", 3, equals=4).holds
    False
    >>> measure("error", float("nan"), at_most=1).holds
    False
    """
    if not name.strip():
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
    return Measurement(name, float(value), low, high, target, distance)


def claim(
    id: str, *as_printed: Measurement, corrected: Sequence[Measurement] = (), note: str = ""
) -> Claim:
    """State a claim of a paper together with the measurements that decide it.

    Parameters
    ----------
    id
        Its row in the ledger, ``<paper>-<number>-<word>``, such as ``"N-2.22-delta"``.
    *as_printed
        Measurements of the statement exactly as printed; at least one.
    corrected
        Measurements of the corrected statement, where the printed one fails.
    note
        A sentence on how the two differ or on the range of what was measured.

    Returns
    -------
    Claim
        Its verdict is "confirmed" if all of `as_printed` hold, "confirmed with a correction" if
        they do not but all of `corrected` (at least one) do, and "not confirmed" otherwise.

    Raises
    ------
    ValueError
        If the id is malformed or there is no measurement.

    Examples
    --------
    >>> claim("N-2.22-delta", measure("largest difference", 1e-16, at_most=1e-15))
    ✓ N-2.22-delta: confirmed
      as printed: largest difference = 1e-16 (≤ 1e-15) ✓
    >>> printed, corrected = measure("order", 0, at_least=3), measure("order", 3, at_least=3)
    >>> claim("N-2.18-order", printed, corrected=[corrected], note="other way round").verdict
    'confirmed with a correction'
    """
    if not _ID.fullmatch(id):
        raise ValueError(
            f"{id!r} is not a claim id: write <paper>-<number>-<word>, such as 'N-2.22-delta'"
        )
    if not as_printed:
        raise ValueError(
            f"claim {id}: at least one measurement of the statement as printed is needed"
        )
    for m in (*as_printed, *corrected):
        if not isinstance(m, Measurement):
            raise ValueError(f"claim {id}: expected measure(...), got {m!r}")
    return Claim(id, as_printed, tuple(corrected), note)


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
