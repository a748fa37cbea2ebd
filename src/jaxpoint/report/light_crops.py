"""Small crops of what was found and of what was rejected, for a person to look at."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import UInt8

from jaxpoint.detection.light.blob import Reason
from jaxpoint.detection.light.led import LedDetection
from jaxpoint.detection.light.mask import Mask, read_mask
from jaxpoint.io.video import FrameSource, open_frames

MARK = (255, 64, 64)  # RGB of the four ticks around a found position
TICK = (4.0, 7.0)  # px, where they begin and end: the light itself stays free
HIDDEN = (72, 40, 120)  # RGB of the stripes over what a mask hides
STRIPE = 8  # px from stripe to stripe
OVERVIEW = 480  # px, width of the picture of a mask
MAX_GAIN = 4.0  # dark crops are shown this much brighter at most


@dataclass(frozen=True)
class LightCrop:
    """One light, or what was taken for none, much enlarged."""

    reason: Reason
    frame_id: int
    image: UInt8[np.ndarray, "S S 3"]  # RGB; four ticks point at the position where one was found


def contact_sheet(
    detection: LedDetection, camera: int, per_reason: int = 6, radius: int = 12, zoom: int = 6
) -> list[LightCrop]:
    """A few crops of one camera for each reason that occurred, spread over the recording, in the order of `Reason`.

    Each shows (2 radius + 1) px of the image around the light or, where none was found, around the brightest place,
    enlarged `zoom` times without smoothing and brightened when dark; stripes lie over what the camera's mask hides.
    Reads the images anew.

    Raises:
        FileFormatError: an image can no longer be read.
    """
    source = open_frames(detection.sources[camera])
    mask = _mask(detection, camera, source)
    crops = []
    for reason in Reason:
        shown = detection.pairing.index[:, camera] >= 0  # others lie between two frames
        frames = np.flatnonzero(shown & (detection.reasons[:, camera] == reason))
        if reason == Reason.NO_IMAGE or not len(frames):
            continue
        for frame in frames[np.unique(np.linspace(0, len(frames) - 1, per_reason).astype(int))]:
            frame_id = int(detection.tracks.frame_ids[frame])
            image = source.read(int(detection.pairing.index[frame, camera]))
            pixel = detection.tracks.pixels[frame, camera] if reason == Reason.FOUND else None
            crop = _crop(image, mask, detection.brightest[frame, camera], pixel, radius, zoom)
            crops.append(LightCrop(reason, frame_id, crop))
    return crops


def mask_overview(detection: LedDetection, camera: int) -> UInt8[np.ndarray, "h w 3"] | None:
    """The first image of a camera (RGB), brightened, with stripes over what its mask hides; None without a mask.

    Raises:
        FileFormatError: the image or the mask can no longer be read.
    """
    source = open_frames(detection.sources[camera])
    mask = _mask(detection, camera, source)
    if mask is None:
        return None
    image = _brighten(source.read(0).astype(np.float32))
    striped = _stripe(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), mask)
    height = max(1, round(OVERVIEW * striped.shape[0] / striped.shape[1]))
    return np.asarray(cv2.resize(striped, (OVERVIEW, height), interpolation=cv2.INTER_AREA))


def _mask(detection: LedDetection, camera: int, source: FrameSource) -> Mask | None:
    file = detection.masks[camera]
    return None if file is None else read_mask(file, source.size)


def _brighten(image: np.ndarray) -> UInt8[np.ndarray, "h w 3"]:
    return np.clip(image * min(MAX_GAIN, 255.0 / max(float(image.max()), 1.0)), 0, 255).astype(np.uint8)


def _stripe(image: np.ndarray, mask: Mask) -> UInt8[np.ndarray, "h w 3"]:
    """The image with oblique stripes over what the mask hides."""
    rows, columns = np.indices(mask.shape)
    stripes = (rows + columns) % STRIPE < STRIPE // 2
    return np.where((~mask & stripes)[..., None], np.array(HIDDEN, dtype=np.uint8), image)


def _crop(
    image: UInt8[np.ndarray, "H W 3"],
    mask: Mask | None,
    middle: np.ndarray,
    pixel: np.ndarray | None,
    radius: int,
    zoom: int,
) -> UInt8[np.ndarray, "S S 3"]:
    padded = cv2.copyMakeBorder(image, radius, radius, radius, radius, cv2.BORDER_CONSTANT)
    x, y = (int(value) for value in middle)
    part = np.s_[y : y + 2 * radius + 1, x : x + 2 * radius + 1]
    crop = _brighten(np.asarray(padded)[part].astype(np.float32))
    large = cv2.resize(cv2.cvtColor(crop, cv2.COLOR_BGR2RGB), None, fx=zoom, fy=zoom, interpolation=cv2.INTER_NEAREST)
    if mask is not None:
        seen = np.kron(np.pad(mask, radius, constant_values=True)[part], np.ones((zoom, zoom), dtype=bool))
        large = _stripe(np.asarray(large), seen)
    if pixel is not None:
        # The centre of a pixel lies in the middle of its zoom x zoom square.
        place = (pixel - middle + radius + 0.5) * zoom - 0.5
        for direction in np.array([(1, 0), (-1, 0), (0, 1), (0, -1)]):
            ends = [np.round(place + direction * reach * zoom).astype(int).tolist() for reach in TICK]
            cv2.line(large, ends[0], ends[1], MARK, max(1, zoom // 3))
    return np.asarray(large)
