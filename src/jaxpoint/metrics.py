"""The figures of a calibration that a person or a program compares."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import numpy as np

from jaxpoint.calibration.quality import Quality
from jaxpoint.calibration.result import Calibration, ReadoutTimes, TimeOffsets, Verdict
from jaxpoint.camera.mixed import own_coefficients


def metrics(
    calibration: Calibration, detect_seconds: float | None = None, quality: Quality | None = None
) -> dict[str, Any]:
    """What `metrics.json` holds: strict JSON, with None for what does not exist.

    Reprojection errors are lengths of two-dimensional residuals in pixels, over the observations kept;
    `mean_all_px` is over every visible observation that has a residual, believed or not (`observations.compared`).

    Args:
        detect_seconds: how long the detection took that made the tracks, where known; it is added to the total.
        quality: what `calibration.quality.assess` decided, where it was asked.
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
        "time_offsets": _times(calibration.time_offsets),
        "readout_times": _times(calibration.readout_times),
        **({} if quality is None else _verdict(quality)),
    }


def _verdict(quality: Quality) -> dict[str, Any]:
    """Whether it passes, why not, and all that was found."""
    return {
        "passed": quality.passed,
        "failure": None if quality.failure is None else str(quality.failure),
        "causes": list(quality.causes),
        "holds_without_cameras_left_out": quality.holds,
        "findings": [asdict(finding) for finding in quality.findings],
    }


def _cameras(calibration: Calibration) -> list[dict[str, Any]]:
    cameras = calibration.rig.cameras
    focal, center = np.asarray(cameras.focal), np.asarray(cameras.center)
    models, kind = calibration.rig.lens_models, type(cameras.lens)
    coefficients = np.asarray(cameras.distortion)
    kept, visible = calibration.kept, calibration.tracks.visible
    return [
        {
            "name": name,
            "focal_px": _numbers(focal[c]),
            "center_px": _numbers(center[c]),
            "lens": models[c].name,
            "distortion": _numbers(coefficients[c][own_coefficients(kind, models[c])]),
            "used": int(kept[:, c].sum()),
            "total": int(visible[:, c].sum()),
        }
        for c, name in enumerate(calibration.tracks.names)
    ]


def _times(found: TimeOffsets | ReadoutTimes | None) -> dict[str, list[float | None]] | None:
    return None if found is None else {"frames": _numbers(found.frames), "sigma": _numbers(found.sigma)}


def _mean(values: np.ndarray) -> float | None:
    return _finite(values.mean()) if values.size else None


def _finite(value: Any) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None


def _numbers(values: np.ndarray) -> list[float | None]:
    return [_finite(value) for value in values]
