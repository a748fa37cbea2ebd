"""All cameras of a session, side by side; what was once looked at is kept by its content and is not decoded again."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Int

from jaxpoint.config import to_toml
from jaxpoint.config.person import PersonSettings
from jaxpoint.detection.colour import Image
from jaxpoint.detection.person.frame_motion import learn_threshold, motion_between
from jaxpoint.detection.person.silhouette import RoomBackground, learn_background, never_clears
from jaxpoint.detection.person.silhouette_views import FORMAT, SilhouetteViews, load_views, save_views, watch
from jaxpoint.detection.person.watcher import PersonWatch
from jaxpoint.detection.workers import Advance, run_cameras
from jaxpoint.errors import FileFormatError, InsufficientDataError
from jaxpoint.evidence.camera_evidence import FrameReason
from jaxpoint.io.images import share_white
from jaxpoint.io.session import Session
from jaxpoint.io.video import FrameSource, open_frames

NEVER_CLEARS = 0.1  # of the outline of what differs: beyond it the median holds somebody
FOCAL_OF_WIDTH = 0.9  # focal length over image width where there is no calibration
QUIET = 0.5  # part of a recording's pairs that is taken for the empty room where there is no other

Job = TypeVar("Job")
Found = TypeVar("Found")
Progress = Callable[[str, int, int], None]
"""Called with a camera's name, frames done, frames to do."""


@dataclass(frozen=True)
class CameraJob:
    """What a process needs to look through one camera."""

    name: str
    video: Path
    empty: Path | None
    frame_index: Int[np.ndarray, " F"]  # -1 where the camera has no frame
    focal_px: float
    settings: PersonSettings
    kept: Path | None  # file of what was found, read where it exists and written where not


def watch_session(
    session: Session,
    settings: PersonSettings,
    *,
    cache: Path | None = None,
    anew: bool = False,
    workers: int = 0,
    progress: Progress | None = None,
) -> tuple[SilhouetteViews, ...]:
    """What every camera saw of people. Deterministic, whatever the number of processes.

    Processes are spawned, so a script must call this under `if __name__ == "__main__":` (or with `workers=1`).

    Args:
        session: the videos.
        settings: of the detectors.
        cache: folder of what earlier calls found; None keeps nothing.
        anew: look again where something was kept.
        workers: processes at most; 0 for one a core.
        progress: called in this process.

    Raises:
        FileFormatError: a video that cannot be decoded at all.
        InsufficientDataError: too few frames to learn a background from.
    """
    jobs = [camera_job(session, camera, settings, cache) for camera in range(len(session.names))]
    for job in jobs:
        if anew and job.kept is not None:
            job.kept.unlink(missing_ok=True)
    return side_by_side(watch_camera, jobs, session.names, cache, workers, progress)


def side_by_side(
    work: Callable[[Job, Advance], Found],
    jobs: Sequence[Job],
    names: Sequence[str],
    cache: Path | None,
    workers: int,
    progress: Progress | None,
) -> tuple[Found, ...]:
    """What `work` finds in every camera, each in a process.

    Raises:
        KeyboardInterrupt: Ctrl-C; the message names the folder of those that were done.
    """
    finished: dict[int, Found] = {}

    def report(camera: int, done: int, total: int) -> None:
        if progress:
            progress(names[camera], done, total)

    try:
        run_cameras(work, jobs, workers, finished, report)
    except KeyboardInterrupt:
        if not finished or cache is None:
            raise
        raise KeyboardInterrupt(
            f"{len(finished)} of {len(jobs)} cameras were done and are kept in {cache}; the same command goes on there."
        ) from None
    return tuple(finished[camera] for camera in range(len(jobs)))


