"""The whole calibration on random rooms, against their truth."""

import logging
from dataclasses import replace

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxpoint.calibration import selfcal
from jaxpoint.calibration.alignment import umeyama
from jaxpoint.calibration.covariance import with_covariance
from jaxpoint.calibration.outliers import refine_coarse_to_fine, refine_to_convergence
from jaxpoint.calibration.quality import assess
from jaxpoint.calibration.recording import Freedom, Recording, RigState
from jaxpoint.calibration.result import Verdict
from jaxpoint.calibration.selfcal import calibrate
from jaxpoint.config import CalibrateSettings, LensSettings
from jaxpoint.errors import UsageError
from jaxpoint.simulate.rooms import random_room

SEEDS = (1, 5, 7, 8, 13)  # visibility 0.6 to 0.8, 1 to 8 % of outliers; three and four cameras


def room_of(seed):
    return random_room(seed, cameras=3 + seed % 2, frames=300)


@pytest.fixture(scope="module")
def solved():
    """Every room with its calibration."""
    rooms = {seed: room_of(seed) for seed in SEEDS}
    return {seed: (room, calibrate(room.tracks)) for seed, room in rooms.items()}


def cost_of(calibration):
    return next(stage for stage in calibration.stages if stage.name == "Adjustment").figures["robust_cost_px2"]


def centre_error(positions, true):
    """Largest distance (m) of a camera centre from the truth, after the best similarity."""
    return np.linalg.norm(np.asarray(umeyama(positions, true) @ positions) - true, axis=1).max()


def mean_px(calibration):
    return calibration.errors[calibration.kept].mean()


@pytest.mark.parametrize("seed", SEEDS)
def test_the_optimum_of_the_truth_is_reached(solved, state_of, seed):
    room, found = solved[seed]
    recording, settings = Recording.of(room.tracks), CalibrateSettings()
    freedom = Freedom.of(recording, settings.lens, "radial2")
    best = refine_to_convergence(
        recording, refine_coarse_to_fine(recording, state_of(room, recording), freedom), freedom, settings.outliers
    )
    assert found.converged
    assert cost_of(found) <= 1.01 * best.cost
    from_truth = centre_error(best.judged.state.positions[: room.tracks.cameras], room.positions)
    assert centre_error(np.asarray(found.rig.positions), room.positions) <= 3 * from_truth
    assert found.sigma_px == pytest.approx(room.noise_px, rel=0.15)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_room_is_not_mirrored(solved, seed):
    room, found = solved[seed]
    rotation = np.asarray(found.rig.cameras.cam_from_world.rotation)
    np.testing.assert_allclose(np.linalg.det(rotation), 1.0, atol=1e-9)
    sound = found.point_valid & ~room.is_outlier.any(axis=1)
    points, true = found.points[sound], room.points[sound]
    both = [umeyama(points, true, allow_mirror=mirror) for mirror in (False, True)]
    errors = [np.linalg.norm(np.asarray(fit @ points) - true, axis=1) for fit in both]
    np.testing.assert_allclose(errors[0], errors[1], atol=1e-9)  # the better fit wants no mirror
    assert np.median(errors[0]) < 0.05  # m
    assert (np.asarray(found.rig.depth(found.points))[found.kept] > 0).all()


def test_outliers_are_found_and_good_observations_kept(solved):
    """Of what can be tested: at least two good views of the frame besides."""
    outliers, found_outliers, good, lost = 0, 0, 0, 0
    for room, calibration in solved.values():
        true = room.tracks.visible & ~room.is_outlier
        testable = room.tracks.visible & (true.sum(axis=1, keepdims=True) - true >= 2)
        outliers += (testable & room.is_outlier).sum()
        found_outliers += (testable & room.is_outlier & ~calibration.kept).sum()
        good += (testable & true).sum()
        lost += (testable & true & ~calibration.kept).sum()
    assert outliers > 60
    assert found_outliers >= 0.95 * outliers
    assert lost < 0.01 * good


