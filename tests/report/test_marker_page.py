"""The page of a marker: what is drawn is where it should be, and no way is drawn where there is no tip."""

import colorsys
import re

import cv2
import numpy as np
import pytest

from jaxpoint.report.figures_marker import RAY_M, TipTrack, floor_plan, in_space, over_time
from jaxpoint.report.marker_page import _swatch, write_marker_report
from jaxpoint.report.style import style, to_svg

CENTERS = np.array([[0.1, 0.2, 2.5], [5.5, 4.0, 2.2]])
FIGURES = {
    "moments": 20,
    "cameras": [
        {"name": "door", "found": 17, "frames": 20, "reasons": {"no_colour": 3}},
        {"name": "window", "found": 20, "frames": 20, "reasons": {}},
    ],
    "in_room": {"tips": 17, "reasons": {"one_view": 3}},
    "model": {"hue": 60.0, "saturation": 200.0, "value": 180.0},
    "notes": ["the room is learnt from the recording itself"],
}


@pytest.fixture
def track():
    """A way of 20 frames: three without a tip, two without a direction."""
    turn = np.linspace(0, 2, 20)
    tips = np.stack([2 + np.cos(turn), 2 + np.sin(turn), 1.2 + 0.1 * turn], axis=1)
    directions = np.stack([-np.sin(turn), np.cos(turn), 0 * turn], axis=1)
    found = np.ones(20, bool)
    found[8:11], tips[8:11], directions[8:13] = False, 0.0, 0.0
    return TipTrack(np.arange(20) / 12.5, found, tips, directions, np.where(found, 0.004, 0.0))


def test_the_way_is_broken_where_there_is_no_tip(track):
    with style():
        figure = in_space(track, ("door", "window"), CENTERS)
    (way,) = [one for one in figure.axes[0].collections if one.get_array() is not None]
    assert len(way.get_array()) == 19 - 4  # three frames without a tip cut four pieces
    pieces, _ = track.pieces()
    assert np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1).max() < 0.15  # none leads to the zeros


def test_tips_lie_in_their_place_and_point_ahead(track):
    with style():
        plan, time = floor_plan(track, ("door", "window"), CENTERS), over_time(track)
    ax = plan.axes[0]
    (dots,) = [one for one in ax.collections if len(one.get_offsets()) > 1]
    np.testing.assert_allclose(dots.get_offsets(), track.tips[track.found, :2])
    rays = np.array([line.get_xydata() for line in ax.lines if len(line.get_xdata()) == 2])
    assert len(rays) == 15
    np.testing.assert_allclose(rays[0, 1] - rays[0, 0], RAY_M * track.directions[0, :2], atol=1e-12)
    np.testing.assert_allclose(time.axes[0].lines[0].get_ydata(), track.tips[track.found, 2])
    assert all(word in to_svg(plan) for word in ("door", "window", "time, s"))


def test_the_page_says_what_was_found(track, tmp_path):
    sheet = np.zeros((4, 4, 3), np.uint8)
    write_marker_report(tmp_path / "report.html", FIGURES, track, CENTERS, [("Frame 3", sheet)], {}, "[a]")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for told in ("17 of 20", "3 no colour", "Frames without a tip in the room: 3 one view.", "0.4 cm", "Frame 3"):
        assert told in page, told
    assert page.count("<svg") == 3
    alone = FIGURES | {"in_room": None}
    write_marker_report(tmp_path / "alone.html", alone, None, None, [], {}, "[a]")
    page = (tmp_path / "alone.html").read_text(encoding="utf-8")
    assert "--calibration" in page
    assert "<svg" not in page


@pytest.mark.parametrize("hsv", [(60, 200, 180), (170, 255, 90), (5, 30, 250), (0, 0, 255), (90, 120, 0)])
def test_the_swatch_is_the_colour_that_was_learnt(hsv):
    blue, green, red = cv2.cvtColor(np.uint8([[hsv]]), cv2.COLOR_HSV2BGR)[0, 0] / 255.0
    css = _swatch(dict(zip(("hue", "saturation", "value"), map(float, hsv))))
    hue, saturation, light = map(float, re.findall(r"[\d.]+", css))
    shown = colorsys.hls_to_rgb(hue / 360, light / 100, saturation / 100)
    np.testing.assert_allclose(shown, (red, green, blue), atol=0.02)
