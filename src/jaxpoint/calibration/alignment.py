"""From the solver's frame to the metric room: x_room = s R x_solver + t (thesis 5.3.4).

Eq. 5.8 of the thesis speaks of similar matrices; what is meant, and used here, is a similarity transformation found by
Umeyama's method (Umeyama 1991, "Least-squares estimation of transformation parameters between two point patterns").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxpoint.calibration.result import Calibration
from jaxpoint.calibration.upright import CameraAxes, check_centres, check_upright
from jaxpoint.camera.rig import CameraRig
from jaxpoint.errors import InsufficientDataError
from jaxpoint.geometry import rotation as so3
from jaxpoint.geometry.arrays import AnyArray, as_float
from jaxpoint.geometry.pose import Similarity

DUPLICATE = 1e-6  # landmarks nearer than this fraction of their extent are the same
COLLINEAR = 0.01  # smallest width of the landmarks, as a fraction of their extent
CLEAR_HAND = 2.5  # how many times the residual of one hand must exceed the other's to tell them apart
SUSPICIOUS = 4.0  # a leave-one-out error this many times the median is worth a warning


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["similarity", "residual_mm", "leave_one_out_mm", "rms_mm", "max_mm"],
    meta_fields=["method", "names", "handedness_verified", "warnings"],
)
@dataclass(frozen=True)
class Alignment:
    """How a calibration was brought into the room, and how well the known points agree."""

    similarity: Similarity  # room (m) from solver
    method: str  # "landmarks", "camera centres" or "floor"
    names: tuple[str, ...]  # of the N known points
    residual_mm: Float[np.ndarray, " N"]  # distance of each from where it was measured
    leave_one_out_mm: tuple[float | None, ...]  # the same when it did not take part; None where the rest is too few
    rms_mm: float
    max_mm: float
    handedness_verified: bool  # False where a mirrored room would have fitted as well
    warnings: tuple[str, ...] = ()


def umeyama(
    source: Float[AnyArray, "N 3"],
    target: Float[AnyArray, "N 3"],
    weights: Float[AnyArray, " N"] | None = None,
    allow_mirror: bool = False,
) -> Similarity:
    """The similarity that brings `source` closest to `target` in the (weighted) least-squares sense.

    Pure, jitted, differentiable (also where the points are coplanar or symmetric) and vmappable. Meaningful for three
    or more points that are not collinear; `align_to_landmarks` checks that.

    Args:
        weights: not negative; 0 leaves a point out. For standard deviations give 1 / sigma^2.
        allow_mirror: permit a rotation with determinant -1 where that fits better.

    Raises:
        ValueError: the points are float64 and JAX would cut them to float32.
    """
    source, target = as_float(source), as_float(target)
    weights = jnp.ones_like(source[:, 0]) if weights is None else as_float(weights)
    return _umeyama(source, target, weights, allow_mirror)


@partial(jax.jit, static_argnames="allow_mirror")
def _umeyama(
    source: Float[Array, "N 3"], target: Float[Array, "N 3"], weights: Float[Array, " N"], allow_mirror: bool
) -> Similarity:
    w = (weights / weights.sum())[:, None]
    source_mean, target_mean = (w * source).sum(axis=0), (w * target).sum(axis=0)
    centred = source - source_mean[None]
    covariance = (target - target_mean[None]).T @ (w * centred)
    rotation = so3.nearest_rotation(covariance)
    if allow_mirror:
        mirror = -so3.nearest_rotation(-covariance)
        rotation = jnp.where((mirror * covariance).sum() > (rotation * covariance).sum(), mirror, rotation)
    scale = (rotation * covariance).sum() / (w * centred**2).sum()
    return Similarity(scale, rotation, target_mean - scale * (rotation @ source_mean))


def align_to_landmarks(
    points: Float[AnyArray, "N 3"],
    landmarks: Float[AnyArray, "N 3"],
    sigmas: Float[AnyArray, " N"] | None = None,
    *,
    names: Sequence[str] = (),
    camera_centres: Float[AnyArray, "C 3"] | None = None,
    camera_rotations: Float[AnyArray, "C 3 3"] | None = None,
    method: str = "landmarks",
) -> Alignment:
    """The similarity that brings `points` of the solver's frame onto known `landmarks` of the room.

    With four or more landmarks that are not coplanar a fit that wants a mirror image is refused. With coplanar ones
    both hands fit equally well, and `handedness_verified` is False. The cameras must stand upright and above the floor
    (z > 0, or the lowest landmark), see `check_upright`.

    Args:
        points: solver's unit.
        landmarks: m.
        sigmas: standard deviation of each landmark's coordinates, m; weighs them.
        names: of the landmarks, for messages.
        camera_centres: of the rig, solver's unit.
        camera_rotations: from the solver's frame to the cameras; they tell where up is.

    Raises:
        InsufficientDataError: fewer than three landmarks, two at one place, all on a line, mirrored, or cameras below
            the floor or not upright, with the turn that mends it.
        ValueError: shapes do not fit, a number is not finite, or a sigma is not positive.
    """
    points, landmarks = np.asarray(points, np.float64), np.asarray(landmarks, np.float64)
    names = tuple(names) or tuple(f"landmark_{i}" for i in range(len(points)))
    sigmas = None if sigmas is None else np.asarray(sigmas, np.float64)
    _check_shapes(points, landmarks, sigmas, names)
    _check_spread(landmarks, names, "known landmarks")
    _check_spread(points, names, "reconstructed landmarks")
    weights = np.ones(len(points)) if sigmas is None else (sigmas.min() / sigmas) ** 2
    with jax.enable_x64(True):
        similarity = umeyama(points, landmarks, weights)
        residuals = np.linalg.norm(np.asarray(similarity @ points) - landmarks, axis=1)
        verified, warnings = _judge_hand(points, landmarks, weights, residuals)
        if camera_centres is not None:
            warnings += _check_floor(similarity, camera_centres, camera_rotations, landmarks, verified)
        left_out = _leave_one_out(points, landmarks, weights)
    warnings += _suspicious(names, left_out, residuals, sigmas)
    return Alignment(
        similarity,
        method,
        names,
        1e3 * residuals,
        tuple(None if error is None else 1e3 * error for error in left_out),
        float(1e3 * np.sqrt((residuals**2).mean())),
        float(1e3 * residuals.max()),
        verified,
        warnings,
    )


def align_to_camera_centres(
    centres: Float[AnyArray, "N 3"],
    known: Float[AnyArray, "N 3"],
    sigmas: Float[AnyArray, " N"] | None = None,
    *,
    names: Sequence[str] = (),
    camera_rotations: Float[AnyArray, "C 3 3"] | None = None,
    all_centres: Float[AnyArray, "C 3"] | None = None,
) -> Alignment:
    """As `align_to_landmarks`, with measured places of the cameras (m) for landmarks.

    Args:
        centres: solver's unit.
        known: m.
        sigmas: standard deviation of each known coordinate, m; weighs them.
        names: of these cameras, for messages.
        camera_rotations: from the solver's frame to the cameras, of all of the rig.
        all_centres: of all of the rig, solver's unit; those of `centres` where not given.

    Raises:
        InsufficientDataError: fewer than three cameras, two at one place, all on a line, mirrored, or most of them
            below the floor or not upright.
        ValueError: shapes do not fit, a number is not finite, or a sigma is not positive.
    """
    return align_to_landmarks(
        centres,
        known,
        sigmas,
        names=names,
        camera_centres=centres if all_centres is None else all_centres,
        camera_rotations=camera_rotations,
        method="camera centres",
    )


def align_to_floor(
    floor: Float[AnyArray, "N 3"],
    camera_centres: Float[AnyArray, "C 3"],
    length_m: float,
    *,
    ends: Float[AnyArray, "2 3"] | None = None,
    names: Sequence[str] = (),
) -> Alignment:
    """The room whose floor goes through three or more points laid on it, and whose scale comes from one length.

    z points up, towards the cameras; the first point is the origin, x points to the second. The residuals are heights
    above the floor's plane. A floor has no hand of its own, so `handedness_verified` is False.

    Args:
        floor: solver's unit.
        camera_centres: of the rig, solver's unit.
        length_m: distance between the `ends`, m.
        ends: of the measured length, solver's unit; the first two points of the floor where not given.
        names: of the points on the floor, for messages.

    Raises:
        InsufficientDataError: fewer than three points, two at one place, all on a line, ends at one place, or a
            camera below the floor.
        ValueError: shapes do not fit, a number is not finite, or the length is not positive.
    """
    floor, centres = np.asarray(floor, np.float64), np.asarray(camera_centres, np.float64)
    names = tuple(names) or tuple(f"floor_{i}" for i in range(len(floor)))
    _check_shapes(floor, floor, None, names)
    _check_spread(floor, names, "points on the floor")
    ends = floor[:2] if ends is None else np.asarray(ends, np.float64)
    measured = float(np.linalg.norm(ends[1] - ends[0]))
    if not (np.isfinite(length_m) and length_m > 0):
        raise ValueError(f"The length is {length_m} m; give a positive one.")
    if not measured > 0:
        raise InsufficientDataError("Both ends of the length lie at one place; take two points that differ.")
    up, origin = _floor_plane(floor, centres)
    along = floor[1] - floor[0] - up * (up @ (floor[1] - floor[0]))
    x = along / np.linalg.norm(along)
    rotation = np.stack([x, np.cross(up, x), up])
    scale = length_m / measured
    heights = scale * (floor - origin) @ up
    with jax.enable_x64(True):
        similarity = Similarity(jnp.asarray(scale), jnp.asarray(rotation), jnp.asarray(-scale * rotation @ origin))
    return Alignment(
        similarity,
        "floor",
        names,
        1e3 * np.abs(heights),
        _floor_left_out(scale * floor),
        float(1e3 * np.sqrt((heights**2).mean())),
        float(1e3 * np.abs(heights).max()),
        False,
        ("The handedness was not verified: points on a floor have none. Check one landmark off the floor.",),
    )


def apply_alignment(calibration: Calibration, alignment: Alignment) -> Calibration:
    """The calibration in the room: P' = P S^-1, points S X, unit m; every pixel stays where it was.

    The covariance of the cameras is mapped along, the alignment taken as exact; one that is not in the order of
    `Camera.perturbed` is dropped, with a warning in the alignment. The scale is the alignment's from then on, not that
    of targets.
    """
    similarity, covariance = alignment.similarity, calibration.camera_covariance
    with jax.enable_x64(True):
        rig = calibration.rig.transformed(similarity)
        points = np.asarray(similarity @ np.asarray(calibration.points, np.float64))
        if covariance is not None:
            size = rig.camera_size * len(rig)
            if covariance.shape == (size, size):
                covariance = transformed_covariance(covariance, rig, similarity)
            else:
                reason = f"The camera covariance is {covariance.shape}, not {(size, size)}; it was dropped."
                covariance, alignment = None, replace(alignment, warnings=(*alignment.warnings, reason))
    return replace(
        calibration,
        rig=rig,
        points=np.where(calibration.point_valid[:, None], points, 0.0),
        unit="m",
        alignment=alignment,
        camera_covariance=covariance,
        hold=None,
    )


def transformed_covariance(
    covariance: Float[np.ndarray, "D D"], aligned: CameraRig, similarity: Similarity
) -> Float[np.ndarray, "D D"]:
    """With R = exp(w) R0 the room's t' = s t - exp(w) R0' t_S changes by s dt + [R0' t_S]x w; w and the lens stay."""
    rotations = np.asarray(aligned.cameras.cam_from_world.rotation)
    size = aligned.camera_size
    jacobian = np.zeros((len(rotations), size, len(rotations), size))
    for camera, rotation in enumerate(rotations):
        block = np.eye(size)
        block[3:6, 3:6] *= float(similarity.scale)
        block[3:6, :3] = np.asarray(so3.skew(rotation @ np.asarray(similarity.translation)))
        jacobian[camera, :, camera] = block
    jacobian = jacobian.reshape(covariance.shape)
    return jacobian @ covariance @ jacobian.T


def _check_shapes(points: np.ndarray, landmarks: np.ndarray, sigmas: np.ndarray | None, names: tuple[str, ...]) -> None:
    if points.ndim != 2 or points.shape[1] != 3 or points.shape != landmarks.shape or len(names) != len(points):
        raise ValueError(f"Points {points.shape}, landmarks {landmarks.shape} and {len(names)} names must be N x 3.")
    for values in (points, landmarks):
        if not np.isfinite(values).all():
            bad = int(np.argwhere(~np.isfinite(values))[0, 0])
            raise ValueError(f"Landmark '{names[bad]}' is {values[bad].tolist()}; give finite numbers.")
    if sigmas is not None and (sigmas.shape != (len(points),) or not (np.isfinite(sigmas) & (sigmas > 0)).all()):
        raise ValueError(f"{len(points)} landmarks need as many positive sigmas, not {sigmas.tolist()}.")
    if len(points) < 3:
        raise InsufficientDataError(
            f"An alignment needs three points that are not on a line, but there are {len(points)}; measure more."
        )


def _check_spread(points: np.ndarray, names: tuple[str, ...], what: str) -> None:
    extent, width, _ = _spread(points)
    distances = np.linalg.norm(points[:, None] - points[None], axis=-1)
    np.fill_diagonal(distances, np.inf)
    first, second = np.unravel_index(distances.argmin(), distances.shape)
    if distances[first, second] <= DUPLICATE * extent:
        raise InsufficientDataError(
            f"Of the {what}, '{names[first]}' and '{names[second]}' lie at one place "
            f"({distances[first, second]:.3g} apart); keep one of them."
        )
    if width < COLLINEAR * extent:
        raise InsufficientDataError(
            f"The {len(points)} {what} lie on a line (width {width / extent:.2%} of their extent, 1 % is needed); "
            "add one off that line."
        )


def _spread(points: np.ndarray) -> np.ndarray:
    """Rms extent of the points along their three principal axes, largest first."""
    return np.linalg.svd(points - points.mean(axis=0), compute_uv=False) / np.sqrt(len(points))


def _judge_hand(
    points: np.ndarray, landmarks: np.ndarray, weights: np.ndarray, residuals: np.ndarray
) -> tuple[bool, tuple[str, ...]]:
    """Whether the landmarks tell right from left, and a warning where they do not; refuses a mirror image."""
    mirrored = points * [1, 1, -1]
    fit = umeyama(mirrored, landmarks, weights)
    rms = np.sqrt((residuals**2).mean())
    rms_mirrored = np.sqrt((np.linalg.norm(np.asarray(fit @ mirrored) - landmarks, axis=1) ** 2).mean())
    better, worse = sorted((rms, rms_mirrored))
    if worse < max(CLEAR_HAND * better, DUPLICATE * _spread(landmarks)[0]):
        return False, (
            f"The handedness was not verified: the landmarks fit a mirrored room (rms {1e3 * rms_mirrored:.1f} mm) "
            f"about as well (rms {1e3 * rms:.1f} mm). Add one well off the plane of the others.",
        )
    if rms_mirrored < rms:
        raise InsufficientDataError(
            f"The landmarks fit a mirror image (rms {1e3 * rms_mirrored:.1f} mm) better than the room "
            f"(rms {1e3 * rms:.1f} mm): their axes are left-handed, or names are swapped. Write them "
            "right-handed with z up: (x, y, z) -> (x, -y, z) where z points up already; or say whose axes they are: "
            "--world unity (left-handed, y up), --world unreal (left-handed, z up)."
        )
    return True, ()


def _check_floor(
    similarity: Similarity, centres: AnyArray, rotations: AnyArray | None, landmarks: np.ndarray, verified: bool
) -> tuple[str, ...]:
    placed = np.asarray(similarity @ np.asarray(centres))
    if rotations is None:
        return check_centres(placed, landmarks)
    turned = np.asarray(rotations) @ np.asarray(similarity.rotation).T
    return check_upright(CameraAxes.of(placed, turned), landmarks, right_handed=verified)


def _leave_one_out(points: np.ndarray, landmarks: np.ndarray, weights: np.ndarray) -> tuple[float | None, ...]:
    """Error of each landmark (m) under the alignment of the others; None where those are too few or on a line."""
    count = len(points)
    if count < 4:
        return (None,) * count
    others = weights[None] * ~np.eye(count, dtype=bool)
    fits = jax.vmap(umeyama, in_axes=(None, None, 0))(points, landmarks, others)
    scale, rotation, translation = (np.asarray(part) for part in (fits.scale, fits.rotation, fits.translation))
    predicted = scale[:, None] * np.einsum("nij,nj->ni", rotation, points) + translation
    errors = np.linalg.norm(predicted - landmarks, axis=1)
    return tuple(float(errors[i]) if _has_width(np.delete(landmarks, i, axis=0)) else None for i in range(count))


def _has_width(points: np.ndarray) -> bool:
    extent, width, _ = _spread(points)
    return bool(width >= COLLINEAR * extent)


def _suspicious(
    names: tuple[str, ...], left_out: tuple[float | None, ...], residuals: np.ndarray, sigmas: np.ndarray | None
) -> tuple[str, ...]:
    warnings = []
    known = [error for error in left_out if error is not None]
    for name, error in zip(names, left_out):
        if error is not None and len(known) > 4 and error > SUSPICIOUS * float(np.median(known)):
            warnings.append(
                f"Landmark '{name}' is {1e3 * error:.0f} mm from where the others put it "
                f"(median {1e3 * float(np.median(known)):.0f} mm); measure it again."
            )
    if sigmas is not None:
        ratio = float(np.sqrt((residuals**2 / (3 * sigmas**2)).mean()))
        if ratio > 3:
            warnings.append(f"The residuals are {ratio:.1f} times what sigma_m allows; check the landmarks.")
    return tuple(warnings)


def _floor_plane(floor: np.ndarray, centres: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normal towards the cameras, and the first point's foot on the plane."""
    middle = floor.mean(axis=0)
    up = np.linalg.svd(floor - middle)[2][2]
    heights = (centres - middle) @ up
    if np.median(heights) < 0:
        up, heights = -up, -heights
    if (heights <= 0).any():
        below = int((heights <= 0).sum())
        raise InsufficientDataError(
            f"{below} of {len(centres)} cameras lie below the floor through these points; check which points lie on it."
        )
    return up, floor[0] - up * (up @ (floor[0] - middle))


def _floor_left_out(floor: np.ndarray) -> tuple[float | None, ...]:
    """Height (mm) of each point (m) over the plane of the others; None where those are too few or on a line."""
    heights: list[float | None] = []
    for i in range(len(floor)):
        others = np.delete(floor, i, axis=0)
        middle = others.mean(axis=0)
        enough = len(others) >= 3 and _has_width(others)
        normal = np.linalg.svd(others - middle)[2][2]
        heights.append(1e3 * abs(float((floor[i] - middle) @ normal)) if enough else None)
    return tuple(heights)
