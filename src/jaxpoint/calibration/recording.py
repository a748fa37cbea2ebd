"""One recording and one rig as the adjustment sees them: padded to few shapes, in blocks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from jaxpoint.calibration.adjustment import PointPriors
from jaxpoint.calibration.bundle import LEAST_SQUARES, CameraModel, padded_frames, solve, to_blocks
from jaxpoint.calibration.schur import Problem, SchurLevenbergMarquardt, Unknowns, solve_points
from jaxpoint.calibration.shared_lenses import lens_owners, places_of, with_common_lenses
from jaxpoint.calibration.target_blocks import TargetRows, seen_targets, target_rows, with_solved
from jaxpoint.camera.brown import Brown
from jaxpoint.camera.lens import AbstractLens
from jaxpoint.camera.lenses import LensChoice, chosen_lenses
from jaxpoint.camera.parameters import ASPECT, CENTER, COEFFICIENTS, FOCAL, POSE, size_of
from jaxpoint.compilation import jit
from jaxpoint.config import LensSettings
from jaxpoint.tracks import Tracks

CAMERA_SIZES = (4, 6, 8, 12, 16, 24, 32, 48, 64)  # rigs are padded to these, so that few programs are compiled


@dataclass(frozen=True)
class Recording:
    """Tracks padded in frames (N) and cameras (D); padding is never visible."""

    pixels: np.ndarray  # (N, D, 2)
    visible: np.ndarray  # (N, D)
    image_sizes: np.ndarray  # (D, 2)
    frames: int
    cameras: int
    pixel_aspects: np.ndarray  # (D,) width over height of a pixel; 1 where nothing states another
    names: tuple[str, ...]  # of the cameras
    targets: tuple[TargetRows, ...] = ()
    known: np.ndarray | None = None  # (N, 3) m, where the room says that points lie,
    known_sigmas: np.ndarray | None = None  # (N,) m, and how sure it is; infinite where it says nothing

    @staticmethod
    def of(tracks: Tracks) -> Recording:
        """Pad tracks."""
        aspects = np.ones(padded_cameras(tracks.cameras))
        if tracks.pixel_aspects is not None:
            aspects[: tracks.cameras] = tracks.pixel_aspects
        frames, cameras = padded_frames(tracks.frames), padded_cameras(tracks.cameras)
        pixels = np.zeros((frames, cameras, 2))
        visible = np.zeros((frames, cameras), dtype=bool)
        sizes = np.ones((cameras, 2), dtype=np.int64)
        pixels[: tracks.frames, : tracks.cameras] = tracks.pixels
        visible[: tracks.frames, : tracks.cameras] = tracks.visible
        sizes[: tracks.cameras] = tracks.image_sizes
        targets = tuple(target_rows(tracks, number) for number in range(len(tracks.targets)))
        plain = Recording(pixels, visible, sizes, tracks.frames, tracks.cameras, aspects, tracks.names, targets)
        if tracks.prior is None:
            return plain
        known, sigmas = np.zeros((frames, 3)), np.full(frames, np.inf)
        known[: tracks.frames], sigmas[: tracks.frames] = tracks.prior.points, tracks.prior.sigmas
        return replace(plain, known=known, known_sigmas=sigmas)

    @property
    def scale(self) -> float:
        """Thresholds are given for images 1280 px wide; this is the mean width over that."""
        return float(self.image_sizes[: self.cameras, 0].mean()) / 1280.0

    @property
    def exists(self) -> np.ndarray:
        """(D,) False for padded cameras."""
        return np.arange(self.image_sizes.shape[0]) < self.cameras


def padded_cameras(cameras: int) -> int:
    """The size of rig that this one is padded to."""
    return next((size for size in CAMERA_SIZES if size >= cameras), cameras)


@dataclass(frozen=True)
class RigState:
    """A Euclidean rig while it is being solved: the parameters of `camera.parameters` about a base rotation."""

    cameras: np.ndarray  # (D, p)
    base: np.ndarray  # (D, 3, 3)
    points: np.ndarray  # (N, 3)
    lens: type[AbstractLens] = Brown
    poses: tuple[np.ndarray, ...] = ()  # (M, 12) of each target, see `eliminated.POSE`; none while shapes are not used
    anchored: bool = False  # whether the rig stands in the room's frame, and known points hold it there

    @property
    def rotation(self) -> np.ndarray:
        """cam_from_world (D, 3, 3)."""
        return Rotation.from_rotvec(self.cameras[:, :3].copy()).as_matrix() @ self.base

    @property
    def positions(self) -> np.ndarray:
        """Camera centres (D, 3)."""
        return -np.einsum("cji,cj->ci", self.rotation, self.cameras[:, 3:6])

    def rebased(self) -> RigState:
        """The same rig with the rotation vectors at zero."""
        cameras = self.cameras.copy()
        cameras[:, :3] = 0.0
        return replace(self, cameras=cameras, base=self.rotation)


def free_parameters(recording: Recording, lens: LensSettings, choice: LensChoice, hold: bool = False) -> np.ndarray:
    """Which parameters of each camera move, (D, p) bool."""
    free = np.zeros((recording.image_sizes.shape[0], size_of(choice.model)), dtype=bool)
    free[: recording.cameras, POSE] = True
    if hold:
        return free
    real = free[: recording.cameras]
    real[:, FOCAL] = True
    real[:, ASPECT] = lens.aspect == "free"
    real[:, CENTER] = lens.principal_point != "fixed"
    real[:, COEFFICIENTS] = choice.free
    return free


NOISE_PX = 0.5  # assumed when priors are weighed against pixels
SIGMA_ASPECT = 0.3  # of a log aspect


def priors(recording: Recording, lens: LensSettings, choice: LensChoice) -> tuple[np.ndarray, np.ndarray]:
    """Prior mean and weight (px^2 per unit^2) of the parameters of each camera, (D, p) each."""
    shape = (recording.image_sizes.shape[0], size_of(choice.model))
    mean, sigma = np.zeros(shape), np.full(shape, np.inf)
    mean[:, CENTER] = (recording.image_sizes - 1) / 2.0
    mean[:, ASPECT] = -np.log(recording.pixel_aspects)  # of fx / fy
    if lens.principal_point == "prior":
        sigma[:, CENTER] = lens.principal_point_sigma * recording.image_sizes[:, :1]
    sigma[:, ASPECT] = SIGMA_ASPECT
    mean[: recording.cameras, COEFFICIENTS] = choice.mean
    sigma[:, COEFFICIENTS] = [coefficient.prior_sigma for coefficient in choice.model.coefficients]
    return mean, (NOISE_PX / sigma) ** 2


SIGMA_KNOWN = np.array([0.01, 0.005, 0.01, 0.01])
"""How far known intrinsics are trusted when refined: log focal, log aspect, centre (of the image width); of the
coefficients each lens says it. About what a careful calibration with a board leaves open."""


@dataclass(frozen=True)
class Freedom:
    """What may move in an adjustment, and what it is drawn to."""

    free: np.ndarray  # (D, p) bool
    prior_mean: np.ndarray  # (D, p)
    prior_weight: np.ndarray  # (D, p)
    noise_px: float = NOISE_PX  # of the pixels that the priors are weighed against
    owner: np.ndarray | None = None  # (D,) the camera that owns the lens of each camera; None where all have their own

    @staticmethod
    def of(recording: Recording, lens: LensSettings, choice: LensChoice | str, hold: bool = False) -> Freedom:
        """The freedom that the settings ask for, with these lenses (see `lenses.chosen_lenses`)."""
        if isinstance(choice, str):
            choice = chosen_lenses(choice, recording.names)
        owner = lens_owners(lens.shared, recording.names, recording.image_sizes)
        freedom = Freedom(free_parameters(recording, lens, choice, hold), *priors(recording, lens, choice), owner=owner)
        return freedom.with_shared_priors()

    def around(self, recording: Recording, lenses: np.ndarray, model: type[AbstractLens]) -> Freedom:
        """The same freedom, drawn to known lenses (C, p - 6), see `camera.parameters.adjusted_lenses`."""
        mean, weight = self.prior_mean.copy(), self.prior_weight.copy()
        known = [coefficient.known_sigma for coefficient in model.coefficients]
        sigma = np.tile(np.concatenate([SIGMA_KNOWN, known]), (recording.cameras, 1))
        sigma[:, 2:4] *= recording.image_sizes[: recording.cameras, :1]
        mean[: recording.cameras, FOCAL:] = lenses
        weight[: recording.cameras, FOCAL:] = (NOISE_PX / sigma) ** 2
        return replace(self, prior_mean=mean, prior_weight=weight).with_shared_priors()

    @property
    def parameters(self) -> int:
        """How many parameters move, each of a shared lens once."""
        return int((self.free & ~self._borrowed).sum())

    @property
    def _borrowed(self) -> np.ndarray:
        """(D, p) parameters that another camera owns."""
        return places_of(self.owner, *self.free.shape) != places_of(None, *self.free.shape)

    def with_shared_priors(self) -> Freedom:
        """The same freedom, with one prior for each shared lens: its owner's."""
        if self.owner is None:
            return self
        return replace(self, prior_weight=np.where(self._borrowed, 0.0, self.prior_weight))

    def at_noise(self, sigma_px: float) -> Freedom:
        """The priors weighed against pixels of this noise."""
        return replace(self, prior_weight=self.prior_weight * (sigma_px / NOISE_PX) ** 2, noise_px=sigma_px)


