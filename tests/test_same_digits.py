"""The comparison of two builds sees what differs, and only that."""

import pytest
import same_digits
from bs4 import BeautifulSoup

from esfem_core.companion.claims import claim, measure
from esfem_core.tables import html_table


def page(value=0.25, printed="0.125", time="3 ms"):
    box = claim("N-2.22-delta", measure("error", value, at_most=1))._repr_html_()
    return (
        f'<div class="cell_output">{box}</div>'
        f'<div class="cell_output"><pre>order {printed}, 1,026 nodes\n{time}</pre></div>'
        '<div class="cell_output"><script>var x = 7</script></div>'
    )


@pytest.fixture
def compared(tmp_path):
    def differences(first, second, name="page.html"):
        for folder, text in (("one", first), ("two", second)):
            (tmp_path / folder).mkdir(exist_ok=True)
            (tmp_path / folder / name).write_text(text, "utf8")
        return same_digits.differences(tmp_path / "one", tmp_path / "two")

    return differences


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"value": 0.25 + 1e-8}, "page.html: N-2.22-delta: error: 0.25 and 0.25000001"),
        ({"printed": "0.127"}, "page.html: order 0.125, 1,026 nodes: 0.125 and 0.127"),
        ({"printed": "0.125 7"}, "page.html: not as many numbers in the one as in the other"),
    ],
)
def test_other_numbers_are_named(compared, change, message):
    _, found = compared(page(), page(**change))
    assert found == [message]


def test_an_order_may_differ_by_what_rounding_of_the_errors_makes_of_it(compared):
    def orders(name, value):
        return claim("N-2.22-delta", measure(name, value, at_least=2.9))._repr_html_()

    for name in ("k = 4: order of the gap", "p − observed orders"):
        assert compared(orders(name, 6.06375748), orders(name, 6.06375753)) == (1, [])
        assert compared(orders(name, 6.06375), orders(name, 6.06376))[1]
    gap = "gap, against order conditions"
    assert compared(orders(gap, 6.06375748), orders(gap, 6.06375753))[1]


def test_columns_of_run_times_are_left_out(compared):
    def table(amount, seconds):
        shown = html_table(["steps", "run time", "amount"], [["180", seconds, amount]])
        return f'<div class="cell_output">{shown._repr_html_()}</div>'

    assert compared(table("4.25", "15.0"), table("4.25", "13.3")) == (2, [])
    assert compared(table("4.25", "15.0"), table("4.28", "13.3"))[1] == [
        "page.html: 4.25: 4.25 and 4.28"
    ]


def test_rounding_and_times_are_no_difference(compared):
    other = page(value=0.25 + 1e-10, printed="0.126", time="5 ms")
    assert compared(page(), other) == (3, [])
    assert BeautifulSoup(other, "html.parser").select("[data-claim]")


def test_pages_about_times_are_left_out_and_missing_ones_named(compared, tmp_path):
    assert compared(page(), page(value=0.5), "status.html") == (0, [])
    (tmp_path / "one" / "more.html").write_text(page())
    assert compared(page(), page())[1] == ["more.html: only in one of them"]
