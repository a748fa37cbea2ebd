"""Synchrony: known shifts and offsets are found again."""

import numpy as np
from numpy.testing import assert_allclose

from jaxpoint.report.sync import image_velocity, speed_lags, time_offsets

FRAMES = 400


def test_speed_lags_find_a_camera_that_is_late(waves):
    pixels = waves([0, 5, 0, -3])
    lag, likeness = speed_lags(pixels, np.ones((FRAMES, 4), bool), np.arange(FRAMES))
    assert_allclose(lag[0], [0, 5, 0, -3])
    assert_allclose(lag, -lag.T)
    assert (likeness[0, 1:] > 0.5).all()


def test_speed_lags_do_not_guess_from_few_frames(waves):
    visible = np.zeros((FRAMES, 2), bool)
    visible[:40] = True
    _, likeness = speed_lags(waves([0, 0]), visible, np.arange(FRAMES))
    assert np.isnan(likeness).all()


def test_velocity_needs_both_neighbours_and_knows_thinned_recordings():
    pixels = np.stack([np.arange(9.0)[:, None] * [[6.0, 0.0]]], axis=1).reshape(9, 1, 2)
    visible = np.ones((9, 1), bool)
    visible[4] = False
    velocity, known = image_velocity(pixels, visible, np.arange(0, 27, 3))
    assert_allclose(known[:, 0], [0, 1, 1, 0, 0, 0, 1, 1, 0])
    assert_allclose(velocity[known], [[2.0, 0.0]] * 4)


def test_time_offsets_recover_a_late_camera(waves):
    late = np.array([0.0, 0.4, 0.0])
    on_time, seen = waves([0, 0, 0], seed=1), waves(late, seed=1)
    kept = np.ones((FRAMES, 3), bool)
    offset, sigma = time_offsets(on_time - seen, kept, seen, kept, np.arange(FRAMES))
    assert_allclose(offset, late, atol=0.03)
    assert (sigma < 0.02).all()


def test_a_light_that_rests_tells_nothing():
    pixels = np.full((50, 2, 2), 100.0)
    offset, sigma = time_offsets(
        np.zeros((50, 2, 2)), np.ones((50, 2), bool), pixels, np.ones((50, 2), bool), np.arange(50)
    )
    assert_allclose(offset, 0.0)
    assert np.isinf(sigma).all()
