"""The README's example runs and is as good as it says."""

import re
from pathlib import Path

README = (Path(__file__).parents[1] / "README.md").read_text("utf8")


def test_the_example_runs(capsys):
    (example,) = re.findall(r"```python\n(.*?)```", README, re.S)
    assert len([line for line in example.splitlines() if line.strip()]) <= 10
    names: dict = {}
    exec(compile(example, "README.md", "exec"), names)
    assert names["errors"].x_l2 < 1e-3
    assert capsys.readouterr().out.startswith("t = 1, error of the position ")


def test_the_files_it_names_exist():
    root = Path(__file__).parents[1]
    for target in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (root / target).exists(), target
