"""OpenCV's FileStorage (YAML, XML, JSON) as its calibration samples write it.

One camera: `camera_matrix`, `distortion_coefficients`, `image_width`, `image_height`, with `fisheye_model: 1` those of
cv::fisheye. A pair: `M1`, `D1`, `M2`, `D2` (or `K1`, `K2`), `R`, `T` with x_2 = R x_1 + T, in one file or in two
(`intrinsics.yml`, `extrinsics.yml`); it stores no image size, and its unit is that of the board. Ours adds
`camera_name1`, `image_size1`, ... to a pair; more cameras are one file each, with `R` and `T` from world to camera.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxpoint.errors import FileFormatError
from jaxpoint.io.formats.calibration_format import UNSIZED, CalibrationFormat, Holds, Request, relative_frame
from jaxpoint.io.formats.fields import (
    camera_entry,
    lens_kind,
    no_place,
    opencv_coefficients,
    pose_of,
    read_image_size,
    read_numbers,
    rotation_of,
    width_and_height,
)
from jaxpoint.io.formats.names import file_stems
from jaxpoint.io.formats.storage_tree import encode_storage, parse_storage
from jaxpoint.io.rig_entries import UNSTATED, CameraEntry, SavedCalibration

TITLE = "OpenCV's FileStorage"
MATRIX, DISTORTION = ("cameramatrix", "k", "m"), ("distortioncoefficients", "distcoeffs", "d")
SAME = 1e-6  # relative difference of a value that two files of a pair hold
NEEDS = (
    "it needs camera_matrix, distortion_coefficients, image_width and image_height of one camera, or M1, D1, M2, D2, R "
    "and T of a pair"
)


def _read(request: Request) -> SavedCalibration:
    tables = [(file.path, _plain(parse_storage(file.path, file.text))) for file in request.files]
    if any(_key(table, MATRIX, "1") or _key(table, MATRIX, "2") for _, table in tables):
        return _read_pair(request, _merged([table for _, table in tables], request.where))
    cameras = [_camera(f"{path}: ", table, str(table.get("cameraname", path.stem))) for path, table in tables]
    return request.saved(cameras, unit=UNSTATED)


def _plain(table: Mapping[str, Any]) -> dict[str, Any]:
    """Names without capitals and underscores, which differ between versions."""
    return {re.sub(r"_", "", name).lower(): value for name, value in table.items()}


def _key(table: Mapping[str, Any], names: tuple[str, ...], ending: str) -> str | None:
    """The name of a matrix; k1 may also be a single coefficient."""
    return next((n + ending for n in names if isinstance(table.get(n + ending), Mapping | list)), None)


def _merged(tables: list[dict[str, Any]], where: str) -> dict[str, Any]:
    """One table of the files of a pair, which must not contradict each other."""
    merged: dict[str, Any] = {}
    for table in tables:
        for name, value in table.items():
            if name in merged and isinstance(value, Mapping) and isinstance(merged[name], Mapping):
                one, other = (read_numbers(f"{where}: ", {name: part}, name) for part in (merged[name], value))
                if one.shape != other.shape or np.abs(one - other).max() > SAME * max(np.abs(one).max(), 1e-12):
                    raise FileFormatError(
                        f"{where}: the files hold different values of '{name}'; name those of one run."
                    )
            merged.setdefault(name, value)
    return merged


def _read_pair(request: Request, table: dict[str, Any]) -> SavedCalibration:
    where = f"{request.where}: "
    posed = "r" in table and "t" in table
    rotation = rotation_of(where, read_numbers(where, table, "r")) if posed else None
    second = (rotation, read_numbers(where, table, "t", (3,))) if posed else None
    first = (np.eye(3), np.zeros(3)) if posed else None
    cameras = [_camera(where, table, f"cam_{i}", str(i), pose) for i, pose in ((1, first), (2, second))]
    return request.saved(cameras, unit=UNSTATED, in_room=False)


def _camera(
    where: str, table: dict[str, Any], name: str, ending: str = "", pose: tuple[Any, Any] | None = None
) -> CameraEntry:
    matrix, bending = _key(table, MATRIX, ending), _key(table, DISTORTION, ending)
    if matrix is None or bending is None:
        missing = "M" if matrix is None else "D"
        raise FileFormatError(f"{where}there is no lens here (no {missing}{ending}); {NEEDS}, as OpenCV writes them.")
    if "xi" in table or f"xi{ending}" in table:
        raise FileFormatError(
            f"{where}this lens cannot be read (model 'omnidir', with xi): calibrate it anew with "
            "cv::calibrateCamera or cv::fisheye, or calibrate without it."
        )
    if pose is None and not ending and "r" in table and "t" in table:
        pose = rotation_of(where, read_numbers(where, table, "r")), read_numbers(where, table, "t", (3,))
    return camera_entry(
        where,
        str(table.get(f"cameraname{ending}", name)),
        _size(where, table, ending),
        read_numbers(where, table, matrix, (3, 3)),
        read_numbers(where, table, bending).ravel(),
        _model(where, table, bending),
        pose,
    )


def _model(where: str, table: dict[str, Any], bending: str) -> str:
    """The lens model; four coefficients in a plain list are cv::fisheye's (Vec4d), but nothing says so."""
    for name in ("distortionmodel", "cameramodel"):
        if isinstance(table.get(name), str):
            return table[name]
    if "fisheyemodel" in table:
        return "fisheye" if table["fisheyemodel"] else ""
    if isinstance(table[bending], list) and len(table[bending]) == 4:
        raise FileFormatError(
            f"{where}'{bending.upper()}' is a plain list of 4 coefficients, as cv::fisheye writes its own, and "
            "nothing says of which model they are; add 'fisheye_model: 1' to the file, or "
            "'fisheye_model: 0' for k1, k2, p1, p2."
        )
    return ""


