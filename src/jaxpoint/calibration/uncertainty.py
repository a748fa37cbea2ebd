"""How wrong a calibration may be; what follows for whatever is measured with it is in `propagation`.

The adjustment's normal equations at its optimum give the covariance of the cameras by their Schur complement, points
eliminated (Triggs et al. 2000, sections 6.1 and 9; Foerstner and Wrobel 2016, chapter 15). They leave the world frame
open: seven freedoms, a similarity. A covariance means something only once it is said what holds the frame (an
S-transformation, Baarda 1973; Triggs et al. 2000, section 9.2):

- `gauge = "free"`: inner constraints. The frame is the one that fits the true light and camera centres best. Of all
  frames this gives the smallest trace over points and camera centres (the norm: squared lengths, every point and every
  centre alike), whatever the frame and the unit.
- `gauge = "landmarks"`: the frame is the room's, as the weighted fit of `align_to_landmarks` finds it. The errors of
  the landmarks' known places and of their places as seen both move it.

Either is linear: e = d - G K u, where d is the error in any frame, G the seven directions in which a similarity moves
cameras or points, u = sum of w G^T d over the anchors, and K = (sum of w G^T G)^-1.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.special import exp1

from jaxpoint.calibration.bundle import CENTER, FOCAL, SIZE, BrownModel, to_blocks
from jaxpoint.calibration.hypotheses import known_numbers
from jaxpoint.calibration.recording import Freedom, Recording
from jaxpoint.calibration.result import Calibration
from jaxpoint.camera.camera import PARAMETERS, Camera
from jaxpoint.camera.rig import CameraRig
from jaxpoint.compilation import jit
from jaxpoint.errors import InsufficientDataError, UsageError
from jaxpoint.geometry import rotation as so3
from jaxpoint.geometry.arrays import AnyArray
from jaxpoint.geometry.linalg import symmetric_full, symmetric_inverse
from jaxpoint.triangulation import triangulate

MODEL = BrownModel()
FREEDOMS = 7  # of a similarity: translation, rotation vector (rad), log scale
NO_LOSS = 50.0  # (loss scale / sigma)^2 / 2 from which a robust loss costs less than 2 % and counts as none
MANY = 8  # clicked anchors are padded to multiples of this, so that few programs are compiled


class Uncertainty(eqx.Module):
    """What is known of a rig's error. C cameras, D = 15 C, F frames of the light; in the frame and unit of the rig."""

    rig: CameraRig
    covariance: Float[Array, "D D"]  # camera by camera, in the order of `Camera.perturbed`; held numbers have none
    point_covariance: Float[Array, "F 3 3"]  # of the light's points, each by itself; 0 where there is no point
    sigma_px: Float[Array, ""]  # standard deviation of one pixel coordinate
    gauge: str = eqx.field(static=True)  # what holds the frame: "free" or "landmarks"

    @property
    def camera_sigmas(self) -> Float[Array, "C 15"]:
        """One standard deviation of every number of every camera, in the order of `Camera.perturbed`."""
        return jnp.sqrt(jnp.maximum(jnp.diagonal(self.covariance), 0.0)).reshape(-1, PARAMETERS)

    @property
    def centre_covariance(self) -> Float[Array, "C 3 3"]:
        """Covariance of every camera's centre."""
        by_camera = jax.vmap(_centre_by_numbers)(self.rig.cameras)
        blocks = self.covariance.reshape(len(self.rig), PARAMETERS, len(self.rig), PARAMETERS)
        own = jnp.einsum("cpcq->cpq", blocks)
        return jnp.einsum("cip,cpq,cjq->cij", by_camera, own, by_camera)


class Anchors(eqx.Module):
    """What the room's frame hangs on: places known in metres, each with a standard deviation (m) per coordinate.

    An infinite one means: not known. F frames, C cameras, N clicked landmarks.
    """

    light: Float[np.ndarray, " F"]  # of the light in each frame
    centres: Float[np.ndarray, " C"]  # of the camera centres
    clicked: Float[np.ndarray, " N"]  # of points clicked in images
    pixels: Float[np.ndarray, "N C 2"]  # px, of the clicks; hidden ones never matter
    visible: Bool[np.ndarray, "N C"]
    click_sigma_px: float = 1.0  # standard deviation of one clicked coordinate


