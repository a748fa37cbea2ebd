"""Folders of MultiCamSelfCal and of the programs that took over its files (flydra).

`cameraN.Pmat.cal` (P, 3 x 4), `*N.rad` (K11 to K33, kc1 to kc4: k1, k2, p1, p2), `Res.dat` (width, height, a line a
camera) and, where there are any, `camera_order.txt` (names) and `calibration_units.txt`. P maps to pixels that the lens
of `.rad` has undistorted. The `.cal` files of the same run hold the same with six decimals, and are not read.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from jaxpoint.errors import FileFormatError
from jaxpoint.io.files import natural_key
from jaxpoint.io.formats.calibration_format import CalibrationFormat, Holds, Request, SourceFile
from jaxpoint.io.formats.fields import camera_entry, opencv_coefficients, pose_of, read_image_size
from jaxpoint.io.formats.projection_cameras import Misfit, camera_of_projection, mirror_notes, notes_of
from jaxpoint.io.rig_entries import UNSTATED, CameraEntry, SavedCalibration
from jaxpoint.io.svoboda import read_matrix, read_rad

TITLE = "MultiCamSelfCal's folder"
UNITS_THERE = {"millimeters": "mm", "centimeters": "cm", "meters": "m", "mm": "mm", "cm": "cm", "m": "m"}
OTHERS = ("res.dat", "camera_order.txt", "calibration_units.txt")


def _read(request: Request) -> SavedCalibration:
    files = sorted(request.files, key=lambda file: natural_key(file.path.name))
    matrices = [file for file in files if file.path.name.lower().endswith(".pmat.cal")]
    lenses = [read_rad(file.path) for file in files if file.path.suffix.lower() == ".rad"]
    count = len(matrices) or len(lenses)
    if not count or (lenses and len(lenses) != count):
        raise FileFormatError(
            f"{request.where} holds {len(matrices)} .Pmat.cal and {len(lenses)} .rad files; it needs one of each "
            "a camera."
        )
    others = {file.path.name.lower(): file for file in files if file.path.name.lower() in OTHERS}
    names, sizes = _names(others, count), _sizes(request, others, count)
    if not matrices:
        cameras = [camera_entry(request.where, name, size, *lens) for name, size, lens in zip(names, sizes, lenses)]
        return request.saved(cameras, unit=UNSTATED)
    found = [
        _camera(file, name, size, lens)
        for file, name, size, lens in zip(matrices, names, sizes, lenses or [(None, None)] * count)
    ]
    notes = notes_of(f"{request.where}: one lens was fitted to each camera's P and .rad", [off for _, off in found])
    cameras = [camera for camera, _ in found]
    notes += mirror_notes(request.where, cameras)
    return request.saved(cameras, unit=_unit(others), notes=notes)


def _camera(file: SourceFile, name: str, size: tuple[int, int], lens: tuple) -> tuple[CameraEntry, Misfit]:
    projection = read_matrix(file.path)
    if projection.shape != (3, 4):
        rows, columns = projection.shape
        raise FileFormatError(f"{file.path} is {rows} x {columns}; a projection matrix is 3 x 4.")
    return camera_of_projection(f"{file.path}: ", name, size, projection, *lens)


def _names(others: Mapping[str, SourceFile], count: int) -> list[str]:
    file = others.get("camera_order.txt")
    names = [line.strip() for line in file.text.splitlines() if line.strip()] if file else []
    if file and len(names) != count:
        raise FileFormatError(f"{file.path} names {len(names)} cameras, and there are {count}; write one a line.")
    return names or [f"cam_{i}" for i in range(count)]


def _sizes(request: Request, others: Mapping[str, SourceFile], count: int) -> list[tuple[int, int]]:
    file = others.get("res.dat")
    if file is None:
        return [request.needed_size("the cameras (there is no Res.dat)")] * count
    sizes = read_matrix(file.path)
    if sizes.shape != (count, 2):
        raise FileFormatError(f"{file.path} is {sizes.shape[0]} x {sizes.shape[1]}; {count} cameras need {count} x 2.")
    return [read_image_size(f"{file.path}: ", row.tolist()) for row in sizes]


def _unit(others: Mapping[str, SourceFile]) -> str:
    file = others.get("calibration_units.txt")
    word = " ".join(file.text.lower().split()) if file else ""
    if file and word not in UNITS_THERE:
        raise FileFormatError(f"{file.path} says '{word[:20]}'; it must be one of {', '.join(UNITS_THERE)}.")
    return UNITS_THERE.get(word, UNSTATED)


def _write(saved: SavedCalibration, path: Path) -> Mapping[str, bytes]:
    files: dict[str, list[str]] = {}
    cameras = saved.entries()
    for i, camera in enumerate(cameras, start=1):
        rotation, translation = pose_of(camera)
        projection = np.array(camera.K) @ np.hstack([rotation, translation[:, None]])
        files[f"camera{i}.Pmat.cal"] = [" ".join(map(repr, row)) for row in projection.tolist()]
        values = opencv_coefficients(TITLE, camera, 4)
        k = {f"K{r + 1}{c + 1}": camera.K[r][c] for r in range(3) for c in range(3)}
        files[f"basename{i}.rad"] = [f"{name} = {value!r}" for name, value in k.items()] + [
            f"kc{n} = {value!r}" for n, value in enumerate(values, start=1)
        ]
    files["Res.dat"] = [f"{camera.size[0]} {camera.size[1]}" for camera in cameras]
    files["camera_order.txt"] = [camera.name for camera in cameras]
    word = next((word for word, unit in UNITS_THERE.items() if unit == saved.unit), None)
    if word is not None:
        files["calibration_units.txt"] = [word]
    return {name: "\n".join([*lines, ""]).encode() for name, lines in files.items()}


def _recognise(path: Path, head: str) -> bool:
    name = path.name.lower()
    lens = name.endswith(".rad") and "K11" in head
    return lens or name.endswith(".pmat.cal") or name in OTHERS


FORMAT = CalibrationFormat(
    name="multicamselfcal",
    title=TITLE,
    patterns=("*.Pmat.cal", "*.rad", "Res.dat", "camera_order.txt", "calibration_units.txt"),
    recognise=_recognise,
    holds=Holds(lenses="Brown without k3, pinhole", unit="any", poses="P, camera from world"),
    read=_read,
    write=_write,
)
