"""Where cameras stand to each other by the boards that they saw together: robust means, along the best chain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from jaxpoint.calibration.board_views import BoardViews
from jaxpoint.errors import InsufficientDataError

NEAR = 3.0  # medians of the distances to the medoid: what lies beyond takes no part in the mean
LEAST_SHARED = 3  # views of two cameras, of which one may be wrong


@dataclass(frozen=True)
class Link:
    """Where one camera stands to another."""

    first: int
    second: int
    rotation: Float[np.ndarray, "3 3"]  # second_from_first
    translation: Float[np.ndarray, "3"]
    views: int


def chain_cameras(
    views: Sequence[BoardViews], names: Sequence[str]
) -> tuple[Float[np.ndarray, "C 3 3"], Float[np.ndarray, "C 3"]]:
    """cam_from_world of all cameras, the first camera being the world; over the pairs that share most views.

    Raises:
        InsufficientDataError: a camera is connected with the others by too few views.
    """
    count = len(views)
    links = [link for i in range(count) for j in range(i + 1, count) if (link := link_of(views, i, j)) is not None]
    rotation, translation = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    reached = {0}
    while len(reached) < count:
        open_ = [link for link in links if (link.first in reached) != (link.second in reached)]
        best = max(open_, key=lambda link: link.views, default=None)
        if best is None or best.views < LEAST_SHARED:
            lost = next(c for c in range(count) if c not in reached)
            raise InsufficientDataError(
                f"Camera '{names[lost]}' saw the board together with the others in {0 if best is None else best.views} "
                f"frames, and {LEAST_SHARED} are needed; hold the board where it and another camera see it at once, or "
                "leave the camera out."
            )
        turn, shift = best.rotation, best.translation
        if best.first in reached:
            old, new = best.first, best.second
        else:
            old, new = best.second, best.first
            turn, shift = turn.T, -turn.T @ shift
        rotation[new], translation[new] = turn @ rotation[old], turn @ translation[old] + shift
        reached.add(new)
    return rotation, translation


def link_of(views: Sequence[BoardViews], first: int, second: int) -> Link | None:
    """The robust mean over common views; None where there are none."""
    turns, shifts = [], []
    for one, other in zip(views[first].poses, views[second].poses):
        both = np.isfinite(one).all(axis=1) & np.isfinite(other).all(axis=1)
        turn, shift = relative_poses(one[both], other[both])
        turns.append(turn)
        shifts.append(shift)
    turn, shift = np.concatenate(turns), np.concatenate(shifts)
    if not len(turn):
        return None
    apart = pose_distances(turn, shift)
    medoid = int(np.median(apart, axis=1).argmin())
    near = apart[medoid] <= NEAR * max(np.median(apart[medoid]), 1e-9)
    mean = Rotation.from_matrix(turn[near]).mean().as_matrix()
    return Link(first, second, mean, shift[near].mean(axis=0), int(near.sum()))


def relative_poses(
    one: Float[np.ndarray, "M 12"], other: Float[np.ndarray, "M 12"]
) -> tuple[Float[np.ndarray, "M 3 3"], Float[np.ndarray, "M 3"]]:
    """Of the second camera against the first, from each view's poses of the target in both."""
    left, right = one[:, :9].reshape(-1, 3, 3), other[:, :9].reshape(-1, 3, 3)
    turn = right @ np.swapaxes(left, 1, 2)
    return turn, other[:, 9:] - np.einsum("mij,mj->mi", turn, one[:, 9:])


def pose_distances(turn: Float[np.ndarray, "M 3 3"], shift: Float[np.ndarray, "M 3"]) -> Float[np.ndarray, "M M"]:
    """Between relative poses: angle (rad), and translation over its typical length."""
    trace = np.einsum("aij,bij->ab", turn, turn)
    angle = np.arccos(np.clip((trace - 1) / 2, -1.0, 1.0))
    length = max(float(np.median(np.linalg.norm(shift, axis=1))), 1e-9)
    return angle + np.linalg.norm(shift[:, None] - shift[None], axis=-1) / length


def target_poses(
    views: Sequence[BoardViews], rotation: Float[np.ndarray, "C 3 3"], translation: Float[np.ndarray, "C 3"]
) -> tuple[Float[np.ndarray, "_ 12"], ...]:
    """world_from_target of each target, by the camera that saw most of its points; NaN where none saw enough."""
    found = []
    for number in range(len(views[0].poses)):
        own = np.stack([view.poses[number] for view in views])  # (C, M, 12)
        corners = np.stack([view.corners[number] for view in views])
        camera = np.where(np.isfinite(own).all(axis=2), corners, -1).argmax(axis=0)
        chosen = own[camera, np.arange(own.shape[1])]
        back = np.swapaxes(rotation[camera], 1, 2)
        turned = back @ chosen[:, :9].reshape(-1, 3, 3)
        shifted = np.einsum("mij,mj->mi", back, chosen[:, 9:] - translation[camera])
        found.append(np.concatenate([turned.reshape(-1, 9), shifted], axis=1))
    return tuple(found)
