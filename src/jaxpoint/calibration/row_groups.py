"""Rows of a calibration by the unknowns that place them: single points, and the points of each pose of a target.

Plain numpy, for covariances and tests at a solution. Either kind is B unknowns of d components, each of which places K
rows; `tangent` is how these points move with the unknown.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxpoint.calibration.result import Calibration
from jaxpoint.calibration.sight import covariance_of_points, derivatives
from jaxpoint.tracks import NO_TARGET

BLOCK = 1024  # rows at once
RANK = 1e-12  # eigenvalues of a pose's normal equations below this share of the largest are open: a wand's turn


class RowGroup(NamedTuple):
    """B unknowns of d components, K rows each."""

    rows: Int[np.ndarray, "B K"]
    shown: Bool[np.ndarray, "B K"]  # False where an unknown has no such row
    tangent: Float[np.ndarray, "B K 3 d"]
    prior: Float[np.ndarray, " B"]  # weight of what is known of each component, px^2 over its squared unit


class GroupSlopes(NamedTuple):
    """Derivatives of the pixels of a group's rows; zero where not seen. V = K C views."""

    by_camera: Float[np.ndarray, "B K C 2 q"]
    by_unknown: Float[np.ndarray, "B K C 2 d"]

    @property
    def cross(self) -> Float[np.ndarray, "B d D"]:
        """J_u^T J_c of the normal equations; D = q C."""
        blocks = np.einsum("bkcid,bkciq->bdcq", self.by_unknown, self.by_camera, optimize=True)
        return blocks.reshape(*blocks.shape[:2], -1)

    @property
    def cameras(self) -> Float[np.ndarray, "C q q"]:
        """Sum of J_c^T J_c."""
        views = np.moveaxis(self.by_camera, 2, 0).reshape(self.by_camera.shape[2], -1, self.by_camera.shape[-1])
        return np.swapaxes(views, 1, 2) @ views

    def own(self, prior: Float[np.ndarray, " B"]) -> Float[np.ndarray, "B d d"]:
        """Covariance of the unknowns for pixels of variance 1 and cameras without error; zero where not determined."""
        if self.by_unknown.shape[-1] == 3 and not prior.any():
            by_point = self.by_unknown[:, 0]
            return covariance_of_points(by_point, (by_point != 0).any(axis=(2, 3)))
        stacked = self.by_unknown.reshape(len(self.by_unknown), -1, self.by_unknown.shape[-1])
        normal = np.swapaxes(stacked, 1, 2) @ stacked + prior[:, None, None] * np.eye(stacked.shape[-1])
        return np.linalg.pinv(normal, rcond=RANK, hermitian=True)


def row_groups(calibration: Calibration) -> Iterator[RowGroup]:
    """All rows of a calibration, each once, a block at a time."""
    posed = posed_rows(calibration)
    single = np.flatnonzero(~posed)
    priors = _priors(calibration)
    for start in range(0, len(single), BLOCK):
        rows = single[start : start + BLOCK, None]
        tangent = np.broadcast_to(np.eye(3), (len(rows), 1, 3, 3))
        yield RowGroup(rows, np.ones(rows.shape, bool), tangent, priors[rows[:, 0]])
    if posed.any():
        yield from _poses(calibration, posed)


def posed_rows(calibration: Calibration) -> Bool[np.ndarray, " F"]:
    """Rows that the pose of a target places."""
    ids = calibration.tracks.target_ids
    if ids is None or calibration.hold is None:
        return np.zeros(calibration.tracks.frames, bool)
    return (ids != NO_TARGET) & calibration.point_valid


def _priors(calibration: Calibration) -> Float[np.ndarray, " F"]:
    """Weights of the priors of rows, in px^2 over m^2."""
    prior, hold = calibration.tracks.prior, calibration.hold
    if prior is None or hold is None or hold.open_freedoms > 0:
        return np.zeros(calibration.tracks.frames)
    return (calibration.sigma_px / prior.sigmas) ** 2


def _poses(calibration: Calibration, posed: Bool[np.ndarray, " F"]) -> Iterator[RowGroup]:
    tracks, points = calibration.tracks, calibration.points
    for number, target in enumerate(tracks.targets):
        rows = tracks.rows_of_target(number, posed)
        step = max(BLOCK // len(target.points), 1)
        for some in (rows[start : start + step] for start in range(0, len(rows), step)):
            shown = some >= 0
            there = np.where(shown[..., None], points[some], 0.0)
            middle = there.sum(axis=1, keepdims=True) / shown.sum(axis=1)[:, None, None]
            lever = np.where(shown[..., None], there - middle, 0.0)
            turning = np.cross(np.eye(3)[None, None], lever[..., None, :])  # (B, K, 3 of w, 3): e_i x lever
            tangent = np.concatenate([np.swapaxes(turning, 2, 3), np.broadcast_to(np.eye(3), turning.shape)], axis=-1)
            yield RowGroup(some, shown, tangent, np.zeros(len(some)))


def slopes_of(calibration: Calibration, group: RowGroup, seen: Bool[np.ndarray, "F C"]) -> GroupSlopes:
    """Derivatives of what was seen of a group, by the adjusted parameters of the cameras and by the unknowns."""
    flat = group.rows.ravel()
    visible = seen[flat] & group.shown.ravel()[:, None]
    if group.tangent.shape[-1] == 3:  # one view alone does not place a point
        visible &= ((visible.sum(axis=1) >= 2) | (group.prior > 0))[:, None]
    by_camera, by_point = derivatives(calibration.rig, calibration.points[flat], visible)
    shape = group.rows.shape
    by_point = by_point.reshape(*shape, *by_point.shape[1:])
    tangent = group.tangent[:, :, None]
    by_unknown = by_point if group.tangent.shape[1] == 1 else by_point @ tangent
    return GroupSlopes(by_camera.reshape(*shape, *by_camera.shape[1:]), by_unknown)
