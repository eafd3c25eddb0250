"""Put JupyterLite into the built book, and a button on each chapter that opens its notebook there.

    python lite/build.py [PYODIDE]

PYODIDE is a folder with a Pyodide distribution, or its address. From a folder all that is needed is
copied into the book and nothing is asked of other hosts; from an address the reader's browser loads
Pyodide itself. Without it the packages are fetched by npm and pip: Pyodide's own one has the
runtime, and the wheels of compiled packages, which no registry has, come with another one.

Nothing is used that is not what it should be: the files of the runtime have the sums below, those
of the distribution the sums of its lock file, and pip checks the rest. The book keeps its pages as
they are if something cannot be had.
"""

from __future__ import annotations

import ast
import hashlib
import json
import re
import shutil
import subprocess
import sys
import tarfile
import urllib.request
import zipfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from http.client import HTTPException
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
BOOK = ROOT / "_build" / "html"
LITE = BOOK / "lite"
WORK = ROOT / "_build" / "lite"  # what is fetched stays here

VERSION = "314.0.3"
LOCK = "pyodide-lock.json"
# fmt: off
RUNTIME = {
    LOCK:                "c963d22858f6bcb8f41586a2142f03905ab370c88ea22a86a2736e95fac2a8f3",
    "pyodide.mjs":       "5cfc46f5dcbaf2a16f26e2363f441873eb424762609cc03db00d6a2ace4d00e5",
    "pyodide.asm.mjs":   "1a9775427ef6e8abaa7db88ece0515422d1886915ae5c9093776410c865dfd8d",
    "pyodide.asm.wasm":  "e7f8fac36f8bf11085309cbc5c829b3ec3057c18bf1d73b05a6741612d63cdbf",
    "python_stdlib.zip": "444c770dfd75a32097fc0a7d5c1413fd3140601f49c3a1f2e9af0376fcd124b4",
}
# fmt: on
COMPILED = "open_webui==0.12.4"  # ships these wheels, and is on the registry

KERNEL = ("micropip", "piplite", "ipykernel", "comm", "pyodide-kernel", "jedi", "ipython")
OURS = "esfem-core"
SOLVER = (OURS, "matplotlib")  # imported by ours only when something is drawn
PLOTLY = "_static/plotly/plotly-gl3d.min.js"  # of the book, for its pictures and those in here
OPTIONAL = ("sympy", "meshio", "scikit-image")  # without one, chapters that need it stay out

APPLICATION = 9_900_000  # bytes of JupyterLite itself that a notebook loads
# Pages that are read from a disk, without a server, cannot start Python: no button there.
BUTTON = """\
<p class="esfem-launch" hidden>
<a class="btn btn-sm btn-outline-primary"
   href="../lite/notebooks/index.html?path={notebook}&amp;run=1">
Run in the browser ({megabytes} MB)</a>
<a href="in_the_browser.html">What is this?</a>
</p>
<script>document.querySelector(".esfem-launch").hidden = location.protocol === "file:";</script>"""

Entry = dict[str, Any]  # of the lock file


@dataclass(frozen=True)
class Package:
    """A wheel: its entry in the lock file, its bytes, and the file if the site has to have it."""

    entry: Entry
    size: int
    wheel: Path | None = None


class MissingError(Exception):
    """Something cannot be had, or is not what it should be."""


#: What stands for it in the libraries; most of what urllib raises is an OSError.
UNAVAILABLE = (MissingError, OSError, HTTPException, tarfile.TarError, zipfile.BadZipFile)