@dataclass(frozen=True)
class Solved:
    """A rig after an adjustment."""

    state: RigState
    cost: float  # px^2, robust
    steps: int
    settled: bool


POINT_STEPS = 8
LARGE_RIG = 16  # cameras


def adjust(
    recording: Recording,
    state: RigState,
    kept: np.ndarray,
    freedom: Freedom,
    *,
    loss_scale: float = LEAST_SQUARES,
    steps: int = 100,
    rtol: float = 1e-6,
) -> Solved:
    """Robust bundle adjustment of the observations `kept` (N, D)."""
    state = state.rebased()
    state = replace(state, cameras=with_common_lenses(state.cameras, freedom.owner))
    problem, start = _problem(recording, state, kept, freedom, loss_scale, steps)
    # Of a large rig the products dominate; of a small one another compilation would.
    held = tuple(np.flatnonzero(~freedom.free.any(axis=0)).tolist()) if recording.cameras >= LARGE_RIG else ()
    solver = SchurLevenbergMarquardt(model=CameraModel(state.lens, held), rtol=jnp.asarray(rtol))
    end = solve(solver, start, problem)
    solved = with_solved(recording, replace(state, cameras=np.asarray(end.cameras)), end)
    return Solved(solved, float(end.cost), int(end.steps), bool(end.settled))


