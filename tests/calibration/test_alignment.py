"""Alignment to the room: a published one, invariants of Umeyama's method, and what must be refused."""

import dataclasses

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax.test_util import check_grads
from scipy.spatial.transform import Rotation

from jaxpoint.calibration.alignment import (
    Alignment,
    align_to_camera_centres,
    align_to_floor,
    align_to_landmarks,
    apply_alignment,
    umeyama,
)
from jaxpoint.calibration.result import Calibration, PairTable, Verdict
from jaxpoint.errors import InsufficientDataError
from jaxpoint.geometry.pose import Similarity
from jaxpoint.simulate.rooms import random_room

RNG = np.random.default_rng(0)
ROOM_POINTS = np.array([[0, 0, 0], [2, 0, 0.1], [0, 3, 0.2], [1, 1, 1.5], [2, 2.5, 0.8], [0.3, 2, 1.9]])
SOLVER = Similarity(0.4, Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix(), np.array([1.0, -2.0, 0.5]))
CAMERAS = np.array([[0, 0, 2.5], [4, 0, 2.4], [4, 4, 2.6], [0, 4, 2.5]])  # m


def solver(points):
    """The same points in a solver's frame."""
    return np.asarray(SOLVER.inverse() @ points)


def read_xyz(path):
    return np.genfromtxt(path, delimiter=",", skip_header=1)


def test_braid_alignment(data_folder):
    folder = data_folder / "braid_alignment"
    alignment = align_to_landmarks(read_xyz(folder / "unaligned.csv"), read_xyz(folder / "ground_truth.csv"))
    assert float(alignment.similarity.scale) == pytest.approx(0.46901, abs=5e-6)  # its README
    assert alignment.rms_mm == pytest.approx(19.69, abs=0.005)
    assert alignment.max_mm == pytest.approx(27.57, abs=0.005)
    assert alignment.handedness_verified
    assert alignment.warnings == ()
    assert all(out is not None and out > kept for out, kept in zip(alignment.leave_one_out_mm, alignment.residual_mm))


def test_braid_mirrored_is_refused(data_folder):
    folder = data_folder / "braid_alignment"
    truth = read_xyz(folder / "ground_truth.csv") * [1, -1, 1]
    with pytest.raises(
        InsufficientDataError, match=r"mirror image \(rms 19\.7 mm\) better than the room \(rms \d{3}\."
    ):
        align_to_landmarks(read_xyz(folder / "unaligned.csv"), truth)


vector = st.tuples(*[st.floats(-3, 3)] * 3).map(np.array)


@settings(max_examples=40, deadline=None)
@given(vector, vector, st.floats(-3, 3), st.integers(0, 2**32 - 1))
def test_umeyama_finds_any_similarity(rotvec, translation, log_scale, seed):
    scale, rotation = np.exp(log_scale), Rotation.from_rotvec(rotvec).as_matrix()
    source = np.random.default_rng(seed).normal(size=(6, 3))
    found = umeyama(source, scale * source @ rotation.T + translation)
    np.testing.assert_allclose(found.scale, scale, rtol=1e-10)
    np.testing.assert_allclose(found.rotation, rotation, atol=1e-9)
    np.testing.assert_allclose(found.translation, translation, atol=1e-9 * (1 + scale))


def test_umeyama_against_opencv_and_scipy():
    source, target = RNG.normal(size=(20, 3)), RNG.normal(size=(20, 3))  # nothing alike: all the freedom counts
    target += 3 * source @ Rotation.from_rotvec([1, 2, 3]).as_matrix()
    found = umeyama(source, target)
    affine, scale = cv2.estimateAffine3D(source, target, force_rotation=True)
    np.testing.assert_allclose(found.rotation, affine[:, :3], atol=1e-10)
    np.testing.assert_allclose(found.scale, scale, rtol=1e-10)
    weights = RNG.uniform(0.1, 2, 20)
    weighted = umeyama(source, target, weights)
    mean_s, mean_t = (np.average(points, axis=0, weights=weights) for points in (source, target))
    expected, _ = Rotation.align_vectors(target - mean_t, source - mean_s, weights)
    np.testing.assert_allclose(weighted.rotation, expected.as_matrix(), atol=1e-9)


def test_umeyama_mirror_only_on_demand():
    mirrored = ROOM_POINTS * [1, 1, -1]
    assert jnp.linalg.det(umeyama(ROOM_POINTS, mirrored).rotation) == pytest.approx(1)
    free = umeyama(ROOM_POINTS, mirrored, allow_mirror=True)
    np.testing.assert_allclose(free @ ROOM_POINTS, mirrored, atol=1e-12)
    assert jnp.linalg.det(umeyama(ROOM_POINTS, ROOM_POINTS, allow_mirror=True).rotation) == pytest.approx(1)


