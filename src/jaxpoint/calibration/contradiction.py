"""A camera that the others contradict: found by what is left of its observations, and why it does not fit."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.calibration.clock_findings import Timing, contradicts, finding, flags
from jaxpoint.calibration.clocks import find_clocks
from jaxpoint.calibration.result import Calibration, Finding
from jaxpoint.calibration.shared_lenses import shares_lens
from jaxpoint.config import CalibrateSettings
from jaxpoint.errors import ContradictionError
from jaxpoint.tracks import Tracks

LEAST_KEPT = 0.6  # of a camera's observations, where two others saw the light too (random rooms keep 0.8 or more)
APART = 0.2  # by which it keeps less than the others do, by their median
FITS = 0.7  # share of inliers at which a projection explains a camera's pixels
LEAST_ROWS = 20  # observations that tell something
LEAST_OFFSET = 0.2  # frames; pairs of cameras in step come to 0.11 at most (simulated), 0.03 (real recordings)
PARTNERS = 3  # cameras with which its clock is compared
SAMPLES = 300  # of six points
NEAR_PX = 10.0  # of the linear projection, at an image width of 1280: lens distortion is left out


def kept_shares(calibration: Calibration) -> Float[np.ndarray, " C"]:
    """Inliers of every camera over its observations in frames of three views or more (of two, where those are few)."""
    visible, kept = calibration.tracks.visible, calibration.kept
    tested = visible & (visible.sum(axis=1) >= 3)[:, None]
    tested = np.where(tested.sum(axis=0) >= LEAST_ROWS, tested, calibration.comparable)
    return (kept & tested).sum(axis=0) / np.maximum(tested.sum(axis=0), 1)


def contradicted_camera(calibration: Calibration) -> int | None:
    """The camera most of whose observations the others reject, or that no pair explains; None where all fit."""
    shares = kept_shares(calibration)
    worst = int(shares.argmin())
    if shares[worst] < LEAST_KEPT and shares[worst] < np.median(np.delete(shares, worst)) - APART:
        return worst
    return None if calibration.converged else _suspect(calibration)


def _suspect(calibration: Calibration) -> int | None:
    """The camera whose best pair of views agrees far less than those of the others."""
    inliers = calibration.pairs.inliers
    if inliers is None:
        return None
    shared = calibration.pairs.shared * (1 - np.eye(len(inliers), dtype=int))
    best = np.where(shared >= LEAST_ROWS, inliers / np.maximum(shared, 1), 0.0).max(axis=1)
    worst = int(best.argmin())
    return worst if best[worst] < FITS * np.median(np.delete(best, worst)) else None


def holds_without(others: Calibration, everything: Calibration) -> bool:
    """Whether the rig without a camera is better than the one with it."""
    names = everything.tracks.names
    places = [names.index(name) for name in others.tracks.names]
    before, after = kept_shares(everything)[places], kept_shares(others)
    return bool(after.min() >= LEAST_KEPT and after.mean() >= before.mean() - 0.02)


def left_out(tracks: Tracks, camera: int, others: Calibration, settings: CalibrateSettings) -> Finding:
    """Why a camera was left out of a rig that holds without it."""
    name = tracks.names[camera]
    cause, why, remedy = _reason(tracks, camera, others, settings)
    return Finding(
        cause,
        "bad",
        f"Camera {name} contradicts the others and was left out. {why}",
        f"{remedy}, or leave it out for good (--leave-out {name})",
        (name,),
        left_out=True,
    )


def left_out_unsolved(tracks: Tracks, error: ContradictionError) -> Finding:
    """Why a camera was left out before anything was solved."""
    name = tracks.names[error.camera]
    return Finding(
        error.causes[0],
        "bad",
        f"Camera {name} was left out. {error}",
        f"Mend that, or leave it out for good (--leave-out {name})",
        (name,),
        left_out=True,
    )


def _reason(tracks: Tracks, camera: int, others: Calibration, settings: CalibrateSettings) -> tuple[str, str, str]:
    """The cause in a word or two, a sentence with the figure, and the remedy; the first that holds."""
    name = tracks.names[camera]
    usable = tracks.visible[:, camera] & others.point_valid
    points, pixels = others.points[usable], tracks.pixels[usable, camera]
    if len(points) < LEAST_ROWS:
        return (
            "shares too little",
            f"It shares {len(points)} frames with them.",
            f"Wave the light longer where {name} and two others see it",
        )
    near = NEAR_PX * float(tracks.image_sizes[camera, 0]) / 1280.0
    found = fit_projection(points, pixels, near, settings.seed)
    if found.share >= FITS and found.mirrored:
        return (
            "mirrored images",
            f"Its images are mirrored: {found.share:.0%} of its observations fit a camera with left and right "
            "exchanged.",
            f"Record {name} without the mirror or flip, or flip its images",
        )
    if found.share >= FITS and shares_lens(settings.lens.shared, name):
        return (
            "shared lens",
            f"{found.share:.0%} of its observations fit a camera with a lens of its own.",
            f"Leave {name} out of --lens.shared",
        )
    moved = None if found.share >= FITS else _moved(name, points, pixels, near, settings.seed)
    return moved or _clock(tracks, camera, settings) or _unknown(name, found.share)


def _moved(name: str, points: np.ndarray, pixels: np.ndarray, near: float, seed: int) -> tuple[str, str, str] | None:
    """That each half of the recording fits one camera, where both together do not."""
    half = len(points) // 2
    if half < LEAST_ROWS:
        return None
    first, second = (
        fit_projection(points[some], pixels[some], near, seed).share for some in (slice(half), slice(half, None))
    )
    if min(first, second) < FITS:
        return None
    return (
        "camera moved",
        f"It was moved during the recording: each half of it fits one camera ({first:.0%} and {second:.0%} of the "
        "observations), both together do not.",
        f"Keep the part of the recording before or after {name} was touched",
    )


def _clock(tracks: Tracks, camera: int, settings: CalibrateSettings) -> tuple[str, str, str] | None:
    """That it is late or runs at another rate than its best partners."""
    shared = (tracks.visible & tracks.visible[:, camera : camera + 1]).sum(axis=0)
    shared[camera] = -1
    chosen = [*np.argsort(-shared)[:PARTNERS].tolist(), camera]
    some = tracks.select_cameras(chosen)
    clock = find_clocks(some, settings.epipolar, settings.seed)[-1]
    if not clock.certain or (abs(clock.offset_frames) < LEAST_OFFSET and clock.rate == 1.0):
        return None
    name, timing = tracks.names[camera], Timing.of(some)
    if not contradicts(clock):
        late = f"{abs(clock.offset_frames):.1f} frames {'late' if clock.offset_frames > 0 else 'early'}"
        return "out of step", f"Camera {name} shows the light {late}.", "Calibrate with --time-offsets"
    return (
        "out of step" if clock.rate == 1.0 else "frame rate",
        finding(clock, timing),
        f"Give {flags([clock], timing)}",
    )


def _unknown(name: str, share: float) -> tuple[str, str, str]:
    fits = f"No more than {share:.0%} of its observations fit any one camera" if share < FITS else "It fits by itself"
    return (
        "contradicting camera",
        f"{fits}: it shows another light, another room, or other moments than the others.",
        f"Check what {name} recorded, and whether it lost frames (`jaxpoint check`)",
    )


class Projection:
    """A projection matrix fitted to points and pixels, outliers and all."""

    def __init__(self, matrix: Float[np.ndarray, "3 4"], inliers: Bool[np.ndarray, " N"], depths: np.ndarray):
        self.share = float(inliers.mean())
        turned = (
            np.linalg.det(matrix[:, :3]) * (1.0 if np.median(depths[inliers]) > 0 else -1.0) if inliers.any() else 1.0
        )
        self.mirrored = bool(turned < 0)  # the points lie before it only if its axes are left-handed


def fit_projection(
    points: Float[np.ndarray, "N 3"], pixels: Float[np.ndarray, "N 2"], near_px: float, seed: int
) -> Projection:
    """The linear projection with which most observations agree (direct linear transform on random samples)."""
    rng = np.random.default_rng(seed)
    rows = _linear_rows(points, pixels)
    samples = rng.integers(0, len(points), (SAMPLES, 6))
    matrices = np.linalg.svd(rows[samples].reshape(SAMPLES, 12, 12))[2][:, 11]
    errors = np.stack([_errors(matrix.reshape(3, 4), points, pixels)[0] for matrix in matrices])
    best = errors[(errors < near_px).sum(axis=1).argmax()] < near_px
    for _ in range(3):
        if best.sum() < 6:
            break
        matrix = np.linalg.svd(rows[best].reshape(-1, 12), full_matrices=False)[2][11].reshape(3, 4)
        best = _errors(matrix, points, pixels)[0] < near_px
    else:
        return Projection(matrix, best, _errors(matrix, points, pixels)[1])
    return Projection(np.eye(3, 4), np.zeros(len(points), bool), np.ones(len(points)))


def _linear_rows(points: np.ndarray, pixels: np.ndarray) -> Float[np.ndarray, "N 2 12"]:
    """Of every observation, the two equations of the transform; pixels in thousands for the conditioning."""
    x = np.concatenate([points, np.ones((len(points), 1))], axis=1)
    u = pixels / 1000.0
    zero = np.zeros_like(x)
    return np.stack(
        [
            np.concatenate([x, zero, -u[:, :1] * x], axis=1),
            np.concatenate([zero, x, -u[:, 1:] * x], axis=1),
        ],
        axis=1,
    )


def _errors(matrix: np.ndarray, points: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance of every projection (px) and the third coordinate, of the sign of a depth."""
    mapped = points @ matrix[:, :3].T + matrix[:, 3]
    third = np.where(np.abs(mapped[:, 2]) < 1e-12, 1e-12, mapped[:, 2])
    return np.linalg.norm(1000.0 * mapped[:, :2] / third[:, None] - pixels, axis=1), mapped[:, 2]