@runtime_checkable
class Clicks(Protocol):
    """Points clicked in images, as `LandmarkPixels` holds them."""

    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def pixels(self) -> Float[np.ndarray, "N C 2"]: ...
    @property
    def visible(self) -> Bool[np.ndarray, "N C"]: ...


def anchors_of(
    calibration: Calibration,
    names: Sequence[str],
    sigmas: Float[AnyArray, " N"],
    clicks: Clicks | None = None,
    click_sigma_px: float = 1.0,
) -> Anchors:
    """The anchors of an alignment by named landmarks, found as `jaxpoint.landmarks.locate` finds them.

    Args:
        names: a point of `clicks`, else a camera, else the number of a frame.
        sigmas: standard deviation of each landmark's coordinates, m, as given to `align_to_landmarks`.
        click_sigma_px: standard deviation of one clicked coordinate.

    Raises:
        InsufficientDataError: a name is none of these.
        ValueError: a sigma is not positive, or their number is another than that of the names.
    """
    sigmas = np.asarray(sigmas, np.float64)
    if sigmas.shape != (len(names),) or not (sigmas > 0).all():
        raise ValueError(f"{len(names)} landmarks need as many positive sigmas, not {sigmas.tolist()}.")
    tracks, clicked = calibration.tracks, () if clicks is None else clicks.names
    rows = {str(frame): i for i, frame in enumerate(tracks.frame_ids)}
    light, centres = np.full(tracks.frames, np.inf), np.full(tracks.cameras, np.inf)
    chosen: list[int] = []
    for i, name in enumerate(names):
        if name in clicked:
            chosen.append(i)
        elif name in tracks.names:
            centres[tracks.names.index(name)] = sigmas[i]
        elif name in rows and calibration.point_valid[rows[name]]:
            light[rows[name]] = sigmas[i]
        else:
            raise InsufficientDataError(f"'{name}' is no clicked point, camera or frame with a point; name another.")
    places = [clicked.index(names[i]) for i in chosen]
    pixels = np.zeros((0, tracks.cameras, 2)) if clicks is None else clicks.pixels[places]
    visible = np.zeros((0, tracks.cameras), bool) if clicks is None else clicks.visible[places]
    return Anchors(light, centres, sigmas[chosen], pixels, visible, click_sigma_px)


def uncertainty_of(calibration: Calibration, anchors: Anchors | None = None) -> Uncertainty:
    """The uncertainty of a calibration as `calibrate` returned it, aligned with the room or not.

    Computed in float64 whatever JAX's global setting; use the result in float64 too.

    Args:
        anchors: what the alignment hung on (`anchors_of`): the room's frame then has its share in the uncertainty.
            Without them the gauge is free, in the frame and unit of the rig: shape alone is uncertain.

    Raises:
        UsageError: the calibration does not say which numbers were free (it was read from a file, or made by hand),
            or anchors are given for one that was not aligned by a weighted fit of points.
        InsufficientDataError: the observations leave more than a similarity undetermined, or fewer than three anchors
            hold the frame.
    """
    if calibration.freedom is None:
        raise UsageError(
            "This calibration does not say which of its numbers were free; calibrate again from its tracks."
        )
    if anchors is not None and (calibration.alignment is None or calibration.alignment.method == "floor"):
        raise UsageError("Anchors belong to a calibration aligned by landmarks or camera centres; align it so first.")
    with jax.enable_x64(True):
        return _uncertainty(calibration, calibration.freedom, anchors)


