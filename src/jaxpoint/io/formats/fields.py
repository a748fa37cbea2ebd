"""Values of files, checked: numbers of a given shape, image sizes, poses; and lenses on the way out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float

from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.io.lens_entries import model_of_name, read_coefficients
from jaxpoint.io.rig_entries import CameraEntry, tuples

MAX_SIZE = 1_000_000  # px; more is no image


def read_numbers(
    where: str, table: Mapping[str, Any], key: str, shape: tuple[int, ...] | None = None
) -> Float[np.ndarray, "..."]:
    """Finite numbers under a key, also as OpenCV's matrix (rows, cols, data); reshaped where only the count fits.

    Raises:
        FileFormatError: the key is missing, or holds something else.
    """
    if key not in table:
        raise FileFormatError(f"{where}'{key}' is missing.")
    given = table[key]
    if isinstance(given, Mapping):
        given = _matrix(where, key, given)
    try:
        values = np.array(given, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise FileFormatError(f"{where}'{key}' must hold numbers.") from None
    if not np.isfinite(values).all() or (shape is not None and values.size != int(np.prod(shape))):
        size = " x ".join(map(str, shape or values.shape))
        raise FileFormatError(f"{where}'{key}' must be {size} finite numbers, not {str(table[key])[:80]}.")
    return values if shape is None else values.reshape(shape)


def _matrix(where: str, key: str, given: Mapping[str, Any]) -> Any:
    data, rows, columns = given.get("data"), given.get("rows"), given.get("cols")
    count = len(data) if isinstance(data, list) else -1
    if not (isinstance(rows, int) and isinstance(columns, int)) or rows * columns != count:
        raise FileFormatError(f"{where}'{key}' must have rows, cols and as much data, as OpenCV writes a matrix.")
    return np.array(data, dtype=object).reshape(rows, columns).tolist()


def read_image_size(where: str, values: Any) -> tuple[int, int]:
    """Width and height, whole pixels.

    Raises:
        FileFormatError: they are not two whole positive numbers.
    """
    width, height = read_numbers(where, {"size": values}, "size", (2,)).tolist()
    if not (0 < width <= MAX_SIZE and 0 < height <= MAX_SIZE):
        raise FileFormatError(f"{where}size [{width:g}, {height:g}] must be positive (px, at most {MAX_SIZE}).")
    if width != int(width) or height != int(height):
        raise FileFormatError(f"{where}size [{width:g}, {height:g}] must be whole pixels.")
    return int(width), int(height)


def width_and_height(where: str, table: Mapping[str, Any], names: tuple[str, str]) -> tuple[int, int]:
    """Width and height, whole pixels, under two keys.

    Raises:
        FileFormatError: one is missing or wrong.
    """
    if any(name not in table for name in names):
        raise FileFormatError(f"{where}image_width and image_height must both be there; add them (px).")
    return read_image_size(where, [table[name] for name in names])


def camera_entry(
    where: str,
    name: str,
    size: tuple[int, int],
    matrix: Any,
    coefficients: Any,
    model: str = "",
    pose: tuple[Any, Any] | None = None,
) -> CameraEntry:
    """A camera from K, its coefficients and its pose.

    Args:
        model: of the lens, as tools name it; "" for OpenCV's, whose number of coefficients tells which.
        pose: rotation matrix and translation from world to camera; None where the file has none.

    Raises:
        FileFormatError: the lens is not known, or a value is impossible.
    """
    k = np.asarray(matrix, dtype=float)
    if not np.isfinite(k).all() or min(k[0, 0], k[1, 1]) <= 0 or (k[[0, 1, 2, 2], [1, 0, 0, 1]] != 0).any():
        raise FileFormatError(f"{where}K must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], not {k.tolist()}.")
    k = np.array([[k[0, 0], 0.0, k[0, 2]], [0.0, k[1, 1], k[1, 2]], [0.0, 0.0, 1.0]])
    lens, values = read_coefficients(where, coefficients, model_of_name(where, model))
    rotation, translation = pose or (None, None)
    return CameraEntry(
        name,
        size,
        tuples(k),
        values.tolist(),
        None if rotation is None else tuples(np.asarray(rotation, dtype=float)),
        None if translation is None else tuples(np.asarray(translation, dtype=float).ravel()),
        lens=lens.name,
    )


def camera_matrix(fx: float, fy: float, cx: float, cy: float) -> Float[np.ndarray, "3 3"]:
    """K of focal lengths and principal point, px."""
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def rotation_of(where: str, values: Float[np.ndarray, "..."]) -> Float[np.ndarray, "3 3"]:
    """A rotation matrix from one, or from a rotation vector (rad).

    Raises:
        FileFormatError: it is neither.
    """
    if values.shape in ((3,), (3, 1), (1, 3)):
        return np.asarray(cv2.Rodrigues(values.reshape(3))[0])
    if values.shape != (3, 3):
        raise FileFormatError(f"{where}rotation has shape {values.shape}; give a rotation vector or a 3 x 3 matrix.")
    return values


def rotation_vector(rotation: Any) -> list[float]:
    """The rotation vector (rad) of a matrix."""
    return cv2.Rodrigues(np.array(rotation))[0].ravel().tolist()


def rotation_of_quaternion(where: str, values: Sequence[float]) -> Float[np.ndarray, "3 3"]:
    """The rotation of a quaternion w, x, y, z of length 1 (to 1 %; it is made so exactly).

    Raises:
        FileFormatError: it has another length, or is not finite.
    """
    quaternion = np.clip(np.asarray(values, dtype=float), -1e6, 1e6)
    length = float(np.linalg.norm(quaternion))
    if not abs(length - 1) < 0.01:
        raise FileFormatError(f"{where}the quaternion has length {length:.3g}; that of a rotation has length 1.")
    w, x, y, z = quaternion / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_of(rotation: Any) -> list[float]:
    """The quaternion w, x, y, z of a rotation matrix, w >= 0."""
    r = np.array(rotation, dtype=float)
    # The row of the largest diagonal entry of 4 q q^T is the best conditioned one.
    products = np.array(
        [
            [1 + r[0, 0] + r[1, 1] + r[2, 2], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], 1 + r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0]],
            [r[0, 2] - r[2, 0], r[0, 1] + r[1, 0], 1 - r[0, 0] + r[1, 1] - r[2, 2], r[1, 2] + r[2, 1]],
            [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], 1 - r[0, 0] - r[1, 1] + r[2, 2]],
        ]
    )
    row = products[np.diagonal(products).argmax()]
    return (row / np.linalg.norm(row) * (1.0 if row[0] >= 0 else -1.0)).tolist()


def pose_of(camera: CameraEntry) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """Rotation and translation from world to camera; of a lens without a pose the identity."""
    if camera.rotation is None or camera.translation is None:
        return np.eye(3), np.zeros(3)
    return np.array(camera.rotation), np.array(camera.translation)


def centre_of(camera: CameraEntry) -> Float[np.ndarray, "3"]:
    """Where the camera stands in the world."""
    rotation, translation = pose_of(camera)
    return -rotation.T @ translation


def lens_kind(camera: CameraEntry) -> str:
    """The model's name: "brown", "pinhole", "rational", "kannala_brandt", ..."""
    return camera.lens if isinstance(camera.lens, str) else "brown"


def opencv_coefficients(title: str, camera: CameraEntry, most: int) -> list[float]:
    """Coefficients in OpenCV's order of a lens that has at most so many (4: k1 k2 p1 p2, 5: and k3, 8: rational).

    Zeros fill up to 4 (or 5, or 8). A pinhole has zeros.

    Raises:
        UsageError: the lens is of another model, or needs more.
    """
    values = list(camera.distortion)
    while len(values) > 4 and values[-1] == 0.0:
        values.pop()
    if lens_kind(camera) not in ("brown", "pinhole", "rational") or len(values) > most:
        raise no_place(title, camera)
    count = next(count for count in (4, 5, 8) if len(values) <= count)
    return values + [0.0] * (count - len(values))


def no_place(title: str, camera: CameraEntry) -> UsageError:
    """The error of a lens that a format has no place for."""
    given = ", ".join(f"{value:.4g}" for value in camera.distortion)
    return UsageError(
        f"{title} has no place for the {lens_kind(camera)} lens of camera '{camera.name}' (coefficients {given}); "
        "`jaxpoint convert --list` says which formats have."
    )
