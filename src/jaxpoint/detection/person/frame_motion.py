"""When something moves before a camera, so that idle video is skipped (thesis 6.2.1)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Int, UInt8

from jaxpoint.config.person import MotionSettings
from jaxpoint.detection.colour import Image, shrink_of, shrunk
from jaxpoint.errors import InsufficientDataError


@dataclass(frozen=True)
class FrameMotion:
    """What changed between two successive images of a camera."""

    edges: int  # edge pixels of the difference; the thesis's "histogram" of a Canny image is this count
    changed: float  # 0..1, part of the pixels whose Y changed
    is_light_switch: bool  # many changed, nearly all of them in the same direction


def motion_between(previous: Image, image: Image, settings: MotionSettings) -> FrameMotion:
    """Edges in the sum of the absolute differences of Y, Cr and Cb.

    Raises:
        ValueError: the images are of different sizes.
    """
    if previous.shape != image.shape:
        raise ValueError(f"Images of {previous.shape[1::-1]} and {image.shape[1::-1]} px cannot be compared.")
    return motion_of(motion_image(previous, settings), motion_image(image, settings), settings)


def motion_image(image: Image, settings: MotionSettings) -> UInt8[np.ndarray, "h w 3"]:
    """What `motion_of` compares: the image at its size, as Y, Cr, Cb."""
    return cv2.cvtColor(shrunk(image, shrink_of(image.shape[1], settings.width_px)), cv2.COLOR_BGR2YCrCb)


def motion_of(
    before: UInt8[np.ndarray, "h w 3"], after: UInt8[np.ndarray, "h w 3"], settings: MotionSettings
) -> FrameMotion:
    """As `motion_between`, of what `motion_image` made of both: successive pairs share an image."""
    y, cr, cb = cv2.split(cv2.absdiff(before, after))
    total = cv2.add(cv2.add(y, cr), cb)  # 0..765 saturates at 255, far above both thresholds of the edges
    edges = cv2.countNonZero(cv2.Canny(total, settings.canny_low, settings.canny_high))
    changed = cv2.countNonZero(cv2.threshold(y, settings.switch_levels, 255, cv2.THRESH_BINARY)[1]) / y.size
    is_switch = changed > settings.switch_fraction and _of_one_sign(before, after, settings)
    return FrameMotion(edges, changed, is_switch)


def learn_threshold(counts: Int[np.ndarray, " N"], settings: MotionSettings) -> float:
    """Edge pixels above which something moves, from the counts of the empty room: mean and `deviations` deviations.

    Raises:
        InsufficientDataError: fewer than `min_pairs` counts.
    """
    if len(counts) < settings.min_pairs:
        raise InsufficientDataError(
            f"The threshold of motion is learnt from at least {settings.min_pairs} pairs of images of the empty room, "
            f"and there are {len(counts)}; record it for longer, or lower `motion.min_pairs`."
        )
    learnt = np.mean(counts) + settings.deviations * np.std(counts)
    return float(max(learnt, settings.floor_px))


def intervals(above: Bool[np.ndarray, " N"], settings: MotionSettings) -> list[tuple[int, int]]:
    """First and last frame of every stretch of motion.

    One begins with `frames_on` frames above the threshold in a row and ends with the last one before `frames_off`
    below it in a row.
    """
    found: list[tuple[int, int]] = []
    first = last = None
    run = 0
    for frame, is_above in enumerate(above):
        run = run + 1 if is_above else 0
        if first is None and run >= max(settings.frames_on, 1):
            first = frame - run + 1
        if is_above:
            last = frame
        if first is not None and last is not None and frame - last >= max(settings.frames_off, 1):
            found.append((first, last))
            first = None
    if first is not None and last is not None:
        found.append((first, last))
    return found


def _of_one_sign(
    before: UInt8[np.ndarray, "h w 3"], after: UInt8[np.ndarray, "h w 3"], settings: MotionSettings
) -> bool:
    step = after[..., 0].astype(np.int16) - before[..., 0]
    up, down = np.count_nonzero(step > settings.switch_levels), np.count_nonzero(step < -settings.switch_levels)
    return bool(max(up, down) >= settings.switch_one_sign * (up + down))