def _uncertainty(calibration: Calibration, freedom: Freedom, anchors: Anchors | None) -> Uncertainty:
    recording, rig, cameras = Recording.of(calibration.tracks), calibration.rig, calibration.tracks.cameras
    weighed = freedom.at_noise(calibration.sigma_px)
    network = _network(recording, rig, calibration, weighed)
    anchoring = _inner(recording, calibration) if anchors is None else _outer(recording, calibration, anchors)
    found = _adjusted(network, anchoring, jnp.asarray(variance_px2(calibration)))
    if not bool(jnp.isfinite(found.cameras).all()):
        raise InsufficientDataError(
            "The observations (or the anchors of the frame) do not determine the rig: its covariance is not finite. "
            "Wave the light through more of every camera's view, or name three landmarks or more off one line."
        )
    size, kept = SIZE * cameras, slice(0, calibration.tracks.frames)
    to_perturbed = jnp.asarray(_perturbed_by_numbers(rig))
    covariance = (to_perturbed @ found.cameras[:size, :size]) @ to_perturbed.T
    points = np.moveaxis(np.asarray(found.points), -1, 1).reshape(-1, 3, 3)[kept]
    valid = calibration.point_valid[:, None, None]
    gauge = "free" if anchors is None else "landmarks"
    return Uncertainty(
        rig, covariance, jnp.asarray(np.where(valid, points, 0.0)), jnp.asarray(calibration.sigma_px), gauge
    )


def variance_px2(calibration: Calibration) -> float:
    """The variance (px^2) by which the inverse of J^T J, every believed observation weighing alike, is to be scaled.

    For least squares that of a pixel coordinate. A robust loss pays for its insurance with a larger one: with weights
    w = 1 / (1 + r^2 / c^2) of residuals of two normal coordinates the sandwich of an M-estimator comes to
    E[w^2 r^2 / 2] over E[w^2]^2 (Huber 1981, chapter 7; the slope of w r is w^2 on average over directions), 1.09 times
    the variance of least squares for c = 2 sigma. In simulation (6 cameras, 200 points, 100 recalibrations of either
    kind) squared errors of the shape were 1.08 to 1.12 times those of least squares. The inverse of the weighted
    J^T W J promises 1.22 times, Huber's estimate from the residuals themselves 0.93: points of few views absorb too
    much of those.
    """
    variance = calibration.sigma_px**2
    if calibration.loss_scale is None:
        return variance
    q = (calibration.loss_scale / calibration.sigma_px) ** 2 / 2.0
    if q > NO_LOSS:
        return variance
    weight = float(q * np.exp(q) * exp1(q))  # E[w]
    square = q * (1.0 - weight)  # E[w^2]
    return variance * q * (weight - square) / square**2


class Network(eqx.Module):
    """An adjustment at its optimum, padded: C cameras, points in NB blocks of B."""

    base: Float[Array, "C 3 3"]  # cam_from_world
    numbers: Float[Array, "C 15"]  # as `bundle` orders them, the rotation vectors at zero
    points: Float[Array, "NB 3 B"]
    seen: Bool[Array, "NB C B"]
    free: Bool[Array, "C 15"]
    prior: Float[Array, "C 15"]  # px^2 per unit^2


class Anchoring(eqx.Module):
    """What holds the frame, padded: weights of the sum u, and the variances that the known places add."""

    light: Float[Array, "NB B"]  # weights
    centres: Float[Array, " C"]
    clicked: Float[Array, " N"]
    places: Float[Array, "3 N"]  # of the clicked
    visible: Bool[Array, "C N"]
    click_variance: Float[Array, ""]  # px^2
    measured: Float[Array, ""]  # 1 where the weights are 1 / sigma^2 of known places, 0 where nothing was measured


class Adjusted(NamedTuple):
    """Covariances in the frame that the anchors hold."""

    cameras: Float[Array, "D D"]  # as `bundle` orders the numbers
    points: Float[Array, "NB 3 3 B"]


def _network(recording: Recording, rig: CameraRig, calibration: Calibration, freedom: Freedom) -> Network:
    size, count = len(recording.image_sizes), recording.cameras
    base, numbers = np.tile(np.eye(3), (size, 1, 1)), np.zeros((size, SIZE))
    base[:count] = rig.cameras.cam_from_world.rotation
    numbers[:count, 3:6] = rig.cameras.cam_from_world.translation
    numbers[:count, FOCAL:] = known_numbers(rig)
    free, prior = np.zeros((size, SIZE), bool), np.zeros((size, SIZE))
    free[:count], prior[:count] = freedom.free[:count], freedom.prior_weight[:count]
    points, seen = np.zeros((len(recording.visible), 3)), np.zeros(recording.visible.shape, bool)
    points[: recording.frames] = calibration.points
    seen[: recording.frames, :count] = calibration.kept & calibration.point_valid[:, None]
    blocks = jnp.asarray(to_blocks(points)), jnp.asarray(to_blocks(seen))
    return Network(jnp.asarray(base), jnp.asarray(numbers), *blocks, jnp.asarray(free), jnp.asarray(prior))


