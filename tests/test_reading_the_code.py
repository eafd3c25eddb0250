"""The API pages and the page that leads through the code know all of it, in its order."""

import re

import pytest
import sources
import yaml
from sources import (
    PACKAGE,
    Lines,
    Place,
    cited,
    first_line,
    handed_out,
    home,
    imports,
    modules,
)
from test_rooms import ORDER

BOOK = sources.ROOT.parent / "book"
TOC = yaml.safe_load((sources.ROOT.parent / "_toc.yml").read_text("utf8"))
ROOMS = [room for room in ORDER if sources.path_of(f"{PACKAGE}.{room}").exists()]
READING = (BOOK / "reading_the_code.md").read_text("utf8")
PATH = re.findall(rf"^   ({PACKAGE}[\w.]+)$", READING, re.M)
TABLE = re.findall(r"^\| (\[(?:N|LMV)\][^|]*) \| ([^|]*) \|", READING, re.M)


def documented(page):
    return re.findall(r"automodule:: (\S+)", (BOOK / page).read_text("utf8"))


def test_the_api_has_a_page_for_each_room_in_their_order():
    (api,) = (c for part in TOC["parts"] for c in part["chapters"] if c["file"] == "book/api")
    assert [section["file"] for section in api["sections"]] == [f"book/api/{r}" for r in ROOMS]
    assert documented("api.md") == [PACKAGE]


@pytest.mark.parametrize("room", ROOMS)
def test_the_page_of_a_room_documents_each_module_once(room):
    found = documented(f"api/{room}.md")
    assert found[0] == f"{PACKAGE}.{room}"
    assert sorted(found) == modules(f"{PACKAGE}.{room}")


def too_early(order):
    """Modules of a list, each with one that it imports from and that stands only after it."""
    places = {module: i for i, module in enumerate(order)}
    return [
        (module, used)
        for module in order
        for _, origin, name in imports(module)
        for used in (origin, f"{origin}.{name}", home(f"{origin}.{name}").rpartition(".")[0])
        if places.get(used, -1) > places[module]
    ]


@pytest.mark.parametrize("room", ROOMS)
def test_a_module_is_documented_after_those_it_uses(room):
    found = documented(f"api/{room}.md")
    assert too_early([m for m in found if sources.path_of(m).stem != "__init__"]) == []


@pytest.mark.parametrize("room", [PACKAGE, *(f"{PACKAGE}.{room}" for room in ROOMS)])
def test_what_a_room_hands_out_is_documented_by_its_module(room):
    for name in handed_out(room):
        module, inside = sources.split(home(f"{room}.{name}"))
        assert not inside or inside in handed_out(module), f"{name} is not in {module}.__all__"


def test_the_reading_path_goes_one_way():
    assert PATH[0] == "esfem_core.surfaces.shapes"
    assert PATH[-1] == "esfem_core.stepping.run"
    assert too_early(PATH) == []
    assert too_early(PATH[::-1]) != []


def test_the_plan_shows_the_rooms_in_their_order():
    (plan,) = re.findall(r"\.\. house::\n\n((?: .*\n)+)", READING)
    assert plan.split() == ROOMS


@pytest.mark.parametrize(("where", "code"), TABLE)
def test_the_code_names_the_equation_that_it_is_said_to_implement(where, code):
    named = re.findall(r"`~([\w.]+)`", code)
    assert named
    for name in named:
        module, _ = sources.split(name)
        assert {place for _, place in sources.places(where)} <= set(cited(module)), module


def test_the_equations_of_a_step_are_all_there():
    shown = {str(place) for where, _ in TABLE for _, place in sources.places(where)}
    assert {"[N] (2.18)", "[N] (2.19)", "[N] (2.20)", "[N] (2.21)", "[N] (2.22)"} <= shown


def test_places_of_the_papers_are_read_from_text():
    def read(text):
        return [str(place) for _, place in sources.places(text)]

    assert read("see [N] (2.19)-(2.21), with M") == ["[N] (2.19)", "[N] (2.20)", "[N] (2.21)"]
    assert read("[N] (2.22),\n    [LMV] (3.2)") == ["[N] (2.22)", "[LMV] (3.2)"]
    assert read("[LMV] Figures 1 and 2.") == ["[LMV] Figure 1", "[LMV] Figure 2"]
    assert read("[N] 7.3 and 7.4") == ["[N] Section 7.3", "[N] Section 7.4"]
    assert read("[N] (2.8), 3 steps; (2.9)") == ["[N] (2.8)"]
    assert read("the matrix [N] of 2.3") == []


def test_places_are_named_by_the_innermost_definition():
    named = cited("esfem_core.elements.space")
    assert named[Place("[N]", "Section", (2, 10))] == ["SurfaceSpace.mass_stiffness"]


def test_names_lead_home():
    assert home("esfem_core.evolve") == "esfem_core.stepping.run.evolve"
    assert home("esfem_core.bdf.delta") == "esfem_core.stepping.bdf.delta"
    assert home("esfem_core.SurfaceSpace.load") == "esfem_core.elements.space.SurfaceSpace.load"
    assert home("numpy.array") == "numpy.array"


@pytest.mark.parametrize("room", ["", *ROOMS])
def test_all_that_a_room_hands_out_says_what_it_is(room):
    module = f"{PACKAGE}.{room}".strip(".")
    silent = [n for n in handed_out(module) if not first_line(home(f"{module}.{n}"))]
    assert silent == []


@pytest.mark.parametrize(
    ("name", "module"),
    [
        ("measure", "stepping.measure"),
        ("repair", "surfaces.repair"),
        ("smooth", "surfaces.smooth"),
        ("manufactured", "problems.manufactured"),
    ],
)
def test_a_name_that_its_module_bears_leads_to_the_function(name, module):
    function = f"esfem_core.{module}.{name}"
    assert home(f"esfem_core.{name}") == home(f"esfem_core.{module}") == function
    assert home("esfem_core.bdf") == "esfem_core.stepping.bdf"


def test_docstrings_comments_and_blank_lines_are_no_code(tmp_path, monkeypatch):
    silent = '"""Doc.\n\nMore.\n"""\n\n# why\n'
    code = 'x = [  # here\n    1,\n]\n\n\ndef f():\n    """Doc."""\n    return x\n'
    (tmp_path / "small.py").write_text(silent + code)
    monkeypatch.setattr(sources, "ROOT", tmp_path)
    assert sources.lines("esfem_core.small") == Lines(14, 5)
