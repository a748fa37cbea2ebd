"""A calibration together with the covariance of its cameras, as a run keeps it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from jaxpoint.calibration.alignment import Alignment, apply_alignment
from jaxpoint.calibration.pair_poses import pair_scatter
from jaxpoint.calibration.result import Calibration
from jaxpoint.calibration.uncertainty import Anchors, Clicks, anchors_of, uncertainty_of
from jaxpoint.camera.camera import POSE_NAMES
from jaxpoint.errors import InsufficientDataError, UsageError


def with_covariance(calibration: Calibration, anchors: Anchors | None = None) -> Calibration:
    """The calibration with `camera_covariance` and `gauge`, or with the reason why there is none (`undetermined`).

    Args:
        anchors: as `uncertainty_of` takes them; without them the gauge is free.
    """
    try:
        found = uncertainty_of(calibration, anchors)
    except (InsufficientDataError, UsageError) as error:
        return replace(calibration, camera_covariance=None, gauge=None, undetermined=str(error))
    except np.linalg.LinAlgError:  # a solved rig must not be lost to its covariance
        reason = "The normal equations are singular: the observations do not determine the rig."
        return replace(calibration, camera_covariance=None, gauge=None, undetermined=reason)
    return replace(calibration, camera_covariance=np.asarray(found.covariance), gauge=found.gauge, undetermined="")


def with_board_covariance(calibration: Calibration) -> Calibration:
    """`with_covariance` of a calibration from boards.

    One camera is its own frame: only its lens is uncertain. Where single views of boards put cameras elsewhere by more
    than the noise of corners explains, the covariance is larger by the square of that ratio (Birge 1932).
    """
    found = with_covariance(calibration)
    covariance = found.camera_covariance
    if covariance is None:
        return found
    if len(found.rig) == 1:
        lens = np.arange(len(covariance)) >= len(POSE_NAMES)
        return replace(found, camera_covariance=np.where(lens[:, None] & lens[None, :], covariance, 0.0))
    ratio = max((scatter.ratio for scatter in pair_scatter(found)), default=1.0)
    return replace(found, camera_covariance=max(ratio, 1.0) ** 2 * covariance)


def aligned_with_covariance(
    calibration: Calibration,
    alignment: Alignment,
    sigmas: Float[np.ndarray, " N"] | None = None,
    clicks: Clicks | None = None,
    click_sigma_px: float = 1.0,
) -> Calibration:
    """`apply_alignment`, with the covariance of the cameras in the room.

    Aligned by landmarks or camera centres, the room's frame is as uncertain as these are (gauge "landmarks"). A floor
    leaves the gauge free: the shape of the rig is uncertain, but not where its frame stands, nor the measured length
    that gives the scale; nobody stated how well those are known.

    Args:
        sigmas: standard deviation of each landmark's coordinates, m; where unknown the residuals of the alignment
            tell it, one for all.
        clicks: those by which landmarks were found.
        click_sigma_px: standard deviation of one clicked coordinate.
    """
    aligned = apply_alignment(calibration, alignment)
    if alignment.method == "floor":
        return with_covariance(aligned)
    known = np.full(len(alignment.names), _residual_sigma(alignment)) if sigmas is None else sigmas
    return with_covariance(aligned, anchors_of(aligned, alignment.names, known, clicks, click_sigma_px))


def _residual_sigma(alignment: Alignment) -> float:
    """Standard deviation (m) of a landmark's coordinate that the residuals show; a similarity takes 7 of them."""
    squares = (1e-3 * alignment.residual_mm) ** 2
    return max(float(np.sqrt(squares.sum() / (3 * len(squares) - 7))), 1e-6)
