"""A calibrated room with one camera more, or with one that was moved: all others stay as they are.

The cameras that stay place the light; each other camera is found from its points (resection), and one adjustment moves
these cameras and the points alone. The covariance is that of this estimate: what the cameras that stay are uncertain
by, and what of it enters the others.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Bool

from jaxpoint.calibration.assembly import assemble_calibration
from jaxpoint.calibration.degenerate import check_volume
from jaxpoint.calibration.extension_covariance import extended_covariance
from jaxpoint.calibration.lens_checks import with_reach
from jaxpoint.calibration.outliers import (
    GROWING_PX,
    classify_observations,
    refine_coarse_to_fine,
    refine_to_convergence,
)
from jaxpoint.calibration.pairs import pair_table
from jaxpoint.calibration.recording import Freedom, Recording, RigState
from jaxpoint.calibration.refinement import first_lenses
from jaxpoint.calibration.result import Calibration, Finding, FrameHold, Stage, Verdict
from jaxpoint.calibration.robust_resection import RobustResection, resect_robustly
from jaxpoint.camera.lenses import lenses_of_models
from jaxpoint.camera.parameters import CENTER, COEFFICIENTS, FOCAL, adjusted_cameras, adjusted_lenses
from jaxpoint.camera.rig import CameraRig
from jaxpoint.config import CalibrateSettings
from jaxpoint.errors import InsufficientDataError, UsageError
from jaxpoint.tracks import Tracks

MIN_FRAMES = 20  # of a camera together with the known ones
WIDEST, NARROWEST = 0.2, 20.0  # focal lengths in image widths; a resection beyond is no start
AHEAD = 0.1  # of a unit direction along the optical axis, from which points can be divided by their depth
STILL_FITS = 0.5  # share of the observations of a camera that stays which must fit where it stands


@dataclass(frozen=True)
class _Parts:
    """The cameras of the tracks by what is known of them."""

    stay: Bool[np.ndarray, " C"]
    moved: Bool[np.ndarray, " C"]  # of known lens
    lenses: CameraRig  # of the known room, its first camera standing for the new ones

    @property
    def new(self) -> Bool[np.ndarray, " C"]:
        return ~(self.stay | self.moved)


def extend_calibration(
    tracks: Tracks, known: Calibration, settings: CalibrateSettings | None = None, moved: Sequence[str] = ()
) -> Calibration:
    """The cameras of `tracks` in the frame and unit of a calibration that has some of them already.

    Cameras of the calibration stay as they are, those in `moved` keep their lens (a prior with `lens.known =
    "refine"`), and cameras that it does not have are found with their lens, of the same model as the others.

    Args:
        known: as `calibrate` or `align` left it, with its covariance (`with_covariance`).
        moved: cameras to be found again.

    Raises:
        UsageError: a camera in `moved` is not known, nothing is to be found, image sizes are others, or lenses are to
            be shared.
        InsufficientDataError: fewer than two cameras stay, or a camera shares too little with them.
    """
    with jax.enable_x64(True):
        return _extend(tracks, known, settings or CalibrateSettings(), moved)


def _extend(tracks: Tracks, known: Calibration, settings: CalibrateSettings, moved: Sequence[str]) -> Calibration:
    begin = time.perf_counter()
    if settings.lens.shared:
        raise UsageError("A calibrated room keeps its lenses; leave out --lens.shared, or calibrate anew.")
    parts = _parts(tracks, known, moved)
    recording, light = Recording.of(tracks), _light(tracks, known.rig, parts.stay)
    state, found = _start(tracks, recording, parts, light, settings)
    freedom = _freedom(recording, parts, settings)
    judged = refine_coarse_to_fine(recording, state, freedom)
    settled = refine_to_convergence(recording, judged, freedom, settings.outliers)
    end = assemble_calibration(tracks, recording, settled, freedom, settings, pair_table(tracks))
    check_volume(end.points[end.point_valid])
    names = [name for name, stays in zip(tracks.names, parts.stay) if not stays]
    stage = Stage("Extension", {"found": names, "from_points": {n: int(i) for n, i in zip(names, found)}})
    end = replace(
        with_reach(end),
        unit=known.unit,
        alignment=known.alignment,
        hold=FrameHold(open_freedoms=0, scale_sigma=0.0, in_room=known.in_room),
        stages=(stage,),
        findings=_not_where_they_were(end, parts.stay),
        seconds={"init": 0.0, "adjust": time.perf_counter() - begin, "total": time.perf_counter() - begin},
    )
    return extended_covariance(end, known, parts.stay, parts.moved)


def _parts(tracks: Tracks, known: Calibration, moved: Sequence[str]) -> _Parts:
    rig = known.rig
    for name in moved:
        if name not in rig.names:
            raise UsageError(f"The room has no camera '{name}' to be found again; it has {', '.join(rig.names)}.")
        if name not in tracks.names:
            raise UsageError(f"The tracks have no camera '{name}'; they have {', '.join(tracks.names)}.")
    inside = np.array([name in rig.names for name in tracks.names])
    again = np.array([name in moved for name in tracks.names])
    if (inside & ~again).sum() < 2:
        raise InsufficientDataError(
            f"{(inside & ~again).sum()} of the tracks' cameras stay as they were; two or more must, for they place the "
            "light. Calibrate the room anew."
        )
    if inside.all() and not again.any():
        raise UsageError("The room has all cameras of these tracks already; name the moved ones by --recalibrate.")
    if not inside.all() and len(set(rig.lens_models)) > 1:
        models = ", ".join(sorted({model.name for model in rig.lens_models}))
        new = tracks.names[int(np.flatnonzero(~inside)[0])]
        raise UsageError(
            f"The room has lenses of several models ({models}), and nothing says which of them {new} has; calibrate "
            f"the room anew, and name it: --lens.distortion {new}=MODEL."
        )
    first = int(np.flatnonzero(inside)[0])
    order = [rig.names.index(name if ours else tracks.names[first]) for name, ours in zip(tracks.names, inside)]
    cameras = jax.tree.map(lambda leaf: leaf[np.array(order)], rig.cameras)
    lenses = CameraRig(cameras, rig.image_sizes[np.array(order)], tracks.names)
    for name, ours, size, was in zip(tracks.names, inside, tracks.image_sizes.tolist(), lenses.image_sizes.tolist()):
        if ours and size != was:
            raise UsageError(
                f"Camera '{name}' has images of {size[0]} x {size[1]} px in the tracks, of {was[0]} x {was[1]} px in "
                "the room; only the same mode of a camera has the same lens."
            )
    return _Parts(inside & ~again, again, lenses)


def _light(tracks: Tracks, rig: CameraRig, stay: Bool[np.ndarray, " C"]) -> tuple[np.ndarray, np.ndarray]:
    """Points (F, 3) of the light where the cameras that stay agree on them, and which frames these are."""
    seen = tracks.select_cameras(np.flatnonzero(stay).tolist())
    recording = Recording.of(seen)
    ours = rig.select([rig.names.index(name) for name in seen.names])
    judged = classify_observations(recording, _state_of(ours, recording), GROWING_PX[-1] * recording.scale)
    agreed = judged.kept[: tracks.frames].sum(axis=1) >= 2
    both = (seen.visible.sum(axis=1) >= 2).sum()
    if agreed.sum() < max(MIN_FRAMES, STILL_FITS * both):
        raise InsufficientDataError(
            f"The cameras that stay agree on the light in {agreed.sum()} of the {both} frames that two of them see: "
            "one of them was moved too, or too little was recorded. Name the moved ones by --recalibrate, or calibrate "
            "the room anew."
        )
    return judged.state.points[: tracks.frames], agreed


def _state_of(rig: CameraRig, recording: Recording) -> RigState:
    size = len(recording.image_sizes)
    cameras = np.pad(adjusted_cameras(rig), ((0, size - len(rig)), (0, 0)))
    base = np.tile(np.eye(3), (size, 1, 1))
    base[: len(rig)] = rig.cameras.cam_from_world.rotation
    return RigState(cameras, base, np.zeros((len(recording.pixels), 3)), type(rig.cameras.lens))


def _start(tracks: Tracks, recording: Recording, parts: _Parts, light, settings) -> tuple[RigState, list[int]]:
    """The rig with every camera to be found put where the light's points have it, and from how many points each."""
    state, (points, agreed), counts = _state_of(parts.lenses, recording), light, []
    cameras, base = state.cameras, state.base
    for camera in np.flatnonzero(~parts.stay).tolist():
        rows = agreed & tracks.visible[:, camera]
        if rows.sum() < MIN_FRAMES:
            raise InsufficientDataError(
                f"Camera '{tracks.names[camera]}' sees the light in {rows.sum()} frames in which the cameras that stay "
                f"place it; it takes {MIN_FRAMES}. Wave the light longer where they see it together."
            )
        found, focal = _resected(tracks, parts, camera, points[rows], tracks.pixels[rows, camera], settings.seed)
        pose = found.cam_from_world
        base[camera], cameras[camera, 3:6] = pose.rotation, pose.translation
        if parts.new[camera]:
            cameras[camera, FOCAL:] = 0.0
            cameras[camera, FOCAL] = np.log(focal)
            cameras[camera, CENTER] = (tracks.image_sizes[camera] - 1) / 2.0
        counts.append(int(found.inliers.sum()))
    whole = np.zeros_like(state.points)
    whole[: tracks.frames][agreed] = points[agreed]
    return replace(state, cameras=cameras, base=base, points=whole, anchored=True), counts


