"""Poses and similarities against scipy's matrix exponential and the thesis's matrices."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from jaxpoint.geometry.pose import Pose, Similarity, gimbal
from jaxpoint.geometry.rotation import skew

RNG = np.random.default_rng(0)
AXIS = np.array([0.48, 0.6, -0.64])
ANGLES = [0.0, 1e-7, 0.2, 1.5, 3.0, np.pi - 1e-6]
POSE_EXP, POSE_LOG = jax.jit(Pose.exp), jax.jit(Pose.log)
SIM_EXP, SIM_LOG = jax.jit(Similarity.exp), jax.jit(Similarity.log)


def homogeneous(rotation, translation, scale=1.0):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = scale * np.asarray(rotation), translation
    return matrix


def of(thing):
    return homogeneous(thing.rotation, thing.translation, getattr(thing, "scale", 1.0))


def random_pose(seed):
    rng = np.random.default_rng(seed)
    return Pose(Rotation.random(random_state=seed).as_matrix(), rng.normal(size=3))


def random_similarity(seed):
    pose = random_pose(seed)
    return Similarity(np.float64(0.3 + seed), pose.rotation, pose.translation)


@pytest.mark.parametrize("angle", ANGLES)
def test_exp_is_the_matrix_exponential(angle):
    tangent = np.concatenate([[0.3, -1.2, 2.0], angle * AXIS, [-0.7]])
    generator = np.zeros((4, 4))
    generator[:3, :3], generator[:3, 3] = skew(tangent[3:6]), tangent[:3]
    np.testing.assert_allclose(of(POSE_EXP(tangent[:6])), expm(generator), atol=5e-15)
    np.testing.assert_allclose(POSE_LOG(POSE_EXP(tangent[:6])), tangent[:6], atol=1e-13)
    generator[:3, :3] += tangent[6] * np.eye(3)
    np.testing.assert_allclose(of(SIM_EXP(tangent)), expm(generator), atol=5e-15)
    np.testing.assert_allclose(SIM_LOG(SIM_EXP(tangent)), tangent, atol=1e-13)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_similarity_log_of_extreme_scales(scale):
    similarity = Similarity(np.float64(scale), Rotation.from_rotvec(3.1 * AXIS).as_matrix(), [1.0, 2.0, 3.0])
    np.testing.assert_allclose(of(SIM_EXP(SIM_LOG(similarity))), of(similarity), rtol=1e-11)


@jax.jit
def flat_exp(tangent):
    pose = Pose.exp(tangent)
    return jnp.concatenate([pose.rotation.ravel(), pose.translation])


FLAT_JACOBIANS = jax.jit(lambda x: (jax.jacfwd(flat_exp)(x), jax.jacrev(flat_exp)(x)))
ROUND_TRIP = jax.jit(jax.jacrev(lambda x: Similarity.exp(x).log()))


@pytest.mark.parametrize("angle", [0.0, 1e-6, 2.0, np.pi - 1e-3])
def test_derivatives(angle):
    tangent = np.concatenate([[0.3, -1.2, 2.0], angle * AXIS, [-0.7]])
    step = 1e-6 * np.eye(6)
    numeric = [(flat_exp(tangent[:6] + d) - flat_exp(tangent[:6] - d)) / 2e-6 for d in step]
    for ours in FLAT_JACOBIANS(tangent[:6]):
        np.testing.assert_allclose(ours, np.stack(numeric, axis=1), atol=1e-8)
    np.testing.assert_allclose(ROUND_TRIP(tangent), np.eye(7), atol=1e-9)


@pytest.mark.parametrize("make", [random_pose, random_similarity])
def test_products_chain(make):
    a, b = make(1), make(2)
    points = RNG.normal(size=(4, 5, 3))
    np.testing.assert_allclose(of(a @ b), of(a) @ of(b), atol=1e-14)
    np.testing.assert_allclose((a @ b) @ points, a @ (b @ points), atol=1e-13)
    np.testing.assert_allclose(a.inverse() @ (a @ points), points, atol=1e-14)
    np.testing.assert_allclose(of(a.inverse() @ a), np.eye(4), atol=1e-15)
    np.testing.assert_array_equal(type(a).identity() @ points, points)
    homogeneous_points = np.concatenate([points, np.ones((4, 5, 1))], axis=-1)
    np.testing.assert_allclose(a @ points, (homogeneous_points @ of(a).T)[..., :3], atol=1e-14)


def test_a_camera_moves_with_its_world():
    similarity, cam_from_world = random_similarity(3), random_pose(4)
    points = RNG.normal(size=(6, 3))
    moved = similarity.transform_camera(cam_from_world)
    before, after = np.asarray(cam_from_world @ points), np.asarray(moved @ (similarity @ points))
    np.testing.assert_allclose(after, similarity.scale * before, atol=1e-13)
    np.testing.assert_allclose(moved.rotation @ moved.rotation.T, np.eye(3), atol=1e-14)
    center = cam_from_world.inverse().translation
    np.testing.assert_allclose(moved.inverse().translation, similarity @ center, atol=1e-13)


def test_gimbal_is_the_chain_of_the_thesis():
    pan, tilt, center, offset, lens = 0.4, 1.9, np.array([1.0, 2.0, 1.5]), np.array([0.1, -0.05, 0.2]), 0.016
    move, turn_z, turn_x, shift, perspective = (np.eye(4) for _ in range(5))
    move[:3, 3], shift[:3, 3] = -center, -offset
    turn_z[:3, :3] = Rotation.from_rotvec([0, 0, -pan]).as_matrix()
    turn_x[:3, :3] = Rotation.from_rotvec([-tilt, 0, 0]).as_matrix()
    perspective[3, 2] = -1 / lens
    points = RNG.normal(size=(10, 3)) * 3
    image = np.concatenate([points, np.ones((10, 1))], axis=1) @ (perspective @ shift @ turn_x @ turn_z @ move).T
    local = np.asarray(gimbal(pan, tilt, center, offset, lens) @ points)
    np.testing.assert_allclose(lens * local[:, :2] / local[:, 2:], image[:, :2] / image[:, 3:], rtol=1e-12)
    # Eq. 2.6 as printed, but for its entry (3, 3).
    (c, s), (ca, sa) = (np.cos(pan), np.sin(pan)), (np.cos(tilt), np.sin(tilt))
    printed = np.array([[c, s, 0], [-s * ca, c * ca, sa], [s * sa, -c * sa, ca]])
    np.testing.assert_allclose((turn_x @ turn_z)[:3, :3], printed, atol=1e-15)


def test_gimbal_looks_level_and_upright():
    pose = gimbal(0.0, np.pi / 2, np.array([0.0, 0.0, 2.0]), np.zeros(3))
    ahead, above = np.asarray(pose @ np.array([[0.0, -3.0, 2.0], [0.0, -3.0, 2.5]]))
    np.testing.assert_allclose(ahead, [0, 0, 3], atol=1e-15)
    np.testing.assert_allclose(above, [0, -0.5, 3], atol=1e-15)  # y is down
    assert np.linalg.det(pose.rotation) == pytest.approx(1.0)
