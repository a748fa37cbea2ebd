"""Tracks in files: our own `.npz`, a long CSV, caliscope's corners, and the one door to all of them, `read_tracks`.

Long CSV: `frame,time,camera,x,y`, one line for each light seen. `time` (s; or `time_ms`, `time_us`, `time_ns`) may be
left out; x or y empty or NaN means hidden. With several points a frame (ends of a wand, corners of a board) the column
`point` tells them apart. Columns named u and v, or cam_id, are read too (`ALIASES`). The image sizes
come from the columns `width,height`, else from the argument `image_sizes`, else from a file `cameras.csv`
(`camera,width,height`) in the same folder, which also fixes the order of the cameras; without it they are sorted by
name, cam_2 before cam_10.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Int

from jaxpoint.calibration.stuck import refuse_stuck
from jaxpoint.errors import FileFormatError, InsufficientDataError
from jaxpoint.io.clicked_points import is_clicked, read_clicked_points
from jaxpoint.io.files import PIXEL_ALIASES, Row, StrPath, natural_key, read_header, read_table, replacing
from jaxpoint.io.formats.caliscope_toml import read_camera_array_sizes
from jaxpoint.io.svoboda import read_svoboda
from jaxpoint.targets import Target
from jaxpoint.tracks import PointPrior, Tracks

TRACKS_FORMAT = "jaxpoint-tracks"
TRACKS_VERSION = 2  # 1 has a single light; files that hold no more are still written so
LONG_COLUMNS = ("frame", "camera", "x", "y")
ALIASES = {
    "frame": ("sync_index", "frame_id", "frame_number", "frame_index"),  # what all cameras share first
    **PIXEL_ALIASES,
    "width": ("image_width", "width_px"),
    "height": ("image_height", "height_px"),
}
TIME_UNITS = {"time": 1.0, "time_s": 1.0, "time_ms": 1e-3, "time_us": 1e-6, "time_ns": 1e-9}  # s
SLOWEST = 10.0  # s from frame to frame; more in a column `time` is no time in seconds
BOARD_COLUMNS = ("obj_loc_x", "obj_loc_y", "obj_loc_z")  # m, on the board
CORNER_COLUMNS = ("sync_index", "cam_id", "keypoint_id", "img_loc_x", "img_loc_y")

ImageSizes = tuple[int, int] | Mapping[str, tuple[int, int]]
Key = tuple[int, int]  # point and frame


def read_tracks(path: StrPath, *, one_based: bool = False, image_sizes: ImageSizes | None = None) -> Tracks:
    """Tracks from whatever `path` is.

    - a folder with `points.dat` (or that file itself): Svoboda's toolbox, see `read_svoboda`;
    - `.npz`: written by `save_tracks`;
    - `.csv` with a column `keypoint_id`: caliscope's corners, see `read_caliscope_corners`;
    - `.csv` of DLTdv, Argus or easyWand: see `clicked_points`;
    - any other `.csv`: the long table of this module.

    Args:
        one_based: the pixels of text files count from 1, as Matlab's do; 1 is subtracted.
        image_sizes: width and height (px) of all cameras, or of each by name, for CSV files that do not say.

    Raises:
        FileFormatError: it is none of these, is damaged, or a camera has many sightings at one and the same pixel.
    """
    path = Path(path)
    tracks = _read_any(path.parent if path.name == "points.dat" and path.is_file() else path, one_based, image_sizes)
    try:
        refuse_stuck(tracks)
    except InsufficientDataError as error:
        raise FileFormatError(f"{path}: {error}") from None
    return tracks


def _read_any(path: Path, one_based: bool, image_sizes: ImageSizes | None) -> Tracks:
    suffix = path.suffix.lower()
    if path.is_dir():
        if not (path / "points.dat").exists():
            raise FileFormatError(
                f"The folder {path} has no points.dat; give a folder of Svoboda's toolbox, or the .npz or .csv file in "
                "it. Images and videos go through `jaxpoint detect led` first."
            )
        return read_svoboda(path, one_based)
    if suffix == ".npz":
        return load_tracks(path)
    if suffix in (".csv", ".tsv", ".txt"):
        if "keypoint_id" in read_header(path):
            return read_caliscope_corners(path, image_sizes)
        if is_clicked(path):
            return read_clicked_points(path, image_sizes if isinstance(image_sizes, tuple) else None)
        return read_long_csv(path, one_based, image_sizes)
    if not path.exists():
        raise FileFormatError(f"There is no file or folder {path}; check the path.")
    raise FileFormatError(f"{path} is no tracks file; give a folder with points.dat, an .npz or a .csv file.")


def save_tracks(
    path: StrPath,
    tracks: Tracks,
    reasons: Int[np.ndarray, "F C"] | None = None,
    reason_names: Sequence[str] = (),
) -> None:
    """Write tracks as `.npz`, at once or not at all.

    Args:
        reasons: why each light was rejected, as an index into `reason_names`.

    Raises:
        ValueError: `reasons` does not fit the tracks or names.
    """
    arrays: dict[str, np.ndarray] = {
        "format": np.array(TRACKS_FORMAT),
        "version": np.array(1 if tracks.point_ids is None and tracks.prior is None else TRACKS_VERSION),
        "pixels": tracks.pixels,
        "visible": tracks.visible,
        "image_sizes": tracks.image_sizes,
        "frame_ids": tracks.frame_ids,
        "names": np.array(tracks.names),
    }
    if tracks.times is not None:
        arrays["times"] = tracks.times
    if tracks.pixel_aspects is not None:
        arrays["pixel_aspects"] = tracks.pixel_aspects
    arrays |= _point_arrays(tracks)
    if reasons is not None:
        reasons = np.asarray(reasons)
        if reasons.shape != tracks.visible.shape or not ((reasons >= 0) & (reasons < len(reason_names))).all():
            raise ValueError(
                f"`reasons` {reasons.shape} must have the shape {tracks.visible.shape} and values below "
                f"{len(reason_names)}, the number of names."
            )
        arrays |= {"reasons": reasons.astype(np.int16), "reason_names": np.array(reason_names)}
    with replacing(path) as file:
        np.savez_compressed(file, **arrays)  # pyright: ignore[reportArgumentType]


def _point_arrays(tracks: Tracks) -> dict[str, np.ndarray]:
    """What tells points apart, and what is known of them; nothing for a single light."""
    arrays: dict[str, np.ndarray] = {}
    if tracks.point_ids is not None and tracks.target_ids is not None:
        arrays |= {"point_ids": tracks.point_ids, "target_ids": tracks.target_ids}
        arrays["target_names"] = np.array([target.name for target in tracks.targets], dtype=str)
        arrays["target_size_sigmas"] = np.array([target.size_sigma for target in tracks.targets], dtype=float)
        arrays |= {f"target_points_{i}": target.points for i, target in enumerate(tracks.targets)}
    if tracks.prior is not None:
        arrays |= {"prior_points": tracks.prior.points, "prior_sigmas": tracks.prior.sigmas}
    return arrays


def _with_point_arrays(tracks: Tracks, arrays: Mapping[str, np.ndarray]) -> Tracks:
    """Tracks with what `_point_arrays` wrote."""
    if "prior_points" in arrays:
        tracks = replace(tracks, prior=PointPrior(arrays["prior_points"], arrays["prior_sigmas"]))
    if "point_ids" not in arrays:
        return tracks
    names, sigmas = arrays["target_names"].tolist(), arrays["target_size_sigmas"].tolist()
    shapes = [arrays[f"target_points_{i}"] for i in range(len(names))]
    targets = tuple(Target(*fields) for fields in zip(names, shapes, sigmas))
    return replace(tracks, point_ids=arrays["point_ids"], target_ids=arrays["target_ids"], targets=targets)


def load_tracks(path: StrPath) -> Tracks:
    """Tracks written by `save_tracks`.

    Raises:
        FileFormatError: not such a file, damaged, or of a later version.
    """
    arrays = _read_npz(path)
    try:
        plain = Tracks.from_pixels(
            arrays["pixels"],
            arrays["image_sizes"],
            arrays["visible"],
            arrays["frame_ids"],
            arrays.get("times"),
            tuple(str(name) for name in arrays["names"]),
            arrays.get("pixel_aspects"),
        )
        return _with_point_arrays(plain, arrays)
    except (KeyError, ValueError) as error:
        raise FileFormatError(f"{path} is damaged: {error}") from None


def load_reasons(path: StrPath) -> tuple[Int[np.ndarray, "F C"], tuple[str, ...]] | None:
    """The detection reasons of a file written by `save_tracks` and their names; None where it has none.

    Raises:
        FileFormatError: not such a file, damaged, or of a later version.
    """
    arrays = _read_npz(path)
    if "reasons" not in arrays:
        return None
    return arrays["reasons"], tuple(str(name) for name in arrays["reason_names"])


def _read_npz(path: StrPath) -> dict[str, np.ndarray]:
    try:
        with Path(path).open("rb") as file, np.load(file, allow_pickle=False) as archive:
            arrays = dict(archive)
    except (FileNotFoundError, IsADirectoryError):
        raise FileFormatError(f"There is no file {path}; check the path.") from None
    except (ValueError, EOFError, OSError, zipfile.BadZipFile) as error:
        raise FileFormatError(f"{path} is not an .npz file or is cut off ({error}); write it again.") from None
    if "format" not in arrays or str(arrays["format"]) != TRACKS_FORMAT:
        raise FileFormatError(f"{path} holds no jaxpoint tracks; write it with `jaxpoint detect led` or `save_tracks`.")
    if not 1 <= int(arrays["version"]) <= TRACKS_VERSION:
        raise FileFormatError(
            f"{path} has version {int(arrays['version'])}, this jaxpoint reads 1 to {TRACKS_VERSION}; update jaxpoint."
        )
    return arrays


def read_long_csv(path: StrPath, one_based: bool = False, image_sizes: ImageSizes | None = None) -> Tracks:
    """Tracks from a table `frame,time,camera,x,y` (this module says which columns are optional).

    Raises:
        FileFormatError: a missing column or value, a camera twice in one frame, or no image size.
    """
    rows = read_table(path, LONG_COLUMNS, ALIASES)
    order, sizes = _sizes_of(path, rows, image_sizes)
    several = "point" in rows[0].values
    keys = [(row.integer("point") if several else 0, row.integer("frame")) for row in rows]
    different = sorted(set(keys))
    pixels = _scatter(rows, keys, different, order, ("x", "y"))
    times = _times(path, rows, keys, different)
    points, frames = np.array(different).T
    return Tracks.from_pixels(
        pixels - float(one_based),
        np.array([sizes[name] for name in order]),
        frame_ids=frames,
        times=times,
        names=order,
        point_ids=points if several else None,
    )


def read_caliscope_corners(path: StrPath, image_sizes: ImageSizes | None = None) -> Tracks:
    """Corners of a board as caliscope writes them (`xy_CHARUCO.csv`): point ids are its keypoint ids.

    Where the file says where each corner lies on the board, the board is a target of that shape. Cameras are named
    cam_<id>. The image sizes come from `image_sizes` or a `camera_array.toml` in this folder or one of the three above
    it.

    Raises:
        FileFormatError: a missing column or value, a corner twice, a board beside another, or no image size.
    """
    rows = read_table(path, CORNER_COLUMNS)
    for row in rows:
        row.values["camera"] = f"cam_{row.integer('cam_id')}"
    if len({row.values.get("object_id") for row in rows}) > 1:
        raise FileFormatError(f"{path} holds several boards (object_id); keep the lines of one.")
    if image_sizes is None:
        image_sizes = _camera_array_sizes(Path(path), {row.values["camera"] for row in rows})
    order, sizes = _sizes_of(path, rows, image_sizes)
    keys = [(row.integer("keypoint_id"), row.integer("sync_index")) for row in rows]
    different = sorted(set(keys))
    pixels = _scatter(rows, keys, different, order, ("img_loc_x", "img_loc_y"))
    points, frames = np.array(different).T
    corners, target = _board_of(rows)
    return Tracks.from_pixels(
        pixels,
        np.array([sizes[name] for name in order]),
        frame_ids=frames,
        names=order,
        point_ids=points if target is None else np.array([corners.index(point) for point in points.tolist()]),
        target=target,
    )


def _board_of(rows: list[Row]) -> tuple[list[int], Target | None]:
    """The corners' ids in order, and the board that they are of; None where the file does not say where they lie."""
    corners = sorted({row.integer("keypoint_id") for row in rows})
    if any(column not in rows[0].values or row.missing(column) for row in rows for column in BOARD_COLUMNS):
        return corners, None
    places: dict[int, list[float]] = {}
    for row in rows:
        place = [row.number(column) for column in BOARD_COLUMNS]
        if places.setdefault(row.integer("keypoint_id"), place) != place:
            raise row.error(f"corner {row.integer('keypoint_id')} lies elsewhere on the board than in a line before.")
    try:
        return corners, Target("board", np.array([places[corner] for corner in corners]))
    except ValueError as error:
        raise rows[0].error(f"obj_loc is of no board: {error}") from None