def place_points(recording: Recording, state: RigState, kept: np.ndarray, loss_scale: float) -> RigState:
    """The best point of every frame for cameras that stay as they are, from the points given."""
    nothing = np.zeros(state.cameras.shape)
    problem, start = _problem(recording, state, kept, Freedom(nothing > 0, nothing, nothing), loss_scale, 0)
    return with_solved(recording, state, _place_points(CameraModel(state.lens), start, problem))


@jit
def _place_points(model: CameraModel, start: Unknowns, problem: Problem):
    return solve_points(model, start, problem, POINT_STEPS)


def _problem(recording, state: RigState, kept, freedom: Freedom, loss_scale, steps) -> tuple[Problem, Unknowns]:
    weights = kept.astype(np.float64)
    targets, poses = seen_targets(recording, state, weights)
    for owned, pose in zip(recording.targets, state.poses):
        weights[owned.with_pose(pose)[0]] = 0.0  # these rows move with a pose, and are no points of their own
    problem = Problem(
        jnp.asarray(to_blocks(recording.pixels)),
        jnp.asarray(to_blocks(weights)),
        jnp.asarray(state.base),
        jnp.asarray(freedom.free),
        jnp.asarray(freedom.prior_mean),
        jnp.asarray(freedom.prior_weight),
        jnp.asarray(float(loss_scale)),
        jnp.asarray(steps),
        _point_priors(recording, state, freedom.noise_px),
        targets,
        None if freedom.owner is None else jnp.asarray(places_of(freedom.owner, *freedom.free.shape)),
    )
    return problem, Unknowns(jnp.asarray(state.cameras), jnp.asarray(to_blocks(state.points)), poses)


def _point_priors(recording: Recording, state: RigState, noise_px: float) -> PointPriors | None:
    """Of points that the room knows, once the rig stands in its frame."""
    if not state.anchored or recording.known is None or recording.known_sigmas is None:
        return None
    weight = (noise_px / recording.known_sigmas) ** 2
    return PointPriors(jnp.asarray(to_blocks(recording.known)), jnp.asarray(to_blocks(weight)))


@jit
def _project(model: CameraModel, turned, rest, points):
    def one(turn, own, point):
        pixel = model.residual((turn, own), jnp.zeros(model.camera_size), point, jnp.zeros(2))
        local = turn @ point + own[:3]
        return pixel, jnp.linalg.norm(local) if model.lens.sees_sideways else local[2]

    over_cameras = jax.vmap(one, in_axes=(0, 0, None))
    return jax.vmap(over_cameras, in_axes=(None, None, 0))(turned, rest, points)


def project(state: RigState) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (N, D, 2) and depths (N, D) of the points; distances where a lens sees more than what lies ahead."""
    pixels, depth = _project(CameraModel(state.lens), state.rotation, state.cameras[:, 3:], state.points)
    return np.asarray(pixels), np.asarray(depth)
