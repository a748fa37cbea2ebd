"""Lines of pointing against sums by hand, Monte Carlo and simulated people; holds against scipy and known tremor."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize

from jaxpoint.body.joints import Joints, estimate_joints, joints_with_covariance, other_eye
from jaxpoint.pointing.held_mean import held_mean
from jaxpoint.pointing.pointing_line import KINDS, pointing_lines, pointing_ray, weights_of

HEAD, ELBOW = np.array([0.0, 0.0, 1.6]), np.array([0.2, -0.25, 1.25])
WRIST, TIP = np.array([0.42, -0.18, 1.4]), np.array([0.58, -0.12, 1.46])
MEASURED = np.concatenate([HEAD, ELBOW, WRIST, TIP])
UP = np.array([0.0, 0.0, 1.0])


def unit(vector):
    return vector / np.linalg.norm(vector)


def batch(joints: Joints) -> Joints:
    return jax.tree.map(lambda leaf: leaf[None], joints)


def test_every_line_goes_through_its_joints():
    joints = estimate_joints(HEAD, ELBOW, WRIST, TIP)
    hand = (WRIST + TIP) / 2
    wanted = {
        "forearm": WRIST - ELBOW,
        "finger": TIP - WRIST,
        "eye-fingertip": TIP - np.asarray(joints.eye),
        "head-hand": hand - HEAD,
        "shoulder-hand": hand - np.asarray(joints.shoulder),
    }
    assert tuple(wanted) == KINDS
    for kind, direction in wanted.items():
        ray = pointing_ray(joints, weights_of(kind))
        np.testing.assert_allclose(ray.direction, unit(direction), atol=1e-12)
        np.testing.assert_allclose(ray.origin, TIP)
    blend = pointing_ray(joints, weights_of({"forearm": 1.0, "head-hand": 3.0})).direction
    np.testing.assert_allclose(blend, unit(unit(WRIST - ELBOW) + 3 * unit(hand - HEAD)), atol=1e-12)


@pytest.mark.parametrize("wrong", ["nose", {"forearm": 0.0}, {"forearm": -1.0, "finger": 2.0}, {}])
def test_weights_that_make_no_line_are_refused(wrong):
    with pytest.raises(ValueError, match=r"There is no line|The weights of a blend"):
        weights_of(wrong)


def test_the_covariance_of_a_line_is_that_of_many_noisy_arms():
    rng = np.random.default_rng(0)
    root = 0.004 * rng.normal(size=(12, 12))
    joints, covariance = joints_with_covariance(MEASURED, root @ root.T)
    drawn = MEASURED + rng.normal(size=(20_000, 12)) @ root.T
    for kind in ("forearm", "finger", "head-hand"):  # of measured joints alone
        line = pointing_lines(batch(joints), covariance[None], weights_of(kind)[None])
        parts = {"forearm": (drawn[:, 3:6], drawn[:, 6:9]), "finger": (drawn[:, 6:9], drawn[:, 9:])}
        parts["head-hand"] = drawn[:, :3], (drawn[:, 6:9] + drawn[:, 9:]) / 2
        start, end = parts[kind]
        directions = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
        sampled = np.cov(np.concatenate([drawn[:, 9:], directions], axis=1).T)
        stated = np.asarray(line.covariance[0])
        np.testing.assert_allclose(stated, sampled, atol=0.05 * np.abs(np.diag(sampled)).max())
        assert abs(np.asarray(line.ray.direction[0]) @ stated[3:, 3:] @ np.asarray(line.ray.direction[0])) < 1e-15


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_are_those_of_finite_differences(kind):
    def direction(flat):
        joints = estimate_joints(*(flat[3 * i : 3 * i + 3] for i in range(4)))
        return pointing_ray(joints, weights_of(kind)).direction

    step = np.random.default_rng(1).normal(size=12)
    _, derivative = jax.jvp(direction, (jnp.asarray(MEASURED),), (jnp.asarray(step),))
    wanted = (direction(MEASURED + 1e-6 * step) - direction(MEASURED - 1e-6 * step)) / 2e-6
    np.testing.assert_allclose(derivative, wanted, atol=1e-7)
    vertical = np.concatenate([HEAD, ELBOW, HEAD - [0, 0, 0.4], HEAD - [0, 0, 0.6]])  # points straight down
    assert np.isfinite(jax.jacfwd(direction)(jnp.asarray(vertical))).all()


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_eye_and_shoulder_lie_on_the_side_of_the_arm(side):
    """Of both arms, mirrored, and wherever the person faces."""
    mirror = np.array([1.0, side, 1.0])
    joints = estimate_joints(*(mirror * place for place in (HEAD, ELBOW, WRIST, TIP)))
    gaze = unit(mirror * (TIP - HEAD))
    left = unit(np.cross(UP, gaze))
    arm = -side  # of the elbow, in y to the left
    assert (
        np.sign((np.asarray(joints.eye) - HEAD) @ left) == np.sign((np.asarray(joints.shoulder) - HEAD) @ left) == arm
    )
    other = np.asarray(other_eye(joints).eye)
    between = (other + np.asarray(joints.eye)) / 2 - HEAD
    np.testing.assert_allclose(between @ left, 0, atol=1e-12)
    assert 0.05 < between @ gaze < 0.1
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = estimate_joints(*(turn @ (mirror * place) for place in (HEAD, ELBOW, WRIST, TIP)))
    np.testing.assert_allclose(turned.eye, turn @ np.asarray(joints.eye), atol=1e-12)


def test_the_mean_of_a_hold_is_its_geometric_median():
    rng = np.random.default_rng(2)
    values = rng.normal(size=(12, 3))
    values[9:] += 5.0  # another limb
    seen = np.arange(16) < 12
    padded = np.concatenate([values, np.full((4, 3), 1e3)])
    mean, _, weights = held_mean(padded[None], np.zeros((1, 16, 3, 3)), seen[None])
    best = minimize(lambda x: np.linalg.norm(values - x, axis=1).sum(), values.mean(axis=0), method="Nelder-Mead")
    np.testing.assert_allclose(mean[0], best.x, atol=5e-3)
    assert (np.asarray(weights[0])[12:] == 0).all()
    assert np.linalg.norm(np.asarray(mean[0])) < 1.0 < np.linalg.norm(values.mean(axis=0))


def test_the_covariance_of_a_mean_knows_that_tremor_is_correlated():
    """Means over many holds scatter as stated, whether frames are independent or hang together."""
    rng = np.random.default_rng(3)
    for memory in (0.0, 0.8):
        noise = rng.normal(size=(400, 40, 3))
        tremor = np.zeros_like(noise)
        for frame in range(40):
            before = tremor[:, frame - 1] if frame else rng.normal(size=(400, 3))
            tremor[:, frame] = memory * before + np.sqrt(1 - memory**2) * noise[:, frame]
        zeros = np.zeros((400, 40, 3, 3))
        mean, stated, _ = held_mean(0.003 * tremor, zeros, np.ones((400, 40), bool))
        ratio = np.trace(np.cov(np.asarray(mean).T)) / np.trace(np.asarray(stated).mean(axis=0))
        assert 0.5 < ratio < 2.0
        _, same, _ = held_mean(0.003 * tremor, zeros + 1e-4 * np.eye(3), np.ones((400, 40), bool))
        np.testing.assert_allclose(same - stated, np.broadcast_to(1e-4 * np.eye(3), same.shape), atol=1e-9)


def test_a_frame_that_saw_next_to_nothing_does_not_make_the_others_worthless():
    rng = np.random.default_rng(4)
    values, own = 0.003 * rng.normal(size=(1, 9, 3)), np.tile(1e-4 * np.eye(3), (1, 9, 1, 1))
    _, usual, _ = held_mean(values, own, np.ones((1, 9), bool))
    blind = own.copy()
    blind[0, 4] = 1e8 * np.eye(3)
    _, found, _ = held_mean(values, blind, np.ones((1, 9), bool))
    assert (np.diagonal(found[0]) < 1.6 * np.diagonal(usual[0])).all()
    assert (np.diagonal(found[0]) > np.diagonal(usual[0])).all()
