"""EasyMocap's `intri.yml` and `extri.yml`: metres, from world to camera, cameras listed under `names`.

`intri.yml` has `K_x` and `dist_x` (and in newer ones `H_x` and `W_x`, the image size, px) of each camera x, `extri.yml`
`R_x` (rotation vector), `Rot_x` (matrix) and `T_x`. Without `extri.yml` there are lenses alone.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxpoint.errors import FileFormatError
from jaxpoint.io.formats.calibration_format import UNSIZED, CalibrationFormat, Holds, Request
from jaxpoint.io.formats.fields import (
    camera_entry,
    opencv_coefficients,
    pose_of,
    read_image_size,
    read_numbers,
    rotation_of,
    rotation_vector,
)
from jaxpoint.io.formats.names import file_stems
from jaxpoint.io.formats.storage_tree import encode_storage, parse_storage
from jaxpoint.io.rig_entries import CameraEntry, SavedCalibration

TITLE = "EasyMocap's intri.yml and extri.yml"
APART = 1e-4  # of a rotation matrix from the one of its vector


def _read(request: Request) -> SavedCalibration:
    files = list(request.files)
    if len(files) == 1:  # the other one lies beside it
        other = {"intri.yml": "extri.yml", "extri.yml": "intri.yml"}.get(files[0].path.name.lower())
        beside = files[0].path.with_name(other) if other else None
        files += [type(files[0])(beside)] if beside is not None and beside.is_file() else []
    table: dict[str, Any] = {}
    for file in files:
        table |= parse_storage(file.path, file.text)
    names = [str(name) for name in table.get("names") or []] if isinstance(table.get("names"), list) else []
    lenses = [name for name in names or _named(table, "K") if f"K_{name}" in table]
    posed = _named(table, "T")
    if not lenses:
        raise FileFormatError(
            f"{request.where} holds no lens; EasyMocap's intri.yml has K_x and dist_x of each camera."
        )
    if missing := [name for name in posed if f"K_{name}" not in table]:
        raise FileFormatError(f"{request.where}: camera '{missing[0]}' has a pose and no lens (K_{missing[0]}).")
    left = [name for name in _named(table, "K") if posed and name not in posed]
    notes = [f"{request.where}: left out, because they have no pose: {', '.join(left)}."] if left else []
    return request.saved([_camera(request.where, name, table) for name in posed or lenses], notes=notes)


def _named(table: Mapping[str, Any], letter: str) -> list[str]:
    return [key.removeprefix(f"{letter}_") for key in table if key.startswith(f"{letter}_")]


def _camera(path: str, name: str, table: dict[str, Any]) -> CameraEntry:
    where = f"{path}, camera {name}: "
    bending = next((key for key in (f"dist_{name}", f"D_{name}") if key in table), f"dist_{name}")
    sides = [table[f"{letter}_{name}"] for letter in "WH" if f"{letter}_{name}" in table]
    return camera_entry(
        where,
        name,
        read_image_size(where, sides) if len(sides) == 2 else UNSIZED,
        read_numbers(where, table, f"K_{name}", (3, 3)),
        read_numbers(where, table, bending).ravel(),
        "",
        _pose(where, name, table) if f"T_{name}" in table else None,
    )


def _pose(where: str, name: str, table: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    vector, matrix = f"R_{name}", f"Rot_{name}"
    rotation = rotation_of(where, read_numbers(where, table, matrix if matrix in table else vector))
    if vector in table and matrix in table:
        other = rotation_of(where, read_numbers(where, table, vector))
        if (apart := float(np.abs(rotation - other).max())) > APART:
            raise FileFormatError(f"{where}{vector} and {matrix} are different rotations (by {apart:.2g}).")
        rotation = other  # exactly a rotation, where the matrix was rounded
    return rotation, read_numbers(where, table, f"T_{name}", (3,))


def _write(saved: SavedCalibration, path: Path) -> Mapping[str, bytes]:
    names = list(file_stems(saved.rig.names))
    lenses: dict[str, Any] = {"names": names}
    poses: dict[str, Any] = {"names": names}
    for name, camera in zip(names, saved.entries()):
        values = opencv_coefficients(TITLE, camera, 8)
        bending = np.array([values + [0.0] * max(0, 5 - len(values))])
        lenses |= {f"K_{name}": np.array(camera.K), f"dist_{name}": bending}
        lenses |= {f"H_{name}": int(camera.size[1]), f"W_{name}": int(camera.size[0])}
        rotation, translation = pose_of(camera)
        vector = np.array(rotation_vector(rotation)).reshape(3, 1)
        poses |= {f"R_{name}": vector, f"Rot_{name}": rotation, f"T_{name}": translation.reshape(3, 1)}
    files = {"intri.yml": lenses, **({"extri.yml": poses} if saved.posed else {})}
    return {name: encode_storage(Path(name), values) for name, values in files.items()}


FORMAT = CalibrationFormat(
    name="easymocap",
    title=TITLE,
    patterns=("intri.yml", "extri.yml"),
    recognise=lambda path, head: re.search(r"^(K|Rot|T)_\S+:\s*!!opencv-matrix", head, re.MULTILINE) is not None,
    holds=Holds(lenses="Brown, pinhole, rational", unit="m"),
    read=_read,
    write=_write,
    rename=file_stems,
    needs_poses=False,
)
