"""The recording pose2sim_single as experiments and tests take it: cameras in pixels of its videos, and labels.

Two things lie between the Qualisys calibration and the videos. The videos of cam01 and cam02 are the 1088 x 1920 images
scaled to 1080 x 1906, with bars of 7 rows above and below. And the images of all four are moved against the
calibration, by up to 20 px: places of the still room, seen by eye in the calibration's own images, miss their own
triangulation by 10.4 px in the median; with one shift a camera, fitted to them alone, by 0.6 px.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import least_squares

from jaxpoint.camera.rig import CameraRig
from jaxpoint.io.files import StrPath, read_table
from jaxpoint.io.formats.qualisys_xml import read_qualisys
from jaxpoint.triangulation import Triangulation, triangulate

LABELS = Path(__file__).parents[1] / "tests" / "data"
JOINTS = ("right_elbow", "right_wrist", "left_elbow", "left_wrist", "cap")
STILL_WIDTH, STILL_HEIGHT = 1088, 1920
BARRED = ("cam01", "cam02")  # whose videos are scaled
BARRED_SIZE, BAR = (1080, 1906), 7  # px, of the picture, and of the bars above and below it
BLOCK = 128  # things located at once, so that one program does for all
SHIFT_SIGMA = 30.0  # px, only holds what the places leave free: where the room lies


@dataclass(frozen=True)
class Labels:
    """What was seen by eye: N things in C cameras."""

    names: tuple[str, ...]  # of the things
    pixels: Float[np.ndarray, "N C 2"]  # px; 0 where not seen
    seen: Bool[np.ndarray, "N C"]


def read_labels(path: StrPath = LABELS / "pose2sim_labels.csv") -> dict[tuple[int, str], Labels]:
    """Labelled joints of the videos, by frame and joint; each holds one thing."""
    rows = read_table(path, ("frame", "camera", "joint", "x", "y", "visible"))
    found: dict[tuple[int, str], Labels] = {}
    for row in rows:
        key = (row.integer("frame"), row.text("joint"))
        labels = found.setdefault(key, Labels((key[1],), np.zeros((1, 4, 2)), np.zeros((1, 4), bool)))
        if row.integer("visible"):
            camera = int(row.text("camera")[-2:]) - 1
            labels.pixels[0, camera] = row.number("x"), row.number("y")
            labels.seen[0, camera] = True
    return found


def read_places(path: StrPath = LABELS / "pose2sim_static.csv") -> Labels:
    """Places of the still room, in pixels of the calibration's images."""
    rows = read_table(path, ("point", "camera", "x", "y"))
    names = tuple(dict.fromkeys(row.text("point") for row in rows))
    pixels, seen = np.zeros((len(names), 4, 2)), np.zeros((len(names), 4), bool)
    for row in rows:
        place = names.index(row.text("point")), int(row.text("camera")[-2:]) - 1
        pixels[place] = row.number("x"), row.number("y")
        seen[place] = True
    return Labels(names, pixels, seen)


def still_rig(folder: Path) -> CameraRig:
    """The cameras as calibrated, in pixels of the calibration's images (1088 x 1920)."""
    return read_qualisys(folder / "calibration" / "Calib.qca.txt")


def video_rig(folder: Path) -> CameraRig:
    """The cameras in pixels of the videos."""
    rig = still_rig(folder)
    rig = moved(rig, fitted_shifts(rig, read_places()))
    scaled = np.array([name in BARRED for name in rig.names])[:, None]
    scale = np.where(scaled, np.array(BARRED_SIZE) / (STILL_WIDTH, STILL_HEIGHT), 1.0)
    sizes = np.where(scaled, (BARRED_SIZE[0], STILL_HEIGHT), (STILL_WIDTH, STILL_HEIGHT))
    return moved(rig, np.where(scaled, (0.0, BAR), 0.0), scale, sizes)


def moved(
    rig: CameraRig,
    shift: Float[np.ndarray, "C 2"],
    scale: Float[np.ndarray, "C 2"] | float = 1.0,
    sizes: np.ndarray | None = None,
) -> CameraRig:
    """The same cameras when each image is first scaled about its corner, then moved, px."""
    with jax.enable_x64(True):
        focal = rig.cameras.focal * scale
        center = (rig.cameras.center + 0.5) * scale - 0.5 + shift
        whole = rig.image_sizes if sizes is None else jnp.asarray(sizes, dtype=rig.image_sizes.dtype)
        return eqx.tree_at(
            lambda r: (r.cameras.lens, r.image_sizes),
            rig,
            (type(rig.cameras.lens).of(focal, center, rig.cameras.distortion), whole),
        )


def fitted_shifts(rig: CameraRig, places: Labels) -> Float[np.ndarray, "C 2"]:
    """By how much each camera's images are moved against its calibration, px: what makes still places agree."""

    def residuals(shifts: Float[np.ndarray, " 2C"]) -> Float[np.ndarray, " R"]:
        errors = missed(rig, Labels(places.names, places.pixels - shifts.reshape(-1, 2), places.seen))
        return np.concatenate([errors[places.seen].ravel(), shifts / SHIFT_SIGMA])

    return least_squares(residuals, np.zeros(2 * len(rig)), loss="soft_l1").x.reshape(-1, 2)


def located(rig: CameraRig, labels: Labels) -> Triangulation:
    """All things of the labels triangulated, from all cameras that saw them."""
    empty = (-len(labels.seen) % BLOCK, len(rig))
    pixels = np.concatenate([labels.pixels, np.zeros((*empty, 2))])
    seen = np.concatenate([labels.seen, np.zeros(empty, bool)])
    with jax.enable_x64(True):
        found = triangulate(rig, pixels, seen, covariance=False)
        return jax.tree.map(lambda leaf: leaf[: len(labels.seen)], found)


def missed(rig: CameraRig, labels: Labels) -> Float[np.ndarray, "N C 2"]:
    """By how much each camera misses the triangulated things, px; 0 where not seen."""
    return np.asarray(located(rig, labels).residuals)
