"""Do the readout times of rolling shutters come back, and does the error fall to that of global shutters?

Random rooms of 4 to 6 cameras with 0.5 px of noise, 5 % gross outliers and 60 to 100 % visibility, each recorded three
times with the same noise: with global shutters; with rolling ones that take 0.3 to 0.9 frame from the first image row
to the last, a quarter of them from below; and with these, out of step by up to a frame. `check` (pairs of cameras
alone) and `calibrate` must warn of the second, and not of the first. The light goes to a random place in the room every
`stride` frames: 24 is a brisk wave (about 20 px a frame), 12 a hasty one (35 px), 6 a wild one (70 px).

    python experiments/readout_times.py --seeds 0 24 --out readout_times.md
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from rich.progress import track

from jaxpoint.calibration.clocks import survey_clocks
from jaxpoint.calibration.covariance import with_covariance
from jaxpoint.calibration.quality import assess
from jaxpoint.calibration.readout_search import survey_readouts
from jaxpoint.calibration.result import Calibration
from jaxpoint.calibration.selfcal import calibrate
from jaxpoint.config import CalibrateSettings, EpipolarSettings
from jaxpoint.errors import JaxpointError
from jaxpoint.report.advice import on_readouts
from jaxpoint.simulate.rooms import RandomRoom, random_room
from time_offsets import centres_mm, mean_px

TARGET = 0.05  # error of a readout time, over that time
TARGET_ERROR = 1.05  # times that of global shutters


@dataclass(frozen=True)
class ReadoutTimes:
    """Calibrate simulated rooms whose cameras have rolling shutters."""

    seeds: tuple[int, int] = (0, 24)
    """First seed of a room, and one past the last."""
    out: Path = Path("readout_times.md")
    """The table, as Markdown."""
    stride: int = 24
    """Frames between the random places through which the light is waved."""
    frames: int = 600
    """Frames of every recording."""
    out_of_step: bool = True
    """Also solve the rooms whose cameras are out of step."""


@dataclass(frozen=True)
class Solved:
    """What one calibration reached."""

    relative: tuple[float, ...]  # error of every readout time, over that time
    in_sigmas: tuple[float, ...]  # error of every readout time over its predicted standard deviation
    mean_px: float
    centres_mm: float

    @property
    def worst(self) -> float:
        """Largest error of a readout time, over that time."""
        return max(self.relative)


@dataclass(frozen=True)
class Row:
    """One room; what ends in an error is None."""

    seed: int
    cameras: int
    usual: Solved | None  # global shutters
    plain: Solved | None  # rolling, not solved for
    found: Solved | None  # rolling, solved for
    late: Solved | None  # and out of step
    false_alarms: int  # of `check` and `calibrate`, of 2
    alarms: int


def main(options: ReadoutTimes) -> None:
    """Every room, then the table."""
    rows = []
    for seed in track(range(*options.seeds), "rooms"):
        rows.append(solved(seed, options))
        options.out.write_text(markdown(rows))
    sys.stdout.write(options.out.read_text())


def solved(seed: int, options: ReadoutTimes) -> Row:
    """One room with global shutters and with rolling ones."""
    rng = np.random.default_rng([seed, 2])
    cameras = 4 + seed % 3
    readouts = rng.uniform(0.3, 0.9, cameras) * np.where(rng.random(cameras) < 0.25, -1.0, 1.0)
    late, visibility = rng.uniform(-1.0, 1.0, cameras), rng.uniform(0.6, 1.0)

    def room(rolling: np.ndarray | None, offsets: np.ndarray | None = None) -> RandomRoom:
        return random_room(
            seed, cameras=cameras, frames=options.frames, visibility=visibility, outliers=0.05, noise_px=0.5,
            stride=options.stride, time_offsets=offsets, readouts=rolling,
        )  # fmt: skip

    straight, rolling = room(None), room(readouts)
    usual, plain = (calibration_of(one, CalibrateSettings()) for one in (straight, rolling))
    found = calibration_of(rolling, CalibrateSettings(readout_times=True))
    both = room(readouts, late) if options.out_of_step else None
    all_times = CalibrateSettings(readout_times=True, time_offsets=True)
    return Row(
        seed,
        cameras,
        figures(usual, straight),
        figures(plain, rolling),
        figures(found, rolling),
        None if both is None else figures(calibration_of(both, all_times), both),
        warnings(straight, usual),
        warnings(rolling, plain),
    )


def calibration_of(room: RandomRoom, settings: CalibrateSettings) -> Calibration | None:
    """The calibration of a room's tracks, if there is one of all cameras."""
    try:
        found = with_covariance(calibrate(room.tracks, settings))
    except JaxpointError:
        return None
    return found if len(found.rig) == room.tracks.cameras else None


