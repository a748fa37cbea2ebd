"""Rectangles: screens, pictures, doors, table tops."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from jaxpoint.geometry.arrays import AnyArray
from jaxpoint.geometry.world_axes import World
from jaxpoint.pointing.shapes.faces import Faces
from jaxpoint.pointing.shapes.shape import MIN_SIDE_M, AbstractShape, Field, Rows, points, too_small

MAX_RESIDUAL_M = 0.05


@dataclass(frozen=True)
class Rectangle(AbstractShape):
    """A rectangle (or parallelogram), met from both sides; measured corners become the nearest that is plane."""

    corners: Float[np.ndarray, "4 3"]  # m: left-top, right-top, left-bottom, right-bottom

    name: ClassVar[str] = "rectangle"
    fields: ClassVar[tuple[Field, ...]] = (points("corners", "lt", "rt", "lb", "rb"),)

    def primitives(self) -> Rows:
        corner, right, down = flat_rectangle(self.corners)[0][:, None]
        return Faces, (corner, right, down, np.zeros(1, bool))

    def to_room(self, world: World) -> Rectangle:
        return Rectangle(world.to_room(self.corners))

    def fault(self) -> str | None:
        left_top, right_top, left_bottom, right_bottom = np.asarray(self.corners)
        across = right_top - left_top, right_bottom - left_bottom
        upright = left_bottom - left_top, right_bottom - right_top
        shortest = min(float(np.linalg.norm(side)) for side in (*across, *upright))
        return (
            too_small("side", shortest)
            or _twist(*across, "top and bottom")
            or _twist(*upright, "left and right side")
            or self._narrowness()
        )

    def doubt(self, name: str) -> str | None:
        if self.residual <= MAX_RESIDUAL_M:
            return None
        return (
            f"The corners of '{name}' lie {100 * self.residual:.1f} cm off a common plane (limit "
            f"{100 * MAX_RESIDUAL_M:.0f} cm); measure them again."
        )

    @property
    def sides(self) -> tuple[float, ...]:
        """Width and height, m."""
        _, right, down = flat_rectangle(self.corners)[0]
        return float(np.linalg.norm(right)), float(np.linalg.norm(down))

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return np.min(self.corners, axis=0), np.max(self.corners, axis=0)

    @property
    def residual(self) -> float:
        """Of the corners from their plane."""
        return flat_rectangle(self.corners)[1]

    def _narrowness(self) -> str | None:
        _, right, down = flat_rectangle(self.corners)[0]
        narrow = float(np.linalg.norm(np.cross(right, down)) / max(self.sides))
        if narrow < MIN_SIDE_M / 1000:
            return "has all corners on one line, so that its area is 0; measure them again."
        return too_small("side", narrow)


def flat_rectangle(corners: Float[AnyArray, "4 3"]) -> tuple[Float[np.ndarray, "3 3"], float]:
    """Left-top, right side and left side (m, rows) of the rectangle nearest to measured corners, and the rms distance
    (m) of these from a common plane."""
    corners = np.asarray(corners, float)
    center = corners.mean(axis=0)
    normal = np.linalg.svd(corners - center)[2][-1]
    off = (corners - center) @ normal
    left_top, right_top, left_bottom, right_bottom = corners - off[:, None] * normal
    right = (right_top - left_top + right_bottom - left_bottom) / 2
    down = (left_bottom - left_top + right_bottom - right_top) / 2
    return np.stack([center - right / 2 - down / 2, right, down]), float(np.sqrt(np.mean(off**2)))


def _twist(one: np.ndarray, other: np.ndarray, what: str) -> str | None:
    cosine = one @ other / np.linalg.norm(one) / np.linalg.norm(other)
    if cosine >= 0.5:
        return None
    angle = np.rad2deg(np.arccos(np.clip(cosine, -1, 1)))
    return (
        f"is twisted: its {what} are {angle:.0f} degrees apart; give the corners in the order left-top, right-top, "
        "left-bottom, right-bottom."
    )
