"""A folder of keypoints: one file a camera, side by side or each in a folder of its own."""

from __future__ import annotations

from pathlib import Path

from jaxpoint.errors import FileFormatError
from jaxpoint.io.formats.calibration_format import SourceFile
from jaxpoint.io.track_formats.keypoint_cameras import camera_names, sorted_files
from jaxpoint.io.track_formats.track_format import TrackFormat
from jaxpoint.io.track_formats.track_registry import recognised

Found = dict[Path, TrackFormat]


def keypoint_files(folder: Path) -> tuple[TrackFormat, tuple[SourceFile, ...]]:
    """The format and the files of a folder's cameras, in the order of their names.

    Other files are left alone. Of a camera with the same keypoints as CSV and as HDF5 the CSV file is taken.

    Raises:
        FileFormatError: there are none, they are of several formats, or a camera has several.
    """
    found = _keypoints_in(folder)
    if not found:
        folders = sorted(path for path in folder.iterdir() if path.is_dir())
        found = {file: fmt for inside in folders for file, fmt in _only(_keypoints_in(inside)).items()}
    if not found:
        raise FileFormatError(
            f"The folder {folder} has no points.dat and no keypoints of DeepLabCut or SLEAP, one file a camera; give "
            "such a folder, or the .npz or .csv file in it. Images and videos go through `jaxpoint detect led` first."
        )
    formats = {fmt.name: fmt for fmt in found.values()}
    if len(formats) > 1:
        raise FileFormatError(
            f"{folder} holds keypoints of several formats ({', '.join(formats)}); keep the files of one there."
        )
    files = sorted_files(list(found))
    by_name: dict[str, Path] = {}
    for name, file in zip(camera_names(files), files):
        if (other := by_name.setdefault(name, file)) is not file:
            raise FileFormatError(f"{other} and {file.name} are both of camera '{name}'; keep one of them there.")
    return next(iter(formats.values())), tuple(map(SourceFile, files))


def _keypoints_in(folder: Path) -> Found:
    """The files of keypoints directly in a folder; not an HDF5 file beside its CSV."""
    files = sorted(path for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))
    claims = {file: recognised(SourceFile(file)) for file in files}
    found = {file: fmt for file, fmt in claims.items() if fmt is not None and fmt.per_camera}
    return {file: fmt for file, fmt in found.items() if file.suffix == ".csv" or file.with_suffix(".csv") not in found}


def _only(found: Found) -> Found:
    """Of a camera's own folder, the one file."""
    if len(found) > 1:
        first, second, *_ = found
        raise FileFormatError(
            f"{first.parent} holds {len(found)} files of keypoints ({first.name}, {second.name}); keep one a camera."
        )
    return found
