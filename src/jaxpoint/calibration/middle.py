"""A calibration in a frame whose origin lies amid its points; national grids have theirs far off."""

from __future__ import annotations

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxpoint.calibration.alignment import transformed_covariance
from jaxpoint.calibration.result import Calibration
from jaxpoint.calibration.sight import poses
from jaxpoint.camera.rig import CameraRig
from jaxpoint.geometry.pose import Similarity

FAR = 1e3  # of the places' extent; an origin beyond that is a national grid's


def about_its_middle(calibration: Calibration) -> tuple[Calibration, Float[np.ndarray, "3"]]:
    """The same calibration with the origin amid its points, and where that was; without its covariance.

    A rotation about an origin far away (metres of a national grid) moves a camera nearly as a shift does, and the
    normal equations could not tell the two apart.
    """
    valid = calibration.points[calibration.point_valid]
    middle = valid.mean(axis=0) if len(valid) else np.zeros(3)
    points = np.where(calibration.point_valid[:, None], calibration.points - middle, 0.0)
    rig = rig_about(calibration.rig, middle)
    return replace(calibration, rig=rig, points=points, camera_covariance=None, gauge=None), middle


def rig_about(rig: CameraRig, middle: Float[np.ndarray, "3"]) -> CameraRig:
    """The rig in a frame whose origin is `middle` of its own."""
    rotation, translation = poses(rig)
    moved = jnp.asarray(translation + rotation @ middle)
    return eqx.tree_at(lambda rig: rig.cameras.cam_from_world.translation, rig, moved)


def covariance_about(
    rig: CameraRig, covariance: Float[np.ndarray, "D D"], middle: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "D D"]:
    """The covariance of the cameras of a rig in a frame whose origin is `middle` of the rig's own.

    Far off it is exact to about 1e-16 of what the frame's rotation moves there: with a rotation known to 1 mrad, 5000
    km from the origin, to 0.1 mm.
    """
    return transformed_covariance(covariance, rig, Similarity(np.ones(()), np.eye(3), -middle))


def far_middle(places: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, "3"]:
    """The middle of places where their origin is that of a national grid, else zero."""
    middle = places.mean(axis=0) if len(places) else np.zeros(3)
    near = np.linalg.norm(middle) < FAR * np.ptp(places, axis=0).max(initial=1.0)
    return np.zeros(3) if near else middle


def near(
    rig: CameraRig, covariance: Float[np.ndarray, "D D"], middle: Float[np.ndarray, "3"]
) -> tuple[CameraRig, Float[np.ndarray, "D D"]]:
    """A rig and its covariance in a frame whose origin is `middle` of the rig's own; unchanged where that is zero."""
    if not middle.any():
        return rig, covariance
    values, vectors = np.linalg.eigh(covariance_about(rig, covariance, middle))
    whole = (vectors * np.maximum(values, 0.0)) @ vectors.T  # rounding leaves small negative values
    with jax.enable_x64(True):
        return rig_about(rig, middle), whole