def _camera_array_sizes(path: Path, cameras: set[str]) -> dict[str, tuple[int, int]] | None:
    for folder in path.resolve().parents[:4]:
        if (folder / "camera_array.toml").exists():
            sizes = read_camera_array_sizes(folder / "camera_array.toml")
            return {name: size for name, size in sizes.items() if name in cameras}
    return None


def _scatter(
    rows: list[Row], keys: list[Key], different: list[Key], cameras: Sequence[str], xy: tuple[str, str]
) -> np.ndarray:
    """(F, C, 2) pixels, NaN where there is no line."""
    index = {key: i for i, key in enumerate(different)}
    camera_index = {name: i for i, name in enumerate(cameras)}
    pixels = np.full((len(different), len(cameras), 2), np.nan)
    taken = np.zeros(pixels.shape[:2], bool)
    for row, key in zip(rows, keys):
        name = row.text("camera")
        place = index[key], camera_index[name]
        if taken[place]:
            again = f"camera '{name}' has a second line for frame {key[1]}"
            if "point" in row.values or "keypoint_id" in row.values:
                raise row.error(f"{again} and point {key[0]}; keep one line.")
            raise row.error(
                f"{again}; a file holds one light, unless a column 'point' tells several apart: keep one line, or add "
                "that column."
            )
        taken[place] = True
        if not (row.missing(xy[0]) or row.missing(xy[1])):
            pixels[place] = row.number(xy[0]), row.number(xy[1])
    return pixels


