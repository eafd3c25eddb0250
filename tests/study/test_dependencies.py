"""A row depends on the code that its experiment reaches, and on no word beside it."""

import ast
import shutil

import pytest

from esfem_core.companion.experiments import EXPERIMENTS, expanding_sphere
from esfem_core.companion.experiments.theorem import nodal_sides
from esfem_core.stepping import bdf
from esfem_core.study import dependencies, environment
from esfem_core.study.user_code import code_of

MODULES = {
    "__init__": """
from house.walls import Wall, colour
""",
    "walls": '''
"""A docstring."""
from house import doors
from house.numbers import COUNT as HOW_MANY

class Wall:
    """A wall."""
    def area(self):
        # a comment
        return doors.width() * HOW_MANY

    def paint(self):
        return colour()

    def __len__(self):
        return 1

def colour():
    return "white"
''',
    "numbers": """
COUNT = 4
COUNT += 1
OTHER = 7
""",
    "doors": """
import house as h
TABLE = {"wide": h.colour}

def width():
    from house.numbers import OTHER
    return OTHER

def height():
    return 2
""",
    "start": """
import house as h

def build():
    if not HEIGHT:
        raise ValueError("no height")
    wall = h.Wall()
    if not wall:
        raise Halted("no wall")
    check_height(HEIGHT)
    require_width(wall)
    _warn_of_low_walls(HEIGHT)
    return wall.area()

def require_width(wall):
    if wall.area() < 1:
        raise Halted("no width")

def check_height(height):
    if height > 3:
        raise ValueError("too high")

def _warn_of_low_walls(height):
    if height < 1:
        print("too low")

class Halted(Exception):
    pass

HEIGHT = 2

def paint():
    return h.doors.TABLE
""",
}


@pytest.fixture
def house(tmp_path):
    """A package of five modules; a function changes one of them and returns the new hash."""
    package = tmp_path / "house"
    package.mkdir()

    def hash_with(name="walls", old="", new="", start="build"):
        assert old in MODULES[name]
        changed = {name: MODULES[name].replace(old, new)} if old else {}
        for module, text in (MODULES | changed).items():
            (package / f"{module}.py").write_text(text)
        dependencies._read.cache_clear()
        dependencies._definition.cache_clear()
        dependencies.hash_of.cache_clear()
        return dependencies.hash_of("house.start", start, package, whole=False)

    return hash_with


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("walls", "doors.width() * HOW_MANY", "HOW_MANY * doors.width()"),
        ("numbers", "COUNT = 4", "COUNT = 3"),
        ("numbers", "COUNT += 1", "COUNT += 2"),
        ("numbers", "OTHER = 7", "OTHER = 8"),
        ("doors", "return OTHER", "return -OTHER"),
        ("walls", "class Wall:", "print(1)\nclass Wall:"),
        ("walls", "return 1", "return 2"),
        ("start", "h.Wall()", "h.Wall(1)"),
        ("start", "raise Halted", "raise OSError"),
        ("start", "if not wall:", "if wall:"),
        ("start", "wall.area() < 1", "wall.area() < 2"),
    ],
)
def test_code_that_is_reached_counts(house, name, old, new):
    assert house(name, old, new) != house()


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("walls", '"""A wall."""', '"""Another wall."""'),
        ("walls", '"""A docstring."""', ""),
        ("walls", "# a comment", "# another"),
        ("walls", "return doors.width() * HOW_MANY", "return (doors.width()\n  * HOW_MANY)"),
        ("walls", "white", "black"),
        ("doors", "return 2", "return 3"),
        ("doors", "h.colour", "h.Wall"),
        ("walls", "return colour()", "return None"),
        ("start", '"no wall"', '"still no wall"'),
        ("start", "if not HEIGHT:", "if HEIGHT is None:"),
        ("start", "height > 3", "height > 4"),
        ("start", "height < 1", "height < 2"),
        ("start", "    _warn_of_low_walls(HEIGHT)\n", ""),
    ],
)
def test_words_checks_layout_and_code_that_is_not_reached_do_not(house, name, old, new):
    assert house(name, old, new) == house()