def test_the_result_is_whole(solved):
    room, found = solved[5]
    tracks = room.tracks
    assert found.unit == "arbitrary"
    assert found.rig.names == tracks.names
    np.testing.assert_array_equal(found.verdicts == Verdict.HIDDEN, ~tracks.visible)
    np.testing.assert_array_equal(found.point_valid, found.kept.sum(axis=1) >= 2)
    assert (found.points[~found.point_valid] == 0).all()
    # Residuals are those of the rig and the points that are returned.
    again = np.asarray(found.rig.project(found.points)) - tracks.pixels
    np.testing.assert_allclose(found.residuals[found.kept], again[found.kept], atol=1e-6)
    # The unit: cameras 1 from their middle, the light about the origin.
    positions = np.asarray(found.rig.positions)
    spread = np.sqrt(((positions - positions.mean(axis=0)) ** 2).sum(axis=1).mean())
    assert spread == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_allclose(np.median(found.points[found.kept.sum(axis=1) >= 2], axis=0), 0.0, atol=1e-9)
    inliers, shared = found.pairs.inliers, found.pairs.shared
    assert inliers is not None
    assert (inliers <= shared).all()
    assert found.seconds["total"] >= found.seconds["adjust"] > 0
    assert found.stages[0].name == "Pairs of cameras"


def test_the_same_seed_gives_the_same_result_and_progress_is_told(solved):
    room, found = solved[7]
    told = []
    again = calibrate(room.tracks, progress=lambda what, done, total: told.append((what, done, total)))
    np.testing.assert_array_equal(again.verdicts, found.verdicts)
    np.testing.assert_array_equal(again.points, found.points)
    np.testing.assert_array_equal(again.rig.matrices, found.rig.matrices)
    assert {what for what, _, _ in told} == {"pairs of cameras", "first solution", "adjustment"}
    assert all(done <= total for _, done, total in told)
    pairs = [done for what, done, _ in told if what == "pairs of cameras"]
    assert pairs == sorted(pairs)
    assert told[-1][1] == told[-1][2]


def test_another_seed_reaches_the_same_minimum(solved):
    room, found = solved[7]
    again = calibrate(room.tracks, CalibrateSettings(seed=5))
    assert again.seed == 5
    assert cost_of(again) == pytest.approx(cost_of(found), rel=1e-3)


def test_the_order_of_cameras_does_not_matter(solved):
    room, found = solved[5]
    order = [2, 0, 3, 1]
    again = calibrate(room.tracks.select_cameras(order))
    assert cost_of(again) == pytest.approx(cost_of(found), rel=1e-3)
    focal, expected = (np.asarray(c.rig.cameras.focal) for c in (again, found))
    np.testing.assert_allclose(focal, expected[order], rtol=1e-3)


def test_nothing_is_compiled_anew_for_another_room_of_the_same_size(solved, caplog):
    room = random_room(21, cameras=4, frames=417, layout="around", visibility=0.8, outliers=0.02)
    assert solved
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        calibrate(room.tracks)
    compiled = [record.getMessage() for record in caplog.records if record.getMessage().startswith("Compiling")]
    # Small programs of single operations may come; those of the pipeline must not.
    heavy = ("solve", "robust_fundamental", "lens_table", "candidates", "upgrade", "_search", "_placed", "_projected")
    assert not [text for text in compiled if any(f"jit({name})" in text or f"jit__{name}" in text for name in heavy)]


def test_the_global_switch_for_float64_is_left_as_it_was(solved):
    """With JAX in float32 the result is the same to the last digit, and JAX stays in float32."""
    room, found = solved[8]
    with jax.enable_x64(False):
        again = calibrate(room.tracks)
        assert not jax.config.jax_enable_x64
    assert again.rig.cameras.focal.dtype == np.float64
    np.testing.assert_array_equal(again.rig.cameras.focal, found.rig.cameras.focal)
    np.testing.assert_array_equal(again.verdicts, found.verdicts)


