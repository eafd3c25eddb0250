"""The verdict of a claim follows from its measurements, and from nothing else."""

import json
import math
from fractions import Fraction
from typing import get_args

import numpy as np
import pytest

from esfem_core.companion import claims
from esfem_core.companion.claims import (
    CONFIRMED,
    DIFFERS,
    PROOF_ONLY,
    SIGNS,
    Claim,
    Kind,
    claim,
    measure,
    measure_order,
    read_html,
)

GOOD = measure("good", 1.0, at_most=2.0)
BAD = measure("bad", 3.0, at_most=2.0)
NAN = measure("nan", math.nan, at_most=2.0)
ID = "N-2.22-delta"


@pytest.fixture(autouse=True)
def _no_book(monkeypatch):
    """Take the book's own verdicts away: the claims here are none of its claims."""
    monkeypatch.setattr(claims, "accepted", dict)
    monkeypatch.delenv(claims.STRICT, raising=False)


@pytest.mark.parametrize(
    ("bounds", "holds"),
    [
        ({"at_least": 1.0}, True),
        ({"at_least": 1.0000001}, False),
        ({"at_most": 1.0}, True),
        ({"at_most": 0.9999999}, False),
        ({"at_least": 0.5, "at_most": 1.5}, True),
        ({"at_least": 1.5, "at_most": 2.5}, False),
        ({"at_least": 1.0, "at_most": 1.0}, True),
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


@pytest.mark.parametrize("value", ["1.5", "abc", None, 1 + 0j, np.array([1.0, 2.0])])
def test_a_value_that_is_no_number_is_refused(value):
    with pytest.raises(TypeError, match="the value of 'order' must be a number, got"):
        measure("order", value, at_least=1)


def test_what_is_no_measurement_no_id_and_no_note_is_named():
    with pytest.raises(
        TypeError, match="corrected must be a sequence of measurements, got Measure"
    ):
        claim("N-2.22-delta", BAD, corrected=GOOD, kind="misprint")
    with pytest.raises(TypeError, match="id must be a string, got 3"):
        claim(3, GOOD)
    with pytest.raises(TypeError, match="note must be a string, got 3"):
        claim("N-2.22-delta", BAD, kind="contradicted", note=3)
    with pytest.raises(TypeError, match="name must be a string, got 3"):
        measure(3, 1.0, at_most=2)


def test_bounds_are_real_numbers():
    with pytest.raises(TypeError, match="at_most of 'order' must be a finite number, got True"):
        measure("order", 1.0, at_most=True)
    with pytest.raises(ValueError, match="tol of 'order' must be a finite number >= 0, got -1"):
        measure("order", 1.0, equals=1, tol=-1)
    assert measure("order", 1.0, equals=Fraction(3, 2), tol=np.float32(0.5)).holds


def test_an_order_claimed_as_observed_is_bounded_from_both_sides():
    orders = {2.7: False, 2.75: True, 3.0: True, 3.25: True, 3.3: False}
    assert {o: measure_order("x", o, 3).holds for o in orders} == orders
    assert not measure_order("x", math.nan, 3).holds
    uneven = measure_order("x", 3.4, 3, below=0.1, above=0.5)
    assert (uneven.at_least, uneven.at_most) == (2.9, 3.5)
    uneven = measure_order("x", 3.4, 3, below=0.5, above=0.1)
    assert (uneven.at_least, uneven.at_most) == (2.5, 3.1)
    with pytest.raises(ValueError, match="below of 'x' must be a finite number >= 0, got -1"):
        measure_order("x", 3.0, 3, below=-1)


@pytest.mark.parametrize(
    ("as_printed", "corrected", "kind", "verdict"),
    [
        ([GOOD], [], None, CONFIRMED),
        ([GOOD, GOOD], [], None, CONFIRMED),
        ([BAD], [GOOD], "misprint", "misprint"),
        ([GOOD, NAN], [GOOD, GOOD], "restricted", "restricted"),
        ([BAD], [], "contradicted", "contradicted"),
        ([BAD], [GOOD], "contradicted", "contradicted"),
        ([NAN], [], "not reproduced", "not reproduced"),
    ],
)
def test_the_verdict_is_confirmed_or_the_kind_of_a_failure(as_printed, corrected, kind, verdict):
    found = claim(ID, *as_printed, corrected=corrected, kind=kind, note="why")
    assert found.verdict == verdict


@pytest.mark.parametrize(
    ("as_printed", "corrected", "kind", "message"),
    [
        ([BAD], [], None, "fails as printed and does not say its kind"),
        ([GOOD, NAN], [], None, "fails as printed and does not say its kind"),
        ([BAD], [GOOD], None, "fails as printed and does not say its kind"),
        ([GOOD], [], "contradicted", "holds as printed, and has nothing to correct"),
        ([GOOD], [GOOD], "misprint", "holds as printed, and has nothing to correct"),
        ([GOOD], [GOOD], None, "holds as printed, and has nothing to correct"),
        ([BAD], [GOOD, BAD], "misprint", "fails in its corrected form"),
        ([BAD], [NAN], "restricted", "fails in its corrected form"),
        ([BAD], [BAD], "not reproduced", "fails in its corrected form"),
    ],
)
def test_measurements_that_do_not_bear_out_the_verdict_end_a_strict_run_and_are_told_otherwise(
    as_printed, corrected, kind, message, monkeypatch, capsys
):
    found = claim(ID, *as_printed, corrected=corrected, kind=kind, note="why")
    assert capsys.readouterr().out == f"claim {ID} {message}\n"
    assert found.verdict == DIFFERS
    assert repr(found).startswith(f"? {ID}: differs from the book")
    assert "differs from the book" in found._repr_html_()
    monkeypatch.setenv(claims.STRICT, "1")
    with pytest.raises(AssertionError, match=f"claim {ID} {message}"):
        claim(ID, *as_printed, corrected=corrected, kind=kind, note="why")


@pytest.mark.parametrize(
    ("as_printed", "corrected", "kind", "message"),
    [
        ([BAD], [], None, "fails as printed"),
        ([GOOD], [GOOD], "misprint", "holds as printed"),
        ([BAD], [BAD], "misprint", "fails in its corrected form"),
    ],
)
def test_a_reader_is_told_the_verdict_that_other_parameters_do_not_bear_out(
    as_printed, corrected, kind, message, monkeypatch, capsys
):
    verdict = kind or CONFIRMED
    monkeypatch.setattr(claims, "accepted", lambda: {ID: verdict})
    claim(ID, *as_printed, corrected=corrected, kind=kind)
    assert capsys.readouterr().out == (
        f'differs from the book: claim {ID} is "{verdict}" there, '
        "which the numbers measured here do not bear out\n"
    )
    monkeypatch.setenv(claims.STRICT, "1")
    with pytest.raises(AssertionError, match=f"^claim {ID} {message}"):
        claim(ID, *as_printed, corrected=corrected, kind=kind)


def test_what_fails_is_told_with_its_numbers(monkeypatch):
    monkeypatch.setenv(claims.STRICT, "1")
    with pytest.raises(AssertionError) as error:
        claim(ID, GOOD, BAD)
    assert str(error.value).splitlines()[1:] == ["  good = 1 (≤ 2) ✓", "  bad = 3 (≤ 2) ✗"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"kind": "misprint", "note": "why"}, "measure what holds instead"),
        ({"kind": "restricted", "note": "why"}, "measure what holds instead"),
        ({"kind": "contradicted"}, r"say what holds instead, in corrected=\[...\] or a note"),
        ({"kind": "not reproduced"}, r"say what holds instead, in corrected=\[...\] or a note"),
        (
            {"kind": "not confirmed", "note": "why"},
            f'kind of claim {ID} must be "contradicted", "not reproduced", "restricted" or '
            "\"misprint\", got 'not confirmed'",
        ),
    ],
)
def test_a_failure_says_what_holds_instead(arguments, message):
    with pytest.raises(ValueError, match=message):
        claim(ID, BAD, **arguments)


