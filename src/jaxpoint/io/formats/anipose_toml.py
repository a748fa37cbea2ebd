"""anipose's `calibration.toml`, which FreeMoCap and aniposelib share, and caliscope exports.

One table a camera, `cam_0`, `cam_1`, ... with `name`, `size` (width, height), `matrix` (K), `distortions` (k1, k2, p1,
p2, k3; 8 of the rational model; with `fisheye = true` 4), `rotation` (a rotation vector, or a 3 x 3 matrix) and
`translation`, from world to camera; and a table `metadata`. Its lengths are in the unit of the board that was used,
which the file does not say: ours has `unit` in `[metadata]`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w

from jaxpoint.camera.brown import Brown
from jaxpoint.camera.kannala_brandt import KannalaBrandt
from jaxpoint.camera.pinhole import Pinhole
from jaxpoint.camera.rational import Rational
from jaxpoint.camera.rig import CameraRig
from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.io.files import UNITS, StrPath, replacing
from jaxpoint.io.formats.calibration_format import CalibrationFormat, Holds, Request, SourceFile
from jaxpoint.io.formats.fields import lens_kind, no_place, rotation_vector
from jaxpoint.io.formats.toml_cameras import read_toml, toml_camera
from jaxpoint.io.rig_entries import UNSTATED, CameraEntry, SavedCalibration, entries_of

TITLE = "anipose's calibration.toml"
CAMERA_KEYS = {"matrix", "distortions", "rotation", "translation"}  # a table with none of them is something else
MODELS = (Brown, Pinhole, Rational, KannalaBrandt)


def read_calibration_toml(path: StrPath, poses: bool = True) -> SavedCalibration:
    """A rig written by `write_calibration_toml`, anipose, FreeMoCap or caliscope; the cameras in the file's order.

    Millimetres and centimetres become metres where `[metadata]` has such a `unit`; without one the unit is `UNSTATED`.
    `poses` False lets cameras go without.

    Raises:
        FileFormatError: not TOML, no camera, or a missing or wrong value (with its section).
    """
    return _read(Request((SourceFile(Path(path)),), TITLE, poses))


def _read(request: Request) -> SavedCalibration:
    return read_tables(request, UNSTATED)


def read_tables(request: Request, unit: str) -> SavedCalibration:
    """The cameras of all tables but `[metadata]`, in that unit where `[metadata]` does not say another."""
    path = request.only.path
    content = read_toml(path, request.only.text)
    metadata = content.pop("metadata", {})
    metadata = metadata if isinstance(metadata, dict) else {}
    cameras = [
        toml_camera(path, section, table, str(table.get("name", section)), request.poses)
        for section, table in content.items()
        if isinstance(table, dict) and table.keys() & CAMERA_KEYS
    ]
    if not cameras:
        raise FileFormatError(f"{path} holds no camera; expected sections [cam_0], [cam_1], ...")
    unit = str(metadata.get("unit", unit))
    if unit not in (*UNITS, "m", "arbitrary", UNSTATED):
        raise FileFormatError(f"{path}, [metadata]: unit '{unit[:20]}' is none of m, cm, mm and arbitrary.")
    in_room = metadata.get("in_room") is not False
    return request.saved(cameras, unit=unit, provenance=metadata, in_room=in_room)


def write_calibration_toml(
    path: StrPath, rig: CameraRig, *, unit: str = "m", metadata: Mapping[str, Any] | None = None
) -> None:
    """Write a rig as anipose and caliscope read it (`cam_0`, ... in input order), at once or not at all.

    Args:
        unit: of the translations; stands in `[metadata]`.
        metadata: further values of `[metadata]`; anipose knows `adjusted` and `error` (px).

    Raises:
        ValueError: a number is not finite.
        UsageError: the format has no place for a lens of this model.
    """
    for model in rig.lens_models:
        if model not in MODELS:
            raise UsageError(f"calibration.toml has no place for a {model.name} lens; use calibration.json.")
    content = {f"cam_{i}": anipose_table(camera) for i, camera in enumerate(entries_of(rig))}
    content["metadata"] = {"adjusted": True, "error": 0.0, "unit": unit, **(metadata or {})}
    with replacing(path) as file:
        tomli_w.dump(content, file)


def _write(saved: SavedCalibration, path: Path) -> Mapping[str, bytes]:
    content = {f"cam_{i}": anipose_table(camera) for i, camera in enumerate(saved.entries())}
    own_frame = {"in_room": False} if saved.unit == "m" and not saved.in_room else {}
    stated = {} if saved.unit == UNSTATED else {"unit": saved.unit}
    content["metadata"] = {"adjusted": True, "error": 0.0, **stated, **own_frame}
    return {"calibration.toml": tomli_w.dumps(content).encode()}


def anipose_table(camera: CameraEntry) -> dict[str, Any]:
    """One camera's table.

    Raises:
        UsageError: its lens is of another model.
    """
    if lens_kind(camera) not in [model.name for model in MODELS]:
        raise no_place(TITLE, camera)
    pose = {}
    if camera.rotation is not None and camera.translation is not None:
        pose = {"rotation": rotation_vector(camera.rotation), "translation": list(camera.translation)}
    return {
        "name": camera.name,
        "size": list(camera.size),
        "matrix": [list(row) for row in camera.K],
        "distortions": list(camera.distortion) or [0.0] * 5,
        **pose,
        **({"fisheye": True} if lens_kind(camera) == KannalaBrandt.name else {}),
    }


def _recognise(path: Path, head: str) -> bool:
    """Tables with distortions at the top level; Pose2Sim alone writes `fisheye = false`."""
    tables = re.search(r"^\s*\[[^\[\].]+\]\s*$", head, re.MULTILINE)
    return bool(tables and re.search(r"^\s*distortions\s*=", head, re.MULTILINE)) and "fisheye = false" not in head


FORMAT = CalibrationFormat(
    name="anipose",
    title=TITLE,
    patterns=("*.toml",),
    recognise=_recognise,
    holds=Holds(lenses="Brown, pinhole, rational, fisheye", unit="any", room=True),
    read=_read,
    write=_write,
    needs_poses=False,
)
