"""Calibration from boards of known shape: lenses by themselves, cameras by boards seen together, then all at once.

One camera is calibrated so (Zhang 2000), two (stereo), or a whole rig; what else is among the tracks, such as a light,
takes part in the last adjustment.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import numpy as np

from jaxpoint.calibration.assembly import assemble_calibration
from jaxpoint.calibration.board_chain import chain_cameras, target_poses
from jaxpoint.calibration.board_sizes import size_findings
from jaxpoint.calibration.board_turns import turn_tracks, turn_views, views_turned
from jaxpoint.calibration.board_views import BoardViews, is_flat, lens_of, solve_views, starts_of, widest_angle
from jaxpoint.calibration.lens_start import LensStart
from jaxpoint.calibration.objective import Solution, better_by
from jaxpoint.calibration.outliers import Settled, refine_coarse_to_fine, refine_to_convergence
from jaxpoint.calibration.pairs import pair_table
from jaxpoint.calibration.recording import NOISE_PX, Freedom, Recording, RigState, adjust, project
from jaxpoint.calibration.refinement import first_lenses
from jaxpoint.calibration.result import Calibration, Stage
from jaxpoint.calibration.target_blocks import with_places
from jaxpoint.camera.lens import AbstractLens
from jaxpoint.camera.lenses import LensChoice, chosen_lenses
from jaxpoint.camera.mixed import model_of
from jaxpoint.camera.parameters import ASPECT, CENTER, COEFFICIENTS, FOCAL, POSE, adjusted_lenses, size_of
from jaxpoint.camera.rig import CameraRig
from jaxpoint.config import CalibrateSettings, OutlierSettings
from jaxpoint.errors import InsufficientDataError
from jaxpoint.geometry.pose import Similarity
from jaxpoint.tracks import Tracks

Progress = Callable[[str, int, int], None]
FULL, FISHEYE = "brown", "fisheye"  # what `auto` chooses from
WIDE, VERY_WIDE = 0.75, 1.0  # rad off the axis: a fisheye is tried too, and beyond the second nothing else
ALONE = "Each camera by itself"  # the stage that only these calibrations have
SQUARE = 0.02  # sigma of a log aspect: boards tell it to 0.1 %, where they tell it at all
WORTH = 4.0  # fall of the objective for every coefficient more


def calibrate_boards(
    tracks: Tracks,
    settings: CalibrateSettings | None = None,
    *,
    intrinsics: CameraRig | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Calibrate one or more cameras from flat targets of known shape.

    The world is the first camera's frame, in metres where a target's size is known. Computed in float64.

    Args:
        tracks: corners of boards, with or without a light.
        settings: how; `lens.distortion = "auto"` takes all of Brown's coefficients or, for a wide lens, a fisheye.
            Pixel aspects and principal points are solved for unless they are `fixed` or given.
        intrinsics: lenses that are known; `settings.lens.known` says whether to hold or refine them.
        progress: called as `progress(what, done, total)`.

    Raises:
        InsufficientDataError: there is no flat target, a camera saw too few views, or too few together with others.
        UsageError: `settings.lens.distortion` names no lens, or one of another kind than the known ones.
        ValueError: known intrinsics of another number of cameras than the tracks have.
    """
    settings = settings or CalibrateSettings()
    if intrinsics is not None and len(intrinsics) != tracks.cameras:
        raise ValueError(f"Intrinsics of {len(intrinsics)} cameras were given for tracks of {tracks.cameras}.")
    with jax.enable_x64(True):
        recording = Recording.of(tracks)
        if not any(is_flat(owned) for owned in recording.targets):
            raise InsufficientDataError(
                "There are 0 flat targets among the tracks; detect a board first (`jaxpoint detect board`)."
            )
        return _Solver(tracks, recording, settings, intrinsics, progress or (lambda what, done, total: None)).run()


def is_from_boards(calibration: Calibration) -> bool:
    """Whether `calibrate_boards` made it."""
    return any(stage.name == ALONE for stage in calibration.stages)


