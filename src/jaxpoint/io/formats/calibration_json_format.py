"""jaxpoint's own `calibration.json` among the formats; its schema is in `io.calibration`."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from jaxpoint.io.calibration import CALIBRATION_FORMAT, encode_calibration, read_calibration_json
from jaxpoint.io.formats.calibration_format import CalibrationFormat, Holds, Request
from jaxpoint.io.rig_entries import SavedCalibration


def _read(request: Request) -> SavedCalibration:
    saved = read_calibration_json(request.only.path, request.poses)
    why = _mark(request.only.path.with_name("metrics.json"))
    return (
        saved
        if why is None
        else replace(saved, notes=(*saved.notes, f"'{request.where}' was marked when it was made: {why}"))
    )


def _mark(metrics: Path) -> str | None:
    """Why the run that a calibration lies in did not pass its quality gate, if it lies in one and did not."""
    try:
        figures = json.loads(metrics.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return figures.get("failure") if isinstance(figures, dict) else None


def _write(saved: SavedCalibration, path: Path) -> Mapping[str, bytes]:
    return {"calibration.json": encode_calibration(saved)}


FORMAT = CalibrationFormat(
    name="jaxpoint",
    title="jaxpoint's calibration.json",
    patterns=("calibration.json",),
    recognise=lambda path, head: re.search(rf'"format"\s*:\s*"{CALIBRATION_FORMAT}"', head) is not None,
    holds=Holds(lenses="all", unit="any", room=True),
    read=_read,
    write=_write,
    needs_poses=False,
)