@jax.jit
def mapped(source, target, weights):
    return umeyama(source, target, weights) @ jnp.eye(3)


ANGLES = np.arange(6) * np.pi / 3
SHAPES = {  # of the last two the singular values coincide, where the derivative of an SVD does not exist
    "general": ROOM_POINTS,
    "coplanar": ROOM_POINTS * [1, 1, 0],
    "hexagon": np.stack([np.cos(ANGLES), np.sin(ANGLES), 0 * ANGLES], axis=1),
    "octahedron": np.concatenate([np.eye(3), -np.eye(3)]),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_umeyama_derivatives(shape):
    source = SHAPES[shape]
    target = np.asarray(SOLVER @ source)
    for weights in (np.ones(6), np.linspace(0.5, 1.5, 6)):
        check_grads(mapped, (source, target, weights), order=1, modes=["fwd", "rev"])


def test_umeyama_vmaps():
    source = RNG.normal(size=(4, 6, 3))
    target = RNG.normal(size=(4, 6, 3))
    together = jax.vmap(umeyama)(source, target)
    one = umeyama(source[2], target[2])
    for a, b in zip(jax.tree.leaves(together), jax.tree.leaves(one)):
        np.testing.assert_allclose(a[2], b, atol=1e-12)


def test_float64_is_never_cut_silently():
    with jax.enable_x64(False), pytest.raises(ValueError, match="jax_enable_x64"):
        umeyama(ROOM_POINTS, ROOM_POINTS)
    points = solver(ROOM_POINTS)
    with jax.enable_x64(False):  # the pipeline itself works in float64 whatever the switch says
        alignment = align_to_landmarks(points, ROOM_POINTS)
    assert alignment.max_mm < 1e-9


def test_exact_landmarks():
    alignment = align_to_landmarks(solver(ROOM_POINTS), ROOM_POINTS, names=list("abcdef"))
    np.testing.assert_allclose(alignment.similarity.rotation, SOLVER.rotation, atol=1e-12)
    assert alignment.max_mm < 1e-9
    assert max(alignment.leave_one_out_mm) < 1e-9
    assert alignment.handedness_verified
    assert (alignment.names, alignment.method) == (tuple("abcdef"), "landmarks")


def test_leave_one_out_is_a_fit_without_the_landmark():
    measured = ROOM_POINTS + RNG.normal(0, 0.01, ROOM_POINTS.shape)
    alignment = align_to_landmarks(solver(ROOM_POINTS), measured)
    for i in range(len(measured)):
        others = np.delete(np.arange(len(measured)), i)
        fit = umeyama(solver(ROOM_POINTS)[others], measured[others])
        expected = 1e3 * np.linalg.norm(fit @ solver(ROOM_POINTS)[i] - measured[i])
        assert alignment.leave_one_out_mm[i] == pytest.approx(expected, rel=1e-9)


def test_leave_one_out_needs_a_rest_that_holds():
    three = align_to_landmarks(solver(ROOM_POINTS[:3]), ROOM_POINTS[:3])
    assert three.leave_one_out_mm == (None, None, None)
    line = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]])
    assert align_to_landmarks(solver(line), line).leave_one_out_mm[3] is None


def test_sigmas_weigh_the_landmarks():
    measured = ROOM_POINTS.copy()
    measured[5, 0] += 0.3
    sigmas = np.array([0.001] * 5 + [1.0])
    weighted = align_to_landmarks(solver(ROOM_POINTS), measured, sigmas)
    assert weighted.residual_mm[:5].max() < 0.001
    assert weighted.residual_mm[5] == pytest.approx(300, abs=0.01)
    assert align_to_landmarks(solver(ROOM_POINTS), measured).residual_mm[:5].max() > 10
    too_sure = align_to_landmarks(solver(ROOM_POINTS), measured, np.full(6, 0.001))
    assert any("times what sigma_m allows" in warning for warning in too_sure.warnings)


def test_a_landmark_measured_wrongly_is_named():
    points = RNG.uniform(0, 3, (12, 3))
    measured = points + RNG.normal(0, 0.005, points.shape)
    measured[7] += [0, 0.2, 0]
    alignment = align_to_landmarks(solver(points), measured)
    assert [w.split(" is")[0] for w in alignment.warnings] == ["Landmark 'landmark_7'"]


