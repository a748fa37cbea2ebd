"""The chain of essential matrices, and the lens that it and the factorisation hand on."""

import cv2
import numpy as np
import pytest

from jaxpoint.calibration.essential import FOCAL_GRID, chain, relative_pose, voted_focals
from jaxpoint.calibration.hypotheses import coefficients_of_division
from jaxpoint.calibration.twoview import fundamental
from jaxpoint.camera.lenses import chosen_lenses
from jaxpoint.camera.parameters import adjusted_lenses


def test_relative_pose_is_that_of_opencv(pinhole):
    half = pinhole.data.half_diagonals[0]
    focals = pinhole.room.focal / half
    both = pinhole.kept[:, 0] & pinhole.kept[:, 1]
    rays = [
        np.concatenate([pinhole.data.points[both, c] / focals[c], np.ones((both.sum(), 1))], axis=1) for c in (0, 1)
    ]
    scale = [np.diag([focals[c], focals[c], 1.0]) for c in (0, 1)]
    essential = scale[1] @ fundamental(pinhole.geometry, 0, 1) @ scale[0]
    turn, shift, count = relative_pose(essential, *rays)
    _, theirs_turn, theirs_shift, _ = cv2.recoverPose(essential, rays[0][:, :2], rays[1][:, :2], np.eye(3))
    assert count == both.sum()
    np.testing.assert_allclose(turn, theirs_turn, atol=1e-9)
    np.testing.assert_allclose(shift, theirs_shift[:, 0], atol=1e-9)
    room = pinhole.room
    np.testing.assert_allclose(turn, room.rotation[1] @ room.rotation[0].T, atol=1e-7)


def test_chain_recovers_the_rig_of_known_focal_lengths(pinhole):
    room = pinhole.room
    poses = chain(pinhole.geometry, pinhole.data.points, pinhole.kept, room.focal / pinhole.data.half_diagonals)
    assert poses is not None
    rotation, translation = poses
    relative = rotation @ rotation[0].T
    np.testing.assert_allclose(relative, room.rotation @ room.rotation[0].T, atol=1e-6)
    ours = -np.einsum("cji,cj->ci", rotation, translation)
    ours, true = (positions - positions[0] for positions in (ours, room.positions))
    ours, true = ours @ rotation[0].T, true @ room.rotation[0].T  # both in the first camera's frame
    np.testing.assert_allclose(ours / np.linalg.norm(ours), true / np.linalg.norm(true), atol=1e-6)


def test_chain_says_where_a_camera_is_not_reached(pinhole):
    kept = pinhole.kept.copy()
    kept[:, 3] = False
    focals = pinhole.room.focal / pinhole.data.half_diagonals
    assert chain(pinhole.geometry, pinhole.data.points, kept, focals) is None


def test_voted_focals_are_the_nearest_of_the_grid(pinhole):
    true = pinhole.room.focal / pinhole.data.half_diagonals
    step = np.log(FOCAL_GRID[1] / FOCAL_GRID[0])
    assert np.abs(np.log(voted_focals(pinhole.geometry) / true)).max() < 1.5 * step


@pytest.mark.parametrize("lens", [-0.3, -0.1, 0.0, 0.1])
@pytest.mark.parametrize("focal", [0.8, 1.6])
def test_coefficients_of_a_division_bend_alike(lens, focal):
    reach = 0.95
    k1, k2 = coefficients_of_division(lens, focal, reach, chosen_lenses("radial2", ("cam_0",)))[:2]
    bent = np.linspace(0.0, reach, 200)
    straight = bent / (1.0 + lens * bent**2) / focal
    again = focal * straight * (1.0 + k1 * straight**2 + k2 * straight**4)
    assert np.abs(again - bent).max() < 0.01 * reach  # a start, refined afterwards
    assert np.sign(np.round(k1, 12)) == np.sign(lens)


def test_adjusted_lenses_are_those_of_the_rig(noisy):
    numbers = adjusted_lenses(noisy.room.rig)
    np.testing.assert_allclose(numbers, noisy.truth.cameras[:, 6:], atol=1e-12)
