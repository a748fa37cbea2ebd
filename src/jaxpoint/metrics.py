"""The figures of a calibration that a person or a program compares, and the quality gate."""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np

from jaxpoint.calibration.result import Calibration, Verdict
from jaxpoint.camera.distortion import Brown
from jaxpoint.config import AlignSettings, CalibrateSettings
from jaxpoint.errors import JaxpointError, NotConvergedError, QualityError


def metrics(calibration: Calibration, detect_seconds: float | None = None) -> dict[str, Any]:
    """What `metrics.json` holds: strict JSON, with None for what does not exist.

    Reprojection errors are lengths of two-dimensional residuals in pixels, over the observations kept;
    `mean_all_px` is over every visible observation that has a residual, believed or not (`observations.compared`).

    Args:
        detect_seconds: how long the detection took that made the tracks, where known; it is added to the total.
    """
    kept, visible = calibration.kept, calibration.tracks.visible
    errors = calibration.errors
    compared = visible & (errors > 0)
    seconds = {"detect": detect_seconds, "init": None, "adjust": None, **calibration.seconds}
    seconds["total"] = (detect_seconds or 0.0) + calibration.seconds.get("total", 0.0)
    return {
        "reprojection": {
            "mean_px": _mean(errors[kept]),
            "std_px": _finite(errors[kept].std()) if kept.any() else None,
            "rms_px": _finite(np.sqrt((errors[kept] ** 2).mean())) if kept.any() else None,
            "per_camera_mean_px": [_mean(errors[kept[:, c], c]) for c in range(kept.shape[1])],
            "mean_all_px": _mean(errors[compared]),
        },
        "observations": {"used": int(kept.sum()), "total": int(visible.sum()), "compared": int(compared.sum())},
        "frames": {"used": int(calibration.point_valid.sum()), "total": calibration.tracks.frames},
        "verdicts": {
            v.name.lower(): int((calibration.verdicts == v)[visible].sum()) for v in Verdict if v != Verdict.HIDDEN
        },
        "sigma_px": _finite(calibration.sigma_px),
        "converged": bool(calibration.converged),
        "message": calibration.message,
        "unit": calibration.unit,
        "seconds": {name: _finite(value) for name, value in seconds.items()},
        "seed": calibration.seed,
        "cameras": _cameras(calibration),
        "time_offsets": _time_offsets(calibration),
    }


def _cameras(calibration: Calibration) -> list[dict[str, Any]]:
    cameras = calibration.rig.cameras
    focal, center = np.asarray(cameras.focal), np.asarray(cameras.center)
    coefficients = np.asarray(cast(Brown, cameras.distortion).coefficients)
    kept, visible = calibration.kept, calibration.tracks.visible
    return [
        {
            "name": name,
            "focal_px": _numbers(focal[c]),
            "center_px": _numbers(center[c]),
            "distortion": _numbers(coefficients[c]),
            "used": int(kept[:, c].sum()),
            "total": int(visible[:, c].sum()),
        }
        for c, name in enumerate(calibration.tracks.names)
    ]


def _time_offsets(calibration: Calibration) -> dict[str, list[float | None]] | None:
    late = calibration.time_offsets
    return None if late is None else {"frames": _numbers(late.frames), "sigma": _numbers(late.sigma)}


def judge(
    calibration: Calibration, settings: CalibrateSettings, align: AlignSettings | None = None
) -> JaxpointError | None:
    """Why the calibration should not be trusted, or None where it passes the stated thresholds.

    Args:
        align: threshold of the alignment; the default if not given. It counts for aligned calibrations only.
    """
    if not calibration.converged:
        return NotConvergedError(
            f"The adjustment did not converge ({calibration.message}); the results are kept and marked. Record more "
            "of the room, or try another --init."
        )
    mean = _mean(calibration.errors[calibration.kept])
    if mean is None or mean > settings.max_mean_px:
        return QualityError(
            f"The mean reprojection error is {mean} px, above the {settings.max_mean_px:g} px allowed; the results are "
            "kept and marked. The report shows which camera disagrees."
        )
    fraction = calibration.kept.sum() / max(calibration.comparable.sum(), 1)
    if fraction < settings.min_kept:
        return QualityError(
            f"Only {fraction:.0%} of the observations in frames of two or more views fit, below the "
            f"{settings.min_kept:.0%} asked for; the results are kept and marked. The report shows which camera or "
            "time disagrees."
        )
    aligned, allowed = calibration.alignment, (align or AlignSettings()).max_rms_mm
    if aligned is not None and aligned.rms_mm > allowed:
        return QualityError(
            f"The alignment leaves {aligned.rms_mm:.0f} mm (rms), above the {allowed:g} mm allowed; the results are "
            "kept and marked. The report shows which landmark disagrees."
        )
    return None


def _mean(values: np.ndarray) -> float | None:
    return _finite(values.mean()) if values.size else None


def _finite(value: Any) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None


def _numbers(values: np.ndarray) -> list[float | None]:
    return [_finite(value) for value in values]
