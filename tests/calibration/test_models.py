"""Derivatives and steps of the camera models against finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxpoint.calibration.bundle import CameraModel, from_blocks, padded_frames, to_blocks
from jaxpoint.calibration.projective import ProjectiveModel
from jaxpoint.calibration.timing_model import TimingModel
from jaxpoint.camera.brown import Brown
from jaxpoint.camera.parameters import size_of

STEP = 1e-6


def brown(turn, lens):
    """Two cameras turned by a rotation vector from their base, and where they see three points."""
    base = Rotation.from_euler("xyz", [[0.1, 0.2, 0.3], [0.0, -0.4, 0.1]]).as_matrix()
    cameras = np.zeros((2, size_of(Brown)))
    cameras[:, :3] = turn
    cameras[:, 3:6] = [[0.1, -0.2, 5.0], [0.3, 0.1, 4.0]]
    cameras[:, 6:] = [np.log(900.0), 0.01, 630.0, 350.0, *lens]
    back = np.linalg.inv(Rotation.from_rotvec(cameras[:, :3]).as_matrix() @ base)  # points stay before the cameras
    points = back[0] @ np.array([[0.5, -0.5, 0.2], [0.3, 0.4, -0.6], [0.1, 0.9, -0.5]]).T
    return CameraModel(), cameras, base, points, 640.0 + np.zeros((2, 2, 3))


def projective(lens, object_space):
    """Two projective cameras; `object_space` asks for the bilinear residual of the factorisation."""
    rng = np.random.default_rng(0)
    cameras = rng.normal(size=(2, 3, 4)) * 0.3
    cameras[:, 2] = [0.1, -0.1, 0.2, 1.0]
    numbers = np.concatenate([cameras.reshape(2, 12), np.full((2, 1), lens)], axis=1)
    constants = (np.array([700.0, 800.0]), np.full(2, float(object_space)))
    return ProjectiveModel(), numbers, constants, rng.uniform(-0.5, 0.5, (3, 3)), rng.uniform(-0.5, 0.5, (2, 2, 3))


def out_of_step():
    """Brown's cameras with offsets and rolling shutters, where the light moves; seven numbers an observation."""
    _, cameras, base, points, pixels = brown([0.2, -0.1, 0.3], [-0.2, 0.05, 0.002, -0.001, 0.01])
    motion = np.random.default_rng(2).normal(0.0, [[20.0], [20.0], [4.0], [4.0], [0.3]], (2, 5, 3))
    numbers = np.concatenate([cameras, [[0.0, 0.6], [-0.4, -0.7]]], axis=1)
    return TimingModel(), numbers, base, points, np.concatenate([pixels, motion], axis=1)


CASES = {
    "brown out of step and rolling": out_of_step(),
    "brown at rest": brown([0.0, 0.0, 0.0], np.zeros(5)),
    "brown bent": brown([0.2, -0.1, 0.3], [-0.2, 0.05, 0.002, -0.001, 0.01]),
    "brown near pi": brown([0.0, np.pi - 1e-3, 0.0], [-0.2, 0.05, 0.0, 0.0, 0.0]),
    "pose": projective(0.0, True),
    "projective": projective(-0.2, False),
    "projective without lens": projective(0.0, False),
}


@pytest.mark.parametrize("case", CASES)
def test_jacobians(case):
    """The block's Jacobians by the step and the point: residuals after `retract`, in central differences."""
    model, cameras, constants, points, pixels = CASES[case]
    constants, points, pixels = jax.tree.map(jnp.asarray, (constants, points, pixels))

    @jax.jit
    def residuals(step, shift):
        moved = model.retract(jnp.asarray(cameras), constants, step)
        return model._block_residuals(model.state(moved, constants), points + shift, pixels)

    @jax.jit
    def derivatives(cameras):
        state = model.state(cameras, constants)
        value, *rows = model._block_columns(state, points, pixels)
        return jnp.stack(value, axis=1), *(jnp.stack([jnp.stack(row, axis=1) for row in kind], axis=1) for kind in rows)

    value, for_camera, for_point = derivatives(cameras)
    none = np.zeros_like(cameras)
    np.testing.assert_allclose(value, residuals(none, np.zeros((3, 3))), atol=1e-9)
    scale = np.abs(np.asarray(for_camera)).max()
    for parameter in range(model.camera_size):
        step = none.copy()
        step[:, parameter] = STEP
        numeric = (residuals(step, np.zeros((3, 3))) - residuals(-step, np.zeros((3, 3)))) / (2 * STEP)
        np.testing.assert_allclose(for_camera[:, :, parameter], numeric, atol=2e-6 * scale)
    for axis in range(3):
        shift = np.zeros((3, 3))
        shift[axis] = STEP
        numeric = (residuals(none, shift) - residuals(none, -shift)) / (2 * STEP)
        np.testing.assert_allclose(for_point[:, :, axis], numeric, atol=2e-6 * scale)


