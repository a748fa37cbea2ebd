"""How near does the tip of a coloured marker come to the truth?

Simulated people, each with a coloured cap on the index finger, stand somewhere in the room and point, each by a law of
their own. The cap's colour is learnt as a user would teach it: by two clicks into the outer half of the finger in the
three images of one moment of one gesture of that person in which it shows best; the person's other gestures are
judged. The detectors see what the cameras record, and know the true calibration; the room's background
is learnt from its empty recording. Targets: median 1 cm within 4 m. A view's distance is that of the tip from the
camera, a gesture's the median over the views that count.

    python experiments/marker_tip.py --seeds 0 4 --out marker_tip.md
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import numpy as np
import tyro
from rich.progress import track

from jaxpoint.body.marker_tips import TipReason, marker_tips
from jaxpoint.config.people import LooksSettings, PeopleSettings
from jaxpoint.config.person import MarkerSettings, PersonSettings
from jaxpoint.config.simulation import SimulationSettings
from jaxpoint.detection.person.marker_regions import MarkerModel, train_marker
from jaxpoint.detection.person.marker_watch import disc, look_for_marker
from jaxpoint.detection.person.silhouette import RoomBackground, learn_background
from jaxpoint.detection.person.watcher import PersonWatch
from jaxpoint.errors import InsufficientDataError
from jaxpoint.evidence.marker_views import MarkerViews
from jaxpoint.simulate.mesh import PARTS_A_PERSON, Part
from jaxpoint.simulate.people.gesture import Gesture
from jaxpoint.simulate.simulated_session import SimulatedFrame, SimulatedSession, simulate_session

MARKER = MarkerSettings()
FINGER = {"left": Part.LEFT_FINGER, "right": Part.RIGHT_FINGER}
EMPTY_FRAMES = 20
CLICKED_VIEWS = 3
SHOWN_PX = 20  # of a finger, for a user to pick it
NEAR_M = 4.0
TARGET_M = 0.01
MOTION_PX = 12.0  # edge pixels; every frame here holds somebody


@dataclass(frozen=True)
class MarkerTipError:
    """Compare the marker's tip in the room with the truth."""

    seeds: tuple[int, int] = (0, 4)
    """First seed of a session, and one past the last."""
    people: int = 8
    """People of a session, each with a cap of a colour of its own."""
    gestures: int = 5
    """Gestures of each of them; the first teaches the colour."""
    out: Path = Path("marker_tip.md")
    """The table, as Markdown."""


@dataclass(frozen=True)
class Row:
    """One gesture; errors are NaN where there is no tip."""

    reason: str
    views: int  # that show the marker in one place
    distance_m: float  # of the true tip from the cameras
    tip_m: float
    direction_deg: float  # against the finger's own: from the middle of the hand's last bone
    sigma_deg: float


def rows_of(seed: int, options: MarkerTipError, person: PersonSettings) -> list[Row]:
    """All judged gestures of one session."""
    looks = replace(LooksSettings(), cap=1.0)
    people = PeopleSettings(
        play="gestures", people=options.people, gestures=options.people * options.gestures, looks=looks
    )
    settings = replace(SimulationSettings(), empty_frames=EMPTY_FRAMES, people=people)
    session = simulate_session(settings, seed)
    rooms = [
        learn_background([session.empty(k, camera) for k in range(EMPTY_FRAMES)], person.background)
        for camera in range(len(session.rig))
    ]
    rows: list[Row] = []
    models: dict[int, MarkerModel | None] = {}
    for gesture in session.gestures:
        moment = session.frame_at((gesture.hold_first_s + gesture.hold_last_s) / 2)
        frames = [session.frame(moment, camera) for camera in range(len(session.rig))]
        if gesture.person not in models:
            models[gesture.person] = taught(frames, gesture, MARKER)
            continue
        rows.append(judged(session, gesture, frames, rooms, models[gesture.person], person))
    return rows


def taught(frames: Sequence[SimulatedFrame], gesture: Gesture, settings: MarkerSettings) -> MarkerModel | None:
    """The colour, from two clicks into the finger's outer half where it shows best; None where these are too few."""
    shown = [np.argwhere(frame.labels == FINGER[gesture.hand] + PARTS_A_PERSON * gesture.person) for frame in frames]
    largest = sorted(range(len(frames)), key=lambda camera: -len(shown[camera]))[:CLICKED_VIEWS]
    picked = [np.zeros((0, 3), np.uint8)]
    for camera in largest:
        truth = next(view for view in frames[camera].views if view.person == gesture.person)
        pixels = shown[camera][:, ::-1]
        distance = np.hypot(*(pixels - truth.tip).T)
        for part in (0.2, 0.4) if len(pixels) >= SHOWN_PX else ():
            x, y = np.round(pixels[distance <= np.quantile(distance, part)].mean(axis=0))
            picked.append(disc(frames[camera].image, float(x), float(y), settings.sample_radius_px))
    try:
        return train_marker(np.concatenate(picked), settings)
    except InsufficientDataError:
        return None


