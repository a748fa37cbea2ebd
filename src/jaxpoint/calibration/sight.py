"""How cameras see places: derivatives of the pixels, and whether a place is in view at all.

Numpy but for the range of the lenses: these answer one question about one rig, and compiling a program would take
longer than the answer.
"""

from __future__ import annotations

import jax
import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.calibration.bundle import CameraModel
from jaxpoint.camera.parameters import adjusted_lenses, change_by_adjusted
from jaxpoint.camera.rig import CameraRig

LEAST_POINTS = 512


def poses(rig: CameraRig) -> tuple[Float[np.ndarray, "C 3 3"], Float[np.ndarray, "C 3"]]:
    """Rotation and translation of `cam_from_world`."""
    pose = rig.cameras.cam_from_world
    return np.asarray(pose.rotation), np.asarray(pose.translation)


def centres(rig: CameraRig) -> Float[np.ndarray, "C 3"]:
    """Of the cameras, in the world."""
    rotation, translation = poses(rig)
    return -np.einsum("cji,cj->ci", rotation, translation)


def derivatives(
    rig: CameraRig, points: Float[np.ndarray, "B 3"], seen: Bool[np.ndarray, "B C"]
) -> tuple[Float[np.ndarray, "B C 2 p"], Float[np.ndarray, "B C 2 3"]]:
    """Of the pixels by the adjusted parameters (`camera.parameters`) and by the points; zero where not seen."""
    _, by_camera, by_point = _columns(rig, points)
    shape = seen.shape[::-1]
    stacked = (
        np.stack([np.stack([np.broadcast_to(entry, shape) for entry in row], axis=-1) for row in rows], axis=-2)
        for rows in (by_camera, by_point)
    )
    cameras, places = (np.where(seen[..., None, None], np.swapaxes(part, 0, 1), 0.0) for part in stacked)
    return cameras, places


def _columns(rig: CameraRig, points: Float[np.ndarray, "B 3"]) -> tuple[tuple, tuple, tuple]:
    """Pixels and their derivatives, component by component (C, B)."""
    rotation, translation = poses(rig)
    rest = np.concatenate([translation, adjusted_lenses(rig)], axis=1).T[:, :, None]
    state = np.moveaxis(rotation, 0, -1)[..., None], rest  # (3, 3, C, 1), (p - 3, C, 1)
    return CameraModel(type(rig.cameras.lens)).columns(state, points.T[:, None, :], np.zeros(2), np)


def derivatives_perturbed(
    rig: CameraRig, points: Float[np.ndarray, "B 3"], seen: Bool[np.ndarray, "B C"]
) -> tuple[Float[np.ndarray, "B C 2 p"], Float[np.ndarray, "B C 2 3"]]:
    """`derivatives`, by the parameters of `Camera.perturbed`."""
    by_camera, by_point = derivatives(rig, points, seen)
    return by_camera @ np.linalg.inv(change_by_adjusted(rig)), by_point


def cross_terms(
    by_camera: Float[np.ndarray, "B C 2 p"], by_point: Float[np.ndarray, "B C 2 3"]
) -> Float[np.ndarray, "B 3 D"]:
    """J_x^T J_c of the normal equations, from what `derivatives` gives; D = p C."""
    blocks = np.swapaxes(by_point, 2, 3) @ by_camera
    return blocks.transpose(0, 2, 1, 3).reshape(len(by_point), 3, -1)


def covariance_of_points(
    by_point: Float[np.ndarray, "B C 2 3"], seen: Bool[np.ndarray, "B C"]
) -> Float[np.ndarray, "B 3 3"]:
    """Of triangulated points for pixels of variance 1 and cameras without error; zero with fewer than two views."""
    stacked = by_point.reshape(len(by_point), -1, 3)
    normal = np.swapaxes(stacked, 1, 2) @ stacked
    enough = (seen.sum(axis=1) >= 2) & (np.linalg.det(normal) > 0)
    return np.where(enough[:, None, None], np.linalg.inv(np.where(enough[:, None, None], normal, np.eye(3))), 0.0)


def in_view(rig: CameraRig, points: Float[np.ndarray, "B 3"]) -> Bool[np.ndarray, "B C"]:
    """Whether each camera has each place in its image: within its frame, and where its lens is one-to-one.

    Walls and furniture are unknown here.
    """
    pixels = project(rig, points)
    sizes = np.asarray(rig.image_sizes)
    inside = ((pixels >= -0.5) & (pixels <= sizes - 0.5)).all(axis=-1)
    if rig.reach is not None:
        inside &= np.linalg.norm(pixels - np.asarray(rig.cameras.center), axis=-1) <= np.asarray(rig.reach)
    return inside & _in_range(rig, points)


def project(rig: CameraRig, points: Float[np.ndarray, "B 3"]) -> Float[np.ndarray, "B C 2"]:
    """Pixels of places in every camera; meaningless behind one, or beyond the reach of its lens."""
    pixels, _, _ = _columns(rig, points)
    return np.stack(pixels, axis=-1).swapaxes(0, 1)


def _in_range(rig: CameraRig, points: Float[np.ndarray, "B 3"]) -> Bool[np.ndarray, "B C"]:
    """Padded to few lengths: each one is a program, and compiling it takes longer than running it."""
    padded = np.zeros((max(LEAST_POINTS, 1 << max(len(points) - 1, 0).bit_length()), 3))
    padded[: len(points)] = points
    with jax.enable_x64(True):
        return np.asarray(rig.sees(padded))[: len(points)]
