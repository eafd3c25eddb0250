"""The plan of the house: rooms import from rooms before them, and only what those hand out."""

import ast
from pathlib import Path

import pytest

import esfem_core

PACKAGE = Path(esfem_core.__file__).parent
ORDER = [
    "checks",
    "tables",
    "solvers",
    "surfaces",
    "elements",
    "laws",
    "problems",
    "stepping",
    "errors",
    "theory",
    "study",
    "output",
    "companion",
]
FILES = sorted(
    path for path in PACKAGE.rglob("*.py") if path.parent != PACKAGE or path.stem in ORDER
)


def name_of(path):
    """Dotted name of a module inside the package, such as ``surfaces.check``."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


SOURCES = {name_of(path): path.read_text("utf8") for path in FILES}


def imports(source, module="?"):
    """Pairs of a module of the package, and a name imported from it or None."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module} imports by a relative path"
            head, _, rest = (node.module or "").partition(".")
            if head == "esfem_core":
                yield from ((rest, alias.name) for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (
                (alias.name.partition(".")[2], None)
                for alias in node.names
                if alias.name.partition(".")[0] == "esfem_core"
            )


def handed_out(source):
    """The names in ``__all__``."""
    for node in ast.parse(source).body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__":
            return set(ast.literal_eval(node.value))
    return set()


def faults(module, source, sources):
    """What is wrong with the imports of a module."""
    room = module.partition(".")[0]
    before = ORDER[: ORDER.index(room)]
    for origin, name in imports(source, module):
        if not origin:
            # `import esfem_core as ec` sees the public face, so only the last room may.
            if name in ORDER:
                origin, name = name, None
            elif room == "companion":
                continue
            else:
                yield f"{module} imports the whole package"
                continue
        other = origin.partition(".")[0]
        if other == room:
            continue
        if other not in before:
            yield f"{module} imports from {other}, which is not before {room}"
        elif name is not None and name not in handed_out(sources[origin]):
            yield f"{module} imports {name}, which {origin} does not hand out"
        elif "." in origin and origin.split(".")[1] not in handed_out(sources[other]):
            yield f"{module} reaches into {origin}, which {other} does not hand out"


def circle(graph):
    """Modules that import each other in a circle, or nothing."""
    done, path = set(), []

    def walk(module):
        if module in path:
            return path[path.index(module) :]
        if module in done:
            return []
        path.append(module)
        for other in sorted(graph.get(module, ())):
            if found := walk(other):
                return found
        path.pop()
        done.add(module)
        return []

    return next((found for module in sorted(graph) if (found := walk(module))), [])


@pytest.mark.parametrize("module", SOURCES)
def test_imports_come_from_rooms_before(module):
    assert list(faults(module, SOURCES[module], SOURCES)) == []


def test_every_module_has_a_room():
    assert {module.partition(".")[0] for module in SOURCES} <= set(ORDER)
    assert {p.name for p in PACKAGE.iterdir() if p.suffix == ".py"} <= {
        "__init__.py",
        *(f"{room}.py" for room in ORDER),
    }


def test_no_circle():
    graph = {}
    for module, source in SOURCES.items():
        for origin, name in imports(source, module):
            target = f"{origin}.{name}" if f"{origin}.{name}" in SOURCES else origin
            # A room's __init__ collects its modules: that is not a circle.
            if target and module.partition(".")[0] != target:
                graph.setdefault(module, set()).add(target)
    assert circle(graph) == []


def test_the_rules_can_be_broken():
    sources = {"solvers": '__all__ = ["superlu"]', "elements": '__all__ = ["space"]'}
    for line, word in [
        ("from esfem_core.theory import forms", "not before"),
        ("from esfem_core.solvers import _rows", "does not hand out"),
        ("from esfem_core.solvers.lagged import price", "does not hand out"),
        ("import esfem_core as ec", "whole package"),
    ]:
        extra = sources | {"solvers.lagged": '__all__ = ["price"]', "theory": ""}
        assert any(word in fault for fault in faults("elements.space", line, extra)), line
    assert list(faults("elements.space", "from esfem_core.solvers import superlu", sources)) == []
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c"]
