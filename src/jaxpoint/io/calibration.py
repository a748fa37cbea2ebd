"""jaxpoint's own file of a calibrated rig, `calibration.json`; `io.exchange` reads and writes all formats.

Version 1:

    {"format": "jaxpoint-calibration",
     "version": 1,
     "unit": "m",                          or "arbitrary" before alignment, or "unstated" where it was converted
                                           from a file that does not say it: the unit of all translations
     "in_room": false,                     only where metres come from a target alone: the frame has no floor, no up
     "cameras": [{"name": "cam_0",
                  "size": [1280, 720],     width and height, px
                  "K": [[fx, 0, cx], [0, fy, cy], [0, 0, 1]],     px, (0, 0) is the centre of the top-left pixel
                  "distortion": [k1, k2, p1, p2, k3],             OpenCV's order
                  "lens": "kannala_brandt",                       or "rational", ... where it is not Brown's; the
                                                                  coefficients are then the model's (`camera`)
                  "rotation": [[...], [...], [...]],              x_camera = rotation x_world + translation,
                  "translation": [x, y, z]}, ...],                camera axes x right, y down, z forward
     "covariance": null,                   or {"parameters": [...p names...], "matrix": [[...], ...],
                                               "gauge": "free" or "landmarks"}
     "time_offsets": {"frames": [0.0, ...], "sigma": [0.0, ...]},      one a camera, only where they were solved for:
                                           by how many frames it shows the light later than the first camera
     "readout_times": {"frames": [0.6, ...], "sigma": [0.01, ...]},    one a camera, only where they were solved for:
                                           frames from its first image row to its last
     "provenance": {...}}                  free: versions, seed, hashes of the input, time, ...

`covariance.matrix` is pC x pC, the parameters of the first camera first, in the order of `parameters` (that of
`Camera.perturbed`); the rotation is a left perturbation (R = exp(w) R0, rad).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

import msgspec
import numpy as np
from jaxtyping import Float

from jaxpoint.calibration.result import ReadoutTimes, TimeOffsets
from jaxpoint.camera.rig import CameraRig
from jaxpoint.errors import FileFormatError
from jaxpoint.io.files import StrPath, read_text, replacing
from jaxpoint.io.rig_entries import (
    UNSTATED,
    CameraEntry,
    SavedCalibration,
    check_entry,
    check_finite_numbers,
    rig_of_entries,
)

CALIBRATION_FORMAT = "jaxpoint-calibration"
CALIBRATION_VERSION = 1
CALIBRATION_UNITS = ("m", "arbitrary", UNSTATED)
OneTimes = TypeVar("OneTimes", TimeOffsets, ReadoutTimes)


class _CovarianceEntry(msgspec.Struct, forbid_unknown_fields=True):
    parameters: list[str]
    matrix: list[list[float]]
    gauge: str | None = None


class _TimesEntry(msgspec.Struct, forbid_unknown_fields=True):
    frames: list[float]
    sigma: list[float]


class _CalibrationFile(msgspec.Struct, forbid_unknown_fields=True):
    format: str
    version: int
    unit: str
    cameras: list[CameraEntry]
    covariance: _CovarianceEntry | None = None
    provenance: dict[str, Any] = {}
    time_offsets: _TimesEntry | msgspec.UnsetType = msgspec.UNSET
    readout_times: _TimesEntry | msgspec.UnsetType = msgspec.UNSET
    in_room: bool | msgspec.UnsetType = msgspec.UNSET  # only where it is not, though in metres


def write_calibration_json(
    path: StrPath,
    rig: CameraRig,
    *,
    unit: str = "m",
    covariance: Float[np.ndarray, "D D"] | None = None,
    gauge: str | None = None,
    provenance: Mapping[str, Any] | None = None,
    time_offsets: TimeOffsets | None = None,
    readout_times: ReadoutTimes | None = None,
    in_room: bool = True,
) -> None:
    """Write a rig as `calibration.json` (schema: this module's docstring), at once or not at all.

    Args:
        unit: of the translations, "m" or "arbitrary".
        covariance: of all camera parameters, D = p C, in the order of `Camera.perturbed`.
        gauge: what holds its frame, "free" or "landmarks" (see `calibration.uncertainty`).
        provenance: anything JSON can hold.
        time_offsets: of the cameras, where they were solved for.
        readout_times: likewise.
        in_room: False for metres of a frame of the solver's own.

    Raises:
        ValueError: a number is not finite, or the covariance has another shape.
    """
    saved = SavedCalibration(
        rig,
        unit,
        covariance,
        gauge,
        dict(provenance or {}),
        time_offsets,
        in_room,
        readout_times=readout_times,
    )
    content = encode_calibration(saved)
    with replacing(path) as file:
        file.write(content)


def encode_calibration(saved: SavedCalibration) -> bytes:
    """The text of `calibration.json`.

    Raises:
        ValueError: a number is not finite, or the covariance has another shape.
    """
    rig, covariance = saved.rig, saved.covariance
    size = rig.camera_size * len(rig)
    if covariance is not None and np.shape(covariance) != (size, size):
        raise ValueError(f"The covariance is {np.shape(covariance)}; {len(rig)} cameras need {(size, size)}.")
    check_finite_numbers("covariance", covariance if covariance is not None else 0.0)
    entry = None
    if covariance is not None:
        entry = _CovarianceEntry(list(rig.cameras.parameter_names()), np.asarray(covariance).tolist(), saved.gauge)
    times = _entry(saved.time_offsets), _entry(saved.readout_times)
    own = False if saved.unit == "m" and not saved.in_room else msgspec.UNSET
    content = _CalibrationFile(
        CALIBRATION_FORMAT, CALIBRATION_VERSION, saved.unit, saved.entries(), entry, saved.provenance, *times, own
    )
    return msgspec.json.format(msgspec.json.encode(content), indent=1)


def read_calibration_json(path: StrPath, poses: bool = True) -> SavedCalibration:
    """A rig written by `write_calibration_json`; `poses` False lets cameras go without.

    Raises:
        FileFormatError: not JSON, another format or version, or an unknown, missing or wrong field (with its path).
    """
    try:
        raw = msgspec.json.decode(read_text(path))
        if not isinstance(raw, dict) or raw.get("format") != CALIBRATION_FORMAT:
            raise FileFormatError(f"{path} is not a calibration.json: its 'format' is not '{CALIBRATION_FORMAT}'.")
        if raw.get("version") != CALIBRATION_VERSION:
            raise FileFormatError(
                f"{path} has version {raw.get('version')}; this jaxpoint reads {CALIBRATION_VERSION}. Update jaxpoint."
            )
        content = msgspec.convert(raw, _CalibrationFile)
    except RecursionError:
        raise FileFormatError(f"{path} is not a calibration.json (brackets in brackets without end).") from None
    except msgspec.DecodeError as error:  # also what msgspec raises for a value that does not fit the schema
        raise FileFormatError(
            f"{path} is not a whole calibration.json: {error}; copy it again, or write it anew by `jaxpoint calibrate`."
        ) from None
    if content.unit not in CALIBRATION_UNITS:
        raise FileFormatError(f"{path}: unit '{content.unit}' at `$.unit` is none of {', '.join(CALIBRATION_UNITS)}.")
    for i, camera in enumerate(content.cameras):
        if isinstance(camera.lens, msgspec.UnsetType) and len(camera.distortion) < 4:
            raise FileFormatError(f"{path}: `$.cameras[{i}].distortion` must be k1, k2, p1, p2 and k3, five numbers.")
        check_entry(f"{path}: at `$.cameras[{i}]`, ", camera)
    rig = rig_of_entries(path, content.cameras, poses)
    entry = content.covariance
    gauge = None if entry is None else entry.gauge
    late = _times(path, "time_offsets", content.time_offsets, TimeOffsets, len(rig))
    rolling = _times(path, "readout_times", content.readout_times, ReadoutTimes, len(rig))
    covariance, in_room = _covariance(path, entry, rig), content.in_room is not False
    posed = all(camera.rotation is not None and camera.translation is not None for camera in content.cameras)
    return SavedCalibration(
        rig, content.unit, covariance, gauge, content.provenance, late, in_room, posed, readout_times=rolling
    )


def _entry(times: TimeOffsets | ReadoutTimes | None) -> _TimesEntry | msgspec.UnsetType:
    return msgspec.UNSET if times is None else _TimesEntry(times.frames.tolist(), times.sigma.tolist())


def _times(
    path: StrPath, name: str, entry: _TimesEntry | msgspec.UnsetType, kind: type[OneTimes], cameras: int
) -> OneTimes | None:
    if isinstance(entry, msgspec.UnsetType):
        return None
    if len(entry.frames) != cameras or len(entry.sigma) != cameras:
        raise FileFormatError(
            f"{path}: `$.{name}` has {len(entry.frames)} frames and {len(entry.sigma)} sigmas for {cameras} "
            "cameras; one each is needed."
        )
    return kind(np.array(entry.frames), np.array(entry.sigma))


def _covariance(path: StrPath, entry: _CovarianceEntry | None, rig: CameraRig) -> np.ndarray | None:
    if entry is None:
        return None
    names, cameras = list(rig.cameras.parameter_names()), len(rig)
    size = len(names) * cameras
    if entry.parameters != names:
        raise FileFormatError(f"{path}: `$.covariance.parameters` must be {', '.join(names)}.")
    if len(entry.matrix) != size or any(len(row) != size for row in entry.matrix):
        raise FileFormatError(f"{path}: `$.covariance.matrix` must be {size} x {size} for {cameras} cameras.")
    return np.array(entry.matrix)
