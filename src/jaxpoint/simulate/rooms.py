"""Random rooms watched by random cameras, and a light waved through them, with the truth known.

These rooms are what a self-calibration must survive: unlike lenses, strong distortion, gaps, gross outliers of which
some lie along epipolar lines and so are invisible to any pair of cameras.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.tracks import Tracks

ROOM_M = np.array([6.0, 5.0, 3.0])  # length, width, height of the room
IMAGE_PX = (1280, 720)
ROLLING_STEPS = 8  # to the moment at which a rolling shutter meets the light; each leaves a tenth of the error or less
MIN_SHARED = 30  # frames that every camera shares with at least two others


@dataclass(frozen=True)
class RandomRoom:
    """A simulated recording and its truth. Arrays of C cameras and F frames; metres, pixels, world z up."""

    tracks: Tracks
    focal: Float[np.ndarray, " C"]  # px
    center: Float[np.ndarray, "C 2"]  # px
    distortion: Float[np.ndarray, "C 5"]  # k1, k2, p1, p2, k3
    rotation: Float[np.ndarray, "C 3 3"]  # cam_from_world
    translation: Float[np.ndarray, "C 3"]  # m
    points: Float[np.ndarray, "F 3"]  # m
    is_outlier: Bool[np.ndarray, "F C"]
    is_epipolar: Bool[np.ndarray, "F C"]  # outliers that lie along the epipolar line of another camera
    noise_px: float
    time_offsets: Float[np.ndarray, " C"]  # frames: in frame f camera c shows where the light was at f - offset,
    readouts: Float[np.ndarray, " C"]  # frames from the first image row to the last, and its middle row then

    @property
    def positions(self) -> Float[np.ndarray, "C 3"]:
        """Camera centres in the world, m."""
        return -np.einsum("cji,cj->ci", self.rotation, self.translation)

    def seen(self, points: Float[np.ndarray, "N 3"]) -> tuple[Float[np.ndarray, "N C 2"], Bool[np.ndarray, "N C"]]:
        """Exact pixels of points (m), and whether each lies inside the image and the lens's range."""
        return _project((self.focal, self.center, self.distortion, self.rotation, self.translation), points)

    @property
    def rig(self):
        """The true cameras as a `CameraRig`."""
        from jaxpoint.camera.rig import CameraRig

        return CameraRig.from_parameters(
            np.repeat(self.focal[:, None], 2, axis=1),
            self.center,
            self.distortion,
            self.rotation,
            self.translation,
            self.tracks.image_sizes,
            self.tracks.names,
        )


def random_room(
    seed: int,
    *,
    cameras: int | None = None,
    frames: int = 300,
    layout: Literal["around", "wall"] | None = None,
    visibility: float | None = None,
    outliers: float | None = None,
    noise_px: float | None = None,
    stride: int = 6,
    time_offsets: Float[np.ndarray, " C"] | None = None,
    readouts: Float[np.ndarray, " C"] | None = None,
) -> RandomRoom:
    """One random room; what is not given is drawn from `seed`.

    Args:
        seed: the same seed and arguments give the same room.
        cameras: C, drawn from 3 to 12.
        frames: positions of the light.
        layout: cameras on all four walls, or on one.
        visibility: fraction of the sightings that are not lost, drawn from 0.4 to 1.
        outliers: fraction of gross outliers among the visible pixels, drawn from 0 to 0.1; a third lie along
            epipolar lines; all are displaced by more than 10 `noise_px`.
        noise_px: standard deviation of the noise of a pixel coordinate, drawn from 0.3 to 1.
        stride: frames between the random places in the room through which the light is waved. 6 is a wild wave, 70 px
            a frame; 24 a brisk one, 20 px.
        time_offsets: frames by which each of the cameras (their number must be given) shows the light late; `points`
            is the light on the common clock. All else of a room stays as its seed says.
        readouts: frames that each of the cameras (their number must be given) takes from its first image row to its
            last, as rolling shutters do; negative from below. The offset is then that of its middle row.
    """
    rng = np.random.default_rng(seed)
    count = int(rng.integers(3, 13)) if cameras is None else cameras
    layout = layout or ("around" if rng.random() < 0.5 else "wall")
    kept = rng.uniform(0.4, 1.0) if visibility is None else visibility
    outlier_share = rng.uniform(0.0, 0.1) if outliers is None else outliers
    noise = rng.uniform(0.3, 1.0) if noise_px is None else noise_px
    clocks = [np.zeros(count) if each is None else np.asarray(each, float) for each in (time_offsets, readouts)]
    for _ in range(1000):
        room = _draw(rng, count, (frames, stride), layout, kept, outlier_share, noise, clocks)
        shared = (room.tracks.visible[:, :, None] & room.tracks.visible[:, None, :]).sum(axis=0)
        np.fill_diagonal(shared, 0)
        if ((shared >= MIN_SHARED).sum(axis=1) >= 2).all():
            return room
    raise ValueError(
        f"No room with {count} cameras, {frames} frames and visibility {kept:.2f} lets every camera share "
        f"{MIN_SHARED} frames with two others; ask for more frames or a higher visibility."
    )


