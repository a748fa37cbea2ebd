"""Rectified cameras: rows agree, disparities are depths, and OpenCV's Q says the same."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxpoint.camera.brown import Brown
from jaxpoint.camera.kannala_brandt import KannalaBrandt
from jaxpoint.camera.rectification import rectified_pixels, rectify
from jaxpoint.camera.remap import undistortion_map
from jaxpoint.camera.rig import CameraRig
from jaxpoint.errors import InsufficientDataError, UsageError

SIZE = (640, 480)
BENT = {Brown: [-0.25, 0.05, 0.001, -0.001, 0.0], KannalaBrandt: [0.02, -0.01, 0.005, -0.001]}
FOCAL = {Brown: 530.0, KannalaBrandt: 210.0}


def pair(lens=Brown, shift=(-0.08, 0.004, 0.01), turn=(0.01, 0.05, -0.02)):
    """Two cameras, the second to the right of the first, in a world of their own."""
    world = Rotation.from_rotvec([0.3, -0.2, 0.1]).as_matrix()
    turns = np.stack([world, Rotation.from_rotvec(turn).as_matrix() @ world])
    shifts = np.array([[0.1, 0.2, 0.3], Rotation.from_rotvec(turn).as_matrix() @ [0.1, 0.2, 0.3] + np.array(shift)])
    focal = FOCAL[lens] * np.array([[1.0, 1.01], [1.02, 1.0]])
    return CameraRig.from_parameters(
        focal, np.array([[322.0, 238.0], [316.0, 243.0]]), np.array([BENT[lens]] * 2), turns, shifts,
        np.array([SIZE] * 2), ("left", "right"), lens,
    )  # fmt: skip


@pytest.mark.parametrize("lens", BENT)
def test_rows_agree_and_disparities_are_depths(lens):
    rig = pair(lens)
    found = rectify(rig[0], rig[1], SIZE)
    rng = np.random.default_rng(0)
    own = rng.uniform([-0.3, -0.2, 0.6], [0.3, 0.2, 2.0], (50, 3))  # in the left camera's frame
    pose = rig[0].cam_from_world
    points = np.asarray(pose.inverse() @ jnp.asarray(own))
    pixels = np.asarray(rig.project(points))
    (left, ahead), (right, _) = (rectified_pixels(found, rig[c], c, pixels[:, c]) for c in range(2))
    assert ahead.all()
    np.testing.assert_allclose(left[:, 1], right[:, 1], atol=1e-8)
    disparity = left[:, 0] - right[:, 0]
    assert (disparity > 0).all()
    homogeneous = np.concatenate([left, disparity[:, None], np.ones((50, 1))], axis=1) @ found.to_points.T
    rectified = homogeneous[:, :3] / homogeneous[:, 3:]
    np.testing.assert_allclose(rectified @ found.rotations[0], own, atol=1e-8)
    centres = np.asarray(rig.positions)
    assert found.baseline == pytest.approx(np.linalg.norm(centres[1] - centres[0]))


def test_it_differs_from_that_of_opencv_by_a_turn_about_the_baseline_alone():
    """How far the rectified pair is turned about its baseline is free; OpenCV halves the turn between the cameras."""
    rig = pair()
    ours = rectify(rig[0], rig[1], SIZE)
    pose = rig.cameras.cam_from_world
    turns, shifts = np.asarray(pose.rotation), np.asarray(pose.translation)
    relative = turns[1] @ turns[0].T
    matrices = [np.asarray(camera.intrinsics) for camera in rig]
    bends = [np.asarray(camera.distortion) for camera in rig]
    shift = shifts[1] - relative @ shifts[0]
    shift = shift.reshape(3, 1)
    first, second, *_ = cv2.stereoRectify(matrices[0], bends[0], matrices[1], bends[1], SIZE, relative, shift)
    between = ours.rotations[0] @ first.T
    np.testing.assert_allclose(between[0], [1, 0, 0], atol=1e-9)
    np.testing.assert_allclose(ours.rotations[1] @ second.T, between, atol=1e-9)
    assert np.degrees(np.arccos(between[1, 1])) < 3


def test_depths_come_from_a_whole_image_of_disparities():
    rig = pair()
    found = rectify(rig[0], rig[1], SIZE)
    disparity = np.full((4, 5), np.nan)
    disparity[1, 2], disparity[3, 4] = 30.0, 60.0
    theirs = cv2.reprojectImageTo3D(disparity.astype(np.float32), found.to_points)
    ours = found.points(disparity)
    assert np.isfinite(ours).all(axis=2).sum() == 2
    for place in ((1, 2), (3, 4)):
        np.testing.assert_allclose(ours[place], theirs[place] @ found.rotations[0], rtol=1e-5)


def test_maps_turn_the_camera_as_opencv_does():
    rig = pair()
    found = rectify(rig[0], rig[1], SIZE)
    camera = rig[0]
    with jax.enable_x64(True):
        x, y = undistortion_map(camera, SIZE, found.intrinsics, found.rotations[0])
    theirs = cv2.initUndistortRectifyMap(
        np.asarray(camera.intrinsics), np.asarray(camera.distortion), found.rotations[0], found.intrinsics, SIZE,
        cv2.CV_32FC1,
    )  # fmt: skip
    np.testing.assert_allclose(np.asarray(x), theirs[0], atol=2e-3)
    np.testing.assert_allclose(np.asarray(y), theirs[1], atol=2e-3)


def test_cameras_that_are_no_stereo_pair_are_refused():
    right, same, behind = pair(), pair(shift=(0.0, 0.0, 0.0)), pair(shift=(0.0, 0.0, -0.3), turn=(0.0, 0.0, 0.0))
    with pytest.raises(UsageError, match="stands to the right of the other"):
        rectify(right[1], right[0], SIZE)
    with pytest.raises(InsufficientDataError, match="at one place"):
        rectify(same[0], same[1], SIZE)
    with pytest.raises(InsufficientDataError, match="along their baseline"):
        rectify(behind[0], behind[1], SIZE)
