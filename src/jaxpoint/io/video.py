"""The frames of one camera: a video file or a folder of images."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from jaxpoint.errors import FileFormatError
from jaxpoint.io.frames import FrameSource
from jaxpoint.io.images import IMAGE_SUFFIXES, ImageFolder
from jaxpoint.io.stamps import MS, SAME_STAMP, Stamps, pixel_aspect, read_stamps

__all__ = ["IMAGE_SUFFIXES", "FrameSource", "ImageFolder", "VideoFile", "open_frames"]

logger = logging.getLogger(__name__)


class VideoFile(FrameSource):
    """A video file, decoded by OpenCV. Frame numbers are positions; times are the stamps of the container."""

    def __init__(self, path: Path):
        self.path = path
        capture = self._open()
        try:
            counted = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
            decoded, image = capture.read()
            if not decoded:
                raise FileFormatError(
                    f"0 frames of the video '{path}' could be decoded; it is empty or truncated. Copy it anew."
                )
            rate = capture.get(cv2.CAP_PROP_FPS)
            self.pixel_aspect = pixel_aspect(capture)
        finally:
            capture.release()
        stamps = read_stamps(path)
        self.size = (image.shape[1], image.shape[0])
        self._stamps = stamps.times
        count = _frame_count(stamps, counted)
        self.frame_ids = np.arange(count)
        self.numbered = False
        self.times = _times(stamps, count, rate)
        self.start = stamps.first_place / rate if rate > 0 else 0.0

    def _open(self) -> cv2.VideoCapture:
        capture = cv2.VideoCapture(str(self.path))
        if not capture.isOpened():
            raise FileFormatError(
                f"The video '{self.path}' cannot be opened (0 frames decoded); it is empty, truncated or of an unknown "
                "format. Copy it anew or convert it to mp4."
            )
        return capture

    def read(self, index: int) -> UInt8[np.ndarray, "H W 3"]:
        if not 0 <= index < len(self):
            raise IndexError(f"'{self.path}' has {len(self)} frames, no position {index}.")
        image = self._sought(index)
        if image is None:
            raise FileFormatError(f"Frame {index} of the video '{self.path}' cannot be decoded; copy the video anew.")
        return image

    def _sought(self, index: int) -> UInt8[np.ndarray, "H W 3"] | None:
        """The frame that a seek finds, unless its stamp says that it is another one; then that of going through all."""
        capture = self._open()
        try:
            capture.set(cv2.CAP_PROP_POS_FRAMES, index)
            decoded, image = capture.read()
            if decoded and self._place(capture, index) == index:
                return np.asarray(image)
        finally:
            capture.release()
        return next((image for place, image in self.stream(np.array([index])) if place == index), None)

    def _place(self, capture: cv2.VideoCapture, counted: int) -> int:
        """Position of the frame just decoded by its stamp, `counted` where no frame has this stamp.

        A packet that cannot be decoded gives no frame, and a seek in a video of variable rate ends at another frame.
        """
        if self._stamps is None:
            return counted
        time = capture.get(cv2.CAP_PROP_POS_MSEC) * MS
        first = int(np.searchsorted(self._stamps, time - SAME_STAMP))
        found = first < len(self._stamps) and self._stamps[first] < time + SAME_STAMP
        return first if found else counted

    def stream(self, indices: Int[np.ndarray, " N"] | None = None) -> Iterator[tuple[int, UInt8[np.ndarray, "H W 3"]]]:
        wanted = np.ones(len(self), dtype=bool) if indices is None else np.isin(np.arange(len(self)), indices)
        capture, index, last = self._open(), -1, int(np.flatnonzero(wanted)[-1]) if wanted.any() else -1
        try:
            while index < last:
                if not capture.grab():
                    self._ended_after(index + 1)
                    return
                index = max(index + 1, self._place(capture, index + 1))
                if index <= last and wanted[index]:
                    decoded, image = capture.retrieve()
                    if not decoded:
                        self._ended_after(index)
                        return
                    yield index, np.asarray(image)
        finally:
            capture.release()

    def _ended_after(self, decoded: int) -> None:
        """Headers may count a frame or two too many; more than that is a truncated file."""
        if len(self) - decoded > _spare(len(self)):
            raise FileFormatError(
                f"The video '{self.path}' ends early: {decoded} of {len(self)} frames were decoded. Copy it anew, or "
                "cut it there and cut the other cameras' videos alike."
            )
        logger.warning("Video '%s': %d of the %d frames in its header exist.", self.path, decoded, len(self))


def open_frames(path: str | Path) -> FrameSource:
    """The frames of one camera from a video file, a folder of images, or some of these (`folder/left*.jpg`).

    Raises:
        FileFormatError: no such path, an empty folder, or a video that cannot be decoded.
    """
    path = Path(path)
    if "*" in path.name and path.parent.is_dir():
        return ImageFolder(path.parent, path.parent.glob(path.name))
    if path.is_dir():
        return ImageFolder(path)
    if not path.is_file():
        raise FileFormatError(f"There is no video or folder of images at '{path}'; check the path.")
    if path.suffix.lower() in IMAGE_SUFFIXES:
        raise FileFormatError(f"'{path}' is a single image; give the folder that holds all frames of the camera.")
    return VideoFile(path)


def _spare(count: int) -> int:
    return max(2, count // 100)


def _frame_count(stamps: Stamps, counted: int) -> int:
    """The packets, unless the header promises more frames and their stamps end before: then the file was cut off.

    Some headers hold the length alone, from which a count is guessed that dropped frames do not reach.
    """
    found = stamps.last_place + 1 if stamps.times is None else len(stamps.times)
    cut_off = max(found, stamps.last_place + 1) < counted - _spare(counted)
    return max(counted if cut_off else found, 1)


def _times(stamps: Stamps, count: int, rate: float) -> Float[np.ndarray, " F"] | None:
    """Stamps (s), continued evenly over frames that the header promises; by the rate alone where there are none."""
    if stamps.times is None or len(stamps.times) < 2:
        return np.arange(count) / rate if rate > 0 else None
    period = float(np.median(np.diff(stamps.times)))
    beyond = stamps.times[-1] + period * np.arange(1, count - len(stamps.times) + 1)
    return np.concatenate([stamps.times, beyond])
