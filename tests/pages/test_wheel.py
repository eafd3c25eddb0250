"""The wheel in the book is what the page says, and runs with three packages and nothing else."""

import hashlib
import importlib.metadata
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import HTML, ROOT, soup

FOLDER = HTML / "wheel"
NEEDED = ("numpy", "scipy", "trimesh")


@pytest.fixture(scope="module")
def wheel():
    (found,) = FOLDER.glob("*.whl")
    return found


def test_the_page_has_its_address_and_its_checksum(wheel):
    page = soup("book/how_to_run.html")
    assert [a["href"] for a in page.find_all("a") if a.get("href", "").endswith(".whl")] == [
        f"../wheel/{wheel.name}"
    ]
    line = f"{hashlib.sha256(wheel.read_bytes()).hexdigest()}  {wheel.name}"
    assert line in page.text
    assert (FOLDER / "SHA256SUMS").read_text().strip() == line


@pytest.fixture(scope="module")
def bare(wheel, tmp_path_factory):
    """An environment with the wheel, installed by pip, and with what it needs, linked from here."""
    folder = tmp_path_factory.mktemp("bare")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
    python = folder / "bin" / "python"
    where = "import sysconfig; print(sysconfig.get_path('purelib'))"
    site = Path(subprocess.check_output([python, "-c", where], text=True).strip())
    for name in NEEDED:
        files = importlib.metadata.files(name)
        here = Path(files[0].locate()).parents[len(files[0].parts) - 1]
        for top in {path.parts[0] for path in files} - {"..", "__pycache__"}:
            (site / top).symlink_to(here / top)
    options = "--quiet --disable-pip-version-check --no-index --no-warn-script-location"
    install = [sys.executable, "-m", "pip", "--python", python, "install", *options.split(), wheel]
    # Without an index: what is missing ends it. Without this checkout, which has it, too.
    alone = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    subprocess.run(install, check=True, env=alone)
    return python


def test_an_empty_environment_with_three_packages_runs_the_ten_lines_of_the_readme(bare, tmp_path):
    (example,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text("utf8"), re.S)
    example += """
import importlib.metadata, json
print(json.dumps([ec.__file__, [d.name for d in importlib.metadata.distributions()]]))
"""
    found = subprocess.run(
        [bare, "-I", "-c", example], cwd=tmp_path, check=True, capture_output=True, text=True
    )
    said, place = found.stdout.splitlines()
    assert said.startswith("t = 1, error of the position ")
    assert found.stderr == ""
    file, installed = json.loads(place)
    assert Path(file).is_relative_to(bare.parents[1])
    assert sorted(installed) == ["esfem-core", *NEEDED]
