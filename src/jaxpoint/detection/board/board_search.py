"""Find one board in the images of one or several cameras: images to tracks of its corners."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from jaxpoint.detection.board.abstract_board import AbstractBoard, BoardCorners, BoardReason, corner_spacing_px
from jaxpoint.detection.workers import cores
from jaxpoint.errors import InsufficientDataError
from jaxpoint.io.board_sources import BoardSources
from jaxpoint.io.frames import FrameSource
from jaxpoint.io.pairing import Pairing
from jaxpoint.tracks import Tracks

BLURRED = 0.45  # of the spacing of corners: softer edges hide where a corner is
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class BoardDetection:
    """Where the board was found, and why it was not."""

    board: AbstractBoard
    tracks: Tracks  # of the corners, one row for each corner in each frame in which any camera saw the board
    frame_ids: Int[np.ndarray, " F"]  # of all frames that were looked at
    reasons: Int[np.ndarray, "F C"]  # values of `BoardReason`
    edges_px: Float[np.ndarray, "F C"]  # softness of edges; NaN where the board was not found
    mirrored: Bool[np.ndarray, "F C"]
    sources: BoardSources
    seconds: float

    @property
    def names(self) -> tuple[str, ...]:
        """Of the cameras."""
        return self.tracks.names

    def image(self, frame_id: int, camera: int) -> UInt8[np.ndarray, "H W 3"]:
        """An image of the recording (blue, green, red)."""
        place = int(np.searchsorted(self.sources.pairing.frame_ids, frame_id))
        return self.sources.frames[camera].read(int(self.sources.pairing.index[place, camera]))


def detect_board(
    sources: BoardSources, board: AbstractBoard, *, every: int = 0, progress: Progress | None = None
) -> BoardDetection:
    """Find the board in every frame of every camera; images side by side on all cores.

    Args:
        sources: what `open_board_sources` gives.
        board: what to look for.
        every: look at every so many frames; 0 takes all images of folders, and of videos at most 300 frames.
        progress: called with (camera, done, total).

    Raises:
        FileFormatError: an image cannot be read.
        InsufficientDataError: no camera shows the board in any frame.
    """
    started = time.perf_counter()
    chosen = sources.spread(every)
    pairing = sources.pairing
    shape = len(chosen), len(sources.frames)
    reasons = np.full(shape, BoardReason.NO_IMAGE, dtype=np.int8)
    edges, mirrored = np.full(shape, np.nan), np.zeros(shape, bool)
    pixels = np.full((shape[0], len(board.target.points), shape[1], 2), np.nan)
    for camera, (name, source) in enumerate(zip(sources.names, sources.frames)):
        shown = np.flatnonzero(pairing.index[chosen, camera] >= 0)
        places = pairing.index[chosen[shown], camera]
        for done, (row, found) in enumerate(zip(shown, _find_all(source, places, board))):
            reasons[row, camera] = _reason(found)
            if found is not None:
                edges[row, camera], mirrored[row, camera] = found.edge_px, found.mirrored
            if found is not None and reasons[row, camera] == BoardReason.FOUND:
                pixels[row, found.ids, camera] = found.pixels
            if progress:
                progress(name, done + 1, len(shown))
    if not (reasons == BoardReason.FOUND).any():
        raise InsufficientDataError(_nothing(board, reasons))
    tracks = _tracks(pixels, sources, pairing, chosen, board)
    ids = pairing.frame_ids[chosen]
    return BoardDetection(board, tracks, ids, reasons, edges, mirrored, sources, time.perf_counter() - started)


def _find_all(
    source: FrameSource, places: Int[np.ndarray, " N"], board: AbstractBoard
) -> Iterator[BoardCorners | None]:
    """What is found in each image, in order; a few images wait in memory at most."""
    threads = cores()
    waiting: deque[Future[BoardCorners | None]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        for _, image in source.stream(places):
            waiting.append(pool.submit(_find, board, image))
            if len(waiting) > 2 * threads:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


def _find(board: AbstractBoard, image: UInt8[np.ndarray, "H W 3"]) -> BoardCorners | None:
    return board.find(np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)))


def _reason(found: BoardCorners | None) -> BoardReason:
    if found is None:
        return BoardReason.NOT_FOUND
    return BoardReason.BLURRED if found.edge_px > BLURRED * corner_spacing_px(found.pixels) else BoardReason.FOUND


def _nothing(board: AbstractBoard, reasons: Int[np.ndarray, "F C"]) -> str:
    images = int((reasons != BoardReason.NO_IMAGE).sum())
    blurred = int((reasons == BoardReason.BLURRED).sum())
    soft = f", and was too blurred in {blurred}" if blurred else ""
    return (
        f"The board {board.spec} was found in 0 of {images} images{soft}; check how its sides are counted, hold all of "
        "it in view and still, and light it evenly."
    )


def _tracks(
    pixels: Float[np.ndarray, "F K C 2"],
    sources: BoardSources,
    pairing: Pairing,
    chosen: Int[np.ndarray, " F"],
    board: AbstractBoard,
) -> Tracks:
    frame, point = np.nonzero(np.isfinite(pixels).any(axis=(2, 3)))
    return Tracks.from_pixels(
        pixels[frame, point],
        np.array([source.size for source in sources.frames]),
        frame_ids=pairing.frame_ids[chosen][frame],
        times=None if pairing.times is None else pairing.times[chosen][frame],
        names=sources.names,
        point_ids=point,
        target=board.target,
    )


def notes_of(detection: BoardDetection) -> tuple[str, ...]:
    """What a user should know of the boards that were found, a sentence each."""
    notes: list[str] = list(detection.sources.pairing.notes)
    found = detection.reasons == BoardReason.FOUND
    for camera, name in enumerate(detection.names):
        mirrored = int((detection.mirrored & found)[:, camera].sum())
        if mirrored:
            notes.append(
                f"The images of camera '{name}' are mirrored ({mirrored} of {int(found[:, camera].sum())} with the "
                "board); switch the mirroring off, or no other camera will agree with it."
            )
    if detection.board.ambiguous and len(detection.names) > 1:
        notes.append(
            f"The board {detection.board.spec} looks the same turned by 180 degrees, and only all views together tell "
            "which end is which; a board with an odd and an even side leaves no doubt."
        )
    return tuple(notes)


def counts_of(detection: BoardDetection, camera: int) -> dict[str, int]:
    """How often each reason occurred in one camera, without zeros."""
    found = np.bincount(detection.reasons[:, camera], minlength=len(BoardReason))
    return {reason.name.lower(): int(found[reason]) for reason in BoardReason if found[reason]}
