"""Peano kernels against polynomials, smooth functions and the error constants."""

from fractions import Fraction
from math import factorial

import numpy as np
import pytest

from esfem_core.stepping import bdf
from esfem_core.theory import peano

ORDERS = range(1, 7)


def quotient_error(p, y, dy, t, tau):
    return bdf.delta(p) @ y(t - tau * np.arange(p + 1)) / tau - dy(t)


def extrapolation_error(p, y, t, tau):
    return bdf.gamma(p) @ y(t - tau * np.arange(1, p + 1)) - y(t)


def integral(kernel, derivative, t, tau):
    # Gauss-Legendre on each piece
    points, weights = np.polynomial.legendre.leggauss(20)
    p = len(kernel.x) - 1
    theta = np.arange(p)[:, None] + (points + 1) / 2
    return np.sum(weights / 2 * kernel(theta) * derivative(t - tau * theta))


@pytest.mark.parametrize("p", ORDERS)
def test_integrals_are_the_error_constants(p):
    assert abs(peano.bdf_kernel(p).integrate(0, p) + 1 / (p + 1)) < 1e-14
    assert abs(peano.extrapolation_kernel(p).integrate(0, p) + 1) < 1e-14


@pytest.mark.parametrize("p", ORDERS)
@pytest.mark.parametrize("m", range(4))
def test_errors_of_polynomials_are_exact(p, m):
    # y = t^(p+1+m) at t = 0 in exact arithmetic, against moments of the kernel
    n = p + 1 + m
    exact = sum(c * Fraction(-j) ** n for j, c in enumerate(bdf.delta_exact(p)))
    moments = integral(
        peano.bdf_kernel(p), lambda s: factorial(n) / factorial(m) * s**m, t=0.0, tau=1.0
    )
    assert moments == pytest.approx(float(exact), rel=1e-12)


@pytest.mark.parametrize("p", ORDERS)
def test_representation_for_a_smooth_function_and_every_degree(p):
    w, t, tau = 3.0, 0.4, 0.3
    y = lambda s: np.sin(w * s)  # noqa: E731

    def derivative(n):
        return lambda s: w**n * np.sin(w * s + n * np.pi / 2)

    for q in range(1, p + 1):
        error = quotient_error(p, y, derivative(1), t, tau)
        kernel = peano.bdf_kernel(p, q)
        assert tau**q * integral(kernel, derivative(q + 1), t, tau) == pytest.approx(error)
        error = extrapolation_error(p, y, t, tau)
        kernel = peano.extrapolation_kernel(p, q)
        assert tau**q * integral(kernel, derivative(q), t, tau) == pytest.approx(error)


def test_kernels_in_closed_form():
    theta = np.linspace(0, 1, 5)[:-1]
    assert np.allclose(peano.bdf_kernel(1)(theta), theta - 1, atol=1e-15)  # backward Euler
    assert np.allclose(peano.extrapolation_kernel(1)(theta), -1, atol=1e-15)
    assert np.allclose(peano.extrapolation_kernel(2)(1 + theta), theta - 1, atol=1e-15)


@pytest.mark.parametrize("kernel", [peano.bdf_kernel, peano.extrapolation_kernel])
def test_orders_and_degrees_out_of_range_are_refused(kernel):
    with pytest.raises(ValueError, match="p must be an integer from 1 to 30, got 0"):
        kernel(0)
    for degree in (0, 4, 1.5):
        with pytest.raises(
            ValueError, match=f"degree must be an integer from 1 to 3, got {degree}"
        ):
            kernel(3, degree)


@pytest.mark.parametrize("kernel", [peano.bdf_kernel, peano.extrapolation_kernel])
def test_integers_of_any_library_are_orders(kernel):
    np.testing.assert_array_equal(kernel(np.float64(3), np.int64(2)).c, kernel(3, 2).c)


@pytest.mark.parametrize("kernel", [peano.bdf_kernel, peano.extrapolation_kernel])
def test_a_kernel_is_known_between_its_values_only(kernel):
    assert np.isnan(kernel(3)([-0.1, 3.1])).all()
