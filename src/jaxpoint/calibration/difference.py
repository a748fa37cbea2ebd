"""Two calibrations of one room against each other, and against what their uncertainties allow.

Two frames of one room differ by a similarity that means nothing. It is found as the one under which the cameras project
the same places to the same pixels, all cameras together: what a camera did relative to the others then remains, and
what all did together is gone (mrcal does the same for one camera, with its implied rotation). Each camera's weight
falls with its own difference (Geman and McClure 1987), so that a camera that was moved does not pull the others along.

Whether the rest is chance is asked free of any frame: with d the difference of all parameters and Q the sum of both
covariances, chi-square = d^T Q^-1 d, least over all similarities (Foerstner and Wrobel 2016, chapter 4). What one
camera adds to it when the others are known already is its own share (Baarda 1968, data snooping).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import block_diag
from scipy.stats import chi2

from jaxpoint.calibration.alignment import transformed_covariance, umeyama
from jaxpoint.calibration.expected import moved_by_cameras, parallax
from jaxpoint.calibration.gauge import FREEDOMS, centres_by_parameters, gauge_directions_of_cameras
from jaxpoint.calibration.middle import far_middle, near, rig_about
from jaxpoint.calibration.sight import centres, derivatives_perturbed, in_view, poses, project
from jaxpoint.camera.rig import CameraRig
from jaxpoint.errors import InsufficientDataError, UsageError
from jaxpoint.geometry import rotation as so3
from jaxpoint.geometry.pose import Similarity
from jaxpoint.triangulation import MIN_PARALLAX, triangulate

CHANCE = 1e-3  # a difference less probable than this is not chance
STANDS_OUT = 1.5  # a camera without which the rest differs so many times less is named
HELD = 1e-11  # of the largest variance: less is rounding
STEPS = 30  # of the alignment, at most
DEPTHS = (0.3, 0.5, 0.75, 1.0)  # of sampled places, in median distances between two cameras
FARTHER = (2.0, 4.0, 8.0, 16.0)  # for cameras side by side that see nothing together so near
PLACES = 400


@dataclass(frozen=True)
class Allowed:
    """What the uncertainties of both calibrations allow, one standard deviation each (root mean squares)."""

    pixels: Float[np.ndarray, " C"]  # px
    centres: Float[np.ndarray, " C"]  # unit of the first
    points: float  # unit of the first
    ratio: Float[np.ndarray, " C"]  # rms normalised difference of each camera, those known that are no culprits
    ratio_all: float  # of all cameras together
    chance_all: float  # probability of a larger one
    freedoms: int  # of its chi-square
    culprits: tuple[int, ...]  # cameras without which the others are alike, or far more so; worst first

    @property
    def consistent(self) -> bool:
        """Whether chance explains the difference of the calibrations."""
        return self.chance_all >= CHANCE


@dataclass(frozen=True)
class Difference:
    """The second calibration minus the first, over P places of the room; C cameras. Lengths in the first's unit."""

    first: CameraRig
    second: CameraRig  # in the first one's frame
    similarity: Similarity  # first from second
    places: Float[np.ndarray, "P 3"]
    seen: Bool[np.ndarray, "P C"]  # by both
    shifts: Float[np.ndarray, "P C 2"]  # px, of the places' projections
    moved: Float[np.ndarray, "P 3"]  # what the second triangulates from the first's projections, minus the places
    allowed: Allowed | None  # None where a covariance is missing

    @property
    def pixels(self) -> Float[np.ndarray, " C"]:
        """Root mean square shift in each camera, px; NaN where it sees none of the places."""
        return _rms(self.shifts, self.seen)

    @property
    def centres(self) -> Float[np.ndarray, " C"]:
        """Distance between the two centres of each camera."""
        return np.linalg.norm(centres(self.second) - centres(self.first), axis=1)

    @property
    def rotations(self) -> Float[np.ndarray, " C"]:
        """Angle between the two orientations of each camera, rad."""
        return np.linalg.norm(_parameters_apart(self.first, self.second)[:, :3], axis=1)

    @property
    def focals(self) -> Float[np.ndarray, " C"]:
        """Change of the focal length, mean of x and y, px."""
        return _parameters_apart(self.first, self.second)[:, 6:8].mean(axis=1)

    @property
    def points(self) -> float:
        """Root mean square distance between triangulated places."""
        return float(np.sqrt((self.moved**2).sum(axis=1).mean()))


