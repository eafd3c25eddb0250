"""Multipliers in exact arithmetic, and the identity that defines G."""

import math
from fractions import Fraction

import numpy as np
import pytest
import sympy
from numpy.polynomial import chebyshev

import esfem_core as ec
from esfem_core.stepping.bdf import delta_exact
from esfem_core.theory import multipliers

PRINTED = {1: 0.0, 2: 0.0, 3: 0.0836, 4: 0.2878, 5: 0.8160}
SIX_STEP = [1, -13 / 9, 25 / 36, -1 / 9]  # Akrivis, Chen, Yu, Zhou 2021
MINIMAL = {  # by descending powers of eta
    3: [4, -108, 9],
    4: [639, -3216, 43568, -12288],
    5: [110415888, -665091144, 1722651825, -14624080200, 11014840000, 68160000],
}
X, ETA = sympy.symbols("x eta")


def exact_quotient(p):
    """Return Re[delta(z) (1 - eta/z)]/(1 - x) on the unit circle as a polynomial in x."""
    d = [sympy.Rational(c.numerator, c.denominator) for c in delta_exact(p)]
    F = sum(
        c * (sympy.chebyshevt(j, X) - ETA * sympy.chebyshevt(abs(j - 1), X))
        for j, c in enumerate(d)
    )
    quotient, remainder = sympy.div(sympy.expand(F), 1 - X, X)
    assert remainder == 0
    return quotient


def sign_changes(p, eta):
    """Return the number of zeros in [-1, 1], for the exact value of a floating-point number."""
    number = Fraction(eta)
    at = sympy.Rational(number.numerator, number.denominator)
    return sympy.Poly(exact_quotient(p).subs(ETA, at), X).count_roots(-1, 1)


def sides(delta, mu, v, inner):
    """Return both sides of the identity for rows v_0, ..., v_p."""
    p = len(v) - 1
    d, m = (np.pad(c, (0, p + 1 - len(c)))[::-1] for c in (delta, mu))
    G, gamma = multipliers.g_matrix_of(delta, mu), multipliers.gammas_of(delta, mu)
    products = v @ inner @ v.T
    energy = (G * products[1:, 1:]).sum() - (G * products[:-1, :-1]).sum()
    return d @ products @ m, energy + gamma @ products @ gamma


def etas(p):
    """Return admissible values, some of them very near the smallest."""
    smallest = multipliers.smallest_eta(p)
    near = [smallest + gap for gap in (0, 1e-16, 1e-15, 1e-13, 1e-10, 1e-7, 1e-3)]
    return [*near, (1 + smallest) / 2, 0.99, 1 - 1e-9]


