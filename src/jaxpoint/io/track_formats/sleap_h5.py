"""Keypoints of one camera in SLEAP's analysis files (HDF5): `tracks` (track, xy, node, frame), names, scores.

SLEAP leaves out peaks below its own threshold; `min_likelihood` leaves out more. A score of NaN is a point that was
placed by hand. Pixel (0, 0) is the centre of the top-left one.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from jaxpoint.errors import FileFormatError, MissingDependencyError
from jaxpoint.io.track_formats.hdf5 import is_hdf5, names_in, open_hdf5
from jaxpoint.io.track_formats.keypoint_cameras import CameraKeypoints, individual_of, keypoint_format
from jaxpoint.io.track_formats.track_format import TrackRequest


def is_sleap_h5(path: Path, head: str) -> bool:
    """Whether it holds tracks and the names of nodes; without h5py its name says it."""
    if not is_hdf5(path):
        return False
    try:
        with open_hdf5(path) as file:
            return {"tracks", "node_names", "track_occupancy"} <= set(file)
    except MissingDependencyError:
        return path.name.endswith(".analysis.h5")
    except FileFormatError:
        return False


def read_sleap_h5(request: TrackRequest, path: Path) -> CameraKeypoints:
    """The keypoints of one file.

    Raises:
        FileFormatError: its arrays do not fit each other.
        UsageError: it holds several tracks, and none was chosen.
        MissingDependencyError: h5py is not installed.
    """
    with open_hdf5(path) as file:
        tracks, nodes = np.asarray(file["tracks"][()], float), names_in(file["node_names"])
        names = names_in(file["track_names"]) if "track_names" in file else ()
        scores = np.asarray(file["point_scores"][()], float) if "point_scores" in file else None
    if tracks.ndim != 4 or tracks.shape[1:3] != (2, len(nodes)):
        raise FileFormatError(
            f"{path}: `tracks` has shape {tracks.shape}, not (tracks, 2, {len(nodes)} nodes, frames); export it anew."
        )
    names = names or tuple(f"track_{i}" for i in range(len(tracks)))
    one = individual_of(request, path, names)
    pixels = np.moveaxis(tracks[one], (0, 1, 2), (2, 1, 0)).copy()
    if request.min_likelihood is not None and scores is not None:
        pixels[request.min_likelihood > scores[one].T] = np.nan
    return CameraKeypoints(nodes, np.arange(len(pixels)), pixels)


FORMAT = keypoint_format("sleap", "SLEAP's analysis file (HDF5)", is_sleap_h5, read_sleap_h5)
