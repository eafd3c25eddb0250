"""The comparison of two builds sees what differs, and only that."""

import pytest
import same_digits
from bs4 import BeautifulSoup

from esfem_core.companion.claims import claim, measure


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


def test_rounding_and_times_are_no_difference(compared):
    other = page(value=0.25 + 1e-10, printed="0.126", time="5 ms")
    assert compared(page(), other) == (3, [])
    assert BeautifulSoup(other, "html.parser").select("[data-claim]")


def test_pages_about_times_are_left_out_and_missing_ones_named(compared, tmp_path):
    assert compared(page(), page(value=0.5), "status.html") == (0, [])
    (tmp_path / "one" / "more.html").write_text(page())
    assert compared(page(), page())[1] == ["more.html: only in one of them"]
