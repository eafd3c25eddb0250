"""Test the solver in an environment of its own, with other versions of what it needs.

``python tests/versions.py oldest`` takes the oldest versions that ``pyproject.toml`` allows, and
``newest`` the newest there are; further arguments go to pytest. The environment is made anew in
``_build``; it needs an index of packages. The book's tools are not in it: what is tested are the
rooms of the solver, whose numbers ``tests/stepping/numbers.json`` and the doctests fix.
"""

import re
import subprocess
import sys
import tomllib
import venv
from pathlib import Path

ROOT = Path(__file__).parents[1]
ROOMS = (
    "solvers surfaces elements laws problems stepping theory study test_checks.py test_errors.py"
)
TOOLS = [
    "pytest",
    "pytest-xdist",
    "pyyaml",
    "packaging",
    "tqdm",
    "cloudpickle",
]


def requirements(project: dict, which: str) -> list[str]:
    """Return what to install: bounds from below become equalities, or stay.

    Examples
    --------
    >>> requirements({"dependencies": ["numpy>=2.0"]}, "oldest")
    ['numpy==2.0']
    """
    needed = project["dependencies"]
    return [re.sub(">=", "==", text) for text in needed] if which == "oldest" else needed


def main(which: str, arguments: list[str]) -> int:
    """Make the environment and run the tests."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf8"))["project"]
    folder = ROOT / "_build" / which
    venv.create(folder, clear=True, with_pip=True)
    python = folder / ("Scripts" if sys.platform == "win32" else "bin") / "python"
    names = ("fast", "files", "mesh", "pictures", "symbolic")
    optional = [r for name in names for r in extras(project, name)]
    install = [python, "-m", "pip", "install", "-q", "--disable-pip-version-check", "--upgrade"]
    subprocess.run([*install, *requirements(project, which), *optional, *TOOLS], check=True)
    subprocess.run([*install, "--no-deps", "-e", ROOT], check=True)
    show = "import numpy, scipy, trimesh, sys; print(sys.version.split()[0], *(\n"
    show += "f'{m.__name__} {m.__version__}' for m in (numpy, scipy, trimesh)))"
    subprocess.run([python, "-c", show], check=True)
    places = ["esfem_core", *(f"tests/{room}" for room in ROOMS.split())]
    places.append("--ignore=esfem_core/companion")
    tests = [python, "-m", "pytest", "-q", "-n", "2", "-p", "no:cacheprovider", *places]
    return subprocess.run([*tests, *arguments], cwd=ROOT, check=False).returncode


def extras(project: dict, name: str) -> list[str]:
    """Return the requirements of an extra."""
    return project["optional-dependencies"][name]


if __name__ == "__main__":
    if sys.argv[1:2] not in (["oldest"], ["newest"]):
        raise SystemExit("usage: python tests/versions.py oldest|newest [arguments of pytest]")
    raise SystemExit(main(sys.argv[1], sys.argv[2:]))