def difference(
    first: CameraRig,
    second: CameraRig,
    places: Float[np.ndarray, "P 3"],
    covariances: tuple[Float[np.ndarray, "D D"], Float[np.ndarray, "D D"]] | None = None,
    align: bool = True,
) -> Difference:
    """Compare two rigs of the same cameras, in the same order.

    Args:
        places: of the room, in the frame of the first.
        covariances: of both, in the order of `Camera.perturbed`; their errors count as independent.
        align: False where both stand in one frame already; then that frame's own errors count too.

    Raises:
        InsufficientDataError: fewer than two cameras, or fewer than three places that two cameras of both rigs see.
        ValueError: the cameras differ.
        UsageError: the lenses are of different models.
    """
    if first.names != second.names:
        raise ValueError(f"The cameras differ: {list(first.names)} and {list(second.names)}; select alike.")
    for name, *kinds in zip(first.names, first.lens_models, second.lens_models):
        if kinds[0] is not kinds[1]:
            raise UsageError(
                f"The lenses of camera '{name}' are of different models, {kinds[0].name} and {kinds[1].name}; "
                "calibrate both with one --lens.distortion."
            )
    if align and len(first) < 2:
        raise InsufficientDataError("1 camera in common does not hold a frame; an alignment takes two or more.")
    with jax.enable_x64(True):
        seen = in_view(first, places)
        useful = _enough(first, places, seen)
        places, seen = places[useful], seen[useful]
        pixels, weights = project(first, places), np.ones(len(first))
        similarity = Similarity.identity()
        if align:
            similarity, weights = _align_rigs(first, second, places, seen, pixels)
        moved = second.transformed(similarity)
        seen = seen & in_view(moved, places)
        useful = _enough(first, places, seen)
        places, seen, pixels = places[useful], seen[useful], pixels[useful]
        again = np.asarray(triangulate(moved, pixels, seen, covariance=False).points)
        allowed = None
        if covariances is not None:
            joint = covariances[0] + transformed_covariance(covariances[1], moved, similarity)
            allowed = _allowed_difference(first, moved, joint, places, seen, weights if align else None)
        shifts = np.where(seen[..., None], project(moved, places) - pixels, 0.0)
        return Difference(first, moved, similarity, places, seen, shifts, again - places, allowed)


def sampled_places(rig: CameraRig) -> Float[np.ndarray, "P 3"]:
    """Places of a room of which no light tells: along the cameras' lines of sight, seen by two or more."""
    rotation, _ = poses(rig)
    origin = centres(rig)
    apart = np.linalg.norm(origin[:, None] - origin, axis=-1)[~np.eye(len(origin), dtype=bool)]
    focal, center = np.asarray(rig.cameras.focal), np.asarray(rig.cameras.center)
    unit = np.stack(np.meshgrid(*[(np.arange(8) + 0.5) / 8] * 2), axis=-1).reshape(-1, 2)
    plane = (unit * np.asarray(rig.image_sizes)[:, None] - 0.5 - center[:, None]) / focal[:, None]
    sight = np.concatenate([plane, np.ones((*plane.shape[:2], 1))], axis=2) @ rotation
    between = np.median(apart) if apart.size else 1.0
    for depths in (DEPTHS, FARTHER):
        places = (origin[:, None, None] + between * np.array(depths)[:, None] * sight[:, :, None]).reshape(-1, 3)
        useful = _usable(rig, places, in_view(rig, places))
        if useful.sum() >= PLACES / 4 or depths is FARTHER:
            break
    chosen = places[useful]
    return chosen[np.linspace(0, max(len(chosen) - 1, 0), min(PLACES, len(chosen))).astype(int)]


def _usable(rig: CameraRig, places: np.ndarray, seen: np.ndarray) -> Bool[np.ndarray, " P"]:
    """The places that two cameras see under an angle that fixes them."""
    return (seen.sum(axis=1) >= 2) & (parallax(rig, places, seen) >= MIN_PARALLAX)


def _enough(rig: CameraRig, places: np.ndarray, seen: np.ndarray) -> Bool[np.ndarray, " P"]:
    """`_usable`, or a refusal.

    Raises:
        InsufficientDataError: fewer than three.
    """
    enough = _usable(rig, places, seen)
    if enough.sum() < 3:
        raise InsufficientDataError(
            f"Only {enough.sum()} places of the room are seen by two cameras of both calibrations; 3 are needed. "
            "Are these calibrations of the same room?"
        )
    return enough