def _draw(rng, cameras, wave, layout, kept, outlier_share, noise, clocks) -> RandomRoom:
    """One room, not yet checked for how much its cameras share."""
    frames = wave[0]
    focal = rng.uniform(500.0, 1500.0, cameras)
    center = (np.array(IMAGE_PX) - 1) / 2 + rng.normal(0.0, 0.015 * IMAGE_PX[0], (cameras, 2))
    distortion = np.stack([_random_lens(rng, f) for f in focal])
    rotation, translation = random_poses(rng, cameras, layout)
    lens = (focal, center, distortion, rotation, translation)
    path = waved_path(rng, *wave)
    shown = _shown_to_each(lens, path, frames, *clocks)
    exact, in_view = _seen_by_each(lens, shown)
    visible = in_view & (rng.random(in_view.shape) < kept)
    pixels = exact + rng.normal(0.0, noise, exact.shape)
    is_outlier = visible & (rng.random(visible.shape) < outlier_share)
    is_epipolar = is_outlier & (rng.random(visible.shape) < 1 / 3)
    for frame, camera in np.argwhere(is_outlier):
        others = np.flatnonzero(visible[frame] & (np.arange(cameras) != camera))
        along = bool(is_epipolar[frame, camera]) and len(others) > 0
        is_epipolar[frame, camera] = along
        other = int(rng.choice(others)) if along else None
        pixels[frame, camera] = displaced_pixel(rng, lens, shown[frame], exact[frame, camera], camera, other, noise)
    sizes = np.tile(np.array(IMAGE_PX), (cameras, 1))
    tracks = Tracks.from_pixels(pixels, sizes, visible, times=np.arange(frames) / 25.0)
    return RandomRoom(tracks, *lens, path(np.arange(frames)), is_outlier, is_epipolar, float(noise), *clocks)


def _random_lens(rng, focal) -> np.ndarray:
    """Brown coefficients with k1 in -0.35..0.05 whose radial polynomial is monotone over the whole image."""
    k1 = rng.uniform(-0.35, 0.05)
    k2 = rng.uniform(0.5, 1.5) * k1**2
    corner = np.hypot(*IMAGE_PX) / 2 / focal
    reach = 2 / 3 * np.sqrt(1 / (3 * max(-k1, 1e-9)))  # largest distorted radius that k1 alone can produce
    if corner < 0.9 * reach and rng.random() < 0.5:
        k2 = 0.0
    return np.array([k1, k2, 0.0, 0.0, 0.0])


def random_poses(rng, cameras, layout) -> tuple[np.ndarray, np.ndarray]:
    """Cameras on the walls, 1.5 to 2.9 m up, looking near the middle of the room. Returns cam_from_world (R, t)."""
    share = (np.arange(cameras) + rng.uniform(0.1, 0.9, cameras)) / cameras
    if layout == "wall":
        ground = np.stack([share * ROOM_M[0], np.full(cameras, 0.1)], axis=1)
    else:
        ground = np.stack([_on_walls(s) for s in share])
    position = np.concatenate([ground, rng.uniform(1.5, 2.9, (cameras, 1))], axis=1)
    target = ROOM_M * [0.5, 0.5, 0.4] + rng.normal(0.0, [0.5, 0.4, 0.2], (cameras, 3))
    forward = target - position
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    down = np.cross(forward, right)
    roll = rng.normal(0.0, np.deg2rad(5.0), (cameras, 1))
    x = np.cos(roll) * right + np.sin(roll) * down
    rotation = np.stack([x, np.cross(forward, x), forward], axis=1)
    return rotation, -np.einsum("cij,cj->ci", rotation, position)


def _on_walls(share) -> np.ndarray:
    """The place on the ground plan at this share of the way around the four walls, m."""
    length, width, _ = ROOM_M
    along = share * 2 * (length + width)
    if along < length:
        return np.array([along, 0.1])
    if along < length + width:
        return np.array([length - 0.1, along - length])
    if along < 2 * length + width:
        return np.array([2 * length + width - along, width - 0.1])
    return np.array([0.1, 2 * (length + width) - along])


