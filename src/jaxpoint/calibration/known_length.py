"""A calibration in metres by one measured length: its scale, and no more of the room."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxpoint.calibration.alignment import transformed_covariance
from jaxpoint.calibration.result import Calibration
from jaxpoint.errors import InsufficientDataError, UsageError
from jaxpoint.geometry.pose import Similarity


def scale_by_length(calibration: Calibration, ends: Float[np.ndarray, "2 3"], length_m: float) -> Calibration:
    """The calibration in metres, in a frame of its own: it knows neither floor nor up (`in_room` is False).

    The scale is as good as the length; the covariance leaves it out, as the gauge "free" does.

    Args:
        ends: of the measured length, solver's unit.

    Raises:
        UsageError: the calibration has metres already.
        InsufficientDataError: the ends lie at one place.
        ValueError: the length is not positive.
    """
    if calibration.unit == "m":
        raise UsageError("This calibration has metres already; --length is for one in an arbitrary unit.")
    if not (np.isfinite(length_m) and length_m > 0):
        raise ValueError(f"The length is {length_m} m; give a positive one.")
    measured = float(np.linalg.norm(ends[1] - ends[0]))
    if not measured > 0:
        raise InsufficientDataError("Both ends of the length lie at one place; take two points that differ.")
    scale = length_m / measured
    covariance = calibration.camera_covariance
    with jax.enable_x64(True):
        similarity = Similarity(jnp.asarray(scale), jnp.eye(3), jnp.zeros(3))
        rig = calibration.rig.transformed(similarity)
        if covariance is not None:
            covariance = transformed_covariance(covariance, rig, similarity)
    return replace(calibration, rig=rig, points=scale * calibration.points, unit="m", camera_covariance=covariance)
