"""Answers of the scheme to chosen defects, against its error equations."""

import dataclasses

import numpy as np
import pytest

import esfem_core as ec
from esfem_core.theory.defects import Defects
from esfem_core.theory.stability import ErrorTerms, error_terms, proposition_1, response

SPACE = ec.SurfaceSpace(ec.sphere("icosahedron", 0), 2, ec.to_unit_sphere)
PROBLEM = ec.problems.expanding_sphere()
ZERO = np.zeros_like(SPACE.nodes)
RNG = np.random.default_rng(0)


def nothing(n):
    return Defects(ZERO[:, 0], ZERO, ZERO)


def test_no_defects_no_errors():
    for computed, exact in response(SPACE, PROBLEM, 3, 1 / 20, 0.5, nothing):
        assert np.abs(computed.x - exact.x).max() < 1e-12
        assert np.abs(computed.u - exact.u).max() < 1e-12


def test_first_step_solves_the_error_equations():
    # without starting errors, the first step has x~ = x~_* and u~ = u~_*: linear systems remain
    step, p = 1 / 20, 2
    d_u, d_v = RNG.normal(size=len(SPACE.nodes)), RNG.normal(size=SPACE.nodes.shape)
    d_x = RNG.normal(size=SPACE.nodes.shape)
    d = Defects(d_u, d_v, d_x)
    *_, (computed, exact) = response(SPACE, PROBLEM, p, step, p * step, lambda n: d)
    past = [PROBLEM.exact.x(SPACE.nodes, t) for t in (step, 0.0)]
    M, A = SPACE.mass_stiffness(2 * past[0] - past[1])
    e_x, e_v, e_u = computed.x - exact.x, computed.v - exact.v, computed.u - exact.u
    assert np.allclose((M + A) @ e_v + A @ e_x, -d_v, atol=1e-11)
    assert np.allclose(1.5 * e_x / step, e_v - d_x, atol=1e-11)
    assert np.allclose(1.5 / step * (M @ e_u) + A @ e_u, -d_u, atol=1e-11)


def test_small_defects_act_linearly():
    def of(size):
        def chosen(n):
            return Defects(size * SPACE.nodes[:, 0], size * SPACE.nodes, -size * SPACE.nodes)

        *_, (computed, exact) = response(SPACE, PROBLEM, 2, 1 / 20, 0.3, chosen)
        return computed.u - exact.u

    assert np.allclose(of(2e-6), 2 * of(1e-6), rtol=1e-3, atol=1e-12)


def test_starting_errors_stay_where_they_are():
    start = [(ZERO + 1e-3 * j, ZERO[:, 0] + 1e-3) for j in range(3)]
    pairs = list(response(SPACE, PROBLEM, 3, 0.1, 0.3, nothing, start))
    for (e_x, e_u), (computed, exact) in zip(start, pairs[:3], strict=True):
        assert np.allclose(computed.x - exact.x, e_x, atol=1e-15)
        assert np.allclose(computed.u - exact.u, e_u, atol=1e-15)


def test_starting_errors_and_defects_of_another_shape_are_refused():
    with pytest.raises(ValueError, match=r"problem must have the velocity law .* is prescribed"):
        response(SPACE, ec.problems.oscillating_ellipsoid(), 2, 0.1, 0.3, nothing)
    with pytest.raises(ValueError, match=r"start must hold p = 3 pairs \(e_x, e_u\), got 2"):
        response(SPACE, PROBLEM, 3, 0.1, 0.3, nothing, [(ZERO, ZERO[:, 0])] * 2)
    with pytest.raises(ValueError, match=r"start\[1\]: e_u must have shape \(42,\), got \(42, 3\)"):
        response(SPACE, PROBLEM, 2, 0.1, 0.3, nothing, [(ZERO, ZERO[:, 0]), (ZERO, ZERO)])
    with pytest.raises(ValueError, match="step must be a finite number > 0"):
        response(SPACE, PROBLEM, 2, -0.1, 0.3, nothing)

    def chosen(n):
        return Defects(ZERO[:, :1], ZERO, ZERO)

    with pytest.raises(ValueError, match=r"chosen\(2\)\.u must have shape \(42,\), got \(42, 1\)"):
        list(response(SPACE, PROBLEM, 2, 0.1, 0.3, chosen))