def boards_alone(tracks: Tracks) -> bool:
    """Whether the tracks are of flat targets and of nothing else."""
    if not tracks.targets or tracks.target_ids is None or tracks.prior is not None:
        return False
    flat = [target.width > 0 and np.ptp(target.centred[:, 2]) < 1e-6 * target.width for target in tracks.targets]
    return all(flat) and bool((tracks.target_ids >= 0).all())


@dataclass
class _Solver:
    """One calibration on its way."""

    tracks: Tracks
    recording: Recording
    settings: CalibrateSettings
    intrinsics: CameraRig | None
    progress: Progress

    def run(self) -> Calibration:
        """From each camera by itself to the whole."""
        clock = [time.perf_counter()]
        starts = self._starts()
        solutions = [self._solve(choice, starts) for choice in self._choices(starts)]
        best, stages = solutions[0]
        for other, others in solutions[1:]:
            more = other.freedom.parameters - best.freedom.parameters
            if better_by(other, best) > WORTH * more:
                best, stages = other, others
        clock.append(time.perf_counter())
        freedom = replace(best.freedom, free=best.freedom.free.copy())
        freedom.free[: self.tracks.cameras, POSE] = True  # held with one camera, whose covariance knows no frame
        pairs = pair_table(self.tracks)
        settings = replace(self.settings, outliers=self._outliers)
        found = assemble_calibration(self.tracks, self.recording, best.settled, freedom, settings, pairs)
        found = in_camera_frame(found)
        findings = size_findings(found, self.recording)
        return replace(
            found,
            stages=stages,
            findings=findings,
            seconds={"adjust": clock[1] - clock[0], "total": clock[1] - clock[0]},
        )

    def _starts(self) -> list[list[LensStart]] | None:
        """First lenses of each camera, where they are not known."""
        if self.intrinsics is not None:
            return None
        return [starts_of(self.recording, camera, name) for camera, name in enumerate(self.tracks.names)]

    def _choices(self, starts: list[list[LensStart]] | None) -> list[LensChoice]:
        """Lenses to try."""
        asked, names = self.settings.lens.distortion, self.tracks.names
        if starts is None:
            return [first_lenses(self.settings, self.intrinsics, names)]
        if asked != "auto":
            return [chosen_lenses(asked, names)]
        bent = [next(start for start in some if start.equidistant) for some in starts]
        angle = max(widest_angle(self.recording, camera, start) for camera, start in enumerate(bent))
        wide = angle > WIDE and any(some[0].equidistant for some in starts)
        tried = [FISHEYE] if wide and angle > VERY_WIDE else [FULL, FISHEYE] if wide else [FULL]
        return [chosen_lenses(choice, names) for choice in tried]

    def _solve(self, choice: LensChoice, starts: list[list[LensStart]] | None) -> tuple[Solution, tuple[Stage, ...]]:
        model = choice.model
        freedom = board_freedom(self.recording, self.settings, choice, self.intrinsics)
        views = [self._alone(camera, model, freedom, starts) for camera in range(self.tracks.cameras)]
        names, views = self.tracks.names, self._counted_alike(views)
        rotation, translation = chain_cameras(views, names)
        state = self._state(model, views, rotation, translation)
        self.progress("all together", 0, 1)
        judged = refine_coarse_to_fine(self.recording, state, freedom)
        settled = self._finished(refine_to_convergence(self.recording, judged, freedom, self._outliers), freedom)
        self.progress("all together", 1, 1)
        figures = {name: [round(float(value), 4) for value in lens_of(view)] for name, view in zip(names, views)}
        return Solution(settled, freedom), (Stage(ALONE, figures),)

    def _counted_alike(self, views: list[BoardViews]) -> list[BoardViews]:
        """The views with every symmetric board counted from the same end by all cameras; so are the tracks then."""
        turned = views_turned(views, self.recording.targets)
        if any(own.any() for own in turned):
            self.tracks = turn_tracks(self.tracks, turned)
            self.recording = Recording.of(self.tracks)
        return turn_views(views, turned)

    def _finished(self, settled: Settled, freedom: Freedom) -> Settled:
        """The inliers at their very optimum: judging them leaves poses where a robust loss has them."""
        judged = settled.judged
        end = adjust(self.recording, judged.state, judged.kept, freedom.at_noise(settled.sigma_px), rtol=1e-10)
        errors = np.linalg.norm(project(end.state)[0] - self.recording.pixels, axis=-1)
        errors = np.where(judged.errors > 0, errors, 0.0)
        return replace(settled, judged=replace(judged, state=end.state, errors=errors))

    @property
    def _outliers(self) -> OutlierSettings:
        """The inliers in the end by least squares: corners of boards are many, and their noise is alike."""
        return replace(self.settings.outliers, loss="none")

    def _alone(
        self, camera: int, model: type[AbstractLens], freedom: Freedom, starts: list[list[LensStart]] | None
    ) -> BoardViews:
        """One camera by itself."""
        self.progress("each camera by itself", camera, self.tracks.cameras)
        alone = Recording.of(self.tracks.select_cameras([camera]))
        owner = camera if freedom.owner is None else int(freedom.owner[camera])  # it alone has the lens's priors
        free, mean, weight = (_first_of(part, owner, len(alone.image_sizes)) for part in _parts(freedom))
        own = Freedom(free, mean, weight)
        known = None if self.intrinsics is None else adjusted_lenses(self.intrinsics)[camera]
        start = None
        if starts is not None:
            equidistant = next(some for some in starts[camera] if some.equidistant)
            # A perspective lens that is strongly bent looks equidistant; its coefficients are fitted to that.
            start = equidistant if model_of(model, mean[0, COEFFICIENTS]).sees_sideways else starts[camera][0]
        found = solve_views(alone, own, model, start, known)
        self.progress("each camera by itself", camera + 1, self.tracks.cameras)
        return found

    def _state(self, model: type[AbstractLens], views: list[BoardViews], rotation, translation) -> RigState:
        size, count = len(self.recording.image_sizes), self.tracks.cameras
        cameras, base = np.zeros((size, size_of(model))), np.tile(np.eye(3), (size, 1, 1))
        cameras[:, FOCAL] = np.log(1000.0)
        cameras[:, CENTER] = (self.recording.image_sizes - 1) / 2.0
        cameras[:count, 3:6], base[:count] = translation, rotation
        cameras[:count, FOCAL:] = np.stack([view.lens for view in views])
        poses = target_poses(views, rotation, translation)
        state = RigState(cameras, base, np.zeros((len(self.recording.pixels), 3)), model, poses)
        return with_places(self.recording, state)


