"""Frames that a recording repeats or skips: found, put right, and not seen where there are none."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from jaxpoint.repeats import regular_steps, without_steps
from jaxpoint.tracks import Tracks

FRAMES = 900
SIZES = np.array([[1280, 720]] * 2)


def tracks_at(places, noise=0.3):
    """A light whose second camera shows the moments `places`."""
    rng = np.random.default_rng(0)
    knots = rng.uniform([100, 100], [1100, 600], (50, 2, 2))
    path = CubicSpline(np.linspace(0, 1.2 * FRAMES, 50), knots)
    shown = path(np.arange(2 * FRAMES)) + rng.normal(0.0, noise, (2 * FRAMES, 2, 2))
    pixels = np.stack([shown[:FRAMES, 0], shown[places, 1]], axis=1)
    return Tracks.from_pixels(pixels, SIZES), shown


@pytest.mark.parametrize("rate", [29.7, 29.83, 30.2, 31.0])
def test_repeated_and_skipped_frames_are_put_right(rate):
    places = np.floor(np.arange(FRAMES) * rate / 30).astype(int)
    tracks, shown = tracks_at(places)
    steps = regular_steps(tracks, 1, tracks.visible, 30 / rate)
    assert steps.skips == (rate > 30)
    assert steps.rate == pytest.approx(30 / rate, abs=3e-4)
    right = without_steps(tracks, 1, steps)
    seen = right.visible[:, 1]
    same = (right.pixels[seen, 1] == shown[:FRAMES][seen, 1]).all(axis=1)
    assert same.mean() > 0.97  # but for a row or two where a step was not seen
    assert seen.sum() > 0.95 * min(FRAMES, FRAMES * 30 / rate)
    np.testing.assert_array_equal(right.pixels[:, 0], tracks.pixels[:, 0])


@pytest.mark.parametrize("rate", [29.83 / 30, 30.2 / 30])
def test_a_light_that_moves_evenly_has_no_steps(rate):
    tracks, _ = tracks_at(np.arange(FRAMES))
    assert regular_steps(tracks, 1, tracks.visible, rate) is None
    assert regular_steps(tracks, 1, tracks.visible, 1.0) is None