def single_velocity_defect(n):
    return nothing(n)._replace(v=1e-5 * SPACE.nodes * (n == 10))


def test_the_squares_are_those_of_the_errors_at_the_exact_positions():
    pairs = list(response(SPACE, PROBLEM, 2, 1 / 20, 0.5, single_velocity_defect))
    terms = error_terms(SPACE, pairs, 2, 1 / 20, single_velocity_defect)
    M, A = SPACE.mass_stiffness(pairs[-1][1].x)
    e_v = pairs[-1][0].v - pairs[-1][1].v
    assert np.isclose(terms.squares["v"][-1], np.sum(e_v * ((M + A) @ e_v)), rtol=1e-14)
    d = single_velocity_defect(10).v
    solved = np.linalg.solve((M + A).toarray(), d)
    assert np.isclose(terms.squares["d_v"][-1], np.sum(d * solved), rtol=1e-10)
    assert terms.defects[:2] == (None, None)
    assert not terms.squares["d_v"][:-1].any()
    assert not terms.errors["v"][:2].any()


def test_defects_of_positions_have_the_norm_of_errors_and_the_others_its_dual():
    """d^T K d and d^T K^{-1} d with K = M + A: of constants c and of M c these are areas."""
    x, M = SPACE.nodes, SPACE.mass(SPACE.nodes)
    states = [ec.State(0.1 * n, x, ZERO, x[:, 0], space=SPACE) for n in range(2)]
    c = np.ones_like(x) * [1, 2, 3]
    d = Defects(M @ c[:, 1], M @ c, c)
    terms = error_terms(SPACE, [(state, state) for state in states], 1, 0.1, lambda n: d)
    found = [terms.squares[name][1] for name in ("d_x", "d_v", "d_u")]
    assert found == pytest.approx(np.array([14, 14, 4]) * M.sum(), rel=1e-12)


def test_errors_of_u_are_measured_with_the_matrices_of_their_time():
    """On spheres of radius 1, 2 and 3: M grows like r^2, A does not."""
    x, (M, A) = SPACE.nodes, SPACE.mass_stiffness(SPACE.nodes)
    e = x[:, 0]
    pairs = [
        tuple(ec.State(0.1 * n, (1 + n) * x, x, u, space=SPACE) for u in (e, 0 * e))
        for n in range(3)
    ]
    squares = error_terms(SPACE, pairs, 1, 0.1, lambda n: None).squares
    assert squares["u_mass"] == pytest.approx(np.array([1, 4, 9]) * (e @ (M @ e)), rel=1e-12)
    assert squares["u_stiffness"] == pytest.approx([e @ (A @ e)] * 3, rel=1e-12)
    assert squares["u"] == pytest.approx(squares["u_mass"] + squares["u_stiffness"], rel=1e-12)


def test_one_velocity_defect_refutes_the_printed_estimate_and_not_the_corrected_one():
    pairs = list(response(SPACE, PROBLEM, 2, 1 / 20, 0.5, single_velocity_defect))
    terms = error_terms(SPACE, pairs, 2, 1 / 20, single_velocity_defect)
    assert 15 < proposition_1(terms) < 20  # 1/τ less a constant
    assert proposition_1(terms, corrected=True) < 1


def test_an_estimate_needs_something_on_the_right():
    pairs = list(response(SPACE, PROBLEM, 2, 1 / 20, 0.2, nothing))
    terms = error_terms(SPACE, pairs, 2, 1 / 20, nothing)
    with pytest.raises(ValueError, match="must have a defect or a starting error in some step"):
        proposition_1(terms)


