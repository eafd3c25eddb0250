"""When a factorisation is given up: the rule, without a matrix."""

import numpy as np

from esfem_core.solvers.ageing import Ageing


def test_the_first_solve_sets_the_rate():
    ageing = Ageing(price=10)
    ageing.record(4, np.exp(8), 1.0)
    assert ageing.rate == 2.0
    ageing.record(4, np.exp(20), 1.0)  # later ones do not change it
    assert ageing.rate == 2.0


def test_a_solve_at_the_rate_costs_nothing():
    ageing = Ageing(price=10)
    ageing.record(1, np.exp(2), 1.0)
    for iterations in range(1, 20):
        ageing.record(iterations, np.exp(2 * iterations), 1.0)
        ageing.record(iterations, np.exp(2 * iterations - 1.9), 1.0)  # begun is counted as whole
        assert ageing.lost == 0


def test_what_a_solve_takes_beyond_the_rate_is_lost():
    ageing = Ageing(price=10)
    ageing.record(1, np.exp(2), 1.0)
    ageing.record(8, np.exp(10), 1.0)
    assert ageing.lost == 3
    ageing.record(6, np.exp(10), 1.0)
    assert ageing.lost == 4


def test_nothing_is_won_back():
    ageing = Ageing(price=10)
    ageing.record(1, np.exp(2), 1.0)
    ageing.record(7, np.exp(10), 1.0)
    ageing.record(1, np.exp(10), 1.0)
    assert ageing.lost == 2


def test_a_solve_without_iterations_says_nothing():
    ageing = Ageing(price=10)
    ageing.record(0, 0.5, 0.5)
    assert (ageing.rate, ageing.lost) == (0, 0)
    ageing.record(1, np.exp(2), 1.0)
    ageing.record(0, 0.5, 0.5)
    assert (ageing.rate, ageing.lost) == (2, 0)


def test_an_exact_solution_is_a_finite_rate():
    ageing = Ageing(price=10)
    ageing.record(1, 1e30, 0.0)
    np.testing.assert_allclose(ageing.rate, np.log(1e60))


def test_due_when_the_price_is_lost():
    ageing = Ageing(price=3)
    ageing.record(1, np.exp(2), 1.0)
    for n in range(5):
        assert ageing.due == (n >= 3)
        ageing.record(2, np.exp(2), 1.0)  # one more than needed


def test_with_linear_growth_the_total_cost_is_near_the_least():
    """Solve n after a factorisation takes n iterations too many, for a price of C.

    Factorising every q solves costs C / q + (q - 1) / 2 per solve on average.
    """
    for price in (3, 10, 45, 100):
        ageing, factorisations, lost = Ageing(price), 1, 0
        age = 0
        solves = 3000
        for _ in range(solves):
            if ageing.due:
                ageing, factorisations, age = Ageing(price), factorisations + 1, 0
            ageing.record(1 + age, np.exp(2), 1.0)
            lost, age = lost + age, age + 1
        least = min(price / q + (q - 1) / 2 for q in range(1, 100))
        assert (price * factorisations + lost) / solves < 1.15 * least
