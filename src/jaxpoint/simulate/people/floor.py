"""The floor of a room, as far as people are concerned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.simulate.people.rotations import Vector

BATCH = 64


@dataclass(frozen=True)
class Chair:
    """A seat to sit on, and the free place in front of it."""

    x_m: float
    y_m: float
    yaw: float  # rad, the way a sitting person looks; 0 is along x
    seat_m: float = 0.45

    @property
    def place(self) -> Vector:
        """On the floor, below the middle of the seat."""
        return np.array([self.x_m, self.y_m, 0.0])


@dataclass(frozen=True)
class Floor:
    """A rectangular room from (0, 0, 0) to `size_m`, and what stands on its floor."""

    size_m: tuple[float, float, float] = (6.0, 5.0, 3.0)
    obstacles: Sequence[tuple[float, float, float, float, float]] = ()
    """x and y of two opposite corners, and height: furniture, chairs too (m)."""
    kept_clear: Sequence[tuple[float, float, float, float]] = ()
    """x and y of two opposite corners: where nobody stands, though one may walk there (m)."""
    chairs: Sequence[Chair] = field(default_factory=tuple)
    door: tuple[float, float] | None = None
    """A place just inside the door, where people appear and vanish; without one, somewhere near a wall."""

    def is_free(self, places: Float[np.ndarray, "N 2"], margin: float) -> Bool[np.ndarray, " N"]:
        """Whether each place (x, y) is at least `margin` m away from every wall, obstacle, and floor kept clear."""
        inside = np.all((places >= margin) & (places <= np.array(self.size_m[:2]) - margin), axis=1)
        kept = np.sort(np.array(self.kept_clear, float).reshape(-1, 2, 2), axis=1)
        low, high = np.concatenate([self._boxes[:, :, :2], kept]).swapaxes(0, 1)
        away = np.maximum(np.maximum(low - places[:, None], places[:, None] - high), 0.0)
        return inside & np.all((away**2).sum(axis=2) >= margin**2, axis=1)

    def holds(self, points: Float[np.ndarray, "N 3"], margin: float) -> bool:
        """Whether all points (m) are inside the room and outside the furniture, `margin` m away from both."""
        inside = np.all((points >= margin) & (points <= np.array(self.size_m) - margin))
        low, high = self._boxes[:, 0] - margin, self._boxes[:, 1] + margin
        within = np.all((points[:, None] > low) & (points[:, None] < high), axis=2)
        return bool(inside and not within.any())

    def free_places(self, rng: np.random.Generator, count: int, margin: float) -> Float[np.ndarray, "N 3"]:
        """Free places (x, y, 0), drawn evenly.

        Raises:
            ValueError: hardly any place is free.
        """
        found: list[np.ndarray] = []
        for _ in range(50 * count):
            places = rng.uniform([0.0, 0.0], self.size_m[:2], (BATCH, 2))
            found.extend(places[self.is_free(places, margin)])
            if len(found) >= count:
                return np.column_stack([found[:count], np.zeros(count)])
        raise ValueError(
            f"The floor has no place that is {margin:.2f} m away from walls and furniture; clear some of it."
        )

    def without(self, place: Vector) -> Floor:
        """The same without the furniture that stands over a place: a seat, for who sits on it."""
        over = np.all((place[:2] > self._boxes[:, 0, :2]) & (place[:2] < self._boxes[:, 1, :2]), axis=1)
        return replace(self, obstacles=[box for box, taken in zip(self.obstacles, over) if not taken])

    def to_walk_through(self) -> Floor:
        """The same with nothing kept clear."""
        return replace(self, kept_clear=())

    @cached_property
    def _boxes(self) -> Float[np.ndarray, "B 2 3"]:
        """Lowest and highest corner of every obstacle."""
        given = np.array(self.obstacles, float).reshape(-1, 5)
        ends = given[:, :4].reshape(-1, 2, 2)
        height = np.stack([np.zeros(len(given)), given[:, 4]], axis=1)
        return np.concatenate([np.sort(ends, axis=1), height[:, :, None]], axis=2)
