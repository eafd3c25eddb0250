"""The reduction to one dimension: closed forms, and the solver on triangulations."""

import numpy as np
import pytest

import esfem_core as ec
from esfem_core.companion.revolution import cosine_mode
from esfem_core.errors import seminorm
from esfem_core.study import final

P = ec.sphere("octahedron", 2).vertices


def half_wave(a):
    return np.cos(a) * np.sin(a)


def test_eigenfunctions_of_the_sphere():
    """x2 and x1 x2 decay with 2 and 6, and the poles are zero."""
    for profile, u0, rate in [(np.sin, P[:, 1], 2), (half_wave, P[:, 0] * P[:, 1], 6)]:
        solutions = cosine_mode(lambda p, t: p, profile, [0.0, 0.3, 1.0])
        for t, u in zip((0.0, 0.3, 1.0), solutions, strict=True):
            np.testing.assert_allclose(u(P), np.exp(-rate * t) * u0, rtol=1e-7, atol=3e-15)


def test_a_growing_sphere():
    """Here u = r^{-2} exp(-6 int r^{-2}) x1 x2 for r = 1 + t, with int r^{-2} = t/(1 + t)."""
    (u,) = cosine_mode(lambda p, t: (1 + t) * p, half_wave, [1.0])
    np.testing.assert_allclose(u(P), np.exp(-3) / 4 * P[:, 0] * P[:, 1], rtol=1e-7, atol=1e-15)


def test_the_bat_against_triangles():
    """Two methods that share only the motion come together with the order of linear elements."""
    bat, errors = ec.problems.baseball_bat(), []
    (u,) = cosine_mode(bat.law.motion, half_wave, [0.4])
    for refinements in (3, 4):
        space = ec.SurfaceSpace(ec.sphere("octahedron", refinements))
        last = final(ec.evolve(space, bat, 4, 1 / 80, 0.4))
        M, _ = space.mass_stiffness(last.x)
        errors.append(seminorm(M, last.u - u(space.nodes)) / seminorm(M, last.u))
    assert errors[1] < 0.03
    assert errors[0] / errors[1] == pytest.approx(4, abs=0.5)


def test_degrees_agree():
    bat = ec.problems.baseball_bat()
    (low,), (high,) = (cosine_mode(bat.law.motion, half_wave, [0.2], degree=d) for d in (12, 24))
    np.testing.assert_allclose(low(P), high(P), atol=2e-5 * abs(high(P)).max())


def test_degrees_and_times_are_refused_by_name():
    with pytest.raises(ValueError, match="degree must be an integer >= 2, got 1"):
        cosine_mode(lambda p, t: p, np.sin, [1.0], degree=1)
    for times in ([], [-1.0], [1.0, 0.5]):
        with pytest.raises(ValueError, match="times must be one or more that do not decrease"):
            cosine_mode(lambda p, t: p, np.sin, times)
    with pytest.raises(ValueError, match=r"times must be finite, but times\[1\] is nan"):
        cosine_mode(lambda p, t: p, np.sin, [0.5, np.nan])
