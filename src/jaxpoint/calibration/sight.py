"""How cameras see places: derivatives of the pixels, and whether a place is in view at all.

Plain numpy: these answer one question about one rig, and compiling a program would take longer than the answer.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.calibration.bundle import ASPECT, FOCAL, SIZE, BrownModel
from jaxpoint.calibration.hypotheses import known_numbers
from jaxpoint.camera.rig import CameraRig

MODEL = BrownModel()
RADII = 64  # steps in which a lens is followed from its axis outwards


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
) -> tuple[Float[np.ndarray, "B C 2 15"], Float[np.ndarray, "B C 2 3"]]:
    """Of the pixels by the cameras' numbers, as `bundle` orders them, and by the points; zero where not seen."""
    rotation, translation = poses(rig)
    numbers = np.concatenate([translation, known_numbers(rig)], axis=1).T[:, :, None]
    state = np.moveaxis(rotation, 0, -1)[..., None], numbers  # (3, 3, C, 1), (12, C, 1)
    _, by_camera, by_point = MODEL.columns(state, points.T[:, None, :], np.zeros(2), np)
    shape = seen.shape[::-1]
    stacked = (
        np.stack([np.stack([np.broadcast_to(entry, shape) for entry in row], axis=-1) for row in rows], axis=-2)
        for rows in (by_camera, by_point)
    )
    cameras, places = (np.where(seen[..., None, None], np.swapaxes(part, 0, 1), 0.0) for part in stacked)
    return cameras, places


def perturbed_by_numbers(rig: CameraRig) -> Float[np.ndarray, "C 15 15"]:
    """From the numbers of `bundle` to those of `Camera.perturbed`: log focal, log aspect become fx, fy."""
    fx, fy = np.asarray(rig.cameras.focal).T
    turn = np.tile(np.eye(SIZE), (len(rig), 1, 1))
    turn[:, FOCAL, FOCAL], turn[:, FOCAL, ASPECT] = fx, fx
    turn[:, ASPECT, FOCAL], turn[:, ASPECT, ASPECT] = fy, 0.0
    return turn


def derivatives_perturbed(
    rig: CameraRig, points: Float[np.ndarray, "B 3"], seen: Bool[np.ndarray, "B C"]
) -> tuple[Float[np.ndarray, "B C 2 15"], Float[np.ndarray, "B C 2 3"]]:
    """`derivatives`, by the numbers of `Camera.perturbed`."""
    by_camera, by_point = derivatives(rig, points, seen)
    return by_camera @ np.linalg.inv(perturbed_by_numbers(rig)), by_point


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
    """Whether each camera has each place in its image: before it, within its frame, and where its lens is one-to-one.

    Walls and furniture are unknown here.
    """
    rotation, translation = poses(rig)
    local = np.einsum("cij,bj->bci", rotation, points) + translation
    ahead = local[..., 2] > 1e-9
    plane = local[..., :2] / np.where(ahead, local[..., 2], 1.0)[..., None]
    square = (plane**2).sum(axis=-1)
    pixels = project(rig, points)
    sizes = np.asarray(rig.image_sizes)
    inside = ((pixels >= -0.5) & (pixels <= sizes - 0.5)).all(axis=-1)
    if rig.reach is not None:
        inside &= np.linalg.norm(pixels - np.asarray(rig.cameras.center), axis=-1) <= np.asarray(rig.reach)
    return ahead & inside & (square <= _reach(np.asarray(known_numbers(rig))[:, 4:], square.max(initial=1.0)))


def project(rig: CameraRig, points: Float[np.ndarray, "B 3"]) -> Float[np.ndarray, "B C 2"]:
    """Pixels of places in every camera; meaningless behind one, or beyond the reach of its lens."""
    rotation, translation = poses(rig)
    numbers = np.concatenate([translation, known_numbers(rig)], axis=1).T[:, :, None]
    state = np.moveaxis(rotation, 0, -1)[..., None], numbers
    pixels, _, _ = MODEL.columns(state, points.T[:, None, :], np.zeros(2), np)
    return np.stack(pixels, axis=-1).swapaxes(0, 1)


def _reach(lens: Float[np.ndarray, "C 5"], farthest: float) -> Float[np.ndarray, " C"]:
    """The squared radius on the z = 1 plane up to which each lens bends farther rays farther out."""
    square = np.linspace(0.0, min(farthest, 9.0), RADII)
    k1, k2, k3 = lens[:, 0, None], lens[:, 1, None], lens[:, 4, None]
    grows = 1 + square * (3 * k1 + square * (5 * k2 + square * 7 * k3)) > 0
    return np.where(grows.all(axis=1), np.inf, square[np.argmin(grows, axis=1)])
