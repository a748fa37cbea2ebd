"""Where the cameras of `doubtful_rigs.py` stand, where they look, and where the light goes: eight kinds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from doubtful_rigs_cameras import looking


@dataclass(frozen=True)
class Layout:
    """C cameras and the space of the light; metres, z up, world frame of the room."""

    rotation: Float[np.ndarray, "C 3 3"]  # cam_from_world
    position: Float[np.ndarray, "C 3"]
    box: Float[np.ndarray, "2 3"]  # lowest and highest corner of the light's space
    width_deg: tuple[float, float]  # fields of view to draw from, full width
    sees_m: float = np.inf  # farther than this a camera does not see the light
    walks: bool = False  # the light goes from one end to the other and back, not at random
    turn_deg: float | None = None  # of nearly parallel axes: how far each is turned


def _wall(rng: np.random.Generator, cameras: int) -> Float[np.ndarray, "C 3"]:
    """Places along a wall at y = 0."""
    spacing = rng.uniform(1.6, 3.2) / (cameras - 1)
    x = spacing * (np.arange(cameras) - (cameras - 1) / 2 + rng.uniform(-0.2, 0.2, cameras))
    z = rng.uniform(1.0, 2.2) + rng.uniform(-0.4, 0.4, cameras) * rng.integers(0, 2)
    return np.stack([x, np.zeros(cameras), z], axis=1)


def _before_wall(rng: np.random.Generator, lower: float = 0.0) -> Float[np.ndarray, "2 3"]:
    return np.array([[-1.9, rng.uniform(1.3, 2.0), 0.3], [1.9, rng.uniform(4.5, 6.0), 2.4 - lower]])


def parallel(rng: np.random.Generator, cameras: int, down: float = 0.0, turn_deg: float | None = None) -> Layout:
    """Side by side along a wall, all axes alike, `down` by an angle (rad); each axis turned by `turn_deg` from it."""
    forward = np.tile([0.0, np.cos(down), -np.sin(down)], (cameras, 1))
    rotation = looking(forward, np.zeros(cameras))
    if turn_deg is not None:
        heading, roll = rng.uniform(0.0, 2 * np.pi, cameras), rng.normal(0.0, 0.3, cameras)
        turn = np.deg2rad(turn_deg) * np.stack([np.cos(heading), np.sin(heading), roll], axis=1)
        rotation = Rotation.from_rotvec(turn).as_matrix() @ rotation
    position = _wall(rng, cameras) + np.array([0.0, 0.0, 2.5 * np.sin(down)])
    return Layout(rotation, position, _before_wall(rng, np.sin(down)), (60.0, 85.0), turn_deg=turn_deg)


def nearly_parallel(rng: np.random.Generator, cameras: int) -> Layout:
    """As parallel, but each axis turned by 0.2 to 10 degrees in a direction of its own."""
    return parallel(rng, cameras, turn_deg=float(np.exp(rng.uniform(np.log(0.2), np.log(10.0)))))


def tilted_alike(rng: np.random.Generator, cameras: int) -> Layout:
    """As parallel, all looking down by 5 to 30 degrees."""
    return parallel(rng, cameras, down=np.deg2rad(rng.uniform(5.0, 30.0)))


def converging(rng: np.random.Generator, cameras: int) -> Layout:
    """On an arc, every axis through one point."""
    middle = np.array([0.0, 0.0, rng.uniform(0.9, 1.3)])
    arc = np.deg2rad(rng.uniform(30.0, 120.0))
    angle = arc * ((np.arange(cameras) + rng.uniform(-0.2, 0.2, cameras)) / (cameras - 1) - 0.5)
    away = rng.uniform(2.5, 4.5) * np.exp(rng.normal(0.0, 0.08, cameras))
    position = np.stack([away * np.sin(angle), -away * np.cos(angle), rng.uniform(1.2, 2.7, cameras)], axis=1)
    box = middle + np.array([[-1.4, -1.4, -0.9], [1.4, 1.4, 1.2]])
    return Layout(looking(middle - position, np.zeros(cameras)), position, box, (50.0, 80.0))


def in_a_line(rng: np.random.Generator, cameras: int) -> Layout:
    """Centres on one straight line, looking where each likes."""
    along = rng.uniform(2.5, 5.0) * ((np.arange(cameras) + rng.uniform(-0.25, 0.25, cameras)) / (cameras - 1) - 0.5)
    line = np.array([1.0, rng.normal(0.0, 0.1), rng.normal(0.0, 0.05)])
    position = along[:, None] * line + [0.0, 0.0, rng.uniform(1.2, 2.4)]
    target = rng.uniform([-1.2, 2.5, 0.6], [1.2, 4.0, 1.6], (cameras, 3))
    return Layout(_rolled(rng, target - position), position, _before_wall(rng), (60.0, 85.0))


def ring(rng: np.random.Generator, cameras: int) -> Layout:
    """All around the room, 1.4 to 2.9 m high, looking near its middle."""
    half = rng.uniform([2.2, 1.9], [3.5, 3.0])
    angle = 2 * np.pi * (np.arange(cameras) + rng.uniform(-0.3, 0.3, cameras)) / cameras
    position = np.stack([half[0] * np.cos(angle), half[1] * np.sin(angle), rng.uniform(1.4, 2.9, cameras)], axis=1)
    target = rng.normal([0.0, 0.0, 1.1], [0.4, 0.4, 0.2], (cameras, 3))
    box = np.array([[-0.75 * half[0], -0.75 * half[1], 0.3], [0.75 * half[0], 0.75 * half[1], 2.2]])
    return Layout(_rolled(rng, target - position), position, box, (55.0, 85.0))


def ceiling(rng: np.random.Generator, cameras: int) -> Layout:
    """Under the ceiling, looking down at the floor."""
    half, height = rng.uniform([1.8, 1.5], [3.0, 2.5]), rng.uniform(2.6, 3.3)
    angle = 2 * np.pi * (np.arange(cameras) + rng.uniform(-0.3, 0.3, cameras)) / cameras
    position = np.stack([half[0] * np.cos(angle), half[1] * np.sin(angle), np.full(cameras, height)], axis=1)
    target = rng.normal([0.0, 0.0, 0.4], [0.4, 0.4, 0.2], (cameras, 3))
    box = np.array([[-0.8 * half[0], -0.8 * half[1], 0.2], [0.8 * half[0], 0.8 * half[1], height - 0.9]])
    return Layout(_rolled(rng, target - position), position, box, (65.0, 90.0))


def corridor(rng: np.random.Generator, cameras: int) -> Layout:
    """In pairs on both walls of a corridor, looking along it; the light is seen by neighbours only."""
    pairs, apart, wide = cameras // 2, rng.uniform(1.8, 2.6), rng.uniform(2.0, 2.8)
    side = np.tile([-1.0, 1.0], pairs)
    x = apart * np.repeat(np.arange(pairs), 2) + rng.uniform(-0.3, 0.3, cameras)
    position = np.stack([x, side * (wide / 2 - 0.1), rng.uniform(1.9, 2.5, cameras)], axis=1)
    inwards, down = np.deg2rad(rng.uniform(5.0, 25.0, cameras)), np.deg2rad(rng.uniform(8.0, 22.0, cameras))
    forward = np.stack([np.cos(inwards), -side * np.sin(inwards), -np.tan(down)], axis=1)
    box = np.array([[0.8, -wide / 2 + 0.3, 0.3], [apart * (pairs - 1) + 3.0, wide / 2 - 0.3, 1.9]])
    return Layout(_rolled(rng, forward), position, box, (65.0, 90.0), sees_m=3.0 * apart, walks=True)


def _rolled(rng: np.random.Generator, forward: np.ndarray) -> np.ndarray:
    return looking(forward, rng.normal(0.0, np.deg2rad(3.0), len(forward)))


LAYOUTS: dict[str, Callable[[np.random.Generator, int], Layout]] = {
    "parallel": parallel,
    "nearly parallel": nearly_parallel,
    "tilted alike": tilted_alike,
    "converging": converging,
    "in a line": in_a_line,
    "ring": ring,
    "ceiling": ceiling,
    "corridor": corridor,
}
CRITICAL = ("parallel", "nearly parallel", "tilted alike")  # the layout itself may be the fault


def drawn_cameras(rng: np.random.Generator, kind: str) -> int:
    """How many cameras a rig of this kind has."""
    return 2 * int(rng.integers(3, 7)) if kind == "corridor" else int(rng.integers(3, 9))