def seen_by(case):
    """Residuals of a projective case, and what its cameras see undistorted, (C, 2, F)."""
    model, numbers, constants, points, pixels = CASES[case]
    state = model.state(jnp.asarray(numbers), jax.tree.map(jnp.asarray, constants))
    local = np.einsum("cij,jf->cif", numbers[:, :12].reshape(2, 3, 4), np.vstack([points, np.ones(3)]))
    return np.asarray(jax.jit(model._block_residuals)(state, points, pixels)), local


def test_projective_lens_is_the_division_model():
    """An undistorted u maps to the distorted d with d / (1 + lambda |d|^2) = u."""
    _, numbers, constants, _, pixels = CASES["projective"]
    residual, local = seen_by("projective")
    bent = residual[:, :2] / constants[0][:, None, None] + pixels
    straight = bent / (1.0 + numbers[0, 12] * (bent**2).sum(axis=1, keepdims=True))
    np.testing.assert_allclose(straight, local[:, :2] / local[:, 2:], atol=1e-12)
    np.testing.assert_array_equal(residual[:, 2:], 0.0)


def test_pseudo_object_space_error_is_that_of_the_paper():
    """Hong & Zach 2018, eq. 5: (1 - eta) |X12 - X3 m|^2 + eta |X12 - m|^2."""
    model, pixels = CASES["pose"][0], CASES["pose"][4]
    residual, local = seen_by("pose")
    near, far = local[:, :2] - local[:, 2:] * pixels, local[:, :2] - pixels
    expected = (1 - model.eta) * (near**2).sum(axis=1) + model.eta * (far**2).sum(axis=1)
    np.testing.assert_allclose((residual**2).sum(axis=1), expected, rtol=1e-12)


def test_retract_turns_from_the_left_to_first_order_and_bounds_the_focal_length():
    model, cameras, constants, _, _ = CASES["brown bent"]
    step = np.random.default_rng(1).normal(0.0, 1e-3, cameras.shape)
    step[:, 6] = [3.0, -3.0]
    moved = np.array(jax.jit(model.retract)(cameras, constants, step))
    expected = Rotation.from_rotvec(step[:, :3]) * Rotation.from_rotvec(cameras[:, :3])
    np.testing.assert_allclose(Rotation.from_rotvec(moved[:, :3]).as_matrix(), expected.as_matrix(), atol=1e-6)
    np.testing.assert_allclose(moved[:, 6] - cameras[:, 6], [0.7, -0.7])
    np.testing.assert_allclose(moved[:, 8:], cameras[:, 8:] + step[:, 8:])


def test_blocks_and_back():
    values = np.arange(256 * 4 * 2, dtype=float).reshape(256, 4, 2)
    blocks = to_blocks(values)
    assert blocks.shape == (2, 4, 2, 128)
    np.testing.assert_array_equal(blocks[1, :, :, 3], values[131])
    np.testing.assert_array_equal(from_blocks(blocks), values)


def test_few_padded_lengths():
    sizes = {padded_frames(frames) for frames in range(1, 20_000)}
    assert all(padded_frames(frames) >= frames for frames in range(1, 20_000))
    assert all(size % 128 == 0 for size in sizes)
    assert len(sizes) <= 12
    assert {512, 768, 1024, 1536} <= sizes
