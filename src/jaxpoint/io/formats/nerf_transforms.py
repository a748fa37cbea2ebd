"""nerfstudio's and instant-ngp's `transforms.json`: one frame a camera, from camera to world in OpenGL's camera axes.

`transform_matrix` (4 x 4, perhaps with a scale) has x right, y up, z backwards; intrinsics (`fl_x`, `fl_y`, `cx`, `cy`,
`w`, `h`, `k1`, `k2`, `k3`, `p1`, `p2`, or with `OPENCV_FISHEYE` k1 to k4) stand in a frame or for all; Blender's
`camera_angle_x` stands for a focal length. Pixels count from the corner of the image; the unit is not stated.
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
from jaxpoint.io.formats.fields import (
    camera_entry,
    camera_matrix,
    lens_kind,
    opencv_coefficients,
    pose_of,
    read_image_size,
    read_numbers,
)
from jaxpoint.io.formats.names import file_stem, file_stems, shortest_names
from jaxpoint.io.rig_entries import UNSTATED, CameraEntry, SavedCalibration

TITLE = "nerfstudio's transforms.json"
CORNER = 0.5  # px: the centre of the first pixel there
OPENGL = np.diag([1.0, -1.0, -1.0])  # between x right, y up, z back and x right, y down, z forward
MODELS = {"OPENCV": "", "PINHOLE": "", "SIMPLE_PINHOLE": "", "OPENCV_FISHEYE": "fisheye"}


def _read(request: Request) -> SavedCalibration:
    path = request.only.path
    content = request.only.json()
    frames = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(frames, list) or not frames or not all(isinstance(frame, dict) for frame in frames):
        raise FileFormatError(f"{path} holds no frame; transforms.json has 'frames' with a transform_matrix each.")
    common = {key: value for key, value in content.items() if key != "frames"}
    names = shortest_names([str(frame.get("file_path", f"frame_{i}")) for i, frame in enumerate(frames)])
    cameras = [
        _camera(f"{path}, frames[{i}]: ", name, common | frame, request.size)
        for i, (frame, name) in enumerate(zip(frames, names))
    ]
    return request.saved(cameras, unit=UNSTATED)


def _camera(where: str, name: str, table: dict[str, Any], given: tuple[int, int] | None) -> CameraEntry:
    model = str(table.get("camera_model", "OPENCV_FISHEYE" if table.get("is_fisheye") is True else "OPENCV"))
    if model not in MODELS:
        raise FileFormatError(
            f"{where}this lens cannot be read (model '{model}'; known are {', '.join(MODELS)}): calibrate without it."
        )
    size = read_image_size(where, [table["w"], table["h"]]) if "w" in table and "h" in table else given or UNSIZED
    k = _intrinsics(where, table, size)
    pose = _pose(where, table)
    return camera_entry(where, name, size, k, _coefficients(where, table, model), MODELS[model], pose)


def _intrinsics(where: str, table: dict[str, Any], size: tuple[int, int]) -> np.ndarray:
    width, height = size
    if "fl_x" in table:
        fx = float(read_numbers(where, table, "fl_x", ()))
    elif size == UNSIZED:  # a size is asked for later
        return np.eye(3)
    else:
        angle = float(read_numbers(where, table, "camera_angle_x", ()))
        if not 0 < angle < np.pi:
            raise FileFormatError(f"{where}camera_angle_x is {angle:.4g} rad; it must lie between 0 and pi.")
        fx = width / 2 / np.tan(angle / 2)
    fy = float(read_numbers(where, table, "fl_y", ())) if "fl_y" in table else fx
    cx, cy = (
        float(read_numbers(where, {key: half, **table}, key, ()))
        for key, half in (("cx", width / 2), ("cy", height / 2))
    )
    return camera_matrix(fx, fy, cx - CORNER, cy - CORNER)


def _coefficients(where: str, table: dict[str, Any], model: str) -> list[float]:
    k1, k2, k3, k4, p1, p2 = (
        float(read_numbers(where, {key: 0.0, **table}, key, ())) for key in ("k1", "k2", "k3", "k4", "p1", "p2")
    )
    if model == "OPENCV_FISHEYE":
        return [k1, k2, k3, k4]
    if k4 != 0:
        raise FileFormatError(f"{where}k4 is {k4:.4g}, of r^8, which no lens here has; calibrate that lens anew.")
    return [k1, k2, p1, p2, k3]


def _pose(where: str, table: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    matrix = read_numbers(where, table, "transform_matrix", (4, 4))
    scale = np.cbrt(np.linalg.det(matrix[:3, :3]))
    if not scale > 0 or np.abs(matrix[:3, :3] @ matrix[:3, :3].T / scale**2 - np.eye(3)).max() > 1e-4:
        raise FileFormatError(f"{where}transform_matrix is no rotation with a scale.")
    rotation = OPENGL @ (matrix[:3, :3] / scale).T
    return rotation, -rotation @ matrix[:3, 3]


def _write(saved: SavedCalibration, path: Path) -> Mapping[str, bytes]:
    frames = [_frame(camera) for camera in saved.entries()]
    models = {frame["camera_model"] for frame in frames}
    common = {"camera_model": models.pop()} if len(models) == 1 else {}  # nerfstudio looks for it at the top
    content = {**common, "frames": frames}
    return {"transforms.json": json.dumps(content, indent=2).encode()}


def _frame(camera: CameraEntry) -> dict[str, Any]:
    rotation, translation = pose_of(camera)
    matrix = np.eye(4)
    matrix[:3, :3] = rotation.T @ OPENGL
    matrix[:3, 3] = -rotation.T @ translation
    k = np.array(camera.K)
    if lens_kind(camera) == "kannala_brandt":
        model, names, values = "OPENCV_FISHEYE", ("k1", "k2", "k3", "k4"), camera.distortion
    else:
        model, names, values = "OPENCV", ("k1", "k2", "p1", "p2", "k3"), opencv_coefficients(TITLE, camera, 5)
    return {
        "file_path": f"images/{file_stem(camera.name)}.png",
        "camera_model": model,
        "w": camera.size[0],
        "h": camera.size[1],
        "fl_x": k[0, 0],
        "fl_y": k[1, 1],
        "cx": k[0, 2] + CORNER,
        "cy": k[1, 2] + CORNER,
        **{str(name): value for name, value in zip(names, values)},
        "transform_matrix": matrix.tolist(),
    }


FORMAT = CalibrationFormat(
    name="nerfstudio",
    title=TITLE,
    patterns=("transforms*.json", "*transforms.json"),
    recognise=lambda path, head: re.search(r'"transform_matrix"\s*:', head) is not None,
    holds=Holds(
        lenses="Brown, pinhole, fisheye", unit=UNSTATED, poses="world from camera, OpenGL axes", pixels="corner"
    ),
    read=_read,
    write=_write,
    rename=file_stems,
)
