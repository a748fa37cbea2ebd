"""Synchrony: known shifts and offsets are found again."""

import numpy as np
from numpy.testing import assert_allclose

from jaxpoint.motion import Motion, motion
from jaxpoint.report.sync import time_offsets

FRAMES = 400


def test_time_offsets_recover_a_late_camera(waves):
    """No point takes anything of the residuals."""
    late = np.array([0.0, 0.4, 0.0])
    on_time, seen = waves([0, 0, 0], seed=1), waves(late, seed=1)
    judged = np.ones((FRAMES, 3), bool)
    moving = motion(seen, judged, np.arange(FRAMES))
    offset, sigma = time_offsets(on_time - seen, judged, moving, np.zeros((FRAMES, 3, 2, 3)), 0.5)
    assert_allclose(offset, late, atol=0.03)
    assert (sigma < 0.02).all()


def test_time_offsets_are_found_behind_points_that_moved_to_suit():
    """Residuals of the best points, by numpy's least squares frame by frame, and a tenth of them grossly wrong."""
    rng = np.random.default_rng(0)
    slopes, velocity = rng.normal(0.0, 100.0, (FRAMES, 3, 2, 3)), rng.normal(0.0, 10.0, (FRAMES, 3, 2))
    late = np.array([0.0, -0.3, 0.0])
    raw = late[:, None] * velocity + rng.normal(0.0, 0.5, velocity.shape)
    raw[rng.random((FRAMES, 3)) < 0.1] += 60.0
    residuals = np.stack(
        [r.ravel() - a.reshape(6, 3) @ np.linalg.lstsq(a.reshape(6, 3), r.ravel())[0] for r, a in zip(raw, slopes)]
    ).reshape(raw.shape)
    everywhere = np.ones((FRAMES, 3), bool)
    nothing = np.zeros((FRAMES, 3, 1))
    moving = Motion(velocity, 0.0 * velocity, nothing, nothing, everywhere)
    offset, sigma = time_offsets(residuals, everywhere, moving, slopes, 0.5)
    assert_allclose(offset, late, atol=0.02)
    assert (np.abs(offset - late) < 5 * sigma).all()
    assert np.linalg.norm(residuals) < 0.8 * np.linalg.norm(raw)  # the points did move


def test_a_light_that_rests_tells_nothing():
    pixels, seen = np.full((50, 2, 2), 100.0), np.ones((50, 2), bool)
    moving = motion(pixels, seen, np.arange(50))
    offset, sigma = time_offsets(np.zeros((50, 2, 2)), seen, moving, np.ones((50, 2, 2, 3)), 0.5)
    assert_allclose(offset, 0.0)
    assert np.isinf(sigma).all()
