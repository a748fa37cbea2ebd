"""The cameras of the simulated room: on its walls, unlike lenses, looking at the middle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import jax
import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from jaxpoint.camera.rig import CameraRig
from jaxpoint.config.simulation import ViewpointSettings
from jaxpoint.simulate.scene import Scene

CLEARANCE_M = 0.2  # between a camera and furniture
FROM_WALL_M = 0.08


@dataclass(frozen=True)
class Viewpoint:
    """One camera in plain numbers, for drawing; `rig_of` makes the real thing."""

    focal: float  # px
    center: Float[np.ndarray, "2"]  # px
    distortion: Float[np.ndarray, "5"]  # k1, k2, p1, p2, k3
    rotation: Float[np.ndarray, "3 3"]  # cam_from_world
    position: Float[np.ndarray, "3"]  # m
    size: tuple[int, int]  # px

    def project(self, points: Float[np.ndarray, "N 3"]) -> tuple[Float[np.ndarray, "N 2"], Float[np.ndarray, " N"]]:
        """Pixels and depth (m) of points (m); no number where the lens model does not reach."""
        local = (np.asarray(points, float) - self.position) @ self.rotation.T
        depth = local[:, 2]
        ahead = depth > 0.05
        plane = local[:, :2] / np.where(ahead, depth, 1.0)[:, None]
        usable = ahead & ((plane**2).sum(axis=1) < self._reach() ** 2)
        kept = np.where(usable[:, None], local, [0.0, 0.0, 1.0])
        matrix = np.array([[self.focal, 0.0, self.center[0]], [0.0, self.focal, self.center[1]], [0.0, 0.0, 1.0]])
        pixels = cv2.projectPoints(kept, np.zeros(3), np.zeros(3), matrix, self.distortion)[0].reshape(-1, 2)
        return np.where(usable[:, None], pixels, np.nan), depth

    def _reach(self) -> float:
        """Radius on the z = 1 plane up to which the radial polynomial grows, less a little."""
        k1, k2 = self.distortion[:2]
        roots = np.roots([5 * k2, 3 * k1, 1.0])
        turning = roots[np.isreal(roots) & (roots.real > 0)].real
        return float(np.sqrt(0.98 * min(turning.min(initial=np.inf), 25.0)))


def random_viewpoints(rng: Generator, settings: ViewpointSettings, scene: Scene) -> list[Viewpoint]:
    """Cameras spread along the walls, clear of the furniture."""
    share = (np.arange(settings.cameras) + rng.uniform(0.0, 1.0)) / settings.cameras
    return [_viewpoint(rng, settings, scene, along) for along in share]


def rig_of(viewpoints: Sequence[Viewpoint]) -> CameraRig:
    """The true cameras as a rig, named cam_0, cam_1, ..."""
    rotation = np.stack([view.rotation for view in viewpoints])
    position = np.stack([view.position for view in viewpoints])
    with jax.enable_x64(True):
        return CameraRig.from_parameters(
            np.array([[view.focal, view.focal] for view in viewpoints]),
            np.stack([view.center for view in viewpoints]),
            np.stack([view.distortion for view in viewpoints]),
            rotation,
            -np.einsum("cij,cj->ci", rotation, position),
            np.array([view.size for view in viewpoints]),
        )


def _viewpoint(rng: Generator, settings: ViewpointSettings, scene: Scene, along: float) -> Viewpoint:
    width, height = settings.size
    field = np.deg2rad(rng.uniform(settings.field_of_view_deg.low, settings.field_of_view_deg.high))
    focal = width / 2 / np.tan(field / 2)
    center = (np.array(settings.size) - 1) / 2 + rng.normal(0.0, settings.center_sd * width, 2)
    position = _free_place(rng, settings, scene, along)
    target = scene.size * [0.5, 0.5, 0.37] + rng.normal(0.0, [0.3, 0.25, 0.1])
    return Viewpoint(
        float(focal),
        center,
        _lens(rng, settings, np.hypot(width, height) / 2 / focal),
        _looking(rng, target - position, settings.roll_sd_deg),
        position,
        (width, height),
    )


def _free_place(rng: Generator, settings: ViewpointSettings, scene: Scene, along: float) -> np.ndarray:
    """A place on the walls near this share of the way around, m, in which no furniture stands or blocks the view."""
    length, width, _ = scene.size
    low, high = scene.boxes[:, 0], scene.boxes[:, 1]
    for _ in range(200):
        ground = _on_walls((along + rng.uniform(-0.5, 0.5) / settings.cameras) % 1.0, length, width)
        place = np.append(ground, rng.uniform(settings.height_m.low, settings.height_m.high))
        inward = (scene.size * [0.5, 0.5, 0.37] - place) * 0.25
        probes = place + np.linspace(0.0, 1.0, 8)[:, None] * inward
        hit = (probes[:, None] > low - CLEARANCE_M) & (probes[:, None] < high + CLEARANCE_M)
        if not hit.all(axis=-1).any():
            return place
    return np.append(ground, 2.8)


def _on_walls(share: float, length: float, width: float) -> np.ndarray:
    """The place on the ground plan at this share of the way around, m."""
    inset = np.array([FROM_WALL_M, FROM_WALL_M])
    far = np.array([length, width]) - inset
    along = share * 2 * (length + width)
    if along < length:
        place = np.array([along, 0.0])
    elif along < length + width:
        place = np.array([length, along - length])
    elif along < 2 * length + width:
        place = np.array([2 * length + width - along, width])
    else:
        place = np.array([0.0, 2 * (length + width) - along])
    return np.clip(place, inset, far)


def _lens(rng: Generator, settings: ViewpointSettings, corner: float) -> np.ndarray:
    """Brown coefficients whose radial polynomial grows well beyond the image's corner (at that radius for no lens)."""
    while True:
        k1 = rng.uniform(settings.k1.low, settings.k1.high)
        k2 = rng.uniform(0.4, 1.2) * k1**2
        radius = np.linspace(0.0, 2.5 * corner, 400)
        seen = radius * (1 + k1 * radius**2 + k2 * radius**4)
        grows = np.gradient(seen, radius) > 0.05
        reach = seen[: len(grows) if grows.all() else int(np.argmin(grows))].max()
        if reach > 1.12 * corner:
            return np.array([k1, k2, *rng.normal(0.0, settings.tangential, 2), 0.0])


def _looking(rng: Generator, forward: np.ndarray, roll_sd_deg: float) -> np.ndarray:
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    roll = np.deg2rad(rng.normal(0.0, roll_sd_deg))
    x = np.cos(roll) * right + np.sin(roll) * down
    return np.stack([x, np.cross(forward, x), forward])
