"""Tables of errors and observed orders."""

import numpy as np
import pytest

import esfem_core as ec
from esfem_core.study import ConvergenceTable, final, observed_orders


def test_observed_orders_of_powers():
    h = np.array([1, 0.5, 0.3, 0.1])
    np.testing.assert_allclose(observed_orders(h, 7 * h**2.5), 2.5, rtol=1e-12)


def test_final():
    assert final(ec.State(t, None, None, None) for t in range(3)).t == 2
    with pytest.raises(ValueError, match="there are no states"):
        final([])


def test_table_shows_sizes_errors_and_orders():
    table = ConvergenceTable("h", np.array([0.2, 0.1]), {"u_l2": np.array([4e-3, 1e-3])})
    assert str(table).split() == [
        "h",
        "u_l2",
        "order",
        "0.2",
        "4.00e-03",
        "0.1",
        "1.00e-03",
        "2.00",
    ]
    html = table._repr_html_()
    assert html.count("<tr>") == 3
    assert "<td>2.00</td>" in html
    assert table.select("u_l2").errors.keys() == {"u_l2"}
    with pytest.raises(KeyError):
        table.select("w")
