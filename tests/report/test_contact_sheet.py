"""Contact sheets and figures of people: what is drawn is where it should be."""

import cv2
import numpy as np
import pytest

from jaxpoint.body.tracking.head_tracks import HeadTracks, Status
from jaxpoint.report.contact_sheet import PersonView, contact_sheet, save_contact_sheet
from jaxpoint.report.figures_heads import floor_plan, heights, in_space
from jaxpoint.report.style import style, to_svg

GREY = np.full((100, 200, 3), 128, np.uint8)


def drawn(cell, color):
    """Middle of all pixels of nearly this colour (blue, green, red)."""
    near = (np.abs(cell.astype(int) - color) < 20).all(axis=2)
    rows, columns = np.nonzero(near)
    return columns.mean(), rows.mean()


@pytest.fixture
def view():
    mask = np.zeros((100, 200), bool)
    mask[20:80, 90:110] = True
    return PersonView(
        GREY,
        "door, frame 12",
        [mask],
        [(100.0, 30.0, 16.0)],
        ((110.0, 45.0), (150.0, 40.0)),
        (150.0, 40.0),
        (110.0, 45.0),
    )


def test_what_was_found_is_drawn_in_its_place(view):
    sheet = contact_sheet([view], width=400)
    cell = sheet[22 : 22 + 200, 6 : 6 + 400]  # under one line of text, at twice the size
    for color, place in (((80, 60, 235), view.tip), ((176, 80, 196), view.base), ((107, 163, 42), view.heads[0][:2])):
        np.testing.assert_allclose(drawn(cell, color), 2 * np.array(place) + 0.5, atol=1.5)
    np.testing.assert_allclose(drawn(cell, (208, 130, 59)), [199.5, 99.5], atol=6)  # the outline, arm and head over it


def test_zoom_shows_all_that_was_found_larger(view):
    cell = contact_sheet([view], width=400, zoom=True)[22:, 6:406]
    tip, base = np.array(drawn(cell, (80, 60, 235))), np.array(drawn(cell, (176, 80, 196)))
    assert np.linalg.norm(tip - base) > 1.1 * 2 * np.linalg.norm(np.subtract(view.tip, view.base))
    assert contact_sheet([PersonView(GREY, "empty")], width=200, zoom=True).shape == (100 + 22 + 6, 212, 3)


def test_reasons_have_their_line_and_rows_their_height(view):
    with_reason = PersonView(GREY, "door, frame 13", reason="no size of a head fits the silhouette " * 5)
    sheet = contact_sheet([view, with_reason, view], columns=2, width=200)
    assert sheet.shape == (2 * (100 + 2 * 22 + 6), 2 * 206 + 6, 3)
    red = (np.abs(sheet[22:44].astype(int) - (93, 69, 214)) < 30).all(axis=2)
    assert red[:, 212:].any()
    assert not red[:, :206].any()


def test_saved_as_png_whole_or_not_at_all(view, tmp_path):
    save_contact_sheet(tmp_path / "sheet.png", [view], width=300)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "sheet.png")), contact_sheet([view], width=300))
    with pytest.raises(ValueError, match="at least one view"):
        save_contact_sheet(tmp_path / "none.png", [])
    assert [path.name for path in tmp_path.iterdir()] == ["sheet.png"]


@pytest.fixture(scope="module")
def heads():
    """Two people; the second comes later and is not seen for a while."""
    frames, turn = 60, np.linspace(0, 2, 60)
    positions = np.stack(
        [
            np.stack([2 + np.cos(turn), 2 + np.sin(turn), np.full(frames, 1.6)], axis=1),
            np.stack([4 - turn, np.full(frames, 3.0), np.full(frames, 1.7)], axis=1),
        ],
        axis=1,
    )
    status = np.full((frames, 2), int(Status.MEASURED))
    status[:20, 1], status[30:36, 1] = Status.ABSENT, Status.NO_VIEW
    return HeadTracks(
        np.arange(frames), np.arange(frames) / 12.5, np.array([1, 2]), positions, np.full((frames, 2), 0.01),
        np.ones((frames, 2, 2), bool), status, ("door", "window"),
    )  # fmt: skip


CENTERS = np.array([[0.1, 0.2, 2.5], [5.5, 4.0, 2.2]])


def test_the_floor_plan_shows_every_way_from_where_it_begins(heads):
    with style():
        figure = floor_plan(heads, CENTERS, np.array([[0.0, 0.0, 0.0], [6.0, 5.0, 3.0]]))
    ax = figure.axes[0]
    bands = [line for line in ax.lines if line.get_linewidth() == 7]
    assert [len(band.get_xdata()) for band in bands] == [60, 40]
    np.testing.assert_allclose(bands[1].get_xydata()[0], heads.positions[20, 1, :2])
    dots = [dot for dot in ax.collections if len(dot.get_offsets()) > 1]
    assert [len(dot.get_offsets()) for dot in dots] == [60, 34]
    np.testing.assert_allclose(dots[1].get_array()[[0, -1]], heads.times[[20, 59]])
    text = to_svg(figure)
    assert all(word in text for word in ("person 1", "person 2", "door", "window", "time, s"))


def test_space_and_heights(heads):
    with style():
        space, height = in_space(heads, CENTERS), heights(heads)
    times = [way.get_array() for way in space.axes[0].collections if way.get_array() is not None]
    assert [len(seconds) for seconds in times] == [59, 39]
    assert times[1][0] == pytest.approx((heads.times[20] + heads.times[21]) / 2)
    lines = [line for line in height.axes[0].lines if line.get_linestyle() == "-" and line.get_linewidth() == 1.6]
    np.testing.assert_allclose(lines[1].get_ydata(), heads.positions[20:, 1, 2])
    rings = [line for line in height.axes[0].lines if line.get_marker() == "o"]
    assert [len(ring.get_xdata()) for ring in rings] == [0, 6]


def test_nobody_is_a_figure_too(heads):
    nobody = HeadTracks(
        heads.frame_ids, heads.times, heads.people[:0], heads.positions[:, :0], heads.sigma[:, :0], heads.used[:, :0],
        heads.status[:, :0], heads.cameras,
    )  # fmt: skip
    with style():
        for figure in (floor_plan(nobody, CENTERS), in_space(nobody, CENTERS), heights(nobody)):
            assert "<svg" in to_svg(figure)
