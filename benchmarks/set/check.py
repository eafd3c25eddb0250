"""Hold the errors of another code against ours: python check.py mine.json.

mine.json is a list of rows like those of errors.json, such as
{"problem": "lmv-1", "mesh": "sphere_3", "order": 2, "step": 0.05, "measured": {"u_l2": 0.00123}}
The same scheme on the same mesh agrees to the uncertainty that errors.json states. Other schemes do
not have to; for them the ratio is what counts. Needs nothing but Python.
"""

import json
import math
import sys
from pathlib import Path

KEY = ("problem", "mesh", "order", "step")


def compared(mine, ours):
    """Row by row and number by number: (what, theirs, ours, uncertainty, agreement)."""
    known = {tuple(row[k] for k in KEY): row["measured"] for row in ours}
    if not isinstance(mine, list) or not mine:
        raise SystemExit(f"there must be a list of rows, got {shown(mine)}")
    seen = {}
    for i, row in enumerate(mine):
        key = key_of(i, row, known)
        if key in seen:
            raise SystemExit(f"rows {seen[key]} and {i} are both for {shown(key)}")
        seen[key] = i
        measured = row.get("measured")
        if not isinstance(measured, dict) or not measured:
            raise SystemExit(
                f'row {i} must have "measured", numbers by name ({", ".join(known[key])}), got '
                f"{shown(measured)}"
            )
        for name, value in measured.items():
            if name not in known[key]:
                raise SystemExit(f"{name!r} is none of {', '.join(known[key])} of {key}")
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise SystemExit(f"{name} of row {i} must be a number, got {shown(value)}")
            expected, uncertainty = known[key][name]
            agrees = abs(value - expected) <= uncertainty
            yield (*key, name), value, expected, uncertainty, agrees


def key_of(i, row, known):
    """What a row is about, one of the known; steps are those to nine digits."""
    if not isinstance(row, dict):
        raise SystemExit(f"row {i} must have {', '.join(KEY)} and measured, got {shown(row)}")
    given = tuple(row.get(k) for k in KEY)
    for key in known:
        if given[:3] == key[:3] and close(given[3], key[3]):
            return key
    keys, tried = list(known), []
    for k, value in zip(KEY, given, strict=True):
        there = list(dict.fromkeys(key[len(tried)] for key in keys))
        keys = [key for key in keys if key[len(tried)] == value]
        if not keys:
            of = f" for {' '.join(map(str, tried))}" if tried else ""
            raise SystemExit(
                f"row {i} has {k} {shown(value)}{of}; known: {', '.join(map(str, there))}"
            )
        tried.append(value)
    raise AssertionError("one of the four does not fit")


def close(step, other):
    """Whether a value is a step to nine digits."""
    return isinstance(step, int | float) and math.isclose(step, other, rel_tol=1e-9)


def shown(value):
    """A value for a message: short."""
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def read(path):
    """What a file says."""
    try:
        return json.loads(Path(path).read_bytes())
    except (OSError, ValueError) as error:  # of JSON, and of its encoding
        raise SystemExit(f"{path} must be a file of JSON: {error}") from None


def how_far(value, expected, uncertainty):
    """By how much a value is off; its ratio to ours, which is what counts for other schemes."""
    ratio = f", {value / expected:.3g} times ours" if expected else ""
    return f"off by {value - expected:.1e}, allowed {uncertainty:.0e}{ratio}"


def main(path):
    """Print a line for each number; the exit code is 1 if some do not agree."""
    ours = json.loads((Path(__file__).parent / "errors.json").read_text())
    lines = list(compared(read(path), ours))
    for key, value, expected, uncertainty, agrees in lines:
        verdict = "agrees" if agrees else how_far(value, expected, uncertainty)
        print(f"{' '.join(map(str, key)):60} {value:15.7e} {expected:15.7e}  {verdict}")
    print(f"{sum(line[-1] for line in lines)} of {len(lines)} numbers agree")
    return 0 if all(line[-1] for line in lines) else 1


if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1] in ("-h", "--help"):
        raise SystemExit(__doc__)
    sys.exit(main(sys.argv[1]))
