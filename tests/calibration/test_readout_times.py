"""Rolling shutters: simulated readout times come back, with the error of global shutters."""

from dataclasses import replace

import numpy as np
import pytest

from jaxpoint.calibration import timing
from jaxpoint.calibration.alignment import umeyama
from jaxpoint.calibration.camera_clock import CameraClock, ClockSurvey
from jaxpoint.calibration.clock_fit import Clock
from jaxpoint.calibration.covariance import with_covariance
from jaxpoint.calibration.normal import OFFSET, ROWS, _late
from jaxpoint.calibration.quality import assess
from jaxpoint.calibration.readout_search import search_readouts, survey_readouts
from jaxpoint.calibration.recording import Freedom, Recording
from jaxpoint.calibration.selfcal import calibrate
from jaxpoint.config import CalibrateSettings, EpipolarSettings, LensSettings, OutlierSettings
from jaxpoint.errors import UsageError
from jaxpoint.motion import motion, on_clock
from jaxpoint.report.advice import on_readouts
from jaxpoint.report.tables import clock_table
from jaxpoint.simulate.rooms import random_room
from jaxpoint.targets import Target

READOUTS = np.array([0.8, 0.45, -0.65, 0.75, 0.7, 0.35])  # frames; one camera hangs upside down
LATE = np.array([0.3, -0.6, 0.0, 0.8, -0.2, 0.5])  # frames
IN_STEP = dict.fromkeys(range(6), Clock())
KNOWN = LensSettings(known="hold")


def room_with(readouts, late=None):
    """Six cameras, 5 % of outliers, a fifth of the sightings lost, 20 px a frame."""
    return random_room(
        2, cameras=6, frames=500, layout="around", visibility=0.8, outliers=0.05, noise_px=0.5, stride=24,
        time_offsets=late, readouts=readouts,
    )  # fmt: skip


def mean_px(calibration):
    return calibration.errors[calibration.kept].mean()


def errors_mm(calibration, room):
    """Rms error of the camera centres, median error of the points, after the similarity of the centres."""
    similarity = umeyama(calibration.rig.positions, room.positions)
    away = np.asarray(similarity @ calibration.points) - room.points
    apart = np.asarray(similarity @ calibration.rig.positions) - room.positions
    points = np.linalg.norm(away[calibration.point_valid], axis=1)
    return 1e3 * np.sqrt((apart**2).sum(axis=1).mean()), 1e3 * np.median(points)


def causes(calibration):
    return [finding.cause for finding in assess(with_covariance(calibration), CalibrateSettings()).findings]


def with_known_lenses(room, **settings):
    return calibrate(room.tracks, CalibrateSettings(lens=KNOWN, **settings), intrinsics=room.rig)


@pytest.fixture(scope="module")
def rolling():
    return room_with(READOUTS)


@pytest.fixture(scope="module")
def straight():
    """The same room with global shutters."""
    return room_with(None)


@pytest.fixture(scope="module")
def solved(rolling):
    return calibrate(rolling.tracks, CalibrateSettings(readout_times=True))


def test_readout_times_come_back_with_nothing_known(solved):
    found = solved.readout_times
    error = found.frames - READOUTS
    assert solved.converged
    assert solved.time_offsets is None
    assert np.abs(error / READOUTS).max() < 0.05
    assert (np.abs(error) < 3 * found.sigma).all()
    assert (found.sigma < 0.02).all()


def test_the_errors_fall_to_those_of_global_shutters(rolling, straight):
    """With known lenses, whose errors would hide those of the shutters."""
    control, plain, found = (
        with_known_lenses(straight),
        with_known_lenses(rolling),
        with_known_lenses(rolling, readout_times=True),
    )
    assert mean_px(plain) > 2 * mean_px(control)
    assert mean_px(found) == pytest.approx(mean_px(control), rel=0.05)
    wanted, without, reached = errors_mm(control, straight), errors_mm(plain, rolling), errors_mm(found, rolling)
    assert without[0] > 5 * wanted[0]  # centres
    assert without[1] > 5 * wanted[1]  # points
    assert reached[0] < 2 * wanted[0]
    assert reached[1] < 1.15 * wanted[1]
    assert np.abs(found.readout_times.frames / READOUTS - 1).max() < 0.05
    assert found.kept.sum() > 0.9 * control.kept.sum()
    assert "rolling shutter" in causes(plain)
    assert "rolling shutter" not in causes(control) + causes(found)
    (said,) = [f for f in assess(plain, CalibrateSettings()).findings if f.cause == "rolling shutter"]
    assert "--readout-times" in said.remedy
    worst = rolling.tracks.names.index(said.cameras[0])
    assert ("after" if READOUTS[worst] > 0 else "before") in said.finding


