"""The README's example runs and is as good as it says."""

import math
import re
from pathlib import Path

from esfem_core.companion import campaign

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text("utf8")


def test_the_example_runs(capsys):
    (example,) = re.findall(r"```python\n(.*?)```", README, re.S)
    assert len([line for line in example.splitlines() if line.strip()]) <= 10
    names: dict = {}
    exec(compile(example, "README.md", "exec"), names)
    assert names["errors"].x_l2 < 1e-3
    assert capsys.readouterr().out.startswith("t = 1, error of the position ")


def test_the_files_it_names_exist():
    for target in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (ROOT / target).exists(), target


def test_the_speed_it_names_was_measured():
    (low, high), *others = re.findall(
        r"(\d+) to\s+(\d+)\s+times\s+as fast as with\s+NGSolve", README
    )
    ratios = [row["ratio"] for row in campaign.performance()["step"]]
    assert (int(low), int(high)) == (math.floor(min(ratios)), math.floor(max(ratios)))
    assert not others
