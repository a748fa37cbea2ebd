"""Difficult rigs with known truth, a seed each: a layout, a fault at most two, and the same rig without the fault.

The layout is that of `seed % 8`, the first fault that of `seed % 11` (two of eleven have none, two have pixels that
are not square), so that 88 seeds in a row hold every pair once. A light walks smoothly through the space before the
cameras; they see it with 0.3 to 0.7 px of noise, 2 to 5 % gross outliers, and gaps. The control has the same cameras
but for the fault, the same light, noise, gaps and outliers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.interpolate import CubicSpline

from doubtful_rigs_cameras import Cameras
from doubtful_rigs_faults import LATEST, Fault, clocks, draw_faults, faulty_cameras
from doubtful_rigs_layouts import LAYOUTS, Layout, drawn_cameras
from jaxpoint.tracks import Tracks

FIRST = ("none", "aspect", "late", "crop", "none", "lens", "rate", "aspect", "frozen", "mirrored", "other room")
SIZES = ((1280, 720), (1920, 1080), (1024, 576), (640, 480))  # px
SHARED = 50  # frames that every camera has in common with two others at least
Path = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Rig:
    """One recording and its truth. C cameras, F frames; metres, pixels."""

    seed: int
    kind: str  # of layout
    layout: Layout
    faults: tuple[Fault, ...]
    cameras: Cameras
    tracks: Tracks
    light: Float[np.ndarray, "F 3"]  # on the clock of the cameras that are not late
    shown: Float[np.ndarray, "F C 3"]  # the light when each camera saw it; of a frozen camera as if it were not
    outliers: Bool[np.ndarray, "F C"]
    noise_px: float

    @property
    def clock_of_first(self) -> Float[np.ndarray, "F 3"]:
        """The light on the clock of the first camera, which counts where clocks are brought together."""
        return self.shown[:, 0]


@dataclass(frozen=True)
class _Drawn:
    """What rig and control have in common."""

    kind: str
    layout: Layout
    cameras: Cameras
    faults: tuple[Fault, ...]
    path: Path
    elsewhere: Path  # of another room
    frames: int
    noise_px: float
    noise: Float[np.ndarray, "F C 2"]  # px
    hidden: Bool[np.ndarray, "F C"]  # gaps
    outlier: Bool[np.ndarray, "F C"]
    astray: Float[np.ndarray, "F C 2"]  # px, of an outlier from where the light is
    frozen: Float[np.ndarray, "2"]  # place in the image, share of its size


def draw(seed: int) -> tuple[Rig, Rig]:
    """A rig and its control; the same seed gives the same two.

    Raises:
        ValueError: no attempt lets every camera share enough frames with two others.
    """
    for attempt in range(200):
        drawn = _draw(seed, np.random.default_rng([seed, attempt]))
        rig, control = _seen(seed, drawn, drawn.faults), _seen(seed, drawn, ())
        if _shares_enough(rig.tracks) and _shares_enough(control.tracks):
            return rig, control
    raise ValueError(f"200 attempts at seed {seed} share fewer than {SHARED} frames; take another seed.")


def _draw(seed: int, rng: np.random.Generator) -> _Drawn:
    kind = tuple(LAYOUTS)[seed % len(LAYOUTS)]
    count = drawn_cameras(rng, kind)
    layout = LAYOUTS[kind](rng, count)
    frames = _drawn_frames(rng, layout)
    noise_px, shape = float(rng.uniform(0.3, 0.7)), (frames, count)
    bearing = rng.uniform(0.0, 2 * np.pi, shape)
    reach = 15.0 + rng.exponential(80.0, shape)
    return _Drawn(
        kind,
        layout,
        _drawn_lenses(rng, layout),
        draw_faults(rng, FIRST[seed % len(FIRST)], count),
        _path(rng, layout, frames),
        _path(rng, layout, frames),
        frames,
        noise_px,
        rng.normal(0.0, noise_px, (*shape, 2)),
        _gaps(rng, shape),
        rng.random(shape) < rng.uniform(0.02, 0.05),
        reach[..., None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=-1),
        rng.uniform(0.1, 0.9, 2),
    )


def _drawn_frames(rng: np.random.Generator, layout: Layout) -> int:
    """300 to 512 in nine of ten, which share compiled programs; up to 900 in the others."""
    low, high = ((420, 513) if layout.walks else (300, 513)) if rng.random() < 0.9 else (513, 901)
    return int(rng.integers(low, high))


def _drawn_lenses(rng: np.random.Generator, layout: Layout) -> Cameras:
    """Cameras of one model or of several: fields of view, image sizes, mild distortion."""
    count, alike = len(layout.position), rng.random() < 0.5
    models = 1 if alike else count
    width = np.deg2rad(rng.uniform(*layout.width_deg, models))
    size = np.array(SIZES)[rng.integers(len(SIZES), size=models)]
    focal = size[:, 0] / 2 / np.tan(width / 2)
    radial = np.stack([_mild(rng, np.hypot(*own) / 2 / f) for own, f in zip(size, focal)])
    focal, size, radial = (np.repeat(part, count // models, axis=0) for part in (focal, size, radial))
    center = (size - 1) / 2 + rng.normal(0.0, 0.01, (count, 2)) * size[:, :1]
    square, plain = np.ones(count), np.zeros(count, bool)
    return Cameras(layout.rotation, layout.position, focal, square, center, radial, plain, size)


def _mild(rng: np.random.Generator, corner: float) -> Float[np.ndarray, "2"]:
    """k1 and k2: none in two of five lenses, else up to what moves the corner of the image by about 12 %."""
    if rng.random() < 0.4:
        return np.zeros(2)
    k1 = rng.uniform(-0.15, 0.04) / max(corner**2, 1.0)
    return np.array([k1, rng.uniform(0.5, 1.5) * k1**2])


def _path(rng: np.random.Generator, layout: Layout, frames: int) -> Path:
    """A smooth walk of the light (m) at any moments, in frames, also long before the first frame and after the last."""
    low, high = layout.box
    start, end = -LATEST - 20.0, 1.05 * frames + 20.0
    knots = round((end - start) / rng.uniform(18.0, 28.0))
    places = rng.uniform(low + 0.08 * (high - low), high - 0.08 * (high - low), (knots, 3))
    if layout.walks:
        there = np.abs(np.linspace(-3.0, 3.0, knots) % 2.0 - 1.0)
        places[:, 0] = low[0] + (high[0] - low[0]) * np.clip(there + rng.normal(0.0, 0.05, knots), 0.0, 1.0)
    spline = CubicSpline(np.linspace(start, end, knots), places)
    return lambda moments: np.clip(spline(moments), low - 0.2, high + 0.2)


def _gaps(rng: np.random.Generator, shape: tuple[int, int]) -> Bool[np.ndarray, "F C"]:
    """Stretches of 3 to 30 frames, and single frames, in which a camera loses the light."""
    frames, count = shape
    hidden = rng.random(shape) < 0.03
    for camera in range(count):
        for begin in rng.integers(frames, size=rng.integers(0, 1 + frames // 60)):
            hidden[begin : begin + rng.integers(3, 31), camera] = True
    return hidden


def _seen(seed: int, drawn: _Drawn, faults: tuple[Fault, ...]) -> Rig:
    cameras = faulty_cameras(drawn.cameras, faults)
    shown = drawn.path(clocks(faults, drawn.frames, len(cameras)))
    for fault in faults:
        if fault.kind == "other room":
            moments = np.arange(drawn.frames, dtype=float)
            shown[:, fault.cameras[0]] = drawn.elsewhere(moments)
    pixels = cameras.project(shown) + drawn.noise
    visible = cameras.sees(shown) & ~drawn.hidden
    visible &= np.linalg.norm(shown - cameras.position, axis=2) < drawn.layout.sees_m
    astray = pixels + drawn.astray
    outliers = visible & drawn.outlier & ((astray >= 0) & (astray <= cameras.size - 1)).all(axis=2)
    pixels = np.where(outliers[..., None], astray, pixels)
    pixels, visible = _spoilt(drawn, cameras, faults, pixels, visible)
    times = np.arange(drawn.frames) / 30.0
    tracks = Tracks.from_pixels(np.where(visible[..., None], pixels, np.nan), cameras.size, times=times)
    light = drawn.path(np.arange(drawn.frames, dtype=float))
    return Rig(seed, drawn.kind, drawn.layout, faults, cameras, tracks, light, shown, outliers, drawn.noise_px)


def _spoilt(drawn: _Drawn, cameras: Cameras, faults: tuple[Fault, ...], pixels, visible):
    """The frozen and the mirrored camera."""
    for fault in faults:
        own = fault.cameras[0]
        if fault.kind == "frozen":
            pixels[:, own] = drawn.frozen * (cameras.size[own] - 1) + drawn.noise[:, own]
            visible[:, own] = ~drawn.hidden[:, own]
        elif fault.kind == "mirrored":
            pixels[:, own, 0] = cameras.size[own, 0] - 1 - pixels[:, own, 0]
    return pixels, visible


def _shares_enough(tracks: Tracks) -> bool:
    shared = (tracks.visible[:, :, None] & tracks.visible[:, None, :]).sum(axis=0)
    np.fill_diagonal(shared, 0)
    return bool(((shared >= SHARED).sum(axis=1) >= 2).all())