def test_another_function_reaches_other_code(house):
    assert house("walls", "white", "black", start="paint") != house(start="paint")
    assert house("doors", "return 2", "return 3", start="paint") == house(start="paint")


def test_what_is_not_defined_in_the_package_is_refused():
    for function in (shutil.copy, dependencies.code_hash.__class__):
        with pytest.raises(ValueError, match="is not defined at the top of a module of esfem_core"):
            dependencies.code_hash(function)


def test_an_experiment_depends_on_solver_and_scheme_and_not_on_pictures_or_claims():
    modules = dependencies.reached(nodal_sides)
    assert {"esfem_core.stepping.scheme", "esfem_core.elements.integrals"} <= set(modules)
    assert not any(".output" in name or ".claims" in name for name in modules)
    assert not any("campaign" in name or "scheduling" in name for name in modules)
    assert dependencies.reached(bdf.delta) == ["esfem_core.checks", "esfem_core.stepping.bdf"]


@pytest.mark.parametrize("experiment", EXPERIMENTS, ids=lambda e: e.name)
def test_a_row_names_the_code_of_its_experiment(experiment):
    code = code_of(experiment.compute)
    assert code == dependencies.code_hash(experiment.compute)
    assert environment.environment(code)["esfem_core"].endswith(f", source {code}")


def test_a_module_as_a_whole_counts_with_all_that_is_in_it(monkeypatch):
    code = dependencies.hash_of_all("esfem_core.laws")
    assert code != dependencies.hash_of_all("esfem_core.laws.fixed")
    real = dependencies._definition

    def changed(module, name, package):
        found = real(module, name, package)
        return found._replace(code="") if (module, name) == place else found

    monkeypatch.setattr(dependencies, "_definition", changed)
    whole = dependencies.hash_of_all.__wrapped__
    place = "esfem_core.laws.slip", "Elastic"
    assert whole("esfem_core.laws") != code
    place = "esfem_core.study.cases", "run"
    assert whole("esfem_core.laws") == code


NOT_COUNTED = [
    (path.name, node)
    for path in sorted(dependencies.PACKAGE.rglob("*.py"))
    for node in ast.walk(ast.parse(path.read_text("utf8")))
    if isinstance(node, ast.FunctionDef)
    and node.name.lstrip("_").startswith(dependencies.UNCOUNTED)
]


@pytest.mark.parametrize(("file", "function"), NOT_COUNTED, ids=[f.name for _, f in NOT_COUNTED])
def test_a_function_that_does_not_count_refuses_input_warns_or_permits(file, function):
    """No result, no change, and no error that ends a run or sends an algorithm another way."""
    nodes = list(ast.walk(function))
    assert not any(n.value for n in nodes if isinstance(n, ast.Return)), f"{file} returns"
    kept = [n for n in nodes if isinstance(n, ast.Attribute) and isinstance(n.ctx, ast.Store)]
    assert not kept, f"{file} changes what it belongs to"
    raised = {n.exc.func.id for n in nodes if isinstance(n, ast.Raise) and n.exc}
    assert raised <= {"TypeError", "ValueError"}, file
    named = {n.attr if isinstance(n, ast.Attribute) else n.id for n in nodes
             if isinstance(n, ast.Attribute | ast.Name)}  # fmt: skip
    assert not any(name.lstrip("_").startswith("require_") for name in named), file


def test_what_ends_a_run_counts_for_an_experiment_that_stores_this():
    compute = expanding_sphere.errors_at_end
    key = compute.__module__, compute.__qualname__, dependencies.PACKAGE, False
    found = {name for _, name in dependencies._closure(*key)}
    assert {"Guard.look_at_surface", "Guard._look_inside", "Guard.look_at_functions"} <= found
    assert {"require_small_residual", "require_solved", "_require_definite"} <= found
    assert not {"Guard.warn_of_folds", "fold_of", "check_law"} & found
