"""True cameras of `doubtful_rigs.py`, in plain numpy and apart from jaxpoint's own: no exam of a code by itself.

Two lenses: a perspective one with k1 and k2 (OpenCV's order), and an equidistant one, r = f theta, with k1 and k2 in
theta (OpenCV's fisheye). Pixels need not be square.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

NEAR_M = 0.2  # what is nearer is not seen
STEEPEST = np.deg2rad(88.0)  # off the axis: where an equidistant lens ends
PARAMETERS = 12  # of one camera, in the order of `Cameras.moved`


@dataclass(frozen=True)
class Cameras:
    """C cameras in a world with z up: x right, y down, z forward; pixel (0, 0) is the centre of the top-left pixel."""

    rotation: Float[np.ndarray, "C 3 3"]  # cam_from_world
    position: Float[np.ndarray, "C 3"]  # m
    focal: Float[np.ndarray, " C"]  # px, in y
    aspect: Float[np.ndarray, " C"]  # width over height of a pixel: fx = fy / aspect
    center: Float[np.ndarray, "C 2"]  # px, principal point
    radial: Float[np.ndarray, "C 2"]  # k1, k2
    equidistant: Bool[np.ndarray, " C"]
    size: Int[np.ndarray, "C 2"]  # px, width and height

    def __len__(self) -> int:
        """Number of cameras."""
        return len(self.focal)

    @property
    def focals(self) -> Float[np.ndarray, "C 2"]:
        """px, in x and y; of an equidistant lens those at its centre."""
        return np.stack([self.focal / self.aspect, self.focal], axis=1)

    @property
    def extent_m(self) -> float:
        """Largest distance between two cameras, m."""
        return float(np.linalg.norm(self.position[:, None] - self.position, axis=2).max())

    def select(self, chosen: np.ndarray) -> Cameras:
        """Some of the cameras (indices or a mask)."""
        return Cameras(**{name: values[chosen] for name, values in vars(self).items()})

    def local(self, points: Float[np.ndarray, "F C 3"]) -> Float[np.ndarray, "F C 3"]:
        """What is in front of each camera, in its own frame, m."""
        return np.einsum("cij,fcj->fci", self.rotation, points - self.position)

    def project(self, points: Float[np.ndarray, "F C 3"]) -> Float[np.ndarray, "F C 2"]:
        """Pixels of the points in front of each camera; meaningful where `sees`."""
        x, y, z = np.moveaxis(self.local(points), -1, 0)
        across = np.hypot(x, y)
        angle = np.arctan2(across, z)
        slope = across / np.where(z > 0, np.maximum(z, 1e-9), 1e-9)
        radius = np.where(self.equidistant, angle, slope)
        k1, k2 = self.radial.T
        ratio = radius * (1 + k1 * radius**2 + k2 * radius**4) / np.where(across > 0, across, 1.0)
        # On the axis both lenses are the plain one.
        ratio = np.where(across > 0, ratio, 1.0 / np.where(z > 0, np.maximum(z, 1e-9), 1.0))
        return self.focals * np.stack([x * ratio, y * ratio], axis=-1) + self.center

    def sees(self, points: Float[np.ndarray, "F C 3"]) -> Bool[np.ndarray, "F C"]:
        """Whether each point lies before its camera, within the lens's range and inside the image."""
        x, y, z = np.moveaxis(self.local(points), -1, 0)
        angle = np.arctan2(np.hypot(x, y), z)
        pixels = self.project(points)
        inside = ((pixels >= 0) & (pixels <= self.size - 1)).all(axis=-1)
        return inside & (z > NEAR_M) & (angle < np.minimum(self._reach(), STEEPEST))

    def _reach(self) -> Float[np.ndarray, " C"]:
        """The angle off the axis (rad) at which a lens's polynomial begins to turn back."""
        radius = np.linspace(0.0, 8.0, 801)
        k1, k2 = self.radial.T[:, :, None]
        turns = 1 + 3 * k1 * radius**2 + 5 * k2 * radius**4 < 0.1
        first = np.where(turns.any(axis=1), radius[np.argmax(turns, axis=1)], np.inf)
        return np.where(self.equidistant, np.minimum(first, np.pi / 2), np.arctan(first))

    def moved(self, change: Float[np.ndarray, "C 12"]) -> Cameras:
        """The cameras a little off: rotation vector w, R -> exp(w) R (rad), position (m), log focal length, log aspect,
        principal point (px), k1, k2."""
        return Cameras(
            Rotation.from_rotvec(change[:, :3]).as_matrix() @ self.rotation,
            self.position + change[:, 3:6],
            self.focal * np.exp(change[:, 6]),
            self.aspect * np.exp(change[:, 7]),
            self.center + change[:, 8:10],
            self.radial + change[:, 10:12],
            self.equidistant,
            self.size,
        )


def looking(forward: Float[np.ndarray, "C 3"], roll: Float[np.ndarray, " C"]) -> Float[np.ndarray, "C 3 3"]:
    """cam_from_world of cameras that look along `forward` (never straight up or down), rolled about it (rad)."""
    forward = forward / np.linalg.norm(forward, axis=1, keepdims=True)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    down = np.cross(forward, right)
    across = np.cos(roll)[:, None] * right + np.sin(roll)[:, None] * down
    return np.stack([across, np.cross(forward, across), forward], axis=1)
