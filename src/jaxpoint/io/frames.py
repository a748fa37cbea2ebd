"""What all recordings of one camera have in common, whether a video or a folder of images."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8

from jaxpoint.errors import FileFormatError
from jaxpoint.io.frame_names import NameColumn


class FrameSource(ABC):
    """Frames of one camera, 8-bit BGR as OpenCV orders colours. Open one with `open_frames`."""

    path: Path
    size: tuple[int, int]  # px, width and height
    frame_ids: Int[np.ndarray, " F"]  # number of the frame in the recording, strictly rising
    numbered: bool  # whether the frame numbers come from file names; else they are positions
    times: Float[np.ndarray, " F"] | None = None  # s from the first frame, where a video states them
    start: float = 0.0  # s, of the first frame on the clock of the video's container
    columns: tuple[NameColumn, ...] = ()  # numbers and times in file names that rise from file to file
    pixel_aspect: float | None = None  # width over height of a pixel, where the video states it

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
