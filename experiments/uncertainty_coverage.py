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
from jaxpoint.calibration.assembly import centred, rig_of
from jaxpoint.calibration.bundle import LEAST_SQUARES
from jaxpoint.calibration.outliers import robust_sigma
from jaxpoint.calibration.pairs import pair_table
from jaxpoint.calibration.propagation import joint_uncertainty
from jaxpoint.calibration.recording import Freedom, Recording, RigState, adjust, project
from jaxpoint.calibration.result import Calibration, Verdict
from jaxpoint.calibration.selfcal import calibrate
from jaxpoint.calibration.uncertainty import Anchors, Uncertainty, uncertainty_of
from jaxpoint.camera.brown import Brown
from jaxpoint.camera.parameters import CENTER, FOCAL, size_of
from jaxpoint.config import LensSettings
from jaxpoint.errors import JaxpointError
from jaxpoint.simulate.rooms import Room, _displaced, random_room
from jaxpoint.tracks import Tracks
from jaxpoint.triangulation import triangulate

Mode = Literal["least_squares", "robust", "calibrate"]
MODES: tuple[Mode, ...] = ("least_squares", "robust", "calibrate")
KINDS = ("points", "centres", "lengths")
FREEDOMS = {"points": 3, "centres": 3, "lengths": 1}
LANDMARKS, PLACES = 6, 40
MEASURED_M = 0.005
WALKED_M = np.array([[0.8, 0.8, 0.3], [5.2, 4.2, 2.2]])


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
class Recalibrated:
    """One room, its landmarks and places, and what its cameras see without noise. C cameras, F frames."""

    room: Room
    exact: np.ndarray  # (F, C, 2) px
    visible: np.ndarray  # (F, C)
    landmarks: np.ndarray  # (6, 3) m
    landmark_pixels: np.ndarray  # (6, C, 2) px
    landmark_visible: np.ndarray  # (6, C)
    places: np.ndarray  # (40, 3) m
    noise_px: float
    outliers: float = 0.0

    @staticmethod
    def of(seed: int, *, cameras: int, frames: int, noise_px: float, outliers: float = 0.0) -> Recalibrated:
        """A room with cameras all around; landmarks and places are seen by three cameras (two of three)."""
        room = random_room(
            seed, cameras=cameras, frames=max(frames, 60), layout="around", visibility=0.8, outliers=0.0, noise_px=0.5
        )
        exact, _ = room.seen(room.points)
        seen_often = np.flatnonzero(room.tracks.visible.sum(axis=1) >= 2)[:frames]
        chosen = np.arange(frames) if frames >= 60 else seen_often
        places = seen_places(room, np.random.default_rng(seed), LANDMARKS + PLACES)
        pixels, visible = room.seen(places[:LANDMARKS])
        cut = Room(**{**vars(room), "points": room.points[chosen]})
        return Recalibrated(
            cut, exact[chosen], room.tracks.visible[chosen], places[:LANDMARKS], pixels, visible, places[LANDMARKS:],
            noise_px, outliers,
        )  # fmt: skip

    def tracks(self, rng: np.random.Generator, outliers: float = 0.0) -> Tracks:
        """A recording: noise, and outliers a third of which lie along epipolar lines."""
        pixels = self.exact + rng.normal(0.0, self.noise_px, self.exact.shape)
        room = self.room
        lens = (room.focal, room.center, room.distortion, room.rotation, room.translation)
        for frame, camera in np.argwhere(self.visible & (rng.random(self.visible.shape) < outliers)):
            others = np.flatnonzero(self.visible[frame] & (np.arange(self.visible.shape[1]) != camera))
            other = int(rng.choice(others)) if rng.random() < 1 / 3 and len(others) else None
            pixels[frame, camera] = _displaced(
                rng, lens, room.points[frame], self.exact[frame, camera], camera, other, self.noise_px
            )
        return Tracks.from_pixels(pixels, self.room.tracks.image_sizes, self.visible)

    def true_state(self, recording: Recording) -> RigState:
        """The true rig as the adjustment writes it."""
        room, count = self.room, recording.cameras
        numbers = np.zeros((len(recording.image_sizes), size_of(Brown)))
        base = np.tile(np.eye(3), (len(numbers), 1, 1))
        base[:count], numbers[:count, 3:6] = room.rotation, room.translation
        numbers[:, FOCAL] = np.log(1000.0)
        numbers[:count, FOCAL] = np.log(room.focal)
        numbers[:count, CENTER], numbers[:count, 10:] = room.center, room.distortion
        points = np.zeros((len(recording.visible), 3))
        points[: recording.frames] = room.points
        return RigState(numbers, base, points)

    def truth(self) -> Calibration:
        """The true rig as a calibration of pixels without noise."""
        tracks = Tracks.from_pixels(self.exact, self.room.tracks.image_sizes, self.visible)
        recording = Recording.of(tracks)
        return calibration_of(self, tracks, recording, self.true_state(recording), self.noise_px, None)


def seen_places(room: Room, rng: np.random.Generator, count: int) -> np.ndarray:
    """Places (count, 3), m, that three cameras see; two where there are three."""
    needed = min(3, room.tracks.cameras - 1)
    drawn = rng.uniform(WALKED_M[0], WALKED_M[1], (100 * count, 3))
    return drawn[room.seen(drawn)[1].sum(axis=1) >= needed][:count]


def calibration_of(
    known: Recalibrated, tracks: Tracks, recording: Recording, state: RigState, sigma: float, loss_scale: float | None
) -> Calibration:
    """A solved rig as `calibrate` would return it."""
    count, valid = tracks.cameras, known.visible.sum(axis=1) >= 2
    kept = known.visible & valid[:, None]
    parts = Freedom.of(recording, LensSettings(), "radial2")
    return Calibration(
        rig=rig_of(state, tracks),
        tracks=tracks,
        points=np.where(valid[:, None], state.points[: tracks.frames], 0.0),
        point_valid=valid,
        residuals=np.where(kept[..., None], project(state)[0][: tracks.frames, :count] - tracks.pixels, 0.0),
        verdicts=np.where(kept, Verdict.KEPT, np.where(known.visible, Verdict.FEW_VIEWS, Verdict.HIDDEN)),
        sigma_px=sigma,
        converged=True,
        message="started from the truth",
        pairs=pair_table(tracks),
        freedom=Freedom(parts.free[:count], parts.prior_mean[:count], parts.prior_weight[:count]),
        loss_scale=loss_scale,
    )


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


def from_truth(known: Recalibrated, mode: Mode, rng: np.random.Generator) -> Calibration:
    """The adjustment alone, from the true rig; the origin and the unit become those of the solver."""
    tracks = known.tracks(rng)
    recording = Recording.of(tracks)
    kept = np.zeros(recording.visible.shape, bool)
    kept[: tracks.frames, : tracks.cameras] = known.visible & (known.visible.sum(axis=1) >= 2)[:, None]
    freedom = Freedom.of(recording, LensSettings(), "radial2").at_noise(known.noise_px)
    loss = 2 * known.noise_px if mode == "robust" else LEAST_SQUARES
    state = adjust(recording, known.true_state(recording), kept, freedom, loss_scale=loss, rtol=1e-9).state
    errors = np.linalg.norm(project(state)[0] - recording.pixels, axis=-1)
    sigma = robust_sigma(errors, kept, int(freedom.free.sum()))
    state = centred(state, kept, tracks.cameras)
    return calibration_of(known, tracks, recording, state, sigma, 2 * sigma if mode == "robust" else None)


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
