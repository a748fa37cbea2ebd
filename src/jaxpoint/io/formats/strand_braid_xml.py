"""strand-braid's and flydra's calibration XML: metres, one `<single_camera_calibration>` a camera.

`<calibration_matrix>` is P (rows between semicolons), `<non_linear_parameters>` the lens that undistorts pixels before
P: fc1, fc2, cc1, cc2, k1, k2, p1, p2, alpha_c. After an alignment that is no similarity P is only projective, and then
there is no such camera; water is refused by name.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from jaxpoint.errors import FileFormatError
from jaxpoint.io.formats.calibration_format import CalibrationFormat, Holds, Request
from jaxpoint.io.formats.fields import camera_matrix, opencv_coefficients, pose_of, read_image_size
from jaxpoint.io.formats.projection_cameras import Misfit, camera_of_projection, mirror_notes, notes_of
from jaxpoint.io.formats.storage_tree import parse_xml
from jaxpoint.io.rig_entries import CameraEntry, SavedCalibration

TITLE = "strand-braid's calibration XML"
LENS = ("fc1", "fc2", "cc1", "cc2", "k1", "k2", "p1", "p2")


def _read(request: Request) -> SavedCalibration:
    path = request.only.path
    root = parse_xml(path, request.only.text)
    if (water := root.findtext("water")) is not None:
        raise FileFormatError(
            f"{path} is of cameras that look into water (refractive index {water.strip()}), which no lens here is; "
            "calibrate them in air."
        )
    cameras = root.findall("single_camera_calibration")
    if not cameras:
        raise FileFormatError(f"{path} holds no <single_camera_calibration>.")
    found = [_camera(path, i, camera) for i, camera in enumerate(cameras)]
    notes = notes_of(f"{path}: one lens was fitted to each camera's P and lens", [off for _, off in found])
    cameras = [camera for camera, _ in found]
    notes += mirror_notes(str(path), cameras)
    return request.saved(cameras, notes=notes)


def _camera(path: Path, i: int, element: ElementTree.Element) -> tuple[CameraEntry, Misfit]:
    name = (element.findtext("cam_id") or f"cam_{i}").strip()
    where = f"{path}, camera '{name}': "
    size = read_image_size(where, _numbers(where, element, "resolution", 2).tolist())
    projection = _numbers(where, element, "calibration_matrix", 12).reshape(3, 4)
    fx, fy, cx, cy, k1, k2, p1, p2 = (
        float(_numbers(where, element, f"non_linear_parameters/{key}", 1)[0]) for key in LENS
    )
    skew = element.findtext("non_linear_parameters/alpha_c")
    if skew is not None and float(_numbers(where, element, "non_linear_parameters/alpha_c", 1)[0]) != 0:
        raise FileFormatError(f"{where}its lens is skewed (alpha_c {skew.strip()[:12]}), which no lens here is.")
    lens = camera_matrix(fx, fy, cx, cy)
    return camera_of_projection(where, name, size, projection, lens, np.array([k1, k2, p1, p2, 0.0]))


def _numbers(where: str, element: ElementTree.Element, key: str, count: int) -> np.ndarray:
    text = element.findtext(key) or ""
    try:
        values = np.array([float(word) for word in re.split(r"[\s;]+", text.strip(" ;\n\t")) if word])
    except ValueError:
        values = np.zeros(0)
    if values.size != count or not np.isfinite(values).all():
        raise FileFormatError(
            f"{where}<{key.rsplit('/')[-1]}> must hold {count} finite numbers, not '{text.strip()[:40]}'."
        )
    return values


def _write(saved: SavedCalibration, path: Path) -> Mapping[str, bytes]:
    root = ElementTree.Element("multi_camera_reconstructor")
    for camera in saved.entries():
        _element(root, camera)
    ElementTree.indent(root)
    return {"calibration.xml": ElementTree.tostring(root, "utf-8")}


def _element(root: ElementTree.Element, camera: CameraEntry) -> None:
    k, (rotation, translation) = np.array(camera.K), pose_of(camera)
    projection = k @ np.hstack([rotation, translation[:, None]])
    element = ElementTree.SubElement(root, "single_camera_calibration")
    values = [k[0, 0], k[1, 1], k[0, 2], k[1, 2], *opencv_coefficients(TITLE, camera, 4)]
    texts = {
        "cam_id": camera.name,
        "calibration_matrix": "; ".join(" ".join(map(repr, row)) for row in projection.tolist()),
        "resolution": f"{camera.size[0]} {camera.size[1]}",
    }
    for tag, text in texts.items():
        ElementTree.SubElement(element, tag).text = text
    lens = ElementTree.SubElement(element, "non_linear_parameters")
    for tag, value in zip((*LENS, "alpha_c"), [*values, 0.0]):
        ElementTree.SubElement(lens, tag).text = repr(float(value))


FORMAT = CalibrationFormat(
    name="strand-braid",
    title=TITLE,
    patterns=("*.xml",),
    recognise=lambda path, head: "<single_camera_calibration" in head or "<multi_camera_reconstructor" in head,
    holds=Holds(lenses="Brown without k3, pinhole", unit="m", poses="P, camera from world"),
    read=_read,
    write=_write,
)
