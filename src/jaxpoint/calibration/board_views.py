"""What one camera by itself says of flat targets of known shape: its lens, and the pose of each in each frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from jaxpoint.calibration.eliminated import POSE, pose_values
from jaxpoint.calibration.lens_start import FlatView, LensStart, directions_of, lens_starts
from jaxpoint.calibration.outliers import FIRST_LOSS_PX
from jaxpoint.calibration.planar_pose import FLAT, LEAST_POINTS, flipped_pose, pose_from_rays, rays
from jaxpoint.calibration.recording import Freedom, Recording, RigState, adjust, place_points, project
from jaxpoint.calibration.target_blocks import TargetRows, known_poses, with_places
from jaxpoint.camera.conversion import fit_coefficients
from jaxpoint.camera.lens import AbstractLens
from jaxpoint.camera.mixed import embedded, model_of, own_coefficients
from jaxpoint.camera.parameters import ASPECT, CENTER, COEFFICIENTS, FOCAL, lens_parameters, size_of
from jaxpoint.camera.parameters import POSE as CAMERA_POSE
from jaxpoint.errors import InsufficientDataError

LEAST_VIEWS = 3  # of a camera whose lens is not known: Zhang's constraints are two a view
STEPS = 30
REACH = 1.2  # rad: an equidistant start is turned into another lens up to this angle
FLIPPED = 0.7  # of the cost: the other pose of a plane must be that much better


@dataclass(frozen=True)
class BoardViews:
    """A camera's lens and what it saw, each target in the camera's own frame."""

    lens: Float[np.ndarray, " q"]  # adjusted parameters from log focal onwards
    poses: tuple[Float[np.ndarray, "_ 12"], ...]  # cam_from_target of each target; NaN where it was not seen
    corners: tuple[np.ndarray, ...]  # (M,) how many of its points were seen
    cost: float  # px^2, robust


def is_flat(owned: TargetRows) -> bool:
    """Whether the target's points lie on a plane, and off one line."""
    return owned.target.width > 0 and bool(np.abs(owned.shape[:, 2]).max() <= FLAT * np.abs(owned.shape).max())


def flat_views(recording: Recording, camera: int) -> list[FlatView]:
    """Every view of a flat target that is large enough to tell its pose."""
    found = []
    for owned in filter(is_flat, recording.targets):
        for rows in owned.rows:
            own = (rows >= 0) & recording.visible[rows, camera]
            if own.sum() >= LEAST_POINTS + 2:
                found.append(FlatView(owned.shape[own, :2], recording.pixels[rows[own], camera]))
    return found


def starts_of(recording: Recording, camera: int, name: str) -> list[LensStart]:
    """First lenses of a camera.

    Raises:
        InsufficientDataError: it saw too few views.
    """
    views = flat_views(recording, camera)
    if len(views) < LEAST_VIEWS:
        raise InsufficientDataError(
            f"Camera '{name}' saw the board in {len(views)} frames, and its lens takes {LEAST_VIEWS} or more; show it "
            "the board near and far, tilted to all sides, up to the corners of its image."
        )
    return lens_starts(views, recording.image_sizes[camera].astype(float))


def widest_angle(recording: Recording, camera: int, start: LensStart) -> float:
    """The largest angle (rad) off the axis at which an equidistant lens of this focal length saw a point."""
    away = recording.pixels[recording.visible[:, camera], camera] - (recording.image_sizes[camera] - 1) / 2.0
    return float(np.quantile(np.linalg.norm(away, axis=1), 0.98) / start.focal)


def solve_views(
    alone: Recording, freedom: Freedom, model: type[AbstractLens], start: LensStart | None, known: np.ndarray | None
) -> BoardViews:
    """The lens and the poses of a recording of one camera (its first), by a robust adjustment.

    Args:
        start: a rough lens.
        known: adjusted parameters of a known lens, instead.
    """
    state = _first_state(alone, freedom, model, start, known)
    loss, seen = FIRST_LOSS_PX * alone.scale, _placed(alone, state)
    held = freedom.free.copy()
    held[:, CAMERA_POSE] = False
    moving = replace(freedom, free=held)
    for _ in range(2):
        end = adjust(alone, state, seen, moving, loss_scale=loss, steps=STEPS, rtol=1e-6)
        state = _unflipped(alone, end.state, seen, loss)
    corners = tuple(((owned.rows >= 0) & alone.visible[owned.rows, 0]).sum(axis=1) for owned in alone.targets)
    return BoardViews(state.cameras[0, FOCAL:], state.poses, corners, end.cost)


