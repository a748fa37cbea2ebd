"""Lights of a camera of another rate at the times of the common clock."""

import numpy as np

from jaxpoint.detection.light.retime import retime


def path(times):
    """A light waved about once in 30 rows, px."""
    return np.stack([300 + 200 * np.cos(0.2 * times), 200 + 100 * np.sin(0.3 * times)], axis=1)


def retimed(times, found, rows=120):
    covariance = np.tile(0.04 * np.eye(2), (len(times), 1, 1))
    return retime(np.arange(rows), times, path(times), covariance, found)


def test_a_cubic_follows_the_light_where_the_nearest_frame_is_off():
    times = np.arange(118) * 30 / 29.5
    result = retimed(times, np.ones(118, dtype=bool), 119)
    assert result.known.all()
    errors = np.linalg.norm(result.pixels - path(np.arange(119)), axis=1)
    assert np.quantile(errors, 0.99) < 0.5
    assert errors.max() < 4  # beside the ends the slope is that of one side
    nearest = np.linalg.norm(
        path(times[np.abs(times[:, None] - np.arange(119)).argmin(axis=0)]) - path(np.arange(119)), axis=1
    )
    assert np.median(nearest) > 5
    assert np.linalg.eigvalsh(result.covariance).max() <= 0.04 + 1e-9


def test_nothing_is_made_up_beside_frames_without_the_light():
    times = np.arange(100) * 1.07 + 0.5
    found = ~np.isin(np.arange(100), [0, 40, 41, 60])
    result = retimed(times, found)
    known = [row for row in range(120) if ((times[:-1] <= row) & (row <= times[1:]) & found[:-1] & found[1:]).any()]
    assert np.flatnonzero(result.known).tolist() == known
    assert not result.pixels[~result.known].any()
    assert np.linalg.norm(result.pixels - path(np.arange(120)), axis=1)[result.known].max() < 4
    assert not retimed(times, np.arange(100) == 3).known.any()
