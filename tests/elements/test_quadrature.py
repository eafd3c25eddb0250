"""Rules integrate monomials exactly: int xi^i eta^j = i! j!/(i + j + 2)!."""

from math import factorial

import pytest

from esfem_core.elements import triangle_rule


@pytest.mark.parametrize("exactness", range(21))
def test_monomials(exactness):
    rule = triangle_rule(exactness)
    assert rule.exactness >= exactness
    xi, eta = rule.points.T
    for i in range(rule.exactness + 1):
        for j in range(rule.exactness + 1 - i):
            exact = factorial(i) * factorial(j) / factorial(i + j + 2)
            assert rule.weights @ (xi**i * eta**j) == pytest.approx(exact, rel=2e-14)


@pytest.mark.parametrize("exactness", [*range(12), 20])
def test_points_inside_and_weights_positive(exactness):
    rule = triangle_rule(exactness)
    assert (rule.weights > 0).all()
    assert (rule.points > 0).all()
    assert (rule.points.sum(axis=1) < 1).all()


@pytest.mark.parametrize(("degree", "n_points"), [(1, 1), (2, 3), (4, 6), (6, 12), (8, 16)])
def test_numbers_of_points(degree, n_points):
    assert len(triangle_rule(degree).weights) == n_points


@pytest.mark.parametrize("degree", [1, 2, 4, 6, 8])
def test_stated_exactness_is_not_understated(degree):
    """Some polynomial of the next degree is integrated wrongly."""
    rule = triangle_rule(degree)
    xi, eta = rule.points.T
    worst = max(
        abs(
            rule.weights @ (xi**i * eta ** (degree + 1 - i))
            - factorial(i) * factorial(degree + 1 - i) / factorial(degree + 3)
        )
        for i in range(degree + 2)
    )
    assert worst > 1e-8


@pytest.mark.parametrize("exactness", range(102))
def test_what_a_rule_states_can_be_asked_for(exactness):
    """As files and new triangles do, to have the rule of their space."""
    rule = triangle_rule(exactness)
    assert len(triangle_rule(rule.exactness).weights) == len(rule.weights)


@pytest.mark.parametrize("exactness", [-1, 2.5, 102])
def test_refuses(exactness):
    with pytest.raises(ValueError, match="exactness must be an integer from 0 to 101"):
        triangle_rule(exactness)
