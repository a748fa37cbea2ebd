"""The marker in the room: which regions of the views show it, its axis, and its tip on that axis (thesis 7.2).

The middles of the regions say which of them are one. The axis lies in the planes of all views; the tip is where the
views see its end on it. An end is the same point of a marker in every view only up to its thickness, which the thesis's
triangulated ends (7.2) leave out of account, and so a view counts by how squarely it sees the axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxpoint.body.limb_association import PLANE_ANGLE, common_point
from jaxpoint.body.limb_axis import LimbAxis, fit_axis
from jaxpoint.camera.rig import CameraRig
from jaxpoint.compilation import jit
from jaxpoint.config.person import MarkerSettings
from jaxpoint.evidence.marker_views import MarkerViews

SIGMA_PX = 0.5  # error of a marker's end across its axis: of a few pixels' mean
MOST_SIGMA = np.deg2rad(20.0)  # of a direction that is worth giving
BATCH = 64  # frames whose axes are fitted at once, so that one program does for all
TIP, BASE, CENTROID, PERSON = range(4)


class TipReason(IntEnum):
    """Whether the marker was found in the room, or why not."""

    FOUND = 0
    NO_AXIS = 1  # found, but its direction is not: its views lie in one plane with it, or it is a mere blob
    NO_VIEW = 2  # no view shows its colour
    ONE_VIEW = 3
    DISAGREE = 4  # no two views show it in one place
    TOO_LONG = 5  # what they show is larger than a marker


@dataclass(frozen=True)
class MarkerTip:
    """The marker in one frame. Zeros where it was not found, or has no axis."""

    reason: TipReason
    members: dict[int, int]  # by camera: which place of its `MarkerViews` is the marker
    flipped: tuple[int, ...] = ()  # cameras whose far end from the person is the base
    tip: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))  # m
    base: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))  # m
    spread: float = 0.0  # m, rms distance of the views' tips from the tip
    direction: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))  # unit, from base to tip
    direction_sigma: float = 0.0  # rad

    @property
    def found(self) -> bool:
        """Whether there is a tip."""
        return self.reason in (TipReason.FOUND, TipReason.NO_AXIS)


@dataclass(frozen=True)
class _Sights:
    """The n views of the marker in one frame."""

    cameras: list[int]
    origins: Float[np.ndarray, "n 3"]  # m
    rays: Float[np.ndarray, "n 4 3"]  # unit: to tip, base, centroid and person
    focal: Float[np.ndarray, " n"]  # px


def marker_tips(rig: CameraRig, markers: Sequence[MarkerViews], settings: MarkerSettings) -> list[MarkerTip]:
    """The marker at each of the frames. Float64: call it where JAX has 64 bits.

    Args:
        rig: the cameras, C of them, m.
        markers: what each of them saw.
        settings: of the marker.
    """
    rays = _all_rays(rig, markers)
    origins, focal = np.asarray(rig.positions), np.asarray(rig.cameras.focal).mean(axis=1)
    tips: list[MarkerTip] = []
    open_axes: list[tuple[int, _Sights, np.ndarray, np.ndarray]] = []
    for frame in range(len(markers[0].reasons)):
        places = [(camera, place) for camera, own in enumerate(markers) for place in own.of(frame)]
        reason, members = _members(places, rays, origins, settings)
        cameras = [camera for camera, _ in members]
        own = np.array([rays[camera][place] for camera, place in members]).reshape(-1, 4, 3)
        tips.append(MarkerTip(reason, dict(members)))
        if reason == TipReason.FOUND:
            sights = _Sights(cameras, origins[cameras], own, focal[cameras])
            direction = _common_direction(sights)
            if direction is None:
                tips[-1] = _without_axis(sights, dict(members))
            else:
                open_axes.append((frame, sights, *_rough(sights, direction)))
    for (frame, sights, _, _), axis in zip(
        open_axes, _fit_axes(rig, [one[1:] for one in open_axes], settings.max_length_m)
    ):
        members = tips[frame].members
        tip = _on_axis(sights, axis, members)
        tips[frame] = tip if tip.direction_sigma <= MOST_SIGMA else _without_axis(sights, members)
    return tips


def _all_rays(rig: CameraRig, markers: Sequence[MarkerViews]) -> list[Float[np.ndarray, "M 4 3"]]:
    """Unit rays of all places: to tip, base, centroid and person. Padded, so that few programs are compiled."""
    most = max(len(own.frame) for own in markers)
    padded = 64
    while padded < most:
        padded *= 4
    pixels = np.zeros((4, padded, len(markers), 2))
    for camera, own in enumerate(markers):
        pixels[:, : len(own.frame), camera] = (own.tip, own.base, own.centroid, own.person)
    directions = np.asarray(rig.rays(pixels).direction)
    return [directions[:, : len(own.frame), camera].swapaxes(0, 1) for camera, own in enumerate(markers)]


def _members(places, rays, origins, settings: MarkerSettings) -> tuple[TipReason, list[tuple[int, int]]]:
    """Which places are the marker, one a view: the small thing that the most views see in one place."""
    views = {camera for camera, _ in places}
    if len(views) < 2:
        return (TipReason.ONE_VIEW if views else TipReason.NO_VIEW), []
    reason = TipReason.DISAGREE
    while len({camera for camera, _ in places}) > 1:
        cameras = np.array([camera for camera, _ in places])
        directions = np.array([rays[camera][place] for camera, place in places])
        centers = directions[:, CENTROID]
        found = common_point(origins[cameras], centers, cameras, np.zeros(3), settings.agree_m)
        if found is None:
            break
        point, _, chosen = found
        distances = np.linalg.norm(point - origins[cameras[chosen]], axis=1)
        lengths = distances * np.linalg.norm(directions[chosen, TIP] - directions[chosen, BASE], axis=1)
        too_long = lengths > settings.max_length_m
        if not too_long.any():
            return TipReason.FOUND, [places[k] for k in chosen]
        reason = TipReason.TOO_LONG
        dropped = {chosen[k] for k in np.flatnonzero(too_long)}
        places = [place for k, place in enumerate(places) if k not in dropped]
    return reason, []


def _common_direction(sights: _Sights) -> Float[np.ndarray, "3"] | None:
    """Where the planes of the views' axes meet, pointing away from the person; None where they are hardly apart."""
    normal = np.cross(sights.rays[:, TIP], sights.rays[:, BASE])  # as long as the marker is seen: so it counts
    values, vectors = np.linalg.eigh(normal.T @ normal)
    unit = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    sine = np.linalg.norm(np.cross(unit[:, None], unit[None]), axis=2)
    if values[1] <= 0 or sine.max() < np.sin(PLANE_ANGLE):
        return None
    middle, person = (_meeting(sights.origins, sights.rays[:, k]) for k in (CENTROID, PERSON))
    direction = vectors[:, 0]
    return direction if direction @ (middle - person) > 0 else -direction


