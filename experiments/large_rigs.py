"""Rigs of 20 to 48 cameras: do they come out right, and where does the time go?

`room` is as large as a published recording of insects in flight (20 cameras around a room, 1,079 frames, 8,043
observations, 1920 x 1200 px); in `corridor` each camera sees only its neighbours, in `hall` cameras around a large hall
look across it. A light is waved along the way, with 0.5 px of noise and 3 % gross outliers. `calibrate` sees the tracks
alone; the time is that of a process that has its programs already (each rig is calibrated twice, the second counts).
The reference is the last stage from the truth, as in `random_rooms.py`.

    python experiments/large_rigs.py --out large_rigs.md
    python experiments/large_rigs.py --layout hall --cameras 8 16 32 48 --out growth.md
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal

import jax
import numpy as np
import tyro
from jaxtyping import Float

from jaxpoint.calibration.alignment import umeyama
from jaxpoint.calibration.covariance import with_covariance
from jaxpoint.calibration.quality import assess
from jaxpoint.calibration.result import Calibration
from jaxpoint.calibration.selfcal import calibrate
from jaxpoint.config import CalibrateSettings
from jaxpoint.errors import JaxpointError
from jaxpoint.io.files import replacing
from jaxpoint.simulate.rooms import smooth_path
from jaxpoint.tracks import Tracks

Layout = Literal["room", "corridor", "hall"]
NOISE_PX, OUTLIERS = 0.5, 0.03
USUAL: dict[Layout, int] = {"room": 20, "corridor": 24, "hall": 48}


@dataclass(frozen=True)
class LargeRigs:
    """Calibrate rigs of many cameras."""

    layout: Layout | None = None
    """One of them; all if not given."""
    cameras: tuple[int, ...] = ()
    """Numbers of cameras; the usual one of a layout if not given."""
    seed: int = 0
    """Of the rigs."""
    out: Path = Path("large_rigs.md")
    """The table."""


@dataclass(frozen=True)
class Rig:
    """A recording and its true camera centres."""

    tracks: Tracks
    centres: Float[np.ndarray, "C 3"]  # m


@dataclass(frozen=True)
class Row:
    """One rig."""

    layout: str
    cameras: int
    frames: int
    observations: int
    pairs: int  # of cameras that share 20 frames
    seconds: float
    first_solution_s: float
    adjustment_s: float
    centres_mm: float | None  # rms after similarity
    extent_m: float
    good: bool
    remark: str = ""


def main(options: LargeRigs) -> None:
    """Calibrate, and write and print the table."""
    layouts = (options.layout,) if options.layout else tuple(USUAL)
    rows = []
    for layout in layouts:
        for cameras in options.cameras or (USUAL[layout],):
            rows.append(calibrated(layout, large_rig(layout, cameras, options.seed)))
            sys.stdout.write(f"{rows[-1]}\n")
            sys.stdout.flush()
    with replacing(options.out) as file:
        file.write(markdown(rows).encode())
    sys.stdout.write(markdown(rows))


def calibrated(layout: str, rig: Rig) -> Row:
    """The second of two calibrations, and how far the camera centres are off."""
    settings = CalibrateSettings()
    seen = rig.tracks.visible.astype(int)
    shared = np.triu(seen.T @ seen, 1)
    extent = float(np.linalg.norm(rig.centres[:, None] - rig.centres, axis=2).max())
    about = (layout, rig.tracks.cameras, rig.tracks.frames, int(seen.sum()), int((shared >= 20).sum()))
    try:
        calibrate(rig.tracks, settings)
        started = time.perf_counter()
        found = calibrate(rig.tracks, settings)
        seconds = time.perf_counter() - started
    except JaxpointError as error:
        return Row(*about, 0.0, 0.0, 0.0, None, extent, False, str(error))
    with jax.enable_x64(True):
        judged = assess(with_covariance(found), settings)
    off = None if len(found.rig) < len(rig.centres) else 1e3 * centre_error(rig, found)
    remark = "" if judged.failure is None else str(judged.failure)
    return Row(*about, seconds, found.seconds["init"], found.seconds["adjust"], off, extent, judged.passed, remark)


def centre_error(rig: Rig, found: Calibration) -> float:
    """Rms distance of the camera centres after the best similarity, m."""
    with jax.enable_x64(True):
        centres = np.asarray(found.rig.positions)
        fit = umeyama(centres, rig.centres, np.ones(len(centres)), False)
        return float(np.sqrt(((np.asarray(fit @ centres) - rig.centres) ** 2).sum(axis=1).mean()))


def large_rig(layout: Layout, cameras: int, seed: int) -> Rig:
    """A recording of one layout."""
    rng = np.random.default_rng([seed, cameras, len(layout)])
    centres, aims, low, high, frames, size, views = PLANS[layout](rng, cameras)
    focal = rng.uniform(0.6, 0.8, cameras) * size[0]
    k1 = rng.uniform(-0.2, 0.0, cameras)
    center = (np.array(size) - 1) / 2 + rng.normal(0.0, 0.01 * size[0], (cameras, 2))
    rotation = _looking(rng, centres, aims)
    light = _along(rng, layout, low, high, frames)
    local = np.einsum("cij,fcj->fci", rotation, light[:, None] - centres)
    plane = local[..., :2] / np.maximum(local[..., 2:], 1e-3)
    square = (plane**2).sum(axis=-1)
    pixels = focal[:, None] * plane * (1 + k1 * square + 0.8 * k1**2 * square**2)[..., None] + center
    inside = ((pixels >= 0) & (pixels <= np.array(size) - 1)).all(axis=-1)
    inside &= (local[..., 2] > 0.3) & (local[..., 2] < 9.0) & (square < 1.5)
    visible = inside & (rng.random(inside.shape) < views)
    wild = visible & (rng.random(inside.shape) < OUTLIERS)
    pixels = pixels + rng.normal(0.0, NOISE_PX, pixels.shape)
    pixels = np.where(wild[..., None], rng.uniform(0.0, np.array(size) - 1.0, pixels.shape), pixels)
    return Rig(Tracks.from_pixels(pixels, np.tile(size, (cameras, 1)), visible), centres)


def _room(rng: np.random.Generator, cameras: int):
    """Around the walls of 8 x 6 m; a light somewhere in the middle."""
    centres = _around(rng, cameras, 8.0, 6.0)
    aims = np.array([4.0, 3.0, 1.2]) + rng.normal(0.0, 0.4, (cameras, 3))
    return centres, aims, [2.0, 1.5, 0.3], [6.0, 4.5, 2.2], 1079, (1920, 1200), 0.42


def _corridor(rng: np.random.Generator, cameras: int):
    """2 m wide, a camera every 1.5 m on alternate sides, each looking ahead and across."""
    along = 1.5 * np.arange(cameras)
    side = np.where(np.arange(cameras) % 2 == 0, 0.1, 2.4)
    centres = np.stack([along, side, rng.uniform(2.2, 2.8, cameras)], axis=1)
    aims = np.stack([along + rng.uniform(1.5, 2.5, cameras), 2.5 - side, np.full(cameras, 1.0)], axis=1)
    return centres, aims, [0.0, 0.3, 0.3], [1.5 * cameras + 2.0, 2.2, 2.0], 120 * cameras, (1280, 720), 0.9


def _hall(rng: np.random.Generator, cameras: int):
    """Around a hall of 16 x 12 m, looking across its nearer half."""
    centres = _around(rng, cameras, 16.0, 12.0)
    middle = np.array([8.0, 6.0, 1.2])
    aims = centres + 0.5 * (middle - centres) + rng.normal(0.0, 1.0, (cameras, 3))
    aims[:, 2] = rng.uniform(0.8, 1.6, cameras)
    return centres, aims, [1.5, 1.5, 0.3], [14.5, 10.5, 2.2], 3000, (1280, 720), 0.8


PLANS = {"room": _room, "corridor": _corridor, "hall": _hall}


def _around(rng: np.random.Generator, cameras: int, length: float, width: float) -> np.ndarray:
    share = 2 * (length + width) * (np.arange(cameras) + rng.uniform(0.2, 0.8, cameras)) / cameras
    corners = np.cumsum([0.0, length, width, length, width])
    x = np.interp(share, corners, [0.0, length, length, 0.0, 0.0])
    y = np.interp(share, corners, [0.0, 0.0, width, width, 0.0])
    return np.stack([x, y, rng.uniform(2.0, 3.0, cameras)], axis=1)


def _looking(rng: np.random.Generator, centres: np.ndarray, aims: np.ndarray) -> np.ndarray:
    """cam_from_world of cameras that look from centres to aims, a little rolled."""
    forward = aims - centres
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    down, roll = np.cross(forward, right), rng.normal(0.0, 0.05, (len(centres), 1))
    x = np.cos(roll) * right + np.sin(roll) * down
    return np.stack([x, np.cross(forward, x), forward], axis=1)


def _along(rng: np.random.Generator, layout: Layout, low, high, frames: int) -> np.ndarray:
    """The waved light: through the whole volume, or once along a corridor."""
    knots = max(frames // 6, 6)
    places = rng.uniform(low, high, (knots, 3))
    if layout == "corridor":
        places[:, 0] = np.linspace(low[0], high[0], knots) + rng.normal(0.0, 0.8, knots)
    return smooth_path(places, frames)(np.arange(frames))


def markdown(rows: list[Row]) -> str:
    """The table."""
    names = [field.name for field in fields(Row)]
    cells = [[_cell(getattr(row, name)) for name in names] for row in rows]
    lines = [names, ["---"] * len(names), *cells]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def _cell(value: object) -> str:
    return f"{value:.1f}" if isinstance(value, float) else "" if value is None else str(value)


if __name__ == "__main__":
    main(tyro.cli(LargeRigs, description=__doc__))
