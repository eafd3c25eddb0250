"""What `make lite` refuses, says and leaves alone; tests/lite runs what it builds."""

import importlib.util
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture
def build(tmp_path, monkeypatch):
    """Give lite/build.py, with an empty book of one page in a folder of its own."""
    spec = importlib.util.spec_from_file_location("lite_build", ROOT / "lite" / "build.py")
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "lite_build", module)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "BOOK", tmp_path / "html")
    monkeypatch.setattr(module, "LITE", tmp_path / "html" / "lite")
    monkeypatch.setattr(module, "WORK", tmp_path / "work")
    (tmp_path / "html" / "book").mkdir(parents=True)
    return module


@pytest.mark.parametrize("lock", [None, "{}"])
def test_what_cannot_be_had_is_said_and_the_pages_stay_as_they_are(
    lock, build, tmp_path, monkeypatch, capsys
):
    page = tmp_path / "html" / "book" / "01_surface_pde.html"
    page.write_text("<article><h1>One</h1></article>")
    distribution = tmp_path / "pyodide"
    distribution.mkdir()
    if lock is not None:
        (distribution / build.LOCK).write_text(lock)
    monkeypatch.setattr(sys, "argv", ["build.py", str(distribution)])
    build.main()
    said = capsys.readouterr().out
    assert said.startswith("lite: the book has no buttons, for something cannot be had: ")
    assert build.LOCK in said
    assert page.read_text() == "<article><h1>One</h1></article>"
    assert not build.LITE.exists()


def test_a_book_has_to_be_there(build, tmp_path):
    (tmp_path / "html" / "book").rmdir()
    with pytest.raises(SystemExit, match="there is no built book: run `make book`"):
        build.main()


def test_a_wheel_with_another_sum_is_refused(build, tmp_path):
    wheel = tmp_path / "some-1.0-py3-none-any.whl"
    wheel.write_bytes(b"other")
    with pytest.raises(build.MissingError, match="is not the file with sha256 0000"):
        build.checked(wheel, 64 * "0")


def test_chapters_import_what_the_browser_can_have(build):
    known = {"IPython", "esfem_core", "matplotlib", "mpl_toolkits", "numpy", "scipy", "trimesh"}
    optional = {"meshio", "skimage", "sympy"}
    for notebook in (ROOT / "book").glob("*.ipynb"):
        assert build.modules(notebook) <= known | optional, notebook.name


def test_no_file_of_it_names_a_host():
    for path in (ROOT / "lite").iterdir():
        if path.is_file():
            assert "://" not in path.read_text("utf8").replace('"://"', ""), path
