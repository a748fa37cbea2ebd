"""Heads of drawn people, whose middles are known to a fraction of a pixel."""

import cv2
import numpy as np
import pytest

from jaxpoint.config.person import HeadSettings, SilhouetteSettings, thesis_person
from jaxpoint.detection.person.head_template import find_head, head_heights, head_template, ring_template
from jaxpoint.detection.person.silhouette import silhouettes
from jaxpoint.evidence.camera_evidence import HeadReason

FOCAL = 500.0  # px; a head of 0.24 m at 1 to 6 m is 20 to 120 px high
SETTINGS, THESIS = HeadSettings(), thesis_person().head
EXACT = SilhouetteSettings(width_px=0, close_px=1)


def found_in(mask, settings=SETTINGS, shapes=EXACT):
    return find_head(silhouettes(mask, shapes)[0], FOCAL, settings)


@pytest.fixture(scope="module")
def blank(drawn):
    return np.zeros((*drawn.size[::-1], 3))


@pytest.fixture(scope="module")
def crowd(drawn):
    """People of unlike sizes, arms and heads, somewhere in the image."""
    rng = np.random.default_rng(0)
    return [
        drawn.Person(
            rng.uniform(150, 450),
            rng.uniform(40, 90),
            rng.uniform(160, 280),
            rng.uniform(-1.2, 1.3),
            rng.uniform(0.68, 0.85),
        )
        for _ in range(40)
    ]


def test_the_middle_of_every_head(crowd, blank):
    """Within 2 % of its height: half a centimetre. Half resolution hardly matters; the thesis's place is rougher."""
    errors = {"outline": [], "half": [], "thesis": []}
    for person in crowd:
        mask = person.drawn(blank, mask_only=True)
        for name, settings, shapes in (
            ("outline", SETTINGS, EXACT),
            ("half", SETTINGS, SilhouetteSettings(width_px=320, close_px=0)),
            ("thesis", THESIS, EXACT),
        ):
            head = found_in(mask, settings, shapes)
            assert head.found
            errors[name].append(np.hypot(head.x - person.x, head.y - person.y) / person.head)
            if name == "outline":
                assert head.height_px == pytest.approx(person.head, rel=0.15)
    medians = {name: np.median(errors[name]) for name in errors}
    assert medians["outline"] < 0.02
    assert max(errors["outline"]) < 0.08
    assert medians["half"] < 0.05
    assert medians["thesis"] > 1.2 * medians["outline"]


def test_a_raised_fist_is_no_head(drawn, blank):
    person = drawn.Person(300.0, 130.0, 230.0, arm=1.35)
    mask = person.drawn(blank, mask_only=True)
    cv2.circle(mask, np.round(person.tip).astype(int).tolist(), 8, 255, -1)
    head = found_in(mask)
    assert head.found
    assert np.hypot(head.x - person.x, head.y - person.y) < 0.1 * person.head


@pytest.mark.parametrize(("x", "y"), [(5.0, 80.0), (636.0, 80.0), (300.0, 12.0)])
def test_a_head_over_the_border_of_the_image_is_continued(drawn, blank, x, y):
    """From what is seen of its outline, to a tenth of its height."""
    person = drawn.Person(x, y, 260.0, arm=None)
    head = found_in(person.drawn(blank, mask_only=True))
    assert head.found
    assert np.hypot(head.x - person.x, head.y - person.y) < 0.1 * person.head


def test_a_head_of_which_too_little_is_seen_is_none(drawn, blank):
    for x, y in ((-6.0, 80.0), (300.0, 6.0), (300.0, -4.0)):
        assert not found_in(drawn.Person(x, y, 260.0, arm=None).drawn(blank, mask_only=True)).found


def test_one_reason_for_every_cause(drawn, blank):
    cut = drawn.Person(300.0, -4.0, 260.0)
    assert found_in(cut.drawn(blank, mask_only=True)).reason == HeadReason.OUT_OF_VIEW
    mask = np.zeros(drawn.size[::-1], np.uint8)
    mask[100:115, 100:300] = 255
    assert found_in(mask).reason == HeadReason.TOO_SMALL
    mask[100:123, 20:620] = 255
    assert found_in(mask).reason == HeadReason.NO_SIZE_FITS
    mask[100:300, 60:500] = 255
    assert found_in(mask).reason == HeadReason.UNLIKE
    assert not found_in(mask).found


def test_sizes_follow_the_camera():
    heights = head_heights(900.0, SETTINGS)
    assert (heights[0], heights[-1]) == pytest.approx((900 * 0.24 / 6, 900 * 0.24 / 1))
    np.testing.assert_allclose(np.diff(np.log(heights)), np.log(6) / 9)


def test_templates_are_ellipses_with_a_margin():
    template = head_template(24.0, 0.78)
    assert template.astype(float).sum() / 255 == pytest.approx(np.pi / 4 * 24 * 0.78 * 24, rel=0.01)
    assert not template[:3].any()
    assert not template[:, :3].any()
    ring = ring_template(24.0, 0.78)
    assert ring.sum() == pytest.approx(0, abs=1e-5)
    assert np.abs(ring - ring[:, ::-1]).max() < 1e-6
    assert (ring[len(ring) // 2 + 4 :] >= 0).all()
