"""All frames of one camera, one after the other. Imports no jax, so that its processes start fast."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from jaxpoint.config import LedSettings
from jaxpoint.detection.background import Background, mean_background, median_background
from jaxpoint.detection.light.blob import Blob, Reason, find_blob
from jaxpoint.detection.light.mask import Mask, read_mask
from jaxpoint.detection.light.position import Positions, Spots, cut_patch, fit_positions, half_window, match_positions
from jaxpoint.detection.workers import Advance
from jaxpoint.errors import InsufficientDataError
from jaxpoint.io.video import FrameSource, open_frames

CHANNELS = {"green": 1, "red": 2, "blue": 0}  # place in OpenCV's order; the first named wins a tie
CHANNEL_FRAMES = 25
BACKGROUND_FRAMES = 151
BACKGROUND_BYTES = 256 * 2**20


@dataclass(frozen=True)
class CameraStats:
    """How the detection went in one camera."""

    channel: str  # colour in which the light was looked for
    frames: int
    found: int
    background_level: float  # grey levels, median over the image
    noise: float  # grey levels, median background deviation over the image
    brightness: float  # grey levels above the background, median over the found lights; 0 where none
    radius_px: float  # median standard deviation of the found spots; 0 with the thesis method
    sigma_px: float  # median standard deviation of a found coordinate
    seconds: float


@dataclass(frozen=True)
class CameraLights:
    """The light in the F frames of one camera."""

    size: tuple[int, int]  # px, width and height
    pixels: Float[np.ndarray, "F 2"]  # px, (0, 0) where not found
    covariance: Float[np.ndarray, "F 2 2"]  # px^2, zeros where not found
    reasons: Int[np.ndarray, " F"]  # values of `Reason`
    brightest: Int[np.ndarray, "F 2"]  # px, the brightest place of the frame, whether or not it is the light
    stats: CameraStats


def find_lights(settings: LedSettings, camera: tuple[Path, Path | None], advance: Advance) -> CameraLights:
    """Find the light in every frame of one camera.

    Args:
        settings: the method and its thresholds.
        camera: its recording, and the image of where to look, if any.
        advance: called with the frames done and to do.

    Raises:
        FileFormatError: the frames or the mask cannot be read.
        InsufficientDataError: fewer frames than `settings.min_frames`.
    """
    path, mask_file = camera
    started = time.perf_counter()
    source = open_frames(path)
    if len(source) < settings.min_frames:
        raise InsufficientDataError(
            f"'{path}' has {len(source)} frame{'s' * (len(source) != 1)}, but a background is learnt from at least "
            f"{settings.min_frames}; record longer, or lower --min-frames."
        )
    mask = None if mask_file is None else read_mask(mask_file, source.size)
    channel = _strongest_channel(source, mask) if settings.channel == "auto" else settings.channel
    samples = _background_frames(source, settings)
    total = len(samples) + len(source)
    learnt = (_take(image, channel) for _, image in _counted(source, samples, lambda done: advance(done, total)))
    background = mean_background(learnt) if settings.method == "thesis" else median_background(np.stack(list(learnt)))
    watched = _counted(source, None, lambda done: advance(len(samples) + done, total))
    reasons, brightest, spots = _find_spots(watched, len(source), channel, background, mask, settings)
    measure = match_positions if settings.method == "thesis" else fit_positions
    positions = measure(spots, settings)
    candidates = reasons == Reason.FOUND
    reasons[candidates] = positions.reasons
    found = positions.reasons == Reason.FOUND
    pixels, covariance = np.zeros((len(source), 2)), np.zeros((len(source), 2, 2))
    pixels[reasons == Reason.FOUND] = positions.pixels[found]
    covariance[reasons == Reason.FOUND] = positions.covariance[found]
    stats = _summarise(positions, background, channel, len(source), time.perf_counter() - started)
    return CameraLights(source.size, pixels, covariance, reasons, brightest, stats)


def _find_spots(
    frames: Iterator[tuple[int, UInt8[np.ndarray, "H W 3"]]],
    count: int,
    channel: str,
    background: Background,
    mask: Mask | None,
    settings: LedSettings,
) -> tuple[Int[np.ndarray, " F"], Int[np.ndarray, "F 2"], Spots]:
    """Reasons and brightest places of all frames, and what surrounds the candidates (reason FOUND so far)."""
    half = half_window(settings)
    reasons = np.full(count, Reason.NO_IMAGE, dtype=np.int8)
    brightest = np.zeros((count, 2), dtype=np.int32)
    patches, usable, noise = [], [], []
    for index, image in frames:
        grey = _take(image, channel)
        difference = np.maximum(grey - background.level, 0)
        if mask is not None:
            difference[~mask] = 0
        blob: Blob = find_blob(difference, background.deviation, settings)
        if mask is not None and blob.reason == Reason.FOUND and _at_edge(mask, blob):
            blob = replace(blob, reason=Reason.AT_BORDER)
        reasons[index] = blob.reason
        brightest[index] = blob.x, blob.y
        if blob.reason == Reason.FOUND:
            patch, good = cut_patch(grey, background.level, blob, half, mask)
            patches.append(patch)
            usable.append(good)
            noise.append(background.deviation[blob.y, blob.x])
    shape = (len(patches), 2 * half + 1, 2 * half + 1)
    spots = Spots(
        pixel=brightest[reasons == Reason.FOUND],
        patches=np.reshape(patches, shape).astype(np.float32),
        usable=np.reshape(usable, shape).astype(bool),
        noise=np.array(noise, dtype=np.float64),
    )
    return reasons, brightest, spots


def _at_edge(mask: Mask, blob: Blob) -> bool:
    """Whether a masked pixel touches the brightest one: the light, or a masked reflection's glow, is cut there."""
    around = np.s_[max(blob.y - 1, 0) : blob.y + 2, max(blob.x - 1, 0) : blob.x + 2]
    return not mask[around].all()