@pytest.mark.parametrize(
    ("points", "landmarks", "error", "message"),
    [
        (ROOM_POINTS[:2], ROOM_POINTS[:2], InsufficientDataError, "needs three points .* there are 2"),
        (ROOM_POINTS[[0, 1, 1]], ROOM_POINTS[[0, 1, 1]], InsufficientDataError, "'b' and 'c' lie at one place"),
        (ROOM_POINTS[:3], np.outer([0, 1, 3], [1, 2, 3.0]), InsufficientDataError, "3 known landmarks lie on a line"),
        (np.outer([0, 1, 3], [1, 2, 3.0]), ROOM_POINTS[:3], InsufficientDataError, "3 reconstructed landmarks lie on"),
        (ROOM_POINTS[:3], ROOM_POINTS[:4], ValueError, "must be N x 3"),
        (ROOM_POINTS[:3] * np.nan, ROOM_POINTS[:3], ValueError, r"'a' is \[nan, nan, nan\]"),
    ],
)
@pytest.mark.usefixtures("any_shape")
def test_what_cannot_be_aligned(points, landmarks, error, message):
    with pytest.raises(error, match=message):
        align_to_landmarks(points, landmarks, names=list("abcdef")[: len(points)])


def test_sigmas_must_be_positive():
    with pytest.raises(ValueError, match="as many positive sigmas"):
        align_to_landmarks(ROOM_POINTS, ROOM_POINTS, np.zeros(6))


def test_mirrored_landmarks_are_refused_with_both_residuals():
    with pytest.raises(InsufficientDataError, match=r"mirror image \(rms 0\.0 mm\) better than the room \(rms \d+"):
        align_to_landmarks(solver(ROOM_POINTS), ROOM_POINTS * [-1, 1, 1])


def test_coplanar_landmarks_leave_the_hand_unverified():
    flat = ROOM_POINTS * [1, 1, 0]
    alignment = align_to_landmarks(solver(flat), flat, camera_centres=solver(CAMERAS))
    assert not alignment.handedness_verified
    assert len(alignment.warnings) == 1
    assert "handedness was not verified" in alignment.warnings[0]
    with pytest.raises(InsufficientDataError, match="4 of 4 cameras come out below the floor"):
        align_to_landmarks(solver(flat), flat * [-1, 1, 1], camera_centres=solver(CAMERAS))


def test_a_little_relief_below_the_noise_is_coplanar_too():
    nearly_flat = ROOM_POINTS * [1, 1, 0.005]
    noisy = nearly_flat + np.random.default_rng(1).normal(0, 0.02, nearly_flat.shape)
    assert not align_to_landmarks(solver(nearly_flat), noisy).handedness_verified


def test_table_top_upside_down_is_a_warning():
    table = ROOM_POINTS * [1, 1, 0] + [0, 0, 2.0]
    alignment = align_to_landmarks(solver(table), table * [-1, 1, 1], camera_centres=solver(CAMERAS))
    assert any("lower than the landmarks" in warning for warning in alignment.warnings)


def test_camera_centres():
    around = CAMERAS + np.array([[0, 0, 0.3], [0, 0, -0.2], [0, 0, 0], [0, 0, -0.9]])
    alignment = align_to_camera_centres(solver(around), around, names=["n", "e", "s", "w"])
    assert alignment.method == "camera centres"
    assert alignment.max_mm < 1e-9
    assert alignment.handedness_verified
    with pytest.raises(InsufficientDataError, match="there are 2"):
        align_to_camera_centres(solver(CAMERAS[:2]), CAMERAS[:2])


def test_floor_and_length():
    floor = np.array([[1.0, 1, 0], [3, 1, 0], [1, 2, 0], [2.5, 2.5, 0]])
    alignment = align_to_floor(solver(floor), solver(CAMERAS), 2.0)
    np.testing.assert_allclose(alignment.similarity @ solver(floor), floor - [1, 1, 0], atol=1e-12)
    np.testing.assert_allclose(alignment.similarity @ solver(CAMERAS), CAMERAS - [1, 1, 0], atol=1e-12)
    assert alignment.rms_mm < 1e-9
    assert not alignment.handedness_verified
    ends = np.array([[0.0, 0, 1], [0, 4, 1]])  # 4 m, called 3 m
    half = align_to_floor(solver(floor), solver(CAMERAS), 3.0, ends=solver(ends))
    np.testing.assert_allclose(float(half.similarity.scale), 0.75 * float(SOLVER.scale), rtol=1e-12)


def test_uneven_floor_and_leave_one_out():
    floor = np.array([[0.0, 0, 0], [2, 0, 0], [0, 2, 0], [2, 2, 0.02]])
    alignment = align_to_floor(solver(floor), solver(CAMERAS), 2.0)
    np.testing.assert_allclose(alignment.residual_mm, 5, rtol=1e-3)  # the best plane is off by a quarter everywhere
    assert alignment.leave_one_out_mm[3] == pytest.approx(20, rel=1e-3)


