"""Norms and errors of known functions."""

import numpy as np
import pytest

import esfem_core as ec

SPACE = ec.SurfaceSpace(ec.sphere("icosahedron", 3), 2, ec.to_unit_sphere)
PROBLEM = ec.problems.expanding_sphere()


def exact_state(t):
    x = PROBLEM.exact.x(SPACE.nodes, t)
    return ec.State(t, x, PROBLEM.exact.v(SPACE.nodes, t), PROBLEM.exact.u(x, t))


def test_exact_values_have_no_error():
    assert max(ec.errors.compare(SPACE, PROBLEM, exact_state(0.3))) < 1e-15


def test_a_known_perturbation():
    """Norms of eps x1 on a sphere of radius r: eps sqrt(4 pi/3) r^2 and eps sqrt(8 pi/3) r."""
    state, eps = exact_state(0.3), 1e-3
    r = np.linalg.norm(state.x[0])
    errors = ec.errors.compare(
        SPACE,
        PROBLEM,
        ec.State(
            0.3, state.x + eps * state.x[:, :1] * [[0, 0, 1]], None, state.u + eps * state.x[:, 0]
        ),
    )
    for name in ("x", "u"):
        assert getattr(errors, f"{name}_l2") == pytest.approx(
            eps * np.sqrt(4 * np.pi / 3) * r**2, rel=1e-4
        )
        assert getattr(errors, f"{name}_h1") == pytest.approx(
            eps * np.sqrt(8 * np.pi / 3) * r, rel=1e-3
        )
    assert np.isnan([errors.v_l2, errors.v_h1]).all()


def test_several_components_add_up():
    M, _ = SPACE.mass_stiffness(SPACE.nodes)
    w = np.random.default_rng(0).standard_normal((len(SPACE.nodes), 3))
    single = [ec.errors.seminorm(M, w[:, i]) for i in range(3)]
    assert ec.errors.seminorm(M, w) == pytest.approx(np.linalg.norm(single), rel=1e-14)


def test_a_seminorm_of_a_constant_is_zero_and_not_nan():
    _, A = SPACE.mass_stiffness(SPACE.nodes)
    assert 0 <= ec.errors.seminorm(A, np.full(len(SPACE.nodes), 7.0)) < 1e-5


def test_refusals():
    problem = ec.Problem(u0=lambda x: x[:, 0])
    with pytest.raises(ValueError, match="no exact solution to compare with"):
        ec.errors.compare(SPACE, problem, exact_state(0.0))
    with pytest.raises(ValueError, match=r"different times, 0\.1 and 0\.2"):
        ec.errors.difference(SPACE, exact_state(0.1), exact_state(0.2))
