"""The thesis's filters: each fires on the region made for it; and its regions on drawn people."""

import cv2
import numpy as np
import pytest

from jaxpoint.config.person import MarkerSettings, ThesisSettings
from jaxpoint.detection.person.marker_regions import train_marker
from jaxpoint.detection.person.silhouette import Silhouette
from jaxpoint.detection.person.thesis_regions import ThesisReason, thesis_finger, thesis_forearm
from jaxpoint.detection.region import region_of

SETTINGS = ThesisSettings()
SHAPE = (200, 260)
MARKER = (200, 40, 30)


@pytest.fixture
def dressed(drawn):
    """An image in blue, and a silhouette that covers most of it, with its centroid near (80, 100)."""
    mask = np.zeros(SHAPE, bool)
    mask[20:180, 5:240] = True
    mask[20:60, 160:] = mask[140:180, 160:] = False
    region = region_of(mask)
    x, y, width, height = region.box
    silhouette = Silhouette(mask[y : y + height, x : x + width], region.box, region, SHAPE[::-1])
    return np.full((*SHAPE, 3), (90, 60, 40), np.uint8), silhouette


def strip(image, center, length, width, degrees, colour):
    """A rotated rectangle, drawn pixel by pixel."""
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    angle = np.radians(degrees)
    x, y = columns - center[0], center[1] - rows
    along, across = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
    inside = (np.abs(along) <= length / 2) & (np.abs(across) <= width / 2)
    image[inside] = colour
    return inside


@pytest.mark.parametrize(
    ("length", "width", "degrees", "reason"),
    [
        (60, 12, 20, ThesisReason.FOUND),
        (60, 12, 54, ThesisReason.FOUND),
        (60, 12, 57, ThesisReason.TOO_STEEP),
        (60, 12, -57, ThesisReason.TOO_STEEP),
        (16, 5, 20, ThesisReason.TOO_SMALL),
        (30, 26, 20, ThesisReason.TOO_ROUND),
        (36, 20, 20, ThesisReason.WRONG_RATIO),
        (60, 4, 0, ThesisReason.WRONG_RATIO),
        (0, 0, 0, ThesisReason.NO_COLOUR),
    ],
)
def test_every_filter_fires_on_its_own_region(dressed, drawn, length, width, degrees, reason):
    image, silhouette = dressed
    if length:
        strip(image, (180, 100), length, width, degrees, drawn.skin)
    found = thesis_forearm(image, silhouette, SETTINGS)
    assert found.reason == reason
    assert (found.region is None) == (found.endpoints is None) == (reason != ThesisReason.FOUND)


def test_the_farthest_region_wins_and_its_ends_are_in_the_image(dressed, drawn):
    image, silhouette = dressed
    near = strip(image, (70, 60), 60, 14, 0, drawn.skin)
    far = strip(image, (200, 100), 60, 14, 10, drawn.skin)
    found = thesis_forearm(image, silhouette, SETTINGS)
    x, y, width, height = found.region.box
    np.testing.assert_array_equal(found.mask, far[y : y + height, x : x + width])
    assert np.count_nonzero(far) == found.region.area != np.count_nonzero(near)
    rows, columns = np.nonzero(far)
    np.testing.assert_allclose(found.region.centroid, [columns.mean(), rows.mean()])
    np.testing.assert_allclose(found.endpoints.base, found.region.centroid)
    assert found.endpoints.tip[0] == columns.max()
    assert found.endpoints.tip[1] == rows[columns == columns.max()].min()


def test_skin_outside_the_silhouette_is_not_looked_at(dressed, drawn):
    image, silhouette = dressed
    strip(image, (215, 30), 60, 12, 0, drawn.skin)
    assert thesis_forearm(image, silhouette, SETTINGS).reason == ThesisReason.NO_COLOUR


def test_grey_images_are_said(dressed):
    image, silhouette = dressed
    grey = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    assert thesis_forearm(grey, silhouette, SETTINGS).reason == ThesisReason.GREY


@pytest.mark.parametrize(
    ("length", "width", "degrees", "reason"),
    [
        (18, 3.5, 50, ThesisReason.FOUND),
        (18, 3.5, 65, ThesisReason.TOO_STEEP),
        (18, 8, 10, ThesisReason.WRONG_RATIO),
        (5, 1, 0, ThesisReason.TOO_SMALL),
    ],
)
def test_the_finger_has_its_own_filters(dressed, length, width, degrees, reason):
    image, silhouette = dressed
    strip(image, (225, 100), length, width, degrees, MARKER)
    model = train_marker(np.tile(np.array([MARKER], np.uint8), (30, 1)), MarkerSettings(gates="fixed"))
    found = thesis_finger(image, silhouette, model, SETTINGS)
    assert found.reason == reason
    if reason == ThesisReason.FOUND:
        assert found.endpoints.tip[0] > found.endpoints.base[0]


def test_the_thesis_itself_is_what_the_settings_say():
    """The numbers of the thesis (6.3.1), one by one."""
    forearm, finger = SETTINGS.forearm, SETTINGS.finger
    assert (forearm.min_area_px, forearm.min_eccentricity, forearm.max_orientation_deg) == (100, 0.75, 55)
    assert (forearm.min_ratio, forearm.max_ratio) == (2, 11)
    assert (finger.min_area_px, finger.min_eccentricity, finger.max_orientation_deg) == (7, 0.75, 60)
    assert (finger.min_ratio, finger.max_ratio) == (3, 8)
    fixed = MarkerSettings(gates="fixed")
    assert (fixed.hue_gate, fixed.saturation_gate, fixed.value_gate) == (10, 60, 70)