class TestSmallestEta:
    @pytest.mark.parametrize("p", [3, 4, 5])
    def test_minimal_polynomial_divides_the_discriminant_and_is_irreducible(self, p):
        polynomial = sympy.Poly(MINIMAL[p], ETA)
        discriminant = sympy.Poly(sympy.discriminant(exact_quotient(p), X), ETA)
        assert polynomial.is_irreducible
        assert sympy.rem(discriminant, polynomial).is_zero

    @pytest.mark.parametrize("p", [3, 4, 5])
    def test_is_the_root_rounded_up(self, p):
        between = [r for r in sympy.Poly(MINIMAL[p], ETA).nroots(n=40) if r.is_real and 0 < r < 1]
        assert len(between) == 1
        error = sympy.Float(multipliers.smallest_eta(p), 40) - between[0]
        assert 0 <= error < math.ulp(multipliers.smallest_eta(p))

    def test_closed_form_for_three_steps(self):
        root = sympy.Rational(27, 2) - 6 * sympy.sqrt(5)
        assert sympy.Poly(MINIMAL[3], ETA).eval(root).expand() == 0
        assert abs(multipliers.smallest_eta(3) - root.evalf(30)) < 1e-16

    @pytest.mark.parametrize("p", [3, 4, 5])
    def test_is_the_smallest_number_that_is_admissible(self, p):
        eta = multipliers.smallest_eta(p)
        assert sign_changes(p, eta) == 0
        assert sign_changes(p, math.nextafter(eta, 0)) == 2

    @pytest.mark.parametrize("p", [1, 2])
    def test_a_stable_methods_need_none(self, p):
        assert multipliers.smallest_eta(p) == 0.0
        x = np.linspace(-1, 1, 101)
        np.testing.assert_allclose(
            multipliers.circle_polynomial(ec.bdf.delta(p), [1])(x), (1 - x) ** p, atol=1e-15
        )

    def test_printed_values(self):
        """All have four digits of the true value, but that for p = 4 is rounded down."""
        for p, printed in PRINTED.items():
            assert abs(printed - multipliers.smallest_eta(p)) < 5e-5
        safe = {p for p, eta in PRINTED.items() if eta >= multipliers.smallest_eta(p)}
        assert safe == {1, 2, 3, 5}
        assert {p: sign_changes(p, PRINTED[p]) for p in (3, 4, 5)} == {3: 0, 4: 2, 5: 0}
        x = np.linspace(-1, 1, 100001)
        lowest = multipliers.circle_polynomial(ec.bdf.delta(4), [1, -PRINTED[4]])(x).min()
        assert lowest == pytest.approx(-1.2732e-5, rel=1e-3)

    @pytest.mark.parametrize(
        ("p", "message"),
        [
            (0, "an integer from 1 to 5, got 0"),
            (2.5, r"an integer from 1 to 5, got 2\.5"),
            (6, "no linear multiplier"),
            (10**30, "an integer from 1 to 5, got 10000"),
        ],
    )
    def test_orders_without_a_multiplier_are_refused(self, p, message):
        for function in (multipliers.smallest_eta, lambda p: multipliers.g_matrix(p, 7.0)):
            with pytest.raises(ValueError, match=message):
                function(p)

    def test_six_steps_would_need_more_than_one(self):
        """With eta = 1 the real part is still negative somewhere."""
        x = np.linspace(-1, 1, 20001)[:-1]
        a, b = (multipliers.circle_polynomial(ec.bdf.delta(6), mu)(x) for mu in ([1.0], [0.0, 1.0]))
        assert (b < 0).all()
        assert (a / b).max() == pytest.approx(5.0132, abs=1e-4)