def test_offsets_and_readout_times_are_found_together(state_of):
    room = room_with(READOUTS, LATE)
    recording = Recording.of(room.tracks)
    freedom = Freedom.of(recording, LensSettings(), "none", hold=True)
    start = timing.Times(np.round(LATE - LATE[0], 1), np.round(READOUTS, 1))
    found = timing.brought_in_step(room.tracks, state_of(room, recording), start, freedom, OutlierSettings())
    assert found.still
    error = found.times.table - np.stack([LATE - LATE[0], READOUTS], axis=1)
    sigmas = found.unit_sigmas * found.settled.sigma_px
    assert found.settled.sigma_px == pytest.approx(0.5, rel=0.05)
    assert sigmas[0, 0] == error[0, 0] == 0.0
    assert (np.abs(error) <= 3 * sigmas).all()
    assert (sigmas < [0.005, 0.02]).all()


def test_pairs_of_cameras_tell_before_anything_is_solved(rolling, straight):
    """What `check` warns of: all of the rolling shutters, and none of the global ones."""
    found = search_readouts(rolling.tracks, IN_STEP, EpipolarSettings(), 0)
    assert (np.abs(found.frames - READOUTS) < 3 * found.sigma).all()
    assert (found.sigma < 0.1).all()
    clocks = tuple(CameraClock(name, 0.0, 1.0, 1.0, 1.0, True) for name in rolling.tracks.names)
    survey = survey_readouts(ClockSurvey(clocks, ()), rolling.tracks, EpipolarSettings(), 0)
    (item,) = on_readouts(survey.clocks)
    assert "--readout-times" in item.remedy
    assert item.remedy.count("--readout cam_") >= 5
    assert " frames before in cam_2" in item.finding
    quiet = survey_readouts(ClockSurvey(clocks, ()), straight.tracks, EpipolarSettings(), 0)
    assert list(on_readouts(quiet.clocks)) == []
    assert clock_table(("a", *"bcdef"), survey.clocks).rows[2][3].startswith("-0.")
    unsure = replace(clocks[0], certain=False)
    survey = survey_readouts(ClockSurvey((unsure, *clocks[1:]), ()), rolling.tracks, EpipolarSettings(), 0)
    assert survey.clocks[0].readout_frames is None


def test_the_gates_derivatives_are_those_of_moving_the_pixels(straight):
    """The columns by which residuals are looked at for readout times and offsets, in central differences."""
    tracks, step = straight.tracks, 1e-5
    moving = motion(tracks.pixels, tracks.visible, tracks.series_ids)
    columns = _late(tracks, moving.velocity)
    for column, name in ((OFFSET, "offsets"), (ROWS, "readouts")):
        zero = {"offsets": np.zeros(6), "readouts": np.zeros(6)}
        sides = [on_clock(tracks, moving, **(zero | {name: np.full(6, by)})) for by in (-step, step)]
        seen = sides[0].visible & sides[1].visible
        slope = (sides[1].pixels - sides[0].pixels) / (2 * step)
        assert seen.sum() > 1000
        np.testing.assert_allclose(columns[..., column][seen], -slope[seen], atol=1e-4)  # projected minus observed


def test_boards_alone_are_refused():
    room = random_room(0, cameras=3, frames=90, visibility=0.9)
    board = Target.chessboard(3, 2, 0.1)
    ids = np.tile(np.arange(6), 15)
    tracks = replace(room.tracks, point_ids=ids, target_ids=np.zeros(90, int), targets=(board,))
    with pytest.raises(UsageError, match=r"not from boards alone; leave out --readout-times"):
        calibrate(tracks, CalibrateSettings(init="boards", readout_times=True))
