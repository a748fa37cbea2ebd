"""Pictures of boards: what was found, drawn into the images."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from jaxpoint.detection.board.abstract_board import BoardReason
from jaxpoint.detection.board.board_search import BoardDetection, counts_of

WIDTH, PER_REASON = 420, 4
FOUND, FIRST = (60, 200, 90), (240, 160, 30)  # RGB


def board_strips(detection: BoardDetection) -> list[tuple[str, UInt8[np.ndarray, "H W 3"]]]:
    """One row of pictures, with its caption, for each camera and reason."""
    strips = []
    for camera, name in enumerate(detection.names):
        for reason in (BoardReason.FOUND, BoardReason.BLURRED, BoardReason.NOT_FOUND):
            rows = np.flatnonzero(detection.reasons[:, camera] == reason)
            if not len(rows):
                continue
            some = rows[np.unique(np.linspace(0, len(rows) - 1, PER_REASON).astype(int))]
            frames = detection.frame_ids[some].tolist()
            pictures = [board_picture(detection, frame, camera) for frame in frames]
            count = counts_of(detection, camera)[reason.name.lower()]
            what = {"found": "board found", "blurred": "too blurred", "not_found": "no board found"}[
                reason.name.lower()
            ]
            caption = f"{name}: {what} in {count} frames, such as {', '.join(map(str, frames))}"
            strips.append((caption, np.concatenate(pictures, axis=1)))
    return strips


def board_picture(
    detection: BoardDetection, frame_id: int, camera: int, width: int = WIDTH
) -> UInt8[np.ndarray, "H W 3"]:
    """The image, RGB, with the corners along the order of their ids; the first is orange."""
    image = detection.image(frame_id, camera)
    scale = width / image.shape[1]
    picture = cv2.cvtColor(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2RGB)
    pixels, seen = corners_of(detection, frame_id, camera)
    return draw_corners(np.asarray(picture), (pixels + 0.5) * scale - 0.5, seen)


def corners_of(
    detection: BoardDetection, frame_id: int, camera: int
) -> tuple[Float[np.ndarray, "K 2"], Bool[np.ndarray, " K"]]:
    """Pixels of the board's corners by id, and which were seen."""
    tracks, count = detection.tracks, len(detection.board.target.points)
    rows = np.flatnonzero((tracks.frame_ids == frame_id) & tracks.visible[:, camera])
    assert tracks.point_ids is not None
    pixels, seen = np.zeros((count, 2)), np.zeros(count, bool)
    pixels[tracks.point_ids[rows]], seen[tracks.point_ids[rows]] = tracks.pixels[rows, camera], True
    return pixels, seen


def draw_corners(
    picture: UInt8[np.ndarray, "H W 3"], pixels: Float[np.ndarray, "K 2"], seen: Bool[np.ndarray, " K"]
) -> UInt8[np.ndarray, "H W 3"]:
    """Rings at the corners and a line along their order."""
    points = np.rint(16 * pixels[seen]).astype(np.int32)  # in sixteenths of a pixel
    cv2.polylines(picture, [points[:, None]], False, FOUND, 1, cv2.LINE_AA, 4)
    for number, (x, y) in enumerate(points.tolist()):
        cv2.circle(picture, (x, y), 16 * 4, FIRST if number == 0 else FOUND, 1 + (number == 0), cv2.LINE_AA, 4)
    return picture
