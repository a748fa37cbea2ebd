"""Sightings at one and the same pixel: stand-ins and hot pixels are refused, a light held still is not."""

import numpy as np
import pytest

from jaxpoint.calibration.pairs import check_pairs, pair_table
from jaxpoint.calibration.stuck import refuse_stuck
from jaxpoint.errors import InsufficientDataError
from jaxpoint.tracks import Tracks

SIZE = np.array([320, 240])


def waved(frames: int = 600, *, whole: bool = False) -> np.ndarray:
    """(F, 3, 2) pixels of a light that is waved and, twice, held still for 60 frames."""
    rng = np.random.default_rng(0)
    time = np.linspace(0, 20, frames)
    time[100:160], time[300:360] = time[100], time[300]
    angles = time[:, None, None] * np.array([[1.0, 1.31], [0.9, 1.7], [1.1, 1.23]]) + np.arange(6).reshape(3, 2)
    pixels = SIZE * (0.5 + 0.4 * np.sin(angles)) + rng.normal(0, 0.3, (frames, 3, 2))
    return np.round(pixels) if whole else pixels


def tracks_of(pixels: np.ndarray) -> Tracks:
    return Tracks.from_pixels(pixels, np.tile(SIZE, (3, 1)))


@pytest.mark.parametrize("whole", [True, False])
@pytest.mark.parametrize("place", [(0.0, 0.0), (-1.0, -1.0), (133.0, 71.25), (300.0, 5.0)])
def test_a_pixel_that_comes_and_goes_is_no_light(place, whole):
    pixels = waved(whole=whole)
    pixels[np.random.default_rng(1).random(600) < 0.2, 1] = place
    wanted = rf"'cam_1' has 1\d\d of 600 .* \({place[0]:g}, {place[1]:g}\); .*empty"
    with pytest.raises(InsufficientDataError, match=wanted):
        refuse_stuck(tracks_of(pixels))


@pytest.mark.parametrize("place", [(0.0, 0.0), (-1.0, -1.0)])
def test_one_long_gap_filled_with_a_stand_in(place):
    pixels = waved()
    pixels[200:280, 0] = place
    pixels[-40:, 2] = place
    with pytest.raises(InsufficientDataError, match=r"'cam_0' has 80 of 600 .*and so have cam_2"):
        refuse_stuck(tracks_of(pixels))


@pytest.mark.parametrize("whole", [True, False])
def test_a_light_held_still_is_a_light(whole):
    pixels = waved(whole=whole)
    refuse_stuck(tracks_of(pixels))
    pixels[100:160] = pixels[100]  # without any noise
    pixels[100:160:2] += whole  # trembling between two whole pixels
    refuse_stuck(tracks_of(pixels))


def test_a_path_gone_along_again_and_again_is_a_light():
    refuse_stuck(tracks_of(np.tile(waved()[:30], (20, 1, 1))))


def test_frozen_cameras_and_stand_ins_are_refused_before_anything_is_solved():
    pixels = waved()
    pixels[:, 2] = 50.0, 60.0
    tracks = tracks_of(pixels)
    with pytest.raises(InsufficientDataError, match=r"'cam_2' has all its 600 sightings .* \(50, 60\): .* frozen"):
        check_pairs(tracks, pair_table(tracks))
    pixels = waved()
    pixels[::3, 2] = 0.0
    tracks = tracks_of(pixels)
    with pytest.raises(InsufficientDataError, match=r"'cam_2' has 200 of 600 sightings"):
        check_pairs(tracks, pair_table(tracks))
