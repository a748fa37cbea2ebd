"""The covariance that a run keeps: which gauge holds it, and why there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from jaxpoint.calibration.alignment import align_to_camera_centres, align_to_floor, apply_alignment
from jaxpoint.calibration.covariance import aligned_with_covariance, with_covariance
from jaxpoint.calibration.recording import Freedom, Recording
from jaxpoint.calibration.uncertainty import anchors_of, uncertainty_of
from jaxpoint.config import LensSettings
from jaxpoint.simulate.recalibration import Recalibrated


@pytest.fixture(scope="module")
def room():
    return Recalibrated.of(3, cameras=5, frames=120, noise_px=0.5)


@pytest.fixture(scope="module")
def solved(room):
    return room.truth()


def test_measured_places_hold_the_frame_as_well_as_they_are_known(room, solved):
    measured = room.room.positions + np.random.default_rng(2).normal(0, 0.01, (5, 3))
    alignment = align_to_camera_centres(room.room.positions, measured, names=solved.rig.names)
    stated = aligned_with_covariance(solved, alignment, np.full(5, 0.01))
    aligned = apply_alignment(solved, alignment)
    expected = uncertainty_of(aligned, anchors_of(aligned, solved.rig.names, np.full(5, 0.01)))
    assert (stated.gauge, stated.unit, stated.undetermined) == ("landmarks", "m", "")
    np.testing.assert_allclose(stated.camera_covariance, expected.covariance, rtol=1e-9, atol=1e-15)
    # Where nobody says how well they are known, their residuals do: 15 coordinates less the 7 of a similarity.
    unsaid = aligned_with_covariance(solved, alignment)
    sigma = np.sqrt((1e-6 * alignment.residual_mm**2).sum() / 8)
    assert 0.005 < sigma < 0.02
    told = aligned_with_covariance(solved, alignment, np.full(5, sigma))
    np.testing.assert_allclose(unsaid.camera_covariance, told.camera_covariance, rtol=1e-9, atol=1e-15)


def test_a_floor_leaves_the_gauge_free(room, solved):
    """The covariance of the rig alone, mapped into the room: a free gauge fits whatever the frame and the unit."""
    floor = room.room.points[[0, 30, 60]] * [1, 1, 0]
    alignment = align_to_floor(floor, room.room.positions, 2.0)
    stated = aligned_with_covariance(solved, alignment)
    assert (stated.gauge, stated.unit) == ("free", "m")
    mapped = apply_alignment(with_covariance(solved), alignment)
    sigma = np.sqrt(np.diag(stated.camera_covariance))
    scale = np.outer(sigma, sigma) + 1e-300
    np.testing.assert_allclose(stated.camera_covariance / scale, mapped.camera_covariance / scale, atol=1e-5)


def test_what_cannot_be_known_is_said(room):
    nowhere = with_covariance(replace(room.truth(), freedom=None))
    assert nowhere.camera_covariance is None
    assert "calibrate again" in nowhere.undetermined
    apart = room.truth()
    alone = np.zeros_like(apart.verdicts)
    verdicts = np.where(apart.tracks.visible & (np.arange(5) < 2) & (np.arange(120)[:, None] < 4), alone, 3)
    freedom = Freedom.of(Recording.of(apart.tracks), LensSettings(), "radial2")
    parts = (freedom.free[:5], freedom.prior_mean[:5], np.zeros((5, 15)))
    few = with_covariance(replace(apart, verdicts=verdicts, freedom=Freedom(*parts)))
    assert few.camera_covariance is None
    assert few.gauge is None
    assert "do not determine the rig" in few.undetermined
