"""What `make lite` refuses, says and leaves alone; tests/lite runs what it builds."""

import importlib.util
import shutil
import subprocess
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
    monkeypatch.setattr(sys, "argv", ["build.py"])
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


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["/no/such/folder"], "must be a folder that is there or .* got '/no/such/folder'"),
        (["://x"], "an address of http or https, got '://x'"),
        (["https://a b"], "got 'https://a b'"),
        (["a", "b"], r"PYODIDE must be one folder or address, got 2: \['a', 'b'\]"),
    ],
)
def test_what_is_no_folder_and_no_address_is_refused_and_an_older_site_stays(
    arguments, message, build, monkeypatch
):
    build.LITE.mkdir()
    monkeypatch.setattr(sys, "argv", ["build.py", *arguments])
    with pytest.raises(SystemExit, match=message):
        build.main()
    assert build.LITE.exists()
    assert build.source_of([]) == build.source_of([""]) == ""
    assert build.source_of(["https://host/pyodide/"]) == "https://host/pyodide/"


@pytest.mark.skipif(shutil.which("make") is None, reason="there is no make")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["pyodide-there", "PYODIDE=/no/such"], "PYODIDE must be a folder or an address, got /no/"),
        (["pyodide-there", "PYODIDE=/a b"], "PYODIDE must be a folder or an address, got /a b"),
        (["-n", "full", "STALE=0"], "STALE must be 1 or nothing, got 0"),
        (["-n", "full", "STALE=no"], "STALE must be 1 or nothing, got no"),
    ],
)
def test_variables_of_make_that_mean_nothing_are_refused(arguments, message):
    made = subprocess.run(
        ["make", *arguments], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert made.returncode != 0
    assert message in made.stderr


@pytest.mark.skipif(shutil.which("make") is None, reason="there is no make")
def test_variables_of_make_that_mean_something_are_taken(tmp_path):
    folder = tmp_path / "with a blank"
    folder.mkdir()
    for value in ("", "https://host/pyodide", str(folder)):
        subprocess.run(["make", "pyodide-there", f"PYODIDE={value}"], cwd=ROOT, check=True)
    said = [
        subprocess.run(
            ["make", "-n", "full", *more], cwd=ROOT, capture_output=True, text=True, check=False
        )
        for more in ([], ["STALE="], ["STALE=1"])
    ]
    assert [("--stale" in made.stdout, made.returncode) for made in said] == [
        (False, 0),
        (False, 0),
        (True, 0),
    ]


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


def test_chapters_import_what_their_calls_need(build):
    """The browser loads what a chapter imports, and nothing else."""
    for notebook in (ROOT / "book").glob("[0-9]*.ipynb"):
        code, modules = notebook.read_text("utf8"), build.modules(notebook)
        for call, module in (("ec.from_level_set(", "skimage"), ("ec.manufactured(", "sympy")):
            assert call not in code or module in modules, (notebook.name, call)


def test_no_file_of_it_names_a_host():
    for path in (ROOT / "lite").iterdir():
        if path.is_file():
            assert "://" not in path.read_text("utf8").replace('"://"', ""), path
