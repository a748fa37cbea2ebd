"""Is the calibration right? Lengths measured in the room, frames held out, one half against the other (thesis 5.4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.calibration.alignment import umeyama
from jaxpoint.calibration.expected import moved_by_cameras
from jaxpoint.calibration.result import Calibration
from jaxpoint.camera.rig import CameraRig
from jaxpoint.errors import InsufficientDataError, UsageError
from jaxpoint.geometry import rotation as so3
from jaxpoint.landmarks import CLICK_SIGMA_PX, LandmarkPixels, Lengths, triangulate_clicks
from jaxpoint.tracks import Tracks
from jaxpoint.triangulation import triangulate


@dataclass(frozen=True)
class LengthValidation:
    """Lengths measured by hand against the same ones triangulated; L lengths."""

    names: tuple[str, ...]
    length_m: Float[np.ndarray, " L"]  # measured by hand
    triangulated_m: Float[np.ndarray, " L"]
    error_mm: Float[np.ndarray, " L"]  # triangulated minus measured
    sigma_mm: Float[np.ndarray, " L"]  # one standard deviation from the clicks and, where known, the cameras
    independent: Bool[np.ndarray, " L"]  # False where both ends took part in the alignment
    mean_mm: float  # of the absolute errors of the independent lengths
    max_mm: float
    expected_mean_mm: float  # mean absolute error that `sigma_mm` lets expect
    count: int  # independent lengths
    warnings: tuple[str, ...] = ()


class ErrorStatistics(NamedTuple):
    """Lengths of two-dimensional residuals, px."""

    count: int
    mean_px: float
    median_px: float
    rms_px: float
    per_camera_mean_px: tuple[float | None, ...]  # None where a camera has none


@dataclass(frozen=True)
class HeldOutValidation:
    """Frames that did not take part in the calibration, triangulated anew."""

    frames: int  # seen by two or more cameras
    reprojection: ErrorStatistics  # against the point of all cameras
    prediction: ErrorStatistics | None  # against the point of the other cameras; None without frames of three views


@dataclass(frozen=True)
class CalibrationDifference:
    """One calibration against another of the same room, the second brought onto the first by a similarity."""

    unit: str  # of the lengths: "mm", or "arbitrary" where the first calibration was not aligned
    names: tuple[str, ...]
    centre: Float[np.ndarray, " C"]  # distance between the camera centres
    rotation_deg: Float[np.ndarray, " C"]
    focal_px: Float[np.ndarray, " C"]  # second minus first, mean of fx and fy
    point_rms: float  # distance between the points of the light
    pixel_rms: float  # px, between the two projections of the first one's points
    per_camera_pixel_rms: tuple[float | None, ...]


def validate_lengths(
    calibration: Calibration, lengths: Lengths, clicks: LandmarkPixels, sigma_px: float = CLICK_SIGMA_PX
) -> LengthValidation:
    """Triangulate the ends of measured lengths and compare.

    Lengths both of whose ends took part in the alignment are shown but not counted.

    Args:
        calibration: aligned, in metres.
        clicks: the ends, clicked in two or more images each.
        sigma_px: standard deviation of a clicked coordinate, from which `sigma_mm` follows.

    Raises:
        UsageError: the calibration is not in metres.
        InsufficientDataError: an end was clicked in fewer than two images, or no length is independent.
    """
    if calibration.unit != "m":
        raise UsageError(
            f"The calibration's unit is {calibration.unit}, lengths in metres cannot be compared; bring it into the "
            "room first, by `jaxpoint align`."
        )
    used = set(calibration.alignment.names) if calibration.alignment is not None else set()
    independent = np.array([not used.issuperset(ends) for ends in lengths.ends])
    if not independent.any():
        raise InsufficientDataError(
            f"All {len(lengths.names)} lengths end at points used for the alignment; measure some between other points."
        )
    distance, sigma, valid = _triangulated_lengths(calibration, lengths, clicks, sigma_px)
    error_mm, sigma_mm = 1e3 * (distance - lengths.length_m), 1e3 * sigma
    warnings = [
        f"Length '{name}': an end lies behind a camera or is seen under less than 2 degrees; click it in more images."
        for name in np.array(lengths.names)[~valid]
    ]
    if not independent.all():
        warnings.append(f"{int((~independent).sum())} lengths end at points of the alignment and are not counted.")
    return LengthValidation(
        lengths.names,
        lengths.length_m,
        distance,
        error_mm,
        sigma_mm,
        independent,
        float(np.abs(error_mm[independent]).mean()),
        float(np.abs(error_mm[independent]).max()),
        float(np.sqrt(2 / np.pi) * sigma_mm[independent].mean()),
        int(independent.sum()),
        tuple(warnings),
    )


def _triangulated_lengths(
    calibration: Calibration, lengths: Lengths, clicks: LandmarkPixels, sigma_px: float
) -> tuple[Float[np.ndarray, " L"], Float[np.ndarray, " L"], Bool[np.ndarray, " L"]]:
    """Each length and its standard deviation, m, and whether both ends are seen well enough."""
    names = list(dict.fromkeys(name for ends in lengths.ends for name in ends))
    a, b = np.array([[names.index(name) for name in ends] for ends in lengths.ends]).T
    found = triangulate_clicks(calibration, clicks, names, sigma_px)
    points, covariance, valid = (np.asarray(part) for part in (found.points, found.covariance, found.valid))
    distance = np.linalg.norm(points[b] - points[a], axis=1)
    along = (points[b] - points[a]) / np.where(distance > 0, distance, 1.0)[:, None]
    variance = np.einsum("li,lij,lj->l", along, covariance[a] + covariance[b], along)
    if calibration.camera_covariance is not None:
        visible = clicks.visible[[clicks.names.index(name) for name in names]]
        # Both ends of a length share the cameras' errors, so their covariances alone do not give the length's.
        moved, _ = moved_by_cameras(calibration.rig, points, visible)
        change = np.einsum("li,lid->ld", along, moved[b] - moved[a])
        variance += np.einsum("ld,de,le->l", change, calibration.camera_covariance, change)
    return distance, np.sqrt(variance), valid[a] & valid[b]


def validate_held_out(rig: CameraRig, tracks: Tracks) -> HeldOutValidation:
    """Triangulate frames that did not take part in the calibration, and reproject them.

    `prediction` is the sharper test: each camera's pixel against the point that the other cameras see.

    Raises:
        InsufficientDataError: no frame is seen by two cameras.
        ValueError: the cameras of rig and tracks differ.
    """
    if rig.names != tracks.names:
        raise ValueError(f"The rig has the cameras {list(rig.names)}, the tracks {list(tracks.names)}; select alike.")
    visible = tracks.visible & (tracks.visible.sum(axis=1, keepdims=True) >= 2)
    if not visible.any():
        raise InsufficientDataError(
            f"None of the {tracks.frames} held-out frames is seen by two cameras; take a recording "
            "in which the light is seen by two at once."
        )
    with jax.enable_x64(True):
        found = triangulate(rig, tracks.pixels, visible)
        errors = np.linalg.norm(np.asarray(found.residuals), axis=-1)
        predictable = tracks.visible & (tracks.visible.sum(axis=1, keepdims=True) >= 3)
        predicted = _prediction_errors(rig, tracks.pixels, predictable) if predictable.any() else None
    return HeldOutValidation(
        int(visible.any(axis=1).sum()),
        _statistics(errors, visible),
        None if predicted is None else _statistics(predicted, predictable),
    )


def _prediction_errors(rig: CameraRig, pixels: np.ndarray, visible: np.ndarray) -> Float[np.ndarray, "F C"]:
    """Distance of each pixel (px) from where the other cameras' point projects."""
    errors = np.zeros(visible.shape)
    for camera in range(visible.shape[1]):
        others = visible.copy()
        others[:, camera] = False
        points = triangulate(rig, pixels, others).points
        projected = np.asarray(rig.project(points))[:, camera]
        errors[:, camera] = np.linalg.norm(projected - pixels[:, camera], axis=-1)
    return errors


