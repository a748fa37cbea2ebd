"""What does jaxpoint reach on the real recordings, beside the figures published with them?

Calibrates svoboda_strawlab2010 and svoboda_arctic4 (its points, and its 2,000 images from the pixels on), aligns
braid_alignment, and measures the squares of caliscope_charuco4. One Markdown table: the figures of the docs.

    python experiments/real_recordings.py DATA --out real.md
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import jax
import numpy as np
import tyro

from jaxpoint import calibrate, detect_led, read_tracks
from jaxpoint.calibration.alignment import align_to_landmarks, umeyama
from jaxpoint.calibration.covariance import with_covariance
from jaxpoint.calibration.result import Calibration
from jaxpoint.camera.parameters import FOCAL
from jaxpoint.camera.rig import CameraRig
from jaxpoint.config import CalibrateSettings, LensSettings
from jaxpoint.io.formats.caliscope_toml import read_camera_array
from jaxpoint.io.track_formats.caliscope_corners import read_caliscope_corners
from jaxpoint.tracks import Tracks

Row = tuple[str, str, str, str]


@dataclass(frozen=True)
class Recordings:
    """Figures on the real recordings beside the published ones."""

    data: Annotated[Path, tyro.conf.Positional]
    """Folder that holds svoboda_strawlab2010, svoboda_arctic4, braid_alignment and caliscope_charuco4."""
    out: Path = Path("real.md")
    """The table."""


def main() -> int:
    """Run all recordings, printing each row as it comes."""
    options = tyro.cli(Recordings)
    jax.config.update("jax_enable_x64", True)
    head = ("recording", "figure", "published or wanted", "reached")
    lines = [f"| {' | '.join(head)} |", "|---|---|---|---|"]
    sys.stdout.write("\n".join(lines) + "\n")
    for part in (strawlab, arctic, braid, charuco):
        for row in part(options.data):
            lines.append(f"| {' | '.join(row)} |")
            sys.stdout.write(lines[-1] + "\n")
            sys.stdout.flush()
    options.out.write_text("\n".join(lines) + "\n")
    return 0


def strawlab(data: Path) -> Iterator[Row]:
    """Means over all observations and over the best 92 %."""
    tracks = read_tracks(data / "svoboda_strawlab2010")
    for init in ("auto", "factorisation"):
        begin = time.perf_counter()
        found = calibrate(tracks, CalibrateSettings(init=init))
        seconds = time.perf_counter() - begin
        errors = np.sort(found.errors[tracks.visible])
        name = f"strawlab2010, `--init {init}`"
        yield name, f"mean over all {len(errors)} observations", "0.47 px", f"{errors.mean():.3f} px"
        best = errors[: round(0.92 * len(errors))].mean()
        yield name, "mean over the best 92 %", "0.33 px (toolbox: 0.62 px over all it kept)", f"{best:.3f} px"
        yield name, "kept at max(4 sigma, 1 px)", "-", kept(found)
        yield name, "seconds in this process, first call compiles", "105 s of CPU (toolbox)", f"{seconds:.1f} s"


def kept(found: Calibration) -> str:
    """How many observations are believed, and their mean error."""
    count = int(found.kept.sum())
    return f"{count} of {int(found.tracks.visible.sum())}, mean {found.errors[found.kept].mean():.3f} px"


def arctic(data: Path) -> Iterator[Row]:
    """The published points, then our own from the images, and how far the two rigs differ."""
    folder = data / "svoboda_arctic4"
    tracks = read_tracks(folder, one_based=True)
    points = calibrate(tracks)
    yield "arctic4, published points", "kept at max(4 sigma, 1 px)", "1693, mean 0.197 px", kept(points)
    focal = np.asarray(points.rig.cameras.focal)[:, 0]
    yield "", "focal lengths", "near 820/650/720/776 (published: 920/712/780/856)", "/".join(f"{f:.0f}" for f in focal)
    begin = time.perf_counter()
    detected = detect_led([folder / f"arctic{camera}" for camera in range(1, 5)])
    detecting = time.perf_counter() - begin
    images = calibrate(detected.tracks)
    both = detected.tracks.visible & tracks.visible
    apart = np.linalg.norm(detected.tracks.pixels - tracks.pixels, axis=-1)[both]
    seen = both.sum() / tracks.visible.sum()
    name = "arctic4, images"
    yield name, "light found where published", ">= 97 %", f"{seen:.1%}"
    yield name, "median distance from published", "< 0.3 px", f"{np.median(apart):.3f} px"
    yield (
        name,
        "more than 3 px from published",
        "< 1 %",
        f"{(apart > 3).sum() / detected.tracks.visible.sum():.2%} of all found",
    )
    far = (images.errors > 5).sum() / detected.tracks.visible.sum()
    yield name, "more than 5 px of reprojection", "< 1 %", f"{far:.2%} of all found, none of them kept"
    yield name, "kept at max(4 sigma, 1 px)", ">= 1650, mean <= 0.22 px", kept(images)
    other = np.asarray(images.rig.cameras.focal)[:, 0]
    yield name, "focal lengths against the points file's", "within 1 %", f"{np.abs(other / focal - 1).max():.2%}"
    fit = umeyama(np.asarray(images.rig.positions), np.asarray(points.rig.positions))
    gap = np.linalg.norm(np.asarray(fit @ images.rig.positions) - np.asarray(points.rig.positions), axis=1).max()
    size = np.ptp(np.asarray(points.rig.positions), axis=0).max()
    yield name, "camera centres against the points file's", "within 1 % of the rig", f"{gap / size:.2%}"
    yield name, "seconds to detect", "-", f"{detecting:.1f} s"


def braid(data: Path) -> Iterator[Row]:
    """A similarity between a self-calibrated and a measured frame."""
    source, target = (
        np.loadtxt(data / "braid_alignment" / name, delimiter=",", skiprows=1)
        for name in ("unaligned.csv", "ground_truth.csv")
    )
    found = align_to_landmarks(source, target)
    yield "braid_alignment", "scale", "0.46901", f"{float(found.similarity.scale):.5f}"
    yield "", "rms, largest residual", "1.97 cm, 2.76 cm", f"{found.rms_mm / 10:.2f} cm, {found.max_mm / 10:.2f} cm"


def charuco(data: Path) -> Iterator[Row]:
    """Corners as single points with the published lenses held; then nothing but the board's shape and size."""
    folder = data / "caliscope_charuco4"
    board = read_caliscope_corners(folder / "calibration" / "extrinsic" / "CHARUCO" / "xy_CHARUCO.csv")
    tracks = board.without_targets()
    theirs = read_camera_array(folder / "camera_array.toml").rig
    theirs = theirs.select([theirs.names.index(name) for name in tracks.names])
    for offsets, what in ((False, "lenses held"), (True, "lenses held, `--time-offsets`")):
        settings = CalibrateSettings(lens=LensSettings(known="hold"), time_offsets=offsets)
        found = calibrate(tracks, settings, intrinsics=theirs)
        scale = float(umeyama(np.asarray(found.rig.positions), np.asarray(theirs.positions)).scale)
        edges = board_edges(found, scale)
        text = f"{edges.mean():.2f} mm, sd {edges.std():.2f}, n = {len(edges)}"
        yield f"caliscope_charuco4, {what}", "board edges of 54 mm", "53.8 mm, sd 0.8, n = 923", text
        errors = found.errors[found.tracks.visible]
        yield "", "mean reprojection over all", "1.36 px", f"{errors.mean():.3f} px"
        if found.time_offsets is not None:
            late = " ".join(f"{value:+.3f}" for value in found.time_offsets.frames)
            yield "", "offsets, frames", "-", late
    yield from _by_the_board(board, theirs)


