"""Rectification of two cameras: turned about their centres so that rows of both images correspond.

Both see along one direction, across the baseline (Fusiello, Trucco and Verri 2000), with one matrix K.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.camera.camera import Camera
from jaxpoint.errors import InsufficientDataError, UsageError

WIDEST = np.deg2rad(100.0)  # across a rectified image: a plane holds no more of a fisheye without waste
LEAST_BASELINE = 1e-9


@dataclass(frozen=True)
class Rectification:
    """How two images are rectified."""

    rotations: Float[np.ndarray, "2 3 3"]  # rect_from_cam of the left and the right camera
    intrinsics: Float[np.ndarray, "3 3"]  # K of both rectified images, px
    baseline: float  # from the left to the right camera, in the unit of the rig
    size: tuple[int, int]  # of the rectified images, px, width and height

    @property
    def to_points(self) -> Float[np.ndarray, "4 4"]:
        """OpenCV's Q: (x, y, disparity, 1) to homogeneous points in the left rectified camera."""
        focal, (cx, cy) = self.intrinsics[0, 0], self.intrinsics[:2, 2]
        return np.array([[1, 0, 0, -cx], [0, 1, 0, -cy], [0, 0, 0, focal], [0, 0, 1 / self.baseline, 0]])

    def points(self, disparity: Float[np.ndarray, "H W"]) -> Float[np.ndarray, "H W 3"]:
        """Points in the left camera's own frame, in the unit of the rig; NaN where there is no disparity."""
        focal, (cx, cy) = self.intrinsics[0, 0], self.intrinsics[:2, 2]
        y, x = np.indices(disparity.shape)
        depth = focal * self.baseline / np.where(disparity > 0, disparity, np.nan)
        rectified = np.stack([(x - cx) / focal * depth, (y - cy) / focal * depth, depth], axis=-1)
        return rectified @ self.rotations[0]


def rectify(left: Camera, right: Camera, size: tuple[int, int]) -> Rectification:
    """The rectification of two cameras with images of this size.

    The focal length is the mean of both, so that the middle of the image keeps its scale; of fisheyes it is what makes
    100 degrees fit.

    Raises:
        InsufficientDataError: the cameras stand at one place.
        UsageError: the left camera stands to the right of the other one.
    """
    turns = [np.asarray(camera.cam_from_world.rotation) for camera in (left, right)]
    centres = [-turn.T @ np.asarray(camera.cam_from_world.translation) for turn, camera in zip(turns, (left, right))]
    along = centres[1] - centres[0]
    baseline = float(np.linalg.norm(along))
    if baseline < LEAST_BASELINE:
        raise InsufficientDataError("Both cameras stand at one place (0 mm apart); stereo needs a baseline.")
    x = along / baseline
    if turns[0][0] @ x + turns[1][0] @ x < -1e-3:
        raise UsageError("The left camera stands to the right of the other one; name them the other way round.")
    ahead = turns[0][2] + turns[1][2]
    y = np.cross(ahead, x)
    if np.linalg.norm(y) < 1e-3:
        raise InsufficientDataError(
            "The cameras look along their baseline (within 0.1 degrees), which no rectification serves; turn them "
            "across it."
        )
    y = y / np.linalg.norm(y)
    rect_from_world = np.stack([x, y, np.cross(x, y)])
    rotations = np.stack([rect_from_world @ turn.T for turn in turns])
    return Rectification(rotations, _intrinsics(left, right, rotations, size), baseline, size)


def flat_focal(cameras: Sequence[Camera], size: tuple[int, int]) -> float:
    """The focal length (px) of flat images of these cameras: their mean, or what fits 100 degrees of a wide lens."""
    if cameras[0].lens.sees_sideways:
        return float((size[0] / 2) / np.tan(WIDEST / 2))
    return float(np.mean([np.asarray(camera.focal) for camera in cameras]))


def _intrinsics(left: Camera, right: Camera, rotations, size: tuple[int, int]) -> Float[np.ndarray, "3 3"]:
    """K with the middle of both images, in the mean, at the middle of the rectified ones."""
    focal = flat_focal([left, right], size)
    middle = (np.array(size) - 1) / 2.0
    shifts = []
    for camera, turn in zip((left, right), rotations):
        direction = turn @ unit_directions(camera, middle[None])[0][0]
        shifts.append(direction[:2] / direction[2] if direction[2] > 0.1 else np.zeros(2))
    cx, cy = middle - focal * np.mean(shifts, axis=0)
    return np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1.0]])


def unit_directions(
    camera: Camera, pixels: Float[np.ndarray, "N 2"]
) -> tuple[Float[np.ndarray, "N 3"], Bool[np.ndarray, " N"]]:
    """Directions of pixels in the camera's own frame, and whether the lens has them."""
    with jax.enable_x64(True):
        directions, valid = camera.lens.unproject(np.asarray(pixels, float))
    return np.asarray(directions), np.asarray(valid)


def rectified_pixels(
    rectification: Rectification, camera: Camera, which: int, pixels: Float[np.ndarray, "N 2"]
) -> tuple[Float[np.ndarray, "N 2"], Bool[np.ndarray, " N"]]:
    """Where pixels of the left (0) or right (1) image lie in the rectified one, and whether they lie ahead there."""
    directions, valid = unit_directions(camera, pixels)
    turned = directions @ rectification.rotations[which].T
    ahead = valid & (turned[:, 2] > 0.1)
    z = np.where(ahead, turned[:, 2], 1.0)[:, None]
    return (turned / z @ rectification.intrinsics.T)[:, :2], ahead
