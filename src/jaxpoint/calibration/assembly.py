"""The `Calibration` of an adjustment that has come to rest: its rig, points, residuals and verdicts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jaxpoint.calibration.bodies import held_rows
from jaxpoint.calibration.hold import hold_of, is_metric
from jaxpoint.calibration.outliers import Settled
from jaxpoint.calibration.recording import Freedom, Recording, RigState, project
from jaxpoint.calibration.result import Calibration, PairTable, Verdict
from jaxpoint.calibration.target_blocks import moved_poses
from jaxpoint.camera.parameters import rig_of_parameters
from jaxpoint.camera.rig import CameraRig
from jaxpoint.config import CalibrateSettings
from jaxpoint.tracks import Tracks

MIN_EXPLAINED = 0.9  # a rig that keeps less than this share of what the pairs believe is not called good
# (right rigs of random rooms and real recordings keep 0.92 to 1.02, rigs from spoilt starts 0.02 to 0.88)


def assemble_calibration(
    tracks: Tracks,
    recording: Recording,
    settled: Settled,
    freedom: Freedom,
    settings: CalibrateSettings,
    pairs: PairTable,
    explained: float = 1.0,
) -> Calibration:
    """The calibration, with the origin amid the light's path and the cameras about 1 apart.

    With targets in metres, or in the room's frame, lengths (and in the room the frame) stay as they are.

    Args:
        explained: inliers over the observations on which pairs of cameras agree.
    """
    frames, cameras = tracks.frames, tracks.cameras
    state = centre_rig(settled.judged.state, settled.judged.kept, cameras)
    pixels, _ = project(state)
    verdicts = settled.judged.verdicts[:frames, :cameras]
    known = (settled.judged.errors > 0)[:frames, :cameras]
    views = (verdicts == Verdict.KEPT).sum(axis=1)
    valid = (views >= 2) | (held_rows(recording, state)[:frames] & (views >= 1))
    free, mean, weight = (part[:cameras] for part in (freedom.free, freedom.prior_mean, freedom.prior_weight))
    return Calibration(
        rig=rig_of(state, tracks),
        tracks=tracks,
        points=np.where(valid[:, None], state.points[:frames], 0.0),
        point_valid=valid,
        residuals=np.where(known[..., None], pixels[:frames, :cameras] - tracks.pixels, 0.0),
        verdicts=verdicts,
        sigma_px=settled.sigma_px,
        converged=settled.converged and explained >= MIN_EXPLAINED,
        message=_message(settled, explained),
        pairs=pairs,
        seed=settings.seed,
        freedom=Freedom(free, mean, weight, owner=None if freedom.owner is None else freedom.owner[:cameras]),
        loss_scale=2.0 * settled.sigma_px if settings.outliers.loss == "cauchy" else None,
        hold=hold_of(recording, state),
        unit="m" if is_metric(recording, state) else "arbitrary",
    )


def _message(settled: Settled, explained: float) -> str:
    if explained < MIN_EXPLAINED:
        return (
            f"ended in a rig that keeps only {explained:.0%} of the observations on which pairs of cameras agree "
            f"({MIN_EXPLAINED:.0%} wanted): it is probably wrong; see whether all cameras are in step "
            "(`jaxpoint check`), or try --init essential"
        )
    if settled.converged:
        return f"converged after {settled.rounds} rounds: the cost and the inliers no longer change"
    return f"stopped after {settled.rounds} rounds without converging"


def centre_rig(state: RigState, kept: np.ndarray, cameras: int) -> RigState:
    """The same rig with the origin amid the light's path and the cameras 1 from their middle (root mean square).

    What targets or known points hold stays: the scale, or the whole frame.
    """
    if state.anchored:
        return state
    placed = state.points[kept.sum(axis=1) >= 2]
    middle = np.median(placed, axis=0) if len(placed) else np.zeros(3)
    positions = state.positions[:cameras]
    length = 1.0 if state.poses else np.sqrt(((positions - positions.mean(axis=0)) ** 2).sum(axis=1).mean())
    numbers = state.cameras.copy()
    numbers[:, 3:6] = (numbers[:, 3:6] + np.einsum("cij,j->ci", state.rotation, middle)) / length
    poses = tuple(moved_poses(part, 1.0, np.eye(3), -middle) for part in state.poses)
    return replace(state, cameras=numbers, points=(state.points - middle) / length, poses=poses)


def rig_of(state: RigState, tracks: Tracks) -> CameraRig:
    """The solved cameras as a `CameraRig`."""
    count = tracks.cameras
    return rig_of_parameters(
        state.cameras[:count], state.rotation[:count], tracks.image_sizes, tracks.names, state.lens
    )
