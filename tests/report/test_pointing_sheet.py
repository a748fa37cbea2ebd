"""A gesture in every camera's image: names stay apart, and the picture tells the answer."""

import cv2
import numpy as np
import pytest

from jaxpoint.report.pointing_sheet import Outline, PointingView, pointing_sheet, save_sheet

GREY = np.full((120, 200, 3), 128, np.uint8)
WHITE, RED = (255, 255, 255), (40, 40, 230)  # blue, green, red


def square(left, top, side=20) -> np.ndarray:
    return np.array([left, top]) + side * np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]], float)


def outlines(places, meant=0):
    return [Outline(f"thing {i}", [square(*place)], i == meant) for i, place in enumerate(places)]


def names(sheet) -> np.ndarray:
    """Left, top, width and height of the white boxes of names."""
    white = (sheet[44:] == WHITE).all(axis=2).astype(np.uint8)  # under the two lines of text
    closed = cv2.morphologyEx(white, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    return cv2.connectedComponentsWithStats(closed)[2][1:, :4]


@pytest.mark.parametrize(
    "places",
    [
        [(90, 50), (94, 52)],  # one on the other
        [(90, 50), (92, 50), (88, 48), (90, 54)],
        [(90, 0), (90, 0)],  # no room above
        [(90, 98), (80, 96)],  # none below
        [(-40, -40, 300), (-38, -30, 290), (20, 20)],  # two larger than the image: outside, and not named
    ],
)
def test_no_name_covers_another(places):
    sheet = pointing_sheet([PointingView(GREY, "door", outlines(places))], width=200)
    shown = sum(len(place) == 2 for place in places)
    boxes = names(sheet)
    assert len(boxes) == shown
    np.testing.assert_allclose(boxes[:, 3], boxes[0, 3], atol=2)  # whole: none is cut by its neighbour


def test_the_answers_name_keeps_its_place():
    alone, among = (
        pointing_sheet([PointingView(GREY, "door", outlines(places, len(places) - 1))], width=200)
        for places in ([(90, 50)], [(94, 52), (90, 50)])
    )
    assert names(alone)[0].tolist() in names(among).tolist()


def test_an_object_as_large_as_the_image_is_named_on_it():
    sheet = pointing_sheet([PointingView(GREY, "door", [Outline("wall", [square(5, 3, 114)], True)])], width=200)
    assert len(names(sheet)) == 1


def test_the_file_tells_the_answer(tmp_path):
    sheet = pointing_sheet([PointingView(GREY, "door")], width=440)[..., ::-1]
    short, long = "Gesture 1. The door.", "Gesture 2. " + 12 * "The door, perhaps; or the window. "
    for name, text in (("short", short), ("long", long)):
        save_sheet(tmp_path / f"{name}.jpg", sheet, text)
    one, many = (np.asarray(cv2.imread(str(tmp_path / f"{name}.jpg"))) for name in ("short", "long"))
    assert one.shape[1] == many.shape[1] == sheet.shape[1]
    assert sheet.shape[0] < one.shape[0] < many.shape[0]
    assert (one[: one.shape[0] - sheet.shape[0]] < 100).any()
    assert (many[-5 - sheet.shape[0] - 20 : -sheet.shape[0]] < 100).any()  # its last line
