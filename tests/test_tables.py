"""Tables for people: what does not fit is refused."""

import pytest

from esfem_core.tables import html_table, text_table


@pytest.mark.parametrize("table", [html_table, text_table])
@pytest.mark.parametrize(("row", "found"), [(["0.99"], 1), (["1", "0.99", "more"], 3), ([], 0)])
def test_a_row_that_does_not_fit_the_header_is_refused(table, row, found):
    with pytest.raises(ValueError, match=rf"rows\[1\] must have 2 cells, .* got {found}$"):
        table(["p", "order"], [["1", "0.99"], row])


def test_a_table_may_be_empty():
    assert repr(html_table(["p", "order"], [])) == "p order"
