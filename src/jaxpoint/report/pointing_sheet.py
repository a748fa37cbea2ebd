"""One gesture in every camera's image: the arm's axis, tip and base, the line, and the object's box (thesis, figures
10 and 51)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from jaxpoint.io.files import StrPath, replacing
from jaxpoint.report.contact_sheet import add_title

_GAP = 6
_PAPER = (250, 248, 246)  # blue, green, red
_ARM, _TIP, _BASE, _LINE, _MEANT, _OTHER = (
    (20, 130, 224), (80, 60, 235), (176, 80, 196), (20, 130, 224), (40, 40, 230), (220, 190, 60)
)  # fmt: skip
_FONT, _LARGE = cv2.FONT_HERSHEY_SIMPLEX, 0.6
_BAND, _TEXT = 26, (47, 32, 16)  # px, a line of the text above all; blue, green, red
_DASH_PX = 9
_CLEAR = 4  # px, between two names


@dataclass(frozen=True)
class Outline:
    """An object as a camera sees it."""

    name: str
    edges: Sequence[Float[np.ndarray, "N 2"]]  # px, polylines: the parts in front of the camera
    meant: bool  # the answer, in red; else one that it may be too


@dataclass(frozen=True)
class PointingView:
    """One camera's image of one gesture; pixels (x, y) of that image."""

    image: UInt8[np.ndarray, "H W 3"]  # blue, green, red
    title: str
    outlines: Sequence[Outline] = ()
    line: Float[np.ndarray, "N 2"] | None = None  # px, from the tip on
    tip: tuple[float, float] | None = None
    base: tuple[float, float] | None = None
    reason: str = ""  # why the view is not used


def pointing_sheet(views: Sequence[PointingView], *, columns: int = 3, width: int = 440) -> UInt8[np.ndarray, "H W 3"]:
    """All views in a grid, blue, green, red.

    The arm is a thick orange line from base (violet) to tip (red), the line of pointing dashes; the object that is
    meant has a red box, another likely one a blue one.

    Raises:
        ValueError: there are no views.
    """
    if not views:
        raise ValueError("A sheet needs at least one view; none was given.")
    columns = min(columns, len(views))
    cells = [_cell(view, width) for view in views]
    rows = [cells[start : start + columns] for start in range(0, len(cells), columns)]
    return np.concatenate([_row(row, columns, width) for row in rows])


def save_sheet(path: StrPath, sheet: UInt8[np.ndarray, "H W 3"], text: str) -> None:
    """Write a sheet (red, green, blue) under a text as JPEG, at once or not at all.

    Raises:
        OSError: the folder is missing or not writable.
    """
    image = np.concatenate([_band(text, sheet.shape[1]), sheet[..., ::-1]])
    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 90])[1]
    with replacing(path) as file:
        file.write(data.tobytes())


def _band(text: str, width: int) -> UInt8[np.ndarray, "H W 3"]:
    """Text on paper, in as many lines as it takes."""
    lines = [""]
    for word in text.encode("ascii", "replace").decode().split():
        longer = f"{lines[-1]} {word}".strip()
        if cv2.getTextSize(longer, _FONT, _LARGE, 1)[0][0] <= width - 8:
            lines[-1] = longer
        else:
            lines.append(word)
    band = np.full((_BAND * len(lines) + _GAP, width, 3), _PAPER, np.uint8)
    for row, line in enumerate(lines, start=1):
        cv2.putText(band, line, (4, _BAND * row - 6), _FONT, _LARGE, _TEXT, 1, cv2.LINE_AA)
    return band


def _row(cells: Sequence[np.ndarray], columns: int, width: int) -> np.ndarray:
    paper = np.full((max(map(len, cells)) + _GAP, columns * (width + _GAP) - _GAP, 3), _PAPER, np.uint8)
    for place, cell in enumerate(cells):
        paper[: len(cell), place * (width + _GAP) : place * (width + _GAP) + width] = cell
    return paper


