"""Regions against drawn shapes of known axes and against moments summed pixel by pixel."""

import math

import cv2
import numpy as np
import pytest

from jaxpoint.detection.region import label_regions, region_of


def literal(mask):
    """Matlab's regionprops, written from its documentation: sums over pixels, each a square of area 1."""
    points = [(c, r) for r in range(mask.shape[0]) for c in range(mask.shape[1]) if mask[r, c]]
    n = len(points)
    mx, my = sum(x for x, _ in points) / n, sum(y for _, y in points) / n
    uxx = sum((x - mx) ** 2 for x, _ in points) / n + 1 / 12
    uyy = sum((my - y) ** 2 for _, y in points) / n + 1 / 12
    uxy = sum((x - mx) * (my - y) for x, y in points) / n
    common = math.sqrt((uxx - uyy) ** 2 + 4 * uxy**2)
    major, minor = (2 * math.sqrt(2) * math.sqrt(uxx + uyy + sign * common) for sign in (1, -1))
    eccentricity = 2 * math.sqrt((major / 2) ** 2 - (minor / 2) ** 2) / major
    num, den = (uyy - uxx + common, 2 * uxy) if uyy > uxx else (2 * uxy, uxx - uyy + common)
    angle = 0.0 if num == den == 0 else (math.atan(num / den) if den else math.copysign(math.pi / 2, num))
    return n, (mx, my), major, minor, eccentricity, angle


@pytest.mark.parametrize("seed", range(8))
def test_properties_are_matlabs(seed):
    rng = np.random.default_rng(seed)
    mask = cv2.GaussianBlur(rng.normal(size=(30, 40)), (0, 0), 3) > 0.05
    _, regions = label_regions(mask)
    region = regions[0]
    whole = np.zeros_like(mask)
    x, y, width, height = region.box
    labels, _ = label_regions(mask)
    whole[y : y + height, x : x + width] = region.crop(labels)
    area, centroid, major, minor, eccentricity, orientation = literal(whole)
    assert region.area == area
    np.testing.assert_allclose(region.centroid, centroid, atol=1e-9)
    np.testing.assert_allclose([region.major, region.minor], [major, minor], rtol=1e-9)
    assert region.eccentricity == pytest.approx(eccentricity, abs=1e-9)
    assert region.orientation == pytest.approx(orientation, abs=1e-9)
    np.testing.assert_array_equal(np.argwhere(whole).min(axis=0), [y, x])
    np.testing.assert_array_equal(np.argwhere(whole).max(axis=0) + 1, [y + height, x + width])


@pytest.mark.parametrize("degrees", [-80, -40, 0, 25, 60, 90])
def test_a_drawn_ellipse_has_its_axes_and_its_angle(degrees):
    a, b, angle = 60.0, 22.0, np.radians(degrees)
    rows, columns = np.mgrid[:200, :200] - 100.3
    along, across = columns * np.cos(angle) - rows * np.sin(angle), columns * np.sin(angle) + rows * np.cos(angle)
    region = region_of((along / a) ** 2 + (across / b) ** 2 <= 1)
    assert region.major == pytest.approx(2 * a, rel=5e-3)
    assert region.minor == pytest.approx(2 * b, rel=5e-3)
    assert abs(np.sin(region.orientation - angle)) < np.radians(0.3)  # +-90 degrees are the same axis
    assert region.area == pytest.approx(np.pi * a * b, rel=5e-3)


def test_a_rectangle_has_the_moments_of_its_squares():
    mask = np.zeros((20, 60), np.uint8)
    mask[5:11, 10:50] = 255
    region = region_of(mask)
    # A w x h rectangle has second moments w^2/12 and h^2/12; the axes of the ellipse are 4 standard deviations.
    assert (region.major, region.minor) == pytest.approx((4 * 40 / 12**0.5, 4 * 6 / 12**0.5))
    assert region.ratio == pytest.approx(40 / 6)
    assert region.orientation == 0
    assert region.box == (10, 5, 40, 6)
    assert region_of(mask.T).orientation == pytest.approx(np.pi / 2)
    assert region_of(np.ones((1, 1), bool)).major == pytest.approx(4 / 12**0.5)


def test_regions_join_over_corners_and_come_largest_first():
    mask = np.zeros((12, 12), bool)
    mask[1, 1] = mask[2, 2] = mask[3, 1] = True
    mask[6:9, 6:10] = True
    labels, regions = label_regions(mask)
    assert [region.area for region in regions] == [12, 3]
    for region in regions:
        assert np.count_nonzero(labels == region.label) == region.area
    assert [region.area for region in label_regions(mask, min_area=4)[1]] == [12]
    assert label_regions(np.zeros((4, 4), bool))[1] == []


def test_a_moved_region_keeps_its_shape():
    mask = np.zeros((30, 30), bool)
    mask[4:9, 3:20] = True
    moved, there = region_of(mask).shift(5, 7), region_of(np.roll(mask, (7, 5), axis=(0, 1)))
    np.testing.assert_allclose(moved.centroid, there.centroid)
    assert (moved.box, moved.major) == (there.box, there.major)


def test_nothing_has_no_shape():
    with pytest.raises(ValueError, match="empty mask"):
        region_of(np.zeros((5, 5), bool))
