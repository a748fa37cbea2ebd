"""Calibrations from and to worlds with other axes and units; every pixel stays where it was."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np

from jaxpoint.calibration.alignment import transformed_covariance
from jaxpoint.errors import UsageError
from jaxpoint.geometry.pose import Similarity
from jaxpoint.geometry.world_axes import PER_METRE, World
from jaxpoint.io.formats.calibration_format import CalibrationFormat
from jaxpoint.io.rig_entries import UNSTATED, SavedCalibration


def from_world(saved: SavedCalibration, world: World) -> SavedCalibration:
    """A calibration whose frame has the axes of another world, in those of the room: z up.

    Raises:
        UsageError: the world is left-handed.
    """
    _check_hand(world)
    return _transformed(saved, Similarity(np.float64(1.0), world.matrix.T, np.zeros(3)))


def to_world(saved: SavedCalibration, world: World) -> SavedCalibration:
    """A calibration of the room with the axes of another world.

    Raises:
        UsageError: the world is left-handed.
    """
    _check_hand(world)
    return _transformed(saved, Similarity(np.float64(1.0), world.matrix, np.zeros(3)))


def to_unit(saved: SavedCalibration, fmt: CalibrationFormat, unit: str) -> SavedCalibration:
    """A calibration in metres with its lengths in m, cm or mm, for a format whose files leave the unit open.

    Raises:
        UsageError: the format has a unit of its own, or the calibration is not in metres.
    """
    if fmt.holds.unit not in ("any", UNSTATED) or fmt.name == "jaxpoint":
        own = "m" if fmt.name == "jaxpoint" else fmt.holds.unit
        raise UsageError(f"{fmt.title} is always in {own}; leave out --out-unit {unit}.")
    if saved.unit != "m":
        raise UsageError(
            f"--out-unit {unit} needs lengths in metres, and these are in no known unit ('{saved.unit}'); give --unit, "
            "or bring them into the room by `jaxpoint align`."
        )
    scaled = _transformed(saved, Similarity(np.float64(PER_METRE[unit]), np.eye(3), np.zeros(3)))
    return replace(scaled, unit=unit)


def _check_hand(world: World) -> None:
    if not world.right_handed:
        raise UsageError(
            f"The world {world} is left-handed, and no format of calibrations has left-handed cameras; write --to gltf,"
            " which Unity and Unreal read, or points by `jaxpoint triangulate --world`."
        )


def _transformed(saved: SavedCalibration, similarity: Similarity) -> SavedCalibration:
    with jax.enable_x64(True):
        rig, covariance = saved.rig.transformed(similarity), saved.covariance
        if covariance is not None:
            covariance = transformed_covariance(covariance, rig, similarity)
    return replace(saved, rig=rig, covariance=covariance)