def _first_state(
    alone: Recording, freedom: Freedom, model: type[AbstractLens], start: LensStart | None, known: np.ndarray | None
) -> RigState:
    size = len(alone.image_sizes)
    cameras = np.zeros((size, size_of(model)))
    cameras[:, FOCAL] = np.log(1000.0)
    cameras[:, CENTER] = (alone.image_sizes - 1) / 2.0
    cameras[:, COEFFICIENTS] = freedom.prior_mean[:, COEFFICIENTS]
    if known is not None:
        cameras[0, FOCAL:] = known
    else:
        assert start is not None
        cameras[0, FOCAL] = np.log(start.focal)
        cameras[0, ASPECT] = freedom.prior_mean[0, ASPECT]
        cameras[0, COEFFICIENTS] = _coefficients(alone, freedom, model, start)
    state = RigState(cameras, np.tile(np.eye(3), (size, 1, 1)), np.zeros((len(alone.pixels), 3)), model)
    poses = tuple(_poses(alone, state, owned, start if known is None else None) for owned in alone.targets)
    return with_places(alone, replace(state, poses=poses))


def _coefficients(
    alone: Recording, freedom: Freedom, model: type[AbstractLens], start: LensStart
) -> Float[np.ndarray, " k"]:
    """Coefficients that make the lens see like the start where the target was seen."""
    mean, free = freedom.prior_mean[0, COEFFICIENTS], freedom.free[0, COEFFICIENTS]
    own = model_of(model, mean)
    if start.equidistant == own.sees_sideways:
        return mean
    center = (alone.image_sizes[0] - 1) / 2.0
    pixels = alone.pixels[alone.visible[:, 0], 0]
    directions = directions_of(pixels, start.focal, center, start.equidistant)
    near = directions[:, 2] > np.cos(REACH)
    # Two radial terms: more would follow the start's faults to the edge of the image.
    radial = free[own_coefficients(model, own)] & np.array([c.name in ("k1", "k2") for c in own.coefficients], bool)
    common = np.array([start.focal, start.focal, *center])
    return embedded(model, own, fit_coefficients(own, common, directions[near], pixels[near], radial))


def _poses(alone: Recording, state: RigState, owned: TargetRows, start: LensStart | None) -> Float[np.ndarray, "M 12"]:
    """Of a flat target in each frame, from the start's plain lens or from a known one; NaN where it tells none."""
    poses = np.full((len(owned.rows), POSE), np.nan)
    if not is_flat(owned):
        return poses
    center = (alone.image_sizes[0] - 1) / 2.0
    for frame, rows in enumerate(owned.rows):
        own = (rows >= 0) & alone.visible[rows, 0]
        pixels = alone.pixels[rows[own], 0]
        if own.sum() < LEAST_POINTS:
            continue
        if start is None:
            directions, valid = rays(state, 0, pixels)
        else:
            directions, valid = (
                directions_of(pixels, start.focal, center, start.equidistant),
                np.ones(len(pixels), bool),
            )
        pose = pose_from_rays(owned.shape[own][valid, :2], directions[valid])
        if pose is not None:
            poses[frame] = pose_values(pose[0][None], pose[1][None])[0]
    return poses


def _placed(recording: Recording, state: RigState) -> np.ndarray:
    """(N, D) observations of targets that have a pose."""
    posed = np.zeros(len(recording.pixels), bool)
    for owned, poses in zip(recording.targets, state.poses):
        posed[owned.with_pose(poses)[0]] = True
    return recording.visible & posed[:, None]


def _unflipped(alone: Recording, state: RigState, seen: np.ndarray, loss: float) -> RigState:
    """The state with the other pose of a target wherever that explains its view better."""
    turned = []
    for poses in state.poses:
        other = poses.copy()
        for frame in np.flatnonzero(known_poses(poses)):
            rotation, translation = flipped_pose(poses[frame, :9].reshape(3, 3), poses[frame, 9:])
            other[frame] = pose_values(rotation[None], translation[None])[0]
        turned.append(other)
    trial = place_points(alone, with_places(alone, replace(state, poses=tuple(turned))), seen, loss)
    before, after = (_costs(alone, one, seen, loss) for one in (state, trial))
    chosen = tuple(
        np.where((new < FLIPPED * old)[:, None], other, poses)
        for poses, other, old, new in zip(state.poses, trial.poses, before, after)
    )
    return with_places(alone, replace(state, poses=chosen))


def _costs(alone: Recording, state: RigState, seen: np.ndarray, loss: float) -> list[np.ndarray]:
    """Robust cost of each pose of each target."""
    pixels, _ = project(state)
    square = ((pixels - alone.pixels) ** 2).sum(axis=-1)
    costs = np.where(seen, loss**2 * np.log1p(square / loss**2), 0.0).sum(axis=1)
    return [np.where(owned.rows >= 0, costs[owned.rows], 0.0).sum(axis=1) for owned in alone.targets]


def lens_of(views: BoardViews) -> Float[np.ndarray, " p"]:
    """fx, fy, cx, cy (px) and the coefficients."""
    return np.array(lens_parameters(views.lens, np))
