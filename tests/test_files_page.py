"""The page Files of the book: its code runs, and what it says of the adaptive recipe is so."""

import re
from functools import reduce
from pathlib import Path

import numpy as np
import pytest

import esfem_core as ec

PAGE = (Path(__file__).parents[1] / "book" / "files.md").read_text("utf8")


def blocks():
    return re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where all code of the page has run, from top to bottom."""
    folder, names = tmp_path_factory.mktemp("page"), {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for block in blocks():
            exec(compile(block, "files.md", "exec"), names)
    return folder, names


def test_the_code_runs_and_writes_what_the_page_says(folder):
    path, names = folder
    written = {p.name for p in path.iterdir()} - {f"run_{n:05d}.vtu" for n in range(21)}
    assert written == {
        *("shape.stl", "run.pvd", "run.npz", "run.csv", "run_2.csv", "run.html", "run.gif"),
        "run.png",
    }
    assert len(list(path.glob("run_*.vtu"))) == 21
    assert names["last"].t == pytest.approx(1.1)


def test_a_series_gives_the_surface_back(folder):
    _, names = folder
    np.testing.assert_array_equal(names["again"].nodes, names["kept"][-1].x)


def test_a_series_that_went_on_has_each_time_once(folder):
    path, _ = folder
    times = re.findall(r'timestep="(.*?)"', (path / "run.pvd").read_text("utf8"))
    np.testing.assert_allclose(np.array(times, float), np.arange(21) / 20, rtol=0, atol=1e-12)


def test_every_function_it_names_exists():
    for name in re.findall(r"`(?:[^`]*<)?esfem_core\.([\w.]+)>?`", PAGE):
        assert reduce(lambda inside, part: getattr(inside, part, None), name.split("."), ec), name
