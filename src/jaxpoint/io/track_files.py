"""Tracks in files: our own `.npz`, and the one door to it and to every registered format, `read_tracks`."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Int

from jaxpoint.calibration.stuck import refuse_stuck
from jaxpoint.errors import FileFormatError, InsufficientDataError
from jaxpoint.io.files import StrPath, replacing
from jaxpoint.io.formats.calibration_format import SourceFile
from jaxpoint.io.track_formats.track_folder import keypoint_files
from jaxpoint.io.track_formats.track_format import ImageSizes, TrackRequest
from jaxpoint.io.track_formats.track_registry import recognised
from jaxpoint.targets import Target
from jaxpoint.tracks import PointPrior, Tracks

TRACKS_FORMAT = "jaxpoint-tracks"
TRACKS_VERSION = 2  # 1 has a single light; files that hold no more are still written so


def read_tracks(
    path: StrPath,
    *,
    one_based: bool = False,
    image_sizes: ImageSizes | None = None,
    min_likelihood: float | None = None,
    individual: str | None = None,
) -> Tracks:
    """Tracks from whatever `path` is: our own `.npz`, or of a registered format (`jaxpoint.io.TRACK_FORMATS`).

    Files are recognised by what is in them: a folder of Svoboda's toolbox (`points.dat`), corners of caliscope, points
    of DLTdv, Argus and easyWand, keypoints of DeepLabCut, Lightning Pose and SLEAP, and else the long table
    `frame,camera,x,y`. Of keypoints one file is one camera, and a folder of files, or of folders with one file each, is
    a recording; cameras are named by what differs between the names.

    Args:
        path: the file or folder.
        one_based: the pixels of text files count from 1, as Matlab's do; 1 is subtracted.
        image_sizes: width and height (px) of all cameras, or of each by name, for files that do not say.
        min_likelihood: keypoints less sure than this are as not seen; without it 0.6 of DeepLabCut, all of SLEAP.
        individual: whose keypoints, where a file holds several animals or people.

    Raises:
        FileFormatError: it is none of these, is damaged, or a camera has many sightings at one and the same pixel.
        UsageError: a file holds several individuals, or needs an image size.
        MissingDependencyError: an HDF5 file without h5py.
    """
    path = Path(path)
    if path.suffix.lower() == ".npz":
        tracks = load_tracks(path)
    else:
        place = path.parent if path.name == "points.dat" and path.is_file() else path
        request = TrackRequest((SourceFile(place),), str(path), one_based, image_sizes, min_likelihood, individual)
        tracks = _read_registered(request)
    try:
        refuse_stuck(tracks)
    except InsufficientDataError as error:
        raise FileFormatError(f"{path}: {error}") from None
    return tracks


def _read_registered(request: TrackRequest) -> Tracks:
    source = request.files[0]
    if not source.path.exists():
        raise FileFormatError(f"There is no file or folder {source.path}; check the path.")
    chosen = recognised(source)
    if chosen is not None:
        return chosen.read(request)
    if not source.path.is_dir():
        raise FileFormatError(f"{source.path} is no tracks file; give an .npz or a .csv file, or a folder of tracks.")
    chosen, files = keypoint_files(source.path)
    return chosen.read(replace(request, files=files))


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
    if tracks.point_names:
        arrays["point_names"] = np.array(tracks.point_names)
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
    if "point_names" in arrays:
        tracks = replace(tracks, point_names=tuple(arrays["point_names"].tolist()))
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
