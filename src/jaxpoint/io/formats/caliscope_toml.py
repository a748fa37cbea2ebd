"""caliscope's `camera_array.toml`: metres, one table `cameras.N` a camera, from world to camera.

Each has `cam_id`, `size`, `matrix`, `distortions`, `rotation` (a rotation vector, or a 3 x 3 matrix), `translation` and
`ignore`; in ours, cameras whose names say no number are numbered in order.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w

from jaxpoint.errors import FileFormatError
from jaxpoint.io.files import StrPath, natural_key
from jaxpoint.io.formats.anipose_toml import anipose_table
from jaxpoint.io.formats.calibration_format import CalibrationFormat, Holds, Request, SourceFile
from jaxpoint.io.formats.toml_cameras import read_toml, toml_camera, toml_size
from jaxpoint.io.rig_entries import SavedCalibration

TITLE = "caliscope's camera_array.toml"


def read_camera_array(path: StrPath, poses: bool = True) -> SavedCalibration:
    """The cameras of caliscope's `camera_array.toml` (metres), named cam_<id>; ignored cameras are left out.

    Raises:
        FileFormatError: not such a file, or a missing or wrong value (with its section).
    """
    return _read(Request((SourceFile(Path(path)),), TITLE, poses))


def _read(request: Request) -> SavedCalibration:
    file = request.only
    cameras = [
        toml_camera(file.path, f"cameras.{key}", table, f"cam_{key}", request.poses)
        for key, table in _tables(file).items()
    ]
    return request.saved(cameras)


def read_camera_array_sizes(path: StrPath) -> dict[str, tuple[int, int]]:
    """Width and height (px) of each camera of `camera_array.toml`, calibrated or not.

    Raises:
        FileFormatError: not such a file, or a size is missing or wrong.
    """
    file = SourceFile(Path(path))
    return {f"cam_{key}": toml_size(f"{path}, [cameras.{key}]: ", table) for key, table in _tables(file).items()}


def _tables(file: SourceFile) -> dict[str, dict[str, Any]]:
    cameras = read_toml(file.path, file.text).get("cameras")
    if not isinstance(cameras, dict) or not all(isinstance(table, dict) for table in cameras.values()):
        raise FileFormatError(f"{file.path} is no camera_array.toml; expected sections [cameras.0], [cameras.1], ...")
    kept = {key: table for key, table in cameras.items() if not table.get("ignore", False)}
    return {key: kept[key] for key in sorted(kept, key=natural_key)}


def _rename(names: tuple[str, ...]) -> tuple[str, ...]:
    """cam_N stays where all are called so; else they are numbered in order."""
    kept = all(re.fullmatch(r"cam_(0|[1-9]\d*)", name) for name in names)
    return names if kept else tuple(f"cam_{i}" for i in range(len(names)))


def _write(saved: SavedCalibration, path: Path) -> Mapping[str, bytes]:
    numbers = [name.removeprefix("cam_") for name in _rename(saved.rig.names)]
    tables = {
        number: {"cam_id": int(number), "rotation_count": 0, "ignore": False, **anipose_table(camera)}
        for number, camera in zip(numbers, saved.entries())
    }
    return {"camera_array.toml": tomli_w.dumps({"cameras": tables}).encode()}


FORMAT = CalibrationFormat(
    name="caliscope",
    title=TITLE,
    patterns=("camera_array.toml",),
    recognise=lambda path, head: re.search(r"^\s*\[cameras\.[^\].]+\]\s*$", head, re.MULTILINE) is not None,
    holds=Holds(lenses="Brown, pinhole, rational, fisheye", unit="m"),
    read=_read,
    write=_write,
    needs_poses=False,
    rename=_rename,
)
