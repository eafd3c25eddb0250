"""Each public function with a wrong kind of each argument: what it says must help."""

import warnings

import numpy as np
import pytest
from door_table import doors
from doors import equal, helpful, same, wrong

MOST = 5  # wrong values of an argument here; `make fuzz` tries all
DOORS = {door.name: door for door in doors()}


@pytest.fixture(autouse=True)
def _pictures_are_closed():
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pyplot.switch_backend("agg")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
    pyplot.close("all")


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
