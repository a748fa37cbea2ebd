"""Known lenses in files: what a camera's image does, wherever it stands; poses are not needed.

- our `calibration.json`, anipose's and caliscope's `.toml`, with or without poses; Qualisys' `*.qca.txt`;
- Kalibr's `camchain.yaml` (pinhole, radtan);
- OpenCV's FileStorage `.yml`/`.yaml` of one camera (`camera_matrix`, `distortion_coefficients`, `image_width`,
  `image_height`), or a folder of such files, each named by its camera.

Only Brown's model with k1, k2, p1, p2, k3 is read; any other is refused by name.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxpoint.camera.rig import CameraRig
from jaxpoint.errors import FileFormatError
from jaxpoint.io.files import StrPath, natural_key, read_text

YAML = (".yml", ".yaml")
COEFFICIENTS = 5  # k1, k2, p1, p2, k3
COUNTS = (0, 1, 2, 4, 5, 8, 12, 14)  # of coefficients that a file may hold
FIVE = "only Brown's k1, k2, p1, p2, k3 are known: calibrate that lens anew with these five, or calibrate without it"


@dataclass(frozen=True)
class Lens:
    """One camera's lens."""

    name: str
    size: tuple[int, int]  # px, width and height
    focal: tuple[float, float]  # px
    center: tuple[float, float]  # px
    distortion: tuple[float, ...]  # k1, k2, p1, p2, k3


def brown_coefficients(where: str, given: Any) -> Float[np.ndarray, "5"]:
    """k1, k2, p1, p2, k3 from 0 to 14 coefficients in OpenCV's order.

    Args:
        where: begins the message, as "FILE, [cam_0]: ".
        given: the coefficients as they stand in a file.

    Raises:
        FileFormatError: they are no numbers, or those of a model with more terms.
    """
    try:
        values = np.array(given, dtype=float)
    except (TypeError, ValueError):
        values = np.full(1, np.nan)
    if not np.isfinite(values).all() or np.squeeze(values).ndim > 1 or values.size not in COUNTS:
        raise FileFormatError(f"{where}the distortion must be 4 or 5 finite numbers, k1, k2, p1, p2 and k3.")
    values = values.ravel()
    if (values[COEFFICIENTS:] != 0).any():
        more = ", ".join(f"{value:.3g}" for value in values[COEFFICIENTS:])
        raise FileFormatError(
            f"{where}the lens has {values.size} coefficients, as OpenCV's rational model (from k4 on {more}); {FIVE}."
        )
    found = np.zeros(COEFFICIENTS)
    found[: min(values.size, COEFFICIENTS)] = values[:COEFFICIENTS]
    return found


def refuse_other_model(where: str, model: str) -> None:
    """Refuse a lens model by its name.

    Raises:
        FileFormatError: it is not Brown's.
    """
    if model.lower() not in ("radtan", "plumb_bob", "brown", "none", "opencv", "pinhole", ""):
        fish = "a fish-eye lens" if model.lower() in ("equidistant", "fisheye", "kannala_brandt") else "this lens"
        raise FileFormatError(f"{where}{fish} cannot be read (model '{model}'); {FIVE}.")


def rig_of_lenses(path: StrPath, lenses: Sequence[Lens]) -> CameraRig:
    """The lenses as a rig whose poses are all the identity.

    Raises:
        FileFormatError: there is none, or two have one name.
    """
    names = tuple(lens.name for lens in lenses)
    if not names or len(set(names)) != len(names):
        raise FileFormatError(f"{path} holds the cameras {list(names)}; it needs one or more with different names.")
    with jax.enable_x64(True):
        return CameraRig.from_parameters(
            focal=np.array([lens.focal for lens in lenses]),
            center=np.array([lens.center for lens in lenses]),
            distortion=np.array([lens.distortion for lens in lenses]),
            rotation=np.tile(np.eye(3), (len(lenses), 1, 1)),
            translation=np.zeros((len(lenses), 3)),
            image_sizes=np.array([lens.size for lens in lenses]),
            names=names,
        )


def read_yaml_lenses(path: StrPath) -> CameraRig:
    """The lenses of a YAML file or of a folder of them: Kalibr's camera chain, or OpenCV's FileStorage.

    Raises:
        FileFormatError: it is neither, a value is missing or wrong, or a lens is of another model than Brown's.
    """
    path = Path(path)
    if not path.is_dir():
        return rig_of_lenses(path, _lenses(path))
    files = sorted((file for file in path.iterdir() if file.suffix.lower() in YAML), key=lambda f: natural_key(f.name))
    return rig_of_lenses(path, [lens for file in files for lens in _lenses(file)])


def _lenses(path: Path) -> list[Lens]:
    text = read_text(path)
    blocks = re.split(r"^([\w-]+):[ \t]*$", text, flags=re.MULTILINE)
    chain = [(name, block) for name, block in zip(blocks[1::2], blocks[2::2]) if "intrinsics:" in block]
    if chain:
        return [_kalibr_lens(f"{path}, {name}: ", name, block) for name, block in chain]
    return [_opencv_lens(path, text)]


def _opencv_lens(path: Path, text: str) -> Lens:
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
    refuse_other_model(where, model)
    return lens_of(where, path.stem, (size[0], size[1]), matrix.reshape(3, 3), coefficients)


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


def lens_of(where: str, name: str, size: tuple[int, int], matrix: np.ndarray, coefficients: Any) -> Lens:
    """A lens from its matrix K and its coefficients.

    Raises:
        FileFormatError: K is none, or the coefficients are not Brown's.
    """
    k = np.asarray(matrix, float)
    if not np.isfinite(k).all() or min(k[0, 0], k[1, 1]) <= 0 or (k[[0, 1, 2, 2], [1, 0, 0, 1]] != 0).any():
        raise FileFormatError(f"{where}K must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], not {k.tolist()}.")
    five = brown_coefficients(where, coefficients)
    return Lens(name, size, (k[0, 0], k[1, 1]), (k[0, 2], k[1, 2]), tuple(five.tolist()))


def _kalibr_lens(where: str, name: str, block: str) -> Lens:
    models = [re.search(rf"^\s*{key}:\s*(\S+)", block, re.MULTILINE) for key in ("camera_model", "distortion_model")]
    for model in filter(None, models):
        refuse_other_model(where, model[1].strip("'\""))
    fx, fy, cx, cy = _numbers(where, block, "intrinsics", 4)
    width, height = _numbers(where, block, "resolution", 2)
    bent = models[1] is not None and models[1][1] != "none"
    coefficients = _numbers(where, block, "distortion_coeffs", None) if bent else []
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    return lens_of(where, name, (int(width), int(height)), matrix, coefficients)


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


def scaled(rig: CameraRig, sizes: np.ndarray) -> CameraRig:
    """The lenses for images of other sizes (C, 2) of the same shape; pixel (0, 0) is the centre of the first one."""
    by = np.asarray(sizes, float) / np.asarray(rig.image_sizes, float)
    with jax.enable_x64(True):
        focal, center = np.asarray(rig.cameras.focal) * by, (np.asarray(rig.cameras.center) + 0.5) * by - 0.5
        return eqx.tree_at(
            lambda rig: (rig.cameras.focal, rig.cameras.center, rig.image_sizes),
            rig,
            (jnp.asarray(focal), jnp.asarray(center), jnp.asarray(sizes, dtype=jnp.int32)),
        )