def waved_path(rng, frames, stride) -> Callable[[np.ndarray], np.ndarray]:
    """A smooth walk of a hand-held light through the room: places (m) at any moments, in frames."""
    knots = max(6, frames // stride)
    low, high = ROOM_M * 0.1, ROOM_M * [0.9, 0.9, 0.75]
    path = smooth_path(rng.uniform(low, high, (knots, 3)), frames)
    return lambda moments: np.clip(path(moments), 0.05, ROOM_M - 0.05)


def smooth_path(places: Float[np.ndarray, "K 3"], frames: int) -> Callable[[np.ndarray], np.ndarray]:
    """A smooth way through places, equally long from each to the next: where it is at any moments, in frames."""
    from scipy.interpolate import CubicSpline

    return CubicSpline(np.linspace(0.0, frames - 1.0, len(places)), places)


def _shown_to_each(lens, path, frames, offsets, readouts) -> np.ndarray:
    """Where the light is (F, C, 3) when each camera's shutter reaches the row in which it shows it."""
    middle = np.arange(frames)[:, None] - offsets
    shown = path(middle)
    for _ in range(ROLLING_STEPS if readouts.any() else 0):
        row = np.clip(_seen_by_each(lens, shown)[0][..., 1], 0.0, IMAGE_PX[1])
        shown = path(middle + readouts * (row / IMAGE_PX[1] - 0.5))
    return shown


def _seen_by_each(lens, shown) -> tuple[np.ndarray, np.ndarray]:
    """As `_project`, of the points (F, C, 3) that each camera shows."""
    each = [_project([part[c : c + 1] for part in lens], shown[:, c]) for c in range(shown.shape[1])]
    pixels, inside = zip(*each)
    return np.concatenate(pixels, axis=1), np.concatenate(inside, axis=1)


def _project(lens, points) -> tuple[np.ndarray, np.ndarray]:
    """Exact pixels (F, C, 2) of points (F, 3), and whether each lies inside the image and the lens's range."""
    focal, center, distortion, rotation, translation = lens
    local = np.einsum("cij,fj->fci", rotation, points) + translation
    depth = np.maximum(local[..., 2], 1e-3)
    plane = local[..., :2] / depth[..., None]
    square = (plane**2).sum(axis=-1)
    k1, k2 = distortion[:, 0], distortion[:, 1]
    slope = 1 + 3 * k1 * square + 5 * k2 * square**2
    pixels = focal[:, None] * plane * (1 + k1 * square + k2 * square**2)[..., None] + center
    inside = ((pixels >= 0) & (pixels <= np.array(IMAGE_PX) - 1)).all(axis=-1)
    # Beyond the first turning point the polynomial folds back and draws far points into the image.
    folded = _folds_before(k1, k2, square) | (slope <= 0.05)
    return pixels, inside & (local[..., 2] > 0.3) & ~folded


def _folds_before(k1, k2, square) -> np.ndarray:
    """Whether r -> r (1 + k1 r^2 + k2 r^4) turns back somewhere between the axis and this squared radius."""
    inner = np.minimum(np.where(k2 > 0, -0.3 * k1 / np.where(k2 > 0, k2, 1.0), np.inf), square)
    inner = np.maximum(inner, 0.0)
    return 1 + 3 * k1 * inner + 5 * k2 * inner**2 <= 0.05


def displaced_pixel(rng, lens, shown, exact, camera, other, noise) -> np.ndarray:
    """A grossly wrong pixel, more than 10 `noise` off: anywhere, or along the epipolar line of camera `other`.

    `shown` (C, 3) is what each camera shows.
    """
    size = np.array(IMAGE_PX, dtype=float)
    for _ in range(200):
        if other is None:
            reach = 10.5 * noise + rng.exponential(80.0)
            angle = rng.uniform(0.0, 2 * np.pi)
            pixel = exact + reach * np.array([np.cos(angle), np.sin(angle)])
        else:
            source = -lens[3][other].T @ lens[4][other]
            moved = source + (shown[other] - source) * np.exp(rng.normal(0.0, 0.4))
            pixels, in_view = _project(lens, moved[None])
            if not in_view[0, camera]:
                continue
            pixel = pixels[0, camera]
        if np.linalg.norm(pixel - exact) > 10 * noise and (pixel >= 0).all() and (pixel <= size - 1).all():
            return pixel
    return size - 1 - exact
