"""COLMAP's text model: `cameras.txt` (lenses) and `images.txt` (poses); other files of it are not needed.

An image line is `IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME`, from world to camera, then a line of its points. Every
image is one camera here, named by its image. Pixels count from the corner of the image; the unit is not stated.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxpoint.errors import FileFormatError
from jaxpoint.io.formats.calibration_format import CalibrationFormat, Holds, Request, SourceFile
from jaxpoint.io.formats.colmap_models import MODELS, colmap_camera, colmap_model
from jaxpoint.io.formats.fields import pose_of, quaternion_of, read_image_size, rotation_of_quaternion
from jaxpoint.io.formats.names import file_stem, file_stems, shortest_names
from jaxpoint.io.rig_entries import UNSTATED, CameraEntry, SavedCalibration

TITLE = "COLMAP's text model"
OTHERS = ("points3d.txt", "rigs.txt", "frames.txt")  # files of a model that say nothing of static cameras
_CAMERA = re.compile(r"^\s*\d+,?\s+[A-Z][A-Z_]+,?\s+\d+,?\s+\d+,?\s+[-+\d.]", re.MULTILINE)


class _Lens(NamedTuple):
    """A line of cameras.txt."""

    where: str
    size: tuple[int, int]
    model: str
    parameters: list[float]


def _read(request: Request) -> SavedCalibration:
    lenses = next((file for file in request.files if file.path.name.lower() == "cameras.txt"), None)
    lenses = lenses or next((file for file in request.files if _CAMERA.search(file.head)), None)
    if lenses is None and (beside := request.files[0].path.with_name("cameras.txt")).is_file():
        lenses = SourceFile(beside)
    if lenses is None:
        raise FileFormatError(f"{request.where} holds no cameras.txt; give the folder of COLMAP's text model.")
    images = next((file for file in request.files if file.path.name.lower() == "images.txt"), None)
    images = images or _beside(lenses)
    cameras = _cameras(lenses)
    if images is None:
        made = [_camera(f"cam_{key}", lens, lens.where, None) for key, lens in cameras.items()]
        return request.saved(made, unit=UNSTATED)
    return request.saved(_images(images, cameras), unit=UNSTATED)


def _beside(lenses: SourceFile) -> SourceFile | None:
    path = lenses.path.with_name("images.txt")
    return SourceFile(path) if path.is_file() else None


def _rows(file: SourceFile) -> list[tuple[str, list[str]]]:
    """Values of each line, without comments, and where it is."""
    return [
        (f"{file.path}, line {number}: ", line.replace(",", " ").split())
        for number, line in enumerate(file.text.splitlines(), start=1)
        if not line.lstrip().startswith("#")
    ]


def _floats(where: str, words: list[str]) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = [np.nan]
    if not np.isfinite(values).all():
        raise FileFormatError(f"{where}'{' '.join(words)[:60]}' are not all finite numbers.")
    return values


def _cameras(file: SourceFile) -> dict[str, _Lens]:
    found = {}
    for where, words in _rows(file):
        if not words:
            continue
        if len(words) < 5:
            raise FileFormatError(
                f"{where}a camera is CAMERA_ID MODEL WIDTH HEIGHT PARAMS, not '{' '.join(words)[:60]}'."
            )
        size = read_image_size(where, _floats(where, words[2:4]))
        found[words[0]] = _Lens(where, size, words[1], _floats(where, words[4:]))
    if not found:
        raise FileFormatError(f"{file.path} holds no camera.")
    return found


def _images(file: SourceFile, cameras: dict[str, _Lens]) -> list[CameraEntry]:
    """One camera for each image; every image has two lines, and that of its points may be empty."""
    rows = _rows(file)
    while rows and not rows[0][1]:
        rows.pop(0)
    lines = [row for row in rows[::2] if row[1]]
    if not lines:
        raise FileFormatError(f"{file.path} holds no image; COLMAP has posed none.")
    for where, words in lines:
        if len(words) < 10 or words[8] not in cameras:
            raise FileFormatError(
                f"{where}an image is IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME with a camera of cameras.txt, and a "
                f"line of points, not '{' '.join(words[:10])[:60]}'."
            )
    names = shortest_names([" ".join(words[9:]) for _, words in lines])
    return [_image(where, words, name, cameras[words[8]]) for (where, words), name in zip(lines, names)]


def _image(where: str, words: list[str], name: str, lens: _Lens) -> CameraEntry:
    values = _floats(where, words[1:8])
    return _camera(name, lens, where, (rotation_of_quaternion(where, values[:4]), values[4:]))


def _camera(name: str, lens: _Lens, where: str, pose: tuple[Any, Any] | None) -> CameraEntry:
    return colmap_camera(where, name, lens.size, lens.model, lens.parameters, pose)


def _write(saved: SavedCalibration, path: Path) -> Mapping[str, bytes]:
    cameras = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
    images = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME", "# POINTS2D[] as (X, Y, POINT3D_ID)"]
    for number, camera in enumerate(saved.entries(), start=1):
        model, parameters = colmap_model(TITLE, camera)
        rotation, translation = pose_of(camera)
        pose = " ".join(map(repr, [*quaternion_of(rotation), *translation.tolist()]))
        values = " ".join(repr(float(value)) for value in parameters)
        cameras.append(f"{number} {model} {camera.size[0]} {camera.size[1]} {values}")
        images += [f"{number} {pose} {number} {file_stem(camera.name)}.png", ""]
    points = ["# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)"]
    files = {"cameras.txt": cameras, "images.txt": images, "points3D.txt": points}
    return {name: "\n".join([*lines, ""]).encode() for name, lines in files.items()}


def _recognise(path: Path, head: str) -> bool:
    """cameras.txt by its models, images.txt by its quaternions, and the other files of a model by their headers."""
    models = [match.split()[1].strip(",") for match in _CAMERA.findall(head)]
    known = any(model in MODELS or model in ("FOV", "THIN_PRISM_FISHEYE") for model in models)
    image = re.search(r"^\s*\d+,?(\s+[-+]?[\d.]+(e[-+]?\d+)?,?){7}\s+\d+,?\s+\S*[A-Za-z]", head, re.MULTILINE)
    other = path.name.lower() in OTHERS and head.startswith("#")
    return path.suffix.lower() == ".txt" and bool(known or image or other)


FORMAT = CalibrationFormat(
    name="colmap",
    title=TITLE,
    patterns=("cameras.txt", "images.txt", "points3D.txt", "rigs.txt", "frames.txt"),
    recognise=_recognise,
    holds=Holds(lenses="Brown, pinhole, rational, fisheye", unit=UNSTATED, pixels="corner"),
    read=_read,
    write=_write,
    rename=file_stems,
)