@pytest.mark.parametrize(
    ("floor", "cameras", "length", "error", "message"),
    [
        (ROOM_POINTS[:2], CAMERAS, 1.0, InsufficientDataError, "needs three points"),
        (np.outer([0, 1, 3], [1, 2, 0.0]), CAMERAS, 1.0, InsufficientDataError, "points on the floor lie on a line"),
        (ROOM_POINTS[[0, 1, 1]], CAMERAS, 1.0, InsufficientDataError, "lie at one place"),
        (ROOM_POINTS[:3], CAMERAS, 0.0, ValueError, "length is 0.0 m; give a positive one"),
        (ROOM_POINTS[:3], CAMERAS, float("nan"), ValueError, "length is nan m"),
    ],
)
def test_floors_that_cannot_be(floor, cameras, length, error, message):
    with pytest.raises(error, match=message):
        align_to_floor(floor, cameras, length)


def test_a_camera_below_the_floor():
    cameras = np.concatenate([CAMERAS, [[1, 1, -0.5]]])
    with pytest.raises(InsufficientDataError, match="1 of 5 cameras lie below the floor"):
        align_to_floor(ROOM_POINTS[:3] * [1, 1, 0], cameras, 1.0)


def calibration_of(room, covariance=None) -> Calibration:
    """The room's truth as a calibration in a solver's frame."""
    with jax.enable_x64(True):
        inverse = SOLVER.inverse()
        rig = room.rig.transformed(inverse)
    tracks, count = room.tracks, room.tracks.cameras
    valid = np.arange(tracks.frames) != 3
    return Calibration(
        rig=rig,
        tracks=tracks,
        points=np.where(valid[:, None], np.asarray(inverse @ room.points), 0.0),
        point_valid=valid,
        residuals=np.zeros((tracks.frames, count, 2)),
        verdicts=np.where(tracks.visible, Verdict.KEPT, Verdict.HIDDEN),
        sigma_px=0.5,
        converged=True,
        message="",
        pairs=PairTable(tracks.names, np.zeros(count, int), np.zeros((count, count), int), np.zeros(count)),
        camera_covariance=covariance,
    )


def room_alignment() -> Alignment:
    return align_to_landmarks(solver(ROOM_POINTS), ROOM_POINTS)


def test_apply_alignment_moves_everything_and_no_pixel():
    room = random_room(1, cameras=4, frames=60)
    before = calibration_of(room)
    after = apply_alignment(before, room_alignment())
    np.testing.assert_allclose(after.rig.positions, room.positions, atol=1e-9)
    np.testing.assert_allclose(after.points[after.point_valid], room.points[after.point_valid], atol=1e-9)
    assert (after.points[3] == 0).all()
    assert after.unit == "m"
    assert after.alignment is not None
    pixels = [c.rig.project(c.points[c.point_valid]) for c in (before, after)]
    np.testing.assert_allclose(*pixels, atol=1e-7)


def test_apply_alignment_maps_the_covariance():
    """Perturbed cameras of the solver's frame, brought into the room, are the room's cameras perturbed by J change."""
    room = random_room(1, cameras=3, frames=60)
    before = calibration_of(room)
    jacobian_squared = apply_alignment(dataclasses.replace(before, camera_covariance=np.eye(45)), room_alignment())
    room_cameras = jacobian_squared.rig.cameras
    similarity = room_alignment().similarity

    @jax.jit
    def in_the_room(changes):
        moved = jax.vmap(lambda camera, change: camera.perturbed(change))(before.rig.cameras, changes.reshape(3, 15))
        poses = jax.vmap(similarity.transform_camera)(moved.cam_from_world)
        turned = jnp.einsum("cij,ckj->cik", poses.rotation, room_cameras.cam_from_world.rotation)
        rotvec = jnp.stack([turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]], axis=1)  # to first order
        lens = jnp.concatenate([moved.focal, moved.center, moved.distortion], axis=1)
        return jnp.concatenate([rotvec, poses.translation, lens], axis=1).ravel()

    step = 1e-5
    columns = [(in_the_room(step * e) - in_the_room(-step * e)) / (2 * step) for e in np.eye(45)]
    jacobian = np.stack(columns, axis=1)
    np.testing.assert_allclose(jacobian_squared.camera_covariance, jacobian @ jacobian.T, atol=1e-6)


def test_a_covariance_of_other_parameters_is_dropped_with_a_reason():
    room = random_room(1, cameras=3, frames=60)
    after = apply_alignment(calibration_of(room, np.eye(7)), room_alignment())
    assert after.camera_covariance is None
    assert after.alignment is not None
    assert after.alignment.warnings == ("The camera covariance is (7, 7), not (45, 45); it was dropped.",)