def _cell(view: PointingView, width: int) -> np.ndarray:
    high, wide = view.image.shape[:2]
    scale = width / wide
    size = width, max(1, round(high * scale))
    image = cv2.resize(view.image, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)

    def place(pixels) -> np.ndarray:
        return np.round((np.asarray(pixels, float) + 0.5) * scale - 0.5).astype(int)

    for outline in sorted(view.outlines, key=lambda one: one.meant):
        color = _MEANT if outline.meant else _OTHER
        for edge in outline.edges:
            cv2.polylines(image, [place(edge)], False, color, 2, cv2.LINE_AA)
    if view.line is not None:
        _draw_dashed(image, place(view.line))
    if view.tip is not None and view.base is not None:
        cv2.line(image, tuple(place(view.base)), tuple(place(view.tip)), _ARM, 3, cv2.LINE_AA)
    for pixel, color in ((view.base, _BASE), (view.tip, _TIP)):
        if pixel is not None:
            cv2.circle(image, tuple(place(pixel)), 5, (255, 255, 255), -1, cv2.LINE_AA)
            cv2.circle(image, tuple(place(pixel)), 4, color, -1, cv2.LINE_AA)
    taken: list[_Box] = []
    for outline in sorted(view.outlines, key=lambda one: not one.meant):
        _name(image, outline, place, taken)
    return add_title(image, view.title, view.reason)


def _draw_dashed(image: np.ndarray, line: np.ndarray) -> None:
    """Dashes of equal length along a polyline."""
    passed = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    if passed[-1] > 10 * max(image.shape):
        return  # passes the camera closely
    steps = np.arange(0.0, passed[-1] + _DASH_PX, _DASH_PX)
    places = np.stack([np.interp(steps, passed, line[:, i]) for i in range(2)], axis=1).round().astype(int)
    for start, end in list(pairwise(places))[::2]:
        cv2.line(image, tuple(start), tuple(end), _LINE, 2, cv2.LINE_AA)


def _name(image: np.ndarray, outline: Outline, place, taken: list[_Box]) -> None:
    """The name beside the object, clear of other names; nothing where it lies outside the image."""
    corners = np.concatenate([place(edge) for edge in outline.edges]) if outline.edges else np.zeros((0, 2), int)
    high, wide = image.shape[:2]
    inside = corners[(corners >= 0).all(axis=1) & (corners < (wide, high)).all(axis=1)]
    if not len(inside):
        return
    text = outline.name.encode("ascii", "replace").decode()
    (w, h), _ = cv2.getTextSize(text, _FONT, 0.45, 1)
    x = int(np.clip(inside[:, 0].mean() - w / 2, 2, max(2, wide - w - 2)))
    above, below = int(inside[:, 1].min()) - 6, int(inside[:, 1].max()) + h + 8
    # Nearest to the object's upper or lower edge, on the object only where there is no room beside it.
    places = sorted(range(h + 3, high - 4), key=lambda y: (above < y < below, min(abs(y - above), abs(y - below))))
    boxes = (_Box(x - 3, y - h - 3, x + w + 3, y + 4) for y in places)
    box = next((box for box in boxes if not any(map(box.meets, taken))), None)
    if box is None:
        return  # an image so full of names is better without another
    taken.append(box)
    cv2.rectangle(image, (box.left, box.top), (box.right, box.bottom), (255, 255, 255), -1)
    color = _MEANT if outline.meant else (150, 110, 0)
    cv2.putText(image, text, (x, box.bottom - 4), _FONT, 0.45, color, 1, cv2.LINE_AA)


class _Box(NamedTuple):
    """A part of an image, px, ends included."""

    left: int
    top: int
    right: int
    bottom: int

    def meets(self, other: _Box) -> bool:
        """Whether less than `_CLEAR` lies between them."""
        across = max(self.left - other.right, other.left - self.right)
        down = max(self.top - other.bottom, other.top - self.bottom)
        return max(across, down) < _CLEAR
