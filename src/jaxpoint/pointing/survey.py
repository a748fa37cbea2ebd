"""Facts about a list of objects: sizes, residuals, which overlap, which lie outside the room."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from typing import Any

import numpy as np

from jaxpoint.pointing.objects import Thing
from jaxpoint.pointing.room_box import Room
from jaxpoint.pointing.shapes.faces import Faces

SAME_PLANE_M = 0.02
OUTSIDE_M = 0.02


@dataclass(frozen=True)
class Surveyed:
    """One object's figures."""

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
    return [_survey(thing) for thing in things]


def overlaps(things: Sequence[Thing]) -> list[str]:
    """A sentence for each two flat objects of nearly one plane that share half of the smaller one's surface or more."""
    flat = [(thing, face) for thing in things if (face := _flat(thing)) is not None]
    notes = []
    for (one, a), (other, b) in combinations(flat, 2):
        share = max(_share_within(a, b), _share_within(b, a))
        if share >= 0.5:
            notes.append(f"'{one.name}' and '{other.name}' lie in one plane and share {share:.0%} of the smaller one.")
    return notes


def outside(things: Sequence[Thing], room: Room) -> list[str]:
    """A sentence for each object that lies outside the room, wholly or in part."""
    low, high = np.asarray(room.low), np.asarray(room.high)
    notes = []
    for thing in things:
        bottom, top = thing.shape.bounds
        beyond = float(np.max(np.maximum(low - bottom, top - high)))
        if beyond > OUTSIDE_M:
            notes.append(f"'{thing.name}' reaches {beyond:.2f} m out of the room; measure one of the two again.")
    return notes


def _survey(thing: Thing) -> Surveyed:
    shape = thing.shape
    bottom, top = shape.bounds
    center = tuple(float(x) for x in (bottom + top) / 2)
    return Surveyed(
        thing.name, thing.kind, shape.name, thing.tags, center, shape.sides, shape.residual, float(bottom[2])
    )


def _flat(thing: Thing) -> np.ndarray | None:
    """Corner, right and down (rows, m) of an object that is one face; None of others."""
    sort, rows = thing.shape.primitives()
    return np.concatenate(rows[:3]) if sort is Faces and len(rows[0]) == 1 else None


def _share_within(part: np.ndarray, whole: np.ndarray) -> float:
    """The share of a rectangle (corner, right, down) that lies on another, on a grid; 0 off its plane."""
    u, v = (axis.ravel() for axis in np.meshgrid(*2 * [np.linspace(0.05, 0.95, 10)]))
    places = part[0] + u[:, None] * part[1] + v[:, None] * part[2] - whole[0]
    normal = np.cross(whole[1], whole[2])
    near = np.abs(places @ normal) / np.linalg.norm(normal) < SAME_PLANE_M
    fractions = np.linalg.lstsq(whole[1:].T, places.T, rcond=None)[0]
    return float(np.mean(near & np.all((fractions >= 0) & (fractions <= 1), axis=0)))
