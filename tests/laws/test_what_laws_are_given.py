"""What functions of a law or a species return, refused by shape or sign; and (2.20) itself."""

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve

import esfem_core as ec
from esfem_core.elements import NotFiniteError

SPACE = ec.SurfaceSpace(ec.sphere("octahedron", 1), 2, ec.to_unit_sphere)
AT = ec.Surface(SPACE, SPACE.nodes, SPACE.nodes[:, 2])


def test_a_step_of_the_regularised_law_leaves_no_residual():
    law = ec.laws.Regularised(0.5, 2.0, lambda at: 1 + at.u)
    tau, past = 0.1, -1.1 * SPACE.nodes  # new positions are tau v - past
    v = law.velocity(AT, {}, tau, past, lambda K, b: spsolve(K.tocsc(), b))
    assert np.abs(law.residual(AT, tau * v - past, v)).max() < 1e-12
    assert np.abs(law.residual(AT, SPACE.nodes, v)).max() > 1e-3  # the positions matter


@pytest.mark.parametrize("shape", [(32, 6, 1), (32,), (6,), (32, 6, 2)])
def test_a_speed_of_another_shape_is_refused(shape):
    law = ec.laws.Regularised(1.0, 1.0, lambda at: np.ones(shape))
    with pytest.raises(ValueError, match=r"g must return an array of shape \(32, 6\) or \(32, 6, "):
        law.load(AT)


@pytest.mark.parametrize("lowest", [-0.1, 0.0])
def test_a_tensor_with_one_negative_eigenvalue_on_the_tangent_plane_is_refused(lowest):
    """The other one is positive, and that in the direction of the normal does not count."""
    nu = AT.normal
    first = np.cross(nu, [0.3, 0.5, 0.8])
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    second = np.cross(nu, first)
    tensor = sum(
        number * e[..., :, None] * e[..., None, :]
        for number, e in ((lowest, first), (1.0, second), (-5.0, nu))
    )
    species = ec.Species(1.0, diffusivity=lambda at: tensor)
    if lowest < 0:
        with pytest.raises(NotFiniteError, match=r"has the eigenvalue -0\.1 in element 0"):
            species.parts(AT, ())
    else:
        assert len(species.parts(AT, ())) == 1


def test_a_tensor_that_is_not_symmetric_is_not_called_indefinite():
    tensor = np.eye(3) + 4 * np.tri(3, k=-1)
    species = ec.Species(1.0, diffusivity=lambda at: np.broadcast_to(tensor, (32, 6, 3, 3)))
    with pytest.raises(ValueError, match=r"diffusivity must be symmetric, but .* up to 4"):
        species.parts(AT, ())


def test_a_node_that_is_fixed_twice_is_named():
    species = ec.Species(1.0, fixed=([5, 2, 5], 1.0))
    with pytest.raises(ValueError, match="must not be repeated, but 5 is"):
        species.fixed.nodes("u", SPACE)
