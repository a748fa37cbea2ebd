"""Rooms to adjust: cameras on the walls, points in the room, a start that is a little wrong everywhere.

A room of 6 x 5 x 3 m, images of 1280 x 720, 0.5 px of noise. The cameras stand on the four walls and look at a place
near the middle; their focal lengths differ, and so does their distortion. A point is observed where it is in front of
the camera and inside the image, thinned at random to the share of a size; every point keeps two cameras at least. The
start is off by 1 % in focal length, 1 degree in rotation, 2 cm in camera centre and 3 cm in points (one sigma each, of
every component), and knows neither distortion nor principal point. The same seed gives the same problem.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from problem import BundleProblem, bent, in_cameras, on_plane
from scipy.spatial.transform import Rotation

ROOM_M = np.array([6.0, 5.0, 3.0])
IMAGE_PX = np.array([1280, 720])
MIDDLE_PX = (IMAGE_PX - 1) / 2
NOISE_PX = 0.5
FOCAL_PX = (550.0, 900.0)  # wide enough that more is seen than the share asks for
MAX_RADIUS2 = 9.0  # on the plane of unit depth: no lens is asked for more
WALL_M = 0.05  # from the wall to a camera
WALKED_M = np.array([[0.8, 0.8, 0.3], [5.2, 4.2, 2.2]])  # where the light is waved
OFF_FOCAL, OFF_ROTATION, OFF_CENTRE_M, OFF_POINT_M = 0.01, np.deg2rad(1.0), 0.02, 0.03

SizeName = Literal["S", "M", "L", "XL"]


@dataclass(frozen=True)
class Size:
    """How large a room's problem is."""

    cameras: int
    points: int
    share: float  # of all pairs of a camera and a point that are observed


SIZES: dict[SizeName, Size] = {
    "S": Size(6, 500, 0.8),
    "M": Size(6, 5_000, 0.8),
    "L": Size(16, 20_000, 0.8),
    "XL": Size(64, 100_000, 0.36),
}


def room_problem(size: Size, parameters: int, seed: int) -> BundleProblem:
    """One room of this size, 11 or 15 parameters a camera."""
    rng = np.random.default_rng([seed, size.cameras, size.points, parameters])
    cameras = _true_cameras(rng, size.cameras, parameters)
    points, pixels, seen = _seen_points(rng, cameras, size)
    kept = _thinned(rng, seen, size.share)
    point_of, camera_of = np.nonzero(kept)
    noisy = pixels[point_of, camera_of] + rng.normal(0.0, NOISE_PX, (len(point_of), 2))
    start = points + rng.normal(0.0, OFF_POINT_M, points.shape)
    return BundleProblem(_disturbed(rng, cameras), start, camera_of.astype(np.int32), point_of.astype(np.int32), noisy)


def _true_cameras(rng: np.random.Generator, count: int, parameters: int) -> np.ndarray:
    rotation, position = _poses(rng, count)
    turned = Rotation.from_matrix(rotation)
    focal = rng.uniform(*FOCAL_PX, count)
    center = MIDDLE_PX + rng.normal(0.0, 0.01 * IMAGE_PX[0], (count, 2))
    k1 = rng.uniform(-0.2, -0.05, count)
    radial = np.stack([k1, k1**2 * rng.uniform(0.6, 1.0, count)], axis=1)  # never folds back: k2 > 9/20 k1^2
    pose = np.concatenate([turned.as_rotvec(), -turned.apply(position)], axis=1)
    if parameters == 11:
        return np.concatenate([pose, focal[:, None], center, radial], axis=1)
    focals = np.stack([focal * rng.normal(1.0, 0.005, count), focal], axis=1)
    tangential, k3 = rng.normal(0.0, 0.001, (count, 2)), rng.uniform(0.0, 0.002, (count, 1))
    return np.concatenate([pose, focals, center, radial, tangential, k3], axis=1)


