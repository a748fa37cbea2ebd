"""A folder of images of one camera: their order, the numbers and times in their names, their depth."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Int, Num, UInt8

from jaxpoint.errors import FileFormatError
from jaxpoint.io.depth import full_scale, to_8_bits
from jaxpoint.io.frame_names import read_names
from jaxpoint.io.frames import FrameSource

IMAGE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".pgm", ".ppm", ".pnm"})
VIDEO_SUFFIXES = frozenset({".mp4", ".avi", ".mov", ".mkv", ".m4v", ".webm", ".mjpeg", ".mjpg"})
DEPTH_IMAGES = 101  # looked at for the depth of a recording
AS_STORED = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH


class ImageFolder(FrameSource):
    """A folder of images, in the order of the numbers in their names (`2.jpg` before `10.jpg`).

    `columns` holds the numbers and times in the names that rise from file to file; the frame number is the first of
    them, else the position. Images of more than 8 bits, all alike, are brought to 8 by what the recording holds.
    """

    def __init__(self, path: Path, chosen: Iterable[Path] | None = None):
        """The images of a folder, or those of one that are chosen."""
        self.path = path
        files = sorted(filter(_is_frame, path.iterdir() if chosen is None else chosen), key=_natural_key)
        if not files:
            raise FileFormatError(_without_images(path))
        _refuse_copies(files)
        names = read_names([file.stem for file in files], path)
        self.files = [files[place] for place in names.order]
        self.columns = names.columns
        counters = [column for column in names.columns if column.kind == "number"]
        self.numbered = bool(counters)
        self.frame_ids = counters[0].values if counters else np.arange(len(files))
        first = _decode(self.files[0])
        self.size = (first.shape[1], first.shape[0])
        self._kind = first.dtype
        self._white: float | None = 255.0 if first.dtype == np.uint8 else None

    @property
    def white(self) -> float:
        """The value that white has in the files; found when it is first needed, as it takes many images."""
        if self._white is None:
            sample = np.unique(np.linspace(0, len(self.files) - 1, DEPTH_IMAGES).astype(int))
            self._white = full_scale(image for image in map(self._sampled, sample.tolist()) if image is not None)
        return self._white

    @white.setter
    def white(self, value: float) -> None:
        self._white = value

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
        if image.dtype != self._kind:
            raise FileFormatError(
                f"'{self.files[index]}' holds {_depth(image.dtype)} but '{self.files[0].name}' {_depth(self._kind)}; "
                "keep one camera's images of one depth in a folder."
            )
        return to_8_bits(image, self.white)

    def stream(self, indices: Int[np.ndarray, " N"] | None = None) -> Iterator[tuple[int, UInt8[np.ndarray, "H W 3"]]]:
        for index in range(len(self)) if indices is None else indices:
            yield int(index), self.read(int(index))

    def readable(
        self, indices: Int[np.ndarray, " N"], lost: list[FileFormatError] | None = None
    ) -> Iterator[tuple[int, UInt8[np.ndarray, "H W 3"]]]:
        for index in indices:  # one bad file says nothing of those after it
            yield from super().readable(np.array([index]), lost)

    def _sampled(self, index: int) -> Num[np.ndarray, "..."] | None:
        """An image as stored; None where it cannot be decoded, which is said when it is read."""
        try:
            return _decode(self.files[index])
        except FileFormatError:
            return None


def _refuse_copies(files: list[Path]) -> None:
    """A frame that was stored in two formats would count as two."""
    first: dict[str, Path] = {}
    for file in files:
        other = first.setdefault(file.stem, file)
        if other is not file:
            raise FileFormatError(
                f"'{other}' and '{file.name}' are one frame in two formats; keep the images of one format there."
            )


def _without_images(path: Path) -> str:
    """What is said of a folder without images: it may be that of all cameras."""
    videos = [file for file in sorted(path.iterdir()) if file.suffix.lower() in VIDEO_SUFFIXES]
    folders = [folder for folder in sorted(path.iterdir()) if folder.is_dir() and any(map(_is_frame, folder.iterdir()))]
    for kind, inside in (("the video", videos), ("the folder of images", folders)):
        if inside:
            more = f" and {len(inside) - 1} more" if len(inside) > 1 else ""
            return (
                f"The folder '{path}' holds {kind} '{inside[0].name}'{more}, but no images; give these one by one, a "
                "camera each."
            )
    return f"The folder '{path}' holds no images; put the frames of one camera there as jpg, png, tif, bmp or pgm."


def share_white(*sources: FrameSource) -> None:
    """Bring several recordings of one camera, such as its empty room, to 8 bits alike."""
    folders = [source for source in sources if isinstance(source, ImageFolder)]
    white = max((folder.white for folder in folders), default=255.0)
    for folder in folders:
        folder.white = white


def read_grey(file: Path) -> UInt8[np.ndarray, "H W"]:
    """One image, such as a mask, as grey levels of 8 bits.

    Raises:
        FileFormatError: it cannot be decoded.
    """
    image = _decode(file)
    return np.asarray(cv2.cvtColor(to_8_bits(image, full_scale([image])), cv2.COLOR_BGR2GRAY))


def _decode(file: Path) -> Num[np.ndarray, "..."]:
    data = np.frombuffer(file.read_bytes(), dtype=np.uint8)
    image = cv2.imdecode(data, AS_STORED) if data.size else None
    if image is None:
        raise FileFormatError(f"The image '{file}' ({data.size} bytes) cannot be decoded; copy it anew or remove it.")
    if np.issubdtype(image.dtype, np.floating) and not np.isfinite(image).all():
        raise FileFormatError(
            f"The image '{file}' holds {np.count_nonzero(~np.isfinite(image))} non-finite values; write 0 there."
        )
    return np.asarray(image)


def _depth(kind: np.dtype[Any]) -> str:
    return f"{8 * kind.itemsize}-bit {'fractions' if np.issubdtype(kind, np.floating) else 'numbers'}"


def _natural_key(file: Path) -> list[tuple[int, int, str]]:
    parts = re.split(r"(\d+)", file.name.lower())
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts]


def _is_frame(file: Path) -> bool:
    return file.suffix.lower() in IMAGE_SUFFIXES and not file.name.startswith(".")
