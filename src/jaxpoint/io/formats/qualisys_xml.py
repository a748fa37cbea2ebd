"""Calibrations of Qualisys Track Manager (`*.qca.txt`, which holds XML), as in the recordings of Pose2Sim.

Each `<camera serial=... viewrotation=...>` has `<fov_video left top right bottom>` (px), `<transform x y z r11..r33>`
(mm and a rotation) and `<intrinsic>` (focal lengths and centre in 1/64 px, radialDistortion1..3,
tangentalDistortion1..2). In Qualisys' camera axes y points up and z backwards:
x_camera = diag(1, -1, -1) R (x_world - position).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from jaxpoint.camera.rig import CameraRig
from jaxpoint.errors import FileFormatError
from jaxpoint.io.files import StrPath
from jaxpoint.io.formats.calibration_format import CalibrationFormat, Holds, Request, SourceFile
from jaxpoint.io.formats.fields import (
    camera_entry,
    camera_matrix,
    centre_of,
    opencv_coefficients,
    pose_of,
    read_image_size,
)
from jaxpoint.io.formats.storage_tree import parse_xml
from jaxpoint.io.rig_entries import CameraEntry, SavedCalibration

TITLE = "Qualisys' calibration (.qca.txt)"
SUBPIXELS = 64.0  # units of the intrinsics in a pixel
AXES = np.diag([1.0, -1.0, -1.0])  # from Qualisys' camera axes to x right, y down, z forward
INTRINSIC = ("focalLengthU", "focalLengthV", "centerPointU", "centerPointV")
# OpenCV's order
DISTORTION = (
    "radialDistortion1", "radialDistortion2", "tangentalDistortion1", "tangentalDistortion2", "radialDistortion3",
)  # fmt: skip
ROTATION = tuple(f"r{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3))
BORDERS = ("left", "top", "right", "bottom")


def read_qualisys(path: StrPath) -> CameraRig:
    """The cameras of a Qualisys calibration, positions in m, named by their serial numbers.

    Pixels are those of the video field of view (`fov_video`), from 0 at its top-left corner.

    Raises:
        FileFormatError: it is no such file, a number is missing, or a view is rotated (`viewrotation` not 0).
    """
    return _read(Request((SourceFile(Path(path)),), TITLE)).rig


def _read(request: Request) -> SavedCalibration:
    path = request.only.path
    root = parse_xml(path, request.only.text, "the XML of a Qualisys calibration")
    cameras = root.findall("cameras/camera")
    if not cameras:
        raise FileFormatError(f"{path} holds 0 cameras; a Qualisys calibration has <cameras><camera ...>.")
    return request.saved([_camera(path, camera) for camera in cameras], unit="mm")


def _camera(path: Path, camera: ElementTree.Element) -> CameraEntry:
    name = camera.get("serial", "")
    if (turned := camera.get("viewrotation", "0")) != "0":
        raise FileFormatError(f"{path}: the view of camera '{name}' is rotated by {turned} degrees; export it upright.")
    where = f"{path}: camera '{name}' "
    left, top, right, bottom = _attributes(where, camera, "fov_video", BORDERS)
    fx, fy, cx, cy = _attributes(where, camera, "intrinsic", INTRINSIC) / SUBPIXELS
    rotation = AXES @ _attributes(where, camera, "transform", ROTATION).reshape(3, 3)
    position = _attributes(where, camera, "transform", ("x", "y", "z"))
    return camera_entry(
        f"{path}, camera '{name}': ",
        name,
        read_image_size(f"{path}, camera '{name}': ", [right - left + 1, bottom - top + 1]),
        camera_matrix(fx, fy, cx - left, cy - top),
        _attributes(where, camera, "intrinsic", DISTORTION),
        "",
        (rotation, -rotation @ position),
    )


def _attributes(where: str, camera: ElementTree.Element, tag: str, names: tuple[str, ...]) -> np.ndarray:
    element, values = camera.find(tag), []
    for name in names:
        try:
            values.append(float("nan" if element is None else element.get(name) or "nan"))
        except ValueError:
            values.append(np.nan)
        if not np.isfinite(values[-1]):
            raise FileFormatError(f"{where}has no number for {name} in <{tag}>; export it anew.")
    return np.array(values)


def _write(saved: SavedCalibration, path: Path) -> Mapping[str, bytes]:
    root = ElementTree.Element("calibration", {"type": "regular", "source": "jaxpoint"})
    cameras = ElementTree.SubElement(root, "cameras")
    for camera in saved.entries():
        _element(cameras, camera)
    ElementTree.indent(root)
    return {"calibration.qca.txt": ElementTree.tostring(root, "utf-8", xml_declaration=True)}


def _element(cameras: ElementTree.Element, camera: CameraEntry) -> None:
    k, values = np.array(camera.K), opencv_coefficients(TITLE, camera, 5)
    lens = SUBPIXELS * np.array([k[0, 0], k[1, 1], k[0, 2], k[1, 2]])
    borders = (0, 0, camera.size[0] - 1, camera.size[1] - 1)
    about = {"active": "1", "serial": camera.name, "viewrotation": "0", "model": "none"}
    element = ElementTree.SubElement(cameras, "camera", about)
    fov: dict[str, str] = dict(zip(BORDERS, map(str, borders)))
    for tag in ("fov_marker", "fov_marker_max", "fov_video", "fov_video_max"):
        ElementTree.SubElement(element, tag, fov)
    rotation = AXES @ pose_of(camera)[0]
    place = dict(zip(("x", "y", "z"), map(_text, 1000.0 * centre_of(camera))))
    ElementTree.SubElement(element, "transform", place | dict(zip(ROTATION, map(_text, rotation.ravel()))))
    sensor = {
        "sensorMinU": "0.0",
        "sensorMaxU": _text(SUBPIXELS * borders[2]),
        "sensorMinV": "0.0",
        "sensorMaxV": _text(SUBPIXELS * borders[3]),
        "skew": "0.0",
    }
    bending = dict(zip(DISTORTION, map(_text, [*values, *[0.0] * (5 - len(values))])))
    ElementTree.SubElement(element, "intrinsic", dict(zip(INTRINSIC, map(_text, lens))) | sensor | bending)


def _text(value: float) -> str:
    return repr(float(value))


FORMAT = CalibrationFormat(
    name="qualisys",
    title=TITLE,
    patterns=("*.qca.txt",),
    recognise=lambda path, head: re.search(r"<calibration\b", head) is not None and "<camera" in head,
    holds=Holds(
        lenses="Brown, pinhole",
        unit="mm",
        poses="position, camera from world, y up and z back",
        pixels="centre, 1/64 px",
    ),
    read=_read,
    write=_write,
)