def figures(found: Calibration | None, room: RandomRoom) -> Solved | None:
    """What it reached, beside the truth."""
    if found is None:
        return None
    times = found.readout_times
    error = np.zeros(1) if times is None else times.frames - room.readouts
    relative = () if times is None else tuple(np.abs(error / room.readouts).tolist())
    in_sigmas = () if times is None else tuple((error / times.sigma).tolist())
    return Solved(relative, in_sigmas, mean_px(found), centres_mm(found, room))


def warnings(room: RandomRoom, found: Calibration | None) -> int:
    """Whether `check` warns of a rolling shutter, and whether a plain calibration does."""
    settings = EpipolarSettings()
    survey = survey_readouts(survey_clocks(room.tracks, settings, 0), room.tracks, settings, 0)
    causes = [] if found is None else [finding.cause for finding in assess(found, CalibrateSettings()).findings]
    return bool(list(on_readouts(survey.clocks))) + ("rolling shutter" in causes)


def markdown(rows: list[Row]) -> str:
    """One line a room, then what the targets are about."""
    header = ("seed", "cameras", "worst error, %", "out of step", "mean px: global", "rolling", "solved", "out of step",
              "centres mm: global", "rolling", "solved", "out of step")  # fmt: skip
    lines = [f"| {' | '.join(header)} |", "|---" * len(header) + "|"]
    for row in rows:
        all_four = (row.usual, row.plain, row.found, row.late)
        values = [100 * one.worst if one else None for one in (row.found, row.late)]
        values += [one.mean_px if one else None for one in all_four]
        values += [one.centres_mm if one else None for one in all_four]
        cells = ("-" if value is None else f"{value:.3g}" for value in values)
        lines.append(f"| {' | '.join((str(row.seed), str(row.cameras), *cells))} |")
    for name in ("plain", "found", "late"):
        lines += [
            "",
            *summary({"plain": "Not solved for", "found": "In step", "late": "Out of step"}[name], rows, name),
        ]
    lines += ["", f"Warnings of {2 * len(rows)}: {sum(row.alarms for row in rows)} with rolling shutters, "
              f"{sum(row.false_alarms for row in rows)} with global ones."]  # fmt: skip
    return "\n".join(lines) + "\n"


def summary(title: str, rows: list[Row], name: str) -> list[str]:
    """What one kind of calibration reached over all rooms."""
    pairs = [(row.usual, getattr(row, name)) for row in rows]
    pairs = [(usual, one) for usual, one in pairs if usual is not None and one is not None]
    if not pairs:
        return []
    ratio = [one.mean_px / usual.mean_px for usual, one in pairs]
    apart = [one.centres_mm / usual.centres_mm for usual, one in pairs]
    said = (
        f"{title}: {len(pairs)} of {len(rows)} rooms; mean error over that of global shutters: median "
        f"{np.median(ratio):.3f}, largest {np.max(ratio):.3f}, at most {TARGET_ERROR} in "
        f"{sum(value <= TARGET_ERROR for value in ratio)}; camera centres: median {np.median(apart):.2f}."
    )
    sigmas = np.abs(np.concatenate([one.in_sigmas for _, one in pairs]))
    if not len(sigmas):
        return [said]
    worst, each = [one.worst for _, one in pairs], np.concatenate([one.relative for _, one in pairs])
    return [
        said,
        f"Readout times within {TARGET:.0%}: all in {sum(value <= TARGET for value in worst)} rooms, "
        f"{np.mean(each <= TARGET):.0%} of {len(each)} cameras (median {np.median(each):.1%}); largest error of a "
        f"room: median {np.median(worst):.1%}, largest {np.max(worst):.1%}; within 3 predicted standard deviations: "
        f"{np.mean(sigmas <= 3):.0%} of {len(sigmas)}, within 2: {np.mean(sigmas <= 2):.0%}.",
    ]


if __name__ == "__main__":
    try:
        main(tyro.cli(ReadoutTimes, description=__doc__))
    except JaxpointError as error:
        sys.stderr.write(f"readout_times: {error}\n")
        sys.exit(error.exit_code)