def _parts(freedom: Freedom) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return freedom.free, freedom.prior_mean, freedom.prior_weight


def _first_of(values: np.ndarray, camera: int, size: int) -> np.ndarray:
    """The row of one camera, then rows of cameras that do not exist."""
    found = np.zeros((size, values.shape[1]), values.dtype)
    found[0] = values[camera]
    return found


def board_freedom(
    recording: Recording, settings: CalibrateSettings, choice: LensChoice, intrinsics: CameraRig | None
) -> Freedom:
    """What moves: the pixel aspect too, which boards tell; of one camera no pose."""
    lens = settings.lens
    hold = lens.known == "hold"
    freedom = Freedom.of(recording, lens, choice, hold=hold)
    free, weight = freedom.free.copy(), freedom.prior_weight.copy()
    if recording.cameras == 1:
        free[:, POSE] = False
    if intrinsics is not None:
        known = freedom.around(recording, adjusted_lenses(intrinsics), type(intrinsics.cameras.lens))
        return replace(known, free=free)
    if not hold and lens.aspect == "auto":
        free[: recording.cameras, ASPECT] = True
    weight[:, ASPECT] = (NOISE_PX / SQUARE) ** 2
    return replace(freedom, free=free, prior_weight=weight).with_shared_priors()


def in_camera_frame(calibration: Calibration, camera: int = 0) -> Calibration:
    """The same calibration in the frame of one of its cameras; to be used before the covariance is known."""
    pose = calibration.rig[camera].cam_from_world
    similarity = Similarity(np.ones(()), pose.rotation, pose.translation)
    moved = np.asarray(similarity @ calibration.points)
    points = np.where(calibration.point_valid[:, None], moved, 0.0)
    return replace(calibration, rig=calibration.rig.transformed(similarity), points=points)
