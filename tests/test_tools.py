"""Commands of the tests themselves: one that tries nothing does not succeed."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("readers.py 99", "no chapter has the number 99; write 02 for the second"),
        ("mutants.py --each 0", "--each and --workers must be 1 or more"),
        ("fuzz.py --cases 0", "--cases must be 1 or more"),
    ],
)
def test_a_command_that_would_try_nothing_is_refused(command, message):
    name, *arguments = command.split()
    done = subprocess.run(
        [sys.executable, ROOT / "tests" / name, *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0
    assert message in done.stderr
