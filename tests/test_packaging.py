"""One version, one set of pins, and enough of them."""

import importlib.metadata
import re
import tomllib
from pathlib import Path

import pytest
import yaml
from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf8"))
PROJECT, SETUPTOOLS = PYPROJECT["project"], PYPROJECT["tool"]["setuptools"]


def pins(lines):
    """Return {name: version} of lines ``name==version``."""
    found = {}
    for line in lines:
        name, version = line.split("==")
        assert canonicalize_name(name) not in found, f"{name} is pinned twice"
        found[canonicalize_name(name)] = Version(version)
    return found


@pytest.fixture(scope="module")
def lock():
    lines = (ROOT / "requirements.lock").read_text("utf8").splitlines()
    return pins(line for line in lines if line and not line.startswith("#"))


def test_conda_environment_installs_what_the_lock_pins(lock):
    environment = yaml.safe_load((ROOT / "environment.yml").read_text("utf8"))
    *_, last = environment["dependencies"]
    assert pins(last["pip"]) == lock


def test_every_requirement_is_pinned_to_a_version_that_satisfies_it(lock):
    extras = PROJECT["optional-dependencies"]
    assert set(extras) >= {"book", "test"}
    # Not pinned: JupyterLab, which no test needs. Pinned elsewhere: what numbers are compared with.
    pinned = [group for name, group in extras.items() if name not in ("bench", "notebooks")]
    for text in [*PROJECT["dependencies"], *(r for group in pinned for r in group)]:
        requirement = Requirement(text)
        name = canonicalize_name(requirement.name)
        assert name in lock, f"{text} is not in requirements.lock"
        assert requirement.specifier.contains(lock[name], prereleases=True), f"{text}: {lock[name]}"


def test_the_extra_bench_is_pinned_in_a_file_of_its_own(lock):
    lines = (ROOT / "benchmarks/requirements.txt").read_text("utf8").splitlines()
    found = pins(line for line in lines if not line.startswith("#"))
    assert set(found) == {canonicalize_name(r) for r in PROJECT["optional-dependencies"]["bench"]}
    for name in set(found) & set(lock):
        assert found[name] == lock[name]


def test_the_lock_is_closed(lock):
    """Whatever a pinned package requires is pinned, and to a version it accepts."""
    linux = {"sys_platform": "linux", "platform_system": "Linux", "os_name": "posix"}
    environment = default_environment() | linux | {"extra": ""}
    for name in lock:
        for text in importlib.metadata.requires(name) or ():
            requirement = Requirement(text)
            if requirement.marker and not requirement.marker.evaluate(environment):
                continue
            required = canonicalize_name(requirement.name)
            assert required in lock, f"{name} requires {text}"
            assert requirement.specifier.contains(lock[required], prereleases=True), (
                f"{name} requires {text}, pinned is {lock[required]}"
            )


def test_the_core_needs_three_packages_only():
    names = {canonicalize_name(Requirement(r).name) for r in PROJECT["dependencies"]}
    assert names == {"numpy", "scipy", "trimesh"}


def test_the_extras_that_messages_name_are_there_and_listed_for_readers():
    sources = [path.read_text("utf8") for path in (ROOT / "esfem_core").rglob("*.py")]
    calls = re.findall(r"\bpackage\([^()]*?\"(\w+)\"\)", " ".join(sources))
    assert set(calls) >= {"fast", "files", "mesh", "pictures", "symbolic"}
    assert set(calls) <= set(PROJECT["optional-dependencies"])
    table = (ROOT / "book/how_to_run.md").read_text("utf8")
    readme = (ROOT / "README.md").read_text("utf8")
    for extra in calls:
        assert f"\n| `{extra}` |" in table
        assert f"`{extra}`" in readme
    named = re.findall(r"(.?)esfem-core\[\w+\]", " ".join([*sources, table, readme]))
    assert set(named) == {'"'}  # some shells take brackets for a pattern


def test_every_file_of_the_package_is_installed():
    patterns = SETUPTOOLS["package-data"]["esfem_core"]
    package = ROOT / "esfem_core"
    installed = {path for pattern in patterns for path in package.glob(pattern)}
    others = {p for p in package.rglob("*.*") if p.is_file() and p.suffix not in (".py", ".pyc")}
    assert any(path.suffix == ".jsonl" for path in others)
    assert others <= installed


def test_one_version_everywhere():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf8"))
    assert citation["version"] == PROJECT["version"]
    newest = re.search(r"^## \[(\d.*?)\]", (ROOT / "CHANGELOG.md").read_text("utf8"), re.M)
    assert newest is not None
    assert newest[1] == PROJECT["version"]
    assert importlib.metadata.version("esfem-core") == PROJECT["version"]


def test_vendored_plotly_is_the_one_that_plotly_for_python_draws_for():
    from plotly.offline import get_plotlyjs_version

    with (ROOT / "book/assets/plotly/plotly-gl3d.min.js").open(encoding="utf8") as script:
        head = script.read(200)
    assert f"plotly.js (gl3d - minified) v{get_plotlyjs_version()}" in head
