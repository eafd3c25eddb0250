"""What chapters state: an error in the build, a sentence for a reader."""

import numpy as np
import pytest

from esfem_core.companion import expect


@pytest.mark.parametrize("false", [False, np.False_, np.array([False]), 0])
def test_a_reader_is_told_and_goes_on(monkeypatch, capsys, false):
    monkeypatch.delenv("ESFEM_STRICT", raising=False)
    expect(false, "the order is 3")
    assert capsys.readouterr().out == (
        'differs from the book: "the order is 3" does not hold here\n'
    )


def test_the_build_stops(monkeypatch):
    monkeypatch.setenv("ESFEM_STRICT", "1")
    expect(np.True_, "the order is 3")
    with pytest.raises(AssertionError, match="the order is 3"):
        expect(False, "the order is 3")


def test_many_truth_values_are_refused():
    with pytest.raises(ValueError, match="one truth value, got an array"):
        expect(np.array([True, False]), "all of them")
