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


@pytest.mark.parametrize(
    "always_true", [lambda: False, (x > 1 for x in (0, 1)), iter([False]), max]
)
def test_what_is_true_whatever_it_says_is_no_statement(always_true):
    with pytest.raises(TypeError, match="holds must be a truth value, got"):
        expect(always_true, "the order is 3")


def test_arguments_in_the_wrong_order_are_refused():
    with pytest.raises(TypeError, match="statement must be a string, got False"):
        expect("the order is 3", False)
