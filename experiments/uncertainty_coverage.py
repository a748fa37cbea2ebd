"""Does a calibration tell the truth about its error? 95 % ellipsoids should hold the truth in 95 % of cases.

One simulated room of 6 cameras and one of 3 (noise of 0.5 px, 80 % visible) is recorded and calibrated again and again,
aligned with the room by 6 landmarks measured to 5 mm and clicked in the images, and asked how far off it may be. Then
the truth is told: places triangulated from fresh pixels, camera centres and lengths between places, each held against
its own ellipsoid. Three kinds of recalibration: least squares from the true rig, the same with the robust loss, and
the whole of `calibrate` on a recording with gross outliers. The mean squared distance in units of its own covariance
tells how far the covariances are wrong on average: 1 is right, 1.2 means standard deviations 10 % too small.

    python experiments/uncertainty_coverage.py --repeats 300 --out coverage.md
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import jax
import numpy as np
import tyro
from rich.progress import track
from scipy.stats import chi2

from jaxpoint.calibration.alignment import align_to_landmarks, apply_alignment
from jaxpoint.calibration.propagation import joint_uncertainty
from jaxpoint.calibration.selfcal import calibrate
from jaxpoint.calibration.uncertainty import Anchors, Uncertainty, uncertainty_of
from jaxpoint.errors import JaxpointError
from jaxpoint.simulate.recalibration import Recalibrated, from_truth
from jaxpoint.triangulation import triangulate

Mode = Literal["least_squares", "robust", "calibrate"]
MODES: tuple[Mode, ...] = ("least_squares", "robust", "calibrate")
KINDS = ("points", "centres", "lengths")
FREEDOMS = {"points": 3, "centres": 3, "lengths": 1}
MEASURED_M = 0.005


@dataclass(frozen=True)
class UncertaintyCoverage:
    """Recalibrate simulated rooms and count how often the truth lies where it should."""

    repeats: int = 300
    """Recalibrations of every room and kind."""
    cameras: tuple[int, ...] = (6, 3)
    """One room each."""
    modes: tuple[Mode, ...] = MODES
    """Kinds of recalibration."""
    frames: int = 500
    """Positions of the light."""
    outliers: float = 0.05
    """Share of gross outliers among the pixels given to `calibrate`."""
    noise_px: float = 0.5
    """Standard deviation of a pixel coordinate, clicks included."""
    seed: int = 1
    """Of the rooms."""
    out: Path = Path("uncertainty_coverage.md")
    """The table, as Markdown."""


@dataclass(frozen=True)
class Row:
    """One recalibration: squared distances from the truth in units of their own covariance."""

    squares: dict[str, np.ndarray]
    sigma_px: float

    def held(self, kind: str) -> np.ndarray:
        """Whether each 95 % ellipsoid holds the truth."""
        return self.squares[kind] < chi2.ppf(0.95, FREEDOMS[kind])


def one(known: Recalibrated, mode: Mode, repeat: int) -> Row:
    """Record, calibrate, align, and hold the result against the truth."""
    rng = np.random.default_rng([repeat, 17])
    solved = calibrate(known.tracks(rng, known.outliers)) if mode == "calibrate" else from_truth(known, mode, rng)
    clicked = known.landmark_pixels + rng.normal(0.0, known.noise_px, known.landmark_pixels.shape)
    measured = known.landmarks + rng.normal(0.0, MEASURED_M, known.landmarks.shape)
    sigmas = np.full(len(measured), MEASURED_M)
    found = np.asarray(triangulate(solved.rig, clicked, known.landmark_visible).points)
    aligned = apply_alignment(solved, align_to_landmarks(found, measured, sigmas))
    nowhere = np.full(solved.tracks.frames, np.inf), np.full(solved.tracks.cameras, np.inf)
    anchors = Anchors(*nowhere, sigmas, clicked, known.landmark_visible, known.noise_px)
    return Row(squares(known, uncertainty_of(aligned, anchors), rng), solved.sigma_px)


def squares(known: Recalibrated, uncertain: Uncertainty, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Squared distance of the truth in units of the covariance, for every place, centre and length."""
    pixels, visible = known.room.seen(known.places)
    pixels = pixels + rng.normal(0.0, known.noise_px, pixels.shape)
    joint = joint_uncertainty(uncertain, pixels, visible)
    count, covariance = len(known.places), np.asarray(joint.covariance)
    error = np.asarray(joint.value).reshape(count, 3) - known.places
    blocks = covariance.reshape(count, 3, count, 3)
    centres = np.asarray(uncertain.rig.positions) - known.room.positions
    ends = np.arange(count).reshape(-1, 2)
    found, true = (np.diff(places[ends], axis=1)[:, 0] for places in (known.places + error, known.places))
    unit = found / np.linalg.norm(found, axis=1, keepdims=True)
    a, b = ends.T
    apart = blocks[a, :, a] + blocks[b, :, b] - blocks[a, :, b] - blocks[b, :, a]
    off = np.linalg.norm(found, axis=1) - np.linalg.norm(true, axis=1)
    each = np.arange(count)
    return {
        "points": distances(error, blocks[each, :, each]),
        "centres": distances(centres, np.asarray(uncertain.centre_covariance)),
        "lengths": off**2 / np.einsum("li,lij,lj->l", unit, apart, unit),
    }


def distances(errors: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """e^T C^-1 e of every error."""
    return np.einsum("ni,ni->n", errors, np.linalg.solve(covariances, errors[..., None])[..., 0])


def main(options: UncertaintyCoverage) -> None:
    """Recalibrate every room in every way, and write and print the table."""
    lines = ["| recalibrated by | cameras | n | refused | sigma / true | " + " | ".join(
        f"{kind} held | {kind} squared" for kind in KINDS) + " |", "|" + "---|" * 11]  # fmt: skip
    with jax.enable_x64(True):
        for cameras in options.cameras:
            known = Recalibrated.of(
                options.seed, cameras=cameras, frames=options.frames, noise_px=options.noise_px,
                outliers=options.outliers,
            )  # fmt: skip
            for mode in options.modes:
                lines.append(line(known, mode, options.repeats))
    text = "\n".join(lines) + "\n"
    options.out.write_text(text)
    sys.stdout.write(text)


def line(known: Recalibrated, mode: Mode, repeats: int) -> str:
    """One line of the table."""
    rows, refused = [], 0
    cameras = known.room.tracks.cameras
    for repeat in track(range(repeats), f"{mode}, {cameras} cameras"):
        try:
            rows.append(one(known, mode, repeat))
        except JaxpointError:
            refused += 1
    if not rows:
        return f"| {mode} | {cameras} | 0 | {refused} |" + " |" * 7
    cells = []
    for kind in KINDS:
        held = np.stack([row.held(kind) for row in rows]).mean()
        ratio = np.stack([row.squares[kind] for row in rows]).mean() / FREEDOMS[kind]
        cells += [f"{held:.1%}", f"{ratio:.2f}"]
    sigma = np.mean([row.sigma_px for row in rows]) / known.noise_px
    return f"| {mode} | {cameras} | {len(rows)} | {refused} | {sigma:.3f} | {' | '.join(cells)} |"


if __name__ == "__main__":
    main(tyro.cli(UncertaintyCoverage, description=__doc__))
