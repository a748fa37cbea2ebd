"""A session: synchronised videos of one room, with what is known of its cameras.

session/
  videos/cam_0.mp4 ...   or a folder of images each; the name is the camera's
  timestamps.csv         which image of which camera belongs to which frame (`jaxpoint.io.timestamps`); without it
                         frames belong together by the time stamps of videos, or by the names of images
  calibration.json       the cameras; optional where only images are looked at
  empty/cam_0.mp4 ...    the empty room, for background and motion threshold; optional
  wave/cam_0.mp4 ...     a light waved in the dark, for `detect led`; optional; `wave/masks/cam_0.png` where not to look
  objects.csv            what can be pointed at; optional
  truth/                 only where simulated
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8

from jaxpoint.camera.rig import CameraRig
from jaxpoint.errors import FileFormatError, InsufficientDataError, UsageError
from jaxpoint.io.exchange import read_calibration
from jaxpoint.io.files import natural_key
from jaxpoint.io.frames import FrameSource
from jaxpoint.io.images import IMAGE_SUFFIXES, VIDEO_SUFFIXES
from jaxpoint.io.pairing import pair_frames
from jaxpoint.io.rig_entries import needs_metres
from jaxpoint.io.stamped_pairing import pair_by_timestamps
from jaxpoint.io.timestamps import read_timestamps
from jaxpoint.io.video import open_frames

MASKS = "masks"  # folder of one image a camera, which is no camera itself
REMEDY = "say which belong together in a timestamps.csv, or number the images of all cameras alike"
logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Session:
    """F frames of C cameras on one clock."""

    folder: Path
    names: tuple[str, ...]
    videos: tuple[Path, ...]  # one a camera
    sizes: Int[np.ndarray, "C 2"]  # px, width and height
    frame_ids: Int[np.ndarray, " F"]  # number of each frame: the sync_index, or the number in the videos
    times: Float[np.ndarray, " F"]  # s
    frame_index: Int[np.ndarray, "F C"]  # position in the camera's own video; -1 where it has no frame
    rig: CameraRig | None  # in the order of `names`, m
    empty: tuple[Path | None, ...]  # recordings of the empty room
    notes: tuple[str, ...]  # what a user should know of the recording, a sentence each
    timestamps: Path | None = None
    calibration: Path | None = None  # of which `rig` is

    @property
    def files(self) -> tuple[Path, ...]:
        """All that the session was read from, folders of images among it."""
        return (*self.videos, *(path for path in (self.timestamps, self.calibration, *self.empty) if path is not None))

    def images(
        self, camera: int, frames: Sequence[int] | None = None
    ) -> Iterator[tuple[int, UInt8[np.ndarray, "H W 3"]]]:
        """The images of one camera (blue, green, red) with the places of their frames, without those that are damaged.

        Args:
            camera: place among the cameras.
            frames: places of those that are wanted; None for all.
        """
        chosen = np.arange(len(self.frame_ids)) if frames is None else np.unique(np.asarray(frames, int))
        index = self.frame_index[chosen, camera]
        for place, image in open_frames(self.videos[camera]).readable(np.unique(index[index >= 0])):
            for frame in chosen[index == place].tolist():
                yield frame, image


def open_session(folder: Path, calibration: Path | None = None, unit: str | None = None) -> Session:
    """Look at a session's folder, or at a single folder of videos; nothing is decoded but the first frames.

    Args:
        folder: as above; or one that holds the videos themselves.
        calibration: to use instead of the session's own.
        unit: of a calibration that does not say it, m, cm or mm.

    Raises:
        FileFormatError: no videos, or a file that cannot be read.
        UsageError: a camera that the calibration does not know, or has with another image size.
    """
    if not folder.is_dir():
        raise FileFormatError(f"There is no session folder '{folder}'; check the path.")
    own = folder / "videos"
    videos = recordings(own if own.is_dir() else folder)
    if not videos:
        raise FileFormatError(f"'{folder}' holds 0 videos; put one video or folder of images a camera in '{own}'.")
    names = tuple(sorted(videos, key=natural_key))
    sources = [open_frames(videos[name]) for name in names]
    sizes = np.array([source.size for source in sources])
    stamps = folder / "timestamps.csv"
    frames, times, index, notes = _stamped(stamps, sources, names) if stamps.is_file() else _matched(sources, names)
    path = calibration or (folder / "calibration.json")
    rig = _rig(path, names, sizes, unit) if calibration is not None or path.is_file() else None
    empty = recordings(folder / "empty")
    strange = sorted(set(empty) - set(names))
    if strange:
        notes = [*notes, f"'{folder / 'empty'}' holds '{strange[0]}', which is no camera here; name both alike."]
    return Session(
        folder,
        names,
        tuple(videos[name] for name in names),
        sizes,
        frames,
        times,
        index,
        rig,
        tuple(empty.get(name) for name in names),
        tuple(notes),
        stamps if stamps.is_file() else None,
        None if rig is None else path,
    )


def recordings(folder: Path) -> dict[str, Path]:
    """The videos and folders of images in a folder, by the camera's name; none where there is no such folder.

    Raises:
        FileFormatError: two of one name.
    """
    if not folder.is_dir():
        return {}
    found: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.name.lower() == MASKS:
            continue
        images = path.is_dir() and any(file.suffix.lower() in IMAGE_SUFFIXES for file in path.iterdir())
        if not images and path.suffix.lower() not in VIDEO_SUFFIXES:
            continue
        name = path.name if images else path.stem
        if name in found:
            raise FileFormatError(f"'{found[name]}' and '{path}' are both of camera '{name}'; keep one of them there.")
        found[name] = path
    return found


def _rig(path: Path, names: tuple[str, ...], sizes: np.ndarray, unit: str | None) -> CameraRig:
    saved = needs_metres(path, read_calibration(path), unit)
    missing = [name for name in names if name not in saved.rig.names]
    if missing:
        raise UsageError(
            f"'{path}' has no camera '{missing[0]}', it has {', '.join(saved.rig.names)}; name videos like cameras."
        )
    rig = saved.rig.select([saved.rig.names.index(name) for name in names])
    for name, known, given in zip(names, np.asarray(rig.image_sizes).tolist(), sizes.tolist()):
        if known != given:
            raise UsageError(
                f"The video of camera '{name}' is {given[0]} x {given[1]} px, but '{path}' knows it with "
                f"{known[0]} x {known[1]}; use the calibration of this recording."
            )
    return rig


def _stamped(stamps: Path, sources: list[FrameSource], names: tuple[str, ...]):
    """Frames as the timestamps have them."""
    timestamps = read_timestamps(stamps).select(names)
    pairing = pair_by_timestamps(timestamps, sources)
    return pairing.frame_ids, timestamps.times, pairing.index, list(pairing.notes)


def _matched(sources: list[FrameSource], names: tuple[str, ...]):
    """Frames that belong together by what names or time stamps say."""
    pairing = pair_frames(sources, names, remedy=REMEDY, any_length=True)
    notes = [note for note in pairing.notes if len(sources) > 1]
    if len(sources) > 1 and any(source.columns for source in sources):
        notes.append(f"Images are paired by {pairing.by}.")
    times = pairing.times
    if times is None:
        notes.append("No time of a frame is known, so frames count as 1 s apart; give the times in timestamps.csv.")
        times = (pairing.frame_ids - pairing.frame_ids[0]).astype(float)
    return pairing.frame_ids, times, pairing.index, notes


def check_session(session: Session) -> None:
    """Refuse a session in which no line can be measured, before anything is looked at.

    Raises:
        UsageError: it has no calibration.
        InsufficientDataError: it has one camera.
    """
    if len(session.names) < 2:
        raise InsufficientDataError(
            f"'{session.folder}' has {len(session.names)} camera; a line in the room takes two views or more, so add a "
            "second one."
        )
    if session.rig is None:
        raise UsageError(f"'{session.folder}' has no calibration.json; give the room's by --calibration.")
