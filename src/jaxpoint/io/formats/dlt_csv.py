"""DLT coefficients (DLTdv, easyWand, Argus): a CSV file of 11 rows, one column a camera, beside easyWand's profile.

u = (L1 X + L2 Y + L3 Z + L4) / (L9 X + L10 Y + L11 Z + 1), v likewise with L5 to L8, in MATLAB's pixels with v upwards:
u = x + 1 and v = height - y. Pixels are undistorted ones where there is a profile (`*_profile.txt`), one line a camera:
number, f, width, height, cx, cy, aspect (fy / fx), k1, k2, p1, p2, k3 in those same axes. The unit is not stated.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.io.formats.calibration_format import CalibrationFormat, Holds, Request, SourceFile
from jaxpoint.io.formats.fields import camera_entry, camera_matrix, opencv_coefficients, pose_of, read_image_size
from jaxpoint.io.formats.projection_cameras import camera_of_projection, notes_of
from jaxpoint.io.rig_entries import UNSTATED, CameraEntry, SavedCalibration

TITLE = "DLT coefficients (CSV)"
ROWS = 11
PROFILE = (7, 12)  # values of a line, without and with coefficients
FLIP_P1 = np.array([1.0, 1.0, -1.0, 1.0, 1.0])  # k1, k2, p1, p2, k3 where y points the other way


def _read(request: Request) -> SavedCalibration:
    tables = {file.path: _rows(file) for file in request.files}
    coefficients = [(path, rows) for path, rows in tables.items() if _is_dlt(rows)]
    profiles = [(path, rows) for path, rows in tables.items() if not _is_dlt(rows)]
    if len(coefficients) > 1 or len(profiles) > 1 or not tables:
        raise UsageError(f"{TITLE} are one CSV file and at most one profile; name these.")
    profile = _profile(*profiles[0], request.size) if profiles else []
    if not coefficients:
        cameras = [camera_entry(request.where, f"cam_{i}", *lens) for i, lens in enumerate(profile, start=1)]
        return request.saved(cameras, unit=UNSTATED)
    path, rows = coefficients[0]
    values = np.array(rows)
    if profile and len(profile) != values.shape[1]:
        raise FileFormatError(
            f"{path} has {values.shape[1]} cameras, and the profile {len(profile)}; name those of one rig."
        )
    return _posed(request, path, values, profile)


def _posed(request: Request, path: Path, values: np.ndarray, profile: list[tuple]) -> SavedCalibration:
    found = []
    for i, column in enumerate(values.T):
        own, lens, bending = profile[i] if profile else (None, None, None)
        size = own or request.needed_size("the cameras (there is no profile)")
        where = f"{path}, camera {i + 1}: "
        projection = _to_ours(size[1]) @ np.append(column, 1.0).reshape(3, 4)
        found.append(camera_of_projection(where, f"cam_{i + 1}", size, projection, lens, bending))
    notes = notes_of(f"{path}: cameras were fitted to its coefficients", [off for _, off in found])
    return request.saved([camera for camera, _ in found], unit=UNSTATED, notes=notes)


def _rows(file: SourceFile) -> list[list[float]]:
    lines = [line for line in file.text.splitlines() if line.strip()]
    try:
        rows = [[float(word) for word in re.split(r"[,;\s]+", line.strip(" ,;\t"))] for line in lines]
    except ValueError:
        raise FileFormatError(f"{file.path} must hold only numbers, {ROWS} rows of one a camera.") from None
    if not rows or not all(np.isfinite(row).all() for row in rows) or len({len(row) for row in rows}) != 1:
        raise FileFormatError(
            f"{file.path} must have {ROWS} rows of as many finite numbers as cameras, or a profile's."
        )
    return rows


def _is_dlt(rows: list[list[float]]) -> bool:
    """11 rows are coefficients, unless they are numbered as the lines of a profile."""
    return len(rows) == ROWS and [row[0] for row in rows] != list(range(1, ROWS + 1))


def _profile(path: Path, rows: list[list[float]], given: tuple[int, int] | None) -> list[tuple]:
    """Image size (as given, else as in the file), K and coefficients of each camera, in our axes."""
    lenses = []
    for line, row in enumerate(rows, start=1):
        if len(row) not in PROFILE or row[0] != line:
            raise FileFormatError(
                f"{path}, line {line}: a profile has number, f, width, height, cx, cy, aspect and perhaps k1, "
                f"k2, p1, p2, k3, not {len(row)} values."
            )
        _, focal, width, height, cx, cy, aspect, *bending = row
        size = given or read_image_size(f"{path}, line {line}: ", [width, height])
        bent = np.array(bending or [0.0] * 5) * FLIP_P1
        lenses.append((size, camera_matrix(focal, focal * aspect, cx - 1, size[1] - cy), bent))
    return lenses


def _to_ours(height: int) -> np.ndarray:
    """From their pixels to ours."""
    return np.array([[1.0, 0.0, -1.0], [0.0, -1.0, float(height)], [0.0, 0.0, 1.0]])


def _write(saved: SavedCalibration, path: Path) -> Mapping[str, bytes]:
    cameras = saved.entries()
    columns = np.stack([_coefficients(camera) for camera in cameras], axis=1)
    lines = [",".join(repr(float(value)) for value in row) for row in columns]
    profile = [" ".join(map(repr, _profile_line(i, camera))) for i, camera in enumerate(cameras, start=1)]
    return {"dltCoefs.csv": "\n".join([*lines, ""]).encode(), "cameras_profile.txt": "\n".join([*profile, ""]).encode()}


def _coefficients(camera: CameraEntry) -> np.ndarray:
    rotation, translation = pose_of(camera)
    projection = np.array(camera.K) @ np.hstack([rotation, translation[:, None]])
    projection = np.linalg.solve(_to_ours(camera.size[1]), projection)
    if abs(translation[2]) < 1e-9 * max(1.0, float(np.linalg.norm(translation))):
        raise UsageError(
            f"{TITLE} cannot hold camera '{camera.name}': the world's origin lies in the plane of its "
            "lens; move the origin."
        )
    return (projection / projection[2, 3]).ravel()[:ROWS]


def _profile_line(number: int, camera: CameraEntry) -> list[float | int]:
    k, (width, height) = np.array(camera.K), camera.size
    values = np.zeros(5)
    given = opencv_coefficients(TITLE, camera, 5)
    values[: len(given)] = given
    lens = [k[0, 0], width, height, k[0, 2] + 1, height - k[1, 2], k[1, 1] / k[0, 0]]
    return [number, *map(float, lens[:1]), width, height, *map(float, lens[3:]), *(values * FLIP_P1).tolist()]


def _recognise(path: Path, head: str) -> bool:
    """Rows of numbers without a header: 11 of as many as cameras, or a profile's, numbered from 1."""
    lines = [line for line in head.splitlines() if line.strip()]
    rows = [re.split(r"[,;\s]+", line.strip(" ,;\t")) for line in lines[: ROWS + 1]]
    number = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|nan|inf", re.IGNORECASE)
    if (
        not rows
        or len({len(row) for row in rows}) != 1
        or not all(number.fullmatch(word) for row in rows for word in row)
    ):
        return False
    numbered = all(row[0] == str(i) for i, row in enumerate(rows, start=1)) and len(rows[0]) in PROFILE
    return path.suffix.lower() in (".csv", ".txt") and (len(lines) == ROWS or numbered)


FORMAT = CalibrationFormat(
    name="dlt",
    title=TITLE,
    patterns=("*dltCoefs*.csv", "*_profile.txt"),
    recognise=_recognise,
    holds=Holds(
        lenses="Brown, pinhole (in the profile)",
        unit=UNSTATED,
        poses="P, camera from world",
        pixels="(1, height), y up",
    ),
    read=_read,
    write=_write,
    rename=lambda names: tuple(f"cam_{i}" for i in range(1, len(names) + 1)),
)
