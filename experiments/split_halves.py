"""Is the stated uncertainty true on real recordings? Two calibrations from parts of each, held against each other.

First half against second, odd against even frames: the parts share no observation, so that their difference is a sample
of their errors. Given are the rms normalised difference of the two rigs (1 where the covariances are true) as
`jaxpoint diff` has it, and the lens models that the parts chose. Halves see other parts of the images and of the room:
what a lens model does not describe differs between them; between odd and even frames it does not.

    python experiments/split_halves.py DATA --out halves.md
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import jax
import numpy as np
import tyro

from jaxpoint import calibrate, read_tracks
from jaxpoint.calibration.covariance import with_covariance
from jaxpoint.calibration.difference import difference
from jaxpoint.calibration.result import Calibration
from jaxpoint.camera.parameters import COEFFICIENTS
from jaxpoint.camera.rig import CameraRig
from jaxpoint.config import CalibrateSettings, LensSettings
from jaxpoint.io.formats.caliscope_toml import read_camera_array
from jaxpoint.io.track_formats.caliscope_corners import read_caliscope_corners
from jaxpoint.tracks import Tracks

PLACES = 300


@dataclass(frozen=True)
class SplitHalves:
    """Compare calibrations from parts of real recordings."""

    data: Annotated[Path, tyro.conf.Positional]
    """Folder that holds the recordings."""
    only: str | None = None
    """One recording."""
    out: Path = Path("halves.md")
    """The table."""


@dataclass(frozen=True)
class Recording:
    """Tracks, and how they are calibrated."""

    tracks: Tracks
    settings: CalibrateSettings = field(default_factory=CalibrateSettings)
    lenses: CameraRig | None = None


def strawlab(data: Path) -> Recording:
    """Eleven cameras, a waved LED."""
    return Recording(read_tracks(data / "svoboda_strawlab2010"))


def arctic(data: Path) -> Recording:
    """Four cameras, a waved LED."""
    return Recording(read_tracks(data / "svoboda_arctic4", one_based=True))


def charuco(data: Path) -> Recording:
    """Corners of a board as single points, lenses known and held, cameras out of step."""
    folder = data / "caliscope_charuco4"
    board = read_caliscope_corners(folder / "calibration" / "extrinsic" / "CHARUCO" / "xy_CHARUCO.csv")
    theirs = read_camera_array(folder / "camera_array.toml").rig
    lenses = theirs.select([theirs.names.index(name) for name in board.names])
    settings = CalibrateSettings(lens=LensSettings(known="hold"), time_offsets=True)
    return Recording(board.without_targets(), settings, lenses)


RECORDINGS: dict[str, Callable[[Path], Recording]] = {
    "strawlab2010": strawlab,
    "arctic4": arctic,
    "caliscope_charuco4": charuco,
}


def main() -> int:
    """Run all recordings, printing each row as it comes."""
    options = tyro.cli(SplitHalves, description=__doc__)
    jax.config.update("jax_enable_x64", True)
    head = ("recording", "parts", "difference over what is allowed", "per camera", "lenses")
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for name, read in RECORDINGS.items():
        if options.only in (None, name):
            for row in compared(read(options.data)):
                lines.append(f"| {name} | {' | '.join(row)} |")
                sys.stdout.write(lines[-1] + "\n")
                sys.stdout.flush()
    options.out.write_text("\n".join(lines) + "\n")
    return 0


def compared(recording: Recording) -> Iterator[tuple[str, ...]]:
    """One row for each way to split."""
    frames = np.unique(recording.tracks.frame_ids)
    ids = recording.tracks.frame_ids
    middle = np.median(frames)
    splits = {"first and second half": np.asarray(ids < middle), "odd and even frames": np.asarray(ids % 2 == 1)}
    for what, first in splits.items():
        parts = [solved(recording, first), solved(recording, np.logical_not(first))]
        places = parts[0].points[parts[0].point_valid]
        places = places[np.linspace(0, len(places) - 1, PLACES).astype(int)]
        one, other = (part.camera_covariance for part in parts)
        assert one is not None
        assert other is not None
        apart = difference(parts[0].rig, parts[1].rig, places, (one, other))
        assert apart.allowed is not None
        each = " ".join(f"{ratio:.2f}" for ratio in apart.allowed.ratio)
        yield what, f"{apart.allowed.ratio_all:.2f}", each, " / ".join(chosen_terms(part) for part in parts)


def chosen_terms(found: Calibration) -> str:
    """The coefficients that were free in some camera."""
    assert found.freedom is not None
    names = found.rig.cameras.lens.coefficients
    free = np.atleast_1d(found.freedom.free[:, COEFFICIENTS].any(axis=0))
    return " ".join(coefficient.name for coefficient, used in zip(names, free) if used) or "held"


def solved(recording: Recording, mask: np.ndarray) -> Calibration:
    """The calibration of some frames, with its covariance."""
    tracks = recording.tracks.select_frames(np.flatnonzero(mask))
    return with_covariance(calibrate(tracks, recording.settings, intrinsics=recording.lenses))


if __name__ == "__main__":
    sys.exit(main())
