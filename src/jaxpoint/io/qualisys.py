"""Calibrations of Qualisys Track Manager (`*.qca.txt`, which holds XML), as in the recordings of Pose2Sim.

Each `<camera serial=... viewrotation=...>` has `<fov_video left top right bottom>` (px), `<transform x y z r11..r33>`
(mm and a rotation) and `<intrinsic>` (focal lengths and centre in 1/64 px, radialDistortion1..3,
tangentalDistortion1..2). In Qualisys' camera axes y points up and z backwards:
x_camera = diag(1, -1, -1) R (x_world - position).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import jax
import numpy as np
from jaxtyping import Float

from jaxpoint.camera.rig import CameraRig
from jaxpoint.errors import FileFormatError
from jaxpoint.io.files import StrPath, read_text

SUBPIXELS = 64.0  # units of the intrinsics in a pixel
AXES = np.diag([1.0, -1.0, -1.0])  # from Qualisys' camera axes to x right, y down, z forward
INTRINSIC = ("focalLengthU", "focalLengthV", "centerPointU", "centerPointV")
# OpenCV's order
DISTORTION = (
    "radialDistortion1", "radialDistortion2", "tangentalDistortion1", "tangentalDistortion2", "radialDistortion3",
)  # fmt: skip
ROTATION = tuple(f"r{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3))


def read_qualisys(path: StrPath) -> CameraRig:
    """The cameras of a Qualisys calibration, positions in m, named by their serial numbers.

    Pixels are those of the video field of view (`fov_video`), from 0 at its top-left corner.

    Raises:
        FileFormatError: it is no such file, a number is missing, or a view is rotated (`viewrotation` not 0).
    """
    path = Path(path)
    try:
        root = ElementTree.fromstring(read_text(path))
    except ElementTree.ParseError as error:
        raise FileFormatError(f"{path}: {error}; it is not the XML of a Qualisys calibration.") from None
    cameras = root.findall("cameras/camera")
    if not cameras:
        raise FileFormatError(f"{path} holds 0 cameras; a Qualisys calibration has <cameras><camera ...>.")
    names = [camera.get("serial", "") for camera in cameras]
    for camera, name in zip(cameras, names):
        if (turned := camera.get("viewrotation", "0")) != "0":
            raise FileFormatError(
                f"{path}: the view of camera '{name}' is rotated by {turned} degrees; export it upright."
            )
    part = _parts(path, cameras, names)
    fov = part("fov_video", ("left", "top", "right", "bottom"))
    lens = part("intrinsic", INTRINSIC) / SUBPIXELS
    rotation = AXES @ part("transform", ROTATION).reshape(-1, 3, 3)
    position = part("transform", ("x", "y", "z")) / 1000.0
    with jax.enable_x64(True):
        return CameraRig.from_parameters(
            focal=lens[:, :2],
            center=lens[:, 2:] - fov[:, :2],
            distortion=part("intrinsic", DISTORTION),
            rotation=rotation,
            translation=-np.einsum("cij,cj->ci", rotation, position),
            image_sizes=(fov[:, 2:] - fov[:, :2] + 1).astype(int),
            names=names,
        )


def _parts(
    path: Path, cameras: list[ElementTree.Element], names: list[str]
) -> Callable[[str, tuple[str, ...]], Float[np.ndarray, "C N"]]:
    """Reads the same attributes of every camera, one row each."""

    def row(camera: ElementTree.Element, name: str, tag: str, attributes: tuple[str, ...]) -> list[float]:
        element = camera.find(tag)
        values = []
        for attribute in attributes:
            text = None if element is None else element.get(attribute)
            try:
                value = float(text or "nan")
            except ValueError:
                value = np.nan
            if not np.isfinite(value):
                raise FileFormatError(
                    f"{path}: camera '{name}' has no number for {attribute} in <{tag}>; export it anew."
                )
            values.append(value)
        return values

    return lambda tag, attributes: np.array([row(c, n, tag, attributes) for c, n in zip(cameras, names)])
