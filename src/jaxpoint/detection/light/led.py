"""Find one small light in the images of several cameras (thesis 5.3.1): images to tracks, cameras in parallel."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from jaxpoint.config import LedSettings
from jaxpoint.detection.light.blob import Reason
from jaxpoint.detection.light.camera_scan import CameraLights, CameraStats, find_lights
from jaxpoint.detection.light.mask import FOLDER as MASK_FOLDER
from jaxpoint.detection.light.mask import mask_files, read_mask
from jaxpoint.detection.light.retime import retime
from jaxpoint.detection.workers import run_cameras
from jaxpoint.errors import UsageError
from jaxpoint.io.frames import FrameSource
from jaxpoint.io.pairing import Pairing, pair_by_ids, pair_frames
from jaxpoint.io.video import open_frames
from jaxpoint.tracks import Tracks

__all__ = ["CameraStats", "DetectionInterrupted", "LedDetection", "Reason", "detect_led"]

OWN_NUMBERS = "the numbers that each recording counts for itself (--unequal-lengths)"

Progress = Callable[[str, int, int], None]
"""Called with a camera's name, the frames done and the frames to do (learning the background counts too)."""


@dataclass(frozen=True)
class LedDetection:
    """Where the light was found, why it was not, and how sure its position is."""

    tracks: Tracks
    reasons: Int[np.ndarray, "F C"]  # values of `Reason`; FOUND where visible
    covariance: Float[np.ndarray, "F C 2 2"]  # px^2, zeros where not found
    brightest: Int[np.ndarray, "F C 2"]  # px, brightest place of each image, whether or not it is the light
    cameras: tuple[CameraStats, ...]
    sources: tuple[Path, ...]
    masks: tuple[Path | None, ...]  # image of where a camera was looked at; None where all over
    pairing: Pairing  # which frame of each camera is in which row
    seconds: float

    def counts(self, camera: int) -> dict[Reason, int]:
        """How often each reason occurred in one camera, in the order of `Reason`, without zeros."""
        found = np.bincount(self.reasons[:, camera], minlength=len(Reason))
        return {reason: int(found[reason]) for reason in Reason if found[reason]}


class DetectionInterrupted(KeyboardInterrupt):
    """Ctrl-C during detection; `finished` holds the cameras that were complete."""

    def __init__(self, finished: LedDetection, cameras: int):
        super().__init__(f"{finished.tracks.cameras} of {cameras} cameras were finished.")
        self.finished = finished


def detect_led(
    sources: Sequence[str | Path],
    settings: LedSettings | None = None,
    progress: Progress | None = None,
    names: Sequence[str] = (),
) -> LedDetection:
    """Find the light in every frame of every camera.

    Deterministic: the same images and settings give the same result, whatever the number of processes. Processes are
    spawned, so a script must call this under `if __name__ == "__main__":` (or with `workers=1`).

    Args:
        sources: a video or a folder of images for each camera, all of the same moments. Frames belong together by
            the number or time in the images' names that rises from file to file, or by the videos' time stamps.
        settings: the method and its thresholds; the defaults suit a bright light in a dimmed room.
        progress: called in this process with (camera, done, total).
        names: of the cameras; by default the names of folders and files, as much of the path as tells them apart.

    Raises:
        UsageError: no sources, one given twice, names that do not fit, or masks of no camera.
        FileFormatError: frames or masks that cannot be read.
        InsufficientDataError: too few frames, or cameras whose frames cannot be paired.
        DetectionInterrupted: Ctrl-C after at least one camera was complete (a KeyboardInterrupt; it is also the plain
            one when none was).
    """
    started = time.perf_counter()
    settings = settings or LedSettings()
    paths = [Path(source) for source in sources]
    names = tuple(names) or camera_names(paths)
    _check_sources(paths, names)
    sources_ = [open_frames(path) for path in paths]
    pairing = _pair(sources_, names, settings)
    masks = mask_files(settings.masks, paths, names)
    for mask, source in zip(masks, sources_):
        if mask is not None:
            read_mask(mask, source.size)  # a wrong one is refused before the work
    whole = _Recording(tuple(paths), names, tuple(sources_), masks, pairing)
    finished: dict[int, CameraLights] = {}

    def report(camera: int, done: int, total: int) -> None:
        if progress:
            progress(names[camera], done, total)

    try:
        run_cameras(partial(find_lights, settings), list(zip(paths, masks)), settings.workers, finished, report)
    except KeyboardInterrupt:
        if not finished:
            raise
        kept = sorted(finished)
        found = _assemble(whole.select(kept), [finished[i] for i in kept], started)
        raise DetectionInterrupted(found, len(paths)) from None
    return _assemble(whole, [finished[i] for i in range(len(paths))], started)


