"""`timestamps.csv` as caliscope writes it: which frame of each camera's file belongs to which common moment."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxpoint.errors import FileFormatError, InsufficientDataError
from jaxpoint.io.files import Row, StrPath, natural_key, read_table
from jaxpoint.tracks import ROWS, SERIES, Tracks


@dataclass(frozen=True)
class Timestamps:
    """F common moments of C cameras whose files may have started, ended and dropped frames differently."""

    cameras: tuple[str, ...]
    sync_indices: Int[np.ndarray, " F"]
    frame_index: Int[np.ndarray, "F C"]  # position in the camera's own file; -1 where it has no frame
    frame_time: Float[np.ndarray, "F C"]  # s, as the camera's clock has it; 0 where it has no frame

    @property
    def present(self) -> Bool[np.ndarray, "F C"]:
        """Where a camera has a frame."""
        return self.frame_index >= 0

    @property
    def times(self) -> Float[np.ndarray, " F"]:
        """Mean time of each moment over all cameras, s: where one has no frame, what its clock would have shown.

        Clocks differ, so that the mean over those that have a frame would jump where one drops out.
        """
        ahead = self._ahead()
        own = np.where(self.present, self.frame_time - ahead, 0.0)
        return own.sum(axis=1) / self.present.sum(axis=1) + ahead.mean(axis=1)

    def _ahead(self) -> Float[np.ndarray, "F C"]:
        """By how much each clock is ahead of that of the camera with most frames, s; between common frames in line."""
        best = int(self.present.sum(axis=0).argmax())
        ahead = np.zeros(self.frame_time.shape)
        moments = np.arange(len(ahead))
        for camera in range(len(self.cameras)):
            common = np.flatnonzero(self.present[:, camera] & self.present[:, best])
            if len(common):
                gap = self.frame_time[common, camera] - self.frame_time[common, best]
                ahead[:, camera] = np.interp(moments, common, gap)
        return ahead

    def select(self, names: Sequence[str]) -> Timestamps:
        """The columns of some cameras in the order given; 'cam_3', 'cam3' and '3' mean the same camera.

        Moments in which none of them has a frame are left out.

        Raises:
            InsufficientDataError: a camera is not in the file.
        """
        known = {_camera_key(name): i for i, name in enumerate(self.cameras)}
        missing = [name for name in names if _camera_key(name) not in known]
        if missing:
            raise InsufficientDataError(
                f"The timestamps know no camera '{missing[0]}', only {', '.join(self.cameras)}; name the files alike."
            )
        columns = [known[_camera_key(name)] for name in names]
        moments = self.present[:, columns].any(axis=1)
        return Timestamps(
            tuple(names),
            self.sync_indices[moments],
            self.frame_index[moments][:, columns],
            self.frame_time[moments][:, columns],
        )


def synchronise(tracks: Tracks, timestamps: Timestamps) -> Tracks:
    """Tracks on the common moments, from tracks whose frame numbers count each camera's own file from 0.

    Frame ids become the sync indices, times the mean times. Frames that the timestamps do not name are left out; of
    several points each is put on the moments by itself, and the moments in which nobody sees it are left out.

    Raises:
        InsufficientDataError: a camera is not in the timestamps, these speak of frames that the tracks of a light have
            not, or the tracks hold points of known place.
    """
    stamps = timestamps.select(tracks.names)
    if tracks.point_ids is None:
        _check_last(tracks, stamps)
        return _on_moments(tracks, stamps)
    if tracks.prior is not None:
        raise InsufficientDataError("Points of known place have no moments; join them to the tracks after these.")
    _, first = np.unique(tracks.series_ids // SERIES, return_index=True)
    parts = [_on_moments(tracks.select_frames(rows), stamps) for rows in np.split(np.arange(tracks.frames), first[1:])]
    joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in ROWS}
    whole = replace(tracks, **joined)
    return whole.select_frames(np.flatnonzero(whole.visible.any(axis=1)))


def _check_last(tracks: Tracks, stamps: Timestamps) -> None:
    """Refuse timestamps of more frames than the tracks of a light have, which hold all frames."""
    last = int(tracks.frame_ids.max(initial=-1))
    if stamps.frame_index.max() > last:
        camera = int(stamps.frame_index.max(axis=0).argmax())
        raise InsufficientDataError(
            f"The timestamps speak of frame {stamps.frame_index.max()} of camera '{tracks.names[camera]}', but the "
            f"tracks end at frame {last}; use the timestamps.csv of this recording."
        )


def _on_moments(tracks: Tracks, stamps: Timestamps) -> Tracks:
    """The rows of one point, one for each moment."""
    row_of_frame = np.full(max(int(stamps.frame_index.max()), int(tracks.frame_ids.max(initial=0))) + 1, -1)
    row_of_frame[tracks.frame_ids] = np.arange(tracks.frames)
    row = np.where(stamps.present, row_of_frame[stamps.frame_index], -1)
    visible = (row >= 0) & tracks.visible[row, np.arange(tracks.cameras)[None]]
    moments = len(stamps.sync_indices)
    return replace(
        tracks,
        pixels=np.where(visible[..., None], tracks.pixels[row, np.arange(tracks.cameras)[None]], 0.0),
        visible=visible,
        frame_ids=stamps.sync_indices,
        times=stamps.times,
        point_ids=None if tracks.point_ids is None else np.full(moments, tracks.point_ids[0]),
        target_ids=None if tracks.target_ids is None else np.full(moments, tracks.target_ids[0]),
    )


def _camera_key(name: str) -> str:
    match = re.fullmatch(r"(?:cam(?:era)?|port)?[_-]?0*(\d+)", name, re.IGNORECASE)
    return match[1] if match else name


def read_timestamps(path: StrPath) -> Timestamps:
    """The timestamps of a recording.

    Columns `sync_index,cam_id,frame_index,frame_time` (`port` of older files means `cam_id`). Without `frame_index`
    the frames of each camera count from 0 in the order of their times, as caliscope counts them.

    Raises:
        FileFormatError: a missing column or value, or a camera with two frames in one moment.
    """
    rows = read_table(path, ("sync_index", "frame_time"))
    column = "cam_id" if "cam_id" in rows[0].values else "port"
    if column not in rows[0].values:
        raise FileFormatError(f"{path} has no column 'cam_id' (it has {', '.join(rows[0].values)}).")
    cameras = sorted({row.text(column) for row in rows}, key=natural_key)
    moments = sorted({row.integer("sync_index") for row in rows})
    moment_index = {moment: i for i, moment in enumerate(moments)}
    frame_index = np.full((len(moments), len(cameras)), -1)
    frame_time = np.zeros(frame_index.shape)
    for camera, name in enumerate(cameras):
        own = [row for row in rows if row.text(column) == name]
        for row, index in zip(own, _frame_indices(own)):
            place = moment_index[row.integer("sync_index")], camera
            if frame_index[place] >= 0:
                raise row.error(f"camera {name} has a second frame in sync_index {row.integer('sync_index')}.")
            frame_index[place], frame_time[place] = index, row.number("frame_time")
    return Timestamps(tuple(cameras), np.array(moments), frame_index, frame_time)


def _frame_indices(rows: list[Row]) -> list[int]:
    """The position in its file of every frame of one camera."""
    if "frame_index" in rows[0].values:
        indices = [row.integer("frame_index") for row in rows]
        seen: set[int] = set()
        for row, index in zip(rows, indices):
            if index < 0 or index in seen:
                raise row.error(f"frame_index {index} is negative or used twice.")
            seen.add(index)
        return indices
    order = np.argsort([row.number("frame_time") for row in rows], kind="stable")
    ranks = np.empty(len(rows), int)
    ranks[order] = np.arange(len(rows))
    return ranks.tolist()