def _inner(recording: Recording, calibration: Calibration) -> Anchoring:
    """Every point of the light and every camera centre, alike."""
    light = np.zeros(len(recording.visible))
    light[: recording.frames] = calibration.point_valid
    return _anchoring(recording, light, recording.exists.astype(float), np.zeros(0), None, 0.0)


def _outer(recording: Recording, calibration: Calibration, anchors: Anchors) -> Anchoring:
    """The known places, weighted as `align_to_landmarks` weights them."""
    known = sum(int(np.isfinite(part).sum()) for part in (anchors.light, anchors.centres, anchors.clicked))
    if known < 3:
        raise InsufficientDataError(
            f"{known} anchors do not hold a frame; it takes three or more that are off one line."
        )
    light, centres = np.zeros(len(recording.visible)), np.zeros(len(recording.image_sizes))
    light[: recording.frames] = np.where(calibration.point_valid, anchors.light**-2.0, 0.0)
    centres[: recording.cameras] = anchors.centres**-2.0
    return _anchoring(recording, light, centres, anchors.clicked**-2.0, (calibration.rig, anchors), 1.0)


def _anchoring(recording, light, centres, clicked, found: tuple[CameraRig, Anchors] | None, measured) -> Anchoring:
    count, size = len(clicked), len(recording.image_sizes)
    total = -(-count // MANY) * MANY
    places, visible = np.zeros((3, total)), np.zeros((size, total), bool)
    if found is not None and count:
        rig, anchors = found
        places[:, :count] = np.asarray(triangulate(rig, anchors.pixels, anchors.visible).points).T
        visible[: recording.cameras, :count] = anchors.visible.T
    return Anchoring(
        jnp.asarray(to_blocks(light)),
        jnp.asarray(centres),
        jnp.asarray(np.pad(clicked, (0, total - count))),
        jnp.asarray(places),
        jnp.asarray(visible),
        jnp.asarray(0.0 if found is None else found[1].click_sigma_px ** 2),
        jnp.asarray(measured),
    )


def _perturbed_by_numbers(rig: CameraRig) -> Float[np.ndarray, "D D"]:
    """From the numbers of `bundle` to those of `Camera.perturbed`: log focal, log aspect become fx, fy."""
    focal = np.asarray(rig.cameras.focal)
    jacobian = np.tile(np.eye(PARAMETERS), (len(focal), 1, 1))
    jacobian[:, FOCAL : CENTER.start, FOCAL : CENTER.start] = np.stack(
        [np.stack([focal[:, 0], focal[:, 0]], axis=1), np.stack([focal[:, 1], np.zeros(len(focal))], axis=1)], axis=1
    )
    whole = np.zeros((len(focal), PARAMETERS, len(focal), PARAMETERS))
    each = np.arange(len(focal))
    whole[each, :, each] = jacobian
    return whole.reshape(PARAMETERS * len(focal), -1)


class _Eliminated(NamedTuple):
    """Points as the cameras move them: error of a point = `moved` times that of the cameras + own error."""

    cross: Float[Array, "B 3 D"]  # J_x^T J_c
    moved: Float[Array, "B 3 D"]
    own: Float[Array, "B 3 3"]  # covariance of the own error for pixels of variance 1
    cameras: Float[Array, "C 15 15"]  # sum of J_c^T J_c


def _eliminated(network: Network, points: Float[Array, "3 B"], seen: Bool[Array, "C B"]) -> _Eliminated:
    """A block of points, and what the cameras that see them say."""
    state = MODEL.state(network.numbers, network.base)
    nowhere = jnp.zeros(2, points.dtype)
    over_points = jax.vmap(lambda camera, point: MODEL.columns(camera, point, nowhere), (None, -1), -1)
    _, for_camera, for_point = jax.vmap(over_points, in_axes=(0, None))(state, points)
    by_camera = jnp.stack([jnp.stack(row) for row in for_camera])  # (2, 15, C, B)
    by_camera = jnp.where(seen[None, None] & network.free.T[None, :, :, None], by_camera, 0.0)
    by_point = jnp.where(seen[None, None], jnp.stack([jnp.stack(row) for row in for_point]), 0.0)
    normal = jnp.einsum("ricb,rjcb->ijb", by_point, by_point)
    inverse = symmetric_full(symmetric_inverse((*normal[0], normal[1, 1], normal[1, 2], normal[2, 2])))
    own = jnp.where(seen.sum(axis=0)[:, None, None] >= 2, inverse, 0.0)
    cross = jnp.einsum("ricb,rpcb->bicp", by_point, by_camera).reshape(points.shape[1], 3, -1)
    return _Eliminated(
        cross, -jnp.einsum("bij,bjd->bid", own, cross), own, jnp.einsum("rpcb,rqcb->cpq", by_camera, by_camera)
    )


class _Gauge(NamedTuple):
    """Sums over anchors: u = `of_cameras` times the cameras' error + own errors of covariance `own`."""

    of_cameras: Float[Array, "7 D"]
    own: Float[Array, "7 7"]
    normal: Float[Array, "7 7"]


def _anchor_sums(parts: _Eliminated, points: Float[Array, "3 B"], weights: Float[Array, " B"], variance) -> _Gauge:
    """The share of a block of points in u; `variance` (px^2) is that of the pixels from which they come."""
    ways = jax.vmap(_point_ways, in_axes=-1)(points)
    pull = weights[:, None, None] * ways
    return _Gauge(
        jnp.einsum("bik,bid->kd", pull, parts.moved),
        variance * jnp.einsum("bik,bij,bjl->kl", pull, parts.own, pull),
        jnp.einsum("bik,bil->kl", pull, ways),
    )


def _point_ways(point: Float[Array, "3"]) -> Float[Array, "3 7"]:
    """How the seven freedoms of a similarity move a point."""
    return jnp.concatenate([jnp.eye(3, dtype=point.dtype), -so3.skew(point), point[:, None]], axis=1)


def _camera_ways(base: Float[Array, "3 3"], numbers: Float[Array, "15"]) -> Float[Array, "15 7"]:
    """How they move a camera's numbers so that no pixel changes: w = -R phi, dt = t scale - R shift."""
    ways = jnp.zeros((SIZE, FREEDOMS), base.dtype)
    return ways.at[:3, 3:6].set(-base).at[3:6, :3].set(-base).at[3:6, 6].set(numbers[3:6])


def _centre_by_pose(base: Float[Array, "3 3"], translation: Float[Array, "3"]) -> Float[Array, "3 6"]:
    """The centre is -R^T t: its change with w and dt is -R^T (dt + t x w)."""
    return jnp.concatenate([-base.T @ so3.skew(translation), -base.T], axis=1)


def _centre_by_numbers(camera: Camera) -> Float[Array, "3 15"]:
    pose = camera.cam_from_world
    return jnp.pad(_centre_by_pose(pose.rotation, pose.translation), ((0, 0), (0, PARAMETERS - 6)))


@jit
def _adjusted(network: Network, anchoring: Anchoring, variance: Float[Array, ""]) -> Adjusted:
    """Two passes over the points: one for the cameras and the frame, one for the points' own covariances."""
    count = network.numbers.shape[0]
    ways = jax.vmap(_camera_ways)(network.base, network.numbers).reshape(count * SIZE, FREEDOMS)
    own_blocks, taken, gauge = _sums(network, anchoring, variance)
    loose = variance * _any_frame(own_blocks, taken, network, ways)
    hold = jnp.linalg.inv(gauge.normal)
    own = gauge.own + anchoring.measured * gauge.normal
    with_u = loose @ gauge.of_cameras.T  # (D, 7)
    of_u = gauge.of_cameras @ with_u + own
    back = hold @ of_u @ hold

    def point_block(block) -> Float[Array, "3 3 B"]:
        points, seen, weights = block
        parts = _eliminated(network, points, seen)
        ways = jax.vmap(_point_ways, in_axes=-1)(points)
        inner = variance * parts.own
        spread = (parts.moved.reshape(-1, parts.moved.shape[2]) @ loose).reshape(parts.moved.shape)
        plain = jnp.einsum("bid,bjd->bij", spread, parts.moved) + inner
        link = parts.moved @ with_u + weights[:, None, None] * (inner @ ways)
        return _held(plain, link, ways, hold, back).transpose(1, 2, 0)

    blocks = (network.points, network.seen, anchoring.light)
    return Adjusted(_held(loose, with_u, ways, hold, back), jax.lax.map(point_block, blocks))


def _held(plain, link, ways, hold, back):
    """Covariance of d - G K u from those of d, of d with u, and K Cov(u) K."""
    turned = jnp.swapaxes(ways, -1, -2)
    mixed = (link @ hold) @ turned
    return plain - mixed - jnp.swapaxes(mixed, -1, -2) + (ways @ back) @ turned


def _sums(network: Network, anchoring: Anchoring, variance) -> tuple[Array, Array, _Gauge]:
    """Camera blocks (C, 15, 15), what eliminating the points takes from them (D, D), and the sums over anchors."""

    def add(total, block):
        points, seen, weights = block
        parts = _eliminated(network, points, seen)
        size = parts.cross.shape[2]
        taken = parts.cross.reshape(-1, size).T @ parts.moved.reshape(-1, size)
        new = (parts.cameras, taken, _anchor_sums(parts, points, weights, variance))
        return jax.tree.map(jnp.add, total, new), None

    count = network.numbers.shape[0]
    size, dtype = count * SIZE, network.numbers.dtype
    start = (jnp.zeros((count, SIZE, SIZE), dtype), jnp.zeros((size, size), dtype), _centre_sums(network, anchoring))
    if anchoring.clicked.shape[0]:
        parts = _eliminated(network, anchoring.places, anchoring.visible)
        clicked = _anchor_sums(parts, anchoring.places, anchoring.clicked, anchoring.click_variance)
        start = (*start[:2], jax.tree.map(jnp.add, start[2], clicked))
    blocks = (network.points, network.seen, anchoring.light)
    return jax.lax.scan(add, start, blocks)[0]


def _centre_sums(network: Network, anchoring: Anchoring) -> _Gauge:
    """The share of the camera centres in u; their error is the cameras' alone."""

    def one(base, numbers, weight):
        by_pose = _centre_by_pose(base, numbers[3:6])
        ways = _point_ways(-base.T @ numbers[3:6])
        of_pose = weight * (ways.T @ by_pose)
        return jnp.pad(of_pose, ((0, 0), (0, SIZE - 6))), weight * (ways.T @ ways)

    of_cameras, normal = jax.vmap(one)(network.base, network.numbers, anchoring.centres)
    of_cameras = jnp.where(network.free[:, None], of_cameras, 0.0)
    return _Gauge(of_cameras.transpose(1, 0, 2).reshape(FREEDOMS, -1), jnp.zeros_like(normal[0]), normal.sum(axis=0))


def _any_frame(own_blocks, taken, network: Network, ways: Float[Array, "D 7"]) -> Float[Array, "D D"]:
    """A covariance of the cameras, for pixels of variance 1, in some frame: an inverse but for the seven freedoms."""
    count = own_blocks.shape[0]
    prior = jnp.where(network.free, network.prior, 0.0)
    diagonal = jnp.diagonal(own_blocks, axis1=1, axis2=2) + prior
    held = (diagonal <= 0).reshape(-1)
    scale = jnp.sqrt(jnp.where(held, 1.0, diagonal.reshape(-1)))
    each = jnp.arange(count)
    matrix = taken.reshape(count, SIZE, count, SIZE).at[each, :, each].add(own_blocks)
    matrix = matrix.reshape(scale.shape[0], -1) + jnp.diag(prior.reshape(-1))
    matrix = matrix / (scale[:, None] * scale[None, :]) + jnp.diag(held.astype(scale.dtype))
    open_ways, _ = jnp.linalg.qr(jnp.where(held[:, None], 0.0, ways * scale[:, None]))
    root = jax.scipy.linalg.cho_factor(matrix + open_ways @ open_ways.T)
    inverse = jax.scipy.linalg.cho_solve(root, jnp.eye(scale.shape[0], dtype=scale.dtype))
    inverse = jnp.where(held[:, None] | held[None, :], 0.0, inverse)
    return inverse / (scale[:, None] * scale[None, :])
