"""Linear instability of a reaction-diffusion system on the unit sphere, against its dispersion.

Near a uniform steady state, the amplitude of a spherical harmonic of degree l grows with the
eigenvalues of J - l (l + 1) diag(D_a, D_b), J the Jacobian of the reaction.
"""

import numpy as np
import pytest

import esfem_core as ec

SIZE, D_A, D_B = 70.0, 1.0, 10.0
FEED_A, FEED_B = 0.1, 0.9
A_0 = FEED_A + FEED_B
B_0 = FEED_B / A_0**2
SMALL = 1e-6  # amplitude, for linear growth
JACOBIAN = SIZE * np.array([[-1 + 2 * A_0 * B_0, A_0**2], [-2 * A_0 * B_0, -(A_0**2)]])
SPACE = ec.SurfaceSpace(ec.sphere("icosahedron", 1), 4, ec.to_unit_sphere)

HARMONICS = {  # zonal ones, and one that is not
    0: lambda x: np.ones(len(x)),
    2: lambda x: x[:, 0] * x[:, 1],
    3: lambda x: 5 * x[:, 2] ** 3 - 3 * x[:, 2],
    4: lambda x: 35 * x[:, 2] ** 4 - 30 * x[:, 2] ** 2 + 3,
}


def schnakenberg(initial):
    return ec.Problem(
        species={
            "a": ec.Species(
                lambda x: initial(x)[0],
                lambda at: SIZE * (FEED_A - at["a"] + at["a"] ** 2 * at["b"]),
                diffusivity=D_A,
            ),
            "b": ec.Species(
                lambda x: initial(x)[1],
                lambda at: SIZE * (FEED_B - at["a"] ** 2 * at["b"]),
                diffusivity=D_B,
            ),
        },
        law=ec.laws.Prescribed(lambda p, t: p),
    )


@pytest.mark.parametrize("degree", HARMONICS)
def test_amplitudes_grow_as_the_dispersion_relation_says(degree):
    """The amplitudes of both species, as a vector, go from c to exp((t - s) B) c."""
    B = JACOBIAN - degree * (degree + 1) * np.diag([D_A, D_B])
    growth, vectors = np.linalg.eig(B)
    Y = HARMONICS[degree]
    direction = vectors[:, np.argmax(growth.real)]

    def initial(x):
        return [s + SMALL * c * Y(x) for s, c in zip((A_0, B_0), direction.real, strict=True)]

    M = SPACE.mass(SPACE.nodes)
    test = M @ Y(SPACE.nodes) / (Y(SPACE.nodes) @ M @ Y(SPACE.nodes)) / SMALL
    run = ec.evolve(SPACE, schnakenberg(initial), 4, 1 / 1600, 0.1, solver="direct")
    amplitude = {s.t: np.array([test @ (s["a"] - A_0), test @ (s["b"] - B_0)]) for s in run}
    for t in (0.05, 0.1):
        exact = ((vectors * np.exp(growth * t)) @ np.linalg.solve(vectors, direction.real)).real
        assert amplitude[t] == pytest.approx(exact, rel=1e-3, abs=1e-3 * np.abs(exact).max())
    if not np.iscomplex(growth).any():
        measured = np.log(amplitude[0.1] / amplitude[0.05]) / 0.05
        assert measured == pytest.approx(growth.real.max(), rel=1e-3)


def test_the_system_is_stable_but_for_patterns():
    """Turing: without diffusion everything decays, some harmonics grow, high ones decay."""
    largest = [
        np.linalg.eigvals(JACOBIAN - n * (n + 1) * np.diag([D_A, D_B])).real.max()
        for n in range(12)
    ]
    assert largest[0] < 0 < max(largest)
    assert largest[-1] < 0
