"""What the container of a video says of its frames: when each is shown, and how wide its pixels are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

MS = 1e-3  # s; OpenCV speaks of milliseconds
SAME_STAMP = 5e-4  # s; containers round to 1 ms at most


@dataclass(frozen=True)
class Stamps:
    """The frames of a video by the times that its container states, first to last as they are shown."""

    times: Float[np.ndarray, " F"] | None  # s, counted from the first frame; None where the container states none
    first_place: int  # of the first frame on the container's own clock, in nominal frames from its zero
    last_place: int


def read_stamps(path: Path) -> Stamps:
    """The stamps of a video's packets: the file is read once, and nothing is decoded."""
    stat = path.stat()
    return _read(path.resolve(), stat.st_mtime_ns, stat.st_size)


def pixel_aspect(capture: cv2.VideoCapture) -> float | None:
    """Width over height of a pixel as the container states it; None where it states none (0/1 or 0/0)."""
    width, height = capture.get(cv2.CAP_PROP_SAR_NUM), capture.get(cv2.CAP_PROP_SAR_DEN)
    if not (width > 0 and height > 0):
        return None
    return float(height / width if _lies_turned(capture) else width / height)


def _lies_turned(capture: cv2.VideoCapture) -> bool:
    """Whether OpenCV turns the images by a quarter, so that width and height change places."""
    turned = capture.get(cv2.CAP_PROP_ORIENTATION_META) % 180 == 90
    return turned and bool(capture.get(cv2.CAP_PROP_ORIENTATION_AUTO))


@lru_cache(maxsize=64)
def _read(path: Path, _modified: int, _size: int) -> Stamps:
    """From the packets; where these do not rise, from the decoded frames."""
    for raw in (True, False):
        found = np.array(sorted(_grab(path, raw)) if raw else list(_grab(path, raw))).reshape(-1, 2)
        times = found[:, 0] * MS
        if len(times) and np.isfinite(times).all() and (np.diff(times) > 0).all():
            return Stamps(times - times[0], int(found[0, 1]), int(found[-1, 1]))
    return Stamps(None, 0, len(found) - 1)


def _grab(path: Path, raw: bool) -> Iterator[tuple[float, float]]:
    """Stamp (ms) and place of every packet (in the order of the file) or of every decoded frame."""
    capture = cv2.VideoCapture(str(path))
    try:
        if raw and not capture.set(cv2.CAP_PROP_FORMAT, -1):
            return
        count = 0
        while capture.grab():
            place = capture.get(cv2.CAP_PROP_PTS) if hasattr(cv2, "CAP_PROP_PTS") else count
            yield capture.get(cv2.CAP_PROP_POS_MSEC), place
            count += 1
    finally:
        capture.release()
