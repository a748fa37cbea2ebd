"""Ends and axes of drawn forearms whose truth is known."""

import cv2
import numpy as np
import pytest

from jaxpoint.detection.person.endpoints import axis_line, finger_endpoints, forearm_endpoints

SHIFT = 4  # bits behind the point in which OpenCV draws
MIDDLE = np.array([150.0, 110.0])


def limb(angle, length=120.0, near=26.0, far=16.0):
    """A tapering forearm on a 300 x 220 image, its middle at MIDDLE, `angle` counter-clockwise with y up."""
    direction = np.array([np.cos(angle), -np.sin(angle)])
    normal = np.array([-direction[1], direction[0]])
    ends = MIDDLE - length / 2 * direction, MIDDLE + length / 2 * direction
    corners = np.array(
        [
            ends[0] + near / 2 * normal,
            ends[1] + far / 2 * normal,
            ends[1] - far / 2 * normal,
            ends[0] - near / 2 * normal,
        ]
    )
    mask = np.zeros((220, 300), np.uint8)
    cv2.fillPoly(mask, [np.round(corners * 2**SHIFT).astype(np.int32)], 255, shift=SHIFT)
    return mask, direction, ends


def apart(first, second):
    """Angle between two axes without sign, degrees."""
    return np.degrees(np.arccos(min(1.0, abs(float(first @ second)))))


@pytest.mark.parametrize("degrees", [-70, -30, 0, 10, 45, 90])
def test_the_axis_of_a_limb(degrees):
    mask, direction, ends = limb(np.radians(degrees))
    line = axis_line(mask)
    assert apart(line.direction, direction) < 0.25
    away = (line.point - MIDDLE) @ np.array([-direction[1], direction[0]])
    assert abs(away) < 0.3
    found = line.ends if line.direction @ direction > 0 else line.ends[::-1]
    np.testing.assert_allclose(found, ends, atol=1.5)
    assert line.width == pytest.approx(21, abs=1.5)
    assert line.residual < 0.5


@pytest.mark.parametrize("degrees", [-30, 0, 40])
def test_a_thumb_and_a_piece_of_the_upper_arm_hardly_turn_it(degrees):
    mask, direction, ends = limb(np.radians(degrees))
    normal = np.array([-direction[1], direction[0]])
    thumb, elbow = ends[1] - 12 * direction, ends[0] + 6 * direction
    for start, stop, width in ((thumb, thumb + 26 * normal, 11), (elbow, elbow + 20 * normal - 12 * direction, 20)):
        cv2.line(mask, np.round(start).astype(int).tolist(), np.round(stop).astype(int).tolist(), 255, width)
    rows, columns = np.nonzero(mask)
    principal = np.linalg.eigh(np.cov(np.stack([columns, rows])))[1][:, 1]
    assert apart(axis_line(mask).direction, direction) < 1.5
    assert apart(principal, direction) > 2 * apart(axis_line(mask).direction, direction)


def test_too_little_has_no_axis():
    assert axis_line(np.zeros((9, 9), bool)) is None
    dot = np.zeros((9, 9), bool)
    dot[4, 4:6] = True
    assert axis_line(dot) is None


def test_the_thesis_takes_the_topmost_pixels_of_the_outermost_columns():
    mask = np.zeros((40, 60), bool)
    mask[20:26, 10:50] = True
    mask[18, 49] = mask[23:30, 9] = True
    person = np.array([0.0, 24.0])
    finger = finger_endpoints(mask, person)
    np.testing.assert_array_equal([finger.tip, finger.base], [[49, 18], [9, 23]])
    np.testing.assert_array_equal(finger_endpoints(mask, np.array([60.0, 24.0])).tip, [9, 23])
    forearm = forearm_endpoints(mask, person)
    np.testing.assert_array_equal(forearm.tip, [49, 18])
    rows, columns = np.nonzero(mask)
    np.testing.assert_allclose(forearm.base, [columns.mean(), rows.mean()])
    np.testing.assert_allclose(forearm_endpoints(mask, person, shift_to_top=True).base, [columns.mean(), 20])


def test_the_thesis_tilts_a_level_forearm_up_by_half_its_width_over_half_its_length():
    """The suspected flaw of the thesis (7.2.2): atan(1.5 cm / 17 cm), which the axis line does not have."""
    mask, direction, _ = limb(0.0, length=340 / 2, near=30, far=30)
    ends = forearm_endpoints(mask, np.array([0.0, 110.0]))
    dx, dy = ends.tip - ends.base
    assert np.degrees(np.arctan2(-dy, dx)) == pytest.approx(np.degrees(np.arctan2(15, 85)), abs=0.5)
    assert apart(axis_line(mask).direction, direction) < 0.1


def test_nothing_has_no_ends():
    for endpoints in (finger_endpoints, forearm_endpoints):
        with pytest.raises(ValueError, match="no endpoints"):
            endpoints(np.zeros((4, 4), bool), np.zeros(2))