def sha256(path: Path) -> str:
    """Sum of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def checked(path: Path, expected: str) -> Path:
    """Return the path of a file that has the sum."""
    if not path.is_file():
        raise MissingError(f"there is no {path.name}")
    if sha256(path) != expected:
        raise MissingError(f"{path} is not the file with sha256 {expected}")
    return path


def run(*command: str | Path, cwd: Path = ROOT) -> None:
    """Run a program; what it says is shown if it fails."""
    try:
        done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    except FileNotFoundError as error:
        raise MissingError(f"there is no program {command[0]}") from error
    if done.returncode:
        last = (done.stdout + done.stderr).strip().splitlines()[-1:]
        raise MissingError(f"{' '.join(map(str, command))}: {''.join(last)}")


def fetched() -> Path:
    """Return a folder with the distribution, as far as the registries have it."""
    folder = WORK / f"pyodide-{VERSION}"
    if all((folder / name).is_file() for name in RUNTIME):
        return folder
    archives = WORK / "archives"
    archives.mkdir(parents=True, exist_ok=True)
    folder.mkdir(exist_ok=True)
    run("npm", "pack", "--silent", f"pyodide@{VERSION}", cwd=archives)
    pip_download(COMPILED, archives, "3.12")  # it declares this one; the wheels in it are for 3.14
    for archive in archives.glob("*.whl"):
        with zipfile.ZipFile(archive) as wheel:
            for name in wheel.namelist():
                if name.endswith(".whl"):
                    (folder / Path(name).name).write_bytes(wheel.read(name))
    with tarfile.open(archives / f"pyodide-{VERSION}.tgz") as package:
        for name in RUNTIME:
            member = package.extractfile(f"package/{name}")
            assert member is not None
            (folder / name).write_bytes(member.read())
    shutil.rmtree(archives)
    return folder


def pip_download(requirement: str, folder: Path, python: str = "3.14") -> None:
    """Let pip fetch a pure wheel for a version of Python."""
    pip = (sys.executable, "-m", "pip", "download", "-q", "--disable-pip-version-check")
    pure = ("--only-binary", ":all:", "--python-version", python, "--platform", "any")
    run(*pip, "--no-deps", *pure, "-d", folder, requirement)


def canonical(name: str) -> str:
    """Return the name of a package as lock files write it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def described(wheel: Path) -> Entry:
    """Return the entry of the lock file for a pure wheel."""
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        (metadata,) = (n for n in names if n.endswith(".dist-info/METADATA"))
        text = archive.read(metadata).decode("utf8")
    needs = re.findall(r"^Requires-Dist: ([\w.-]+)(?!.*;)", text, re.MULTILINE)
    tops = {n.split("/")[0].removesuffix(".py") for n in names if n.endswith(".py")}
    name, version = wheel.name.split("-")[:2]
    return {
        "name": canonical(name),
        "version": version,
        "file_name": wheel.name,
        "sha256": sha256(wheel),
        "imports": sorted(t for t in tops if t.isidentifier()),
        "depends": [canonical(need) for need in needs],
        "install_dir": "site",
        "package_type": "package",
        "unvendored_tests": False,
    }


def own_wheels() -> dict[str, Path]:
    """Return the wheels of the kernel, and that of the book, by name."""
    kernel = Path(sys.prefix, "share/jupyter/labextensions/@jupyterlite").rglob("*.whl")
    ours = (BOOK / "wheel").glob("*.whl")
    return {canonical(path.name.split("-")[0]): path for path in (*kernel, *ours)}


class Distribution:
    """Pyodide, in a folder or at an address, and the wheels that it lacks."""

    def __init__(self, source: str) -> None:
        self.address = source.rstrip("/") if "://" in source else ""
        if self.address:
            self.folder = WORK / "address"
            self.folder.mkdir(parents=True, exist_ok=True)
            with urllib.request.urlopen(f"{self.address}/{LOCK}") as answer:
                (self.folder / LOCK).write_bytes(answer.read())
        else:
            self.folder = Path(source) if source else fetched()
        text = checked(self.folder / LOCK, RUNTIME[LOCK]).read_text("utf8")
        self.lock = json.loads(text)
        self.wheels = WORK / "wheels"
        self.wheels.mkdir(parents=True, exist_ok=True)
        self.own = own_wheels()
        lines = (ROOT / "requirements.lock").read_text("utf8").splitlines()
        self.pins = dict(line.split("==") for line in lines if "==" in line)

    def pure(self, name: str, version: str) -> Path:
        """Return a pure wheel from the registry."""
        stem = f"{name.replace('-', '_')}-{version}-"
        if not (found := list(self.wheels.glob(f"{stem}*.whl"))):
            pip_download(f"{name}=={version}", self.wheels)
            found = list(self.wheels.glob(f"{stem}*.whl"))
        return found[0]

    def package(self, name: str) -> Package:
        """Find a package."""
        listed = self.lock["packages"].get(name)
        if name in self.own or listed is None:
            if name not in self.own and name not in self.pins:
                raise MissingError(f"{name} is neither in Pyodide nor in requirements.lock")
            wheel = self.own.get(name) or self.pure(name, self.pins[name])
            return Package(described(wheel), wheel.stat().st_size, wheel)
        file = listed["file_name"]
        if self.address:
            return Package(listed | {"file_name": f"{self.address}/{file}"}, self.size(file))
        if (self.folder / file).is_file():
            wheel = checked(self.folder / file, listed["sha256"])
            return Package(listed, wheel.stat().st_size, wheel)
        if not file.endswith("-none-any.whl"):
            raise MissingError(f"{name} is compiled, and {self.folder.name} does not have {file}")
        # Pyodide builds some pure wheels itself: the registry's have another sum.
        wheel = self.pure(name, listed["version"])
        changed = {"file_name": wheel.name, "sha256": sha256(wheel)}
        return Package(listed | changed, wheel.stat().st_size, wheel)

    def size(self, file: str) -> int:
        """Return the bytes of a file of the distribution."""
        if not self.address:
            return (self.folder / file).stat().st_size
        request = urllib.request.Request(f"{self.address}/{file}", method="HEAD")
        try:
            with urllib.request.urlopen(request) as answer:
                return int(answer.headers["Content-Length"])
        except (OSError, HTTPException) as error:
            raise MissingError(f"{request.full_url}: {error}") from error
        except TypeError:
            raise MissingError(f"{request.full_url} does not say how large it is") from None


