"""Calibrate a room of cameras from a waved light, and say what a person points at.

The public names load on first use, so that `import jaxpoint` and `jaxpoint --help` stay quick.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxpoint.calibration.alignment import (
        Alignment,
        align_to_camera_centres,
        align_to_floor,
        align_to_landmarks,
        apply_alignment,
    )
    from jaxpoint.calibration.quality import assess
    from jaxpoint.calibration.result import Calibration, Finding, PairTable, Verdict
    from jaxpoint.calibration.selfcal import calibrate
    from jaxpoint.camera.camera import Camera
    from jaxpoint.camera.rig import CameraRig
    from jaxpoint.config import CalibrateSettings, LedSettings
    from jaxpoint.detect.led import detect_led
    from jaxpoint.geometry.pose import Pose, Similarity
    from jaxpoint.io.tracks import read_tracks
    from jaxpoint.report.html import write_report
    from jaxpoint.runs import read_run
    from jaxpoint.tracks import Tracks
    from jaxpoint.triangulation import Triangulation, triangulate

_HOMES = {
    "Alignment": "calibration.alignment",
    "CalibrateSettings": "config",
    "Calibration": "calibration.result",
    "Camera": "camera.camera",
    "CameraRig": "camera.rig",
    "LedSettings": "config",
    "PairTable": "calibration.result",
    "Pose": "geometry.pose",
    "Similarity": "geometry.pose",
    "Tracks": "tracks",
    "Triangulation": "triangulation",
    "Verdict": "calibration.result",
    "Finding": "calibration.result",
    "align_to_camera_centres": "calibration.alignment",
    "align_to_floor": "calibration.alignment",
    "align_to_landmarks": "calibration.alignment",
    "apply_alignment": "calibration.alignment",
    "assess": "calibration.quality",
    "calibrate": "calibration.selfcal",
    "detect_led": "detect.led",
    "read_run": "runs",
    "read_tracks": "io.tracks",
    "triangulate": "triangulation",
    "write_report": "report.html",
}

__all__ = [  # noqa: RUF022 (in the order a newcomer meets them)
    "Tracks", "read_tracks", "detect_led", "LedSettings",
    "calibrate", "CalibrateSettings", "Calibration", "PairTable", "Verdict", "assess", "Finding",
    "Camera", "CameraRig", "Pose", "Similarity", "triangulate", "Triangulation",
    "Alignment", "align_to_landmarks", "align_to_camera_centres", "align_to_floor", "apply_alignment",
    "read_run", "write_report",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'jaxpoint' has no attribute '{name}'")
    return getattr(import_module(f"jaxpoint.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