def _by_the_board(board: Tracks, theirs: CameraRig) -> Iterator[Row]:
    """Lenses, poses and metres from the board's known shape alone."""
    found = with_covariance(calibrate(board, CalibrateSettings(time_offsets=True)))
    assert found.camera_covariance is not None
    name = "caliscope_charuco4, shape of the board, `--time-offsets`"
    focal, published = (np.asarray(rig.cameras.focal)[:, 0] for rig in (found.rig, theirs))
    sigmas = np.sqrt(np.diagonal(found.camera_covariance)).reshape(len(focal), -1)[:, FOCAL]
    shown = " ".join(f"{value:.0f} ± {sigma:.0f}" for value, sigma in zip(focal, sigmas))
    yield name, "focal lengths, px", " ".join(f"{value:.0f}" for value in published), shown
    scale = float(umeyama(np.asarray(found.rig.positions), np.asarray(theirs.positions)).scale)
    yield "", "published size of the rig over ours", "1", f"{scale:.4f}"
    yield "", "kept, mean error", "2175", kept(found)


def board_edges(found: Calibration, scale: float) -> np.ndarray:
    """Lengths (mm) between neighbouring corners; 4 x 3 inner corners, numbered by rows of three."""
    ids = zip(np.asarray(found.tracks.point_ids).tolist(), found.tracks.frame_ids.tolist())
    points = {i: point for i, point, ok in zip(ids, found.points, found.point_valid) if ok}
    lengths = []
    for (corner, frame), point in points.items():
        for neighbour in ([corner + 1] if corner % 3 < 2 else []) + [corner + 3]:
            if (neighbour, frame) in points:
                lengths.append(np.linalg.norm(point - points[neighbour, frame]))
    return 1000.0 * scale * np.array(lengths)


if __name__ == "__main__":
    sys.exit(main())
