"""The page Files of the book: its code runs, and what it says of the adaptive recipe is so."""

import re
from functools import reduce
from pathlib import Path

import numpy as np
import pytest
import trimesh

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
    assert {f"frame_{i:04d}.ply" for i in range(3)} <= written
    written = {name for name in written if not name.startswith("frame_")}
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


def test_values_at_points_become_initial_values(folder):
    _, names = folder
    tri, nodes = names["tri"], names["tri"].vertices
    np.testing.assert_array_equal(names["coloured"].initial_values(np.array(nodes))["u"], 1.0)
    found = names["measured"].initial_values(np.array(nodes))["u"]
    np.testing.assert_allclose(found, 1 + tri.vertices[:, 0], rtol=0, atol=1e-6)


def test_frames_have_the_colours_of_the_values(folder):
    path, names = folder
    frame = trimesh.load(path / "frame_0002.ply", process=False)
    np.testing.assert_allclose(
        frame.vertices, names["kept"][10].x[: len(frame.vertices)], atol=1e-5
    )
    red, u = frame.visual.vertex_colors[:, 0], names["kept"][10].u[: len(frame.vertices)]
    assert np.corrcoef(red, np.clip(u, 0.5, 2.0))[0, 1] > 0.999


def test_a_run_ends_where_nothing_changes(folder):
    _, names = folder
    state = names["state"]
    assert 1 < state.t < 99
    assert np.ptp(state.u) < 1e-4


def test_every_function_it_names_exists():
    for name in re.findall(r"`(?:[^`]*<)?esfem_core\.([\w.]+)>?`", PAGE):
        assert reduce(lambda inside, part: getattr(inside, part, None), name.split("."), ec), name
