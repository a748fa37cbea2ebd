"""The pose of a flat target from one camera whose lens is known: the homography of its plane.

Hartley and Zisserman 2004, section 4.1 and 8.1; Zhang 2000. The adjustment refines it.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.calibration.eliminated import pose_values
from jaxpoint.calibration.recording import Recording, RigState
from jaxpoint.calibration.target_blocks import TargetRows
from jaxpoint.camera.lens import AbstractLens
from jaxpoint.camera.parameters import FOCAL, lens_parameters

LEAST_POINTS = 4
AHEAD = 0.1  # of a unit direction along the middle one: rays farther off it are left out of a homography
FLAT = 1e-6  # thickness over width


def planar_pose(
    recording: Recording, state: RigState, owned: TargetRows, rows: np.ndarray
) -> Float[np.ndarray, "12"] | None:
    """The pose of a target in one frame from the camera that saw most of it; None where no camera saw enough.

    Args:
        rows: (K,) of the recording, where its points stand; -1 where there is none.
    """
    if np.abs(owned.shape[:, 2]).max() > FLAT * np.abs(owned.shape).max():
        return None
    seen = (rows >= 0)[:, None] & recording.visible[rows]
    camera = int(seen.sum(axis=0).argmax())
    own = seen[:, camera]
    if own.sum() < LEAST_POINTS:
        return None
    directions, valid = rays(state, camera, recording.pixels[rows[own], camera])
    cam_from_target = pose_from_rays(owned.shape[own][valid, :2], directions[valid])
    if cam_from_target is None:
        return None
    rotation, translation = state.rotation[camera], state.cameras[camera, 3:6]
    turn, shift = cam_from_target
    return pose_values((rotation.T @ turn)[None], (rotation.T @ (shift - translation))[None])[0]


def pose_from_rays(
    flat: Float[np.ndarray, "K 2"], directions: Float[np.ndarray, "K 3"]
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]] | None:
    """Rotation and translation of a plane z = 0 whose points are seen in these directions, also beyond 90 degrees.

    The homography is taken in an image plane across the middle direction, so that the camera's axis does not matter.
    None where too few points are within reach, or all are on a line.
    """
    if len(flat) < LEAST_POINTS:
        return None
    middle = directions.sum(axis=0)
    middle = middle / max(np.linalg.norm(middle), 1e-12)
    turned = turn_to_axis(middle)
    local = directions @ turned.T
    ahead = local[:, 2] > AHEAD
    flat, local = flat[ahead], local[ahead]
    if len(flat) < LEAST_POINTS or np.linalg.matrix_rank(flat - flat.mean(axis=0), tol=1e-3 * np.ptp(flat)) < 2:
        return None
    rotation, translation = from_homography(homography(flat, local[:, :2] / local[:, 2:]))
    return turned.T @ rotation, turned.T @ translation


def turn_to_axis(direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """The smallest rotation that brings a unit direction onto the z axis."""
    x, y, z = direction
    if z < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    cross = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    return np.eye(3) + cross + cross @ cross / (1 + z)


def flipped_pose(
    rotation: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """The other pose of a plane under which a far or small one looks nearly the same: mirrored in depth."""
    sight = translation / max(np.linalg.norm(translation), 1e-12)
    mirror = np.eye(3) - 2.0 * np.outer(sight, sight)
    return mirror @ rotation @ np.diag([1.0, 1.0, -1.0]), translation


def rays(
    state: RigState, camera: int, pixels: Float[np.ndarray, "K 2"]
) -> tuple[Float[np.ndarray, "K 3"], Bool[np.ndarray, " K"]]:
    """Unit directions in a camera's frame, and whether its lens has them; padded to few lengths."""
    padded = np.zeros((max(1 << max(len(pixels) - 1, 0).bit_length(), 16), 2))
    padded[: len(pixels)] = pixels
    parameters = np.array(lens_parameters(state.cameras[camera, FOCAL:], np))
    directions, valid = _rays(state.lens, parameters, padded)
    return np.asarray(directions)[: len(pixels)], np.asarray(valid)[: len(pixels)]


def _rays(lens: type[AbstractLens], parameters: np.ndarray, pixels: np.ndarray):
    return _unproject(lens(jnp.asarray(parameters)), jnp.asarray(pixels))  # pyright: ignore[reportCallIssue]


@jax.jit
def _unproject(lens: AbstractLens, pixels):
    return lens.unproject(pixels)


def homography(source: Float[np.ndarray, "K 2"], target: Float[np.ndarray, "K 2"]) -> Float[np.ndarray, "3 3"]:
    """H with `target` ~ H `source`, by the normalised direct linear transform."""
    normalised, maps = [], []
    for points in (source, target):
        middle = points.mean(axis=0)
        scale = np.sqrt(2.0 / max(((points - middle) ** 2).sum(axis=1).mean(), 1e-300))
        maps.append(np.array([[scale, 0, -scale * middle[0]], [0, scale, -scale * middle[1]], [0, 0, 1]]))
        normalised.append(scale * (points - middle))
    (x, y), (u, v) = normalised[0].T, normalised[1].T
    one, zero = np.ones_like(x), np.zeros_like(x)
    above = np.stack([x, y, one, zero, zero, zero, -u * x, -u * y, -u], axis=1)
    below = np.stack([zero, zero, zero, x, y, one, -v * x, -v * y, -v], axis=1)
    upper = np.linalg.qr(np.concatenate([above, below]), mode="r")  # small, so that no large U is computed
    found = np.linalg.svd(upper)[2][-1].reshape(3, 3)
    return np.linalg.inv(maps[1]) @ found @ maps[0]


def from_homography(found: Float[np.ndarray, "3 3"]) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """Rotation and translation of a plane z = 0 from its homography into normalised image coordinates."""
    found = found / np.sqrt(np.linalg.norm(found[:, 0]) * np.linalg.norm(found[:, 1]))
    found = found * np.sign(found[2, 2])  # the plane lies ahead
    turn = np.stack([found[:, 0], found[:, 1], np.cross(found[:, 0], found[:, 1])], axis=1)
    u, _, vt = np.linalg.svd(turn)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt, found[:, 2]
