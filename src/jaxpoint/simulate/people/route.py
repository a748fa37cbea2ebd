"""A way around the furniture: shortest over a grid, straightened, its corners rounded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from jaxpoint.simulate.people.floor import Floor
from jaxpoint.simulate.people.rotations import Vector

GRID_M = 0.1
CLEAR_M = 0.33  # the route keeps this far from walls and furniture,
NARROW_M = 0.3  # or where there is no other way this far
STEP_M = 0.02
Place = Float[np.ndarray, " N"]  # x, y, and perhaps a height, which is not looked at
ROUND_M = 0.18  # standard deviation of the filter that rounds corners


@dataclass(frozen=True)
class Route:
    """A smooth line on the floor, sampled every STEP_M or so."""

    places: Float[np.ndarray, "N 2"]
    along: Float[np.ndarray, " N"]  # m from the start

    @property
    def length(self) -> float:
        return float(self.along[-1])

    def at(self, distance: float) -> Vector:
        """The place (x, y, 0) so far along; the ends beyond them."""
        return np.array([*(np.interp(distance, self.along, column) for column in self.places.T), 0.0])

    def heading(self, distance: float) -> float:
        """Direction of the line (rad), over the length of a foot."""
        ahead, behind = min(distance + 0.12, self.length), max(distance - 0.12, 0.0)
        way = self.at(ahead) - self.at(behind)
        return float(np.arctan2(way[1], way[0]))


def find_route(room: Floor, start: Vector, end: Vector) -> Route | None:
    """The way from one place on the floor to another; None where furniture leaves none.

    It crosses what is kept clear, and squeezes past furniture, only where there is no other.
    """
    for floor, clear in ((room, CLEAR_M), (room.to_walk_through(), NARROW_M)):
        corners = _straight(floor, start, end, clear)
        if corners is None:
            corners = _around(floor, start, end, clear)
        if corners is not None:
            return _rounded(corners)
    return None


def line_route(start: Vector, end: Vector) -> Route:
    """Straight from one place to another."""
    return _rounded(np.stack([start[:2], end[:2]]))


def _straight(room: Floor, start: Place, end: Place, clear: float) -> np.ndarray | None:
    """Both ends, if nothing stands between them; the ends themselves may be close to a chair or a door."""
    steps = max(int(np.linalg.norm(end[:2] - start[:2]) / 0.05), 2)
    between = start[:2] + np.linspace(0.0, 1.0, steps)[1:-1, None] * (end[:2] - start[:2])
    away = np.minimum(np.linalg.norm(between - start[:2], axis=1), np.linalg.norm(between - end[:2], axis=1))
    free = room.is_free(between, clear) | (away < clear)
    return np.stack([start[:2], end[:2]]) if free.all() else None


def _around(room: Floor, start: Vector, end: Vector, clear: float) -> np.ndarray | None:
    """Corners of the shortest way over free grid places, each as far along as can be seen from the one before."""
    shape = (np.array(room.size_m[:2]) / GRID_M).astype(int) + 1
    grid = np.stack(np.meshgrid(*(np.arange(n) * GRID_M for n in shape), indexing="ij"), -1)
    free = room.is_free(grid.reshape(-1, 2), clear).reshape(tuple(shape))
    places = grid.reshape(-1, 2)
    open_places = np.flatnonzero(free.ravel())
    if not len(open_places):
        return None
    first, last = (open_places[np.argmin(np.linalg.norm(places[open_places] - p[:2], axis=1))] for p in (start, end))
    _, before = dijkstra(_links(free), indices=int(first), return_predecessors=True)
    if first != last and before[last] < 0:
        return None
    way = [int(last)]
    while way[-1] != first:
        way.append(int(before[way[-1]]))
    full = np.concatenate([start[None, :2], places[way[::-1]], end[None, :2]])
    return _pulled(room, full, clear)


def _links(free: np.ndarray) -> coo_array:
    """Lengths between free neighbours, the diagonal ones too."""
    number = np.arange(free.size).reshape(free.shape)
    rows, columns, lengths = [], [], []
    for dx, dy in ((1, 0), (0, 1), (1, 1), (1, -1)):
        here = (slice(0, free.shape[0] - dx), slice(max(-dy, 0), free.shape[1] - max(dy, 0)))
        there = (slice(dx, None), slice(max(dy, 0), free.shape[1] - max(-dy, 0)))
        both = free[here] & free[there]
        rows.append(number[here][both])
        columns.append(number[there][both])
        lengths.append(np.full(both.sum(), np.hypot(dx, dy)))
    a, b, c = (np.concatenate(part) for part in (rows, columns, lengths))
    return coo_array((np.tile(c, 2), (np.concatenate([a, b]), np.concatenate([b, a]))), shape=(free.size, free.size))


def _pulled(room: Floor, way: np.ndarray, clear: float) -> np.ndarray:
    corners, here = [way[0]], 0
    while here < len(way) - 1:
        ahead = range(len(way) - 1, here, -1)
        here = next((i for i in ahead if _straight(room, way[here], way[i], clear) is not None), here + 1)
        corners.append(way[here])
    return np.array(corners)


def _rounded(corners: np.ndarray) -> Route:
    reach = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    steps = np.linspace(0.0, reach[-1], max(int(reach[-1] / STEP_M), 2))
    line = np.stack([np.interp(steps, reach, column) for column in corners.T], 1)
    # An odd reflection about the ends keeps them, and the direction of the line there.
    pad = len(line) - 1
    longer = np.concatenate([2 * line[0] - line[pad:0:-1], line, 2 * line[-1] - line[-2 : -pad - 2 : -1]])
    soft = gaussian_filter1d(longer, ROUND_M / STEP_M, axis=0)[pad : pad + len(line)]
    soft[0], soft[-1] = line[0], line[-1]
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(soft, axis=0), axis=1))])
    return Route(soft, along)
