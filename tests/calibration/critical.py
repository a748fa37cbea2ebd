"""Rigs on their way through a critical configuration, projected in plain numpy, not by the package itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxpoint.calibration.alignment import umeyama
from jaxpoint.calibration.gauge import centres_by_parameters
from jaxpoint.calibration.result import Calibration
from jaxpoint.tracks import Tracks

FRAMES, NOISE_PX, SIZE, FOCAL = 400, 0.3, (1280, 720), 800.0


@dataclass(frozen=True)
class Truth:
    """Cameras and the light, m."""

    rotation: np.ndarray  # (C, 3, 3) cam_from_world
    centres: np.ndarray  # (C, 3)
    focal: np.ndarray  # (C, 2) px
    light: np.ndarray  # (F, 3)


def looking(centre, target) -> np.ndarray:
    z = np.asarray(target, float) - centre
    z /= np.linalg.norm(z)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def row(angle_deg, cameras=5) -> tuple[np.ndarray, np.ndarray]:
    """Cameras along a wall, their axes spread over so many degrees."""
    centres = np.stack([np.linspace(-2.0, 2.0, cameras), np.zeros(cameras), np.full(cameras, 2.0)], axis=1)
    turns = np.deg2rad(angle_deg) * np.linspace(0.5, -0.5, cameras)
    aims = np.stack([np.sin(turns), np.cos(turns), np.full(cameras, -0.15)], axis=1)
    return np.array([looking(c, c + a) for c, a in zip(centres, aims)]), centres


def ring(cameras=5, radius=4.0, height=2.6, middle=(0.0, 4.0, 1.2), roll_deg=0.0) -> tuple[np.ndarray, np.ndarray]:
    """Cameras around the light, looking at its middle; every second one rolled."""
    around = 2.0 * np.pi * (np.arange(cameras) + 0.2) / cameras
    centres = np.array(middle) + np.stack([radius * np.cos(around), radius * np.sin(around), 0 * around], axis=1)
    centres[:, 2] = height + 0.4 * np.cos(3.0 * around)
    turns = np.array([looking(c, middle) for c in centres])
    a = np.deg2rad(roll_deg) * (np.arange(cameras) % 2)
    zero, one = np.zeros(cameras), np.ones(cameras)
    rolls = np.stack([np.cos(a), -np.sin(a), zero, np.sin(a), np.cos(a), zero, zero, zero, one], axis=1)
    return rolls.reshape(-1, 3, 3) @ turns, centres


def waved(seed=0, extent=(1.8, 1.4, 0.9), middle=(0.0, 4.0, 1.2)) -> np.ndarray:
    """A smooth path of the light through a volume, m."""
    steps = 0.35 * np.cumsum(np.random.default_rng(seed).normal(size=(FRAMES, 3)), axis=0)
    return np.array(middle) + np.array(extent) * np.sin(steps)


def seen(cameras, light, *, aspect=1.0, crop=(0, 0), seed=0, outliers=0.02) -> tuple[Tracks, Truth]:
    """What the cameras see of the light: noise, gross outliers, and pixels so many times as wide as high.

    Args:
        aspect: of all cameras or of each.
        crop: columns and rows cut off at the left and at the top of camera 0.
    """
    rotation, centres = cameras
    rng = np.random.default_rng(1000 + seed)
    focal = np.stack([FOCAL / np.broadcast_to(aspect, len(centres)), np.full(len(centres), FOCAL)], axis=1)
    local = np.einsum("cij,fcj->fci", rotation, light[:, None] - centres)
    pixels = focal * local[..., :2] / local[..., 2:] + (np.array(SIZE) - 1) / 2.0
    sizes = np.tile(SIZE, (len(centres), 1))
    pixels[:, 0] -= crop
    sizes[0] -= crop
    visible = (local[..., 2] > 0.2) & (pixels >= 0).all(axis=-1) & (pixels <= sizes - 1).all(axis=-1)
    pixels = pixels + rng.normal(0.0, NOISE_PX, pixels.shape)
    wrong = rng.random(visible.shape) < outliers
    pixels = np.where(wrong[..., None], rng.random(pixels.shape) * sizes, pixels)
    return Tracks.from_pixels(pixels, sizes, visible), Truth(rotation, centres, focal, light)


def sigmas_off(found: Calibration, truth: Truth) -> float:
    """The largest error of a focal length or camera centre, in predicted sigmas; infinite without a covariance."""
    if found.camera_covariance is None:
        return np.inf
    chosen = [int(name.removeprefix("cam_")) for name in found.rig.names]
    count = len(chosen)
    blocks = np.einsum("cpcq->cpq", found.camera_covariance.reshape(count, -1, count, found.rig.camera_size))
    sigma = np.sqrt(np.einsum("cpp->cp", blocks))[:, 6:8]
    focal = np.abs(np.asarray(found.rig.cameras.focal) - truth.focal[chosen]) / sigma
    positions, valid = np.asarray(found.rig.positions), found.point_valid
    source = np.concatenate([positions, found.points[valid]])
    target = np.concatenate([truth.centres[chosen], truth.light[valid]])
    back = umeyama(target, source)
    apart = np.asarray(back @ truth.centres[chosen]) - positions
    by_camera = centres_by_parameters(found.rig)
    spread = np.einsum("cip,cpq,cjq->cij", by_camera, blocks, by_camera)
    centre = np.sqrt(np.einsum("ci,cij,cj->c", apart, np.linalg.inv(spread), apart) / 3.0)
    return float(max(focal.max(), centre.max()))