def _poses(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Rotations cam_from_world (C, 3, 3) and centres (C, 3), m, evenly around the walls."""
    share = (np.arange(count) + rng.uniform(0.1, 0.9, count)) / count
    position = np.concatenate([_on_walls(share), rng.uniform(1.8, 2.9, (count, 1))], axis=1)
    target = ROOM_M * [0.5, 0.5, 0.4] + rng.normal(0.0, 0.25, (count, 3))
    forward = _unit(target - position)
    right = _unit(np.cross(forward, [0.0, 0.0, 1.0]))
    return np.stack([right, np.cross(forward, right), forward], axis=1), position


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _on_walls(share: np.ndarray) -> np.ndarray:
    """Places on the ground plan (C, 2), m, at these shares of the way around the walls."""
    length, width = ROOM_M[:2] - 2 * WALL_M
    corners = np.array([[0, 0], [length, 0], [length, width], [0, width], [0, 0]]) + WALL_M
    way = np.array([0, length, length + width, 2 * length + width, 2 * (length + width)])
    return np.stack([np.interp(share * way[-1], way, corners[:, axis]) for axis in range(2)], axis=1)


def _seen_points(rng: np.random.Generator, cameras: np.ndarray, size: Size) -> tuple[np.ndarray, ...]:
    """Points (P, 3), their exact pixels (P, C, 2) and where these are visible; two cameras at least see every point."""
    points = rng.uniform(WALKED_M[0], WALKED_M[1], (size.points, 3))
    for _ in range(100):
        pixels, seen = _projected(cameras, points)
        lost = seen.sum(axis=1) < 2
        if not lost.any():
            return points, pixels, seen
        points[lost] = rng.uniform(WALKED_M[0], WALKED_M[1], (int(lost.sum()), 3))
    raise ValueError(f"Some places are seen by fewer than two of {size.cameras} cameras; use more cameras.")


def _projected(cameras: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    pixels, seen = np.empty((len(points), len(cameras), 2)), np.empty((len(points), len(cameras)), bool)
    each = np.arange(len(points))
    for index, camera in enumerate(cameras):
        local = in_cameras(camera[None], points, np.zeros_like(each), each)
        u, v = on_plane(np.where(local[:, 2:] > 0.1, local, 1.0), len(camera))
        pixels[:, index] = bent(np.broadcast_to(camera[6:], (len(points), len(camera) - 6)), u, v)
        inside = ((pixels[:, index] >= 0) & (pixels[:, index] <= IMAGE_PX - 1)).all(axis=1)
        seen[:, index] = inside & (local[:, 2] > 0.1) & (u * u + v * v < MAX_RADIUS2)
    return pixels, seen


def _thinned(rng: np.random.Generator, seen: np.ndarray, share: float) -> np.ndarray:
    """A random part of what is seen, `share` of all pairs, two of every point among them."""
    wanted = round(share * seen.size)
    if seen.sum() < wanted:
        raise ValueError(f"{seen.mean():.0%} of all pairs are seen and {share:.0%} wanted; use shorter focal lengths.")
    order = np.where(seen, rng.random(seen.shape), np.inf)
    first_two = np.argsort(order, axis=1)[:, :2]
    np.put_along_axis(order, first_two, -1.0, axis=1)
    return order <= np.partition(order.ravel(), wanted - 1)[wanted - 1]


def _disturbed(rng: np.random.Generator, cameras: np.ndarray) -> np.ndarray:
    """The cameras as the solvers first see them."""
    count, start = len(cameras), cameras.copy()
    true = Rotation.from_rotvec(cameras[:, :3])
    centre = -true.inv().apply(cameras[:, 3:6]) + rng.normal(0.0, OFF_CENTRE_M, (count, 3))
    turned = Rotation.from_rotvec(rng.normal(0.0, OFF_ROTATION, (count, 3))) * true
    focals = 1 if cameras.shape[1] == 11 else 2
    start[:, :3], start[:, 3:6] = turned.as_rotvec(), -turned.apply(centre)
    start[:, 6 : 6 + focals] *= 1.0 + rng.normal(0.0, OFF_FOCAL, (count, 1))
    start[:, 6 + focals : 8 + focals], start[:, 8 + focals :] = MIDDLE_PX, 0.0
    return start