def _summarise(positions: Positions, background: Background, channel: str, frames: int, seconds: float) -> CameraStats:
    found = positions.reasons == Reason.FOUND
    deviations = np.sqrt(np.trace(positions.covariance[found], axis1=1, axis2=2) / 2)

    def median(values: np.ndarray) -> float:
        return float(np.median(values)) if len(values) else 0.0

    return CameraStats(
        channel=channel,
        frames=frames,
        found=int(found.sum()),
        background_level=float(np.median(background.level)),
        noise=float(np.median(background.deviation)),
        brightness=median(positions.brightness[found]),
        radius_px=median(positions.radius[found]),
        sigma_px=median(deviations),
        seconds=seconds,
    )


def _counted(
    source: FrameSource, indices: np.ndarray | None, advance: Callable[[int], None]
) -> Iterator[tuple[int, UInt8[np.ndarray, "H W 3"]]]:
    for done, frame in enumerate(source.stream(indices), start=1):
        yield frame
        advance(done)


def _take(image: UInt8[np.ndarray, "H W 3"], channel: str) -> UInt8[np.ndarray, "H W"]:
    if channel == "grey":
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
    return np.asarray(cv2.extractChannel(image, CHANNELS[channel]))


def _strongest_channel(source: FrameSource, mask: Mask | None) -> str:
    """The colour that rises most above its median at the brightest places of a few frames, where they are looked at."""
    images = np.stack([source.read(int(index)) for index in _spread(len(source), CHANNEL_FRAMES)])
    middle = (len(images) - 1) // 2
    level = np.partition(images, middle, axis=0)[middle]
    rise = np.zeros(3)
    for image in images:
        difference = np.asarray(cv2.subtract(image, level))
        if mask is not None:
            difference[~mask] = 0
        y, x = np.unravel_index(int(difference.max(axis=2).argmax()), difference.shape[:2])
        rise += difference[y, x]
    return max(CHANNELS, key=lambda name: rise[CHANNELS[name]])


def _background_frames(source: FrameSource, settings: LedSettings) -> Int[np.ndarray, " N"]:
    """All for the thesis's one-pass mean; for the median as many, well spread, as fit in memory."""
    if settings.method == "thesis":
        return np.arange(len(source))
    fitting = BACKGROUND_BYTES // (source.size[0] * source.size[1])
    return _spread(len(source), max(31, min(BACKGROUND_FRAMES, fitting)))


def _spread(frames: int, count: int) -> Int[np.ndarray, " N"]:
    return np.unique(np.linspace(0, frames - 1, min(count, frames)).astype(int))