class TestG:
    def test_two_steps_exactly(self):
        """Derive G of BDF2 by comparing coefficients, in rational numbers."""
        d = delta_exact(2)[::-1]  # of v_0, v_1, v_2
        g11, g12, g22 = sympy.symbols("g11 g12 g22")
        gamma = sympy.symbols("c0 c1 c2")
        v = sympy.symbols("v0 v1 v2")
        left = sum(
            sympy.Rational(c.numerator, c.denominator) * w for c, w in zip(d, v, strict=True)
        )
        energy = [g11 * a**2 + 2 * g12 * a * b + g22 * b**2 for a, b in (v[1:], v[:-1])]
        square = sum(c * w for c, w in zip(gamma, v, strict=True)) ** 2
        difference = sympy.Poly(left * v[2] - energy[0] + energy[1] - square, *v)
        solutions = sympy.solve(difference.coeffs(), [g11, g12, g22, *gamma], dict=True)
        assert {(s[g11] * 4, s[g12] * 4, s[g22] * 4) for s in solutions} == {(1, -2, 5)}
        np.testing.assert_allclose(4 * multipliers.g_matrix(2, 0.0), [[1, -2], [-2, 5]], atol=1e-15)
        np.testing.assert_allclose(multipliers.gammas(2, 0.0), [0.5, -1, 0.5], atol=1e-15)

    @pytest.mark.parametrize("p", range(1, 6))
    def test_identity_holds_for_all_vectors(self, p):
        rng = np.random.default_rng(p)
        for eta in etas(p):
            for dimension in (1, 2, 7):
                v = rng.normal(size=(p + 1, dimension))
                root = rng.normal(size=(dimension, dimension))
                for inner in (np.eye(dimension), root @ root.T):
                    left, right = sides(ec.bdf.delta(p), np.array([1, -eta]), v, inner)
                    scale = np.trace(v @ inner @ v.T)
                    assert abs(left - right) < 1e-13 * max(scale, 1)

    @pytest.mark.parametrize("p", range(1, 6))
    def test_is_symmetric_and_positive_definite(self, p):
        for eta in etas(p):
            G = multipliers.g_matrix(p, eta)
            assert G.shape == (p, p)
            np.testing.assert_array_equal(G, G.T)
            assert np.linalg.eigvalsh(G)[0] > 0

    @pytest.mark.parametrize("p", range(1, 6))
    def test_energy_of_constants_is_half_of_one_minus_eta(self, p):
        """Compare the terms linear in s for v_i = s + i."""
        for eta in etas(p):
            assert abs(multipliers.g_matrix(p, eta).sum() - (1 - eta) / 2) < 1e-13

    @pytest.mark.parametrize("p", range(1, 6))
    def test_square_is_a_spectral_factor_without_zeros_in_the_disc(self, p):
        z = np.exp(1j * np.linspace(0, np.pi, 101))
        for eta in etas(p):
            gamma = multipliers.gammas(p, eta)
            F = multipliers.circle_polynomial(ec.bdf.delta(p), [1, -eta])(z.real)
            np.testing.assert_allclose(abs(np.polyval(gamma[::-1], z)) ** 2, F, atol=1e-13)
            # zeros on the circle are double, which np.roots knows to half of the digits
            assert abs(np.roots(gamma[::-1])).min() > 1 - 1e-6

    @pytest.mark.parametrize("p", range(1, 6))
    def test_is_the_largest(self, p):
        """The same gamma in reverse order gives the smallest G, by sums along diagonals."""
        for eta in etas(p):
            left = np.outer(ec.bdf.delta(p), np.pad([1, -eta], (0, p - 1)))[::-1, ::-1]
            gamma = multipliers.gammas(p, eta)[::-1]
            R = (left + left.T) / 2 - np.outer(gamma, gamma)
            smaller = np.array(
                [
                    [
                        sum(R[k + 1, k + 1 + j - i] for k in range(i, p - max(j - i, 0)))
                        for j in range(p)
                    ]
                    for i in range(p)
                ]
            )
            G = multipliers.g_matrix(p, eta)
            assert np.linalg.eigvalsh(smaller)[0] > -1e-13
            assert np.linalg.eigvalsh(G - smaller)[0] > -1e-13

    def test_choice_of_the_factor_matters(self):
        """For p = 2 and eta = 1/2 both factors are known: F = (1 - x)(2 - x)."""
        w = 2 - math.sqrt(3)  # 2 - x = |1 - w z|^2/(2 w)
        scale = 1 / (2 * math.sqrt(w))
        expected = scale * np.convolve([1, -1], [1, -w])
        np.testing.assert_allclose(multipliers.gammas(2, 0.5), expected, atol=1e-15)

    @pytest.mark.parametrize("p", range(1, 6))
    def test_border_of_the_admissible(self, p):
        smallest = multipliers.smallest_eta(p)
        multipliers.g_matrix(p, smallest)
        for function in (multipliers.g_matrix, multipliers.gammas):
            message = (
                "eta must be a finite number >= 0" if smallest == 0 else "is not admissible for p"
            )
            with pytest.raises(ValueError, match=message):
                function(p, smallest - 1e-12)
            for eta in (1.0, 1.5, -0.1, math.nan):
                with pytest.raises(ValueError, match="eta must be a finite number >= 0 and < 1"):
                    function(p, eta)

    @pytest.mark.parametrize("p", range(1, 6))
    def test_up_to_the_largest_eta_rounding_does_not_decide(self, p):
        multipliers.g_matrix(p, 1 - 1e-12)
        for eta in (1 - 1e-13, 1 - 4e-14, math.nextafter(1, 0)):
            with pytest.raises(ValueError, match="eta must be at most 1 - 1e-12, got 1 - "):
                multipliers.g_matrix(p, eta)

    def test_printed_value_for_four_steps_is_refused(self):
        with pytest.raises(ValueError, match=r"at least 0\.28780655698"):
            multipliers.g_matrix(4, PRINTED[4])
        with pytest.raises(ValueError, match="sign changes at"):
            multipliers.g_matrix_of(ec.bdf.delta(4), [1, -PRINTED[4]])


