"""Every camera by itself: what is kept of its observations, when, and residuals that follow the light's motion."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.calibration.contradiction import LEAST_KEPT, kept_shares
from jaxpoint.calibration.normal import DRIFT, OFFSET, ROWS, GaussNewtonStep, NormalEquations
from jaxpoint.calibration.result import Calibration, Finding
from jaxpoint.camera.parameters import FOCAL
from jaxpoint.config import CalibrateSettings

STRETCHES = 10  # equal parts of the recording
DEAD, ALIVE = 0.3, 0.85  # kept in a stretch: the camera does not fit there, it does elsewhere
FEWEST = 15  # observations of a stretch that tell something
SURE = 6.0  # sigmas of a time offset (cameras in step come to 4, simulated or real)
FOCAL_SIGMAS, FOCAL_CHANGE = 3.0, 0.02  # by which a focal length would change: then the clocks have spoilt it
NOTABLE, LARGE = 0.1, 0.5  # frames: worth a word, and no longer a calibration (residuals give lower bounds)


def camera_findings(
    calibration: Calibration, settings: CalibrateSettings, normal: NormalEquations | None
) -> Iterator[Finding]:
    """What single cameras say against the calibration."""
    yield from _inlier_findings(calibration, settings)
    yield from _stretches(calibration)
    if normal is not None and calibration.freedom is not None:
        yield from _clocks(calibration, normal)


def _inlier_findings(calibration: Calibration, settings: CalibrateSettings) -> Iterator[Finding]:
    shares, names = kept_shares(calibration), calibration.tracks.names
    for camera in np.flatnonzero(shares < max(settings.min_kept, LEAST_KEPT)):
        name = names[camera]
        yield Finding(
            "contradicting camera",
            "bad" if shares[camera] < LEAST_KEPT else "care",
            f"Camera {name} contradicts the others: {shares[camera]:.0%} of its observations fit.",
            f"Look whether {name} is late or runs at another rate (`jaxpoint check`), is mirrored, shows reflections "
            f"(mask them) or was moved; or leave it out (--leave-out {name})",
            (name,),
        )


def _stretches(calibration: Calibration) -> Iterator[Finding]:
    """Cameras that fit for one part of the recording only."""
    different, rank = np.unique(calibration.tracks.frame_ids, return_inverse=True)
    part = rank.ravel() * STRETCHES // max(len(different), 1)
    for camera, name in enumerate(calibration.tracks.names):
        tested, kept = calibration.comparable[:, camera], calibration.kept[:, camera]
        count = np.bincount(part[tested], minlength=STRETCHES)
        share = np.bincount(part[kept], minlength=STRETCHES) / np.maximum(count, 1)
        enough = count >= FEWEST
        dead = enough & (share < DEAD)
        alive = enough & ~dead
        if not dead.any() or not alive.any() or np.median(share[alive]) < ALIVE:
            continue
        rows = np.flatnonzero(np.isin(part, np.flatnonzero(dead)))
        ids = calibration.tracks.frame_ids[rows]
        yield Finding(
            "camera moved",
            "bad" if dead.sum() >= 2 else "care",
            f"Camera {name} fits no other between frames {ids.min()} and {ids.max()}, and does elsewhere: it "
            "was moved, or its recording was interrupted.",
            f"Leave out that part of the recording, or camera {name} (--leave-out {name})",
            (name,),
        )


def _clocks(calibration: Calibration, normal: NormalEquations) -> Iterator[Finding]:
    """Residuals that follow the light's motion: late cameras, other rates, rolling shutters."""
    assert calibration.freedom is not None
    solved = (OFFSET,) * (calibration.time_offsets is not None) + (ROWS,) * (calibration.readout_times is not None)
    try:
        step = normal.solve(calibration.freedom.at_noise(calibration.sigma_px), extra=(OFFSET, DRIFT, ROWS))
    except np.linalg.LinAlgError:
        return
    names = calibration.tracks.names
    for column in (OFFSET, DRIFT, ROWS):
        values, sigmas = step.change[:, column], step.sigmas[:, column]
        if column != ROWS:
            values, sigmas = against_median(values, sigmas)
        sure = (np.abs(values) > SURE * sigmas) & (np.abs(values) > NOTABLE)
        if sure.any() and column not in solved:
            worst = int(np.where(sure, np.abs(values), 0.0).argmax())
            frames = float(values[worst])
            yield (
                _rolling(names, sure, worst, frames)
                if column == ROWS
                else _late(names[worst], column, frames, _spoils(step))
            )


def _spoils(step: GaussNewtonStep) -> bool:
    """Whether focal lengths would come out otherwise with all cameras on one clock."""
    change, sigmas = np.abs(step.change[:, FOCAL]), step.sigmas[:, FOCAL]
    return bool(((change > FOCAL_SIGMAS * sigmas) & (change > FOCAL_CHANGE)).any())


def against_median(
    values: Float[np.ndarray, " C"], sigmas: Float[np.ndarray, " C"]
) -> tuple[Float[np.ndarray, " C"], Float[np.ndarray, " C"]]:
    """Offsets against the median camera rather than the first, which has none of its own."""
    sigmas = np.where(sigmas > 0, sigmas, np.median(sigmas[sigmas > 0]) if (sigmas > 0).any() else np.inf)
    return values - np.median(values), sigmas


def _late(name: str, column: int, frames: float, spoils: bool) -> Finding:
    level = "bad" if spoils or abs(frames) > LARGE else "care"
    if column == DRIFT:
        return Finding(
            "frame rate",
            level,
            f"Camera {name} runs at another rate than the others: it drifts by {abs(frames):.2f} frames or more over "
            "the recording.",
            "`jaxpoint check` finds the rate (--rate), or mend the synchronisation",
            (name,),
        )
    return Finding(
        "out of step",
        level,
        f"Camera {name} shows the light {abs(frames):.2f} frames or more {'late' if frames > 0 else 'early'}.",
        "Calibrate with --time-offsets, which solves for it, or mend the synchronisation",
        (name,),
    )


def _rolling(names: tuple[str, ...], sure: Bool[np.ndarray, " C"], worst: int, frames: float) -> Finding:
    others = [name for camera, name in enumerate(names) if sure[camera] and camera != worst]
    too = f" So do those of {', '.join(others)}." if others else ""
    return Finding(
        "rolling shutter",
        "care",
        f"The residuals of camera {names[worst]} follow the image row: its last row is read {abs(frames):.2f} frames "
        f"or more {'after' if frames > 0 else 'before'} its first (a rolling shutter).{too}",
        "Calibrate with --readout-times, which solves for it, or wave the light more slowly",
        (names[worst], *others),
    )