def _align_rigs(
    first: CameraRig, second: CameraRig, places: np.ndarray, seen: np.ndarray, pixels: np.ndarray
) -> tuple[Similarity, Float[np.ndarray, " C"]]:
    """The similarity under which the cameras project alike, and the weight that each camera had in it."""
    similarity = _start(first, second, places, seen, pixels)
    weights = np.ones(len(first))
    for _ in range(STEPS):
        moved = second.transformed(similarity)
        shifts = project(moved, places) - pixels
        errors = np.nan_to_num(_rms(shifts, seen), nan=0.0)
        usual = 2.0 * np.median(errors[seen.any(axis=0)]) + 1e-9
        weights = (1.0 + (errors / usual) ** 2) ** -2.0
        by_camera, _ = derivatives_perturbed(moved, places, seen)
        slopes = by_camera @ gauge_directions_of_cameras(moved)  # (P, C, 2, 7)
        pull = (weights[:, None, None] * slopes).reshape(-1, FREEDOMS)
        normal = pull.T @ slopes.reshape(-1, FREEDOMS)
        step = -np.linalg.solve(normal, pull.T @ np.where(seen[..., None], shifts, 0.0).ravel())
        turned = so3.exp(jnp.asarray(step[3:6]))
        similarity = Similarity(jnp.exp(step[6]), turned, jnp.asarray(step[:3])) @ similarity
        if np.abs(step).max() < 1e-12 * max(1.0, np.abs(places).max()):
            break
    return similarity, weights


def _start(first: CameraRig, second: CameraRig, places, seen, pixels) -> Similarity:
    """The best of the fits of points and centres by all cameras, and by all but one: one may have been moved."""
    here, there = centres(first), centres(second)
    best, least = Similarity.identity(), np.inf
    for left_out in range(-1, len(first) if len(first) > 2 else 0):
        kept = np.arange(len(first)) != left_out
        found = triangulate(second, pixels, seen & kept, covariance=False)
        known = np.asarray(found.valid)
        if known.sum() < 3:
            continue
        source = np.concatenate([there[kept], np.asarray(found.points)[known]])
        fit = umeyama(source, np.concatenate([here[kept], places[known]]))
        errors = _rms(project(second.transformed(fit), places) - pixels, seen)
        cost = float(np.nanmedian(errors))
        if cost < least:
            best, least = fit, cost
    if not np.isfinite(least):
        raise InsufficientDataError(
            "Fewer than 3 places of the first calibration can be triangulated in the second; are they of the same room?"
        )
    return best


def _parameters_apart(first: CameraRig, second: CameraRig) -> Float[np.ndarray, "C p"]:
    """The second's parameters minus the first's, in the order of `Camera.perturbed`."""
    (before, from_), (after, to) = poses(first), poses(second)
    with jax.enable_x64(True):
        turned = np.asarray(jax.vmap(so3.log)(jnp.asarray(after @ np.swapaxes(before, 1, 2))))
    one, other = first.cameras, second.cameras
    lens = np.asarray(other.lens.parameters) - np.asarray(one.lens.parameters)
    return np.concatenate([turned, to - from_, lens], axis=1)


def _allowed_difference(
    first: CameraRig, second: CameraRig, joint: np.ndarray, places: np.ndarray, seen: np.ndarray, weights
) -> Allowed:
    """What the sum of both covariances lets expect; `weights` are those of the alignment, None without one."""
    if (middle := far_middle(places)).any():
        second = rig_about(second, middle)
        first, joint = near(first, joint, middle)
        places = places - middle
    count, apart = len(first), _parameters_apart(first, second)
    by_camera, _ = derivatives_perturbed(first, places, seen)
    ways = gauge_directions_of_cameras(first).reshape(-1, FREEDOMS)
    held = joint if weights is None else _without_frame(joint, by_camera, ways, weights)
    blocks = held.reshape(count, first.camera_size, count, first.camera_size)
    pixel_variance = np.zeros((len(places), count))
    for c in range(count):
        rows = by_camera[:, c]
        pixel_variance[:, c] = np.einsum("pij,jk,pik->p", rows, blocks[c, :, c], rows)
    at_centres = centres_by_parameters(first)
    centre_variance = [np.trace(at_centres[c] @ blocks[c, :, c] @ at_centres[c].T) for c in range(count)]
    flat = moved_by_cameras(first, places, seen)[0].reshape(-1, len(held))
    point_variance = 3.0 * float(((flat @ held) * flat).sum(axis=1).mean())
    odd = _set_cameras_aside(apart, joint, ways if weights is not None else ways[:, :0])
    return Allowed(
        np.sqrt(pixel_variance.sum(axis=0) / np.maximum(seen.sum(axis=0), 1)),
        np.sqrt(np.maximum(centre_variance, 0.0)),
        float(np.sqrt(max(point_variance, 0.0))),
        *odd,
    )


