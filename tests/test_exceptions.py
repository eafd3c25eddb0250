"""Exceptions and warnings of the package come back from other processes as what they were."""

import copy
import importlib
import inspect
import pickle
import pkgutil

import numpy as np
import pytest

import esfem_core as ec
from esfem_core.study import run

ARGUMENTS = {
    "ElementError": ("no area", 3),
    "DegenerateElementError": ("no area", 3),
    "NotFiniteError": ("no number", 3),
    "EvolutionError": ("it broke", 7, 0.35, 12),
    "EvolutionWarning": ("it folds",),
    "MeshingError": ("not good",),
    "TooCoarseError": ("too large", np.eye(3)),
    "StudyWarning": ("it failed",),
    "UnsavedRowsError": ("no room", ["a row"]),
    "WorkerLostError": ("killed", False),
}


def classes():
    """All that the package can raise or warn with."""
    for found in pkgutil.walk_packages(ec.__path__, "esfem_core."):
        if not found.name.endswith("__main__"):
            module = importlib.import_module(found.name)
            for _, kind in inspect.getmembers(module, inspect.isclass):
                if issubclass(kind, Exception) and kind.__module__ == found.name:
                    yield kind


CLASSES = {kind.__name__: kind for kind in classes()}


def test_all_classes_are_tried():
    assert CLASSES.keys() == ARGUMENTS.keys()


@pytest.mark.parametrize("name", ARGUMENTS)
@pytest.mark.parametrize(
    "back", [lambda error: pickle.loads(pickle.dumps(error)), copy.copy, copy.deepcopy]
)
def test_pickles_and_copies_keep_text_attributes_and_notes(name, back):
    error = CLASSES[name](*ARGUMENTS[name])
    error.add_note("seen before")
    again = back(error)
    assert (type(again), str(again)) == (type(error), str(error))
    np.testing.assert_equal(vars(again), vars(error))
    assert again.__notes__ == ["seen before"]


def flat(size):
    space = ec.SurfaceSpace(ec.sphere("octahedron", 0))
    return {"mass": space.mass(size * np.ones((6, 3))).sum()}


def test_a_study_knows_the_element_where_a_case_failed(tmp_path):
    with pytest.warns(UserWarning, match="1 of the cases failed"):
        [failure] = run([{"size": 1.0}], flat, tmp_path, workers=0, progress=False).failures
    assert (type(failure.error), failure.error.element) == (ec.DegenerateElementError, 0)