@dataclass(frozen=True)
class _Recording:
    """What is known of C cameras before anybody looks for the light."""

    paths: tuple[Path, ...]
    names: tuple[str, ...]
    sources: tuple[FrameSource, ...]
    masks: tuple[Path | None, ...]
    pairing: Pairing

    def select(self, cameras: Sequence[int]) -> _Recording:
        """Some of the cameras."""
        return _Recording(
            tuple(self.paths[i] for i in cameras),
            tuple(self.names[i] for i in cameras),
            tuple(self.sources[i] for i in cameras),
            tuple(self.masks[i] for i in cameras),
            self.pairing.select(cameras),
        )


def _pair(sources: Sequence[FrameSource], names: Sequence[str], settings: LedSettings) -> Pairing:
    if settings.unequal_lengths:
        return pair_by_ids(sources, OWN_NUMBERS)
    return pair_frames(sources, names, settings.pair_by)


def camera_names(paths: Sequence[Path]) -> tuple[str, ...]:
    """Names of folders (or files without suffix), with as many parents as it takes to tell them apart."""
    parts = [[*path.absolute().parts[1:-1], path.name if path.is_dir() else path.stem] for path in paths]
    for depth in range(1, max((len(part) for part in parts), default=1) + 1):
        names = tuple("_".join(part[-depth:]) for part in parts)
        if len(set(names)) == len(names):
            return names
    return tuple(f"cam_{i}" for i in range(len(paths)))


def _check_sources(paths: Sequence[Path], names: Sequence[str]) -> None:
    if not paths:
        raise UsageError("No camera was given; name one folder of images or one video a camera.")
    resolved = [path.resolve() for path in paths]
    for i, path in enumerate(resolved):
        if path in resolved[:i]:
            raise UsageError(f"'{paths[i]}' is given twice; name one folder or video a camera.")
        if path.name == MASK_FOLDER and path.is_dir() and len(paths) > 1:
            raise UsageError(
                f"'{paths[i]}' holds masks, not frames of a camera; leave it out; masks beside the cameras are found."
            )
    if len(names) != len(paths) or len(set(names)) != len(names):
        raise UsageError(f"{len(paths)} cameras need {len(paths)} different names, not {list(names)}.")


def _assemble(recording: _Recording, lights: Sequence[CameraLights], started: float) -> LedDetection:
    """One row for every moment of which any camera has a frame."""
    pairing = recording.pairing
    shape = pairing.index.shape
    pixels, covariance = np.zeros((*shape, 2)), np.zeros((*shape, 2, 2))
    reasons = np.full(shape, Reason.NO_IMAGE, dtype=np.int8)
    brightest = np.zeros((*shape, 2), dtype=np.int32)
    for camera, light in enumerate(lights):
        rows = np.flatnonzero(pairing.index[:, camera] >= 0)
        frames = pairing.index[rows, camera]
        pixels[rows, camera], covariance[rows, camera] = light.pixels[frames], light.covariance[frames]
        reasons[rows, camera], brightest[rows, camera] = light.reasons[frames], light.brightest[frames]
        _retime(pairing, camera, light, pixels, covariance, reasons)
    tracks = Tracks.from_pixels(
        pixels,
        image_sizes=np.array([light.size for light in lights]),
        visible=reasons == Reason.FOUND,
        frame_ids=pairing.frame_ids,
        times=pairing.times,
        names=recording.names,
        pixel_aspects=_pixel_aspects(recording.sources),
    )
    stats = tuple(light.stats for light in lights)
    seconds = time.perf_counter() - started
    return LedDetection(
        tracks, reasons, covariance, brightest, stats, recording.paths, recording.masks, pairing, seconds
    )


def _retime(
    pairing: Pairing,
    camera: int,
    light: CameraLights,
    pixels: Float[np.ndarray, "F C 2"],
    covariance: Float[np.ndarray, "F C 2 2"],
    reasons: Int[np.ndarray, "F C"],
) -> None:
    """Bring the lights of a camera of another rate to the times of the rows, in place."""
    if not pairing.places or pairing.other_rate is None or not pairing.other_rate[camera]:
        return
    found = light.reasons == Reason.FOUND
    moved = retime(pairing.frame_ids, pairing.places[camera], light.pixels, light.covariance, found)
    lost = (reasons[:, camera] == Reason.FOUND) & ~moved.known
    pixels[:, camera], covariance[:, camera] = moved.pixels, moved.covariance
    reasons[moved.known, camera], reasons[lost, camera] = Reason.FOUND, Reason.BETWEEN


def _pixel_aspects(sources: Sequence[FrameSource]) -> Float[np.ndarray, " C"] | None:
    """Width over height of each camera's pixels, 1 where only other videos state one; None where none does."""
    stated = [source.pixel_aspect for source in sources]
    if all(aspect is None for aspect in stated):
        return None
    return np.array([1.0 if aspect is None else aspect for aspect in stated])
