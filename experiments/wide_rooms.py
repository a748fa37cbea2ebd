"""Rooms watched through wide lenses, alone or among ordinary ones: what `random_rooms.py --rooms wide` draws.

3 to 10 cameras on the walls of a room of 6 x 5 x 3 m, 1280 x 960 px. Three rooms in five have lenses of 100 to 190
degrees only, the others mix these with ordinary ones of 60 degrees. A wide lens is equidistant, equisolid,
stereographic, or a polynomial in the angle; its image circle fills the height, the width or the diagonal. 300 frames of
a waved light, 0.3 to 1 px of noise, 60 to 100 % visibility, 5 % gross outliers of which a third lie along epipolar
curves. The projection is plain numpy, apart from jaxpoint's own: no exam of a code by itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.calibration.assembly import centre_rig
from jaxpoint.calibration.recording import Recording, RigState
from jaxpoint.camera.kannala_brandt import KannalaBrandt
from jaxpoint.camera.parameters import CENTER, COEFFICIENTS, FOCAL, size_of
from jaxpoint.simulate.rooms import MIN_SHARED, random_poses, waved_path
from jaxpoint.tracks import Tracks

SIZE_PX = np.array([1280, 960])
NEAR_M = 0.3  # what is nearer is not seen
OUTLIERS = 0.05
LAWS = ("equidistant", "equisolid", "stereographic", "polynomial")


@dataclass(frozen=True)
class RadialLens:
    """A lens whose radius depends on the angle alone."""

    law: str
    focal: float  # px
    bend: tuple[float, float]  # k1, k2 of a polynomial, or of an ordinary lens
    half_angle: float  # rad, of its image circle

    def radius(self, angle: np.ndarray) -> np.ndarray:
        """px from the principal point, of angles (rad) off the axis."""
        k1, k2 = self.bend
        if self.law == "ordinary":
            slope = np.tan(np.minimum(angle, 1.4))
            return self.focal * slope * (1 + k1 * slope**2 + k2 * slope**4)
        unit = {
            "equidistant": angle,
            "equisolid": 2 * np.sin(angle / 2),
            "stereographic": 2 * np.tan(np.minimum(angle, 3.0) / 2),
            "polynomial": angle * (1 + k1 * angle**2 + k2 * angle**4),
        }
        return self.focal * unit[self.law]


@dataclass(frozen=True)
class WideRoom:
    """A simulated recording and its truth. Arrays of C cameras and F frames; metres, pixels, world z up."""

    tracks: Tracks
    lenses: tuple[RadialLens, ...]
    center: Float[np.ndarray, "C 2"]  # px
    rotation: Float[np.ndarray, "C 3 3"]  # cam_from_world
    translation: Float[np.ndarray, "C 3"]  # m
    points: Float[np.ndarray, "F 3"]  # m
    is_outlier: Bool[np.ndarray, "F C"]
    is_epipolar: Bool[np.ndarray, "F C"]
    noise_px: float

    @property
    def positions(self) -> Float[np.ndarray, "C 3"]:
        """Camera centres in the world, m."""
        return -np.einsum("cji,cj->ci", self.rotation, self.translation)

    @property
    def lens_angles(self) -> str:
        """Law and angle (degrees) of every lens."""
        return " ".join(f"{lens.law} {np.rad2deg(2 * lens.half_angle):.0f}" for lens in self.lenses)


Parts: TypeAlias = tuple[tuple[RadialLens, ...], np.ndarray, np.ndarray, np.ndarray]  # of cameras, as in `WideRoom`


def wide_room(seed: int, *, cameras: int | None = None, frames: int = 300) -> WideRoom:
    """One random room; the same seed gives the same room.

    Raises:
        ValueError: no such room lets its cameras share enough frames.
    """
    rng = np.random.default_rng([seed, 190])
    count = int(rng.integers(3, 11)) if cameras is None else cameras
    mixed = rng.random() < 0.4
    for _ in range(1000):
        room = _draw(rng, count, frames, mixed)
        visible = room.tracks.visible
        shared = (visible[:, :, None] & visible[:, None, :]).sum(axis=0)
        np.fill_diagonal(shared, 0)
        if ((shared >= MIN_SHARED).sum(axis=1) >= 2).all():
            return room
    raise ValueError(f"No room with {count} cameras and {frames} frames lets every camera share {MIN_SHARED} frames.")


def _draw(rng: np.random.Generator, count: int, frames: int, mixed: bool) -> WideRoom:
    """One room, not yet checked for how much its cameras share."""
    lenses = [_wide_lens(rng) for _ in range(count)]
    if mixed:
        for camera in rng.choice(count, int(rng.integers(1, count)), replace=False):
            lenses[camera] = _ordinary_lens(rng)
    center = (SIZE_PX - 1) / 2 + rng.normal(0.0, 0.01 * SIZE_PX[0], (count, 2))
    rotation, translation = random_poses(rng, count, "around" if rng.random() < 0.6 else "wall")
    points = waved_path(rng, frames, 12)(np.arange(frames))
    noise, visibility = rng.uniform(0.3, 1.0), rng.uniform(0.6, 1.0)
    parts: Parts = (tuple(lenses), center, rotation, translation)
    exact, inside = seen(parts, points)
    visible = inside & (rng.random(inside.shape) < visibility)
    pixels = exact + rng.normal(0.0, noise, exact.shape)
    is_outlier = visible & (rng.random(visible.shape) < OUTLIERS)
    is_epipolar = is_outlier & (rng.random(visible.shape) < 1 / 3)
    positions = -np.einsum("cji,cj->ci", rotation, translation)
    for frame, camera in np.argwhere(is_outlier):
        others = np.flatnonzero(visible[frame] & (np.arange(count) != camera))
        along = bool(is_epipolar[frame, camera]) and len(others) > 0
        wrong = None
        if along:
            wrong = _along_curve(rng, parts, points[frame], positions[rng.choice(others)], camera, exact[frame, camera])
        is_epipolar[frame, camera] = wrong is not None
        pixels[frame, camera] = _anywhere(rng, exact[frame, camera], noise) if wrong is None else wrong
    tracks = Tracks.from_pixels(pixels, np.tile(SIZE_PX, (count, 1)), visible, times=np.arange(frames) / 25.0)
    return WideRoom(tracks, *parts, points, is_outlier, is_epipolar, float(noise))


def _wide_lens(rng: np.random.Generator) -> RadialLens:
    half = np.deg2rad(rng.uniform(100.0, 190.0)) / 2
    circle = rng.choice([SIZE_PX[1] / 2, SIZE_PX[0] / 2, np.hypot(*SIZE_PX) / 2])
    bend = (rng.uniform(-0.06, 0.03), rng.uniform(-0.003, 0.003))
    unit = RadialLens(str(rng.choice(LAWS)), 1.0, bend, half)
    return RadialLens(unit.law, circle / float(unit.radius(np.array(half))), bend, half)


def _ordinary_lens(rng: np.random.Generator) -> RadialLens:
    focal = SIZE_PX[0] / 2 / np.tan(np.deg2rad(rng.uniform(55.0, 65.0)) / 2)
    half = np.arctan(np.hypot(*SIZE_PX) / 2 / focal)
    return RadialLens("ordinary", focal, (rng.uniform(-0.15, 0.0), 0.0), half + 0.1)


def seen(parts: Parts, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Exact pixels (F, C, 2) of points (F, 3), and whether each lies in the image and its circle."""
    lenses, center, rotation, translation = parts
    local = np.einsum("cij,fj->fci", rotation, points) + translation
    across = np.linalg.norm(local[..., :2], axis=-1)
    angle = np.arctan2(across, local[..., 2])
    radius = np.stack([lens.radius(angle[:, camera]) for camera, lens in enumerate(lenses)], axis=1)
    pixels = local[..., :2] * (radius / np.maximum(across, 1e-12))[..., None] + center
    inside = ((pixels >= 0) & (pixels <= SIZE_PX - 1)).all(axis=-1)
    inside &= angle < [lens.half_angle for lens in lenses]
    return pixels, inside & (np.linalg.norm(local, axis=-1) > NEAR_M)