def _times(path: StrPath, rows: list[Row], keys: list[Key], different: list[Key]) -> np.ndarray | None:
    """(F,) mean time of each frame's lines, s; None where there is no such column or it is empty throughout."""
    column = next((name for name in TIME_UNITS if name in rows[0].values), None)
    if column is None or all(row.missing(column) for row in rows):
        return None
    seconds: dict[int, list[float]] = {frame: [] for _, frame in different}
    for row, (_, frame) in zip(rows, keys):
        if not row.missing(column):
            seconds[frame].append(TIME_UNITS[column] * row.number(column))
    empty = [frame for frame, values in seconds.items() if not values]
    if empty:
        raise FileFormatError(f"{path}: frame {empty[0]} has no time, others do; give all or drop the column.")
    mean = {frame: float(np.mean(values)) for frame, values in sorted(seconds.items())}
    if column == "time":
        _check_seconds(path, np.array(list(mean.values())))
    return np.array([mean[frame] for _, frame in different])


def _check_seconds(path: StrPath, times: np.ndarray) -> None:
    step = float(np.median(np.abs(np.diff(times)))) if len(times) > 1 else 0.0
    if step > SLOWEST:
        unit = next((name for name in ("time_ms", "time_us") if step * TIME_UNITS[name] <= 1), "time_ns")
        raise FileFormatError(
            f"{path}: column 'time' rises by {step:.3g} from frame to frame, which are hardly seconds; name it {unit} "
            f"if it is in {unit[5:]}, or time_s if these are seconds."
        )


