"""Recordings of one simulated room again and again, and the calibration of each: for what errors really are.

The adjustment starts from the true rig, so that a repeat takes a fraction of a second.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from jaxpoint.calibration.assembly import centre_rig, rig_of
from jaxpoint.calibration.bundle import LEAST_SQUARES
from jaxpoint.calibration.outliers import robust_sigma
from jaxpoint.calibration.pairs import pair_table
from jaxpoint.calibration.recording import Freedom, Recording, RigState, adjust, project
from jaxpoint.calibration.result import Calibration, Verdict
from jaxpoint.camera.brown import Brown
from jaxpoint.camera.parameters import CENTER, FOCAL, size_of
from jaxpoint.config import LensSettings
from jaxpoint.simulate.rooms import RandomRoom, displaced_pixel, random_room
from jaxpoint.tracks import Tracks

LANDMARKS, PLACES = 6, 40
WALKED_M = np.array([[0.8, 0.8, 0.3], [5.2, 4.2, 2.2]])  # where places lie, m


@dataclass(frozen=True)
class Recalibrated:
    """One room, its landmarks and places, and what its cameras see without noise. C cameras, F frames."""

    room: RandomRoom
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
        cut = RandomRoom(**{**vars(room), "points": room.points[chosen]})
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
            pixels[frame, camera] = displaced_pixel(
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


def seen_places(room: RandomRoom, rng: np.random.Generator, count: int) -> np.ndarray:
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


def from_truth(known: Recalibrated, mode: Literal["least_squares", "robust"], rng: np.random.Generator) -> Calibration:
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
    state = centre_rig(state, kept, tracks.cameras)
    return calibration_of(known, tracks, recording, state, sigma, 2 * sigma if mode == "robust" else None)