def _along_curve(rng, parts, point, source, camera, exact) -> np.ndarray | None:
    """A wrong pixel on the epipolar curve of the camera at `source`; None where none was found."""
    for _ in range(50):
        moved = source + (point - source) * np.exp(rng.normal(0.0, 0.4))
        pixels, inside = seen(parts, moved[None])
        if inside[0, camera] and np.linalg.norm(pixels[0, camera] - exact) > 10.0:
            return pixels[0, camera]
    return None


def _anywhere(rng, exact, noise) -> np.ndarray:
    """A wrong pixel, more than 10 `noise` off, inside the image."""
    while True:
        reach, turn = 10.5 * noise + rng.exponential(80.0), rng.uniform(0.0, 2 * np.pi)
        pixel = exact + reach * np.array([np.cos(turn), np.sin(turn)])
        if (pixel >= 0).all() and (pixel <= SIZE_PX - 1).all():
            return pixel


def true_fisheye_state(room: WideRoom, recording: Recording) -> RigState:
    """The truth as the adjustment sees it, every lens as the nearest fisheye of Kannala and Brandt."""
    count, size = recording.cameras, len(recording.image_sizes)
    base, numbers = np.tile(np.eye(3), (size, 1, 1)), np.zeros((size, size_of(KannalaBrandt)))
    points = np.zeros((len(recording.pixels), 3))
    base[:count], points[: recording.frames] = room.rotation, room.points
    numbers[:, FOCAL] = np.log(500.0)  # of the cameras that only fill up the arrays
    numbers[:count, 3:6], numbers[:count, CENTER] = room.translation, room.center
    for camera, lens in enumerate(room.lenses):
        angle = np.linspace(0.0, lens.half_angle, 200)[1:]
        powers = angle[:, None] ** np.array([1, 3, 5, 7, 9])
        found = np.linalg.lstsq(powers, lens.radius(angle), rcond=None)[0]
        numbers[camera, FOCAL], numbers[camera, COEFFICIENTS] = np.log(found[0]), found[1:] / found[0]
    return centre_rig(RigState(numbers, base, points, KannalaBrandt), recording.visible, count)
