"""Vicon's `.xcp`: one `<Camera>` each, mm, with position, orientation and focal length in its `<KeyFrame>`.

ORIENTATION is the quaternion x, y, z, w from world to camera (x right, y down, z forward), POSITION the camera's
centre; FOCAL_LENGTH and PRINCIPAL_POINT are px, and fy is fx / PIXEL_ASPECT_RATIO. VICON_RADIAL2 is
"Vicon3Parameter cx cy k1 k2 k3", which corrects a measured place: ideal = measured (1 + k1 r^2 + k2 r^4 + k3 r^6) about
the centre, r in px. Brown's and the rational lens bend the ideal place instead, so that each becomes the other by a
fit, whose error is said.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from jaxpoint.camera.brown import Brown
from jaxpoint.camera.conversion import fit_coefficients
from jaxpoint.errors import FileFormatError
from jaxpoint.io.formats.calibration_format import CalibrationFormat, Holds, Request
from jaxpoint.io.formats.fields import (
    camera_entry,
    camera_matrix,
    centre_of,
    no_place,
    opencv_coefficients,
    pose_of,
    quaternion_of,
    read_image_size,
    rotation_of_quaternion,
)
from jaxpoint.io.formats.image_grid import brown_pixels, image_grid
from jaxpoint.io.formats.storage_tree import parse_xml
from jaxpoint.io.rig_entries import CameraEntry, SavedCalibration

TITLE = "Vicon's .xcp"
NEAR = 0.05  # px, below which Brown's lens does
LARGEST = 1.0  # px by which a fitted lens may be off anywhere in the image


def _read(request: Request) -> SavedCalibration:
    path = request.only.path
    root = parse_xml(path, request.only.text)
    found = root.findall("Camera")
    if not found:
        raise FileFormatError(f"{path} holds no camera; Vicon's .xcp has <Cameras><Camera ...>.")
    named = [camera.get("NAME") or camera.get("DEVICEID", "") for camera in found]
    if len(set(named)) != len(named):
        named = [camera.get("DEVICEID", "") for camera in found]
    cameras, off = zip(*(_camera(f"{path}, camera '{name}': ", name, camera) for name, camera in zip(named, found)))
    notes = _note(f"{path}: Vicon's lenses were fitted by ours", max(off))
    return request.saved(cameras, unit="mm", notes=notes)


def _note(begin: str, off: float) -> list[str]:
    return [f"{begin} within {off:.2g} px over the whole image."] if off > 0 else []


def _camera(where: str, name: str, camera: ElementTree.Element) -> tuple[CameraEntry, float]:
    frame = camera.find("KeyFrames/KeyFrame")
    if frame is None:
        raise FileFormatError(f"{where}it was not calibrated (no KeyFrame); calibrate it, or delete it from the file.")
    size = read_image_size(where, _numbers(where, camera, "SENSOR_SIZE", 2).tolist())
    focal = float(_numbers(where, frame, "FOCAL_LENGTH", 1)[0])
    aspect = float(_numbers(where, camera, "PIXEL_ASPECT_RATIO", 1)[0])
    if focal <= 0 or aspect <= 0:
        raise FileFormatError(f"{where}FOCAL_LENGTH {focal:.4g} and PIXEL_ASPECT_RATIO {aspect:.4g} must be positive.")
    center = _numbers(where, frame, "PRINCIPAL_POINT", 2)
    x, y, z, w = _numbers(where, frame, "ORIENTATION", 4)
    rotation = rotation_of_quaternion(where, [w, x, y, z])
    position = _numbers(where, frame, "POSITION", 3)
    k = camera_matrix(focal, focal / aspect, center[0], center[1])
    values, off = _fitted(k, size, _correction(where, frame, center))
    if not off <= LARGEST:
        raise FileFormatError(f"{where}no lens here is its own (off by {off:.2g} px); export undistorted images.")
    return camera_entry(where, name, size, k, values, "", (rotation, -rotation @ position)), off


def _numbers(where: str, element: ElementTree.Element, name: str, count: int) -> np.ndarray:
    words = re.findall(r"\S+", element.get(name) or "")
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        values = np.full(count, np.nan)
    if values.size != count or not np.isfinite(values).all():
        raise FileFormatError(f"{where}{name} must be {count} finite numbers, not '{(element.get(name) or '')[:60]}'.")
    return values


def _correction(where: str, frame: ElementTree.Element, center: np.ndarray) -> np.ndarray:
    """Coefficients of r^2, r^4 and r^6, r in px; zeros where the file has none."""
    text = frame.get("VICON_RADIAL2")
    if text is None:
        if any(frame.get("VICON_RADIAL", "0").replace("0", "").replace(".", "").split()):
            raise FileFormatError(f"{where}it has VICON_RADIAL only, of old Vicon systems; export VICON_RADIAL2.")
        return np.zeros(3)
    kind, _, rest = text.partition(" ")
    values = _numbers(where, ElementTree.Element("x", {"VICON_RADIAL2": rest}), "VICON_RADIAL2", 5)
    if kind != "Vicon3Parameter" or np.abs(values[:2] - center).max() > 0.01:
        raise FileFormatError(f"{where}VICON_RADIAL2 '{text[:60]}' is no Vicon3Parameter about the principal point.")
    return values[2:]


def _fitted(k: np.ndarray, size: tuple[int, int], correction: np.ndarray) -> tuple[np.ndarray, float]:
    """Coefficients of Brown's lens, or of the rational one where Brown's is not near, and the largest error, px."""
    if not correction.any():
        return np.zeros(5), 0.0
    pixels = image_grid(size)
    out = pixels - k[:2, 2]
    r2 = (out**2).sum(axis=1, keepdims=True)
    ideal = out * (1 + r2 * (correction[0] + r2 * (correction[1] + r2 * correction[2])))
    directions = np.hstack([ideal / k[[0, 1], [0, 1]], np.ones_like(r2)])
    common = np.array([k[0, 0], k[1, 1], k[0, 2], k[1, 2]])
    radial = np.array([True, True, False, False, True])
    brown = fit_coefficients(Brown, common, directions, pixels, radial)
    radii = np.linalg.norm(ideal, axis=1) / k[0, 0], np.sqrt(r2[:, 0]) / k[0, 0]
    lenses = [brown, *(_rational(*radii, order) for order in (1, 2, 3))]
    errors = [float(np.abs(brown_pixels(k, lens, directions) - pixels).max()) for lens in lenses]
    best = 0 if errors[0] <= NEAR else int(np.nanargmin(errors))
    return lenses[best], errors[best]


def _rational(ideal: np.ndarray, measured: np.ndarray, order: int) -> np.ndarray:
    """k1, k2, 0, 0, k3, k4, k5, k6, with so many of the last three, and r the ideal radius, of

    measured (1 + k4 r^2 + ...) = ideal (1 + k1 r^2 + ...).

    Linear in the coefficients; weights from the solution before make the error that of the measured radius.
    """
    powers = np.stack([ideal**2, ideal**4, ideal**6], axis=1)
    found, weight = np.zeros(6), np.ones(len(ideal))
    for _ in range(6):
        design = np.hstack([ideal[:, None] * powers, -measured[:, None] * powers[:, :order]]) * weight[:, None]
        found[: 3 + order] = np.linalg.lstsq(design, (measured - ideal) * weight, rcond=None)[0]
        weight = 1 / np.maximum(1 + powers @ found[3:], 1e-3)
    return np.array([*found[:2], 0.0, 0.0, *found[2:]])


def _vicon(camera: CameraEntry) -> tuple[np.ndarray, float]:
    """The correction of a radial lens, and by how many px it is off at most.

    Raises:
        UsageError: the lens is no radial one, or the correction is off by more than `LARGEST`.
    """
    values = np.zeros(8)
    given = opencv_coefficients(TITLE, camera, 8)
    values[: len(given)] = given
    if not values.any():
        return np.zeros(3), 0.0
    k = np.array(camera.K)
    ideal = image_grid(camera.size) - k[:2, 2]
    directions = np.hstack([ideal / k[[0, 1], [0, 1]], np.ones((len(ideal), 1))])
    measured = brown_pixels(k, values, directions) - k[:2, 2]
    r2 = (measured**2).sum(axis=1, keepdims=True)
    scale = max(float(np.sqrt(r2.max())), 1.0)
    design = np.stack([(measured * (r2 / scale**2) ** power).ravel() for power in (1, 2, 3)], axis=1)
    found = np.linalg.lstsq(design, (ideal - measured).ravel(), rcond=None)[0]
    off = float(np.abs(design @ found - (ideal - measured).ravel()).max())
    if values[2:4].any() or not off <= LARGEST:
        raise no_place(TITLE, camera)
    return found / scale ** np.array([2, 4, 6]), off


def _lost(saved: SavedCalibration) -> list[str]:
    return _note(
        f"{TITLE}: Brown's lenses were fitted by Vicon's", max(_vicon(camera)[1] for camera in saved.entries())
    )


def _write(saved: SavedCalibration, path: Path) -> Mapping[str, bytes]:
    root = ElementTree.Element("Cameras", {"SOURCE": "jaxpoint", "VERSION": "2.0"})
    for number, camera in enumerate(saved.entries(), start=1):
        _element(root, number, camera)
    ElementTree.indent(root)
    return {"cameras.xcp": ElementTree.tostring(root, "utf-8", xml_declaration=True)}


def _element(root: ElementTree.Element, number: int, camera: CameraEntry) -> None:
    k, correction = np.array(camera.K), _vicon(camera)[0]
    about = {
        "NAME": camera.name,
        "DEVICEID": str(number),
        "USERID": str(number),
        "PIXEL_ASPECT_RATIO": _text([k[0, 0] / k[1, 1]]),
        "SENSOR_SIZE": f"{camera.size[0]} {camera.size[1]}",
    }
    w, *axis = quaternion_of(pose_of(camera)[0])
    pose = {
        "FOCAL_LENGTH": _text([k[0, 0]]),
        "FRAME": "0",
        "ORIENTATION": _text([*axis, w]),
        "POSITION": _text((1000.0 * centre_of(camera)).tolist()),
        "PRINCIPAL_POINT": _text([k[0, 2], k[1, 2]]),
        "VICON_RADIAL2": "Vicon3Parameter " + _text([k[0, 2], k[1, 2], *correction.tolist()]),
        "WORLD_ERROR": "0.0",
    }
    frames = ElementTree.SubElement(ElementTree.SubElement(root, "Camera", about), "KeyFrames")
    ElementTree.SubElement(frames, "KeyFrame", pose)


def _text(values: list[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


FORMAT = CalibrationFormat(
    name="vicon",
    title=TITLE,
    patterns=("*.xcp",),
    recognise=lambda path, head: re.search(r"<Cameras\b", head) is not None and "<Camera " in head,
    holds=Holds(lenses="pinhole; radial ones by a fit", unit="mm", poses="position, camera from world (x y z w)"),
    read=_read,
    write=_write,
    more_losses=_lost,
)
