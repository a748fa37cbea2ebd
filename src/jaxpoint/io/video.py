"""The frames of one camera: a video file or a folder of images."""

from __future__ import annotations

import logging
import re
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from jaxpoint.errors import FileFormatError

IMAGE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp"})
logger = logging.getLogger(__name__)


class FrameSource(ABC):
    """Frames of one camera, 8-bit BGR as OpenCV orders colours. Open one with `open_frames`."""

    path: Path
    size: tuple[int, int]  # px, width and height
    frame_ids: Int[np.ndarray, " F"]  # number of the frame in the recording, strictly rising
    numbered: bool  # whether the frame numbers come from file names; else they are positions
    times: Float[np.ndarray, " F"] | None  # s, where the source knows them

    def __len__(self) -> int:
        """Number of frames, F."""
        return len(self.frame_ids)

    @abstractmethod
    def read(self, index: int) -> UInt8[np.ndarray, "H W 3"]:
        """The image at position `index` (0..F-1).

        Raises:
            IndexError: there is no such position.
            FileFormatError: the image cannot be decoded or has another size than the first.
        """

    @abstractmethod
    def stream(self, indices: Int[np.ndarray, " N"] | None = None) -> Iterator[tuple[int, UInt8[np.ndarray, "H W 3"]]]:
        """Position and image, one after the other; with `indices` (rising) only those.

        Raises:
            FileFormatError: an image cannot be decoded, has another size, or the video ends early.
        """

    def readable(
        self, indices: Int[np.ndarray, " N"], lost: list[FileFormatError] | None = None
    ) -> Iterator[tuple[int, UInt8[np.ndarray, "H W 3"]]]:
        """Like `stream`, but what cannot be decoded is left out, and what it says is added to `lost`."""
        try:
            yield from self.stream(indices)
        except FileFormatError as error:
            if lost is not None:
                lost.append(error)


class ImageFolder(FrameSource):
    """A folder of images in natural order (`2.jpg` before `10.jpg`).

    The frame number is the last number in each file's name where these numbers differ and rise, else the position.
    Images of a folder carry no times.
    """

    def __init__(self, path: Path):
        self.path = path
        self.files = sorted(filter(_is_frame, path.iterdir()), key=_natural_key)
        if not self.files:
            raise FileFormatError(
                f"The folder '{path}' holds no images; put the frames of one camera there as jpg, png, tif or bmp."
            )
        first = _decode(self.files[0])
        self.size = (first.shape[1], first.shape[0])
        numbers = _frame_numbers(self.files)
        self.numbered = numbers is not None
        self.frame_ids = np.arange(len(self.files)) if numbers is None else numbers
        self.times = None

    def read(self, index: int) -> UInt8[np.ndarray, "H W 3"]:
        if not 0 <= index < len(self.files):
            raise IndexError(f"'{self.path}' has {len(self.files)} images, no position {index}.")
        image = _decode(self.files[index])
        size = (image.shape[1], image.shape[0])
        if size != self.size:
            raise FileFormatError(
                f"'{self.files[index]}' is {size[0]} x {size[1]} px but '{self.files[0].name}' is "
                f"{self.size[0]} x {self.size[1]}; keep one camera's images of one size in a folder."
            )
        return image

    def stream(self, indices: Int[np.ndarray, " N"] | None = None) -> Iterator[tuple[int, UInt8[np.ndarray, "H W 3"]]]:
        for index in range(len(self)) if indices is None else indices:
            yield int(index), self.read(int(index))

    def readable(
        self, indices: Int[np.ndarray, " N"], lost: list[FileFormatError] | None = None
    ) -> Iterator[tuple[int, UInt8[np.ndarray, "H W 3"]]]:
        for index in indices:  # one bad file says nothing of those after it
            yield from super().readable(np.array([index]), lost)


class VideoFile(FrameSource):
    """A video file, decoded by OpenCV. Frame numbers are positions; times are position / frame rate."""

    def __init__(self, path: Path):
        self.path = path
        capture = self._open()
        try:
            count = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
            if count <= 0:  # raw streams have no count in the header
                count = sum(1 for _ in iter(capture.grab, False))
                capture.release()
                capture = self._open()
            decoded, image = capture.read()
            if not decoded:
                raise FileFormatError(
                    f"0 frames of the video '{path}' could be decoded; it is empty or truncated. Copy it anew."
                )
            rate = capture.get(cv2.CAP_PROP_FPS)
        finally:
            capture.release()
        self.size = (image.shape[1], image.shape[0])
        self.frame_ids = np.arange(count)
        self.numbered = False
        self.times = self.frame_ids / rate if rate > 0 else None

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
        capture = self._open()
        try:
            capture.set(cv2.CAP_PROP_POS_FRAMES, index)
            decoded, image = capture.read()
        finally:
            capture.release()
        if not decoded:
            raise FileFormatError(f"Frame {index} of the video '{self.path}' cannot be decoded; copy the video anew.")
        return image

    def stream(self, indices: Int[np.ndarray, " N"] | None = None) -> Iterator[tuple[int, UInt8[np.ndarray, "H W 3"]]]:
        wanted = np.ones(len(self), dtype=bool) if indices is None else np.isin(np.arange(len(self)), indices)
        capture = self._open()
        try:
            for index in range(len(self)):
                if not capture.grab():
                    self._ended_after(index)
                    return
                if wanted[index]:
                    decoded, image = capture.retrieve()
                    if not decoded:
                        self._ended_after(index)
                        return
                    yield index, image
        finally:
            capture.release()

    def _ended_after(self, decoded: int) -> None:
        """Headers may count a frame or two too many; more than that is a truncated file."""
        if len(self) - decoded > max(2, len(self) // 100):
            raise FileFormatError(
                f"The video '{self.path}' ends early: {decoded} of {len(self)} frames were decoded. Copy it anew, or "
                "cut it there and cut the other cameras' videos alike."
            )
        logger.warning("Video '%s': %d of the %d frames in its header exist.", self.path, decoded, len(self))


def open_frames(path: str | Path) -> FrameSource:
    """The frames of one camera from a video file or a folder of images.

    Raises:
        FileFormatError: no such path, an empty folder, or a video that cannot be decoded.
    """
    path = Path(path)
    if path.is_dir():
        return ImageFolder(path)
    if not path.is_file():
        raise FileFormatError(f"There is no video or folder of images at '{path}'; check the path.")
    if path.suffix.lower() in IMAGE_SUFFIXES:
        raise FileFormatError(f"'{path}' is a single image; give the folder that holds all frames of the camera.")
    return VideoFile(path)


def _decode(file: Path) -> UInt8[np.ndarray, "H W 3"]:
    data = np.frombuffer(file.read_bytes(), dtype=np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_COLOR) if data.size else None
    if image is None:
        raise FileFormatError(f"The image '{file}' ({data.size} bytes) cannot be decoded; copy it anew or remove it.")
    return image


def _natural_key(file: Path) -> list[tuple[int, int, str]]:
    parts = re.split(r"(\d+)", file.name.lower())
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts]


def _frame_numbers(files: Sequence[Path]) -> Int[np.ndarray, " F"] | None:
    """The last number in every name, None where one has none or they do not rise."""
    found = [re.findall(r"\d+", file.stem) for file in files]
    if not all(found):
        return None
    numbers = np.array([int(digits[-1][-18:]) for digits in found], dtype=np.int64)
    return numbers if (np.diff(numbers) > 0).all() else None


def _is_frame(file: Path) -> bool:
    return file.suffix.lower() in IMAGE_SUFFIXES and not file.name.startswith(".")
