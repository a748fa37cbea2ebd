"""Boards that look the same turned by 180 degrees: which end is which in each camera, told by all views together.

One camera may count such a board from its other end. The pose between two cameras then comes out otherwise in every
such view, and the views agree only once they are turned back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxpoint.calibration.board_chain import pose_distances, relative_poses
from jaxpoint.calibration.board_views import BoardViews
from jaxpoint.calibration.target_blocks import TargetRows
from jaxpoint.targets import Target
from jaxpoint.tracks import NO_ROW, Tracks

HALF_TURN = np.diag([-1.0, -1.0, 1.0])
BETTER = 0.3  # of the distance to where most views have the camera: a turned view must come so much nearer
SAME = 1e-6  # of the target's size


def turned_points(target: Target) -> Int[np.ndarray, " K"] | None:
    """For each point the one in whose place a half turn about the middle puts it; None where there is none."""
    shape = target.centred
    apart = np.linalg.norm(shape[:, None] - (shape @ HALF_TURN)[None], axis=-1)
    nearest = apart.argmin(axis=0)
    return nearest if apart.min(axis=0).max() < SAME * np.ptp(shape) else None


def views_turned(views: Sequence[BoardViews], targets: Sequence[TargetRows]) -> list[Bool[np.ndarray, "C _"]]:
    """Of each target the views, camera by camera, that count it from its other end; the first camera is right."""
    count = len(views)
    turned = [np.zeros((count, len(owned.rows)), bool) for owned in targets]
    shared = np.array([[_shared(one, other) for other in views] for one in views])
    settled, now = {0}, list(views)
    while len(settled) < count:
        pairs = [(shared[old, new], -old, -new) for old in settled for new in range(count) if new not in settled]
        common, old, new = max(pairs)
        old, new = -old, -new
        settled.add(new)
        if not common:
            continue
        for number, owned in enumerate(targets):
            if turned_points(owned.target) is not None:
                own = _turned_against(now[old].poses[number], now[new].poses[number])
                turned[number][new] = own
                now[new] = _with_turned(now[new], number, own)
    return turned


def _shared(one: BoardViews, other: BoardViews) -> int:
    pairs = zip(one.poses, other.poses)
    return sum(int((np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)).sum()) for a, b in pairs)


def _turned_against(one: Float[np.ndarray, "M 12"], other: Float[np.ndarray, "M 12"]) -> Bool[np.ndarray, " M"]:
    """Views in which the second camera's pose fits the others only after a half turn."""
    both = np.flatnonzero(np.isfinite(one).all(axis=1) & np.isfinite(other).all(axis=1))
    found = np.zeros(len(one), bool)
    if len(both) < 2:
        return found
    plain, back = (relative_poses(one[both], poses[both]) for poses in (other, half_turned(other)))
    turns, shifts = (np.concatenate(parts) for parts in zip(plain, back))
    apart = pose_distances(turns, shifts)
    views = len(both)
    nearer = np.minimum(apart[:, :views], apart[:, views:])  # of every candidate to the nearer pose of each view
    score = np.median(nearer, axis=1)
    best = int(score[:views].argmin())
    if score.min() < BETTER * score[best]:
        best = int(score.argmin())  # most views are turned
    found[both] = apart[best, views:] < BETTER * apart[best, :views]
    return found


def half_turned(poses: Float[np.ndarray, "M 12"]) -> Float[np.ndarray, "M 12"]:
    """Poses of a target that is counted from its other end."""
    rotation = poses[:, :9].reshape(-1, 3, 3) @ HALF_TURN
    return np.concatenate([rotation.reshape(-1, 9), poses[:, 9:]], axis=1)


def _with_turned(view: BoardViews, number: int, turned: Bool[np.ndarray, " M"]) -> BoardViews:
    poses = list(view.poses)
    poses[number] = np.where(turned[:, None], half_turned(poses[number]), poses[number])
    return replace(view, poses=tuple(poses))


def turn_views(views: Sequence[BoardViews], turned: Sequence[Bool[np.ndarray, "C _"]]) -> list[BoardViews]:
    """The views with all of these turned."""
    found = list(views)
    for number, own in enumerate(turned):
        found = [_with_turned(view, number, own[camera]) for camera, view in enumerate(found)]
    return found


def turn_tracks(tracks: Tracks, turned: Sequence[Bool[np.ndarray, "C _"]]) -> Tracks:
    """The tracks with the corners of these views counted from the other end."""
    pixels, visible = tracks.pixels.copy(), tracks.visible.copy()
    for number, own in enumerate(turned):
        order = turned_points(tracks.targets[number])
        if order is None:
            continue
        rows = tracks.rows_of_target(number, np.ones(tracks.frames, bool))
        for camera, frame in np.argwhere(own):
            here, there = rows[frame], rows[frame][order]
            both = (here != NO_ROW) & (there != NO_ROW)
            pixels[here[both], camera] = tracks.pixels[there[both], camera]
            visible[here[both], camera] = tracks.visible[there[both], camera]
    return replace(tracks, pixels=pixels, visible=visible)
