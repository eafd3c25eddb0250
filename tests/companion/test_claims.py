"""The verdict of a claim follows from its measurements, and from nothing else."""

import json
import math
from fractions import Fraction

import numpy as np
import pytest

from esfem_core.companion.claims import (
    CONFIRMED,
    CORRECTED,
    NOT_CONFIRMED,
    Claim,
    claim,
    measure,
    read_html,
)

GOOD = measure("good", 1.0, at_most=2.0)
BAD = measure("bad", 3.0, at_most=2.0)
NAN = measure("nan", math.nan, at_most=2.0)


@pytest.mark.parametrize(
    ("bounds", "holds"),
    [
        ({"at_least": 1.0}, True),
        ({"at_least": 1.0000001}, False),
        ({"at_most": 1.0}, True),
        ({"at_most": 0.9999999}, False),
        ({"at_least": 0.5, "at_most": 1.5}, True),
        ({"at_least": 1.5, "at_most": 2.5}, False),
        ({"equals": 1.0}, True),
        ({"equals": 1.1}, False),
        ({"equals": 1.1, "tol": 0.2}, True),
        ({"equals": 1.0, "at_most": 0.5}, False),
    ],
)
def test_bounds_are_closed_and_all_count(bounds, holds):
    assert measure("one", 1.0, **bounds).holds is holds


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(
    "bounds", [{"at_least": -1e300}, {"at_most": 1e300}, {"equals": 0, "tol": 1e300}]
)
def test_a_value_that_is_not_finite_never_holds(value, bounds):
    assert not measure("value", value, **bounds).holds


@pytest.mark.parametrize(
    "arguments",
    [
        {"name": "no bound"},
        {"name": "  ", "at_most": 1},
        {"name": "crossed", "at_least": 2, "at_most": 1},
        {"name": "tol alone", "at_most": 1, "tol": 0.1},
        {"name": "negative tol", "equals": 1, "tol": -0.1},
        {"name": "nan bound", "at_most": math.nan},
        {"name": "infinite bound", "at_most": math.inf},
        {"name": "infinite tol", "equals": 1, "tol": math.inf},
    ],
)
def test_measurements_that_could_not_fail_or_not_hold_are_refused(arguments):
    with pytest.raises(ValueError, match=r"measurement|expected|finite|number|tol"):
        measure(value=1.0, **arguments)


def test_bounds_are_real_numbers():
    with pytest.raises(TypeError, match="at_most of 'order' must be a finite number, got True"):
        measure("order", 1.0, at_most=True)
    with pytest.raises(ValueError, match="tol of 'order' must be a finite number >= 0, got -1"):
        measure("order", 1.0, equals=1, tol=-1)
    assert measure("order", 1.0, equals=Fraction(3, 2), tol=np.float32(0.5)).holds


@pytest.mark.parametrize(
    ("as_printed", "corrected", "verdict"),
    [
        ([GOOD], [], CONFIRMED),
        ([GOOD, GOOD], [BAD], CONFIRMED),
        ([GOOD, BAD], [], NOT_CONFIRMED),
        ([BAD], [GOOD], CORRECTED),
        ([GOOD, NAN], [GOOD], CORRECTED),
        ([BAD], [GOOD, BAD], NOT_CONFIRMED),
        ([BAD], [NAN], NOT_CONFIRMED),
        ([NAN], [], NOT_CONFIRMED),
    ],
)
def test_verdict(as_printed, corrected, verdict):
    assert claim("N-2.22-delta", *as_printed, corrected=corrected).verdict == verdict


@pytest.mark.parametrize(
    "bad",
    [
        "",
        "2.22-delta",
        "N-2.22",
        "N-2.22-Delta",
        "n-2.22-delta",
        "N-2.-x",
        "N-2.22-a b",
        "N-2-22-delta",
    ],
)
def test_malformed_ids_are_refused(bad):
    with pytest.raises(ValueError, match="is not a claim id"):
        claim(bad, GOOD)


@pytest.mark.parametrize(
    "good", ["N-2.22-delta", "LMV-6.1-level-set", "N-T2.1-time", "N-2.11.1-velocity", "N-R2-x"]
)
def test_wellformed_ids(good):
    assert claim(good, GOOD).id == good


def test_a_claim_without_measurements_is_refused():
    with pytest.raises(ValueError, match="at least one measurement"):
        claim("N-2.22-delta", corrected=[GOOD])
    with pytest.raises(ValueError, match="expected measure"):
        claim("N-2.22-delta", True)


def test_what_a_notebook_shows_can_be_read_back():
    inf = measure('"inf" & <co>', math.inf, at_most=1)
    c = claim("N-2.22-delta", GOOD, inf, corrected=[GOOD], note="why <b>'so'</b>")
    d = claim("N-2.1-x", NAN)
    first, second = read_html(c._repr_html_() + "<p>data-claim</p>" + d._repr_html_())
    assert first == c
    assert second.verdict == NOT_CONFIRMED
    assert "confirmed with a correction" in repr(c)
    assert "&lt;b&gt;" in c._repr_html_()
    assert 'id="check-N-2_22-delta"' in c._repr_html_()
    assert 'href="ledger.html#claim-N-2_22-delta"' in c._repr_html_()


def test_the_data_hold_no_verdict_and_are_strict_json():
    data = json.dumps(claim("N-2.22-delta", NAN).to_dict(), allow_nan=False)
    assert "confirmed" not in data
    assert Claim.from_dict(json.loads(data)).verdict == NOT_CONFIRMED
