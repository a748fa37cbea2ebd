"""Cameras that have one lens in common: the optimum, its covariance, and what is refused."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxpoint import CalibrateSettings, CameraRig, Tracks, calibrate
from jaxpoint.calibration.covariance import with_covariance
from jaxpoint.calibration.normal import normal_equations
from jaxpoint.calibration.quality import assess
from jaxpoint.calibration.recording import NOISE_PX
from jaxpoint.calibration.shared_lenses import groups_without, lens_owners
from jaxpoint.config import LensSettings, OutlierSettings
from jaxpoint.errors import UsageError
from jaxpoint.io.result_files import load_result, save_result
from jaxpoint.simulate.rooms import random_poses, waved_path

SIZE, COUNT, FRAMES, NOISE = (1280, 720), 4, 60, 0.4
SHARED = LensSettings(shared=("cam_0,cam_2,cam_3",), distortion="radial1", principal_point="fixed")
PLAIN = CalibrateSettings(lens=SHARED, outliers=OutlierSettings(loss="none"))
FOCALS, K1 = np.array([900.0, 1000.0, 900.0, 900.0]), np.array([-0.2, -0.1, -0.2, -0.2])
LENS = [0, 1, 0, 0]  # of each camera


def recorded(frames: int, stride: int, late: np.ndarray) -> Tracks:
    """What four cameras show of a light, each some frames late."""
    rng = np.random.default_rng(7)
    rotation, translation = random_poses(rng, COUNT, "around")
    center = (np.array(SIZE) - 1) / 2
    with jax.enable_x64(True):
        rig = CameraRig.from_parameters(
            np.tile(FOCALS[:, None], 2), np.tile(center, (COUNT, 1)), np.pad(K1[:, None], ((0, 0), (0, 4))),
            rotation, translation, np.tile(SIZE, (COUNT, 1)),
        )  # fmt: skip
        path = waved_path(rng, frames, stride)
        shown = [np.asarray(camera.project(path(np.arange(frames) - by))) for camera, by in zip(rig, late)]
    pixels = np.stack(shown, axis=1)
    visible = ((pixels > 0) & (pixels < np.array(SIZE) - 1)).all(axis=-1)
    return Tracks.from_pixels(pixels + rng.normal(0, NOISE, pixels.shape), np.tile(SIZE, (COUNT, 1)), visible)


@pytest.fixture(scope="module")
def tracks() -> Tracks:
    return recorded(FRAMES, 6, np.zeros(COUNT))


@pytest.fixture(scope="module")
def found(tracks):
    return with_covariance(calibrate(tracks, PLAIN))


def dense_residuals(values: np.ndarray, found) -> np.ndarray:
    """Pixels and priors of two lenses, four poses and all points, in plain numpy."""
    lenses, poses, points = np.split(values, [4, 4 + 6 * COUNT])
    points, kept = points.reshape(-1, 3), found.kept
    rows = []
    for camera, pose in enumerate(poses.reshape(COUNT, 6)):
        focal, k1 = lenses.reshape(2, 2)[LENS[camera]]
        local = points @ Rotation.from_rotvec(pose[:3]).as_matrix().T + pose[3:]
        plane = local[:, :2] / local[:, 2:]
        seen = focal * plane * (1 + k1 * (plane**2).sum(axis=1, keepdims=True)) + (np.array(SIZE) - 1) / 2
        rows.append((seen - found.tracks.pixels[:, camera])[kept[:, camera]].ravel())
    return np.concatenate([*rows, NOISE_PX * lenses[[1, 3]]])


def test_the_optimum_and_its_covariance_are_those_of_a_dense_fit(found):
    rig = found.rig
    lenses = [*zip(np.asarray(rig.cameras.focal)[:2, 0], np.asarray(rig.cameras.distortion)[:2, 0])]
    turns = Rotation.from_matrix(np.asarray(rig.cameras.cam_from_world.rotation)).as_rotvec()
    poses = np.concatenate([turns, np.asarray(rig.cameras.cam_from_world.translation)], axis=1)
    values = np.concatenate([np.ravel(lenses), poses.ravel(), found.points.ravel()])
    step = 1e-6
    jacobian = np.stack(
        [
            (dense_residuals(values + step * unit, found) - dense_residuals(values - step * unit, found)) / (2 * step)
            for unit in np.eye(len(values))
        ],
        axis=1,
    )
    residuals = dense_residuals(values, found)
    move = -np.linalg.pinv(jacobian, rcond=1e-9) @ residuals
    dense = np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-13, hermitian=True)
    sigmas = np.sqrt(np.diagonal(found.camera_covariance)).reshape(COUNT, -1)
    scale = sigmas[0, 6] / np.sqrt(dense[0, 0])  # of the noise, the same for all
    assert np.abs(move[:4] / (scale * np.sqrt(np.diagonal(dense)[:4]))).max() < 0.01
    assert scale == pytest.approx(NOISE, rel=0.1)
    np.testing.assert_allclose(sigmas[[0, 1], 6], scale * np.sqrt(np.diagonal(dense)[[0, 2]]), rtol=1e-3)
    np.testing.assert_allclose(sigmas[[0, 1], 10], scale * np.sqrt(np.diagonal(dense)[[1, 3]]), rtol=1e-3)


def test_cameras_of_a_group_have_one_lens_and_the_others_their_own(found):
    parameters = np.asarray(found.rig.cameras.lens.parameters)
    np.testing.assert_allclose(parameters[[2, 3]], parameters[[0, 0]], rtol=1e-12)
    assert parameters[1, 0] > parameters[0, 0] + 50
    np.testing.assert_allclose(parameters[:, 0], FOCALS, rtol=0.01)
    blocks = found.camera_covariance.reshape(COUNT, 15, COUNT, 15)
    np.testing.assert_allclose(blocks[0, 6:, 3, 6:], blocks[0, 6:, 0, 6:], atol=1e-12)  # they move together
    assert found.freedom.parameters == 6 * COUNT + 2 * 2


def test_a_shared_lens_is_better_known(found, tracks):
    alone = with_covariance(calibrate(tracks, replace(PLAIN, lens=replace(SHARED, shared=()))))
    shared, single = (np.sqrt(np.diagonal(one.camera_covariance)).reshape(COUNT, -1)[:, 6] for one in (found, alone))
    assert (shared[[0, 2, 3]] < 0.75 * single[[0, 2, 3]]).all()


def test_the_score_test_knows_of_it(found):
    step = normal_equations(found).solve(found.freedom.at_noise(found.sigma_px))
    sigmas = np.sqrt(np.diagonal(found.camera_covariance)).reshape(COUNT, -1)[:, 6] / FOCALS
    np.testing.assert_allclose(step.sigmas[:, 6], sigmas, rtol=0.02)
    np.testing.assert_allclose(step.change[[2, 3], 6], step.change[0, 6])


def test_a_run_keeps_who_shares_a_lens(found, tmp_path):
    save_result(tmp_path, found, {})
    again = load_result(tmp_path)
    np.testing.assert_array_equal(again.freedom.owner, [0, 1, 0, 0])
    fresh = with_covariance(replace(again, camera_covariance=None))
    np.testing.assert_allclose(fresh.camera_covariance, found.camera_covariance, rtol=1e-5, atol=1e-14)


def test_one_lens_for_unlike_cameras_is_refused(found, tracks):
    assert assess(found, PLAIN).passed
    for groups in (("cam_0,cam_1", "cam_2,cam_3"), ("all",)):
        wrong = replace(PLAIN, lens=replace(SHARED, shared=groups), outliers=OutlierSettings())
        judged = assess(with_covariance(calibrate(tracks, wrong)), wrong)
        assert not judged.passed
        assert "shared lens" in judged.causes
        assert "cam_1" in str(judged.failure)


@pytest.mark.parametrize(
    ("groups", "said"),
    [
        (("cam_0,cam_9",), "names camera 'cam_9'"),
        (("cam_0",), "names 1 camera"),
        (("cam_0,cam_1", "cam_1,cam_2"), "'cam_1' twice"),
        (("cam_0,cam_0",), "'cam_0' twice"),
        (("all",), "are 1280 x 720 px, those of 'cam_2' 640 x 480 px"),
    ],
)
def test_wrong_groups_are_refused(groups, said):
    sizes = np.array([[1280, 720], [1280, 720], [640, 480], [1, 1]])
    with pytest.raises(UsageError, match=said):
        lens_owners(groups, ("cam_0", "cam_1", "cam_2"), sizes)


def test_groups_lose_a_camera_that_is_left_out():
    assert groups_without(("a,b,c", "d,e", "all"), "d") == ("a,b,c", "all")
    assert groups_without(("a,b,c",), "b") == ("a,c",)


def test_cameras_out_of_step_may_share_a_lens():
    late = np.array([0.0, 0.4, -0.3, 0.2])
    found = calibrate(recorded(200, 20, late), replace(PLAIN, time_offsets=True, outliers=OutlierSettings()))
    np.testing.assert_allclose(found.time_offsets.frames, late, atol=0.03)
    assert np.abs((found.time_offsets.frames - late)[1:] / found.time_offsets.sigma[1:]).max() < 4
    parameters = np.asarray(found.rig.cameras.lens.parameters)
    np.testing.assert_allclose(parameters[[2, 3]], parameters[[0, 0]], rtol=1e-12)
    np.testing.assert_allclose(parameters[:, 0], FOCALS, rtol=0.01)
