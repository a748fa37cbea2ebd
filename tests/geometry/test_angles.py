"""Directions as angles, and turned by them, against scipy's rotations."""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from jaxpoint.geometry.angles import azimuth_elevation, turn_directions, wrap_angle

DRAW = np.random.default_rng(3)
VECTORS = DRAW.normal(size=(40, 3))


def test_angles_and_back():
    azimuth, elevation = np.asarray(azimuth_elevation(VECTORS)).T
    there = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], 1)
    np.testing.assert_allclose(there * np.linalg.norm(VECTORS, axis=1, keepdims=True), VECTORS, atol=1e-12)
    np.testing.assert_allclose(wrap_angle(np.array([7.0, -7.0, 1.0])), [7 - 2 * np.pi, 2 * np.pi - 7, 1.0], atol=1e-12)


def test_turned_as_scipy_turns():
    """The elevation about the level axis to the right of the direction, the azimuth about the vertical."""
    turns = DRAW.uniform(-1.5, 1.5, size=(40, 2))
    across = np.cross(VECTORS, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    up = Rotation.from_rotvec(turns[:, 1:] * across)
    left = Rotation.from_rotvec(turns[:, :1] * [[0.0, 0.0, 1.0]])
    np.testing.assert_allclose(turn_directions(VECTORS, turns), (left * up).apply(VECTORS), atol=1e-12)


def test_vertical_lines_have_values_and_derivatives():
    vertical, turn = jnp.array([0.0, 0.0, 1.0]), jnp.array([0.3, -0.2])
    np.testing.assert_allclose(jnp.linalg.norm(turn_directions(vertical, turn)), 1.0)
    np.testing.assert_allclose(azimuth_elevation(vertical), [0.0, np.pi / 2])
    for function in (lambda v: turn_directions(v, turn), azimuth_elevation):
        assert np.isfinite(jax.jacfwd(function)(vertical)).all()