def _without_axis(sights: _Sights, members: dict[int, int]) -> MarkerTip:
    """The tip alone, where the far ends from the person meet."""
    tip, base = (_meeting(sights.origins, sights.rays[:, k]) for k in (TIP, BASE))
    return MarkerTip(TipReason.NO_AXIS, members, (), tip, base, _spread(sights, sights.rays[:, TIP], tip))


def _rough(sights: _Sights, direction: Float[np.ndarray, "3"]) -> tuple[np.ndarray, np.ndarray]:
    """First guess of the tip, and the direction."""
    tips, _ = _ends(sights, direction)
    return _meeting(sights.origins, tips), direction


def _ends(
    sights: _Sights, direction: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """Rays to the ends that lie ahead, and which views took them for the base."""
    flipped = (sights.rays[:, TIP] - sights.rays[:, BASE]) @ direction < 0
    return np.where(flipped[:, None], sights.rays[:, BASE], sights.rays[:, TIP]), flipped


def _fit_axes(
    rig: CameraRig, starts: Sequence[tuple[_Sights, np.ndarray, np.ndarray]], longest_m: float
) -> list[LimbAxis]:
    """The axes of all frames, in batches of one size."""
    axes: list[LimbAxis] = []
    for first in range(0, len(starts), BATCH):
        part = starts[first : first + BATCH]
        rays = np.zeros((BATCH, len(rig), 2, 3))
        rays[..., 2] = 1.0
        seen = np.zeros((BATCH, len(rig), 2), bool)
        tip, direction = np.zeros((BATCH, 3)), np.tile([1.0, 0.0, 0.0], (BATCH, 1))
        for k, (sights, start, ahead) in enumerate(part):
            rays[k, sights.cameras], seen[k, sights.cameras] = sights.rays[:, (TIP, BASE)], True
            tip[k], direction[k] = start, ahead
        fitted = jax.tree.map(np.asarray, _fit(rig, rays, seen, tip, direction, np.array([0.0, longest_m])))
        axes += [jax.tree.map(lambda leaf, k=k: leaf[k], fitted) for k in range(len(part))]
    return axes


@jit
def _fit(rig: CameraRig, rays: Array, seen: Array, tip: Array, direction: Array, span: Array) -> LimbAxis:
    origins, focal = rig.positions, rig.cameras.focal.mean(axis=1)
    sigma = 0.0 * focal + SIGMA_PX
    return jax.vmap(lambda r, s, t, d: fit_axis(origins, focal, r, s, t, d, sigma, span))(rays, seen, tip, direction)


def _on_axis(sights: _Sights, axis: LimbAxis, members: dict[int, int]) -> MarkerTip:
    """Tip and base where the views see the ends of the axis, squarely seen views first."""
    direction, near = np.asarray(axis.direction), np.asarray(axis.near)
    tips, flipped = _ends(sights, direction)
    bases = np.where(flipped[:, None], sights.rays[:, TIP], sights.rays[:, BASE])
    tip, base = (near + _along(sights, rays, near, direction) * direction for rays in (tips, bases))
    sigma = float(np.sqrt(np.trace(np.asarray(axis.direction_covariance))))
    turned = tuple(camera for camera, turn in zip(sights.cameras, flipped) if turn)
    return MarkerTip(TipReason.FOUND, members, turned, tip, base, _spread(sights, tips, tip), direction, sigma)


def _along(sights: _Sights, rays: Float[np.ndarray, "n 3"], near: np.ndarray, direction: np.ndarray) -> float:
    """How far along the axis from `near` the rays pass it, m, in the mean of the views."""
    gap = near - sights.origins
    cosine = rays @ direction
    sine2 = np.maximum(1 - cosine**2, 1e-6)
    places = (cosine * (gap * rays).sum(axis=1) - gap @ direction) / sine2
    weight = sine2 * (sights.focal / np.linalg.norm(gap, axis=1)) ** 2
    return float(weight @ places / weight.sum())


def _meeting(origins: Float[np.ndarray, "n 3"], rays: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "3"]:
    """The point nearest to all rays, m."""
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    return np.linalg.solve(across.sum(axis=0), np.einsum("nij,nj->i", across, origins))


def _spread(sights: _Sights, rays: Float[np.ndarray, "n 3"], point: Float[np.ndarray, "3"]) -> float:
    gap = point - sights.origins
    off = gap - (gap * rays).sum(axis=1)[:, None] * rays
    return float(np.sqrt((off**2).sum(axis=1).mean()))