def default_cache() -> Path:
    """Where the command line keeps detections: the user's cache folder."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxpoint" / "detections"


def watch_camera(job: CameraJob, advance: Advance) -> SilhouetteViews:
    """Learn one camera's room, then look through its frames.

    Raises:
        FileFormatError: no frame of the video can be decoded, or the empty room has images of another size.
        InsufficientDataError: too few frames to learn a background from.
    """
    if job.kept is not None and job.kept.is_file():
        try:
            views = load_views(job.kept)
        except FileFormatError:  # of another version, or cut off: looked at anew and replaced
            job.kept.unlink(missing_ok=True)
        else:
            advance(len(job.frame_index), len(job.frame_index))
            return views
    source = open_frames(job.video)
    background, threshold, notes = learn_room(job, source)
    watcher = PersonWatch(background, threshold, job.focal_px, job.settings)
    frames = CameraFrames(job, source)
    views = watch(frames.read(), len(job.frame_index), source.size, watcher, advance, notes)
    colour = (*left_out_notes(job.name, views.reasons), *_grey_notes(job.name, views))
    views = replace(views, notes=(*notes, *frames.notes, *colour))
    if job.kept is not None:
        job.kept.parent.mkdir(parents=True, exist_ok=True)
        save_views(job.kept, views)
    return views


def learn_room(job: CameraJob, source: FrameSource) -> tuple[RoomBackground | None, float, list[str]]:
    """Background and motion threshold, from the empty room's recording where there is one; and notes about it.

    Raises:
        FileFormatError: the empty room has images of another size.
        InsufficientDataError: too few frames to learn a background from.
    """
    settings, notes = job.settings, []
    empty = source if job.empty is None else open_frames(job.empty)
    if empty.size != source.size:
        (width, height), (own_width, own_height) = empty.size, source.size
        raise FileFormatError(
            f"The empty room of camera '{job.name}' ('{job.empty}') was recorded with {width} x {height} px and its "
            f"video with {own_width} x {own_height}; record both alike."
        )
    share_white(source, empty)
    adaptive = settings.background.method != "static"
    images = _spread(empty, settings.background.max_frames)
    if job.empty is None and not adaptive and len(images) >= settings.background.min_frames:
        covered = never_clears(images, settings.background)
        if covered > NEVER_CLEARS:
            notes.append(
                f"Camera '{job.name}': {covered:.0%} of the outlines are edges of the median; somebody who hardly "
                "leaves is taken for the room, so an adaptive background (MOG2) is used. Record the empty room."
            )
            adaptive = True
            settings = replace(settings, background=replace(settings.background, method="mog2"))
    try:
        background = None if adaptive else learn_background(images, settings.background)
    except InsufficientDataError as error:
        raise InsufficientDataError(f"Camera '{job.name}': {error}") from None
    counts = _edge_counts(empty, settings)
    if job.empty is None:
        counts = np.sort(counts)[: max(1, int(QUIET * len(counts)))]
    if len(counts) < settings.motion.min_pairs:
        notes.append(
            f"Camera '{job.name}': {len(counts)} pairs of quiet images are too few to learn a threshold of motion "
            f"from; it is {settings.motion.floor_px} edge pixels."
        )
        return background, float(settings.motion.floor_px), notes
    return background, learn_threshold(counts, settings.motion), notes


def left_out_notes(name: str, reasons: Int[np.ndarray, " F"]) -> tuple[str, ...]:
    """Notes on a camera whose grey images cannot be compared with its empty room; nothing where they can."""
    count = int((reasons == FrameReason.WITHOUT_COLOUR).sum())
    if not count:
        return ()
    return (
        f"Camera '{name}': {count} of {len(reasons)} images have no colour and the empty room has, so that all of them "
        "would differ from it; they are left out. Record both in one mode of the camera.",
    )


def _grey_notes(name: str, views: SilhouetteViews) -> tuple[str, ...]:
    """Notes on a camera in whose images people were looked for without colour."""
    count = int((views.grey & (views.reasons != FrameReason.WITHOUT_COLOUR)).sum())
    if not count:
        return ()
    return (
        f"Camera '{name}': {count} of {len(views.grey)} images have no colour, so that skin cannot be recognised and "
        "arms are found by their outlines alone; a colour camera finds more of them.",
    )


class CameraFrames:
    """The images of one camera by frame; what cannot be decoded leaves frames without one, and a note."""

    def __init__(self, job: CameraJob, source: FrameSource):
        self._job, self._source = job, source
        self.notes: list[str] = []

    def read(self) -> Iterator[tuple[int, Image]]:
        """Frame and image.

        Raises:
            FileFormatError: none can be decoded.
        """
        frames = np.flatnonzero(self._job.frame_index >= 0)
        index = self._job.frame_index[frames]
        order = np.argsort(index, kind="stable")
        frame_of = dict(zip(index[order].tolist(), frames[order].tolist()))
        lost: list[FileFormatError] = []
        read: list[int] = []
        for place, image in self._source.readable(np.unique(index), lost):
            read.append(frame_of[place])
            yield read[-1], image
        if lost and not read:
            raise lost[0]
        if lost:
            last = max(read)
            after = int((frames > last).sum())
            where = (
                f"stops at frame {last}, {after} before the end"
                if after
                else f"lacks {len(lost)} image{'s' * (len(lost) > 1)}"
            )
            self.notes.append(f"Camera '{self._job.name}' {where}: {lost[0]}")


def _edge_counts(source: FrameSource, settings: PersonSettings) -> Int[np.ndarray, " P"]:
    """Moving edge pixels between successive images: of at most 100 pairs spread over a recording."""
    pairs = min(len(source) - 1, 2 * settings.motion.min_pairs)
    if pairs < 1:
        return np.zeros(0, int)
    first = np.unique(np.linspace(0, len(source) - 2, pairs).astype(int))
    wanted = np.unique(np.concatenate([first, first + 1]))
    counts, previous = [], (-2, None)
    for index, image in _decodable(source, wanted):
        if previous[0] == index - 1 and previous[1] is not None:
            counts.append(motion_between(previous[1], image, settings.motion).edges)
        previous = index, image
    return np.array(counts, int)


def _spread(source: FrameSource, count: int) -> list[Image]:
    wanted = np.unique(np.linspace(0, len(source) - 1, min(count, len(source))).astype(int))
    return [image for _, image in _decodable(source, wanted)]


def _decodable(source: FrameSource, wanted: np.ndarray) -> Iterator[tuple[int, Image]]:
    """The frames that can be decoded; those that cannot were, or will be, spoken of elsewhere.

    Raises:
        FileFormatError: none can.
    """
    lost: list[FileFormatError] = []
    started = False
    for index, image in source.readable(wanted, lost):
        started = True
        yield index, image
    if lost and not started:
        raise lost[0]


def camera_job(session: Session, camera: int, settings: PersonSettings, cache: Path | None) -> CameraJob:
    """What to look for, and where, in one camera of a session."""
    width = float(session.sizes[camera, 0])
    focal = FOCAL_OF_WIDTH * width if session.rig is None else float(np.mean(session.rig.cameras.focal[camera]))
    job = CameraJob(
        session.names[camera],
        session.videos[camera],
        session.empty[camera],
        session.frame_index[:, camera],
        focal,
        settings,
        None,
    )
    return job if cache is None else replace(job, kept=cache / f"{content_key(job)}.npz")


def content_key(job: CameraJob, more: str = "") -> str:
    """What the result depends on: content, frames taken, focal length, settings, detectors' version, and `more`."""
    digest = hashlib.sha256(f"{FORMAT} {job.focal_px!r}\n{to_toml(job.settings)}{more}".encode())
    digest.update(np.ascontiguousarray(job.frame_index).tobytes())
    for path in (job.video, job.empty):
        digest.update(b"-" if path is None else _content(path))
    return digest.hexdigest()[:32]


def _content(path: Path) -> bytes:
    files = sorted(file for file in path.iterdir() if file.is_file()) if path.is_dir() else [path]
    digest = hashlib.sha256()
    for file in files:
        with file.open("rb") as stream:
            digest.update(file.name.encode() + hashlib.file_digest(stream, "sha256").digest())
    return digest.digest()
