"""Boxes: cupboards, printers, tables as a whole."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from jaxpoint.geometry.world_axes import World
from jaxpoint.pointing.shapes.faces import Faces
from jaxpoint.pointing.shapes.shape import AbstractShape, Field, Rows, angle, vector


@dataclass(frozen=True)
class Box(AbstractShape):
    """A box, met from outside."""

    center: Float[np.ndarray, "3"]  # m
    size: Float[np.ndarray, "3"]  # m, along its own axes
    yaw: float = 0.0  # rad, by which it is turned about the vertical

    name: ClassVar[str] = "box"
    fields: ClassVar[tuple[Field, ...]] = (vector("center"), vector("size"), angle("yaw_deg", 0.0))

    def primitives(self) -> Rows:
        x, y, z = self._sides()
        faces = []
        for sign in (1.0, -1.0):  # down x right looks out of the box
            for out, right, down in ((x, sign * y, -z), (y, -sign * x, -z), (z, sign * x, -y)):
                faces.append((np.asarray(self.center, float) + (sign * out - right - down) / 2, right, down))
        corner, right, down = np.array(faces).transpose(1, 0, 2)
        return Faces, (corner, right, down, np.ones(6, bool))

    def to_room(self, world: World) -> Box:
        """Turned about the vertical the way that its world counts angles: from one level axis to the next."""
        up = int(np.abs(world.matrix[:, 2]).argmax())
        sense = world.matrix[up, 2] * (1.0 if world.right_handed else -1.0)
        return Box(world.to_room(self.center), np.abs(world.to_room(self.size)), sense * self.yaw)

    @property
    def sides(self) -> tuple[float, ...]:
        return tuple(float(side) for side in self.size)

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        half = np.abs(self._sides()).sum(axis=0) / 2
        return self.center - half, self.center + half

    def _sides(self) -> Float[np.ndarray, "3 3"]:
        """Its three edges as rows, m."""
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        return np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]) * np.asarray(self.size, float)[:, None]
