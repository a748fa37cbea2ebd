"""Pose2Sim's `Calib_*.toml`: metres, one table a camera, from world to camera, `fisheye = false` in each.

Sizes stand as floats, rotations are vectors (nested in files of 2023). Files that Pose2Sim of 2023 and 2024 converted
from Qualisys hold distortions divided by 64, which nothing in them tells.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w

from jaxpoint.io.formats.anipose_toml import read_tables
from jaxpoint.io.formats.calibration_format import CalibrationFormat, Holds, Request
from jaxpoint.io.formats.fields import opencv_coefficients, pose_of, rotation_vector
from jaxpoint.io.rig_entries import CameraEntry, SavedCalibration

TITLE = "Pose2Sim's calibration TOML"


def _read(request: Request) -> SavedCalibration:
    return read_tables(request, "m")


def _write(saved: SavedCalibration, path: Path) -> Mapping[str, bytes]:
    content: dict[str, Any] = {_section(i, name): {} for i, name in enumerate(saved.rig.names)}
    for section, camera in zip(list(content), saved.entries()):
        content[section] = _table(camera)
    content["metadata"] = {"adjusted": False, "error": 0.0}
    return {"Calib.toml": tomli_w.dumps(content).encode()}


def _section(i: int, name: str) -> str:
    return f"cam_{i + 1:02d}" if name == "metadata" else name


def _table(camera: CameraEntry) -> dict[str, Any]:
    rotation, translation = pose_of(camera)
    return {
        "name": camera.name,
        "size": [float(side) for side in camera.size],
        "matrix": [list(row) for row in camera.K],
        "distortions": opencv_coefficients(TITLE, camera, 8),
        "rotation": rotation_vector(rotation),
        "translation": translation.tolist(),
        "fisheye": False,
    }


def _recognise(path: Path, head: str) -> bool:
    return bool(re.search(r"^\s*distortions\s*=", head, re.MULTILINE)) and "fisheye = false" in head


FORMAT = CalibrationFormat(
    name="pose2sim",
    title=TITLE,
    patterns=("Calib*.toml",),
    recognise=_recognise,
    holds=Holds(lenses="Brown, pinhole, rational", unit="m"),
    read=_read,
    write=_write,
)