class TestOtherPolynomials:
    def test_six_steps_with_three_terms(self):
        delta, mu = ec.bdf.delta(6), np.array(SIX_STEP)
        np.testing.assert_allclose(  # zeros 9/4 and 2, 2
            mu, np.convolve([1, -4 / 9], np.convolve([1, -1 / 2], [1, -1 / 2])), atol=1e-15
        )
        x = np.linspace(-1, 1, 10001)
        F = multipliers.circle_polynomial(delta, mu)
        # F vanishes at 1, where its terms cancel up to rounding.
        assert (F(x) > -np.finfo(float).eps * abs(F.coef).sum()).all()
        assert np.linalg.eigvalsh(multipliers.g_matrix_of(delta, mu))[0] > 0.008
        v = np.random.default_rng(6).normal(size=(7, 5))
        left, right = sides(delta, mu, v, np.eye(5))
        assert abs(left - right) < 1e-12

    @pytest.mark.parametrize("divisor", [[1, -0.5], [1, 0.3]])
    def test_a_common_divisor_without_zeros_in_the_disc_is_accepted(self, divisor):
        """It has its zero at 2 and at -10/3."""
        delta = np.convolve(ec.bdf.delta(2), divisor)
        assert np.linalg.eigvalsh(multipliers.g_matrix_of(delta, divisor))[0] > 1e-4
        v = np.random.default_rng(2).normal(size=(4, 5))
        left, right = sides(delta, divisor, v, np.eye(5))
        assert abs(left - right) < 1e-12

    def test_trapezoidal_rule_conserves(self):
        """Here F = 0: no square is left."""
        np.testing.assert_array_equal(multipliers.g_matrix_of([1, -1], [0.5, 0.5]), [[0.5]])
        np.testing.assert_array_equal(multipliers.gammas_of([1, -1], [0.5, 0.5]), [0, 0])

    def test_zero_at_minus_one(self):
        """The square of the difference 1 - z^2 over two steps against 1 is |1 - z^2|^2/2."""
        gamma = multipliers.gammas_of([1, 0, -1], [1])
        np.testing.assert_allclose(gamma, np.array([1, 0, -1]) / math.sqrt(2), atol=1e-15)

    def test_zero_of_order_three_at_minus_one(self):
        """On the circle |(1 + z)^3|^2 is the real part of 20 + 30 z + 12 z^2 + 2 z^3."""
        gamma = multipliers.gammas_of([20, 30, 12, 2], [1])
        np.testing.assert_allclose(gamma, [1, 3, 3, 1], rtol=1e-12)

    @pytest.mark.parametrize(
        ("delta", "mu", "message"),
        [
            ([-1, 1], [1], "negative on part"),
            ([-1], [1], "negative on part"),
            (ec.bdf.delta(3), [1], "changes at"),
            ([1, -1], [1, -1], "no common divisor with a zero in the closed unit disc"),
            ([1, -3, 2], [1, -2], "no common divisor with a zero in the closed unit disc"),
            ([], [1], "delta must hold at least one coefficient"),
            ([1, -1], [[1]], r"mu must have shape \(n,\), got \(1, 1\)"),
            ([1, math.nan], [1], r"delta must be finite, but delta\[1\] is nan"),
        ],
    )
    def test_polynomials_without_a_matrix_are_refused(self, delta, mu, message):
        with pytest.raises(ValueError, match=message):
            multipliers.g_matrix_of(delta, mu)


class TestZerosThatRoundingMerges:
    @pytest.mark.parametrize("factor", [[1], [1, -1], [1, 1], [1, 0, -1]])
    def test_are_not_called_changes_of_sign(self, factor):
        """F = (x - 1/4)^4, and that times 1 - x, 1 + x or both, is not negative: G exists."""
        F = np.convolve(np.polynomial.polynomial.polypow([-0.25, 1], 4), factor)
        delta = chebyshev.poly2cheb(F)  # Re sum_k c_k z^k = sum_k c_k T_k
        assert multipliers.circle_polynomial(delta, [1])(np.linspace(-1, 1, 9)).min() > -1e-15
        for function in (multipliers.gammas_of, multipliers.g_matrix_of):
            with pytest.raises(ValueError, match="whether they have is lost in rounding") as found:
                function(delta, [1])
            assert "negative" not in str(found.value)

    def test_a_change_of_sign_between_positive_midpoints_is_one(self):
        """F = 1/4 - x^2 is positive between its zeros, and negative outside of them."""
        with pytest.raises(ValueError, match=r"negative on part of the .* changes at"):
            multipliers.gammas_of(chebyshev.poly2cheb([0.25, 0, -1]), [1])


@pytest.mark.parametrize("tiny", [0.0, 1e-200])
def test_coefficients_whose_products_would_vanish_are_named(tiny):
    for delta, mu, name in (([tiny, -tiny], [1], "delta"), ([1, -1], [tiny], "mu")):
        with pytest.raises(ValueError, match=rf"{name} must hold a coefficient of 1e-100 or more"):
            multipliers.g_matrix_of(delta, mu)
