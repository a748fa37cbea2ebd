"""The direction that planes have in common, against singular vectors of numpy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from common_direction import common_direction

found_of = jax.jit(common_direction)


@pytest.mark.parametrize("planes", [2, 5])
def test_as_the_least_singular_vector(planes):
    rng = np.random.default_rng(planes)
    true = rng.normal(size=(3, 200))
    true /= np.linalg.norm(true, axis=0)
    normals = np.cross(rng.normal(size=(planes, 200, 3)), true.T).transpose(2, 0, 1)
    normals = normals + 0.02 * (planes > 2) * rng.normal(size=normals.shape)
    normals[:, 2:, ::7] = 0.0  # of some directions two planes are left
    found = np.asarray(found_of(jnp.asarray(normals)))
    np.testing.assert_allclose(np.linalg.norm(found, axis=0), 1.0, rtol=1e-12)
    for k in range(200):
        expected = np.linalg.svd(normals[:, :, k].T)[2][-1]
        assert abs(expected @ found[:, k]) == pytest.approx(1.0, abs=1e-8)


def test_no_plane_gives_no_direction():
    assert not np.asarray(found_of(jnp.zeros((3, 2, 4)))).any()
