"""How true are lengths in a calibrated room? The thesis claims 2 cm (5.4).

Simulated rooms are calibrated from their light alone and brought to metres twice: by 6 landmarks clicked in the images,
and by the measured camera centres, both measured to 5 mm. Then come the edges of tables, 0.5 to 2 m long, none of whose
ends took part: clicked with 1 px of noise, triangulated, and held against their true lengths. Beside the mean error
stand what the clicks' noise predicts (`validate_lengths`; it takes rig and scale as exact), and what the same clicks
give with the true rig.

    python experiments/validation_lengths.py --seeds 0 20 --out lengths.md
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, fields
from pathlib import Path

import jax
import numpy as np
import tyro
from rich.progress import track

from jaxpoint.calibration.alignment import Alignment, align_to_camera_centres, align_to_landmarks, apply_alignment
from jaxpoint.calibration.result import Calibration
from jaxpoint.calibration.selfcal import calibrate
from jaxpoint.config import ValidateSettings
from jaxpoint.errors import JaxpointError
from jaxpoint.landmarks import LandmarkPixels, Landmarks, Lengths, locate
from jaxpoint.simulate.known import KnownRoom
from jaxpoint.simulate.rooms import ROOM_M, RandomRoom, random_room
from jaxpoint.triangulation import triangulate
from jaxpoint.validation import validate_lengths

CLICK_PX = 1.0
MEASURED_M = 0.005
EDGE_M = (0.5, 2.0)
TABLE_HEIGHT_M = (0.4, 1.1)
LANDMARKS = 6


@dataclass(frozen=True)
class ValidationLengths:
    """Measure the edges of tables in calibrated, simulated rooms."""

    seeds: tuple[int, int] = (0, 20)
    """First seed of a room, and one past the last."""
    out: Path = Path("validation_lengths.md")
    """The table, as Markdown."""
    lengths: int = 12
    """Edges in every room."""
    cameras: int | None = None
    """Cameras of every room; drawn from 3 to 12 if not given."""
    frames: int = 300
    """Positions of the light in every room."""


@dataclass(frozen=True)
class Row:
    """One room; mean absolute errors of its lengths, mm."""

    seed: int
    cameras: int
    layout: str
    noise_px: float
    lengths: int
    by_landmarks: float | None = None
    by_centres: float | None = None
    predicted: float | None = None
    true_rig: float | None = None
    remark: str = ""


def main(options: ValidationLengths) -> None:
    """Measure in every room, and write and print the table."""
    with jax.enable_x64(True):
        rows = [measured_room(seed, options) for seed in track(range(*options.seeds), "rooms")]
    text = markdown(rows)
    options.out.write_text(text)
    sys.stdout.write(text)


def measured_room(seed: int, options: ValidationLengths) -> Row:
    """Calibrate, align in both ways, and measure."""
    room = random_room(seed, cameras=options.cameras, frames=options.frames)
    known = furnished(room, seed, options.lengths)
    layout = "wall" if np.ptp(room.positions[:, 1]) < 1e-6 else "around"
    drawn = (seed, room.tracks.cameras, layout, room.noise_px, options.lengths)
    try:
        solved = calibrate(room.tracks)
        by_landmarks, by_centres = (
            validate_lengths(apply_alignment(solved, alignment), known.lengths, known.clicks, CLICK_PX)
            for alignment in (landmarks_alignment(solved, known), centres_alignment(solved, room, seed))
        )
    except JaxpointError as error:
        return Row(*drawn, true_rig=true_rig_error(known), remark=str(error))
    return Row(*drawn, by_landmarks.mean_mm, by_centres.mean_mm, by_landmarks.expected_mean_mm, true_rig_error(known))


def furnished(room: RandomRoom, seed: int, lengths: int) -> KnownRoom:
    """Landmarks and edges of tables within sight of three cameras (two where there are only three), and clicks."""
    rng = np.random.default_rng(seed)
    landmarks = seen_edges(room, rng, LANDMARKS)[:, 0]
    ends = seen_edges(room, rng, lengths)
    points = np.concatenate([landmarks, ends.reshape(-1, 3)])
    exact, visible = room.seen(points)
    names = tuple(f"landmark_{i}" for i in range(LANDMARKS)) + tuple(f"end_{i}" for i in range(2 * lengths))
    return KnownRoom(
        room,
        Landmarks(
            names[:LANDMARKS],
            landmarks + rng.normal(0.0, MEASURED_M, landmarks.shape),
            np.full(LANDMARKS, MEASURED_M),
        ),
        LandmarkPixels(
            names, np.where(visible[..., None], exact + rng.normal(0.0, CLICK_PX, exact.shape), 0.0), visible
        ),
        Lengths(
            tuple(f"edge_{i}" for i in range(lengths)),
            tuple((f"end_{2 * i}", f"end_{2 * i + 1}") for i in range(lengths)),
            np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1),
        ),
    )


def seen_edges(room: RandomRoom, rng: np.random.Generator, count: int) -> np.ndarray:
    """Both ends (count, 2, 3) of level edges in the room, m."""
    needed = min(3, room.tracks.cameras - 1)
    found = np.zeros((0, 2, 3))
    while len(found) < count:
        draws = 20 * count
        middle = rng.uniform(
            [0.5, 0.5, TABLE_HEIGHT_M[0]], [ROOM_M[0] - 0.5, ROOM_M[1] - 0.5, TABLE_HEIGHT_M[1]], (draws, 3)
        )
        angle = rng.uniform(0.0, np.pi, draws)
        half = rng.uniform(*EDGE_M, draws)[:, None] / 2 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
        ends = np.stack([middle - half, middle + half], axis=1)
        views = room.seen(ends.reshape(-1, 3))[1].sum(axis=1).reshape(-1, 2)
        inside = ((ends > 0.1) & (ends < ROOM_M - 0.1)).all(axis=(1, 2))
        found = np.concatenate([found, ends[inside & (views >= needed).all(axis=1)]])
    return found[:count]


def landmarks_alignment(solved: Calibration, known: KnownRoom) -> Alignment:
    """By the clicked landmarks."""
    names = known.landmarks.names
    points, _ = locate(solved, names, known.clicks)
    return align_to_landmarks(points, known.landmarks.points, known.landmarks.sigmas, names=names)


def centres_alignment(solved: Calibration, room: RandomRoom, seed: int) -> Alignment:
    """By the measured camera centres."""
    rng = np.random.default_rng([seed, 1])
    measured = room.positions + rng.normal(0.0, MEASURED_M, room.positions.shape)
    return align_to_camera_centres(np.asarray(solved.rig.positions), measured, names=room.tracks.names)


def true_rig_error(known: KnownRoom) -> float:
    """Mean absolute error (mm) of the lengths with the true rig: what the clicks alone spoil."""
    points = np.asarray(triangulate(known.room.rig, known.clicks.pixels, known.clicks.visible).points)
    ends = points[LANDMARKS:].reshape(-1, 2, 3)
    return float(1e3 * np.abs(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) - known.lengths.length_m).mean())


def markdown(rows: list[Row]) -> str:
    """A line for every room, and the mean of all."""
    names = [column.name for column in fields(Row)]
    measured = ("by_landmarks", "by_centres", "predicted", "true_rig")
    means = {name: _mean([getattr(row, name) for row in rows]) for name in measured}
    limit = ValidateSettings().max_mean_mm
    solved = [row for row in rows if row.by_landmarks is not None]
    within = sum(max(row.by_landmarks or 0.0, row.by_centres or 0.0) < limit for row in solved)
    lines = [names, ["---"] * len(names), *([_cell(getattr(row, name)) for name in names] for row in rows)]
    lines.append(["mean", *(_cell(means.get(name)) for name in names[1:])])
    table = "".join(f"| {' | '.join(line)} |\n" for line in lines)
    return f"{table}\nErrors in mm. Both mean errors are below {limit:g} mm in {within} of {len(rows)} rooms.\n"


def _mean(values: list[float | None]) -> float | None:
    present = [value for value in values if value is not None]
    return float(np.mean(present)) if present else None


def _cell(value: object) -> str:
    return "" if value is None else f"{value:.2f}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    main(tyro.cli(ValidationLengths, description=__doc__))
