"""Where the images of a board lie: a session, or a folder of images, some images, or a video for each camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Int

from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.io.frames import FrameSource
from jaxpoint.io.images import IMAGE_SUFFIXES, ImageFolder
from jaxpoint.io.pairing import Pairing, pair_frames
from jaxpoint.io.session import recordings
from jaxpoint.io.stamped_pairing import pair_by_timestamps
from jaxpoint.io.timestamps import read_timestamps
from jaxpoint.io.video import VideoFile, open_frames

MOST_OF_A_VIDEO = 300  # frames, where nobody says how many


@dataclass(frozen=True)
class BoardSources:
    """The cameras of a recording, and which of their frames belong together."""

    names: tuple[str, ...]
    paths: tuple[Path, ...]
    frames: tuple[FrameSource, ...]
    pairing: Pairing

    @property
    def shared(self) -> Int[np.ndarray, " S"]:
        """Rows of the pairing in which every camera has a frame."""
        return np.flatnonzero(np.all(self.pairing.index >= 0, axis=1))

    def spread(self, every: int) -> Int[np.ndarray, " F"]:
        """Rows of the pairing to look at: every so many; with 0 all images, or at most 300 frames of videos."""
        rows = len(self.pairing.frame_ids)
        videos = any(isinstance(source, VideoFile) for source in self.frames)
        step = every or (-(-rows // MOST_OF_A_VIDEO) if videos else 1)
        return np.arange(0, rows, step)


def open_board_sources(
    paths: Sequence[Path], names: Sequence[str] = (), timestamps: Path | None = None
) -> BoardSources:
    """The cameras behind some paths.

    Several image files are one camera; a folder of videos or of folders of images (or a session, with a folder
    `videos`) is one camera each; anything else is one camera: a folder of images, some of one (`folder/left*.jpg`), or
    a video. Which frames belong together is said by `timestamps`, else by a file `timestamps.csv` in the one folder
    that is given, else by numbers in names and time stamps of videos.

    Args:
        paths: as above.
        names: of the cameras, in the order of the paths.
        timestamps: a file as caliscope writes it, see `read_timestamps`.

    Raises:
        FileFormatError: images, a video or the timestamps cannot be read.
        UsageError: nothing was given, or names that do not fit.
        InsufficientDataError: frames of several cameras do not say which belong together.
    """
    if not paths:
        raise UsageError("No images were given; name a folder of images or a video for each camera.")
    given = dict(_cameras([Path(path) for path in paths]))
    if names and len(names) != len(given):
        raise UsageError(f"{len(given)} cameras need as many names, not {len(names)}.")
    chosen = tuple(names) or tuple(given)
    sources = tuple(given.values())
    if timestamps is None and len(sources) > 1:
        timestamps = _timestamps_in(paths)
    pairing = _pairing(sources, chosen, timestamps)
    return BoardSources(chosen, tuple(source.path for source in sources), sources, pairing)


def _timestamps_in(paths: Sequence[Path]) -> Path | None:
    """The timestamps of a session, or of a folder of videos."""
    beside = Path(paths[0]) / "timestamps.csv"
    return beside if len(paths) == 1 and beside.is_file() else None


def _pairing(sources: Sequence[FrameSource], names: Sequence[str], timestamps: Path | None) -> Pairing:
    """Which frames belong together; of one camera each is alone."""
    if timestamps is not None:
        return pair_by_timestamps(read_timestamps(timestamps).select(names), sources)
    if len(sources) > 1:
        return pair_frames(sources, names, remedy="number the images of all cameras alike")
    only = sources[0]
    return Pairing(only.frame_ids, np.arange(len(only))[:, None], only.times, "the only camera")


def _cameras(paths: list[Path]) -> list[tuple[str, FrameSource]]:
    """Name and frames of each camera."""
    if all(path.suffix.lower() in IMAGE_SUFFIXES and "*" not in path.name for path in paths):
        missing = [path for path in paths if not path.is_file()]
        if missing:
            raise FileFormatError(f"There is no image '{missing[0]}'; check the path.")
        return [("camera", ImageFolder(paths[0].parent, paths))]
    if len(paths) == 1:
        inside = _inside(paths[0])
        if inside:
            return [(name, open_frames(path)) for name, path in inside.items()]
    return list(zip(_names(paths), (open_frames(path) for path in paths)))


def _inside(folder: Path) -> dict[str, Path]:
    """The cameras in a session or in a folder of recordings; none in a folder of images."""
    if not folder.is_dir():
        return {}
    own = folder / "videos"
    return recordings(own if own.is_dir() else folder)


def _names(paths: list[Path]) -> list[str]:
    """The shortest ends of the paths that differ."""
    parts = [[*path.absolute().parts[1:-1], _stem(path)] for path in paths]
    for depth in range(1, max(len(part) for part in parts) + 1):
        names = ["_".join(part[-depth:]) for part in parts]
        if len(set(names)) == len(names):
            return names
    raise UsageError(f"'{paths[0]}' is given twice; name each camera once.")


def _stem(path: Path) -> str:
    return path.name if path.is_dir() else path.stem.replace("*", "").strip("_-. ") or "images"
