"""Figures made of capsules: enough for a person in the dark, and for tests of the renderer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxpoint.simulate.mesh import Mesh, Part

SIDES = 20
RINGS = 5  # of each round end


@dataclass(frozen=True)
class Capsule:
    """All places within a radius of a segment."""

    start: Float[np.ndarray, "3"]  # m
    end: Float[np.ndarray, "3"]  # m
    radius: float  # m
    part: int = Part.BODY

    def mesh(self, albedo: Float[np.ndarray, "3"]) -> Mesh:
        """Its surface in one colour (linear red, green, blue)."""
        axis = self.end - self.start
        length = np.linalg.norm(axis)
        along = axis / length if length > 0 else np.array([0.0, 0.0, 1.0])
        side = np.cross(along, [1.0, 0.0, 0.0] if abs(along[0]) < 0.9 else [0.0, 1.0, 0.0])
        side /= np.linalg.norm(side)
        steps = max(1, round(length / 0.03))
        cap = np.linspace(0.0, np.pi / 2, RINGS + 1)
        # From pole to pole: height along the axis, distance from it, and tilt of the normal.
        tilt = np.concatenate([cap - np.pi / 2, np.zeros(steps - 1), cap])
        height = np.concatenate([np.zeros(RINGS + 1), np.arange(1, steps) / steps * length, np.full(RINGS + 1, length)])
        turn = np.linspace(0.0, 2 * np.pi, SIDES, endpoint=False)
        around = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(along, side)
        normals = np.cos(tilt)[:, None, None] * around + np.sin(tilt)[:, None, None] * along
        points = self.start + height[:, None, None] * along + self.radius * normals
        place = np.arange(points.shape[0] * SIDES).reshape(-1, SIDES)
        a, b = place[:-1], np.roll(place[:-1], -1, axis=1)
        c, d = place[1:], np.roll(place[1:], -1, axis=1)
        triangles = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([b, d, c], -1).reshape(-1, 3)])
        count = place.size
        return Mesh(
            points.reshape(-1, 3),
            normals.reshape(-1, 3),
            triangles,
            np.full(count, self.part, np.uint8),
            np.tile(np.asarray(albedo, float), (count, 1)),
        )

    def hides(self, eye: Float[np.ndarray, "3"], point: Float[np.ndarray, "3"]) -> bool:
        """Whether the line from an eye to a point passes through it."""
        along, sight, between = self.end - self.start, point - eye, eye - self.start
        a, b, c = along @ along, along @ sight, sight @ sight
        determinant = a * c - b * b
        s = np.clip((c * (along @ between) - b * (sight @ between)) / max(determinant, 1e-12), 0.0, 1.0)
        t = np.clip((s * b - sight @ between) / c, 0.0, 1.0)
        s = np.clip((t * b + along @ between) / max(a, 1e-12), 0.0, 1.0)
        nearest = between + t * sight - s * along
        return bool(nearest @ nearest < self.radius**2)