def closure(names: Iterable[str], package: Callable[[str], Package]) -> dict[str, Package]:
    """Return packages and all that they need, by name."""
    found: dict[str, Package] = {}
    todo = list(names)
    while todo:
        if (name := canonical(todo.pop())) not in found:
            found[name] = package(name)
            todo += found[name].entry["depends"]
    return found


def build(distribution: Distribution) -> dict[str, Package]:
    """Build the site and return the packages in it, by name."""
    found = closure([*KERNEL, *SOLVER], distribution.package)
    for name in OPTIONAL:
        try:
            found |= closure([name], distribution.package)
        except MissingError as reason:
            print(f"lite: without {name}: {reason}")

    notebooks = WORK / "notebooks"
    shutil.rmtree(notebooks, ignore_errors=True)
    notebooks.mkdir()
    for notebook in (ROOT / "book").glob("*.ipynb"):
        shutil.copy(notebook, notebooks)
    source = WORK / "site"
    # With doit's database: a stale one loses the settings.
    shutil.rmtree(source, ignore_errors=True)
    source.mkdir()
    shutil.rmtree(LITE, ignore_errors=True)
    options = ("--no-sourcemaps", "--no-unused-shared-packages", "--apps", "notebooks")
    command = (sys.executable, "-m", "jupyterlite_core", "build", *options)
    paths = ("--lite-dir", source, "--output-dir", LITE, "--contents", notebooks)
    run(*command, *paths, cwd=source)

    static = LITE / "static" / "pyodide"
    static.mkdir()
    for package in found.values():
        if package.wheel is not None:
            shutil.copy(package.wheel, static)
    if not distribution.address:
        for name, expected in RUNTIME.items():
            shutil.copy(checked(distribution.folder / name, expected), static)
    entries = {"packages": {name: package.entry for name, package in found.items()}}
    (static / LOCK).write_text(json.dumps(distribution.lock | entries), "utf8")
    runner = LITE / "extensions" / "esfem-run"
    runner.mkdir()
    shutil.copy(Path(__file__).with_name("run_on_opening.js"), runner)
    configure(distribution.address or "./static/pyodide")
    return found


def configure(pyodide: str) -> None:
    """Tell JupyterLite where its Python is, and of our extension."""
    file = LITE / "jupyter-lite.json"
    settings = json.loads(file.read_text("utf8"))
    config = settings["jupyter-config-data"]
    config["exposeAppInBrowser"] = True  # for the tests
    config["federated_extensions"].append(
        {"name": "esfem-run", "load": "run_on_opening.js", "extension": "./extension"}
    )
    config.setdefault("litePluginSettings", {})["@jupyterlite/pyodide-kernel-extension:kernel"] = {
        "pyodideUrl": f"{pyodide}/pyodide.mjs",
        "disablePyPIFallback": True,
        "loadPyodideOptions": {
            "lockFileURL": f"./static/pyodide/{LOCK}",
            "packages": [*KERNEL, *SOLVER],
            "env": {"ESFEM_PLOTLY_JS": f"../../{PLOTLY}"},
        },
    }
    file.write_text(json.dumps(settings, indent=1), "utf8")


