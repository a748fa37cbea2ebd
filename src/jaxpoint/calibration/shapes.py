"""Targets of known shape and points of known place brought into a rig that was solved from single points.

The first solution knows neither. Once it stands, each frame of a target gets a pose from its triangulated points (or,
where one camera alone saw a flat target, from the homography of its plane), the poses give the rig its scale, and known
points bring it into their frame; from then on both take part in every adjustment.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.calibration.bodies import held_rows
from jaxpoint.calibration.eliminated import POSE, pose_values
from jaxpoint.calibration.objective import Solution
from jaxpoint.calibration.outliers import GROWING_PX, classify_observations, refine_to_convergence
from jaxpoint.calibration.planar_pose import planar_pose
from jaxpoint.calibration.recording import Recording, RigState
from jaxpoint.calibration.result import Finding, Stage
from jaxpoint.calibration.similarity import fit_similarity
from jaxpoint.calibration.target_blocks import TargetRows, known_poses, with_places
from jaxpoint.config import OutlierSettings
from jaxpoint.errors import InsufficientDataError

LEAST_WIDTH = 0.05  # of its size: points nearer to a line than this do not tell how a target is turned about it
LEAST_FRAMES = 3  # of a target, for its size: one may be a chance
LEAST_KNOWN = 3  # known points that hold a frame
SIZES_DIFFER = 5.0  # standard deviations by which two sizes contradict each other


def has_hold(recording: Recording) -> bool:
    """Whether there is any target, or known point."""
    return bool(recording.targets) or recording.known is not None


def with_shapes(
    recording: Recording, solution: Solution, settings: OutlierSettings
) -> tuple[Recording, Solution, list[Stage], list[Finding]]:
    """The solution adjusted with its targets and known points; the recording says how large the targets are.

    Raises:
        InsufficientDataError: a target has too few frames in which its points were placed, or too few known points
            are seen.
    """
    state, kept = solution.state, solution.settled.judged.kept
    findings: list[Finding] = []
    if recording.known is not None:
        state = _anchor(recording, state, kept)
    figures: dict = {"known_points": int(held_rows(recording, state).sum()), "targets": {}}
    if recording.targets:
        sizes = [_sizes(owned, state, kept) for owned in recording.targets]
        state, recording, findings = _scale(recording, state, sizes)
        poses = tuple(_poses(recording, owned, state, kept) for owned in recording.targets)
        state = with_places(recording, replace(state, poses=poses))
        for owned, found, size in zip(recording.targets, poses, sizes):
            figures["targets"][owned.target.name] = {
                "frames": len(owned.rows),
                "frames_with_a_pose": int(known_poses(found).sum()),
                "size_before_over_stated": float(np.median(size)) if len(size) else None,
            }
    judged = classify_observations(recording, state, GROWING_PX[-1] * recording.scale)
    settled = refine_to_convergence(recording, judged, solution.freedom, settings)
    return recording, Solution(settled, solution.freedom), [Stage("Targets and known points", figures)], findings


def _anchor(recording: Recording, state: RigState, kept: Bool[np.ndarray, "N D"]) -> RigState:
    """The state in the frame of the known points."""
    assert recording.known is not None
    assert recording.known_sigmas is not None
    usable = np.isfinite(recording.known_sigmas) & (kept.sum(axis=1) >= 2)
    known, seen = recording.known[usable], state.points[usable]
    if len(known) < LEAST_KNOWN or _width(known) < LEAST_WIDTH or _width(seen) < LEAST_WIDTH:
        raise InsufficientDataError(
            f"{len(known)} known points are seen by two cameras or more, and it takes {LEAST_KNOWN} that are off one "
            "line to hold the frame; add known points, or calibrate without them and align afterwards."
        )
    scale, rotation, translation = fit_similarity(seen, known, recording.known_sigmas[usable] ** -2.0)
    return replace(_move(state, scale, rotation, translation), anchored=True)


def _move(state: RigState, scale: float, rotation: np.ndarray, translation: np.ndarray) -> RigState:
    """The rig after x -> scale R x + t of the world."""
    state = state.rebased()
    base = state.base @ rotation.T
    cameras = state.cameras.copy()
    cameras[:, 3:6] = scale * cameras[:, 3:6] - base @ translation
    return replace(state, cameras=cameras, base=base, points=scale * state.points @ rotation.T + translation)


def _width(points: Float[np.ndarray, "K 3"]) -> float:
    """Second extent over the first; 0 of points on a line."""
    if len(points) < 3:
        return 0.0
    values = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return float(values[1] / values[0]) if values[0] > 0 else 0.0


def _placed(owned: TargetRows, kept: Bool[np.ndarray, "N D"]) -> Bool[np.ndarray, "M K"]:
    """Points of a target that two cameras or more placed."""
    return (owned.rows >= 0) & (kept.sum(axis=1) >= 2)[owned.rows]


def _sizes(owned: TargetRows, state: RigState, kept: Bool[np.ndarray, "N D"]) -> Float[np.ndarray, " m"]:
    """Size of a target in the rig over its stated one, from each frame with points enough."""
    found = []
    for rows, placed in zip(owned.rows, _placed(owned, kept)):
        if placed.sum() >= 2:
            stated, seen = owned.shape[placed], state.points[rows[placed]]
            found.append(np.linalg.norm(seen - seen.mean(axis=0)) / np.linalg.norm(stated - stated.mean(axis=0)))
    return np.array(found)


def _scale(recording: Recording, state: RigState, sizes: list[np.ndarray]) -> tuple[RigState, Recording, list[Finding]]:
    """The rig in metres, targets of unknown size in its unit, and what is to be said of sizes that contradict."""
    for owned, found in zip(recording.targets, sizes):
        if len(found) < LEAST_FRAMES:
            raise InsufficientDataError(
                f"Target '{owned.target.name}' has {len(found)} frames in which two cameras or more placed two of its "
                f"points or more, and {LEAST_FRAMES} are needed; show it to several cameras at once, or leave it out."
            )
    ratios, frames = np.array([np.median(found) for found in sizes]), np.array([len(found) for found in sizes])
    stated = np.array([np.isfinite(owned.target.size_sigma) for owned in recording.targets])
    if not state.anchored and not stated.any():
        stated[0] = True  # the unit is then the first target's
    factor = 1.0 if state.anchored else 1.0 / float(np.average(ratios[stated], weights=frames[stated]))
    state = state if state.anchored else _move(state, factor, np.eye(3), np.zeros(3))
    ratios = factor * ratios
    targets = tuple(
        owned if known else owned.scaled(float(ratio)) for owned, known, ratio in zip(recording.targets, stated, ratios)
    )
    return state, replace(recording, targets=targets), size_contradictions(recording, ratios, sizes)


def size_contradictions(recording: Recording, ratios: np.ndarray, sizes: list[np.ndarray]) -> list[Finding]:
    """Sizes that another scale contradicts: another target, or the known points."""
    findings = []
    for owned, ratio, found in zip(recording.targets, ratios, sizes):
        spread = 1.4826 * np.median(np.abs(found / np.median(found) - 1.0)) / np.sqrt(len(found))
        sigma = np.hypot(owned.target.size_sigma, spread)
        if np.isfinite(sigma) and abs(ratio - 1.0) > SIZES_DIFFER * max(sigma, 1e-4):
            findings.append(
                Finding(
                    "target size",
                    "bad",
                    f"Target '{owned.target.name}' measures {ratio:.3f} times its stated size beside the other targets "
                    "and known points: one of the sizes is wrong.",
                    "Measure it again, and state its true size",
                )
            )
    return findings


def _poses(
    recording: Recording, owned: TargetRows, state: RigState, kept: Bool[np.ndarray, "N D"]
) -> Float[np.ndarray, "M 12"]:
    """A pose of the target in each frame; NaN where its observations do not tell one."""
    poses = np.full((len(owned.rows), POSE), np.nan)
    for frame, (rows, placed) in enumerate(zip(owned.rows, _placed(owned, kept))):
        shape, seen = owned.shape[placed], state.points[rows[placed]]
        line = owned.target.freedoms == 5
        if (line and placed.sum() >= 2) or _width(shape) >= LEAST_WIDTH:
            _, rotation, translation = fit_similarity(shape, seen, np.ones(len(shape)), scaled=False)
            poses[frame] = pose_values(rotation[None], translation[None])[0]
        elif not line:
            pose = planar_pose(recording, state, owned, rows)
            poses[frame] = np.nan if pose is None else pose
    return poses
