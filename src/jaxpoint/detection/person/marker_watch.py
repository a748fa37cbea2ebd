"""A coloured marker through a session: learnt from picked pixels, looked for in every view, kept like people are."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from jaxtyping import UInt8

from jaxpoint.config.person import MarkerSettings, PersonSettings
from jaxpoint.detection.colour import Image, is_grey
from jaxpoint.detection.person.marker_regions import MarkerModel, MarkerReason, find_markers, marker_ends, train_marker
from jaxpoint.detection.person.session_watch import (
    CameraFrames,
    CameraJob,
    Progress,
    camera_job,
    content_key,
    learn_room,
    left_out_notes,
    side_by_side,
)
from jaxpoint.detection.person.watcher import Look, PersonWatch
from jaxpoint.detection.workers import Advance
from jaxpoint.errors import FileFormatError, InsufficientDataError
from jaxpoint.evidence.camera_evidence import FrameReason
from jaxpoint.evidence.marker_views import MarkerViews
from jaxpoint.io.files import replacing
from jaxpoint.io.marker_samples import MarkerSample
from jaxpoint.io.session import Session
from jaxpoint.io.video import open_frames

FORMAT = 2  # of the kept files; higher whenever the marker is found otherwise


@dataclass(frozen=True)
class MarkerJob:
    """What a process needs to look for the marker in one camera."""

    camera: CameraJob
    model: MarkerModel
    settings: MarkerSettings


def picked_pixels(session: Session, samples: Sequence[MarkerSample]) -> UInt8[np.ndarray, "N 3"]:
    """The pixels of all samples, blue, green, red.

    Raises:
        FileFormatError: an image cannot be decoded.
        InsufficientDataError: an image has no colour.
    """
    picked = [np.zeros((0, 3), np.uint8)]
    for camera in sorted({sample.camera for sample in samples}):
        own = [sample for sample in samples if sample.camera == camera]
        source = open_frames(session.videos[camera])
        index = np.array([session.frame_index[sample.frame, camera] for sample in own])
        for place, image in source.stream(np.unique(index)):
            if is_grey(image):
                raise InsufficientDataError(
                    f"Camera '{session.names[camera]}' has no colour in frame {place} (its channels are alike), and a "
                    "marker is known by its hue; pick in the images of colour cameras."
                )
            picked += [
                disc(image, sample.x, sample.y, sample.radius_px) for sample, at in zip(own, index) if at == place
            ]
    return np.concatenate(picked)


def learn_marker(session: Session, samples: Sequence[MarkerSample], settings: MarkerSettings) -> MarkerModel:
    """The marker's colour from pixels picked in a session.

    Raises:
        FileFormatError: an image cannot be decoded.
        InsufficientDataError: an image has no colour, or the pixels are too few or grey.
    """
    return train_marker(picked_pixels(session, samples), settings)


def watch_markers(
    session: Session,
    model: MarkerModel,
    settings: PersonSettings,
    marker: MarkerSettings,
    *,
    cache: Path | None = None,
    anew: bool = False,
    workers: int = 0,
    progress: Progress | None = None,
) -> tuple[MarkerViews, ...]:
    """Where every camera may have seen the marker. Deterministic, whatever the number of processes.

    Processes are spawned, so a script must call this under `if __name__ == "__main__":` (or with `workers=1`).

    Args:
        session: the videos.
        model: of the marker.
        settings: of the detectors of people.
        marker: of the marker's.
        cache: folder of what earlier calls found; None keeps nothing.
        anew: look again where something was kept.
        workers: processes at most; 0 for one a core.
        progress: called in this process.

    Raises:
        FileFormatError: a video that cannot be decoded at all.
        InsufficientDataError: too few frames to learn a background from.
    """
    jobs = [_job(session, camera, model, settings, marker, cache) for camera in range(len(session.names))]
    for job in jobs:
        if anew and job.camera.kept is not None:
            job.camera.kept.unlink(missing_ok=True)
    return side_by_side(watch_camera, jobs, session.names, cache, workers, progress)


def watch_camera(job: MarkerJob, advance: Advance) -> MarkerViews:
    """Learn one camera's room, then look through its frames.

    Raises:
        FileFormatError: no frame of the video can be decoded, or the empty room has images of another size.
        InsufficientDataError: too few frames to learn a background from.
    """
    own = job.camera
    if own.kept is not None and own.kept.is_file():
        try:
            markers = load_markers(own.kept)
        except FileFormatError:  # of another version, or cut off: looked at anew and replaced
            own.kept.unlink(missing_ok=True)
        else:
            advance(len(own.frame_index), len(own.frame_index))
            return markers
    source = open_frames(own.video)
    background, threshold, notes = learn_room(own, source)
    watcher = PersonWatch(background, threshold, own.focal_px, own.settings)
    frames = CameraFrames(own, source)
    markers = look_for_marker(frames.read(), len(own.frame_index), watcher, job.model, job.settings, advance)
    markers = replace(markers, notes=(*notes, *frames.notes, *left_out_notes(own.name, markers.reasons)))
    if own.kept is not None:
        own.kept.parent.mkdir(parents=True, exist_ok=True)
        save_markers(own.kept, markers)
    return markers


def look_for_marker(
    images: Iterable[tuple[int, Image | None]],
    frames: int,
    watcher: PersonWatch,
    model: MarkerModel,
    settings: MarkerSettings,
    advance: Callable[[int, int], None] | None = None,
) -> MarkerViews:
    """Look for the marker in one camera's frames.

    Args:
        images: frame and image in their order; None, or a frame left out, where the camera has no image.
        frames: F.
        watcher: of people; fresh, for this camera.
        model: of the marker.
        settings: of the marker.
        advance: called with frames done and to do.
    """
    reasons = np.full(frames, FrameReason.NO_IMAGE, int)
    why = np.full(frames, MarkerReason.NO_COLOUR, int)
    found: list[tuple] = []
    for frame, image in images:
        if image is not None:
            look = watcher.look(image)
            reasons[frame] = look.reason
            places, why[frame] = _places(image, look, model, settings)
            found += [(frame, *place) for place in places]
        if advance:
            advance(frame + 1, frames)
    frame, area = (np.array([one[i] for one in found], dtype=int) for i in (0, 1))
    centroid, tip, base, person = (np.array([one[i] for one in found], float).reshape(-1, 2) for i in (2, 3, 4, 5))
    return MarkerViews(reasons, why, frame, area, centroid, tip, base, person)


def _places(image: Image, look: Look, model: MarkerModel, settings: MarkerSettings) -> tuple[list[tuple], MarkerReason]:
    """Area, centroid, tip, base and person of each candidate, the largest first; or why there is none."""
    places, why = [], MarkerReason.NO_COLOUR
    for sighting in look.sightings:
        person = sighting.silhouette.region.centroid
        markers = find_markers(image, sighting.silhouette, model, settings)
        if not places:
            why = max(why, markers.reason) if markers.reason != MarkerReason.FOUND else MarkerReason.FOUND
        for region in markers.regions:
            ends = marker_ends(region, person)
            places.append((region.area, region.centroid, ends.tip, ends.base, person))
    return sorted(places, key=lambda place: -place[0]), why


def disc(image: Image, x: float, y: float, radius_px: float) -> UInt8[np.ndarray, "N 3"]:
    """The pixels of an image whose centres lie within a radius of (x, y) px; the nearest one at least."""
    reach = int(np.ceil(radius_px))
    left, top = round(x) - reach, round(y) - reach
    rows, columns = np.mgrid[top : top + 2 * reach + 1, left : left + 2 * reach + 1]
    inside = (np.hypot(columns - x, rows - y) <= radius_px) | ((rows == round(y)) & (columns == round(x)))
    inside &= (rows >= 0) & (columns >= 0) & (rows < image.shape[0]) & (columns < image.shape[1])
    return image[rows[inside], columns[inside]]


def _job(
    session: Session,
    camera: int,
    model: MarkerModel,
    settings: PersonSettings,
    marker: MarkerSettings,
    cache: Path | None,
) -> MarkerJob:
    own = camera_job(session, camera, settings, None)
    if cache is not None:
        own = replace(own, kept=cache / f"marker-{content_key(own, f'{FORMAT} {model!r} {marker!r}')}.npz")
    return MarkerJob(own, model, marker)


_ARRAYS = ("reasons", "markers", "frame", "area", "centroid", "tip", "base", "person")


def save_markers(path: Path, markers: MarkerViews) -> None:
    """Keep what one camera saw in a file; it appears whole or not at all."""
    arrays = {name: getattr(markers, name) for name in _ARRAYS}
    with replacing(path) as file:
        np.savez(file, format=FORMAT, notes=np.array(markers.notes, dtype=str), **arrays)


def load_markers(path: Path) -> MarkerViews:
    """What `save_markers` kept.

    Raises:
        FileFormatError: it is no such file, or of another version.
    """
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as kept:
            if int(kept["format"]) != FORMAT:
                raise FileFormatError(f"'{path}' was kept by another version of jaxpoint; delete it.")
            arrays = {name: kept[name] for name in _ARRAYS}
            return MarkerViews(**arrays, notes=tuple(kept["notes"].tolist()))
    except (OSError, EOFError, BadZipFile, ValueError, KeyError) as error:
        raise FileFormatError(f"'{path}' cannot be read as kept markers ({error}); delete it.") from None