def _set_cameras_aside(apart, joint, ways) -> tuple[np.ndarray, float, float, int, tuple[int, ...]]:
    """The last fields of `Allowed`: cameras are set aside, worst first, while that makes the rest far more alike."""
    count, size = apart.shape
    ways = ways.reshape(count, size, ways.shape[1])
    joint = joint.reshape(count, size, count, size)
    whole = rest = _squares(apart, joint, ways, range(count))
    kept, culprits = list(range(count)), []
    ratios = np.sqrt(rest.shares / rest.share_freedoms)
    while rest.chance < CHANCE and len(kept) > 2:
        worst = kept[int(np.argmax(rest.shares / rest.share_freedoms))]
        fewer = [c for c in kept if c != worst]
        left = _squares(apart, joint, ways, fewer)
        if left.ratio > rest.ratio / STANDS_OUT and left.chance < CHANCE:
            break
        ratios[worst] = np.sqrt(max(rest.whole - left.whole, 0.0) / max(rest.freedoms - left.freedoms, 1))
        ratios[fewer] = np.sqrt(left.shares / left.share_freedoms)
        kept, rest, culprits = fewer, left, [*culprits, worst]
    return ratios, whole.ratio, whole.chance, whole.freedoms, tuple(culprits)


def _without_frame(joint, by_camera, ways, weights) -> np.ndarray:
    """The covariance of differences after an alignment by projections: an S-transformation, see `uncertainty`."""
    count = len(weights)
    pull = np.einsum("c,pcij,cjk->pcik", weights, by_camera, ways.reshape(count, -1, FREEDOMS))
    of_parameters = np.einsum("pcik,pcij->kcj", pull, by_camera).reshape(FREEDOMS, -1)
    away = np.eye(len(joint)) - ways @ np.linalg.solve(of_parameters @ ways, of_parameters)
    return away @ joint @ away.T


class _Squares(NamedTuple):
    """Chi-square of some cameras, and what each of them adds to it when the others are known; C of them."""

    whole: float
    freedoms: int
    shares: Float[np.ndarray, " C"]
    share_freedoms: Float[np.ndarray, " C"]

    @property
    def chance(self) -> float:
        return float(chi2.sf(self.whole, max(self.freedoms, 1)))

    @property
    def ratio(self) -> float:
        return float(np.sqrt(self.whole / max(self.freedoms, 1)))


def _squares(apart, joint, ways, cameras: Sequence[int]) -> _Squares:
    """d^T Q^-1 d, least over the ways in which a frame may differ.

    Neither parameters that both calibrations held nor the ways themselves, which a free gauge leaves without variance,
    have a part. What is left when a camera goes is the inverse's block (Foerstner and Wrobel 2016, chapter 4).
    """
    bases = [_varying(joint[c, :, c]) for c in cameras]
    owner = np.repeat(np.arange(len(bases)), [basis.shape[1] for basis in bases])
    turned = block_diag(*bases).T  # (n, p C'), every camera by itself with unit variance
    covariance = turned @ joint[np.ix_(cameras, range(joint.shape[1]), cameras, range(joint.shape[3]))].reshape(
        turned.shape[1], -1
    ) @ turned.T  # fmt: skip
    away = turned @ apart[cameras].ravel()
    whole, _ = np.linalg.qr(turned @ ways[cameras].reshape(turned.shape[1], -1), mode="complete")
    rest = whole[:, ways.shape[2] :]
    inverse = rest @ np.linalg.solve(rest.T @ covariance @ rest, rest.T)
    pull, shares, freedoms = inverse @ away, [], []
    for c in range(len(bases)):
        block, along = inverse[np.ix_(owner == c, owner == c)], pull[owner == c]
        back = np.linalg.pinv(block, rcond=HELD, hermitian=True)
        shares.append(max(float(along @ back @ along), 0.0))
        freedoms.append(int(np.linalg.matrix_rank(block, rtol=HELD, hermitian=True)))
    return _Squares(float(away @ pull), rest.shape[1], np.array(shares), np.maximum(freedoms, 1))


def _varying(covariance: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p V"]:
    """Combinations of a camera's parameters that vary, each with unit variance: fx and fy may be one parameter."""
    scale = np.sqrt(np.diagonal(covariance))
    safe = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(safe, safe))
    varies = values > HELD * values.max()
    return (vectors / safe[:, None])[:, varies] / np.sqrt(values[varies])


def _rms(shifts: Float[np.ndarray, "P C 2"], seen: Bool[np.ndarray, "P C"]) -> Float[np.ndarray, " C"]:
    """Root mean square length in each camera; NaN where it sees nothing."""
    count = seen.sum(axis=0)
    total = np.where(seen, (shifts**2).sum(axis=-1), 0.0).sum(axis=0)
    return np.sqrt(np.where(count > 0, total / np.maximum(count, 1), np.nan))