def _resected(tracks: Tracks, parts: _Parts, camera: int, points, pixels, seed: int) -> tuple[RobustResection, float]:
    """The camera on which most points agree, and its focal length (px): the known one where the lens is known."""
    width, name = float(tracks.image_sizes[camera, 0]), tracks.names[camera]
    threshold = GROWING_PX[0] * width / 1280.0
    if parts.moved[camera]:
        lens = parts.lenses[camera].lens
        focal = float(np.mean(np.asarray(lens.focal)))
        directions, valid = (np.asarray(part) for part in lens.unproject(pixels))
        ahead = valid & (directions[:, 2] > AHEAD)
        points, pixels = points[ahead], directions[ahead, :2] / directions[ahead, 2:]
        found = resect_robustly(points, pixels, threshold / focal, seed)
    else:
        found = resect_robustly(points, pixels, threshold, seed)
        focal = float(found.intrinsics[1, 1])
    if found.inliers.sum() < MIN_FRAMES or not WIDEST < focal / width < NARROWEST:
        raise InsufficientDataError(
            f"Camera '{name}' fits {found.inliers.sum()} of the {len(points)} points of the light, at a focal length "
            f"of {focal:.0f} px: it does not see the same light, or the light moved on a plane. Look whether its "
            "images are of this recording and in step, and wave the light through the depth."
        )
    return found, focal


