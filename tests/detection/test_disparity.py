"""Disparities beside plain semi-global matching, against the truth of a real pair."""

import cv2
import numpy as np
import pytest

from jaxpoint.config.stereo_matching import StereoSettings
from jaxpoint.detection.disparity import disparities_of, disparity_of, sgbm_disparity

SETTINGS = StereoSettings(disparities=240, block=5)


@pytest.fixture(scope="module")
def aloe(data_folder):
    """Images, and the true disparities, NaN where they are unknown."""
    folder = data_folder / "opencv_aloe_stereo"
    left, right = (cv2.imread(str(folder / f"aloe{side}.jpg")) for side in "LR")
    truth = cv2.imread(str(folder / "aloeGT.png"), cv2.IMREAD_GRAYSCALE).astype(float)
    return left, right, np.where(truth > 0, truth, np.nan)


def bad(found, truth):
    """Of the pixels with a disparity and a truth, the share that is off by more than 2 px."""
    known = np.isfinite(found) & np.isfinite(truth)
    return float((np.abs(found - truth)[known] > 2).mean()), float(known.sum() / np.isfinite(truth).sum())


def test_fewer_pixels_are_bad_than_by_plain_matching(aloe):
    left, right, truth = aloe
    plain, checked = sgbm_disparity(left, right, SETTINGS), disparity_of(left, right, SETTINGS)
    (plain_bad, plain_known), (checked_bad, checked_known) = bad(plain, truth), bad(checked, truth)
    assert checked_bad <= plain_bad < 0.06
    assert checked_bad < 0.8 * plain_bad
    assert checked_known > 1.15 * plain_known
    beside = SETTINGS.disparities  # columns for which OpenCV leaves disparities out
    at_left, known = bad(checked[:, :beside], truth[:, :beside])
    assert at_left < 0.02
    assert known > 0.6


def test_the_number_of_disparities_is_a_multiple_of_16():
    assert disparities_of(640, StereoSettings()) == 160
    assert disparities_of(640, StereoSettings(disparities=100)) == 112
    assert disparities_of(10, StereoSettings()) == 16