def judged(
    session: SimulatedSession,
    gesture: Gesture,
    frames: Sequence[SimulatedFrame],
    rooms: Sequence[RoomBackground],
    model: MarkerModel | None,
    person: PersonSettings,
) -> Row:
    """The tip of one gesture against the truth."""
    actor = next(a for a in session.play.actors if a.person.number == gesture.person and gesture in a.gestures)
    true_tip = actor.joints(frames[0].time_s)[f"{gesture.hand}_tip"]
    distances = np.linalg.norm(true_tip - np.asarray(session.rig.positions), axis=1)
    if model is None:
        return Row("not_taught", 0, float(np.median(distances)), np.nan, np.nan, np.nan)
    focal = np.asarray(session.rig.cameras.focal).mean(axis=1)
    markers: list[MarkerViews] = []
    for camera, frame in enumerate(frames):
        watcher = PersonWatch(rooms[camera], MOTION_PX, float(focal[camera]), person)
        markers.append(look_for_marker([(0, frame.image)], 1, watcher, model, MARKER))
    tip = marker_tips(session.rig, markers, MARKER)[0]
    distance = float(np.median(distances[list(tip.members)] if tip.members else distances))
    if not tip.found:
        return Row(tip.reason.name.lower(), 0, distance, np.nan, np.nan, np.nan)
    error = float(np.linalg.norm(tip.tip - true_tip))
    turned, sigma = np.nan, np.nan
    if tip.reason == TipReason.FOUND:
        finger = finger_direction(actor, gesture, frames[0].time_s)
        turned = float(np.degrees(np.arccos(np.clip(tip.direction @ finger, -1, 1))))
        sigma = float(np.degrees(tip.direction_sigma))
    return Row(tip.reason.name.lower(), len(tip.members), distance, error, turned, sigma)


def finger_direction(actor, gesture: Gesture, time_s: float) -> np.ndarray:
    """Of the pointing index finger: the long axis of its corners in the mesh, away from the wrist."""
    mesh, joints = actor.mesh(time_s), actor.joints(time_s)
    own = mesh.vertices[mesh.parts == FINGER[gesture.hand] + PARTS_A_PERSON * gesture.person]
    axis = np.linalg.svd(own - own.mean(axis=0))[2][0]
    ahead = joints[f"{gesture.hand}_tip"] - joints[f"{gesture.hand}_wrist"]
    return axis if axis @ ahead > 0 else -axis


def markdown(rows: Sequence[Row]) -> str:
    """Found gestures and errors, near and far."""
    lines = [
        "| gestures | n | found | tip: median | 90 % | direction: median | said, median | not found |",
        "|---|---|---|---|---|---|---|---|",
    ]
    near = [row for row in rows if row.distance_m <= NEAR_M]
    for name, own in (("all", rows), (f"within {NEAR_M:g} m", near)):
        found = [row for row in own if np.isfinite(row.tip_m)]
        if not found:
            lines.append(f"| {name} | {len(own)} | 0 | - | - | - | - | - |")
            continue
        tips = 100 * np.array([row.tip_m for row in found])
        turned, said = ([getattr(row, key) for row in found] for key in ("direction_deg", "sigma_deg"))
        missing = Counter(row.reason for row in own if not np.isfinite(row.tip_m))
        lines.append(
            f"| {name} | {len(own)} | {len(found)} | {np.median(tips):.2f} cm | {np.quantile(tips, 0.9):.2f} cm | "
            f"{np.nanmedian(turned):.1f} deg | {np.nanmedian(said):.1f} deg | "
            f"{', '.join(f'{count} {reason}' for reason, count in missing.items()) or '-'} |"
        )
    return "\n".join(lines) + f"\n\nTarget: median <= {100 * TARGET_M:g} cm within {NEAR_M:g} m.\n"


def main(options: MarkerTipError) -> None:
    """Simulate, detect, compare, write."""
    rows: list[Row] = []
    with jax.enable_x64(True):
        for seed in track(range(*options.seeds), description="sessions"):
            rows += rows_of(seed, options, PersonSettings())
            options.out.write_text(markdown(rows), encoding="utf-8")
    print(markdown(rows))


if __name__ == "__main__":
    main(tyro.cli(MarkerTipError, description=__doc__))