def _freedom(recording: Recording, parts: _Parts, settings: CalibrateSettings) -> Freedom:
    """Cameras that stay are held; moved ones keep their lens; new ones have the lens terms that the others have."""
    freedom = Freedom.of(recording, settings.lens, first_lenses(settings, parts.lenses, recording.names))
    free = freedom.free.copy()
    count = recording.cameras
    known = np.flatnonzero(~parts.new)
    used = (np.asarray(adjusted_lenses(parts.lenses))[known, COEFFICIENTS.start - FOCAL :] != 0).any(axis=0)
    free[:count, COEFFICIENTS] = used & lenses_of_models(parts.lenses.lens_models).free
    free[np.flatnonzero(parts.stay)] = False
    if settings.lens.known != "refine":
        free[np.flatnonzero(parts.moved), FOCAL:] = False
    around = freedom.around(recording, adjusted_lenses(parts.lenses), type(parts.lenses.cameras.lens))
    mean, weight = freedom.prior_mean.copy(), freedom.prior_weight.copy()
    mean[known], weight[known] = around.prior_mean[known], around.prior_weight[known]
    return Freedom(free, mean, weight)


def _not_where_they_were(found: Calibration, stay: Bool[np.ndarray, " C"]) -> tuple[Finding, ...]:
    """Cameras that were to stay, and whose observations do not fit there."""
    comparable = found.tracks.visible & (found.verdicts != Verdict.FEW_VIEWS)
    fits = found.kept.sum(axis=0) / np.maximum(comparable.sum(axis=0), 1)
    return tuple(
        Finding(
            "moved camera",
            "bad",
            f"Only {fits[camera]:.0%} of the observations of {name} fit where the calibration has it: it was moved.",
            f"Find it again too: --recalibrate {name}",
            (name,),
        )
        for camera, name in enumerate(found.tracks.names)
        if stay[camera] and comparable[:, camera].any() and fits[camera] < STILL_FITS
    )