def _size(where: str, table: dict[str, Any], ending: str) -> tuple[int, int]:
    for name in (f"imagesize{ending}", f"size{ending}", "imagesize", "size"):
        if name in table:
            return read_image_size(where, table[name])
    if "imagewidth" in table or "imageheight" in table:
        return width_and_height(where, table, ("imagewidth", "imageheight"))
    return UNSIZED


def _write(saved: SavedCalibration, path: Path) -> Mapping[str, bytes]:
    cameras = saved.entries()
    suffix = path.suffix.lower() if path.suffix.lower() in (".xml", ".json") else ".yml"
    if len(cameras) == 2 and saved.posed:
        return {f"stereo{suffix}": encode_storage(path, _pair(cameras))}
    return {f"{s}{suffix}": encode_storage(path, _single(c)) for s, c in zip(file_stems(saved.rig.names), cameras)}


def _lost(saved: SavedCalibration) -> list[str]:
    if saved.posed and len(saved.rig) == 2:
        return [relative_frame(TITLE, saved)]
    unsaid = saved.posed and not saved.in_room
    return [f"{TITLE} does not say of {len(saved.rig)} cameras that their frame is not the room's."] if unsaid else []


def _lens(camera: CameraEntry) -> tuple[np.ndarray, np.ndarray, int]:
    """K, coefficients in a row, and whether they are cv::fisheye's."""
    if lens_kind(camera) == "kannala_brandt":
        return np.array(camera.K), np.array([camera.distortion]), 1
    values = opencv_coefficients(TITLE, camera, 8)
    return np.array(camera.K), np.array([values + [0.0] * (5 - len(values))]), 0


def _single(camera: CameraEntry) -> dict[str, Any]:
    matrix, bending, fisheye = _lens(camera)
    values = {
        "camera_name": camera.name,
        "image_width": camera.size[0],
        "image_height": camera.size[1],
        "fisheye_model": fisheye,
        "camera_matrix": matrix,
        "distortion_coefficients": bending,
    }
    if camera.rotation is None:
        return values
    rotation, translation = pose_of(camera)
    return values | {"R": rotation, "T": translation.reshape(3, 1)}


def _pair(cameras: list[CameraEntry]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for i, camera in enumerate(cameras, start=1):
        matrix, bending, fisheye = _lens(camera)
        if values.setdefault("fisheye_model", fisheye) != fisheye:
            raise no_place(TITLE, camera)
        values |= {f"camera_name{i}": camera.name, f"image_size{i}": np.array([camera.size]), f"M{i}": matrix}
        values[f"D{i}"] = bending
    (first, t_first), (second, t_second) = (pose_of(camera) for camera in cameras)
    turned = second @ first.T
    return values | {"R": turned, "T": (t_second - turned @ t_first).reshape(3, 1)}


def _recognise(path: Path, head: str) -> bool:
    """By the names of its matrices; ROS, Kalibr and EasyMocap have some of them too."""
    named = "(M[12]|K[12]?|R|[Cc]amera_?[Mm]atrix[12]?)"
    start = head.lstrip()[:1]
    if start == "{":
        return '"opencv-matrix"' in head and re.search(rf'"{named}"\s*:', head) is not None
    if start == "<":
        return "<opencv_storage" in head and re.search(rf"<{named}[\s>]", head) is not None
    other = re.search(r"^(projection_matrix|cam\d+):|^(K|Rot|T)_\S+:\s*!!opencv-matrix", head, re.MULTILINE)
    return other is None and re.search(rf"^{named}\s*:", head, re.MULTILINE) is not None


FORMAT = CalibrationFormat(
    name="opencv",
    title=TITLE,
    patterns=("*.yml", "*.yaml", "*.xml", "*.json"),
    recognise=_recognise,
    holds=Holds(
        room=True, lenses="Brown, pinhole, rational, fisheye", unit=UNSTATED, poses="x_2 = R x_1 + T of a pair"
    ),
    read=_read,
    write=_write,
    more_losses=_lost,
    per_camera=True,
    needs_poses=False,
)
