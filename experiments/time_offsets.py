"""Do the time offsets of unsynchronised cameras come back, and does the error fall to that of cameras in step?

Random rooms of 4 to 6 cameras with 0.5 px of noise, 5 % gross outliers and 40 to 100 % visibility, each recorded twice:
in step, and with every camera up to 2 frames out of step. The light goes to a random place in the room every `stride`
frames: 24 is a brisk wave (about 20 px a frame), 12 a hasty one (35 px), 6 a wild one (70 px). The first recording is
calibrated as usual, the second with `time_offsets`; offsets are held against the truth relative to the first camera.

    python experiments/time_offsets.py --seeds 0 24 --out time_offsets.md
    python experiments/time_offsets.py --seeds 0 24 --stride 6 --out wild.md

With a recording instead, its offsets are solved for as it is, and with the pixels of every camera but the first put one
frame later in turn.

    python experiments/time_offsets.py --recording DATA/svoboda_arctic4 --out arctic4.md
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np
import tyro
from rich.progress import track

from jaxpoint.calibration.alignment import align_to_camera_centres
from jaxpoint.calibration.covariance import with_covariance
from jaxpoint.calibration.quality import assess
from jaxpoint.calibration.result import Calibration
from jaxpoint.calibration.selfcal import calibrate
from jaxpoint.config import CalibrateSettings
from jaxpoint.errors import JaxpointError
from jaxpoint.io.track_files import read_tracks
from jaxpoint.simulate.rooms import RandomRoom, random_room
from jaxpoint.tracks import Tracks

TARGET_FRAMES = 0.05
TARGET_ERROR = 1.05  # times that of the room in step


@dataclass(frozen=True)
class TimeOffsets:
    """Calibrate simulated rooms whose cameras are out of step."""

    seeds: tuple[int, int] = (0, 24)
    """First seed of a room, and one past the last."""
    out: Path = Path("time_offsets.md")
    """The table, as Markdown."""
    stride: int = 24
    """Frames between the random places through which the light is waved."""
    frames: int = 600
    """Frames of every recording."""
    outliers: float = 0.05
    """Fraction of gross outliers."""
    visibility: float | None = None
    """Fraction of the sightings that are not lost; drawn from 0.4 to 1 if not given."""
    largest: float = 2.0
    """Offsets are drawn from this many frames before to as many after."""
    recording: Path | None = None
    """Tracks of a real recording, instead of rooms."""


@dataclass(frozen=True)
class Row:
    """One room; what a room that ends in an error does not have is NaN."""

    seed: int
    cameras: int
    kept: float  # visibility
    verdict: str  # "ok", "gate" or the error
    seconds: float
    worst_frames: float = np.nan  # largest error of an offset
    in_sigmas: tuple[float, ...] = ()  # error of every offset over its predicted standard deviation
    mean_px: float = np.nan
    mean_in_step_px: float = np.nan
    centres_mm: float = np.nan
    centres_in_step_mm: float = np.nan

    @property
    def error_ratio(self) -> float:
        """Mean reprojection error over that of the room in step."""
        return self.mean_px / self.mean_in_step_px


def main(options: TimeOffsets) -> None:
    """Every room, then the table."""
    if options.recording is not None:
        options.out.write_text(real_offsets(read_tracks(options.recording)))
        sys.stdout.write(options.out.read_text())
        return
    rows = []
    for seed in track(range(*options.seeds), "rooms"):
        rows.append(solved(seed, options))
        options.out.write_text(markdown(rows))
    sys.stdout.write(options.out.read_text())


def solved(seed: int, options: TimeOffsets) -> Row:
    """One room in step and out of step."""
    rng = np.random.default_rng([seed, 1])
    cameras = 4 + seed % 3
    late = rng.uniform(-options.largest, options.largest, cameras)
    visibility = rng.uniform(0.4, 1.0) if options.visibility is None else options.visibility
    in_step, out_of_step = (
        random_room(
            seed,
            cameras=cameras,
            frames=options.frames,
            visibility=visibility,
            outliers=options.outliers,
            noise_px=0.5,
            stride=options.stride,
            time_offsets=offsets,
        )
        for offsets in (np.zeros(cameras), late)
    )
    start = time.perf_counter()
    settings = CalibrateSettings(time_offsets=True)
    try:
        found = calibrate(out_of_step.tracks, settings)
    except JaxpointError as error:
        return Row(seed, cameras, visibility, str(error), time.perf_counter() - start)
    seconds = time.perf_counter() - start
    usual = calibrate(in_step.tracks)
    offsets = found.time_offsets
    assert offsets is not None
    error = offsets.frames - (late - late[0])
    return Row(
        seed,
        cameras,
        visibility,
        "ok" if assess(with_covariance(found), settings).passed else "gate",
        seconds,
        float(np.abs(error).max()),
        tuple((error[1:] / offsets.sigma[1:]).tolist()),
        mean_px(found),
        mean_px(usual),
        centres_mm(found, out_of_step),
        centres_mm(usual, in_step),
    )


def real_offsets(tracks: Tracks) -> str:
    """The offsets of a recording as it is, and with one camera after the other put a frame later."""
    lines = [f"| put later | {' | '.join(tracks.names)} |", "|---" * (tracks.cameras + 1) + "|"]
    for camera in range(tracks.cameras):
        given = tracks if camera == 0 else a_frame_later(tracks, camera)
        late = calibrate(given, CalibrateSettings(time_offsets=True)).time_offsets
        assert late is not None
        cells = (f"{by:+.4f} ± {sure:.4f}" for by, sure in zip(late.frames, late.sigma))
        lines.append(f"| {'none' if camera == 0 else tracks.names[camera]} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def a_frame_later(tracks: Tracks, camera: int) -> Tracks:
    """The tracks of a camera that shows everything one row later."""
    pixels, visible = tracks.pixels.copy(), tracks.visible.copy()
    pixels[1:, camera], visible[1:, camera] = tracks.pixels[:-1, camera], tracks.visible[:-1, camera]
    visible[0, camera] = False
    return Tracks.from_pixels(pixels, tracks.image_sizes, visible, tracks.frame_ids, tracks.times, tracks.names)


def mean_px(calibration: Calibration) -> float:
    """Mean reprojection error of what was kept."""
    return float(calibration.errors[calibration.kept].mean())


def centres_mm(calibration: Calibration, room: RandomRoom) -> float:
    """Rms error of the camera centres after similarity."""
    with jax.enable_x64(True):
        return align_to_camera_centres(np.asarray(calibration.rig.positions), room.positions).rms_mm


def markdown(rows: list[Row]) -> str:
    """One line a room, then what the targets are about."""
    good = [row for row in rows if np.isfinite(row.worst_frames)]
    header = ("seed", "cameras", "seen", "verdict", "worst offset error, frames", "mean px", "in step", "centres mm",
              "in step", "s")  # fmt: skip
    lines = [f"| {' | '.join(header)} |", "|---" * len(header) + "|"]
    for row in rows:
        figures = (row.worst_frames, row.mean_px, row.mean_in_step_px, row.centres_mm, row.centres_in_step_mm)
        cells = (str(row.seed), str(row.cameras), f"{row.kept:.0%}", row.verdict, *(f"{x:.3g}" for x in figures))
        lines.append(f"| {' | '.join((*cells, f'{row.seconds:.0f}'))} |")
    within = sum(row.worst_frames <= TARGET_FRAMES for row in good)
    level = sum(row.error_ratio <= TARGET_ERROR for row in good)
    lines += ["", f"All offsets within {TARGET_FRAMES} frame: {within} of {len(rows)} rooms."]
    lines += [f"Mean error at most {TARGET_ERROR} times that in step: {level} of {len(rows)} rooms."]
    if good:
        worst, ratio = [row.worst_frames for row in good], [row.error_ratio for row in good]
        apart = [row.centres_mm / row.centres_in_step_mm for row in good]
        sigmas = np.abs(np.concatenate([row.in_sigmas for row in good]))
        wrong = sum(row.verdict == "ok" and row.worst_frames > TARGET_FRAMES for row in good)
        lines += [
            f"Worst offset error of a room: median {np.median(worst):.4f}, largest {np.max(worst):.4f} frames.",
            f"Mean error over that in step: median {np.median(ratio):.3f}, largest {np.max(ratio):.3f}.",
            f"Error of the camera centres over that in step: median {np.median(apart):.2f}.",
            f"Offsets within 2 predicted standard deviations: {np.mean(sigmas <= 2):.0%} of {len(sigmas)}.",
            f"Wrong offsets that no gate marked: {wrong} rooms.",
        ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    try:
        main(tyro.cli(TimeOffsets, description=__doc__))
    except JaxpointError as error:
        sys.stderr.write(f"time_offsets: {error}\n")
        sys.exit(error.exit_code)
