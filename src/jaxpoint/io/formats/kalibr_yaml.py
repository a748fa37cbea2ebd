"""Kalibr's camera chain (`camchain.yaml`): metres, one table a camera, `cam0`, `cam1`, ...

`T_cn_cnm1` goes from the camera before to this one; where it is missing, `T_cam_imu` (IMU to camera, or OpenVINS'
`T_imu_cam`, its inverse) gives the poses, and the world is the IMU. Lenses: `pinhole` with `radtan` (k1, k2, p1, p2) or
`equidistant` (k1 to k4); omni, eucm, ds and fov are refused by name.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxpoint.errors import FileFormatError
from jaxpoint.io.files import natural_key
from jaxpoint.io.formats.calibration_format import CalibrationFormat, Holds, Request, SourceFile
from jaxpoint.io.formats.fields import (
    camera_entry,
    camera_matrix,
    lens_kind,
    opencv_coefficients,
    pose_of,
    read_image_size,
    read_numbers,
)
from jaxpoint.io.lens_entries import model_of_name
from jaxpoint.io.plain_yaml import parse_yaml
from jaxpoint.io.rig_entries import CameraEntry, SavedCalibration

TITLE = "Kalibr's camchain.yaml"
APART = 1e-4  # of a transformation, above which its two ways are said to differ


def _read(request: Request) -> SavedCalibration:
    file = request.only
    tables = _tables(file)
    poses, notes = _poses(f"{file.path}", tables)
    cameras = [
        _camera(f"{file.path}, {name}: ", name, table, pose) for (name, table), pose in zip(tables.items(), poses)
    ]
    return request.saved(cameras, notes=notes, in_room=False)


def _tables(file: SourceFile) -> dict[str, dict[str, Any]]:
    content = parse_yaml(file.path, file.text)
    content = content if isinstance(content, dict) else {}
    tables = {name: table for name, table in content.items() if re.fullmatch(r"cam\d+", name)}
    if not tables or not all(isinstance(table, dict) for table in tables.values()):
        raise FileFormatError(
            f"{file.path} holds no camera; Kalibr's camera chain has cam0, cam1, ... with intrinsics."
        )
    for name, table in content.items():  # as in 4Seasons, whose T_cam1_cam0 stands beside the cameras
        if (match := re.fullmatch(r"T_cam(\d+)_cam(\d+)", name)) and int(match[1]) == int(match[2]) + 1:
            tables.get(f"cam{match[1]}", {}).setdefault("T_cn_cnm1", table)
    return {name: tables[name] for name in sorted(tables, key=natural_key)}


def _camera(where: str, name: str, table: dict[str, Any], pose: Any) -> CameraEntry:
    model_of_name(where, str(table.get("camera_model", "pinhole")))  # refuses omni and its like by name
    bending = str(table.get("distortion_model", "none"))
    model_of_name(where, bending)
    k = camera_matrix(*read_numbers(where, table, "intrinsics", (4,)).tolist())
    if "resolution" not in table:
        raise FileFormatError(f"{where}'resolution' is missing.")
    size = read_image_size(where, table["resolution"])
    bent = bending not in ("none", "None")
    coefficients = read_numbers(where, table, "distortion_coeffs", (4,)) if bent else []
    return camera_entry(where, name, size, k, coefficients, bending if bent else "", pose)


def _poses(where: str, tables: dict[str, dict[str, Any]]) -> tuple[list[Any], list[str]]:
    """Rotation and translation of each camera, or None; and what is to be said of them."""
    chained = all("T_cn_cnm1" in table for table in list(tables.values())[1:]) and len(tables) > 1
    imu = [_from_imu(f"{where}, {name}: ", table) for name, table in tables.items()]
    if not chained:
        known = all(matrix is not None for matrix in imu)
        return ([(m[:3, :3], m[:3, 3]) for m in imu if m is not None] if known else [None] * len(tables)), []
    matrices = [np.eye(4)]
    for name, table in list(tables.items())[1:]:
        matrices.append(_transformation(f"{where}, {name}: ", table, "T_cn_cnm1") @ matrices[-1])
    return [(m[:3, :3], m[:3, 3]) for m in matrices], _differences(where, matrices, imu)


def _differences(where: str, matrices: list[np.ndarray], imu: list[np.ndarray | None]) -> list[str]:
    apart = 0.0
    for matrix, own in zip(matrices, imu):
        if own is not None and imu[0] is not None:
            apart = max(apart, float(np.abs(own @ np.linalg.inv(imu[0]) - matrix).max()))
    if apart <= APART:
        return []
    return [f"{where}: T_cam_imu differs from T_cn_cnm1 by up to {apart:.2g}; the latter was taken."]


def _from_imu(where: str, table: dict[str, Any]) -> np.ndarray | None:
    if "T_cam_imu" in table:
        return _transformation(where, table, "T_cam_imu")
    return np.linalg.inv(_transformation(where, table, "T_imu_cam")) if "T_imu_cam" in table else None


def _transformation(where: str, table: dict[str, Any], key: str) -> np.ndarray:
    values = read_numbers(where, table, key)
    rigid = values.shape == (4, 4) and np.abs(values[:3, :3] @ values[:3, :3].T - np.eye(3)).max() < 1e-4
    if not rigid or (values[3] != [0, 0, 0, 1]).any():
        raise FileFormatError(f"{where}'{key}' must be a rotation and a translation in 4 x 4 numbers.")
    return values


def _write(saved: SavedCalibration, path: Path) -> Mapping[str, bytes]:
    cameras = saved.entries()
    lines = []
    for i, camera in enumerate(cameras):
        lines.append(f"cam{i}:")
        if i and saved.posed:
            lines += ["  T_cn_cnm1:", *(f"  - {json.dumps(row)}" for row in _step(cameras[i - 1], camera))]
        lines += [f"  {key}: {value}" for key, value in _values(camera, i, len(cameras)).items()]
    return {"camchain.yaml": "\n".join([*lines, ""]).encode()}


def _step(before: CameraEntry, camera: CameraEntry) -> list[list[float]]:
    """T_cn_cnm1."""
    (first, t_first), (second, t_second) = pose_of(before), pose_of(camera)
    turned = second @ first.T
    moved = t_second - turned @ t_first
    return [[*turned[row].tolist(), float(moved[row])] for row in range(3)] + [[0.0, 0.0, 0.0, 1.0]]


def _values(camera: CameraEntry, i: int, count: int) -> dict[str, str]:
    fisheye = lens_kind(camera) == "kannala_brandt"
    bending = list(camera.distortion) if fisheye else opencv_coefficients(TITLE, camera, 4)
    k = np.array(camera.K)
    return {
        "cam_overlaps": json.dumps([other for other in range(count) if other != i]),
        "camera_model": "pinhole",
        "distortion_coeffs": json.dumps(bending),
        "distortion_model": "equidistant" if fisheye else "radtan",
        "intrinsics": json.dumps([k[0, 0], k[1, 1], k[0, 2], k[1, 2]]),
        "resolution": json.dumps(list(camera.size)),
        "rostopic": f"/cam{i}/image_raw",
    }


def _recognise(path: Path, head: str) -> bool:
    return bool(re.search(r"^cam\d+:", head, re.MULTILINE)) and "intrinsics:" in head


FORMAT = CalibrationFormat(
    name="kalibr",
    title=TITLE,
    patterns=("*.yaml", "*.yml"),
    recognise=_recognise,
    holds=Holds(
        room=True,
        lenses="Brown without k3, pinhole, fisheye",
        unit="m",
        poses="T_cn_cnm1, camera to camera",
        world=False,
    ),
    read=_read,
    write=_write,
    rename=lambda names: tuple(f"cam{i}" for i in range(len(names))),
    needs_poses=False,
)
