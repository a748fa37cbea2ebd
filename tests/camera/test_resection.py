"""Resection and decomposition against OpenCV, scipy and the truth."""

import cv2
import jax
import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from jaxpoint.camera.brown import Brown
from jaxpoint.camera.camera import Camera
from jaxpoint.camera.resection import decompose_projection, projection_from_points, resect, resection
from jaxpoint.errors import InsufficientDataError
from jaxpoint.geometry.pose import Pose

RNG = np.random.default_rng(0)
ROTVEC, TRANSLATION = np.array([1.9, -0.6, 0.4]), np.array([0.2, -0.4, 5.0])
ROTATION = Rotation.from_rotvec(ROTVEC).as_matrix()
LENS = np.array([-0.2, 0.05, 5e-4, -1e-3, 0.01])
PINHOLE = Camera(Brown.of(np.array([900.0, 880.0]), np.array([650.0, 370.0])), Pose(ROTATION, TRANSLATION))
POINTS = RNG.uniform(-1.5, 1.5, (60, 3))
SEEN = jax.jit(Camera.project)
DECOMPOSE, PROJECTION = jax.jit(decompose_projection), jax.jit(projection_from_points)


def test_six_points_without_noise_give_the_camera():
    found = resect(POINTS[:6], SEEN(PINHOLE, POINTS)[:6], refine=False).camera
    np.testing.assert_allclose(found.focal, PINHOLE.focal, rtol=1e-9)
    np.testing.assert_allclose(found.center, PINHOLE.center, rtol=1e-9)
    np.testing.assert_allclose(found.cam_from_world.rotation, ROTATION, atol=1e-10)
    np.testing.assert_allclose(found.cam_from_world.translation, TRANSLATION, rtol=1e-9)


def test_distorted_camera_is_found_to_rounding():
    camera = Camera(Brown.of(PINHOLE.focal, PINHOLE.center, LENS), PINHOLE.cam_from_world)
    result = resect(POINTS, SEEN(camera, POINTS), lens_terms=5)
    assert result.converged
    assert result.rms_px < 1e-9
    np.testing.assert_allclose(result.camera.distortion, LENS, atol=1e-9)
    np.testing.assert_allclose(result.camera.focal, camera.focal, rtol=1e-9)


