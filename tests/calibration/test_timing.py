"""Cameras out of step: simulated offsets come back, with the error of cameras in step."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxpoint.calibration import timing
from jaxpoint.calibration.clocks import find_clocks
from jaxpoint.calibration.offset_search import PairOffset, joint_offsets, pair_offsets
from jaxpoint.calibration.recording import Freedom, Recording
from jaxpoint.calibration.selfcal import _on_one_clock, calibrate
from jaxpoint.config import CalibrateSettings, EpipolarSettings, LensSettings
from jaxpoint.errors import InsufficientDataError
from jaxpoint.motion import motion, on_clock
from jaxpoint.report.advice import advise, on_offsets
from jaxpoint.report.reading import summarise
from jaxpoint.simulate.rooms import random_room
from jaxpoint.tracks import Tracks

LATE = np.array([0.4, -1.7, 1.9, 0.55])  # frames


def room_late_by(late):
    """Four cameras, 5 % of outliers, a fifth of the sightings lost."""
    return random_room(
        9, cameras=4, frames=500, layout="around", visibility=0.8, outliers=0.05, noise_px=0.5, stride=24,
        time_offsets=np.asarray(late),
    )  # fmt: skip


def mean_px(calibration):
    return calibration.errors[calibration.kept].mean()


@pytest.fixture(scope="module")
def solved():
    """A room out of step, and its calibration."""
    room = room_late_by(LATE)
    return room, calibrate(room.tracks, CalibrateSettings(time_offsets=True))


def test_offsets_come_back_with_fractions_of_a_frame(solved):
    found = solved[1].time_offsets
    error = found.frames - (LATE - LATE[0])
    assert solved[1].converged
    assert np.abs(error).max() < 0.015
    assert found.frames[0] == found.sigma[0] == 0.0
    assert (found.sigma[1:] < 0.01).all()
    assert (np.abs(error[1:]) < 4 * found.sigma[1:]).all()


def test_the_error_falls_to_that_of_cameras_in_step(solved):
    in_step = calibrate(room_late_by(np.zeros(4)).tracks)
    assert in_step.time_offsets is None
    assert mean_px(solved[1]) == pytest.approx(mean_px(in_step), rel=0.05)
    assert solved[1].sigma_px == pytest.approx(0.5, rel=0.1)
    assert solved[1].kept.sum() > 0.85 * in_step.kept.sum()


def test_tracks_and_residuals_of_the_result_stand_on_the_first_cameras_clock(solved):
    room, found = solved
    kept = found.kept
    projected = np.asarray(found.rig.project(found.points))
    np.testing.assert_allclose(found.residuals[kept], (projected - found.tracks.pixels)[kept], atol=1e-6)
    np.testing.assert_array_equal(found.tracks.pixels[:, 0], room.tracks.pixels[:, 0])
    figures = found.stages[-1].figures
    left_out = figures["observations_left_out_for_want_of_neighbours_in_time"]
    assert left_out == room.tracks.visible.sum() - found.tracks.visible.sum()
    assert 0 < left_out < 0.1 * room.tracks.visible.sum()


def test_outliers_are_found_all_the_same(solved):
    room, found = solved
    clock = on_clock(room.tracks, motion(room.tracks.pixels, room.tracks.visible, np.arange(500)), LATE - LATE[0])
    wrong = np.take_along_axis(room.is_outlier, clock.rows, axis=0)
    assert found.kept[wrong].sum() <= 0.1 * wrong.sum()  # of two views, some cannot be told


def test_the_sigmas_are_those_of_the_dense_normal_equations(solved, state_of):
    """Over every unknown at once, by automatic derivatives and a pseudoinverse."""
    room, _ = solved
    recording, frames = Recording.of(room.tracks), 40
    clock = on_clock(room.tracks, motion(room.tracks.pixels, room.tracks.visible, np.arange(500)), LATE - LATE[0])
    kept = np.zeros(recording.visible.shape, bool)
    kept[100 : 100 + frames] = True
    kept[:500] &= clock.visible
    kept &= (kept.sum(axis=1) >= 2)[:, None]
    state = state_of(room, recording)
    nothing = np.zeros((4, 15))
    freedom = Freedom(Freedom.of(recording, LensSettings(), "none").free, nothing, nothing)
    judged = timing.Classified(state, kept, kept, kept)
    times = timing.Times(LATE - LATE[0], np.zeros(4))
    sigmas = timing._unit_sigmas(recording, clock, times, judged, freedom)
    problem, start = timing._problem(recording, clock, times, state.rebased(), kept, freedom, 1e8)
    free = np.asarray(problem.free)
    used = np.flatnonzero(kept.any(axis=1))
    seen = kept[used]
    moving = clock.pixels, clock.velocity, clock.acceleration, clock.down[..., None]
    observed = np.concatenate(moving, axis=-1)[used]

    def residuals(cameras, points):
        moved = timing.TimingModel().state(start.cameras.at[free].add(cameras), problem.constants)
        each = jax.vmap(jax.vmap(timing.TimingModel().residual, (0, None, None, 0)), (None, None, 0, 0))
        return each(moved, jnp.zeros(17), points, jnp.asarray(observed))[seen].reshape(-1)

    by_cameras, by_points = jax.jit(jax.jacfwd(residuals, (0, 1)))(jnp.zeros(free.sum()), state.points[used])
    jacobian = np.concatenate([by_cameras, np.reshape(by_points, (len(by_points), -1))], axis=1)
    scale = np.linalg.norm(jacobian, axis=0)
    covariance = np.linalg.pinv((jacobian / scale).T @ (jacobian / scale), rcond=1e-11, hermitian=True)
    expected = np.zeros(free.size)
    expected[free.reshape(-1)] = (np.sqrt(np.diag(covariance)) / scale)[: free.sum()]
    np.testing.assert_allclose(sigmas, expected.reshape(4, 17)[:, 15:], rtol=1e-4)
    assert sigmas[0, 0] == 0.0
    assert (sigmas.ravel()[1:] > 0).all()


def test_check_suggests_the_option_where_cameras_are_out_of_step():
    late = room_late_by([0.0, 0.6, 0.0, -0.5])
    (item,) = on_offsets(find_clocks(late.tracks, EpipolarSettings(), 0))
    told = dict(re.findall(r"(cam_\d) shows the light about (\S+ frames \w+)", item.finding))
    assert told.keys() == {"cam_1", "cam_3"}
    assert told["cam_1"] in ("0.6 frames late", "0.7 frames late", "0.8 frames late")
    assert told["cam_3"].endswith("early")
    assert "--time-offsets" in item.remedy
    in_step = room_late_by(np.zeros(4))
    pairs = pair_offsets(in_step.tracks, EpipolarSettings(), 0, partners=1)
    assert len(pairs) == 3
    assert max(abs(pair.frames) for pair in pairs) < 0.11
    assert list(on_offsets(find_clocks(in_step.tracks, EpipolarSettings(), 0))) == []


def test_a_plain_calibration_suggests_the_option():
    """Of a camera so far out of step that it was left out, and in the report of one that was not."""
    (why,) = calibrate(room_late_by([0.0, 0.0, 0.3, 0.0]).tracks).findings
    assert (why.cause, why.cameras) == ("out of step", ("cam_2",))
    assert "0.3 frames late" in why.finding
    assert "--time-offsets" in why.remedy
    found = calibrate(room_late_by([0.0, 0.0, 0.12, 0.0]).tracks)
    advice = [item for item in advise(summarise(found)) if "--time-offsets" in item.remedy]
    assert any("cam_2" in item.finding for item in advice)


def test_the_report_of_a_calibration_with_offsets_does_not(solved):
    assert not [item for item in advise(summarise(solved[1])) if "--time-offsets" in item.remedy]


def test_one_wrong_pair_does_not_move_the_joint_offsets():
    true = np.array([0.0, 1.25, -0.5, 2.0])
    pairs = [
        PairOffset(i, j, float(true[j] - true[i]) + 0.01 * (i - j), 0.9, 0.3) for i in range(4) for j in range(i + 1, 4)
    ]
    pairs[2] = PairOffset(0, 3, -4.0, 0.5, 0.4)
    np.testing.assert_allclose(joint_offsets(pairs, 4), true, atol=0.1)
    np.testing.assert_array_equal(joint_offsets([], 3), np.zeros(3))


def test_tracks_that_cannot_be_moved_say_so():
    room = room_late_by(np.zeros(4))
    visible = room.tracks.visible.copy()
    visible[np.arange(500) % 5 > 0, 3] = False
    tracks = Tracks.from_pixels(room.tracks.pixels, room.tracks.image_sizes, visible)
    late = timing.Times(np.array([0.0, 0.0, 0.0, 0.5]))
    with pytest.raises(InsufficientDataError, match=r"can be brought to one clock, the others have too few neighbours"):
        _on_one_clock(tracks, late, known_intrinsics=False)
