"""Cameras from projection matrices P, with a lens that stands about a K of its own.

P = K [R | t] of any scale and sign, from world points to pixels of the undistorted image. DLT, MultiCamSelfCal and
strand-braid store P, and the lens apart; where the two K are one, that is one camera exactly. Where they differ a
little, one camera is fitted to both over the whole image and the error is said; where they differ much, or P is skewed
as by an alignment that is no similarity, there is no such camera, and that is said.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from jaxpoint.errors import FileFormatError
from jaxpoint.io.formats.fields import camera_entry, centre_of, pose_of
from jaxpoint.io.formats.image_grid import brown_pixels, image_grid
from jaxpoint.io.rig_entries import CameraEntry

EXACT = 1e-6  # px
PIXELS = 50  # of a grid over the image that the lens must see
LARGEST = 1.0  # px, root mean square over the image, by which a fitted camera may be off


class Misfit(NamedTuple):
    """How far a camera is off over the image, px."""

    rms_px: float
    most_px: float


def decompose(
    projection: Float[np.ndarray, "3 4"],
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """K (K[2, 2] = 1, positive diagonal), R (det +1) and t of a projection matrix of any scale and sign."""
    projection = projection * np.sign(np.linalg.det(projection[:, :3]))
    turned, upper = np.linalg.qr(np.linalg.inv(projection[:, :3]))
    signs = np.sign(np.diagonal(upper))
    k = np.linalg.inv(upper * signs[:, None])
    return k / k[2, 2], (turned * signs).T, np.linalg.solve(k, projection[:, 3])


def camera_of_projection(
    where: str,
    name: str,
    size: tuple[int, int],
    projection: Float[np.ndarray, "3 4"],
    lens: Float[np.ndarray, "3 3"] | None = None,
    coefficients: Float[np.ndarray, "5"] | None = None,
) -> tuple[CameraEntry, Misfit]:
    """The camera of P and of a lens (its own K, coefficients in OpenCV's order), and how far it is off.

    Raises:
        FileFormatError: P is singular, or no camera with Brown's lens is near it.
    """
    if not np.isfinite(projection).all() or abs(np.linalg.det(_scaled(projection)[:, :3])) < 1e-12:
        raise FileFormatError(f"{where}its projection matrix has no camera centre (it is singular); calibrate it anew.")
    k, rotation, translation = decompose(projection)
    bending = np.zeros(5) if coefficients is None else coefficients
    directions, pixels = _sight(k, lens, bending, size)
    if len(pixels) < PIXELS:
        raise FileFormatError(f"{where}its lens sees hardly any pixel of an image of {size[0]} x {size[1]} px.")
    start = np.array([[k[0, 0], 0, k[0, 2]], [0, k[1, 1], k[1, 2]], [0, 0, 1]])
    turned = np.eye(3)
    off = _misfit(start, bending, directions, pixels)
    if off.most_px > EXACT:
        start, bending, turned = _fitted(start, bending, directions, pixels)
        off = _misfit(start, bending, directions @ turned.T, pixels)
    if not off.rms_px <= LARGEST or min(start[0, 0], start[1, 1]) <= 0:
        raise FileFormatError(
            f"{where}its projection matrix is only projective: no camera with square corners and one lens is nearer to "
            f"it than {off.rms_px:.2g} px (skew {k[0, 1]:.3g} px, focal lengths {k[0, 0]:.5g} and {k[1, 1]:.5g} px); "
            "calibrate the cameras anew, or give the calibration before it was aligned."
        )
    pose = (turned @ rotation, turned @ translation)
    return camera_entry(where, name, size, start, bending, "", pose), off


def notes_of(begin: str, misfits: Sequence[Misfit]) -> list[str]:
    """The sentence that says how far fitted cameras are off; none where all are exact."""
    worst = max(misfits)
    if worst.most_px <= EXACT:
        return []
    return [
        f"{begin}, off by up to {worst.rms_px:.2g} px (root mean square over the image; {worst.most_px:.2g} at most)."
    ]


def mirror_notes(begin: str, cameras: Sequence[CameraEntry]) -> list[str]:
    """The sentence on cameras that look away from where their axes meet, as they do in a mirrored world.

    The sign of P is not known, so that a world whose handedness is wrong, which self-calibration alone may leave, comes
    out as one that lies behind the cameras.
    """
    centres = np.array([centre_of(camera) for camera in cameras])
    axes = np.array([pose_of(camera)[0][2] for camera in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    total = across.sum(axis=0)
    if np.linalg.cond(total) > 1e6:
        return []
    middle = np.linalg.solve(total, np.einsum("cij,cj->i", across, centres))
    behind = np.einsum("ci,ci->c", axes, middle - centres) < 0
    if behind.mean() <= 0.5:
        return []
    return [
        f"{begin}: {int(behind.sum())} of {len(cameras)} cameras look away from where their axes meet: they look "
        "outwards, or the world of this file is a mirror image (then align it first, with the program that wrote it)."
    ]


def _scaled(projection: np.ndarray) -> np.ndarray:
    return projection / max(np.abs(projection[:, :3]).max(), 1e-300)


def _sight(
    k: np.ndarray, lens: np.ndarray | None, bending: np.ndarray, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Directions all over the image, by K of P, and the pixels where the lens about its own K sees them."""
    pixels = ideal = image_grid(size)
    if lens is not None and bending.any():
        straight = cv2.undistortPoints(ideal.reshape(-1, 1, 2), lens, bending).reshape(-1, 2)
        pixels = brown_pixels(lens, bending, _homogeneous(straight))
        ideal = straight * lens[[0, 1], [0, 1]] + lens[:2, 2]
    inside = ((pixels > -1) & (pixels < np.array(size))).all(axis=1)
    directions = np.linalg.solve(k, _homogeneous(ideal).T).T
    return directions[inside] / directions[inside, 2:], pixels[inside]


def _homogeneous(places: np.ndarray) -> np.ndarray:
    return np.hstack([places, np.ones((len(places), 1))])


def _misfit(k: np.ndarray, bending: np.ndarray, directions: np.ndarray, pixels: np.ndarray) -> Misfit:
    off = np.linalg.norm(brown_pixels(k, bending, directions) - pixels, axis=1)
    return Misfit(float(np.sqrt((off**2).mean())), float(off.max()))


def _fitted(
    k: np.ndarray, bending: np.ndarray, directions: np.ndarray, pixels: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """K, Brown's coefficients and a rotation under which the directions are seen where the pixels are."""
    scale = np.array([k[0, 0], k[1, 1], k[0, 0], k[1, 1]])
    plain = not bending.any()

    def parts(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        fx, fy, cx, cy = np.array([k[0, 0], k[1, 1], k[0, 2], k[1, 2]]) + scale * x[:4]
        values = np.zeros(5) if plain else bending + x[4:9]
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), values, np.asarray(cv2.Rodrigues(x[9:])[0])

    def residuals(x: np.ndarray) -> np.ndarray:
        matrix, values, turned = parts(x)
        return (brown_pixels(matrix, values, directions @ turned.T) - pixels).ravel()

    found = least_squares(residuals, np.zeros(12), method="lm", x_scale="jac", max_nfev=400)
    return parts(found.x)
