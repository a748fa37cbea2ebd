"""How a calibration fits every view of a board, and how well it knows each lens over its image."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Float

from jaxpoint.calibration.result import Calibration
from jaxpoint.camera.camera import POSE_NAMES

POOR, POOR_PX = 2.5, 0.3  # times the median rms of the camera's views, and at least so much: a view to look at
LOST = 0.3  # of a view's corners rejected
BEYOND = 1.25  # of the farthest corner's distance from the principal point: places to hold the board next
APART = 0.01  # of the image's width: boards nearer to each other than this are one view twice
GRID = (16, 12)  # places of the image at which the lens's uncertainty is asked


@dataclass(frozen=True)
class ViewFit:
    """One camera's view of a board in one frame."""

    camera: int
    frame_id: int
    corners: int
    kept: int
    rms_px: float  # of all its corners, rejected or not
    tilt_deg: float  # between the board's normal and the line of sight
    distance_m: float
    middle_px: tuple[float, float]
    poor: bool


def view_fits(calibration: Calibration) -> list[ViewFit]:
    """Of every view of every target, camera by camera."""
    tracks, found = calibration.tracks, []
    pose = calibration.rig.cameras.cam_from_world
    rotations, translations = np.asarray(pose.rotation), np.asarray(pose.translation)
    for number in range(len(tracks.targets)):
        rows = tracks.rows_of_target(number, calibration.point_valid)
        for camera in range(tracks.cameras):
            views = []
            for own in rows:
                own = own[own >= 0]
                own = own[tracks.visible[own, camera]]
                if len(own) < 3:
                    continue
                local = calibration.points[own] @ rotations[camera].T + translations[camera]
                views.append(_fit(calibration, own, camera, local))
            usual = float(np.median([view["rms_px"] for view in views])) if views else 0.0
            for view in views:
                poor = view["rms_px"] > max(POOR * usual, POOR_PX) or view["kept"] < (1 - LOST) * view["corners"]
                found.append(ViewFit(**view, poor=bool(poor)))
    return sorted(found, key=lambda view: (view.camera, view.frame_id))


def _fit(calibration: Calibration, rows: np.ndarray, camera: int, local: np.ndarray) -> dict:
    middle = local.mean(axis=0)
    normal = np.linalg.svd(local - middle)[2][2]
    sight = middle / np.linalg.norm(middle)
    errors = calibration.errors[rows, camera]
    x, y = calibration.tracks.pixels[rows, camera].mean(axis=0)
    return {
        "camera": camera,
        "frame_id": int(calibration.tracks.frame_ids[rows[0]]),
        "corners": len(rows),
        "kept": int(calibration.kept[rows, camera].sum()),
        "rms_px": float(np.sqrt((errors**2).mean())),
        "tilt_deg": float(np.degrees(np.arccos(np.clip(abs(normal @ sight), 0, 1)))),
        "distance_m": float(np.linalg.norm(middle)),
        "middle_px": (float(x), float(y)),
    }


def different_views(calibration: Calibration, camera: int) -> int:
    """How many views of a camera show the board elsewhere than those counted before: one held still is one view."""
    tracks, chosen = calibration.tracks, []
    apart = APART * float(tracks.image_sizes[camera, 0])
    for number in range(len(tracks.targets)):
        seen = []
        for rows in tracks.rows_of_target(number, calibration.point_valid):
            shown = (rows >= 0) & tracks.visible[rows, camera]
            if shown.any():
                pixels = np.where(shown[:, None], tracks.pixels[rows, camera], np.nan)
                if all(_apart(pixels, other) > apart for other in seen):
                    seen.append(pixels)
        chosen += seen
    return len(chosen)


def _apart(one: Float[np.ndarray, "K 2"], other: Float[np.ndarray, "K 2"]) -> float:
    """Rms distance of the corners that both show; infinite without any."""
    square = ((one - other) ** 2).sum(axis=1)
    known = np.isfinite(square)
    return float(np.sqrt(square[known].mean())) if known.any() else float("inf")


