"""mrcal's `.cameramodel`: one file a camera, a Python dictionary, metres, from reference to camera.

`lensmodel` (`LENSMODEL_PINHOLE`, `LENSMODEL_OPENCV4`, `5`, `8`, or `12` where the last four are 0), `intrinsics` (fx,
fy, cx, cy, coefficients), `extrinsics` (rotation vector, translation) and `imagersize`. Splined, CAHVOR and other
models are refused by name.
"""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxpoint.errors import FileFormatError
from jaxpoint.io.formats.calibration_format import CalibrationFormat, Holds, Request, SourceFile
from jaxpoint.io.formats.fields import (
    camera_entry,
    camera_matrix,
    opencv_coefficients,
    pose_of,
    read_image_size,
    read_numbers,
    rotation_of,
    rotation_vector,
)
from jaxpoint.io.formats.names import file_stem, file_stems
from jaxpoint.io.rig_entries import CameraEntry, SavedCalibration

TITLE = "mrcal's .cameramodel"
COUNTS = {"PINHOLE": 0, "OPENCV4": 4, "OPENCV5": 5, "OPENCV8": 8, "OPENCV12": 12}


def _read(request: Request) -> SavedCalibration:
    return request.saved([_camera(file) for file in request.files])


def _camera(file: SourceFile) -> CameraEntry:
    where = f"{file.path}: "
    table = _table(file)
    model = str(table.get("lensmodel", table.get("lens_model", table.get("distortion_model", ""))))
    short = model.removeprefix("LENSMODEL_").removeprefix("DISTORTION_").replace("NONE", "PINHOLE")
    if short not in COUNTS:
        raise FileFormatError(
            f"{where}this lens cannot be read (model '{model[:60]}'; known are {', '.join(COUNTS)}): convert it first "
            f"by `mrcal-convert-lensmodel LENSMODEL_OPENCV8 {file.path.name}`."
        )
    values = read_numbers(where, table, "intrinsics").ravel()
    if values.size != 4 + COUNTS[short]:
        raise FileFormatError(f"{where}{model} has {4 + COUNTS[short]} intrinsics, not {values.size}.")
    pose = read_numbers(where, table, "extrinsics", (6,))
    size = read_image_size(where, table.get("imagersize", []))
    k = camera_matrix(*values[:4].tolist())
    return camera_entry(where, file.path.stem, size, k, values[4:], "", (rotation_of(where, pose[:3]), pose[3:]))


def _table(file: SourceFile) -> dict[str, Any]:
    try:
        content = ast.literal_eval(file.text.strip())
    except (ValueError, SyntaxError, MemoryError, RecursionError, TypeError):
        content = None
    if not isinstance(content, dict):
        raise FileFormatError(f"{file.path} is not a whole .cameramodel (a dictionary in braces); write it again.")
    return content


def _write(saved: SavedCalibration, path: Path) -> Mapping[str, bytes]:
    return {f"{file_stem(camera.name)}.cameramodel": _text(camera).encode() for camera in saved.entries()}


def _text(camera: CameraEntry) -> str:
    values = opencv_coefficients(TITLE, camera, 8)
    values = values if any(values) else []
    k, (rotation, translation) = np.array(camera.K), pose_of(camera)
    model = f"OPENCV{len(values)}" if values else "PINHOLE"
    intrinsics = [k[0, 0], k[1, 1], k[0, 2], k[1, 2], *values]
    return (
        "{\n"
        f"    'lensmodel':  'LENSMODEL_{model}',\n\n"
        "    # intrinsics are fx,fy,cx,cy,distortion0,distortion1,....\n"
        f"    'intrinsics': {json.dumps(intrinsics)},\n\n"
        "    # extrinsics are rt_fromref\n"
        f"    'extrinsics': {json.dumps([*rotation_vector(rotation), *translation.tolist()])},\n\n"
        f"    'imagersize': {json.dumps(list(camera.size))},\n"
        "}\n"
    )


def _recognise(path: Path, head: str) -> bool:
    """By its key, which stands behind comments that may be long."""
    key = re.search(r"'(lens_?|distortion_)model'\s*:", head) is not None
    return key or (path.suffix.lower() == ".cameramodel" and head.startswith("#"))


FORMAT = CalibrationFormat(
    name="mrcal",
    title=TITLE,
    patterns=("*.cameramodel",),
    recognise=_recognise,
    holds=Holds(lenses="Brown, pinhole, rational", unit="m", poses="camera from reference"),
    read=_read,
    write=_write,
    rename=file_stems,
    per_camera=True,
)
