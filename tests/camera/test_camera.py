"""Cameras and rigs against OpenCV."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxpoint.camera.brown import Brown
from jaxpoint.camera.camera import Camera
from jaxpoint.camera.pinhole import Pinhole
from jaxpoint.camera.remap import undistortion_map
from jaxpoint.camera.rig import CameraRig
from jaxpoint.geometry.line import distance_to_point
from jaxpoint.geometry.pose import Pose, Similarity
from jaxpoint.geometry.rotation import left_jacobian_inverse

RNG = np.random.default_rng(0)
LENS = np.array([-0.25, 0.06, 1e-3, -5e-4, -0.005])
ROTVEC, TRANSLATION = np.array([0.3, -0.7, 0.4]), np.array([0.2, -0.1, 4.0])
FOCAL, CENTER = np.array([900.0, 880.0]), np.array([650.3, 370.8])
INTRINSICS = np.array([[FOCAL[0], 0, CENTER[0]], [0, FOCAL[1], CENTER[1]], [0, 0, 1]])
ROTATION = Rotation.from_rotvec(ROTVEC).as_matrix()
CAMERA = Camera(Brown.of(FOCAL, CENTER, LENS), Pose(ROTATION, TRANSLATION))
POINTS = RNG.uniform(-1.5, 1.5, (40, 3))
PROJECT, DEPTH, UNDISTORT, RAY = (jax.jit(f) for f in (Camera.project, Camera.depth, Camera.undistort, Camera.ray))


def opencv_pixels(points):
    return cv2.projectPoints(points, ROTVEC, TRANSLATION, INTRINSICS, LENS)[0][:, 0]


def test_project_is_opencvs():
    pixels = PROJECT(CAMERA, POINTS)
    np.testing.assert_allclose(pixels, opencv_pixels(POINTS), atol=1e-9)
    one_by_one = jax.jit(jax.vmap(CAMERA.project))(POINTS)
    np.testing.assert_allclose(one_by_one, pixels, atol=1e-10)
    np.testing.assert_allclose(PROJECT(CAMERA, POINTS.reshape(5, 8, 3)).reshape(-1, 2), pixels, atol=1e-10)


def test_undistort_is_opencvs():
    pixels = opencv_pixels(POINTS)
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-15)
    theirs = cv2.undistortPoints(pixels[:, None], INTRINSICS, LENS, None, None, INTRINSICS, stop)[:, 0]
    ours, valid = UNDISTORT(CAMERA, pixels)
    assert np.asarray(valid).all()
    np.testing.assert_allclose(ours, theirs, atol=1e-9)
    homogeneous = np.concatenate([POINTS, np.ones((40, 1))], axis=1) @ np.asarray(CAMERA.matrix).T
    np.testing.assert_allclose(ours, homogeneous[:, :2] / homogeneous[:, 2:], atol=1e-9)


def test_rays_depth_and_position():
    rays = RAY(CAMERA, opencv_pixels(POINTS))
    np.testing.assert_allclose(distance_to_point(rays, POINTS), 0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(rays.direction, axis=1), 1, atol=1e-15)
    np.testing.assert_allclose(rays.origin[0], -ROTATION.T @ TRANSLATION, atol=1e-15)
    np.testing.assert_allclose(CAMERA.position, -ROTATION.T @ TRANSLATION, atol=1e-15)
    np.testing.assert_allclose(CAMERA.depth(POINTS), (POINTS @ ROTATION.T + TRANSLATION)[:, 2], atol=1e-14)
    assert (np.sum((POINTS - np.asarray(rays.origin)) * np.asarray(rays.direction), axis=1) > 0).all()
    np.testing.assert_array_equal(CAMERA.intrinsics, INTRINSICS)


def test_derivatives_by_all_numbers_are_opencvs():
    theirs = cv2.projectPoints(POINTS, ROTVEC, TRANSLATION, INTRINSICS, LENS)[1].reshape(40, 2, -1)
    # OpenCV: rotation vector (not a left rotation), translation, fx, fy, cx, cy, k1, k2, p1, p2, k3.
    theirs = np.concatenate([theirs[..., :3] @ np.asarray(left_jacobian_inverse(ROTVEC)), theirs[..., 3:]], axis=2)
    ours = jax.jit(jax.jacfwd(lambda change: CAMERA.perturbed(change).project(POINTS)))(np.zeros(15))
    np.testing.assert_allclose(ours, theirs[..., :15], rtol=1e-9, atol=1e-7)


def test_a_pinhole_has_ten_parameters():
    pinhole = Camera(Pinhole.of(FOCAL, CENTER), CAMERA.cam_from_world)
    with pytest.raises(ValueError, match="10 parameters"):
        pinhole.perturbed(np.zeros(15))
    np.testing.assert_allclose(
        pinhole.project(POINTS), cv2.projectPoints(POINTS, ROTVEC, TRANSLATION, INTRINSICS, None)[0][:, 0], atol=1e-9
    )


@pytest.mark.parametrize("local", [[0.0, 0, 0], [1, 1, 0], [1, -2, 1e-15], [0.5, 0.5, -2], [0, 0, 3.0]])
def test_values_and_gradients_are_finite_everywhere(local):
    point = ROTATION.T @ (np.array(local) - TRANSLATION)
    value, gradient = VALUE_AND_GRAD(CAMERA, point)
    assert np.isfinite(value)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))


VALUE_AND_GRAD = jax.jit(jax.value_and_grad(lambda camera, point: jnp.sum(camera.project(point)), argnums=(0, 1)))


def test_undistortion_map_is_opencvs():
    size, new = (320, 240), np.array([[700.0, 0, 150], [0, 690, 130], [0, 0, 1]])
    for intrinsics in (None, new):
        ours = undistortion_map(CAMERA, size, intrinsics)
        target = INTRINSICS if intrinsics is None else intrinsics
        theirs = cv2.initUndistortRectifyMap(INTRINSICS, LENS, None, target, size, cv2.CV_32FC1)
        for one, other in zip(ours, theirs, strict=True):
            assert one.dtype == np.float32
            np.testing.assert_allclose(one, other, atol=2e-3)  # float32 and OpenCV's own steps
    # Exactly: the map is where the camera projects what the ideal pixel sees.
    column, row = np.meshgrid(np.arange(320.0), np.arange(240.0))
    rays = np.stack([(column - 150) / 700, (row - 130) / 690, np.ones_like(row)], axis=-1).reshape(-1, 3)
    exact = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), INTRINSICS, LENS)[0].reshape(240, 320, 2)
    np.testing.assert_array_almost_equal_nulp(np.stack(ours, axis=-1), exact.astype(np.float32), nulp=1)
    with pytest.raises(ValueError, match="0 x 240"):
        undistortion_map(CAMERA, (0, 240))


def random_rig(count=3, seed=0):
    rng = np.random.default_rng(seed)
    return CameraRig.from_parameters(
        rng.uniform(600, 1200, (count, 2)),
        rng.uniform(300, 600, (count, 2)),
        rng.normal(size=(count, 5)) * [0.1, 0.02, 1e-3, 1e-3, 1e-3],
        Rotation.from_rotvec(rng.normal(size=(count, 3)) * 0.3).as_matrix(),
        rng.normal(size=(count, 3)) * 0.5 + [0, 0, 5],
        np.tile([1280, 720], (count, 1)),
        [f"view {i}" for i in range(count)],
    )


def test_rig_is_its_cameras():
    rig = random_rig()
    assert len(rig) == 3
    pixels = rig.project(POINTS)
    assert pixels.shape == (40, 3, 2)
    undistorted, valid = rig.undistort(pixels)
    rays = rig.rays(pixels)
    for i, camera in enumerate(rig):
        np.testing.assert_allclose(pixels[:, i], PROJECT(camera, POINTS), atol=1e-9)
        np.testing.assert_allclose(rig.depth(POINTS)[:, i], DEPTH(camera, POINTS), atol=1e-13)
        np.testing.assert_allclose(undistorted[:, i], UNDISTORT(camera, pixels[:, i])[0], atol=1e-9)
        np.testing.assert_allclose(rays.direction[:, i], RAY(camera, pixels[:, i]).direction, atol=1e-13)
        np.testing.assert_allclose(rig.matrices[i], camera.matrix, atol=1e-12)
        np.testing.assert_allclose(rig.positions[i], camera.position, atol=1e-14)
    assert np.asarray(valid).all()
    np.testing.assert_array_equal(rig["view 1"].focal, rig[1].focal)
    np.testing.assert_array_equal(rig[-1].focal, rig[2].focal)
    np.testing.assert_array_equal(rig.select([2, 0]).positions, rig.positions[jnp.array([2, 0])])
    assert rig.select([2, 0]).names == ("view 2", "view 0")
    assert rig.project(POINTS[0]).shape == (3, 2)


def test_a_similarity_of_the_world_changes_no_pixel():
    rig = random_rig()
    similarity = Similarity(np.float64(2.7), Rotation.from_rotvec([1.0, 2, -0.4]).as_matrix(), [3.0, -1, 2])
    moved = rig.transformed(similarity)
    np.testing.assert_allclose(moved.project(similarity @ POINTS), rig.project(POINTS), atol=1e-9)
    np.testing.assert_allclose(moved.positions, similarity @ rig.positions, atol=1e-12)
    np.testing.assert_allclose(moved.depth(similarity @ POINTS), 2.7 * rig.depth(POINTS), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(moved.cameras.cam_from_world.rotation), 1, atol=1e-14)


@pytest.mark.usefixtures("any_shape")
def test_rig_says_what_is_wrong():
    rig = random_rig()
    with pytest.raises(ValueError, match=r"called 'door'.*view 0"):
        rig["door"]
    with pytest.raises(IndexError, match="Camera 3"):
        rig[3]
    with pytest.raises(ValueError, match="each once"):
        rig.select([0, 0])
    parameters = [np.ones((2, 2)), np.ones((2, 2)), np.zeros((2, 5)), np.ones((2, 3, 3)), np.ones((2, 3))]
    sizes = np.ones((2, 2), dtype=int)
    with pytest.raises(ValueError, match="2 different names"):
        CameraRig.from_parameters(*parameters, sizes, ["a", "a"])
    with pytest.raises(ValueError, match=r"\(2, 5\)"):
        CameraRig.from_parameters(*parameters[:2], np.zeros((2, 4)), *parameters[3:], sizes)
    with jax.enable_x64(False):
        with pytest.raises(ValueError, match="jax_enable_x64"):
            CameraRig.from_parameters(*parameters, sizes)
        with pytest.raises(ValueError, match="jax_enable_x64"):
            rig.project(POINTS.astype(np.float32))
        with pytest.raises(ValueError, match="jax_enable_x64"):
            _ = rig.positions


def test_float32_rig_stays_float32():
    cameras = random_rig().cameras
    parts = (cameras.focal, cameras.center, cameras.distortion, *jax.tree.leaves(cameras.cam_from_world))
    parameters = [np.asarray(leaf, dtype=np.float32) for leaf in parts]
    rig = CameraRig.from_parameters(*parameters, random_rig().image_sizes)
    assert rig.names == ("cam_0", "cam_1", "cam_2")
    pixels = rig.project(POINTS.astype(np.float32))
    assert pixels.dtype == jnp.float32
    np.testing.assert_allclose(pixels, random_rig().project(POINTS), atol=2e-2)
