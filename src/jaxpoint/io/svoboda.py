"""Folders of Svoboda's multi-camera self-calibration toolbox, and of the programs that took over its files.

`points.dat` (3C x F): rows u, v, 1 of each camera. `IdMat.dat` (C x F): 1 where the camera saw the light. `Res.dat`
(C x 2): width and height. Optional: `camera_order.txt` (one name a line), `*.rad` (one file a camera, known lens) and
`original_cam_centers.dat` or `Cst.dat` (C x 3). Svoboda, Martinec, Pajdla 2005.
"""

from __future__ import annotations

import logging
import re
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Float

from jaxpoint.camera.rig import CameraRig
from jaxpoint.errors import FileFormatError
from jaxpoint.io.files import StrPath, natural_key, read_text
from jaxpoint.io.track_formats.track_format import TrackFormat
from jaxpoint.tracks import Tracks

logger = logging.getLogger(__name__)


def read_svoboda(folder: StrPath, one_based: bool = False) -> Tracks:
    """Tracks from `points.dat`, `IdMat.dat` and `Res.dat`.

    A camera sees the light where `IdMat.dat` says 1 and the pixel is not NaN. Cameras are named by
    `camera_order.txt` where there is one, else cam_0, cam_1, ...

    Args:
        folder: holds the three files, plain or with Octave's text header.
        one_based: the pixels count from 1, as Matlab's do; 1 is subtracted.

    Raises:
        FileFormatError: a file is missing, cut off, holds something else, or the files disagree on their counts.
    """
    folder = Path(folder)
    points = read_matrix(folder / "points.dat")
    seen = read_matrix(folder / "IdMat.dat")
    sizes = read_matrix(folder / "Res.dat")
    cameras, frames = seen.shape
    if points.shape != (3 * cameras, frames):
        raise FileFormatError(
            f"{folder / 'points.dat'} is {points.shape[0]} x {points.shape[1]}, but IdMat.dat is {cameras} x {frames} "
            f"and asks for {3 * cameras} x {frames} (rows u, v, 1 of each camera); take all files of one run."
        )
    if sizes.shape != (cameras, 2):
        raise FileFormatError(
            f"{folder / 'Res.dat'} is {sizes.shape[0]} x {sizes.shape[1]}, but {cameras} cameras need "
            f"{cameras} rows of width and height."
        )
    _check_sizes(folder / "Res.dat", sizes)
    visible = _visibility(folder, points, seen)
    pixels = points.reshape(cameras, 3, frames)[:, :2].transpose(2, 0, 1) - float(one_based)
    pixels = np.where(visible[..., None], pixels, np.nan)
    return Tracks.from_pixels(pixels, sizes.astype(int), visible, names=_camera_names(folder, cameras))


def _check_sizes(path: Path, sizes: Float[np.ndarray, "C 2"]) -> None:
    wrong = ~np.isfinite(sizes) | (sizes <= 0) | (sizes != np.round(sizes))
    if wrong.any():
        camera = int(np.argwhere(wrong)[0, 0])
        raise FileFormatError(
            f"{path}, row {camera + 1}: {sizes[camera].tolist()} is not a width and height; give whole pixels."
        )


