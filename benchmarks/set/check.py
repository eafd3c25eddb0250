"""Hold the errors of another code against ours: python check.py mine.json.

mine.json is a list of rows like those of errors.json, such as
{"problem": "lmv-1", "mesh": "sphere_2", "order": 2, "step": 0.05, "measured": {"u_l2": 0.00123}}
The same scheme on the same mesh agrees to the uncertainty that errors.json states. Other schemes do
not have to; for them the ratio is what counts. Needs nothing but Python.
"""

import json
import sys
from pathlib import Path

KEY = ("problem", "mesh", "order", "step")


def compared(mine, ours):
    """Row by row and number by number: (what, theirs, ours, ratio, agreement)."""
    known = {tuple(row[k] for k in KEY): row["measured"] for row in ours}
    for row in mine:
        key = tuple(row.get(k) for k in KEY)
        if key not in known:
            near = sorted({k[:2] for k in known if k[0] == key[0]}) or sorted({k[0] for k in known})
            raise SystemExit(f"no row {dict(zip(KEY, key, strict=True))}; there are {near}")
        for name, value in row["measured"].items():
            if name not in known[key]:
                raise SystemExit(f"{name!r} is none of {', '.join(known[key])} of {key}")
            expected, uncertainty = known[key][name]
            agrees = abs(value - expected) <= uncertainty
            ratio = value / expected if expected else float("inf")
            yield (*key, name), value, expected, ratio, agrees


def main(path):
    """Print a line for each number; the exit code is 1 if some do not agree."""
    ours = json.loads((Path(__file__).parent / "errors.json").read_text())
    lines = list(compared(json.loads(Path(path).read_text()), ours))
    for key, value, expected, ratio, agrees in lines:
        verdict = "agrees" if agrees else f"{ratio:.3g} times ours"
        print(f"{' '.join(map(str, key)):60} {value:12.4e} {expected:12.4e}  {verdict}")
    print(f"{sum(line[-1] for line in lines)} of {len(lines)} numbers agree")
    return 0 if all(line[-1] for line in lines) else 1


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    sys.exit(main(sys.argv[1]))
