"""The floor of a room, as far as people are concerned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from jaxpoint.simulate.people.rotations import Vector


@dataclass(frozen=True)
class Chair:
    """A seat to sit on, and the free place in front of it."""

    x_m: float
    y_m: float
    yaw: float  # rad, the way a sitting person looks; 0 is along x
    seat_m: float = 0.45

    @property
    def place(self) -> Float[np.ndarray, "2"]:
        return np.array([self.x_m, self.y_m])


@dataclass(frozen=True)
class Floor:
    """A rectangular room from (0, 0, 0) to `size_m`, and what stands on its floor."""

    size_m: tuple[float, float, float] = (6.0, 5.0, 3.0)
    obstacles: Sequence[tuple[float, float, float, float, float]] = ()
    """x and y of two opposite corners, and height: furniture, chairs too (m)."""
    chairs: Sequence[Chair] = field(default_factory=tuple)
    door: tuple[float, float] | None = None
    """A place just inside the door, where people appear and vanish; without one it is the freest edge."""

    def is_free(self, places: Float[np.ndarray, "N 2"], margin: float) -> np.ndarray:
        """Whether each place (x, y) is at least `margin` m away from every wall and obstacle."""
        size = np.array(self.size_m[:2])
        free = np.all((places >= margin) & (places <= size - margin), axis=-1)
        for x0, y0, x1, y1, _ in self.obstacles:
            low, high = np.array([min(x0, x1), min(y0, y1)]), np.array([max(x0, x1), max(y0, y1)])
            away = np.maximum(np.maximum(low - places, places - high), 0.0)
            free = free & (np.linalg.norm(away, axis=-1) >= margin)
        return np.asarray(free)

    def holds(self, points: Float[np.ndarray, "N 3"], margin: float) -> bool:
        """Whether all points (m) are inside the room and outside the furniture, `margin` m away from both."""
        inside = ((points >= margin) & (points <= np.array(self.size_m) - margin)).all()
        return bool(inside) and not any(self._within(points, box, margin) for box in self.obstacles)

    def free_place(self, rng: np.random.Generator, margin: float) -> Vector:
        """A free place (x, y, 0).

        Raises:
            ValueError: none is found.
        """
        places = rng.uniform([0.0, 0.0], self.size_m[:2], (2000, 2))
        free = places[self.is_free(places, margin)]
        if not len(free):
            raise ValueError(
                f"The floor has no place that is {margin:.2f} m away from walls and furniture; clear some of it."
            )
        return np.array([*free[0], 0.0])

    @staticmethod
    def _within(points, box, margin) -> bool:
        x0, y0, x1, y1, height = box
        low = np.array([min(x0, x1), min(y0, y1), 0.0]) - margin
        high = np.array([max(x0, x1), max(y0, y1), height]) + margin
        return bool(((points > low) & (points < high)).all(axis=1).any())
