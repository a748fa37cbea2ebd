"""Keypoints of one camera in DeepLabCut's HDF5 files, which pandas wrote as tables of PyTables.

A table has a column of frames (numbers, or names of labelled images) and blocks of values; which column of a block is
what stands pickled in its attributes, as a list of names. Only lists, tuples and text are taken from there.
"""

from __future__ import annotations

import io
import pickle
from pathlib import Path
from typing import Any

import numpy as np

from jaxpoint.errors import FileFormatError
from jaxpoint.io.track_formats.deeplabcut_csv import Column, keypoints_of
from jaxpoint.io.track_formats.hdf5 import is_hdf5, open_hdf5
from jaxpoint.io.track_formats.keypoint_cameras import CameraKeypoints, frame_of_image, keypoint_format
from jaxpoint.io.track_formats.track_format import TrackRequest


class _TextOnly(pickle.Unpickler):
    """Reads lists, tuples, numbers and text; whatever would run code is refused."""

    def find_class(self, module_name: str, global_name: str) -> Any:
        raise pickle.UnpicklingError(f"{module_name}.{global_name}")


def is_deeplabcut_h5(path: Path, head: str) -> bool:
    """Whether PyTables wrote it, which says so near the beginning."""
    if not is_hdf5(path):
        return False
    with path.open("rb") as file:
        return b"PYTABLES_FORMAT_VERSION" in file.read(1 << 16)


def read_deeplabcut_h5(request: TrackRequest, path: Path) -> CameraKeypoints:
    """The keypoints of one file; those below `request.min_likelihood` (by default 0.6) are not seen.

    Raises:
        FileFormatError: it is not such a table.
        UsageError: it holds several individuals, and none was chosen.
        MissingDependencyError: h5py is not installed.
    """
    with open_hdf5(path) as file:
        tables = [group["table"] for group in file.values() if "table" in group]
        if len(tables) != 1 or "index" not in (tables[0].dtype.names or ()):
            raise FileFormatError(f"{path} is no table of one camera as DeepLabCut writes it; export it as CSV.")
        rows, attributes = tables[0][()], tables[0].attrs
        blocks = [name for name in rows.dtype.names if name.startswith("values_block_")]
        columns = [column for block in blocks for column in _columns(path, attributes[f"{block}_kind"])]
        values = np.concatenate([np.asarray(rows[block], float).reshape(len(rows), -1) for block in blocks], axis=1)
    index = rows["index"]
    if index.dtype.kind == "S":
        frames = [frame_of_image(path, name.decode()) for name in index.tolist()]
    else:
        frames = index.astype(int)
    return keypoints_of(request, path, columns, np.asarray(frames), values)


def _columns(path: Path, pickled: Any) -> list[Column]:
    """Individual, bodypart and coordinate of each column of a block."""
    try:
        labels = _TextOnly(io.BytesIO(bytes(pickled))).load()
    except (pickle.UnpicklingError, EOFError, ValueError, IndexError, KeyError):
        raise FileFormatError(f"{path}: the names of its columns cannot be read; export it as CSV.") from None
    if not all(isinstance(label, tuple) and len(label) in (3, 4) for label in labels):
        raise FileFormatError(f"{path}: its columns are not scorer, bodypart and coordinate; export it as CSV.")
    return [(label[1] if len(label) == 4 else "", label[-2], label[-1]) for label in labels]


FORMAT = keypoint_format("deeplabcut-h5", "DeepLabCut's HDF5", is_deeplabcut_h5, read_deeplabcut_h5)
