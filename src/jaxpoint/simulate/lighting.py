"""Light on surfaces: lamps with soft shadows, and what walls and ceiling send back.

A lamp is a few points on its disc; light sent back is a dozen weak points on ceiling and walls (Keller, Instant
Radiosity, 1997). Each point has a map of what it sees, in the equidistant projection, over the half space before it
and a little more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from jaxpoint.simulate.raster import rasterise
from jaxpoint.simulate.scene import INTENSITY, Lamp, Scene

MAP_PX = 384
REACH_RAD = 0.6 * np.pi  # no light leaves beyond a right angle; straight behind, the projection is singular
BIAS_M = 0.04
POINTS_A_LAMP = 6
NEAREST_M = 0.6  # keeps what almost touches a point from shining


@dataclass(frozen=True)
class LightPoint:
    """A point that shines into the half space around `axis`, with the cosine of the angle to it."""

    position: Float[np.ndarray, "3"]  # m
    axis: Float[np.ndarray, "3"]
    intensity: Float[np.ndarray, "3"]  # linear red, green, blue at 1 m

    def on_map(self, points: Float[np.ndarray, "N 3"]) -> tuple[Float[np.ndarray, "N 2"], Float[np.ndarray, " N"]]:
        """Place on the point's map, px, and distance, m; not finite behind."""
        offset = points - self.position
        distance = np.linalg.norm(offset, axis=1)
        right, down = _frame(self.axis)
        x, y, z = offset @ right, offset @ down, offset @ self.axis
        across = np.hypot(x, y)
        angle = np.arctan2(across, z)
        reach = np.where(angle < REACH_RAD, angle / REACH_RAD, np.nan) * (MAP_PX / 2)
        scale = reach / np.where(across > 0, across, 1.0)
        return np.stack([x * scale, y * scale], axis=1) + (MAP_PX - 1) / 2, distance

    def seen_by(self, points: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "T 3"]) -> np.ndarray:
        """The map (MAP_PX, MAP_PX): distance to the nearest of these triangles, m, infinite where there is none."""
        place, distance = self.on_map(points)
        raster = rasterise(place[triangles], distance[triangles], (MAP_PX, MAP_PX), both_sides=True)
        return raster.depth

    def arriving(self, points: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
        """What reaches surfaces when nothing stands between."""
        offset = self.position - points
        square = np.maximum((offset**2).sum(axis=1), NEAREST_M**2)
        towards = np.einsum("nc,nc->n", offset, normals) / np.sqrt(square)
        leaving = np.maximum(-(offset @ self.axis) / np.sqrt(square), 0.0)
        return (np.maximum(towards, 0.0) * leaving / square)[:, None] * self.intensity


def is_lit(seen: np.ndarray, place: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """Whether points at a place on a light's map are the first that the light meets there."""
    safe = np.nan_to_num(place, nan=0.0)
    column, row = (np.clip(np.rint(safe[:, i]).astype(np.int32), 0, MAP_PX - 1) for i in range(2))
    return (distance <= seen[row, column] * 1.01 + BIAS_M) & np.isfinite(place[:, 0])


@dataclass(frozen=True)
class RoomLight:
    """The light of a room: what arrives at the corners of its surfaces, of each lamp and in all."""

    lamps: tuple[LightPoint, ...]  # the middle of each lamp, as strong as the whole
    lamp_maps: tuple[np.ndarray, ...]  # what each sees of the empty room
    indirect: tuple[LightPoint, ...]
    ambient: Float[np.ndarray, "3"]
    direct: Float[np.ndarray, "L V 3"]  # of each lamp
    total: Float[np.ndarray, "V 3"]

    def on(self, points: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"]) -> tuple[np.ndarray, np.ndarray]:
        """What arrives at points in the room: of each lamp (L, N, 3), furniture's shadow included, and the rest."""
        direct = np.stack(
            [
                lamp.arriving(points, normals) * is_lit(seen, *lamp.on_map(points))[:, None]
                for lamp, seen in zip(self.lamps, self.lamp_maps)
            ]
        )
        return direct, self.ambient + sum(point.arriving(points, normals) for point in self.indirect)


def light_room(scene: Scene) -> RoomLight:
    """Light every corner of the room's surfaces."""
    surfaces = scene.surfaces
    points, normals = surfaces.vertices, surfaces.normals
    lifted = points + 0.01 * normals

    def lit(light: LightPoint) -> np.ndarray:
        seen = light.seen_by(points, surfaces.triangles)
        return light.arriving(lifted, normals) * is_lit(seen, *light.on_map(lifted))[:, None]

    down = np.array([0.0, 0.0, -1.0])
    direct = np.stack([sum(lit(point) for point in _points_of(lamp)) for lamp in scene.lamps])
    indirect = _sent_back(scene)
    ambient = 0.08 * scene.indirect * np.ones(3)
    lamps = tuple(LightPoint(lamp.position, down, lamp.intensity) for lamp in scene.lamps)
    maps = tuple(lamp.seen_by(points, surfaces.triangles) for lamp in lamps)
    total = direct.sum(axis=0) + ambient + sum(lit(point) for point in indirect)
    return RoomLight(lamps, maps, indirect, ambient, direct.astype(np.float32), total.astype(np.float32))


def _points_of(lamp: Lamp) -> list[LightPoint]:
    """The lamp's disc as its middle and points around it."""
    angles = np.arange(POINTS_A_LAMP - 1) * 2 * np.pi / (POINTS_A_LAMP - 1)
    around = 0.75 * lamp.radius * np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
    places = lamp.position + np.concatenate([np.zeros((1, 3)), around])
    share = lamp.intensity / POINTS_A_LAMP
    return [LightPoint(place, np.array([0.0, 0.0, -1.0]), share) for place in places]


def _sent_back(scene: Scene) -> tuple[LightPoint, ...]:
    """Weak points on the ceiling and the walls; their light has the lamps' mean colour."""
    length, width, height = scene.size
    strength = scene.indirect * np.sum([lamp.intensity for lamp in scene.lamps], axis=0) / INTENSITY
    places = [
        ((x * length, y * width, height - 0.05), (0.0, 0.0, -1.0), 0.36) for x in (0.2, 0.5, 0.8) for y in (0.25, 0.75)
    ]
    for share in (0.3, 0.7):
        places.append(((share * length, 0.05, 1.7), (0.0, 1.0, 0.0), 0.25))
        places.append(((share * length, width - 0.05, 1.7), (0.0, -1.0, 0.0), 0.25))
        places.append(((0.05, share * width, 1.7), (1.0, 0.0, 0.0), 0.25))
        places.append(((length - 0.05, share * width, 1.7), (-1.0, 0.0, 0.0), 0.25))
    return tuple(LightPoint(np.array(place), np.array(axis), share * strength) for place, axis, share in places)


def _frame(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two directions square to the axis."""
    other = np.array([1.0, 0.0, 0.0]) if abs(axis[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    right = np.cross(axis, other)
    right /= np.linalg.norm(right)
    return right, np.cross(axis, right)
