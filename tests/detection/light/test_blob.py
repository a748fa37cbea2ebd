"""Each rejection of the thesis on one frame of differences; on whole images: test_camera.py."""

import numpy as np
import pytest

from jaxpoint.config import LedSettings
from jaxpoint.detection.light.blob import Reason, find_blob

SHAPE = (80, 100)
ROWS, COLUMNS = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)


def spot(x, y, peak=100.0, sigma_x=1.3, sigma_y=1.3):
    return peak * np.exp(-0.5 * (((COLUMNS - x) / sigma_x) ** 2 + ((ROWS - y) / sigma_y) ** 2))


def find(difference, method, deviation=1.0):
    deviations = np.full(SHAPE, deviation, dtype=np.float32)
    return find_blob(difference.astype(np.float32), deviations, LedSettings(method=method))


@pytest.fixture(params=["thesis", "robust"])
def method(request):
    return request.param


def test_one_round_light_is_found_at_its_brightest_pixel(method):
    blob = find(spot(40.2, 30.9), method)
    assert blob.reason == Reason.FOUND
    assert (blob.x, blob.y) == (40, 31)


def test_a_large_area_is_no_light(method):
    assert find(100.0 * (np.hypot(COLUMNS - 50, ROWS - 40) < 10), method).reason == Reason.TOO_LARGE


def test_the_area_allowed_grows_with_the_light(method):
    disc = 100.0 * (np.hypot(COLUMNS - 50, ROWS - 40) < 10)  # 305 px; allowed are 254 at a radius of 3, 452 at 4
    settings = LedSettings(method=method, led_radius_px=4.0)
    blob = find_blob(disc.astype(np.float32), np.ones(SHAPE, np.float32), settings)
    assert blob.reason == Reason.FOUND


@pytest.mark.parametrize(("deviation", "reason"), [(19.0, Reason.FOUND), (21.0, Reason.WEAK)])
def test_five_deviations_are_the_limit(method, deviation, reason):
    assert find(spot(40, 30), method, deviation).reason == reason


def test_two_alike_lights_are_one_too_many(method):
    assert find(spot(20, 20) + spot(70, 60, peak=95.0), method).reason == Reason.SEVERAL


def test_pixels_that_touch_at_a_corner_are_one_blob(method):
    difference = np.zeros(SHAPE)
    difference[30, 40], difference[31, 41] = 100.0, 90.0
    assert find(difference, method).reason == Reason.FOUND


def test_an_empty_frame_is_dark(method):
    assert find(np.zeros(SHAPE), method).reason == Reason.DARK


def test_a_light_cut_by_the_border_is_not_measured(method):
    assert find(spot(0.2, 30), method).reason == Reason.AT_BORDER


def test_motion_blur_shows_in_the_thesis_mask():
    assert find(spot(40, 30, sigma_x=6.0), "thesis").reason == Reason.BLURRED


def test_the_shape_of_fewer_than_six_pixels_is_not_judged():
    difference = np.zeros(SHAPE)
    difference[30, 40:45] = 100.0
    assert find(difference, "thesis").reason == Reason.FOUND
    difference[30, 45] = 100.0
    assert find(difference, "thesis").reason == Reason.BLURRED


def test_a_flat_top_split_by_noise_is_one_light_for_the_robust_method_only():
    difference = spot(40, 30, sigma_x=2.0, sigma_y=2.0)
    difference[:, 40] *= 0.7  # the mask falls into a left and a right half
    assert find(difference, "thesis").reason == Reason.SEVERAL
    assert find(difference, "robust").reason == Reason.FOUND


def test_a_sharp_bright_glint_does_not_hide_the_light_from_the_robust_method():
    difference = spot(40, 30, sigma_x=1.8, sigma_y=1.8) + spot(70, 60, peak=110.0, sigma_x=0.6, sigma_y=0.6)
    assert find(difference, "thesis").reason == Reason.SEVERAL
    blob = find(difference, "robust")
    assert blob.reason == Reason.FOUND
    assert (blob.x, blob.y) == (40, 30)


def test_a_flickering_screen_does_not_hide_the_light_from_the_robust_method():
    difference, deviation = spot(40, 30, peak=60.0), np.ones(SHAPE, dtype=np.float32)
    difference[60:70, 80:90], deviation[60:70, 80:90] = 100.0, 40.0
    blob = find_blob(difference.astype(np.float32), deviation, LedSettings())
    assert blob.reason == Reason.FOUND
    assert (blob.x, blob.y) == (40, 30)
