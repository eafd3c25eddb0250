"""Order conditions of delta and gamma, exactly."""

from fractions import Fraction

import numpy as np
import pytest

import esfem_core as ec
from esfem_core.stepping.bdf import delta_exact


@pytest.mark.parametrize("p", range(1, 13))
def test_delta_differentiates_polynomials_up_to_degree_p_exactly(p):
    """sum_j delta_j (-j)^m = [m = 1]; degree p + 1 misses by the known error constant."""
    d = delta_exact(p)
    for m in range(p + 1):
        assert sum(c * Fraction(-j) ** m for j, c in enumerate(d)) == (m == 1)
    miss = sum(c * Fraction(-j) ** (p + 1) for j, c in enumerate(d))
    assert abs(miss) == Fraction(np.prod(np.arange(1, p + 2, dtype=object)), p + 1)


@pytest.mark.parametrize("p", range(1, 13))
def test_gamma_extrapolates_polynomials_below_degree_p_exactly(p):
    g = [Fraction(int(c)) for c in ec.bdf.gamma(p)]
    for m in range(p):
        assert sum(c * Fraction(-j - 1) ** m for j, c in enumerate(g)) == (m == 0)
    assert sum(c * Fraction(-j - 1) ** p for j, c in enumerate(g)) != 0


def test_published_coefficients():
    np.testing.assert_array_equal(ec.bdf.delta(1), [1, -1])
    np.testing.assert_allclose(ec.bdf.delta(3), [11 / 6, -3, 3 / 2, -1 / 3], rtol=1e-16)
    np.testing.assert_allclose(
        ec.bdf.delta(6), [147 / 60, -6, 15 / 2, -20 / 3, 15 / 4, -6 / 5, 1 / 6], rtol=2e-16
    )
    np.testing.assert_array_equal(ec.bdf.gamma(1), [1])
    np.testing.assert_array_equal(ec.bdf.gamma(5), [5, -10, 10, -5, 1])


@pytest.mark.parametrize(("p", "stable"), [*((p, True) for p in range(1, 7)), (7, False)])
def test_zero_stability_ends_at_six(p, stable):
    roots = np.roots(ec.bdf.delta(p))  # in 1/zeta
    others = np.delete(roots, np.argmin(abs(roots - 1)))
    assert (np.abs(others) < 1).all() == stable


@pytest.mark.parametrize("p", [0, -1, 1.5])
@pytest.mark.parametrize("function", [ec.bdf.delta, ec.bdf.gamma])
def test_refuses(function, p):
    with pytest.raises(ValueError, match="order p must be an integer from 1 to 100"):
        function(p)


def test_no_more_values_are_extrapolated_than_there_are_coefficients_for():
    with pytest.raises(ValueError, match="values must be 100 or fewer, got 101"):
        ec.bdf.extrapolate([np.ones(1)] * 101)


@pytest.mark.parametrize(
    ("coefficients", "values", "message"),
    [
        ([1, 2], [np.ones((3, 3)), np.ones(3)], r"values\[1\] has \(3,\) and .* has \(3, 3\)"),
        ([1, 2], [np.ones(3), np.ones(1)], r"values\[1\] has \(1,\) and values\[0\] has \(3,\)"),
        ([1, 2], [np.ones(3), 1.0], r"values\[1\] has \(\) and values\[0\] has \(3,\)"),
        ([1, 2], [np.ones(3), np.ones((2, 3))], r"values\[1\] has \(2, 3\) and values\[0\]"),
        ([1, 2], [np.ones(3)], "one array for each of 2 coefficients, at least one, got 1"),
        ([], [], "one array for each of 0 coefficients, at least one, got 0"),
    ],
)
def test_what_cannot_be_combined_is_refused(coefficients, values, message):
    with pytest.raises(ValueError, match=message):
        ec.bdf.combine(coefficients, values)


@pytest.mark.parametrize(
    ("coefficient", "kind"), [(np.nan, ValueError), (1j, TypeError), ("a", TypeError)]
)
def test_coefficients_are_finite_real_numbers(coefficient, kind):
    with pytest.raises(kind, match=r"coefficients\[1\] must be a finite number, got "):
        ec.bdf.combine([1.0, coefficient], [np.ones(2), np.ones(2)])


def test_lists_and_integers_are_combined_as_arrays_of_floats_are():
    assert ec.bdf.combine([1, -1], [[3.0], [1.0]]).tolist() == [2.0]
    assert ec.bdf.combine([1, -0.5], [np.array([4]), np.array([1])]).tolist() == [3.5]
    with pytest.raises(TypeError, match=r"values\[1\] must hold real numbers"):
        ec.bdf.combine([1, 1], [np.ones(2), np.ones(2) * 1j])


def test_iterators_and_numbers_are_combined():
    assert ec.bdf.combine(iter([1.0, -1.0]), iter([3.0, 2.0])) == 1.0
    given = [np.array([1.0]), np.array([2.0])]
    assert ec.bdf.combine(ec.bdf.delta(1), given) == [-1.0]
    assert given[0] == [1.0]
