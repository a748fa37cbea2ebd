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
from jaxpoint.detect.blob import Reason
from jaxpoint.detect.camera import CameraLights, CameraStats, find_lights
from jaxpoint.detect.workers import run_cameras
from jaxpoint.errors import InsufficientDataError, UsageError
from jaxpoint.tracks import Tracks

__all__ = ["CameraStats", "DetectionInterrupted", "LedDetection", "Reason", "detect_led"]

COUNT_TOLERANCE = 0.01  # of the frames; recorders drop a frame or two at the end
TIME_TOLERANCE = 1e-3  # s

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
            their number: the last number in an image's name, the position in a video.
        settings: the method and its thresholds; the defaults suit a bright light in a dimmed room.
        progress: called in this process with (camera, done, total).
        names: of the cameras; by default the names of folders and files, as much of the path as tells them apart.

    Raises:
        UsageError: no sources, one given twice, or names that do not fit.
        FileFormatError: frames that cannot be read.
        InsufficientDataError: too few frames, or cameras whose frame numbers do not belong together.
        DetectionInterrupted: Ctrl-C after at least one camera was complete (a KeyboardInterrupt; it is also the plain
            one when none was).
    """
    started = time.perf_counter()
    settings = settings or LedSettings()
    paths = [Path(source) for source in sources]
    names = tuple(names) or camera_names(paths)
    _check_sources(paths, names)
    finished: dict[int, CameraLights] = {}

    def report(camera: int, done: int, total: int) -> None:
        if progress:
            progress(names[camera], done, total)

    try:
        run_cameras(partial(find_lights, settings), paths, settings.workers, finished, report)
    except KeyboardInterrupt:
        if not finished:
            raise
        kept = sorted(finished)
        lights = [finished[i] for i in kept]
        found = _assemble([paths[i] for i in kept], [names[i] for i in kept], lights, settings, started)
        raise DetectionInterrupted(found, len(paths)) from None
    return _assemble(paths, names, [finished[i] for i in range(len(paths))], settings, started)


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
    if len(names) != len(paths) or len(set(names)) != len(names):
        raise UsageError(f"{len(paths)} cameras need {len(paths)} different names, not {list(names)}.")


def _assemble(
    paths: Sequence[Path],
    names: Sequence[str],
    lights: Sequence[CameraLights],
    settings: LedSettings,
    started: float,
) -> LedDetection:
    """One row for every frame number that any camera has."""
    _check_counts(names, lights, settings.unequal_lengths)
    frame_ids = np.unique(np.concatenate([light.frame_ids for light in lights]))
    shape = (len(frame_ids), len(lights))
    pixels, covariance = np.zeros((*shape, 2)), np.zeros((*shape, 2, 2))
    reasons = np.full(shape, Reason.NO_IMAGE, dtype=np.int8)
    brightest = np.zeros((*shape, 2), dtype=np.int32)
    for camera, light in enumerate(lights):
        rows = np.searchsorted(frame_ids, light.frame_ids)
        pixels[rows, camera], covariance[rows, camera] = light.pixels, light.covariance
        reasons[rows, camera], brightest[rows, camera] = light.reasons, light.brightest
    tracks = Tracks.from_pixels(
        pixels,
        image_sizes=np.array([light.size for light in lights]),
        visible=reasons == Reason.FOUND,
        frame_ids=frame_ids,
        times=_common_times(frame_ids, lights),
        names=names,
    )
    stats = tuple(light.stats for light in lights)
    return LedDetection(tracks, reasons, covariance, brightest, stats, tuple(paths), time.perf_counter() - started)


def _check_counts(names: Sequence[str], lights: Sequence[CameraLights], any_length: bool) -> None:
    """Videos are matched by position, which needs equal lengths; image numbers must overlap."""
    first = lights[0]
    for name, light in zip(names, lights):
        shared = len(np.intersect1d(first.frame_ids, light.frame_ids))
        if not shared:
            raise InsufficientDataError(
                f"Cameras '{names[0]}' and '{name}' have no frame number in common ({first.frame_ids[0]} to "
                f"{first.frame_ids[-1]}, and {light.frame_ids[0]} to {light.frame_ids[-1]}); number the images of all "
                "cameras alike."
            )
        counts = len(first.frame_ids), len(light.frame_ids)
        matched = any_length or (first.numbered and light.numbered)
        if not matched and abs(counts[0] - counts[1]) > COUNT_TOLERANCE * max(counts):
            raise InsufficientDataError(
                f"Cameras '{names[0]}' and '{name}' have {counts[0]} and {counts[1]} frames, so it is not known which "
                "belong together; cut them to the same moments, give folders of images numbered alike, or, with a "
                "timestamps.csv for `calibrate`, let them through by --unequal-lengths."
            )


def _common_times(frame_ids: Int[np.ndarray, " F"], lights: Sequence[CameraLights]) -> Float[np.ndarray, " F"] | None:
    """Times of the frames where all cameras know them and agree."""
    times = np.full(len(frame_ids), np.nan)
    for light in lights:
        if light.times is None:
            return None
        rows = np.searchsorted(frame_ids, light.frame_ids)
        if (np.abs(times[rows] - light.times) > TIME_TOLERANCE).any():
            return None
        times[rows] = light.times
    return times
