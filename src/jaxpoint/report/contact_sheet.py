"""Contact sheets of what was found of people in images: silhouettes, heads, the pointing arm, and reasons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, UInt8

from jaxpoint.io.files import StrPath, replacing

_BAND = 22  # px, the line of text above a view
_GAP = 6
_PAPER, _TEXT = (250, 248, 246), (47, 32, 16)  # blue, green, red
_SILHOUETTE, _HEAD, _ARM, _TIP, _BASE, _BAD = (
    (208, 130, 59), (107, 163, 42), (20, 130, 224), (80, 60, 235), (176, 80, 196), (93, 69, 214)
)  # fmt: skip
_HEAD_SHAPE = 0.78  # width over height
_FONT = cv2.FONT_HERSHEY_SIMPLEX


@dataclass(frozen=True)
class PersonView:
    """One image and what was found in it; pixels (x, y) of that image."""

    image: UInt8[np.ndarray, "H W 3"]  # blue, green, red
    title: str  # such as "cam_0, frame 120"
    silhouettes: Sequence[Bool[np.ndarray, "H W"]] = ()
    heads: Sequence[tuple[float, float, float]] = ()  # x, y, height of the ellipse, px
    axis: tuple[tuple[float, float], tuple[float, float]] | None = None  # both ends of the arm's axis as drawn
    tip: tuple[float, float] | None = None
    base: tuple[float, float] | None = None
    reason: str = ""  # why something was not found


def contact_sheet(
    views: Sequence[PersonView], *, columns: int = 4, width: int = 400, zoom: bool = False
) -> UInt8[np.ndarray, "H W 3"]:
    """All views in a grid, blue, green, red: the silhouette blue, heads green, the arm orange from base to tip.

    Args:
        views: in the order of reading.
        columns: views side by side.
        width: of each, px.
        zoom: cut each view to its silhouettes and what is drawn, so that small people can be seen.

    Raises:
        ValueError: there are no views.
    """
    if not views:
        raise ValueError("A contact sheet needs at least one view; none was given.")
    columns = min(columns, len(views))
    lines = 2 if any(view.reason for view in views) else 1
    cells = [_cell(view, width, zoom, lines) for view in views]
    rows = [cells[start : start + columns] for start in range(0, len(cells), columns)]
    return np.concatenate([_row(row, columns, width) for row in rows])


def save_contact_sheet(path: StrPath, views: Sequence[PersonView], **layout) -> None:
    """Write a contact sheet as PNG, at once or not at all; `layout` is that of `contact_sheet`.

    Raises:
        OSError: the folder is missing or not writable.
    """
    _, data = cv2.imencode(".png", contact_sheet(views, **layout))
    with replacing(path) as file:
        file.write(data.tobytes())


def _row(cells: Sequence[np.ndarray], columns: int, width: int) -> np.ndarray:
    """Cells side by side on paper, as high as the highest."""
    height = max(len(cell) for cell in cells)
    paper = np.full((height + _GAP, columns * (width + _GAP) + _GAP, 3), _PAPER, np.uint8)
    for place, cell in enumerate(cells):
        left = _GAP + place * (width + _GAP)
        paper[: len(cell), left : left + width] = cell
    return paper


def _cell(view: PersonView, width: int, zoom: bool, lines: int) -> np.ndarray:
    """One view, drawn at its size in the sheet so that lines are equally thick everywhere, under its text."""
    left, top, wide, high = _part(view) if zoom else (0, 0, view.image.shape[1], view.image.shape[0])
    scale = width / wide
    size = width, max(1, round(high * scale))
    part = np.ascontiguousarray(view.image[top : top + high, left : left + wide])
    image = cv2.resize(part, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    for mask in view.silhouettes:
        small = mask[top : top + high, left : left + wide].astype(np.uint8)
        small = cv2.resize(small, size, interpolation=cv2.INTER_NEAREST)
        outlines, _ = cv2.findContours(small, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(image, outlines, -1, _SILHOUETTE, 1, cv2.LINE_AA)

    def place(pixel: tuple[float, float]) -> tuple[int, int]:
        return round((pixel[0] + 0.5 - left) * scale - 0.5), round((pixel[1] + 0.5 - top) * scale - 0.5)

    for x, y, height in view.heads:
        axes = max(1, round(_HEAD_SHAPE * height * scale / 2)), max(1, round(height * scale / 2))
        cv2.ellipse(image, place((x, y)), axes, 0, 0, 360, _HEAD, 2, cv2.LINE_AA)
    if view.axis is not None:
        cv2.line(image, place(view.axis[0]), place(view.axis[1]), _ARM, 2, cv2.LINE_AA)
    for pixel, color in ((view.base, _BASE), (view.tip, _TIP)):
        if pixel is not None:
            cv2.circle(image, place(pixel), 5, (255, 255, 255), -1, cv2.LINE_AA)
            cv2.circle(image, place(pixel), 4, color, -1, cv2.LINE_AA)
    return add_title(image, view.title, view.reason, lines)


def _part(view: PersonView) -> tuple[int, int, int, int]:
    """Left, top, width and height of what there is to see, in the image's own shape; all of it where nothing is."""
    high, wide = view.image.shape[:2]
    drawn = [pixel for pixel in (*(view.axis or ()), view.tip, view.base) if pixel is not None]
    drawn += [(x + sign * size, y + sign * size) for x, y, size in view.heads for sign in (-1, 1)]
    for mask in view.silhouettes:
        rows, columns = np.nonzero(mask)
        drawn += [(columns.min(), rows.min()), (columns.max(), rows.max())] if len(rows) else []
    if not drawn:
        return 0, 0, wide, high
    low, top = np.min(drawn, axis=0), np.max(drawn, axis=0)
    share = min(1.0, 1.15 * float(np.max((top - low) / (wide, high))) + 0.02)
    size = np.maximum(np.round(np.multiply((wide, high), share)), 1).astype(int)
    corner = np.clip(np.round((low + top - size) / 2), 0, np.subtract((wide, high), size)).astype(int)
    return int(corner[0]), int(corner[1]), int(size[0]), int(size[1])


def add_title(image: UInt8[np.ndarray, "H W 3"], title: str, reason: str, lines: int = 2) -> UInt8[np.ndarray, "G W 3"]:
    """The image under a line with its title, and, with two lines, one with the reason in red."""
    band = np.full((_BAND * lines, image.shape[1], 3), _PAPER, np.uint8)
    for row, (text, color) in enumerate(((title, _TEXT), (reason, _BAD))[:lines]):
        cv2.putText(band, _fitting(text, image.shape[1] - 4), (2, row * _BAND + 16), _FONT, 0.45, color, 1, cv2.LINE_AA)
    return np.concatenate([band, image])


def _fitting(text: str, width: int) -> str:
    """The text, cut to a width in px; the font has only plain letters."""
    text = text.encode("ascii", "replace").decode()
    if cv2.getTextSize(text, _FONT, 0.45, 1)[0][0] <= width:
        return text
    while text and cv2.getTextSize(text + "...", _FONT, 0.45, 1)[0][0] > width:
        text = text[:-1]
    return text + "..."
