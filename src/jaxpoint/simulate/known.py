"""What a person would measure in a simulated room: landmarks, clicks on them, lengths between other points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxpoint.landmarks import LandmarkPixels, Landmarks, Lengths
from jaxpoint.simulate.rooms import ROOM_M, RandomRoom

CLICK_PX = 0.5  # standard deviation of a clicked coordinate
TAPE_M = 0.002  # standard deviation of a measured coordinate or length


@dataclass(frozen=True)
class KnownRoom:
    """A simulated room and what was measured in it."""

    room: RandomRoom
    landmarks: Landmarks
    clicks: LandmarkPixels  # the landmarks, then the ends of the lengths
    lengths: Lengths


def known_in(room: RandomRoom, seed: int, landmarks: int = 8, lengths: int = 12) -> KnownRoom:
    """Landmarks and lengths within reach of the cameras, measured by tape (2 mm) and clicked (0.5 px).

    No length ends at a landmark. Points are drawn until three or more cameras see each.
    """
    rng = np.random.default_rng(seed)
    count = landmarks + 2 * lengths
    points, pixels, visible = _seen_points(room, rng, count)
    names = (*(f"landmark_{i}" for i in range(landmarks)), *(f"end_{i}" for i in range(2 * lengths)))
    clicked = np.where(visible[..., None], pixels + rng.normal(0.0, CLICK_PX, pixels.shape), 0.0)
    ends = points[landmarks:].reshape(lengths, 2, 3)
    exact = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    return KnownRoom(
        room,
        Landmarks(
            names[:landmarks],
            points[:landmarks] + rng.normal(0.0, TAPE_M, (landmarks, 3)),
            np.full(landmarks, TAPE_M),
        ),
        LandmarkPixels(names, clicked, visible),
        Lengths(
            tuple(f"length_{i}" for i in range(lengths)),
            tuple((f"end_{2 * i}", f"end_{2 * i + 1}") for i in range(lengths)),
            exact + rng.normal(0.0, TAPE_M, lengths),
        ),
    )


def _seen_points(room: RandomRoom, rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (N, 3) in the room that three cameras see (two where there are no more), their pixels and visibility."""
    found = []
    needed = min(3, room.tracks.cameras - 1)
    while len(found) < count:
        candidates = rng.uniform(ROOM_M * 0.1, ROOM_M * [0.9, 0.9, 0.75], (4 * count, 3))
        pixels, visible = room.seen(candidates)
        enough = visible.sum(axis=1) >= needed
        found += list(zip(candidates[enough], pixels[enough], visible[enough]))
    points, pixels, visible = (np.stack(column) for column in zip(*found[:count]))
    return points, pixels, visible
