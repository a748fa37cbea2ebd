"""COLMAP's camera models: names and parameters, in pixels from the corner of the image."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxpoint.errors import FileFormatError
from jaxpoint.io.formats.fields import camera_entry, camera_matrix, lens_kind, opencv_coefficients
from jaxpoint.io.rig_entries import CameraEntry

CORNER = 0.5  # px: the centre of the first pixel is (0.5, 0.5) there, and (0, 0) here
# how many numbers, how many of them focal lengths, and where the others stand in OpenCV's order
MODELS: dict[str, tuple[int, int, tuple[int, ...], str]] = {
    "SIMPLE_PINHOLE": (3, 1, (), ""),
    "PINHOLE": (4, 2, (), ""),
    "SIMPLE_RADIAL": (4, 1, (0,), ""),
    "RADIAL": (5, 1, (0, 1), ""),
    "OPENCV": (8, 2, (0, 1, 2, 3), ""),
    "FULL_OPENCV": (12, 2, (0, 1, 2, 3, 4, 5, 6, 7), ""),
    "SIMPLE_RADIAL_FISHEYE": (4, 1, (0,), "fisheye"),
    "RADIAL_FISHEYE": (5, 1, (0, 1), "fisheye"),
    "OPENCV_FISHEYE": (8, 2, (0, 1, 2, 3), "fisheye"),
}


def colmap_camera(
    where: str, name: str, size: tuple[int, int], model: str, parameters: Sequence[float], pose: tuple | None
) -> CameraEntry:
    """A camera of a COLMAP model.

    Raises:
        FileFormatError: the model is not known, or has another number of parameters.
    """
    if model not in MODELS:
        raise FileFormatError(
            f"{where}this lens cannot be read (model '{model}'; known are {', '.join(MODELS)}): run COLMAP's "
            "model with one of these, or calibrate without it."
        )
    count, focals, places, lens = MODELS[model]
    if len(parameters) != count or not np.isfinite(parameters).all():
        raise FileFormatError(f"{where}{model} has {count} finite parameters, not {len(parameters)}.")
    fx, fy = parameters[0], parameters[focals - 1]
    cx, cy = parameters[focals : focals + 2]
    coefficients = np.zeros(4 if lens or len(places) <= 4 else 8)
    coefficients[list(places)] = parameters[focals + 2 :]
    return camera_entry(where, name, size, camera_matrix(fx, fy, cx - CORNER, cy - CORNER), coefficients, lens, pose)


def colmap_model(title: str, camera: CameraEntry) -> tuple[str, list[float]]:
    """The model of a camera's lens, and its parameters.

    Raises:
        UsageError: COLMAP has none for it.
    """
    k = np.array(camera.K)
    common = [k[0, 0], k[1, 1], k[0, 2] + CORNER, k[1, 2] + CORNER]
    if lens_kind(camera) == "kannala_brandt":
        return "OPENCV_FISHEYE", [*common, *camera.distortion]
    values = opencv_coefficients(title, camera, 8)
    if not any(values):
        return "PINHOLE", common
    model = "OPENCV" if len(values) == 4 else "FULL_OPENCV"
    return model, [*common, *values, *[0.0] * (MODELS[model][0] - 4 - len(values))]