def modules(notebook: Path) -> set[str]:
    """Return what a notebook imports, apart from the standard library."""
    cells = json.loads(notebook.read_text("utf8"))["cells"]
    found = set()
    for cell in cells:
        if cell["cell_type"] == "code":
            for node in ast.walk(ast.parse("".join(cell["source"]))):
                if isinstance(node, ast.Import):
                    found |= {alias.name.partition(".")[0] for alias in node.names}
                elif isinstance(node, ast.ImportFrom):
                    found.add(str(node.module).partition(".")[0])
    return found - sys.stdlib_module_names


def add_buttons(distribution: Distribution, packages: dict[str, Package]) -> None:
    """Put a button on each chapter that can run."""
    provider = {module: name for name, p in packages.items() for module in p.entry["imports"]}
    runtime = sum(distribution.size(name) for name in RUNTIME if name != LOCK)
    for notebook in sorted((ROOT / "book").glob("[0-9]*.ipynb")):
        needed = modules(notebook)
        if lacking := needed - provider.keys():
            print(f"lite: {notebook.stem} has no button: it needs {', '.join(sorted(lacking))}")
            continue
        names = [*KERNEL, *SOLVER, *(provider[module] for module in needed)]
        loaded = closure(names, packages.__getitem__).values()
        total = APPLICATION + runtime + sum(package.size for package in loaded)
        page = BOOK / "book" / f"{notebook.stem}.html"
        text = page.read_text("utf8")
        button = BUTTON.format(notebook=notebook.name, megabytes=round(total / 1e6))
        text = re.sub('\\n<p class="esfem-launch".*?</script>', "", text, flags=re.DOTALL)
        head, article, body = text.partition("<article")  # there is a title for printers before it
        body = body.replace("</h1>", f"</h1>\n{button}", 1)
        page.write_text(f"{head}{article}{body}", "utf8")


def in_place(distribution: Distribution) -> None:
    """Let the cells of the front page that have the tag "in-place" run where they stand."""
    cells = json.loads((ROOT / "book" / "intro.ipynb").read_text("utf8"))["cells"]
    tagged = [c for c in cells if "in-place" in c["metadata"].get("tags", [])]
    program = "\n\n".join("".join(cell["source"]) for cell in tagged)
    (LITE / "in_place.py").write_text(program, "utf8")
    shutil.copy(Path(__file__).with_name("in_place_worker.js"), LITE)
    runtime = sum(distribution.size(name) for name in RUNTIME)
    total = runtime + sum(p.size for p in closure([OURS], distribution.package).values())
    script = Path(__file__).with_name("in_place.js").read_text("utf8")
    addresses = f"../{PLOTLY}", "../lite/in_place_worker.js"
    parameters = json.dumps(["esfem-in-place", "fig-alpha", *addresses, round(total / 1e6)])
    page = BOOK / "book" / "intro.html"
    place = '<div id="esfem-in-place"></div>'
    text = page.read_text("utf8")
    text = text.replace(place, f"{place}\n<script>{script.strip()}(...{parameters});</script>")
    page.write_text(text, "utf8")


def source_of(arguments: list[str]) -> str:
    """Return the one argument: a folder that is there, an address, or "" for the registries."""
    if len(arguments) > 1:
        sys.exit(f"lite: PYODIDE must be one folder or address, got {len(arguments)}: {arguments}")
    source = arguments[0].strip() if arguments else ""
    address = re.match(r"https?:/{2}\S+$", source)
    if source and not address and not Path(source).is_dir():
        sys.exit(
            "lite: PYODIDE must be a folder that is there or an address of http or https, got "
            f"{source!r}"
        )
    return source


def main() -> None:
    """Build the site and add the buttons, or say why not."""
    source = source_of(sys.argv[1:])
    if not (BOOK / "book").is_dir():
        sys.exit("lite: there is no built book: run `make book`")
    try:
        distribution = Distribution(source)
        packages = build(distribution)
        add_buttons(distribution, packages)
        in_place(distribution)
    except UNAVAILABLE as reason:
        shutil.rmtree(LITE, ignore_errors=True)
        print(f"lite: the book has no buttons, for something cannot be had: {reason}")


if __name__ == "__main__":
    main()
