"""Calibrated rigs in files: our `calibration.json`, anipose's `calibration.toml`, caliscope's `camera_array.toml`.

`calibration.json`, version 1:

    {"format": "jaxpoint-calibration",
     "version": 1,
     "unit": "m",                          or "arbitrary" before alignment: the unit of all translations
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
     "provenance": {...}}                  free: versions, seed, hashes of the input, time, ...

`covariance.matrix` is pC x pC, the parameters of the first camera first, in the order of `parameters` (that of
`Camera.perturbed`); the rotation is a left perturbation (R = exp(w) R0, rad).

`calibration.toml` holds one table a camera, `cam_0`, `cam_1`, ... in input order, each with `name`, `size`, `matrix`,
`distortions` (k1, k2, p1, p2, k3, or 8 of the rational model; with `fisheye = true` 4), `rotation` (rotation vector)
and `translation`, and a table `metadata`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import tomli_w
from jaxtyping import Float

from jaxpoint.calibration.result import TimeOffsets
from jaxpoint.camera.brown import Brown
from jaxpoint.camera.kannala_brandt import KannalaBrandt
from jaxpoint.camera.pinhole import Pinhole
from jaxpoint.camera.rational import Rational
from jaxpoint.camera.rig import CameraRig
from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.io.files import UNITS, StrPath, natural_key, read_text, replacing
from jaxpoint.io.lens_entries import read_coefficients
from jaxpoint.io.lens_files import YAML, read_yaml_lenses
from jaxpoint.io.qualisys import read_qualisys
from jaxpoint.io.rig_entries import (
    UNSTATED,
    CameraEntry,
    SavedCalibration,
    check_entry,
    check_finite_numbers,
    entries_of,
    in_metres,
    rig_of_entries,
    tuples,
)

CALIBRATION_FORMAT = "jaxpoint-calibration"
CALIBRATION_VERSION = 1


class _CovarianceEntry(msgspec.Struct, forbid_unknown_fields=True):
    parameters: list[str]
    matrix: list[list[float]]
    gauge: str | None = None


class _TimeOffsetsEntry(msgspec.Struct, forbid_unknown_fields=True):
    frames: list[float]
    sigma: list[float]


class _CalibrationFile(msgspec.Struct, forbid_unknown_fields=True):
    format: str
    version: int
    unit: str
    cameras: list[CameraEntry]
    covariance: _CovarianceEntry | None = None
    provenance: dict[str, Any] = {}
    time_offsets: _TimeOffsetsEntry | msgspec.UnsetType = msgspec.UNSET
    in_room: bool | msgspec.UnsetType = msgspec.UNSET  # only where it is not, though in metres


def read_lenses(path: StrPath) -> CameraRig:
    """Known lenses, from whatever `read_calibration` reads, with or without poses, or from YAML (`read_yaml_lenses`).

    Raises:
        FileFormatError: it is none of these, a value is missing or wrong, or a lens is of a model that is not known.
    """
    path = Path(path)
    yaml = path.suffix.lower() in YAML or (path.is_dir() and any(f.suffix.lower() in YAML for f in path.iterdir()))
    return read_yaml_lenses(path) if yaml else _read(path, poses=False).rig


def read_calibration(path: StrPath) -> SavedCalibration:
    """A rig from `calibration.json`, `calibration.toml`, `camera_array.toml`, Qualisys' `*.qca.txt`, or a run's folder.

    Raises:
        FileFormatError: it is none of these, or a value is missing or wrong (the message gives its path).
    """
    return _read(Path(path), poses=True)


def _read(path: Path, poses: bool) -> SavedCalibration:
    if path.is_dir():
        path = path / "calibration.json"
    if path.suffix.lower() == ".json":
        return read_calibration_json(path, poses)
    if path.suffix.lower() == ".toml":
        return read_camera_array(path, poses) if "cameras" in _read_toml(path) else read_calibration_toml(path, poses)
    if path.name.lower().endswith(".qca.txt"):
        return SavedCalibration(read_qualisys(path))
    if not path.exists():
        raise FileFormatError(f"There is no file {path}; check the path.")
    lens = " (YAML of lenses goes to `jaxpoint calibrate --intrinsics`)" if path.suffix.lower() in YAML else ""
    raise FileFormatError(
        f"{path} is no calibration; give a calibration.json, a .toml, a .qca.txt, or a run's folder{lens}."
    )


def write_calibration_json(
    path: StrPath,
    rig: CameraRig,
    *,
    unit: str = "m",
    covariance: Float[np.ndarray, "D D"] | None = None,
    gauge: str | None = None,
    provenance: Mapping[str, Any] | None = None,
    time_offsets: TimeOffsets | None = None,
    in_room: bool = True,
) -> None:
    """Write a rig as `calibration.json` (schema: this module's docstring), at once or not at all.

    Args:
        unit: of the translations, "m" or "arbitrary".
        covariance: of all camera parameters, D = p C, in the order of `Camera.perturbed`.
        gauge: what holds its frame, "free" or "landmarks" (see `calibration.uncertainty`).
        provenance: anything JSON can hold.
        time_offsets: of the cameras, where they were solved for.
        in_room: False for metres of a frame of the solver's own.

    Raises:
        ValueError: a number is not finite, or the covariance has another shape.
    """
    size = rig.camera_size * len(rig)
    if covariance is not None and np.shape(covariance) != (size, size):
        raise ValueError(f"The covariance is {np.shape(covariance)}; {len(rig)} cameras need {(size, size)}.")
    check_finite_numbers("covariance", covariance if covariance is not None else 0.0)
    entry = None
    if covariance is not None:
        entry = _CovarianceEntry(list(rig.cameras.parameter_names()), np.asarray(covariance).tolist(), gauge)
    late = (
        msgspec.UNSET
        if time_offsets is None
        else _TimeOffsetsEntry(time_offsets.frames.tolist(), time_offsets.sigma.tolist())
    )
    own = False if unit == "m" and not in_room else msgspec.UNSET
    content = _CalibrationFile(
        CALIBRATION_FORMAT, CALIBRATION_VERSION, unit, entries_of(rig), entry, dict(provenance or {}), late, own
    )
    with replacing(path) as file:
        file.write(msgspec.json.format(msgspec.json.encode(content), indent=1))


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
    except msgspec.DecodeError as error:  # also what msgspec raises for a value that does not fit the schema
        raise FileFormatError(
            f"{path} is not a whole calibration.json: {error}; copy it again, or write it anew by `jaxpoint calibrate`."
        ) from None
    if content.unit not in ("m", "arbitrary"):
        raise FileFormatError(f"{path}: unit '{content.unit}' at `$.unit` is neither 'm' nor 'arbitrary'.")
    for i, camera in enumerate(content.cameras):
        if isinstance(camera.lens, msgspec.UnsetType) and len(camera.distortion) < 4:
            raise FileFormatError(f"{path}: `$.cameras[{i}].distortion` must be k1, k2, p1, p2 and k3, five numbers.")
        check_entry(f"{path}: at `$.cameras[{i}]`, ", camera)
    rig = rig_of_entries(path, content.cameras, poses)
    entry = content.covariance
    gauge = None if entry is None else entry.gauge
    late = _time_offsets(path, content.time_offsets, len(rig))
    covariance, in_room = _covariance(path, entry, rig), content.in_room is not False
    return SavedCalibration(rig, content.unit, covariance, gauge, content.provenance, late, in_room)


def _time_offsets(path: StrPath, entry: _TimeOffsetsEntry | msgspec.UnsetType, cameras: int) -> TimeOffsets | None:
    if isinstance(entry, msgspec.UnsetType):
        return None
    if len(entry.frames) != cameras or len(entry.sigma) != cameras:
        raise FileFormatError(
            f"{path}: `$.time_offsets` has {len(entry.frames)} frames and {len(entry.sigma)} sigmas for {cameras} "
            "cameras; one each is needed."
        )
    return TimeOffsets(np.array(entry.frames), np.array(entry.sigma))


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


def write_calibration_toml(
    path: StrPath, rig: CameraRig, *, unit: str = "m", metadata: Mapping[str, Any] | None = None
) -> None:
    """Write a rig as anipose and caliscope read it (`cam_0`, ... in input order), at once or not at all.

    Args:
        unit: of the translations; stands in `[metadata]`.
        metadata: further values of `[metadata]`; anipose knows `adjusted` and `error` (px).

    Raises:
        ValueError: a number is not finite.
        UsageError: the format has no place for a lens of this model.
    """
    if type(rig.cameras.lens) not in (Brown, Pinhole, Rational, KannalaBrandt):
        raise UsageError(f"calibration.toml has no place for a {rig.cameras.lens.name} lens; use calibration.json.")
    content: dict[str, Any] = {}
    for i, camera in enumerate(entries_of(rig)):
        content[f"cam_{i}"] = {
            "name": camera.name,
            "size": list(camera.size),
            "matrix": [list(row) for row in camera.K],
            "distortions": list(camera.distortion),
            "rotation": cv2.Rodrigues(np.array(camera.rotation))[0].ravel().tolist(),
            "translation": list(camera.translation or ()),
            **({"fisheye": True} if type(rig.cameras.lens) is KannalaBrandt else {}),
        }
    content["metadata"] = {"adjusted": True, "error": 0.0, "unit": unit, **(metadata or {})}
    with replacing(path) as file:
        tomli_w.dump(content, file)


def read_calibration_toml(path: StrPath, poses: bool = True) -> SavedCalibration:
    """A rig written by `write_calibration_toml`, anipose, caliscope or Pose2Sim; the cameras in the file's order.

    Millimetres and centimetres become metres where `[metadata]` has such a `unit`; without one the unit is `UNSTATED`.
    `poses` False lets cameras go without.

    Raises:
        FileFormatError: not TOML, no camera, or a missing or wrong value (with its section).
    """
    content = _read_toml(path)
    metadata = content.pop("metadata", {})
    cameras = [
        _toml_entry(path, section, table, str(table.get("name", section)), poses)
        for section, table in content.items()
        if isinstance(table, dict)
    ]
    if not cameras:
        raise FileFormatError(f"{path} holds no camera; expected sections [cam_0], [cam_1], ...")
    saved = SavedCalibration(
        rig_of_entries(path, cameras, poses),
        str(metadata.get("unit", UNSTATED)),
        provenance=metadata,
        in_room=metadata.get("in_room") is not False,
    )
    return in_metres(saved, saved.unit) if saved.unit in UNITS else saved


def read_camera_array(path: StrPath, poses: bool = True) -> SavedCalibration:
    """The cameras of caliscope's `camera_array.toml` (metres), named cam_<id>; ignored cameras are left out.

    Raises:
        FileFormatError: not such a file, or a missing or wrong value (with its section).
    """
    cameras = [
        _toml_entry(path, f"cameras.{key}", table, f"cam_{key}", poses)
        for key, table in _camera_array_tables(path).items()
    ]
    return SavedCalibration(rig_of_entries(path, cameras, poses))


def read_camera_array_sizes(path: StrPath) -> dict[str, tuple[int, int]]:
    """Width and height (px) of each camera of `camera_array.toml`, calibrated or not.

    Raises:
        FileFormatError: not such a file, or a size is missing or wrong.
    """
    return {
        f"cam_{key}": _toml_size(f"{path}, [cameras.{key}]: ", table)
        for key, table in _camera_array_tables(path).items()
    }


def _camera_array_tables(path: StrPath) -> dict[str, dict[str, Any]]:
    cameras = _read_toml(path).get("cameras")
    if not isinstance(cameras, dict):
        raise FileFormatError(f"{path} is no camera_array.toml; expected sections [cameras.0], [cameras.1], ...")
    kept = {key: table for key, table in cameras.items() if not table.get("ignore", False)}
    return {key: kept[key] for key in sorted(kept, key=natural_key)}


def _read_toml(path: StrPath) -> dict[str, Any]:
    try:
        return tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        raise FileFormatError(f"{path}: {error}; it is not TOML.") from None


def _toml_size(where: str, table: Mapping[str, Any]) -> tuple[int, int]:
    width, height = _numbers(where, table, "size", (2,))
    if width != int(width) or height != int(height):
        raise FileFormatError(f"{where}size {table['size']} must be whole pixels.")
    return int(width), int(height)


def _toml_entry(path: StrPath, section: str, table: Mapping[str, Any], name: str, poses: bool) -> CameraEntry:
    where = f"{path}, [{section}]: "
    if "distortions" not in table:
        raise FileFormatError(f"{where}'distortions' is missing.")
    model, distortion = read_coefficients(where, table["distortions"], KannalaBrandt if table.get("fisheye") else None)
    matrix = tuples(_numbers(where, table, "matrix", (3, 3)))
    pose = _toml_pose(where, table, poses)
    entry = CameraEntry(name, _toml_size(where, table), matrix, distortion.tolist(), *pose, lens=model.name)
    check_entry(where, entry)
    return entry


def _toml_pose(where: str, table: Mapping[str, Any], needed: bool) -> tuple[Any, Any]:
    """Rotation matrix and translation; neither where they are not needed and not there."""
    if not needed and not {"rotation", "translation"} & table.keys():
        return None, None
    rotation = _numbers(where, table, "rotation", None)
    if rotation.shape not in ((3,), (3, 3)):
        raise FileFormatError(f"{where}rotation has shape {rotation.shape}; give a rotation vector or a 3 x 3 matrix.")
    matrix = cv2.Rodrigues(rotation)[0] if rotation.shape == (3,) else rotation
    return tuples(np.asarray(matrix)), tuples(_numbers(where, table, "translation", (3,)))


def _numbers(where: str, table: Mapping[str, Any], key: str, shape: tuple[int, ...] | None) -> np.ndarray:
    if key not in table:
        raise FileFormatError(f"{where}'{key}' is missing.")
    try:
        values = np.array(table[key], dtype=float)
    except (TypeError, ValueError):
        raise FileFormatError(f"{where}'{key}' must hold numbers.") from None
    if not np.isfinite(values).all() or (shape is not None and values.shape != shape):
        size = " x ".join(map(str, shape or values.shape))
        raise FileFormatError(f"{where}'{key}' must be {size} finite numbers, not {table[key]}.")
    return values
