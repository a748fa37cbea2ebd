"""Worlds with other axes and units than ours, which is right-handed, z up, in metres: by name, or axis by axis.

A world is said by what its x, y and z are in ours: `x,z,-y` has x as ours, y up, and z against our y. One reflection
makes it left-handed. Points go there and back exactly: axes are only swapped and negated.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxpoint.errors import UsageError

PER_METRE = {"m": 1.0, "cm": 100.0, "mm": 1000.0}


@dataclass(frozen=True)
class World:
    """Axes and unit of a world."""

    axes: tuple[str, str, str]  # what its x, y and z are in ours, as "x" or "-y"
    unit: str = "m"  # of files that do not say it: m, cm or mm

    @property
    def matrix(self) -> Float[np.ndarray, "3 3"]:
        """Its coordinates from ours, of one and the same unit."""
        matrix = np.zeros((3, 3))
        for row, axis in enumerate(self.axes):
            matrix[row, "xyz".index(axis[-1])] = -1.0 if axis[0] == "-" else 1.0
        return matrix

    @property
    def right_handed(self) -> bool:
        """Whether x, y, z are so."""
        return float(np.linalg.det(self.matrix)) > 0

    def from_room(self, points: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
        """Points of our room in the axes of this world, in the unit that they have."""
        return np.asarray(points) @ self.matrix.T

    def to_room(self, points: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
        """Points of this world in the axes of our room, in the unit that they have."""
        return np.asarray(points) @ self.matrix

    def __str__(self) -> str:
        return ",".join(self.axes)


WORLDS = {
    "room": World(("x", "y", "z")),
    "blender": World(("x", "y", "z")),
    "ros": World(("x", "y", "z")),
    "opengl": World(("x", "z", "-y")),
    "gltf": World(("x", "z", "-y")),
    "opensim": World(("x", "z", "-y")),
    "opencv": World(("x", "-z", "y")),
    "colmap": World(("x", "-z", "y")),
    "unity": World(("x", "z", "y")),
    "unreal": World(("x", "-y", "z"), "cm"),
}


def world_of(text: str) -> World:
    """The world of a name, or of its axes in ours.

    Raises:
        UsageError: it is neither, or an axis is there twice.
    """
    if text.lower() in WORLDS:
        return WORLDS[text.lower()]
    axes = tuple(part.strip().removeprefix("+") for part in text.lower().split(","))
    if len(axes) != 3 or not all(re.fullmatch("-?[xyz]", axis) for axis in axes):
        raise UsageError(
            f"There is no world '{text}'; name one of {', '.join(WORLDS)}, or say what its x, y and z are in a room "
            "with z up, as x,z,-y (write --world=-x,... where it begins with a minus)."
        )
    if len({axis[-1] for axis in axes}) < 3:
        raise UsageError(f"The world '{text}' has an axis of the room twice; each of x, y and z is there once.")
    return World((axes[0], axes[1], axes[2]))
