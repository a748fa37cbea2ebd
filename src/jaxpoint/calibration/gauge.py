"""Directions in which a similarity of the world moves points and cameras without a change of any pixel."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from jaxpoint.calibration.sight import poses
from jaxpoint.camera.rig import CameraRig

FREEDOMS = 7  # of a similarity: translation, rotation vector (rad), log scale


def gauge_directions_of_points(points: Float[np.ndarray, "B 3"]) -> Float[np.ndarray, "B 3 7"]:
    """How the seven freedoms of a similarity move points: translation, rotation vector, log scale."""
    ways = np.zeros((len(points), 3, FREEDOMS))
    ways[:, :, :3], ways[:, :, 3:6], ways[:, :, 6] = np.eye(3), -_skews(points), points
    return ways


def gauge_directions_of_cameras(rig: CameraRig) -> Float[np.ndarray, "C p 7"]:
    """How they move the cameras' parameters so that no pixel changes: w = -R phi, dt = t scale - R shift."""
    rotation, translation = poses(rig)
    ways = np.zeros((len(rig), rig.camera_size, FREEDOMS))
    ways[:, :3, 3:6], ways[:, 3:6, :3], ways[:, 3:6, 6] = -rotation, -rotation, translation
    return ways


def centres_by_parameters(rig: CameraRig) -> Float[np.ndarray, "C 3 p"]:
    """The centre is -R^T t: its change with w and dt is -R^T (dt + t x w)."""
    rotation, translation = poses(rig)
    back = -np.swapaxes(rotation, 1, 2)
    return np.concatenate([back @ _skews(translation), back, np.zeros((len(rig), 3, rig.camera_size - 6))], axis=2)


def _skews(vectors: Float[np.ndarray, "B 3"]) -> Float[np.ndarray, "B 3 3"]:
    return -np.cross(vectors[:, None, :], np.eye(3)[None])
