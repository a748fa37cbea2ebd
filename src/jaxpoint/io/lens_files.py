"""Known lenses in files: what a camera's image does, wherever it stands; poses are not needed.

- our `calibration.json`, anipose's and caliscope's `.toml`, with or without poses; Qualisys' `*.qca.txt`;
- Kalibr's `camchain.yaml` (pinhole; radtan or equidistant);
- OpenCV's FileStorage `.yml`/`.yaml` of one camera (`camera_matrix`, `distortion_coefficients`, `image_width`,
  `image_height`), or a folder of such files, each named by its camera.

Which lens models are known `camera.lenses` says; any other is refused by name.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxpoint.camera.lens import AbstractLens
from jaxpoint.camera.rig import CameraRig
from jaxpoint.errors import FileFormatError
from jaxpoint.io.files import StrPath, natural_key, read_text
from jaxpoint.io.lens_entries import LensEntry, model_of_name, read_coefficients, rig_of_lenses

YAML = (".yml", ".yaml")


def read_yaml_lenses(path: StrPath) -> CameraRig:
    """The lenses of a YAML file or of a folder of them: Kalibr's camera chain, or OpenCV's FileStorage.

    Raises:
        FileFormatError: it is neither, a value is missing or wrong, or a lens is of a model that is not known.
    """
    path = Path(path)
    if not path.is_dir():
        return rig_of_lenses(path, _lenses(path))
    files = sorted((file for file in path.iterdir() if file.suffix.lower() in YAML), key=lambda f: natural_key(f.name))
    return rig_of_lenses(path, [lens for file in files for lens in _lenses(file)])


def _lenses(path: Path) -> list[LensEntry]:
    text = read_text(path)
    blocks = re.split(r"^([\w-]+):[ \t]*$", text, flags=re.MULTILINE)
    chain = [(name, block) for name, block in zip(blocks[1::2], blocks[2::2]) if "intrinsics:" in block]
    if chain:
        return [_kalibr_lens(f"{path}, {name}: ", name, block) for name, block in chain]
    return [_opencv_lens(path, text)]


def _opencv_lens(path: Path, text: str) -> LensEntry:
    where = f"{path}: "
    plain = text if text.lstrip().startswith("%YAML") else f"%YAML:1.0\n---\n{text}"
    try:
        storage = cv2.FileStorage(plain, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        root = storage.root()
        matrix = _matrix(root, ("camera_matrix", "cameraMatrix", "K"))
        coefficients = _matrix(root, ("distortion_coefficients", "distCoeffs", "dist_coeffs", "D"))
        size = [int(root.getNode(name).real()) for name in ("image_width", "image_height")]
        models = [root.getNode(name) for name in ("distortion_model", "camera_model")]
        model = next((node.string() for node in models if node.isString()), "")
        storage.release()
    except (cv2.error, SystemError):
        raise FileFormatError(f"{where}{NO_LENS}") from None
    if matrix is None or matrix.size != 9 or coefficients is None:
        raise FileFormatError(f"{where}{NO_LENS}")
    if min(size) <= 0:
        raise FileFormatError(f"{where}image_width and image_height are missing; add them (px).")
    named = model_of_name(where, model)
    return lens_of(where, path.stem, (size[0], size[1]), matrix.reshape(3, 3), coefficients, named)


NO_LENS = (
    "there is no lens in this YAML file; it needs camera_matrix, distortion_coefficients, image_width, image_height, "
    "as OpenCV writes them, or Kalibr's cam0, cam1, ... with intrinsics."
)


def _matrix(root: Any, names: Sequence[str]) -> np.ndarray | None:
    """The numbers of a matrix as OpenCV writes it, of a plain map with `data` (ROS), or of a list."""
    node = next((root.getNode(name) for name in names if not root.getNode(name).empty()), None)
    if node is not None and node.isMap():
        node = node.getNode("data")
    if node is None or not node.isSeq():
        return None
    return np.array([node.at(i).real() for i in range(node.size())])


def lens_of(
    where: str,
    name: str,
    size: tuple[int, int],
    matrix: np.ndarray,
    coefficients: Any,
    model: type[AbstractLens] | None = None,
) -> LensEntry:
    """A lens from its matrix K and its coefficients.

    Args:
        model: where the file names it; None for OpenCV's pinhole cameras.

    Raises:
        FileFormatError: K is none, or the coefficients are not the model's.
    """
    k = np.asarray(matrix, float)
    if not np.isfinite(k).all() or min(k[0, 0], k[1, 1]) <= 0 or (k[[0, 1, 2, 2], [1, 0, 0, 1]] != 0).any():
        raise FileFormatError(f"{where}K must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], not {k.tolist()}.")
    model, values = read_coefficients(where, coefficients, model)
    return LensEntry(name, size, (k[0, 0], k[1, 1]), (k[0, 2], k[1, 2]), model, tuple(values.tolist()))


def _kalibr_lens(where: str, name: str, block: str) -> LensEntry:
    camera, bending = (
        re.search(rf"^\s*{key}:\s*(\S+)", block, re.MULTILINE) for key in ("camera_model", "distortion_model")
    )
    names = ["" if found is None else found[1].strip("'\"") for found in (camera, bending)]
    model_of_name(where, names[0])
    model = model_of_name(where, names[1])
    fx, fy, cx, cy = _numbers(where, block, "intrinsics", 4)
    width, height = _numbers(where, block, "resolution", 2)
    bent = bending is not None and names[1] != "none"
    coefficients = _numbers(where, block, "distortion_coeffs", None) if bent else []
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    return lens_of(where, name, (int(width), int(height)), matrix, coefficients, model)


def _numbers(where: str, block: str, key: str, count: int | None) -> list[float]:
    found = re.search(rf"^\s*{key}:\s*\[([^\]]*)\]", block, re.MULTILINE)
    try:
        values = [float(part) for part in found[1].split(",") if part.strip()] if found else []
    except ValueError:
        values = []
    if not np.isfinite(values).all() or not values or (count is not None and len(values) != count):
        raise FileFormatError(f"{where}'{key}' must be {count or 'some'} numbers in brackets, as Kalibr writes them.")
    return values


def match_names(wanted: Sequence[str], given: Sequence[str]) -> list[int] | None:
    """Where each wanted camera is among the given; cam_3, cam3 and 3 mean the same. None where one is missing."""
    keys: Mapping[str, int] = {camera_key(name): i for i, name in enumerate(given)}
    if len(keys) != len(given):
        keys = {name: i for i, name in enumerate(given)}
        return [keys[name] for name in wanted] if set(wanted) <= keys.keys() else None
    places = [keys.get(camera_key(name)) for name in wanted]
    found = [place for place in places if place is not None]
    return found if len(found) == len(wanted) == len(set(found)) else None


def camera_key(name: str) -> str:
    """What is the same of names that mean one camera."""
    match = re.fullmatch(r"(?:cam(?:era)?|port)?[_-]?0*(\d+)", name, re.IGNORECASE)
    return match[1] if match else name


def scale_lenses(rig: CameraRig, sizes: np.ndarray) -> CameraRig:
    """The lenses for images of other sizes (C, 2) of the same shape; pixel (0, 0) is the centre of the first one."""
    by = np.asarray(sizes, float) / np.asarray(rig.image_sizes, float)
    with jax.enable_x64(True):
        focal, center = np.asarray(rig.cameras.focal) * by, (np.asarray(rig.cameras.center) + 0.5) * by - 0.5
        lens = type(rig.cameras.lens).of(focal, center, rig.cameras.distortion)
        return eqx.tree_at(
            lambda rig: (rig.cameras.lens, rig.image_sizes), rig, (lens, jnp.asarray(sizes, dtype=jnp.int32))
        )