def test_every_verdict_has_a_sign_of_its_own():
    assert set(SIGNS) == {*get_args(Kind), CONFIRMED, PROOF_ONLY}
    assert len(set(SIGNS.values())) == len(SIGNS)


def test_a_verdict_that_is_not_the_accepted_one_is_told_and_ends_a_strict_run(monkeypatch, capsys):
    monkeypatch.setattr(claims, "accepted", lambda: {ID: "misprint", "N-2.1-other": CONFIRMED})
    claim(ID, BAD, corrected=[GOOD], kind="misprint")
    assert capsys.readouterr().out == ""
    claim(ID, GOOD)
    claim("N-2.1-new", GOOD)
    assert capsys.readouterr().out.splitlines() == [
        f"claim {ID}: confirmed here, misprint in the book",
        "claim N-2.1-new: confirmed here, unknown in the book",
    ]
    monkeypatch.setenv(claims.STRICT, "1")
    claim(ID, BAD, corrected=[GOOD], kind="misprint")
    with pytest.raises(AssertionError, match=f"claim {ID}: confirmed here, misprint in the book"):
        claim(ID, GOOD)
    with pytest.raises(AssertionError, match="confirmed here, unknown in the book"):
        claim("N-2.1-new", GOOD)


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
    c = claim(ID, GOOD, inf, corrected=[GOOD], kind="restricted", note="why <b>'so'</b>")
    d = claim("N-2.1-x", NAN, kind="not reproduced", note="no number")
    first, second = read_html(c._repr_html_() + "<p>data-claim</p>" + d._repr_html_())
    assert first == c
    assert second.verdict == "not reproduced"
    assert f"⊂ {ID}: restricted" in repr(c)
    assert "  restricted: good = 1 (≤ 2) ✓" in repr(c)
    assert 'class="esfem-claim esfem-not-reproduced"' in d._repr_html_()
    assert "&lt;b&gt;" in c._repr_html_()
    assert 'id="check-N-2_22-delta"' in c._repr_html_()
    assert 'href="ledger.html#claim-N-2_22-delta"' in c._repr_html_()


def test_the_data_are_strict_json_and_are_checked_when_read():
    found = claim(ID, NAN, kind="contradicted", note="no number")
    data = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert Claim.from_dict(data).verdict == "contradicted"
    with pytest.raises(AssertionError, match="does not say its kind"):
        Claim.from_dict(data | {"kind": None})


def test_the_link_of_a_check_is_escaped():
    check = claims.Claim('N-2.1-"><b>', (GOOD,))
    assert "<b>" not in check._repr_html_()
