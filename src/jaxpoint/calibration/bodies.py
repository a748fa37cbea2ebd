"""Which rows of a recording move together: each point by itself, the points of a target's pose all at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxpoint.calibration.recording import Recording, RigState

FIRM = 2  # coordinates more than a pose has freedoms: with fewer, nothing would speak against a wrong one


@dataclass(frozen=True)
class Bodies:
    """Rows by the unknowns that place them."""

    owner: np.ndarray  # (N,) number of the body of each row
    freedoms: np.ndarray  # (bodies,)

    @staticmethod
    def single(rows: int) -> Bodies:
        """Each row a point."""
        return Bodies(np.arange(rows), np.full(rows, 3))

    def sums(self, values: np.ndarray) -> np.ndarray:
        """Sums over the rows of each body."""
        found = np.bincount(self.owner, values, minlength=len(self.freedoms))
        return found.astype(values.dtype)


def bodies_of(recording: Recording, state: RigState) -> Bodies:
    """Points, and the poses of targets where the state has them."""
    rows = len(recording.pixels)
    single = Bodies.single(rows)
    owner, freedoms, count = single.owner.copy(), [single.freedoms], rows
    for owned, poses in zip(recording.targets, state.poses):
        rows, frame = owned.with_pose(poses)
        owner[rows] = count + frame
        freedoms.append(np.full(len(poses), owned.target.freedoms))
        count += len(poses)
    return Bodies(owner, np.concatenate(freedoms))


def held_rows(recording: Recording, state: RigState) -> np.ndarray:
    """(N,) rows that something else than two views places: a pose, or what is known of the room."""
    held = np.zeros(len(recording.pixels), bool)
    for owned, poses in zip(recording.targets, state.poses):
        held[owned.with_pose(poses)[0]] = True
    if state.anchored and recording.known_sigmas is not None:
        held |= np.isfinite(recording.known_sigmas)
    return held


def firm_rows(recording: Recording, state: RigState, near: np.ndarray) -> np.ndarray:
    """(N,) rows whose body has observations enough that a wrong one would show; `near` (N, D) are those that fit."""
    bodies = bodies_of(recording, state)
    views = near.sum(axis=1)
    needed = bodies.freedoms + FIRM
    firm = 2 * bodies.sums(views) >= needed
    found = firm[bodies.owner]
    if state.anchored and recording.known_sigmas is not None:
        found |= np.isfinite(recording.known_sigmas) & (views >= 1)
    return found
