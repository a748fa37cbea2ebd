"""How lenses stand in files: the model's name and its coefficients, and which model several of them share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxpoint.camera.brown import Brown
from jaxpoint.camera.kannala_brandt import KannalaBrandt
from jaxpoint.camera.lens import AbstractLens
from jaxpoint.camera.lenses import LENSES
from jaxpoint.camera.mixed import embedded, mixed_lens
from jaxpoint.camera.rational import Rational
from jaxpoint.errors import FileFormatError

OPENCV_COUNTS = (0, 1, 2, 4, 5, 8, 12, 14)  # of coefficients that OpenCV writes of its pinhole cameras
BROWN_COUNT, RATIONAL_COUNT = 5, 8
FISHEYES = ("equidistant", "equi", "fisheye", "kannala_brandt", "kannalabrandt")
CENTRAL = ("radtan", "plumb_bob", "brown", "none", "opencv", "pinhole", "rational_polynomial", "rational", "")


def model_of_name(where: str, name: str) -> type[AbstractLens] | None:
    """The lens model of a name as tools write it; None for OpenCV's, whose number of coefficients tells which.

    Raises:
        FileFormatError: no model that is known has this name.
    """
    lower = name.lower()
    if lower in FISHEYES:
        return KannalaBrandt
    if lower in LENSES and lower not in CENTRAL:
        return LENSES[lower]
    if lower not in CENTRAL:
        known = ", ".join(("radtan", "rational", "fisheye", *(n for n in LENSES if n not in (*CENTRAL, *FISHEYES))))
        raise FileFormatError(
            f"{where}this lens cannot be read (model '{name}'; known are {known}): calibrate it anew with one of "
            "these, or calibrate without it."
        )
    return None


def read_coefficients(
    where: str, given: Any, model: type[AbstractLens] | None = None
) -> tuple[type[AbstractLens], Float[np.ndarray, " k"]]:
    """The lens model and its coefficients, from those in a file.

    Args:
        where: begins the message, as "FILE, [cam_0]: ".
        given: the coefficients as they stand in a file; of OpenCV's pinhole cameras 0 to 14 in its order.
        model: where the file names it; None for OpenCV's pinhole cameras.

    Raises:
        FileFormatError: they are no numbers, of the wrong count, or those of OpenCV's thin prism or tilted sensor.
    """
    try:
        values = np.array(given, dtype=float)
    except (TypeError, ValueError):
        values = np.full(1, np.nan)
    if not np.isfinite(values).all() or np.squeeze(values).ndim > 1:
        raise FileFormatError(f"{where}the distortion must be finite numbers.")
    values = values.ravel()
    if model is not None and model is not Brown and model is not Rational:
        if values.size != len(model.coefficients):
            names = ", ".join(coefficient.name for coefficient in model.coefficients)
            raise FileFormatError(
                f"{where}a {model.name} lens has {len(model.coefficients)} coefficients ({names}), not {values.size}."
            )
        return model, values
    return _opencv(where, values)


def _opencv(where: str, values: np.ndarray) -> tuple[type[AbstractLens], np.ndarray]:
    """Brown's lens where five coefficients do, else the rational one."""
    if values.size not in OPENCV_COUNTS:
        raise FileFormatError(
            f"{where}the distortion must be 4 or 5 finite numbers, k1, k2, p1, p2 and k3, or 8 of the rational model."
        )
    if (values[RATIONAL_COUNT:] != 0).any():
        more = ", ".join(f"{value:.3g}" for value in values[RATIONAL_COUNT:])
        raise FileFormatError(
            f"{where}the lens has {values.size} coefficients, with a thin prism or tilted sensor ({more}), which is "
            "not known: calibrate that lens anew with 8 or fewer, or calibrate without it."
        )
    count = RATIONAL_COUNT if (values[BROWN_COUNT:] != 0).any() else BROWN_COUNT
    found = np.zeros(count)
    found[: min(values.size, count)] = values[:count]
    return (Rational if count == RATIONAL_COUNT else Brown), found


def common_model(
    models: Sequence[type[AbstractLens]], coefficients: Sequence[Any]
) -> tuple[type[AbstractLens], Float[np.ndarray, "C k"]]:
    """The one class that has all of these lenses exactly (mixed, where it must be), and their coefficients in it."""
    kinds = set(models)
    if len(kinds) == 1:
        return models[0], np.array([list(row) for row in coefficients], dtype=float).reshape(len(models), -1)
    if all(issubclass(kind, Brown | Rational) or not kind.coefficients for kind in kinds):
        count = RATIONAL_COUNT if Rational in kinds else BROWN_COUNT
        padded = [[*row, *[0.0] * (count - len(row))] for row in coefficients]
        return (Rational if count == RATIONAL_COUNT else Brown), np.array(padded, dtype=float)
    whole = mixed_lens(models)
    return whole, np.array([embedded(whole, *own) for own in zip(models, coefficients)])
