"""Compare the numbers that two builds of the book print.

``python tests/same_digits.py one/html two/html`` reads the measured values of all claims, which the
pages carry in full precision, and the numbers in the printed outputs. They agree if they differ by
no more than 1e-9 of the larger one or of 1 (an error is a difference of solutions of this size),
and printed ones by a unit of their last digit more.

Observed orders of convergence, known by the word "order" in the name of a measurement, agree if
they do so to 1e-6. Where an error e changes by d, its order log(e'/e)/log 2 changes by d/(e log 2).
In chapter 1 the sides of Green's formula differ by 3e-8: a single rounding of one of them, 9e-16,
is 5e-8 in the order, although this error itself agrees far better than to 1e-9. On coarser meshes,
whose errors are large enough to give the order to 1e-9, it is not yet what it tends to, 6.3 and not
6. A claim shows four digits of an order, which is a thousand times coarser than 1e-6.

Times differ: the pages that are about them, columns that are headed "run time", and lines in which
a number has a unit of time or something is "times as long".
"""

import math
import re
import sys
from collections.abc import Iterator
from pathlib import Path

from bs4 import BeautifulSoup, Tag

from esfem_core.companion.claims import read_html

TOLERANCE, OF_ORDERS = 1e-9, 1e-6
TIMED = {"performance", "status"}
NUMBER = re.compile(r"(?<![\w.])[-−]?\d+(?:,\d{3})*(?:\.\d+)?(?:e[+-]?\d+)?(?![\w])")
TIME = re.compile(r"\d ?(?:µs|ms|s|min|h|seconds|minutes|hours)\b|\btimes as long\b")
ORDER = re.compile(r"\borders?\b(?! conditions| that can be read)")


def claims(page: str) -> Iterator[tuple[str, float]]:
    """Names and values of the measurements on a page."""
    for claim in read_html(page):
        for part in ("as_printed", "corrected"):
            for measurement in getattr(claim, part):
                yield f"{claim.id}: {measurement.name}", measurement.value


def printed(page: str) -> Iterator[tuple[str, str]]:
    """Numbers of the outputs on a page that are text or tables, with the lines they stand in."""
    soup = BeautifulSoup(page, "html.parser")
    for output in soup.select("div.cell_output"):
        for hidden in output.select("script, style, svg, [data-claim]"):
            hidden.decompose()
        for table in output.select("table"):
            leave_out_run_times(table)
        for line in output.get_text("\n").splitlines():
            if not TIME.search(line):
                yield from ((line.strip(), found) for found in NUMBER.findall(line))


def leave_out_run_times(table: Tag) -> None:
    """Empty the columns of a table that are headed so."""
    heads = [head.get_text() for head in table.select("thead th")]
    for row in table.select("tbody tr"):
        for head, cell in zip(heads, row.find_all(["th", "td"]), strict=False):
            if "run time" in head:
                cell.clear()


def unit(text: str) -> float:
    """Return one in the last digit of a printed number.

    Examples
    --------
    >>> unit("1.25e-03"), unit("1,026")
    (1e-05, 1.0)
    """
    mantissa, _, exponent = text.partition("e")
    digits = len(mantissa.partition(".")[2])
    return float(f"1e{int(exponent or 0) - digits}")


def value(text: str) -> float:
    """Return a printed number."""
    return float(text.replace(",", "").replace("−", "-"))


def agree(one: float, other: float, slack: float = 0.0, *, tolerance: float = TOLERANCE) -> bool:
    """Whether two numbers are the same for a reader.

    Examples
    --------
    >>> agree(0.1 + 0.2, 0.3), agree(1e-13, 3e-13), agree(1.0, 1.00001)
    (True, True, False)
    """
    if math.isnan(one) or math.isnan(other):
        return math.isnan(one) and math.isnan(other)
    size = max(1.0, abs(one), abs(other))
    return one == other or abs(one - other) <= tolerance * size + slack * (1 + 1e-9)


def differences(one: Path, other: Path) -> tuple[int, list[str]]:
    """Return how many numbers were compared, and what is not the same."""
    count, found = 0, []
    names = {path.relative_to(folder) for folder in (one, other) for path in folder.rglob("*.html")}
    for name in sorted(names):
        if name.stem in TIMED or {"_static", "_modules"} & set(name.parts):
            continue
        if not ((one / name).exists() and (other / name).exists()):
            found.append(f"{name}: only in one of them")
            continue
        pages = [(folder / name).read_text("utf8") for folder in (one, other)]
        measured = [list(claims(page)) for page in pages]
        texts = [list(printed(page)) for page in pages]
        if len(measured[0]) != len(measured[1]) or len(texts[0]) != len(texts[1]):
            found.append(f"{name}: not as many numbers in the one as in the other")
            continue
        count += len(measured[0]) + len(texts[0])
        for (what, a), (_, b) in zip(*measured, strict=True):
            tolerance = OF_ORDERS if ORDER.search(what.partition(": ")[2]) else TOLERANCE
            if not agree(a, b, tolerance=tolerance):
                found.append(f"{name}: {what}: {a!r} and {b!r}")
        for (line, a), (_, b) in zip(*texts, strict=True):
            if not agree(value(a), value(b), unit(a)):
                found.append(f"{name}: {line}: {a} and {b}")
    return count, found


if __name__ == "__main__":
    number, faults = differences(Path(sys.argv[1]), Path(sys.argv[2]))
    print(*faults, f"{number} numbers compared, {len(faults)} differ", sep="\n")
    raise SystemExit(bool(faults) or not number)