def lens_sigma_map(calibration: Calibration, camera: int) -> Float[np.ndarray, "H W"] | None:
    """How uncertain the lens is over its image, px (one standard deviation of where it sees a fixed direction).

    A rotation of the camera that makes up for a change of the lens over the corners that were seen is taken out: what
    is left cannot be had by turning the camera. NaN where the lens sees nothing; None without a covariance.
    """
    if calibration.camera_covariance is None:
        return None
    lens, size = calibration.rig[camera].lens, calibration.rig.camera_size
    own = slice(camera * size + len(POSE_NAMES), (camera + 1) * size)
    covariance = calibration.camera_covariance[own, own]
    width, height = calibration.tracks.image_sizes[camera]
    x, y = np.meshgrid(np.linspace(0, width - 1, GRID[0]), np.linspace(0, height - 1, GRID[1]))
    seen = calibration.kept[:, camera]
    pixels = calibration.tracks.pixels[seen, camera]
    some = pixels[np.unique(np.linspace(0, len(pixels) - 1, 400).astype(int))]
    by_lens, by_turn, _ = _slopes(lens, some)
    # What a turn does at the corners, as near as it comes to what each parameter does there.
    back = np.linalg.lstsq(by_turn.reshape(-1, 3), by_lens.reshape(-1, by_lens.shape[-1]), rcond=None)[0]
    by_lens, by_turn, valid = _slopes(lens, np.stack([x.ravel(), y.ravel()], axis=1))
    left = by_lens - by_turn @ back
    variance = np.einsum("nip,pq,niq->n", left, covariance, left)
    return np.where(valid, np.sqrt(np.maximum(variance, 0.0)), np.nan).reshape(GRID[::-1])


def _slopes(lens, pixels: Float[np.ndarray, "N 2"]):
    """Derivatives of pixels of fixed directions by the lens's parameters (N, 2, q) and by a turn (N, 2, 3)."""
    with jax.enable_x64(True):
        directions, valid = (np.asarray(part) for part in lens.unproject(pixels))
    parameters = np.asarray(lens.parameters)
    slopes = type(lens).slopes_of(list(parameters), tuple(directions.T), np)
    count = len(pixels)
    by_lens = np.zeros((count, 2, len(parameters)))
    for axis in range(2):
        by_lens[:, axis, axis] = (slopes.pixel[axis] - parameters[2 + axis]) / parameters[axis]
        by_lens[:, axis, 2 + axis] = 1.0
        for k, column in enumerate(slopes.by_coefficients[axis]):
            by_lens[:, axis, 4 + k] = column
    by_direction = np.stack([np.stack(np.broadcast_arrays(*row), axis=-1) for row in slopes.by_direction], axis=1)
    turns = np.cross(np.eye(3)[None], directions[:, None, :])  # (N, 3 of w, 3)
    return by_lens, by_direction @ np.swapaxes(turns, 1, 2), valid


WORDS = (("upper left", "upper middle", "upper right"), ("left", "middle", "right"),
         ("lower left", "lower middle", "lower right"))  # fmt: skip


def where_next(calibration: Calibration, camera: int) -> tuple[tuple[float, float], str] | None:
    """Where in the image the lens is known worst, px and in words; None where that is not known."""
    found = lens_sigma_map(calibration, camera)
    if found is None:
        return None
    width, height = calibration.tracks.image_sizes[camera]
    x, y = np.meshgrid(np.linspace(0, width - 1, GRID[0]), np.linspace(0, height - 1, GRID[1]))
    seen = calibration.tracks.pixels[calibration.kept[:, camera], camera]
    cx, cy = np.asarray(calibration.rig.cameras.center)[camera]
    # A fisheye's image ends before its corners; nobody knows where, but not far beyond the farthest corner of a board.
    reach = BEYOND * np.hypot(*(seen - [cx, cy]).T).max(initial=0.0)
    found = np.where(np.hypot(x - cx, y - cy) <= reach, found, np.nan)
    if not np.isfinite(found).any():
        return None
    row, column = np.unravel_index(np.nanargmax(found), found.shape)
    place = float((width - 1) * column / (GRID[0] - 1)), float((height - 1) * row / (GRID[1] - 1))
    word = WORDS[min(3 * int(row) // GRID[1], 2)][min(3 * int(column) // GRID[0], 2)]
    return place, word
