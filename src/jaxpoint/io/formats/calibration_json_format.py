"""jaxpoint's own `calibration.json` among the formats; its schema is in `io.calibration`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from jaxpoint.io.calibration import CALIBRATION_FORMAT, encode_calibration, read_calibration_json
from jaxpoint.io.formats.calibration_format import CalibrationFormat, Holds, Request
from jaxpoint.io.rig_entries import SavedCalibration


def _read(request: Request) -> SavedCalibration:
    return read_calibration_json(request.only.path, request.poses)


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
