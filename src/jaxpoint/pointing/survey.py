"""What there is to say about a list of objects: sizes, residuals, which overlap, which lie outside of the room."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from typing import Any

import numpy as np

from jaxpoint.pointing.objects import Box, Rectangle, Sphere, Thing, flat_rectangle
from jaxpoint.pointing.room import Room

SAME_PLANE_M = 0.02
OUTSIDE_M = 0.02


@dataclass(frozen=True)
class Surveyed:
    """One object in numbers."""

    name: str
    kind: str
    shape: str
    tags: tuple[str, ...]
    center_m: tuple[float, ...]
    size_m: tuple[float, ...]  # width and height, three sides, or a diameter
    residual_m: float  # rms distance of a rectangle's corners from their plane
    bottom_m: float  # lowest z

    @property
    def figures(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def survey(things: Sequence[Thing]) -> list[Surveyed]:
    """All of them, in order."""
    return [_surveyed(thing) for thing in things]


def overlaps(things: Sequence[Thing]) -> list[str]:
    """A sentence for each two rectangles of nearly one plane that share half of the smaller one's surface or more."""
    flat = [(thing, flat_rectangle(thing.shape.corners)[0]) for thing in things if isinstance(thing.shape, Rectangle)]
    notes = []
    for (one, a), (other, b) in combinations(flat, 2):
        share = max(_share_within(a, b), _share_within(b, a))
        if share >= 0.5:
            notes.append(f"'{one.name}' and '{other.name}' lie in one plane and share {share:.0%} of the smaller one.")
    return notes


def outside(things: Sequence[Thing], room: Room) -> list[str]:
    """A sentence for each object that lies outside of the room, wholly or in part."""
    low, high = np.asarray(room.low), np.asarray(room.high)
    notes = []
    for thing in things:
        bottom, top = _bounds(thing)
        beyond = float(np.max(np.maximum(low - bottom, top - high)))
        if beyond > OUTSIDE_M:
            notes.append(f"'{thing.name}' reaches {beyond:.2f} m out of the room; measure one of the two again.")
    return notes


def _surveyed(thing: Thing) -> Surveyed:
    shape = thing.shape
    bottom, top = _bounds(thing)
    residual = 0.0
    if isinstance(shape, Rectangle):
        (_, right, down), residual = flat_rectangle(shape.corners)
        kind, size = "rectangle", (np.linalg.norm(right), np.linalg.norm(down))
    elif isinstance(shape, Box):
        kind, size = "box", tuple(shape.size)
    else:
        kind, size = "sphere", (2 * shape.radius,)
    numbers = tuple(float(x) for x in (bottom + top) / 2), tuple(float(x) for x in size)
    return Surveyed(thing.name, thing.kind, kind, thing.tags, *numbers, residual, float(bottom[2]))


def _bounds(thing: Thing) -> tuple[np.ndarray, np.ndarray]:
    shape = thing.shape
    if isinstance(shape, Rectangle):
        return np.min(shape.corners, axis=0), np.max(shape.corners, axis=0)
    if isinstance(shape, Sphere):
        return shape.center - shape.radius, shape.center + shape.radius
    cos, sin = abs(np.cos(shape.yaw)), abs(np.sin(shape.yaw))
    half = np.array([[cos, sin, 0], [sin, cos, 0], [0, 0, 1]]) @ np.asarray(shape.size) / 2
    return shape.center - half, shape.center + half


def _share_within(part: np.ndarray, whole: np.ndarray) -> float:
    """The share of a rectangle (corner, right, down) that lies on another, on a grid; 0 off its plane."""
    u, v = (axis.ravel() for axis in np.meshgrid(*2 * [np.linspace(0.05, 0.95, 10)]))
    places = part[0] + u[:, None] * part[1] + v[:, None] * part[2] - whole[0]
    normal = np.cross(whole[1], whole[2])
    near = np.abs(places @ normal) / np.linalg.norm(normal) < SAME_PLANE_M
    fractions = np.linalg.lstsq(whole[1:].T, places.T, rcond=None)[0]
    return float(np.mean(near & np.all((fractions >= 0) & (fractions <= 1), axis=0)))