def _visibility(folder: Path, points: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(F, C): IdMat says 1 and the pixel is a number."""
    if not np.isin(seen, (0, 1)).all():
        camera, frame = np.argwhere(~np.isin(seen, (0, 1)))[0]
        raise FileFormatError(
            f"{folder / 'IdMat.dat'}, row {camera + 1}, column {frame + 1}: {seen[camera, frame]} is neither 0 nor 1."
        )
    cameras, frames = seen.shape
    triples = points.reshape(cameras, 3, frames)
    claimed = seen == 1
    visible = claimed & ~np.isnan(triples).any(axis=1)
    bad = visible & (np.isinf(triples).any(axis=1) | (triples[:, 2] != 1))
    if bad.any():
        camera, frame = np.argwhere(bad)[0]
        raise FileFormatError(
            f"{folder / 'points.dat'}, camera {camera + 1}, column {frame + 1}: {triples[camera, :, frame].tolist()} "
            "is not u, v, 1; each camera needs three rows, with NaN where it did not see the light."
        )
    if (missing := int((claimed & ~visible).sum())) > 0:
        logger.warning("%s: %d pixels are NaN where IdMat.dat says visible; taken as hidden.", folder, missing)
    return visible.T


def _camera_names(folder: Path, cameras: int) -> tuple[str, ...]:
    path = folder / "camera_order.txt"
    if not path.exists():
        return ()
    names = tuple(line.strip() for line in read_text(path).splitlines() if line.strip())
    if len(names) != cameras or len(set(names)) != cameras:
        raise FileFormatError(
            f"{path} must hold {cameras} different names, one a line, not {len(names)} ({len(set(names))} different)."
        )
    return names


def read_matrix(path: StrPath) -> Float[np.ndarray, "rows columns"]:
    """A matrix of numbers written as text, plain or by Octave; NaN, NA and Inf are read as such.

    Raises:
        FileFormatError: no file, no numbers, a non-finite value, or rows of unequal length (a cut-off file).
    """
    expected: dict[str, int] = {}
    rows: list[list[float]] = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        line = line.strip()
        if line.startswith(("#", "%")):
            if match := re.match(r"[#%]\s*(rows|columns)\s*:\s*(\d+)", line):
                expected[match[1]] = int(match[2])
            continue
        try:
            values = [float(token if token != "NA" else "nan") for token in line.replace(",", " ").split()]
        except ValueError:
            raise FileFormatError(f"{path}, line {number}: '{line[:40]}' is not only numbers.") from None
        if values and rows and len(values) != len(rows[0]):
            raise FileFormatError(
                f"{path}, line {number}: {len(values)} values where the lines before have {len(rows[0])}; "
                "the file is cut off, write it again."
            )
        if values:
            rows.append(values)
    if not rows:
        raise FileFormatError(f"{path} holds no numbers; write it again.")
    matrix = np.array(rows)
    header = (expected.get("rows", matrix.shape[0]), expected.get("columns", matrix.shape[1]))
    if matrix.shape != header:
        raise FileFormatError(
            f"{path} holds {matrix.shape[0]} x {matrix.shape[1]} numbers, but its header says "
            f"{header[0]} x {header[1]}; the file is cut off, write it again."
        )
    return matrix


def read_rad_folder(
    folder: StrPath, image_sizes: np.ndarray, names: tuple[str, ...] = (), one_based: bool = False
) -> CameraRig:
    """The known lenses of a folder's `*.rad` files, as a rig whose poses are all the identity.

    Each file holds `K11 = ...` to `K33 = ...` (px) and `kc1 = ...` to `kc4 = ...` (k1, k2, p1, p2).

    Args:
        folder: its `*.rad` files, sorted with cam2 before cam10, belong to the cameras in order.
        image_sizes: (C, 2) width and height, px.
        names: of the cameras.
        one_based: the principal points count pixels from 1.

    Raises:
        FileFormatError: not one file a camera, a missing entry, or a skewed K.
    """
    sizes = np.asarray(image_sizes)
    paths = sorted(Path(folder).glob("*.rad"), key=lambda path: natural_key(path.name))
    if len(paths) != len(sizes):
        raise FileFormatError(f"{folder} holds {len(paths)} .rad files for {len(sizes)} cameras; give one a camera.")
    lenses = [read_rad(path) for path in paths]
    count = len(lenses)
    with jax.enable_x64(True):
        return CameraRig.from_parameters(
            focal=np.array([[k[0, 0], k[1, 1]] for k, _ in lenses]),
            center=np.array([k[:2, 2] for k, _ in lenses]) - float(one_based),
            distortion=np.array([kc for _, kc in lenses]),
            rotation=np.tile(np.eye(3), (count, 1, 1)),
            translation=np.zeros((count, 3)),
            image_sizes=sizes,
            names=names,
        )


def read_rad(path: Path) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "5"]]:
    """K (px) and the distortion k1, k2, p1, p2, 0 of one `.rad` file.

    Raises:
        FileFormatError: a number is missing, or K is skewed.
    """
    entries: dict[str, float] = {}
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        match = re.fullmatch(r"\s*(\w+)\s*=\s*(\S+?);?\s*", line)
        if match:
            try:
                entries[match[1]] = float(match[2])
            except ValueError:
                raise FileFormatError(f"{path}, line {number}: {match[2]} is not a number.") from None
    wanted = [f"K{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)] + ["kc1", "kc2", "kc3", "kc4"]
    missing = [name for name in wanted if not np.isfinite(entries.get(name, np.nan))]
    if missing:
        raise FileFormatError(f"{path} has no number for {missing[0]}; it needs K11 to K33 and kc1 to kc4.")
    k = np.array([entries[name] for name in wanted[:9]]).reshape(3, 3)
    if abs(k[0, 1]) > 1e-6 * k[0, 0] or k[0, 0] <= 0 or k[1, 1] <= 0:
        raise FileFormatError(f"{path}: K11 {k[0, 0]}, K22 {k[1, 1]}, K12 {k[0, 1]}; focal lengths > 0, no skew.")
    return k, np.array([entries[name] for name in wanted[9:]] + [0.0])


TRACK_FORMAT = TrackFormat(
    "svoboda",
    "a folder of Svoboda's toolbox",
    lambda path, head: path.is_dir() and (path / "points.dat").exists(),
    lambda request: read_svoboda(request.path, request.one_based),
)
