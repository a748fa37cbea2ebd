"""Keypoints of a recording from one file a camera, as pose estimators write them."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.io.files import PIXEL_ALIASES, natural_key, read_table
from jaxpoint.io.track_formats.track_format import TrackFormat, TrackRequest
from jaxpoint.tracks import Tracks

# What the tools add to the name of a video: DeepLabCut its network, SLEAP the kind of file.
ADDED = re.compile(r"(DLC_|DeepCut_|\.analysis$|_sleap$).*", re.DOTALL)


@dataclass(frozen=True)
class CameraKeypoints:
    """P named points in F frames of one camera."""

    names: tuple[str, ...]
    frame_ids: Int[np.ndarray, " F"]  # number of the frame in the video
    pixels: Float[np.ndarray, "F P 2"]  # px, NaN where not seen


def keypoint_format(
    name: str,
    title: str,
    recognise: Callable[[Path, str], bool],
    read_camera: Callable[[TrackRequest, Path], CameraKeypoints],
) -> TrackFormat:
    """A format of keypoints with one file a camera, from the function that reads one file."""

    def read(request: TrackRequest) -> Tracks:
        return _tracks(request, [read_camera(request, file.path) for file in request.files])

    return TrackFormat(name, title, recognise, read, per_camera=True)


def camera_names(files: Sequence[Path]) -> tuple[str, ...]:
    """Names of the cameras from those of their files: what differs between these.

    Where each file is alone in its folder, from those of the folders. What a tool adds to a video's name
    (`..DLC_resnet50..`, `.analysis`) is no part of it.
    """
    folders = [file.parent.name for file in files]
    apart = len(set(folders)) == len(files) > 1
    stems = folders if apart else [ADDED.sub("", file.stem) or file.stem for file in files]
    if len(stems) == 1:
        return tuple(stems)
    parts = [re.split(r"([_. ])", stem) for stem in stems]
    same = _same_start(parts)
    if same and all(part[same : same + 1] and part[same][:1].isdigit() for part in parts):
        same = max(same - 2, 0)  # cam_1 and cam_2 are no 1 and 2
    ends = [part[same:] for part in parts]
    after = _same_start([end[:0:-1] for end in ends])  # a name keeps its first part
    return tuple("".join(end[: len(end) - after]).strip("_. ") for end in ends)


def individual_of(request: TrackRequest, path: Path, names: Sequence[str]) -> int:
    """The place of the individual that is to be read.

    Raises:
        UsageError: there are several and none was named, or the named one is not there.
    """
    if request.individual is None and len(names) == 1:
        return 0
    if request.individual is None:
        raise UsageError(
            f"{path} holds {len(names)} individuals ({', '.join(names)}), and whose are whose from camera to camera "
            "is not known: choose one by --individual NAME."
        )
    if request.individual not in names:
        raise UsageError(f"{path} has no individual '{request.individual}'; it has {', '.join(names) or 'no names'}.")
    return list(names).index(request.individual)


def frame_of_image(path: Path, image: str) -> int:
    """The frame of a labelled image: the number at the end of its name, as `img0042.png`.

    Raises:
        FileFormatError: there is none.
    """
    number = re.search(r"(\d+)(\.\w+)?$", image)
    if number is None:
        raise FileFormatError(f"{path}: the image '{image}' has no number, so its frame is not known; number it.")
    return int(number[1])


def _same_start(parts: Sequence[Sequence[str]]) -> int:
    """How many parts all begin with; each keeps one at least."""
    same = 0
    while same < min(map(len, parts)) - 1 and len({part[same] for part in parts}) == 1:
        same += 1
    return same


def _tracks(request: TrackRequest, cameras: Sequence[CameraKeypoints]) -> Tracks:
    """The points of all cameras by name, in the frames of all: rows that no camera sees are left out."""
    names = camera_names([file.path for file in request.files])
    points = tuple(dict.fromkeys(name for camera in cameras for name in camera.names))
    frames = np.unique(np.concatenate([camera.frame_ids for camera in cameras]))
    pixels = np.full((len(points), len(frames), len(cameras), 2), np.nan)
    for c, (camera, file) in enumerate(zip(cameras, request.files)):
        _check_frames(file.path, camera.frame_ids)
        rows = np.searchsorted(frames, camera.frame_ids)
        for p, name in enumerate(camera.names):
            pixels[points.index(name), rows, c] = camera.pixels[:, p]
    seen = np.asarray(np.isfinite(pixels).all(axis=-1))
    point, frame = np.nonzero(seen.any(axis=-1))
    return Tracks.from_pixels(
        np.where(seen[..., None], pixels, np.nan)[point, frame] - float(request.one_based),
        np.array(_sizes(request, names)),
        frame_ids=frames[frame],
        names=names,
        point_ids=point,
        point_names=points,
    )


def _check_frames(path: Path, frame_ids: np.ndarray) -> None:
    different, counts = np.unique(frame_ids, return_counts=True)
    if (counts > 1).any():
        raise FileFormatError(f"{path} has frame {different[counts > 1][0]} twice; keep one line of it.")


def _sizes(request: TrackRequest, names: Sequence[str]) -> list[tuple[int, int]]:
    """As given, or from `cameras.csv` in the folder."""
    place = Path(request.label)
    beside = (place if place.is_dir() else place.parent) / "cameras.csv"
    if request.image_sizes is not None or not beside.is_file():
        return request.sizes_of(names)
    rows = read_table(beside, ("camera", "width", "height"), {"camera": PIXEL_ALIASES["camera"]})
    known = {row.text("camera"): (row.integer("width"), row.integer("height")) for row in rows}
    return TrackRequest(request.files, str(beside), image_sizes=known).sizes_of(names)


def sorted_files(files: Sequence[Path]) -> list[Path]:
    """In the order of their cameras, cam_2 before cam_10."""
    return [file for _, file in sorted(zip(camera_names(files), files), key=lambda pair: natural_key(pair[0]))]