@pytest.fixture(scope="module")
def dense():
    """All cameras see nearly everything: what the thesis's method is made for."""
    return random_room(31, cameras=4, frames=300, layout="around", visibility=1.0, outliers=0.02, noise_px=0.5)


def started_by(calibration):
    """Method and robust cost of every candidate for the first solution."""
    first = next(stage for stage in calibration.stages if stage.name == "First solution").figures
    return {candidate["method"]: candidate["robust_cost_px2"] for candidate in first["candidates"][::-1]}


@pytest.fixture(scope="module")
def dense_auto(dense):
    return calibrate(dense.tracks)


@pytest.mark.parametrize("init", ["factorisation", "thesis"])
def test_each_initialiser_reaches_the_same_minimum(dense, dense_auto, init):
    found = calibrate(dense.tracks, CalibrateSettings(init=init))
    assert set(started_by(found)) == {init}
    assert cost_of(found) <= 1.01 * cost_of(dense_auto)
    assert centre_error(np.asarray(found.rig.positions), dense.positions) < 0.05  # m


def test_all_initialisers_compete(dense_auto):
    assert set(started_by(dense_auto)) == {"factorisation", "essential"}


def test_known_intrinsics_are_held(dense):
    lens = LensSettings(known="hold")
    found = calibrate(dense.tracks, CalibrateSettings(init="essential", lens=lens), intrinsics=dense.rig)
    other = calibrate(dense.tracks, CalibrateSettings(init="factorisation", lens=lens), intrinsics=dense.rig)
    assert started_by(found)["essential"] == pytest.approx(started_by(other)["factorisation"], rel=0.01)
    assert cost_of(found) == pytest.approx(cost_of(other), rel=1e-3)
    for ours, true in ((found.rig.cameras.focal, dense.rig.cameras.focal), (found.rig.cameras.center, dense.center)):
        np.testing.assert_allclose(ours, true, rtol=1e-12)
    np.testing.assert_allclose(found.rig.cameras.distortion, dense.distortion, atol=1e-12)
    assert found.converged
    assert mean_px(found) < 1.3 * dense.noise_px
    assert centre_error(np.asarray(found.rig.positions), dense.positions) < 0.01  # m


def test_known_intrinsics_are_refined(dense):
    """From focal lengths 2 % off, and better than with those held."""
    wrong = dense.rig.cameras.focal * np.array([1.02, 0.98, 1.01, 0.99])[:, None]
    rig = type(dense.rig).from_parameters(
        wrong, dense.center, dense.distortion, dense.rotation, dense.translation, dense.tracks.image_sizes
    )
    found = [
        calibrate(dense.tracks, CalibrateSettings(lens=LensSettings(known=known)), intrinsics=rig)
        for known in ("refine", "hold")
    ]
    np.testing.assert_allclose(found[0].rig.cameras.focal, dense.rig.cameras.focal, rtol=5e-3)
    assert mean_px(found[0]) < 0.8 * mean_px(found[1])


def test_two_cameras_with_known_intrinsics(dense):
    pair = [0, 2]
    settings = CalibrateSettings(lens=LensSettings(known="hold"))
    found = calibrate(dense.tracks.select_cameras(pair), settings, intrinsics=dense.rig.select(pair))
    assert found.converged
    rotation = np.asarray(found.rig.cameras.cam_from_world.rotation)
    relative, true = rotation[1] @ rotation[0].T, dense.rotation[2] @ dense.rotation[0].T
    angle = np.arccos(np.clip((np.trace(relative.T @ true) - 1) / 2, -1, 1))
    assert np.rad2deg(angle) < 0.2
    points, truth = found.points[found.point_valid], dense.points[found.point_valid]
    assert np.median(np.linalg.norm(np.asarray(umeyama(points, truth) @ points) - truth, axis=1)) < 0.02  # m