def _sizes_of(
    path: StrPath, rows: list[Row], given: ImageSizes | None
) -> tuple[tuple[str, ...], dict[str, tuple[int, int]]]:
    """The cameras in order, and the image size of each."""
    seen = sorted({row.text("camera") for row in rows}, key=natural_key)
    order: Sequence[str] = seen
    sidecar = Path(path).parent / "cameras.csv"
    if {"width", "height"} <= rows[0].values.keys():
        sizes = _sizes_in(rows)
    elif isinstance(given, Mapping):
        sizes, order = dict(given), list(given)
    elif given is not None:
        sizes = dict.fromkeys(seen, given)
    elif sidecar.exists():
        sizes = _sizes_in(read_table(sidecar, ("camera", "width", "height"), ALIASES))
        order = list(sizes)
    else:
        raise FileFormatError(
            f"{path} does not say how large the images are; add columns width,height (px), or a file {sidecar} "
            "(camera,width,height), or give --image-size WIDTH HEIGHT where all are alike."
        )
    missing = [name for name in seen if name not in sizes]
    if missing:
        raise FileFormatError(f"{path}: no image size is known for camera '{missing[0]}', only for {list(sizes)}.")
    return tuple(order), sizes


def _sizes_in(rows: list[Row]) -> dict[str, tuple[int, int]]:
    sizes: dict[str, tuple[int, int]] = {}
    for row in rows:
        size = row.integer("width"), row.integer("height")
        if min(size) <= 0:
            raise row.error(f"an image of {size[0]} x {size[1]} px; width and height must be positive.")
        name = row.text("camera")
        if sizes.setdefault(name, size) != size:
            raise row.error(f"camera '{name}' is {size} here and {sizes[name]} before.")
    return sizes
