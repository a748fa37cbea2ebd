"""Rolling shutters: simulated readout times come back, with the error of global shutters."""

import numpy as np
import pytest

from jaxpoint.calibration.alignment import umeyama
from jaxpoint.calibration.selfcal import calibrate
from jaxpoint.config import CalibrateSettings
from jaxpoint.simulate.rooms import random_room

READOUTS = np.array([0.8, 0.45, -0.65, 0.75, 0.7, 0.35])  # frames; one camera hangs upside down
LATE = np.array([0.3, -0.6, 0.0, 0.8, -0.2, 0.5])  # frames


def room_with(readouts, late=None):
    """Six cameras, 5 % of outliers, a fifth of the sightings lost, 20 px a frame."""
    return random_room(
        2, cameras=6, frames=500, layout="around", visibility=0.8, outliers=0.05, noise_px=0.5, stride=24,
        time_offsets=late, readouts=readouts,
    )  # fmt: skip


def mean_px(calibration):
    return calibration.errors[calibration.kept].mean()


def error_mm(calibration, room):
    """Median error of the points after a similarity."""
    valid = calibration.point_valid
    similarity = umeyama(calibration.points[valid], room.points[valid])
    away = np.asarray(similarity @ calibration.points[valid]) - room.points[valid]
    return 1e3 * np.median(np.linalg.norm(away, axis=1))


@pytest.fixture(scope="module")
def control():
    """The same room with global shutters."""
    room = room_with(None)
    return room, calibrate(room.tracks)


@pytest.fixture(scope="module")
def solved():
    """A room of rolling shutters out of step, and its calibration."""
    room = room_with(READOUTS, LATE)
    return room, calibrate(room.tracks, CalibrateSettings(time_offsets=True, readout_times=True))


def test_readout_times_come_back(solved):
    found = solved[1].readout_times
    error = found.frames - READOUTS
    assert solved[1].converged
    assert np.abs(error / READOUTS).max() < 0.05
    assert (np.abs(error) < 3 * found.sigma).all()
    assert (found.sigma < 0.02).all()


def test_so_do_the_offsets_of_the_middle_rows(solved):
    found = solved[1].time_offsets
    error = found.frames - (LATE - LATE[0])
    assert np.abs(error).max() < 0.015
    assert (np.abs(error[1:]) < 4 * found.sigma[1:]).all()