@pytest.mark.parametrize("distortion", ["none", "radial1"])
def test_fewer_lens_parameters_are_held_at_zero(dense, distortion):
    lens = LensSettings(distortion=distortion, principal_point="fixed")
    found = calibrate(dense.tracks, CalibrateSettings(lens=lens))
    free = 1 if distortion == "radial1" else 0
    coefficients = np.asarray(found.rig.cameras.distortion)
    assert (coefficients[:, :free] != 0).all()
    np.testing.assert_array_equal(coefficients[:, free:], 0.0)
    np.testing.assert_allclose(found.rig.cameras.center, np.tile((np.array([1280, 720]) - 1) / 2, (4, 1)))
    np.testing.assert_allclose(found.rig.cameras.focal[:, 0], found.rig.cameras.focal[:, 1])


def test_an_unknown_lens_model_is_refused_at_once():
    with pytest.raises(UsageError, match=r"no lens model 'wide'; choose auto or one of brown, fisheye"):
        calibrate(random_room(1, cameras=3, frames=100).tracks, CalibrateSettings(lens=LensSettings(distortion="wide")))


def test_known_lenses_of_another_model_than_asked_for_are_refused(solved):
    room, _ = solved[SEEDS[0]]
    lens = LensSettings(known="refine", distortion="fisheye")
    with pytest.raises(UsageError, match=r"known lenses are of the model 'brown', but --lens.distortion fisheye"):
        calibrate(room.tracks, CalibrateSettings(lens=lens), intrinsics=room.rig)


def test_a_large_rig_leaves_what_is_held_out_of_its_products():
    """From 16 cameras on the adjustment is another program; whatever fails in the background fails this test."""
    room = random_room(3, cameras=16, frames=250)
    found = calibrate(room.tracks)
    assert found.converged
    assert centre_error(np.asarray(found.rig.positions), room.positions) < 0.05
    np.testing.assert_array_equal(np.asarray(found.rig.cameras.distortion)[:, 2:], 0.0)


AS_LIKELY = pytest.mark.xfail(
    reason="Pixels of 16/15 and principal points 2 sigma off explain a small room as well as the truth: 5.5 % off."
)


@pytest.mark.parametrize(
    ("seed", "spoil"),
    [(5, "swapped"), (5, "turned"), pytest.param(13, "turned", marks=AS_LIKELY), (7, "random")],
)
def test_a_wrong_rig_is_not_called_good(seed, spoil, monkeypatch):
    """From starts that no initialiser would give: the end is right, or marked."""
    room, found = room_of(seed), selfcal.starts

    def spoilt(inputs, method):
        starts, stages = found(inputs, method)
        state, count = starts[0].state.rebased(), room.tracks.cameras
        cameras, base = state.cameras.copy(), state.base.copy()
        rng = np.random.default_rng(3)
        if spoil == "swapped":
            order = np.concatenate([np.roll(np.arange(count), 1), np.arange(count, len(cameras))])
            cameras[:, :6], base = cameras[order, :6], base[order]
        elif spoil == "turned":
            angles = rng.uniform(60.0, 120.0, (count, 1))
            base[:count] = Rotation.from_euler("y", angles, degrees=True).as_matrix() @ base[:count]
        else:
            base[:count] = Rotation.random(count, random_state=4).as_matrix()
            cameras[:count, 3:6] = rng.normal(size=(count, 3))
        return [replace(starts[0], state=RigState(cameras, base, state.points))], stages

    monkeypatch.setattr(selfcal, "starts", spoilt)
    end = with_covariance(calibrate(room.tracks))
    solved = [room.tracks.names.index(name) for name in end.rig.names]
    error = centre_error(np.asarray(end.rig.positions), room.positions[solved])
    assert error < 0.05 or not assess(end).holds
