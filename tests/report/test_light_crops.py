import numpy as np
import pytest

from jaxpoint import LedSettings, detect_led
from jaxpoint.detection.light.led import Reason
from jaxpoint.report.light_crops import MARK, contact_sheet


@pytest.fixture(scope="module")
def detection(recording):
    return detect_led([recording.folder], LedSettings(workers=1))


def test_every_reason_is_shown_with_the_light_in_the_middle(detection):
    crops = contact_sheet(detection, 0, per_reason=3, radius=10, zoom=4)
    assert [(crop.reason, crop.frame_id) for crop in crops] == [
        (Reason.FOUND, 0), (Reason.FOUND, 59), (Reason.FOUND, 119),
        (Reason.TOO_LARGE, 20), (Reason.WEAK, 40), (Reason.SEVERAL, 60), (Reason.BLURRED, 80),
    ]  # fmt: skip
    for crop in crops:
        assert crop.image.shape == (84, 84, 3)
        assert crop.image.dtype == np.uint8
    green = crops[0].image[..., 1].astype(float) - crops[0].image[..., 0]
    assert abs(np.argmax(green.sum(axis=0)) - 42) <= 4
    assert abs(np.argmax(green.sum(axis=1)) - 42) <= 4


def test_only_found_lights_carry_the_mark_and_it_points_at_the_position(detection):
    found, *rest = contact_sheet(detection, 0, per_reason=1, zoom=6)
    rows, columns = np.nonzero((found.image == MARK).all(axis=-1))
    offset = detection.tracks.pixels[0, 0] - detection.brightest[0, 0]
    np.testing.assert_allclose([columns.mean(), rows.mean()], (offset + 12.5) * 6 - 0.5, atol=0.6)
    assert not any((crop.image == MARK).all(axis=-1).any() for crop in rest)