def test_refined_cost_is_scipys_minimum():
    pixels = np.asarray(SEEN(PINHOLE, POINTS)) + RNG.normal(size=(60, 2)) * 0.7

    def residuals(x):
        matrix = np.array([[x[0], 0, x[2]], [0, x[1], x[3]], [0, 0, 1]])
        return (cv2.projectPoints(POINTS, x[4:7], x[7:10], matrix, None)[0][:, 0] - pixels).ravel()

    start = np.concatenate([PINHOLE.focal, PINHOLE.center, ROTVEC, TRANSLATION])
    theirs = least_squares(residuals, start, x_scale=[900] * 4 + [1] * 6, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    ours = resect(POINTS, pixels)
    assert ours.converged
    assert ours.rms_px == pytest.approx(np.sqrt(2 * theirs.cost / 60), rel=1e-9)
    np.testing.assert_allclose(ours.camera.focal, theirs.x[:2], rtol=1e-5)
    assert ours.rms_px < resect(POINTS, pixels, refine=False).rms_px


@pytest.mark.parametrize("scale", [1.0, -3.7, 1e-4])
def test_decomposition_is_opencvs(scale):
    skewed = np.array([[900.0, 4.0, 650], [0, 880, 370], [0, 0, 1]])
    matrix = scale * skewed @ np.concatenate([ROTATION, TRANSLATION[:, None]], axis=1)
    intrinsics, pose = DECOMPOSE(matrix)
    their_intrinsics, their_rotation, their_center, *_ = cv2.decomposeProjectionMatrix(matrix * np.sign(scale))
    np.testing.assert_allclose(intrinsics, their_intrinsics / their_intrinsics[2, 2], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(pose.rotation, their_rotation, atol=1e-12)
    center = their_center[:3, 0] / their_center[3, 0]
    np.testing.assert_allclose(pose.inverse().translation, center, atol=1e-10)
    assert np.linalg.det(pose.rotation) == pytest.approx(1)


def test_projection_is_pure_and_differentiable():
    pixels = np.asarray(SEEN(PINHOLE, POINTS)[:12]) + RNG.normal(size=(12, 2)) * 0.1
    jacobian = np.asarray(jax.jit(jax.jacrev(lambda p: projection_from_points(POINTS[:12], p)))(pixels))
    step = np.zeros_like(pixels)
    step[3, 1] = 1e-4
    numeric = (PROJECTION(POINTS[:12], pixels + step) - PROJECTION(POINTS[:12], pixels - step)) / 2e-4
    np.testing.assert_allclose(jacobian[:, :, 3, 1], numeric, rtol=1e-5, atol=1e-5 * abs(numeric).max())
    both = jax.jit(jax.vmap(projection_from_points, in_axes=(None, 0)))(POINTS[:12], np.stack([pixels, pixels + 1]))
    np.testing.assert_allclose(both[0], PROJECTION(POINTS[:12], pixels), rtol=1e-8)
    weights = np.append(np.ones(12), 0.0)
    hidden = PROJECTION(np.vstack([POINTS[:12], [9.0, 9, 9]]), np.vstack([pixels, [0.0, 0]]), weights)
    np.testing.assert_allclose(hidden, both[0], rtol=1e-8)


def test_resection_is_a_function_for_jit_vmap_and_grad():
    pixels = np.asarray(SEEN(PINHOLE, POINTS)[:12]) + RNG.normal(size=(2, 12, 2)) * 0.5

    def focal(pixels):
        return resect(POINTS[:12], pixels).camera.focal.sum()

    both = jax.jit(jax.vmap(jax.value_and_grad(focal)))
    values, slopes = both(pixels)
    assert values[0] == pytest.approx(float(focal(pixels[0])), rel=1e-9)
    step = 1e-3 * RNG.normal(size=pixels.shape)
    numeric = (both(pixels + step)[0] - both(pixels - step)[0]) / 2
    np.testing.assert_allclose(np.sum(slopes * step, axis=(1, 2)), numeric, rtol=1e-4)
    assert jax.jit(resection)(POINTS[:12], pixels[1]).converged
    assert resect(POINTS[:12], pixels[0]).message == "converged"
    assert resect(POINTS[:12], pixels[0], refine=False).message == "linear solution"


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (POINTS[:5], "needs 6 points, not 5"),
        (POINTS * [1, 1, 0], "lie on a plane"),
        (np.vstack([POINTS[:9] * [1, 1, 0], POINTS[9:10]]), "more than one camera"),
        (POINTS * [1, 0, 0], "lie on a plane"),
    ],
)
def test_too_little_is_refused(points, message):
    with pytest.raises(InsufficientDataError, match=message):
        resect(points, PINHOLE.project(points))


def test_a_mirrored_image_is_refused():
    with pytest.raises(InsufficientDataError, match="behind the camera"):
        resect(POINTS, np.asarray(SEEN(PINHOLE, POINTS)) * [1, -1] + [0, 720])


@pytest.mark.usefixtures("any_shape")
def test_bad_input_is_named():
    pixels = np.asarray(SEEN(PINHOLE, POINTS))
    with pytest.raises(ValueError, match=r"not \(60, 3\) and \(59, 2\)"):
        resect(POINTS, pixels[1:])
    with pytest.raises(ValueError, match="not 3"):
        resect(POINTS, pixels, lens_terms=3)
    with pytest.raises(ValueError, match="NaN"):
        resect(POINTS, np.where(pixels == pixels[4], np.nan, pixels))
