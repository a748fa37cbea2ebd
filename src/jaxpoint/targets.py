"""Targets of known shape: points that are rigid to each other, such as the corners of a board or the ends of a wand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

SIZE_SIGMA = 1e-3  # of a size that somebody printed or measured with a ruler: 0.3 mm on 300 mm
COINCIDENT = 1e-9  # of the extent: points nearer to each other, or to a line, are one point, or on that line


@dataclass(frozen=True, eq=False)
class Target:
    """A rigid target of K points.

    Its size gives a calibration its scale, as uncertain as `size_sigma` says. An infinite one means that only the
    shape is known: lengths then come out in units of these points.
    """

    name: str
    points: Float[np.ndarray, "K 3"]  # m, in the target's own frame
    size_sigma: float = SIZE_SIGMA  # standard deviation of its size, as a share of it

    def __post_init__(self) -> None:
        """Refuse what is no target.

        Raises:
            ValueError: fewer than two points, one that is not finite, two at one place, or a negative sigma.
        """
        points = np.asarray(self.points, np.float64)
        if points.ndim != 2 or points.shape[1:] != (3,) or len(points) < 2:
            raise ValueError(f"Target '{self.name}' needs two points (K, 3) or more, not shape {points.shape}.")
        if not np.isfinite(points).all():
            raise ValueError(f"Target '{self.name}' has a point that is not finite; leave it out.")
        apart = np.linalg.norm(points[:, None] - points[None], axis=-1) + np.eye(len(points)) * np.ptp(points)
        if apart.min() <= COINCIDENT * np.ptp(points):
            first, second = np.unravel_index(apart.argmin(), apart.shape)
            raise ValueError(f"Points {first} and {second} of target '{self.name}' are at one place; keep one of them.")
        if not self.size_sigma >= 0:
            raise ValueError(f"The size of target '{self.name}' has sigma {self.size_sigma}; it must be 0 or more.")
        object.__setattr__(self, "points", points)

    def __eq__(self, other: object) -> bool:
        """Whether both are the same in every number."""
        return isinstance(other, Target) and self._key == other._key

    def __hash__(self) -> int:
        """Of every number: tracks, of which targets are a static part, go through `jit`."""
        return hash(self._key)

    @property
    def _key(self) -> tuple:
        return self.name, self.points.tobytes(), self.size_sigma

    @staticmethod
    def wand(length: float, name: str = "wand", size_sigma: float = SIZE_SIGMA) -> Target:
        """Two points so far apart (m): ids 0 and 1."""
        return Target(name, np.array([[0.0, 0.0, 0.0], [length, 0.0, 0.0]]), size_sigma)

    @staticmethod
    def chessboard(
        columns: int, rows: int, square: float, name: str = "chessboard", size_sigma: float = SIZE_SIGMA
    ) -> Target:
        """Inner corners of a chessboard, row by row as OpenCV counts them; `square` in m."""
        across, down = np.meshgrid(np.arange(columns), np.arange(rows))
        flat = np.stack([across.ravel(), down.ravel(), np.zeros(columns * rows)], axis=1)
        return Target(name, square * flat, size_sigma)

    @property
    def freedoms(self) -> int:
        """Of a pose: 6, or 5 where all points lie on one line."""
        return 5 if self.width == 0 else 6

    @property
    def width(self) -> float:
        """Extent across its longest direction, m; 0 for points on a line."""
        values = np.linalg.svd(self.points - self.points.mean(axis=0), compute_uv=False)
        return float(values[1]) if values[1] > COINCIDENT * values[0] else 0.0

    @property
    def centred(self) -> Float[np.ndarray, "K 3"]:
        """Its points about their middle, along their main directions; on a line exactly along x."""
        middle = self.points - self.points.mean(axis=0)
        turn = np.linalg.svd(middle)[2]
        turn[2] *= np.sign(np.linalg.det(turn))
        found = middle @ turn.T
        return found * [1.0, 0.0, 0.0] if self.width == 0 else found
