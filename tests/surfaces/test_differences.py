"""Central differences: exact weights, exact polynomials, orders."""

from fractions import Fraction

import numpy as np
import pytest

from esfem_core.study import observed_orders
from esfem_core.surfaces import central_stencil, derivative


def test_weights_of_order_eight_are_the_textbook_ones():
    expected = {1: Fraction(4, 5), 2: Fraction(-1, 5), 3: Fraction(4, 105), 4: Fraction(-1, 280)}
    stencil = dict(central_stencil(8))
    assert list(stencil) == [-4, -3, -2, -1, 1, 2, 3, 4]
    for j, weight in expected.items():
        assert stencil[j] == float(weight)
        assert stencil[-j] == -float(weight)


@pytest.mark.parametrize("order", [2, 4, 6, 8])
def test_polynomials_are_differentiated_exactly_up_to_the_order_and_no_further(order):
    # At integers all values are integers, so nothing but the weights is rounded.
    for degree in range(order + 1):
        found = derivative(lambda s, n=degree: s**n, 2.0, order=order, step=1.0)
        assert found == pytest.approx(degree * 2.0 ** (degree - 1), rel=1e-13, abs=1e-14)
    gap = derivative(lambda s: s ** (order + 1), 0.0, order=order, step=1.0)
    assert abs(gap) > 0.9


@pytest.mark.parametrize("order", [2, 4, 6])
def test_the_error_is_of_the_stated_order(order):
    steps = np.array([0.2, 0.1])
    errors = [abs(derivative(np.exp, 0.5, order=order, step=step) - np.exp(0.5)) for step in steps]
    assert observed_orders(steps, errors)[0] == pytest.approx(order, abs=0.05)


def test_values_keep_their_shape():
    matrix = np.array([[1.0, 2.0], [3.0, 4.0]])
    found = derivative(lambda s: np.sin(s) * matrix)
    assert found.shape == (2, 2)
    np.testing.assert_allclose(found, matrix, rtol=1e-13)


def test_a_function_may_return_the_same_array_each_time():
    array = np.zeros(2)

    def written(s):
        array[:] = s, s * s
        return array

    np.testing.assert_allclose(derivative(written, 3.0), [1, 6], rtol=1e-12)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"order": 3}, ValueError, "order of a central difference must be even, got 3"),
        ({"order": 0}, ValueError, "order must be an integer >= 2, got 0"),
        ({"order": "2"}, TypeError, "order must be an integer >= 2, got '2'"),
        ({"step": 0}, ValueError, "step must be a finite number > 0, got 0"),
        ({"t": np.nan}, ValueError, "t must be a finite number, got nan"),
    ],
)
def test_what_is_no_stencil_is_refused_by_name(options, error, message):
    with pytest.raises(error, match=message):
        derivative(np.sin, **options)
