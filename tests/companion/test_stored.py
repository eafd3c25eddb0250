"""Stored results are found wherever the package is, and asked for in one way."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest

from esfem_core.companion import campaign
from esfem_core.companion.experiments import EXPERIMENTS

ROOT = Path(__file__).parents[2]
COMMAND = "python -m esfem_core.companion.experiments"


def test_stored_rows_are_those_with_the_parameters_asked_for():
    rows = campaign.stored("nick_theorem")
    assert len(rows) == 72
    some = campaign.stored("nick_theorem", order=3, refinements=1)
    assert some == campaign.select(rows, order=3, refinements=1)
    assert len(some) == 6


@pytest.mark.parametrize(
    ("name", "parameters", "message"),
    [
        ("nick_theorem", {"order": 6}, "no results of nick_theorem with order = 6 are stored; "),
        (
            "nick_coupling",
            {"mesh": "cube", "angle": 0.3},
            "no results of nick_coupling with mesh = 'cube', angle = 0.3 are stored; ",
        ),
    ],
)
def test_what_is_not_stored_is_told_with_the_command_that_makes_it(name, parameters, message):
    with pytest.raises(LookupError) as error:
        campaign.stored(name, **parameters)
    assert str(error.value).startswith(message)
    assert str(error.value).endswith(f"are computed by: {COMMAND} {name}")


def test_a_name_that_is_no_experiment_is_told_the_names_that_are():
    with pytest.raises(
        LookupError, match="no results of 'nick_figure_6' are stored, only those"
    ) as error:
        campaign.stored("nick_figure_6")
    assert {e.name for e in EXPERIMENTS} <= set(re.findall(r"\w+", str(error.value)))
    assert str(error.value).endswith(f"are computed by: {COMMAND}")


def test_measurements_that_are_not_there_are_told_with_the_command(monkeypatch, tmp_path):
    assert set(campaign.performance()) > {"machine", "step", "assembly"}
    assert campaign.performance("performance_xeon").keys() == campaign.performance().keys()
    monkeypatch.setattr(campaign, "DATA", tmp_path)
    with pytest.raises(LookupError, match=r"make them with: python benchmarks/run\.py"):
        campaign.performance()


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """A wheel of a copy of the checkout, so that no build is left in it."""
    folder = tmp_path_factory.mktemp("wheel")
    copy = folder / "checkout"
    without = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "esfem_core", copy / "esfem_core", ignore=without)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy)
    build = "-m pip wheel -q --no-deps --no-build-isolation --disable-pip-version-check -w"
    subprocess.run([sys.executable, *build.split(), folder, copy], check=True)
    (path,) = folder.glob("*.whl")
    return path


def test_a_wheel_contains_every_stored_result(wheel):
    prefix = "esfem_core/companion/data/"
    names = {name.removeprefix(prefix) for name in ZipFile(wheel).namelist() if prefix in name}
    assert names == {path.name for path in campaign.DATA.iterdir()}
    assert {"performance.json", "verdicts.json", "stanford_bunny.ply"} < names
    assert len(names) == 23


def test_an_installed_package_reads_them_in_an_empty_folder(wheel, tmp_path):
    site, empty = tmp_path / "site", tmp_path / "empty"
    ZipFile(wheel).extractall(site)
    empty.mkdir()
    script = (
        "from esfem_core.companion import campaign\n"
        "print(campaign.DATA)\n"
        "print(len(campaign.stored('nick_theorem')), len(campaign.performance()['step']))"
    )
    run = subprocess.run(
        [sys.executable, "-c", script],
        cwd=empty,
        env=os.environ | {"PYTHONPATH": str(site)},
        check=True,
        capture_output=True,
        text=True,
    )
    rows = len(campaign.performance()["step"])
    assert run.stdout.split() == [str(site / "esfem_core/companion/data"), "72", str(rows)]