def _statistics(errors: Float[np.ndarray, "F C"], mask: Bool[np.ndarray, "F C"]) -> ErrorStatistics:
    values = errors[mask]
    return ErrorStatistics(
        int(mask.sum()),
        float(values.mean()),
        float(np.median(values)),
        float(np.sqrt((values**2).mean())),
        tuple(float(e[m].mean()) if m.any() else None for e, m in zip(errors.T, mask.T)),
    )


def compare_calibrations(first: Calibration, second: Calibration) -> CalibrationDifference:
    """Two calibrations of one room, as from two halves of a recording.

    The second is brought onto the first by its camera centres and by the first one's frames, triangulated in both rigs;
    so the halves need no frame in common.

    Raises:
        ValueError: the cameras differ.
        InsufficientDataError: fewer than three frames of the first have a point in the second rig.
    """
    if first.rig.names != second.rig.names:
        raise ValueError(f"The cameras differ: {list(first.rig.names)} and {list(second.rig.names)}; select alike.")
    with jax.enable_x64(True):
        seen_again = triangulate(second.rig, first.tracks.pixels, first.kept)
        common = first.point_valid & np.asarray(seen_again.valid)
        if common.sum() < 3:
            raise InsufficientDataError(
                f"Only {common.sum()} frames have a point in both rigs, and 3 are needed to compare them; record more, "
                "so that each half suffices for a calibration."
            )
        points, again = np.asarray(first.points)[common], np.asarray(seen_again.points)[common]
        centres = np.asarray(first.rig.positions)
        source = np.concatenate([np.asarray(second.rig.positions), again])
        onto = umeyama(source, np.concatenate([centres, points]))
        rig = second.rig.transformed(onto)
        shift = np.linalg.norm(np.asarray(rig.project(points) - first.rig.project(points)), axis=-1)
        kept = first.kept[common]
        factor, unit = (1e3, "mm") if first.unit == "m" else (1.0, first.unit)
        before, after = (r.cameras.cam_from_world.rotation for r in (first.rig, rig))
        turned = jax.vmap(so3.log)(after @ jnp.swapaxes(before, 1, 2))
        return CalibrationDifference(
            unit,
            first.rig.names,
            factor * np.linalg.norm(np.asarray(rig.positions) - centres, axis=1),
            np.degrees(np.linalg.norm(np.asarray(turned), axis=1)),
            (np.asarray(rig.cameras.focal) - np.asarray(first.rig.cameras.focal)).mean(axis=1),
            factor * float(np.sqrt((np.linalg.norm(np.asarray(onto @ again) - points, axis=1) ** 2).mean())),
            float(np.sqrt((shift[kept] ** 2).mean())),
            tuple(float(np.sqrt((s[k] ** 2).mean())) if k.any() else None for s, k in zip(shift.T, kept.T)),
        )