def test_terms_of_another_run_are_refused():
    pairs = list(response(SPACE, PROBLEM, 2, 1 / 20, 0.2, nothing))
    other = ec.SurfaceSpace(ec.sphere("octahedron", 1))
    for arguments, message in (
        (
            (SPACE, pairs, 2, 1 / 10, nothing),
            r"pairs\[1\]\[0\] must be at the time of step 1, t = 0",
        ),
        ((SPACE, pairs, 5, 1 / 20, nothing), "pairs must be more than p = 5, got 5"),
        ((SPACE, [], 2, 1 / 20, nothing), "pairs must be more than p = 2, got none"),
        ((SPACE, [pairs[0][0]], 2, 1 / 20, nothing), r"pairs\[0\] must be a pair"),
        ((other, pairs, 2, 1 / 20, nothing), r"pairs\[0\]\[0\] must"),
        ((SPACE, pairs, 2, 1 / 20, lambda n: 0), r"chosen\(2\) must be a Defects, got 0"),
        ((SPACE, pairs, 2, 1 / 20, lambda n: Defects(0, 0, 0)), r"chosen\(2\)\.u must have shape"),
    ):
        with pytest.raises((TypeError, ValueError), match=message):
            error_terms(*arguments)
    with pytest.raises(TypeError, match="terms must be an ErrorTerms, got None"):
        proposition_1(None)
    with pytest.raises(TypeError, match="corrected must be True or False, got 'no'"):
        proposition_1(error_terms(SPACE, pairs, 2, 1 / 20, nothing), "no")


def test_errors_of_u_of_two_shapes_are_refused_rather_than_broadcast():
    pairs = list(response(SPACE, PROBLEM, 2, 1 / 20, 0.2, nothing))
    columns = [(ec.State(s.t, s.x, s.v, s.u[:, None]), exact) for s, exact in pairs]
    later = [*pairs[:3], *((c, ec.State(e.t, e.x, e.v, c.u)) for c, e in columns[3:])]
    without = [(s, ec.State(exact.t, exact.x, exact.v)) for s, exact in pairs]
    for bad, message in (
        (columns, r"got pairs\[0\]\[0\]\.u of shape \(42, 1\) and pairs\[0\]\[1\]\.u of \(42,\)"),
        (later, r"got pairs\[3\]\[0\]\.u of shape \(42, 1\) and pairs\[0\]\[1\]\.u of \(42,\)"),
        (without, r'pairs\[0\]\[1\] must have values of "u", but has none'),
        ([(pairs[0][0], 3)], r"pairs\[0\]\[1\] must be a State, got 3"),
    ):
        with pytest.raises((TypeError, ValueError), match=message):
            error_terms(SPACE, bad, 2, 1 / 20, nothing)


@pytest.mark.parametrize("p", [1, 2, 3])
@pytest.mark.parametrize("corrected", [False, True])
def test_both_sides_of_the_estimate_are_sums_as_written(p, corrected):
    names = ("x", "v", "u_mass", "u_stiffness", "d_x", "d_v", "d_u")
    square, tau, ratios = dict(zip(names, RNG.random((7, 9)), strict=True)), 0.1, []
    square["d_x"] *= 0.01  # so that the largest ratio is not that of the first step
    for n in range(p, 9):
        left = square["x"][n] + square["v"][n]
        left += sum(square["u_mass"][n - j] for j in range(p))
        left += tau * sum(square["u_stiffness"][j] for j in range(p if corrected else 1, n + 1))
        right = sum(square[f"d_{name}"][j] for j in range(n + 1) for name in "xvu") * tau
        right += sum(square["x"][j] + square["u_mass"][j] for j in range(p))
        right += square["d_v"][n] if corrected else 0
        ratios.append(left / right)
    terms = ErrorTerms(p, tau, (), (), (), (), {}, square)
    assert proposition_1(terms, corrected) == pytest.approx(max(ratios), rel=1e-13)
    assert len({terms, dataclasses.replace(terms)}) == 2  # dicts of arrays are not compared
