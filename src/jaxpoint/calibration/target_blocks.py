"""The rows of a recording that belong to targets, as blocks of poses for the adjustment and back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np

from jaxpoint.calibration.adjustment import SeenTarget, Unknowns
from jaxpoint.calibration.bundle import Adjusted, from_blocks, to_blocks
from jaxpoint.calibration.eliminated import POSE
from jaxpoint.targets import Target
from jaxpoint.tracks import NO_ROW, Tracks

if TYPE_CHECKING:
    from jaxpoint.calibration.recording import Recording, RigState

POINTS_A_BLOCK = 128  # as of lights: a block's Jacobians stay in cache


@dataclass(frozen=True)
class TargetRows:
    """A target of K points in M frames, and the rows where its points stand."""

    target: Target
    rows: np.ndarray  # (M, K) of the recording; -1 where there is none
    shape: np.ndarray  # (K, 3) its points about their middle, in the unit of the rig

    def scaled(self, factor: float) -> TargetRows:
        """The same with another size."""
        return replace(self, shape=factor * self.shape)

    def with_pose(self, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rows of the points that a pose (M, 12) places, and the frames of the target that they are of."""
        frame, point = np.nonzero((self.rows >= 0) & known_poses(poses)[:, None])
        return self.rows[frame, point], frame

    def places(self, poses: np.ndarray) -> np.ndarray:
        """Its points (M, K, 3) in the world, from poses (M, 12)."""
        return np.einsum("mij,kj->mki", poses[:, :9].reshape(-1, 3, 3), self.shape) + poses[:, None, 9:]

    @property
    def poses_a_block(self) -> int:
        """A power of two, so that few programs are compiled."""
        return max(1 << (POINTS_A_BLOCK // len(self.shape)).bit_length() - 1, 1)

    @property
    def padded(self) -> np.ndarray:
        """The rows (P, K) padded to a power of two, or to one block."""
        size = max(self.poses_a_block, 1 << max(len(self.rows) - 1, 0).bit_length())
        return np.pad(self.rows, ((0, size - len(self.rows)), (0, 0)), constant_values=NO_ROW)


def target_rows(tracks: Tracks, number: int) -> TargetRows:
    """Of one of the targets of the tracks."""
    target = tracks.targets[number]
    return TargetRows(target, tracks.rows_of_target(number, np.ones(tracks.frames, bool)), target.centred)


def known_poses(poses: np.ndarray) -> np.ndarray:
    """(M,) frames of a target whose pose is known; the others' are NaN."""
    return np.asarray(np.isfinite(poses).all(axis=1))


def seen_targets(
    recording: Recording, state: RigState, weights: np.ndarray
) -> tuple[tuple[SeenTarget, ...], tuple[jnp.ndarray, ...]]:
    """What was seen of each target that has poses, and these poses, in blocks."""
    targets, values = [], []
    for owned, poses in zip(recording.targets, state.poses):
        rows, block = owned.padded, owned.poses_a_block
        firm = known_poses(poses)
        shown = (rows >= 0) & np.pad(firm, (0, len(rows) - len(firm)))[:, None]
        pixels = np.where(shown[..., None, None], recording.pixels[rows], 0.0)  # (P, K, D, 2)
        weighed = np.where(shown[..., None], weights[rows], 0.0)
        values_now = np.tile(np.concatenate([np.eye(3).ravel(), np.zeros(3)]), (len(rows), 1))
        values_now[np.flatnonzero(firm)] = poses[firm]
        targets.append(
            SeenTarget(
                jnp.asarray(owned.shape),
                jnp.asarray(_point_by_point(to_blocks(np.moveaxis(pixels, 1, -1), block))),
                jnp.asarray(_point_by_point(to_blocks(np.moveaxis(weighed, 1, -1), block))),
            )
        )
        values.append(jnp.asarray(to_blocks(values_now, block)))
    return tuple(targets), tuple(values)


def _point_by_point(blocks: np.ndarray) -> np.ndarray:
    """(MB, ..., K, B) to (MB, ..., K B)."""
    return blocks.reshape(*blocks.shape[:-2], -1)


def with_solved(recording: Recording, state: RigState, end: Adjusted | Unknowns) -> RigState:
    """The state with the points and poses where a solve ended."""
    poses = tuple(
        np.where(known_poses(old)[:, None], from_blocks(part)[: len(old)], np.nan)
        for part, old in zip(end.poses, state.poses)
    )
    return with_places(recording, replace(state, points=from_blocks(end.points), poses=poses))


def with_places(recording: Recording, state: RigState) -> RigState:
    """The state with the points of targets where their poses put them."""
    points = state.points.copy()
    for owned, poses in zip(recording.targets, state.poses):
        shown = (owned.rows >= 0) & known_poses(poses)[:, None]
        points[owned.rows[shown]] = owned.places(poses)[shown]
    return replace(state, points=points)


def moved_poses(poses: np.ndarray, scale: float, rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """Poses (M, 12) after the world was moved by x -> scale R x + t; the target's own size is not changed here."""
    turned = np.einsum("ij,mjk->mik", rotation, poses[:, :9].reshape(-1, 3, 3)).reshape(-1, 9)
    return np.concatenate([turned, scale * poses[:, 9:POSE] @ rotation.T + translation], axis=1)
