"""COLMAP's rig configuration (`rig_config.json`, read by its rig_configurator), with camera models.

A list of rigs, each with `cameras`: `image_prefix`, `ref_sensor` (one, whose frame is the rig's), from rig to camera
`cam_from_rig_rotation` (w, x, y, z) and `cam_from_rig_translation`, and `camera_model_name` with `camera_params`. It
holds no image sizes; pixels count from the corner.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxpoint.errors import FileFormatError
from jaxpoint.io.formats.calibration_format import UNSIZED, CalibrationFormat, Holds, Request
from jaxpoint.io.formats.colmap_models import colmap_camera, colmap_model
from jaxpoint.io.formats.fields import pose_of, quaternion_of, read_numbers, rotation_of_quaternion
from jaxpoint.io.formats.names import file_stem, file_stems
from jaxpoint.io.rig_entries import UNSTATED, CameraEntry, SavedCalibration

TITLE = "COLMAP's rig configuration"


def _read(request: Request) -> SavedCalibration:
    path = request.only.path
    content = request.only.json()
    rigs = content if isinstance(content, list) else []
    cameras = rigs[0].get("cameras") if len(rigs) == 1 and isinstance(rigs[0], dict) else None
    if not isinstance(cameras, list) or not cameras or not all(isinstance(camera, dict) for camera in cameras):
        raise FileFormatError(f"{path} must be a list of one rig with its cameras; it holds {len(rigs)} rigs.")
    found = [_camera(f"{path}, cameras[{i}]: ", camera) for i, camera in enumerate(cameras)]
    return request.saved(found, unit=UNSTATED, in_room=False)


def _camera(where: str, table: dict[str, Any]) -> CameraEntry:
    prefix = str(table.get("image_prefix", "")).rstrip("/")
    if "camera_model_name" not in table or "camera_params" not in table:
        raise FileFormatError(
            f"{where}'{prefix}' has no lens here (camera_model_name and camera_params); add it, or give the folder of "
            "COLMAP's text model."
        )
    parameters = read_numbers(where, table, "camera_params").ravel().tolist()
    pose: tuple[Any, Any] = np.eye(3), np.zeros(3)
    if not table.get("ref_sensor"):
        quaternion = read_numbers(where, table, "cam_from_rig_rotation", (4,))
        pose = (
            rotation_of_quaternion(where, quaternion.tolist()),
            read_numbers(where, table, "cam_from_rig_translation", (3,)),
        )
    return colmap_camera(where, prefix.split("/")[-1], UNSIZED, str(table["camera_model_name"]), parameters, pose)


def _write(saved: SavedCalibration, path: Path) -> Mapping[str, bytes]:
    cameras = saved.entries()
    first, t_first = pose_of(cameras[0])
    entries = []
    for i, camera in enumerate(cameras):
        rotation, translation = pose_of(camera)
        turned = rotation @ first.T
        model, parameters = colmap_model(TITLE, camera)
        pose = {
            "cam_from_rig_rotation": quaternion_of(turned),
            "cam_from_rig_translation": (translation - turned @ t_first).tolist(),
        }
        entries.append(
            {
                "image_prefix": f"{file_stem(camera.name)}/",
                **(pose if i else {"ref_sensor": True}),
                "camera_model_name": model,
                "camera_params": [float(value) for value in parameters],
            }
        )
    return {"rig_config.json": json.dumps([{"cameras": entries}], indent=2).encode()}


FORMAT = CalibrationFormat(
    name="colmap-rig",
    title=TITLE,
    patterns=("rig_config*.json", "*rig_config.json"),
    recognise=lambda path, head: re.search(r'"image_prefix"\s*:', head) is not None,
    holds=Holds(
        room=True,
        lenses="Brown, pinhole, rational, fisheye",
        unit=UNSTATED,
        poses="camera from rig",
        pixels="corner",
        sizes=False,
        world=False,
    ),
    read=_read,
    write=_write,
    rename=file_stems,
)
