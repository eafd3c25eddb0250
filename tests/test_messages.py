"""Each function that a script calls, with wrong kinds of arguments: what it says must help."""

import inspect
import re
import warnings

import numpy as np
import pytest
from door_table import doors
from doors import equal, helpful, same, wrong

import esfem_core as ec
from esfem_core import theory

MOST = 5  # wrong values of an argument here; `make fuzz` tries all
DOORS = {door.name: door for door in doors()}
# With these, rooms look at arguments for each other.
AMONG_ROOMS = {
    *("check_initial", "check_law", "check_no_slip", "check_normal_and_curvature"),
    *("check_of_points", "check_of_surface", "finite_nodal", "positions_of"),
    *("same_species", "values_at"),
    *("root_of_form", "square_matrix", "unit_of"),
}


@pytest.fixture(autouse=True)
def _pictures_are_closed():
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pyplot.switch_backend("agg")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
    pyplot.close("all")


def test_every_function_of_the_package_itself_its_modules_and_the_theory_has_a_line():
    modules = [getattr(owner, name) for owner in (ec, theory) for name in owner.__all__]
    modules = [ec, *filter(inspect.ismodule, modules)]
    called = {
        name
        for module in modules
        for name in module.__all__
        if inspect.isfunction(getattr(module, name))
    }
    lines = {word for name in DOORS for word in re.findall(r"\w+", name)}
    assert len(called) > 90
    assert called - lines == AMONG_ROOMS


@pytest.mark.parametrize("name", DOORS)
def test_wrong_kinds_are_refused_by_a_message_that_helps(name):
    door = DOORS[name]
    good = {key: a.good for key, a in door.arguments.items() if not a.optional}
    for key, argument in door.arguments.items():
        values = wrong(argument)
        chosen = np.unique(np.linspace(0, len(values) - 1, MOST).astype(int))
        for shown, value in (values[i] for i in chosen):
            with pytest.raises(Exception) as found:
                door.function(**{**good, key: value})
            assert helpful(found.value, key, argument), f"{key} = {shown}: {found.value!r}"


@pytest.mark.parametrize("name", ["torus", "delta", "evolve", "seminorm", "Surface.integral"])
def test_numbers_and_arrays_of_other_kinds_give_the_same_result(name):
    door = DOORS[name]
    good = {key: a.good for key, a in door.arguments.items() if not a.optional}
    for key, argument in door.arguments.items():
        wanted = door.function(**{**good, key: argument.good})
        for shown, value in equal(argument):
            assert same(door.function(**{**good, key: value}), wanted), f"{key} = {shown}"
