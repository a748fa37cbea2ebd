"""Cameras that were moved since their places were measured."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxpoint.calibration.still_cameras import still_cameras

MOVED_M = 0.05


def survey(count, noise_m, seed=0):
    """Places in the room (m), and the same cameras in a solver's frame and unit."""
    rng = np.random.default_rng(seed)
    known = rng.uniform([0, 0, 2], [6, 5, 3], (count, 3))
    turn = Rotation.random(random_state=seed).as_matrix()
    return known, 0.4 * (known + rng.normal(scale=noise_m, size=known.shape)) @ turn.T + [1, -2, 3]


@pytest.mark.parametrize(("count", "moved"), [(4, (2,)), (6, ()), (6, (0, 5)), (9, (1, 2, 3, 7))])
def test_the_moved_ones_are_told(count, moved):
    known, centres = survey(count, 0.005)
    centres[list(moved)] += 0.4 * np.array([0.3, 0.2, -0.25])
    assert np.flatnonzero(~still_cameras(centres, known, MOVED_M)).tolist() == list(moved)


@pytest.mark.parametrize(("count", "moved", "noise_m"), [(6, (0, 1, 2), 0.005), (8, (), 0.08), (3, (1,), 0.005)])
def test_all_stay_where_it_cannot_be_told(count, moved, noise_m):
    """Half of them moved alike, a survey that is poor, and no camera more than it takes."""
    known, centres = survey(count, noise_m)
    centres[list(moved)] += 0.4 * np.array([0.3, 0.2, -0.25])
    assert still_cameras(centres, known, MOVED_M).all()
