"""Small crops of what was found and of what was rejected, for a person to look at."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import UInt8

from jaxpoint.detect.blob import Reason
from jaxpoint.detect.led import LedDetection
from jaxpoint.io.video import open_frames

MARK = (255, 64, 64)  # RGB of the four ticks around a found position
TICK = (4.0, 7.0)  # px, where they begin and end: the light itself stays free
MAX_GAIN = 4.0  # dark crops are shown this much brighter at most


@dataclass(frozen=True)
class Crop:
    """One light, or what was taken for none, much enlarged."""

    reason: Reason
    frame_id: int
    image: UInt8[np.ndarray, "S S 3"]  # RGB; four ticks point at the position where one was found


def contact_sheet(
    detection: LedDetection, camera: int, per_reason: int = 6, radius: int = 12, zoom: int = 6
) -> list[Crop]:
    """A few crops of one camera for each reason that occurred, spread over the recording, in the order of `Reason`.

    Each shows (2 radius + 1) px of the image around the light or, where none was found, around the brightest place,
    enlarged `zoom` times without smoothing and brightened when dark. Reads the images anew.

    Raises:
        FileFormatError: an image can no longer be read.
    """
    source = open_frames(detection.sources[camera])
    places = {int(frame_id): place for place, frame_id in enumerate(source.frame_ids)}
    crops = []
    for reason in Reason:
        frames = np.flatnonzero(detection.reasons[:, camera] == reason)
        if reason == Reason.NO_IMAGE or not len(frames):
            continue
        for frame in frames[np.unique(np.linspace(0, len(frames) - 1, per_reason).astype(int))]:
            frame_id = int(detection.tracks.frame_ids[frame])
            image = source.read(places[frame_id])
            pixel = detection.tracks.pixels[frame, camera] if reason == Reason.FOUND else None
            crop = _crop(image, detection.brightest[frame, camera], pixel, radius, zoom)
            crops.append(Crop(reason, frame_id, crop))
    return crops


def _crop(
    image: UInt8[np.ndarray, "H W 3"], middle: np.ndarray, pixel: np.ndarray | None, radius: int, zoom: int
) -> UInt8[np.ndarray, "S S 3"]:
    padded = cv2.copyMakeBorder(image, radius, radius, radius, radius, cv2.BORDER_CONSTANT)
    x, y = (int(value) for value in middle)
    crop = np.asarray(padded)[y : y + 2 * radius + 1, x : x + 2 * radius + 1].astype(np.float32)
    crop = np.clip(crop * min(MAX_GAIN, 255.0 / max(float(crop.max()), 1.0)), 0, 255).astype(np.uint8)
    large = cv2.resize(cv2.cvtColor(crop, cv2.COLOR_BGR2RGB), None, fx=zoom, fy=zoom, interpolation=cv2.INTER_NEAREST)
    if pixel is not None:
        # The centre of a pixel lies in the middle of its zoom x zoom square.
        place = (pixel - middle + radius + 0.5) * zoom - 0.5
        for direction in np.array([(1, 0), (-1, 0), (0, 1), (0, -1)]):
            ends = [np.round(place + direction * reach * zoom).astype(int).tolist() for reach in TICK]
            cv2.line(large, ends[0], ends[1], MARK, max(1, zoom // 3))
    return np.asarray(large)
