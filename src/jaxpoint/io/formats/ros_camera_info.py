"""ROS' camera_info (camera_info_manager): one YAML file a camera, with K, the lens, R (rectification) and P.

It has no pose. A pair does: with the rectifications R1, R2 and the baseline B in P2[0, 3] = -fx' B, in metres,
x_2 = R2^T (R1 x_1 + (-B, 0, 0)). Lenses: plumb_bob (k1, k2, p1, p2, k3), rational_polynomial (8) and equidistant (4).
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxpoint.errors import FileFormatError
from jaxpoint.io.formats.calibration_format import CalibrationFormat, Holds, Request, SourceFile, relative_frame
from jaxpoint.io.formats.fields import (
    camera_entry,
    lens_kind,
    opencv_coefficients,
    pose_of,
    read_numbers,
    width_and_height,
)
from jaxpoint.io.formats.names import file_stems
from jaxpoint.io.lens_entries import model_of_name
from jaxpoint.io.plain_yaml import parse_yaml
from jaxpoint.io.rig_entries import CameraEntry, SavedCalibration

TITLE = "ROS' camera_info"


def _read(request: Request) -> SavedCalibration:
    tables = [_table(file) for file in request.files]
    names = [str(table.get("camera_name", file.path.stem)) for table, file in zip(tables, request.files)]
    if len(set(names)) != len(names):
        names = [file.path.stem for file in request.files]
    poses = _poses(request.files, tables)
    cameras = [
        _camera(f"{file.path}: ", table, name, pose)
        for file, table, name, pose in zip(request.files, tables, names, poses)
    ]
    return request.saved(cameras, in_room=False)


def _table(file: SourceFile) -> dict[str, Any]:
    content = parse_yaml(file.path, file.text)
    if not isinstance(content, dict) or "camera_matrix" not in content:
        raise FileFormatError(f"{file.path} is no camera_info: it has no camera_matrix.")
    return content


def _camera(where: str, table: dict[str, Any], name: str, pose: Any) -> CameraEntry:
    model = str(table.get("distortion_model", "plumb_bob"))
    model_of_name(where, model)
    size = width_and_height(where, table, ("image_width", "image_height"))
    matrix, bending = (
        read_numbers(where, table, "camera_matrix", (3, 3)),
        read_numbers(where, table, "distortion_coefficients"),
    )
    return camera_entry(where, name, size, matrix, bending.ravel(), model, pose)


def _poses(files: tuple[SourceFile, ...], tables: list[dict[str, Any]]) -> list[Any]:
    """Poses of a pair that share a baseline; none of anything else."""
    if len(tables) != 2 or not all({"projection_matrix", "rectification_matrix"} <= table.keys() for table in tables):
        return [None] * len(tables)
    found = []
    for file, table in zip(files, tables):
        projection = read_numbers(f"{file.path}: ", table, "projection_matrix", (3, 4))
        rectified = read_numbers(f"{file.path}: ", table, "rectification_matrix", (3, 3))
        if projection[0, 0] <= 0 or projection[1, 1] <= 0:
            return [None] * len(tables)
        found.append((rectified, projection[:, 3] / [projection[0, 0], projection[1, 1], 1.0]))
    (first, t_first), (second, t_second) = found
    if not np.abs(t_second - t_first).max() > 0:
        return [None] * len(tables)
    return [(np.eye(3), first.T @ t_first), (second.T @ first, second.T @ t_second)]


def _write(saved: SavedCalibration, path: Path) -> Mapping[str, bytes]:
    cameras = saved.entries()
    rectified = _rectified(cameras) if len(cameras) == 2 and saved.posed else [None] * len(cameras)
    stems = file_stems(saved.rig.names)
    return {f"{s}.yaml": _text(c, part).encode() for s, c, part in zip(stems, cameras, rectified)}


def _lost(saved: SavedCalibration) -> list[str]:
    if not saved.posed:
        return []
    if len(saved.rig) == 2:
        return [relative_frame(TITLE, saved)]
    return [f"{TITLE} has no place for the poses of {len(saved.rig)} cameras, only of a pair: they are lost."]


def _rectified(cameras: list[CameraEntry]) -> list[tuple[np.ndarray, np.ndarray]]:
    """R and P of a pair: x along the baseline, z as near to the optical axes as that allows, one pinhole for both."""
    (first, t_first), (second, t_second) = (pose_of(camera) for camera in cameras)
    turned = second @ first.T
    baseline = -turned.T @ (t_second - turned @ t_first)  # of the second camera's centre, in the first one's axes
    length = float(np.linalg.norm(baseline))
    across = baseline / length * (1.0 if baseline[0] >= 0 else -1.0)
    down = np.cross(np.array([0.0, 0.0, 1.0]) + turned.T[:, 2], across)
    down /= np.linalg.norm(down)
    rotation = np.stack([across, down, np.cross(across, down)])
    k = np.mean([np.array(camera.K) for camera in cameras], axis=0)
    k[0, 0] = k[1, 1] = (k[0, 0] + k[1, 1]) / 2
    moved = -length if baseline[0] >= 0 else length
    shifts = np.zeros((2, 3, 1))
    shifts[1, 0, 0] = k[0, 0] * moved
    return [(r, np.hstack([k, shift])) for r, shift in zip((rotation, rotation @ turned.T), shifts)]


def _text(camera: CameraEntry, rectified: tuple[np.ndarray, np.ndarray] | None) -> str:
    k = np.array(camera.K)
    rotation, projection = rectified or (np.eye(3), np.hstack([k, np.zeros((3, 1))]))
    fisheye = lens_kind(camera) == "kannala_brandt"
    bending = list(camera.distortion) if fisheye else opencv_coefficients(TITLE, camera, 8)
    bending = [0.0] * 5 if bending == [0.0] * 4 and not fisheye else bending
    bending = [*bending, 0.0] if len(bending) == 4 and not fisheye else bending
    model = "equidistant" if fisheye else "rational_polynomial" if len(bending) == 8 else "plumb_bob"
    return "\n".join(
        [
            f"image_width: {camera.size[0]}",
            f"image_height: {camera.size[1]}",
            f"camera_name: {json.dumps(camera.name, ensure_ascii=False)}",
            *_matrix("camera_matrix", k),
            f"distortion_model: {model}",
            *_matrix("distortion_coefficients", np.array([bending])),
            *_matrix("rectification_matrix", rotation),
            *_matrix("projection_matrix", projection),
            "",
        ]
    )


def _matrix(name: str, values: np.ndarray) -> list[str]:
    rows, columns = values.shape
    return [f"{name}:", f"  rows: {rows}", f"  cols: {columns}", f"  data: {json.dumps(values.ravel().tolist())}"]


def _recognise(path: Path, head: str) -> bool:
    return all(re.search(rf"^{key}:", head, re.MULTILINE) for key in ("camera_matrix", "projection_matrix"))


FORMAT = CalibrationFormat(
    name="ros",
    title=TITLE,
    patterns=("*.yaml", "*.yml"),
    recognise=_recognise,
    holds=Holds(
        room=True,
        lenses="Brown, pinhole, rational, fisheye",
        unit="m",
        poses="of a pair only: R and P with the baseline",
    ),
    read=_read,
    write=_write,
    more_losses=_lost,
    per_camera=True,
    needs_poses=False,
)
