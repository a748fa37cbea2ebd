"""How much elevation error does the thesis's rule for the ends of a forearm cause by itself?

The thesis (7.2.2) takes the tip of the forearm on the region's outline and its base at the centroid, and joins the two
points as triangulated from two views; it reports a nearly constant elevation error of 4.885 degrees (sd 0.867), which
it explains by the people. The rule is suspected instead: a tip on the upper outline and a base on the axis tilt the
line up by about atan(1.5 cm / 17 cm) = 5.04 degrees. Here nothing else can err. Simulated people point perfectly, with
straight arms and no error term in their law; the regions are the true masks of forearm and hand, the cameras the true
ones, the two views those of the highest eccentricity and most pixels (7.3). One frame a gesture, two laws:

- `accurate`: eye, fingertip and target in line. The arm itself hangs on the shoulder and rises above that line, so that
  even the true forearm is no line to the target.
- `forearm`: the elbow-wrist axis runs exactly along the line from the fingertip to the target.

Elevation error is estimated minus true, positive too high: against the line from the true fingertip to the target, as
the thesis has it, and against the true elbow-wrist axis, where the rule alone is left. Beside the thesis's rule stand
the same with its step 5 (the base moved up to the outline too) and the planes of the region's axis lines, which join no
points: in the same two views, and in all. Views whose region the thesis's filters of shape reject (6.3.1: too round, or
too steep for ends at the left and right to mean anything) are left out for all alike; `--any-shape` takes them.

    python experiments/thesis_endpoints.py --seeds 0 5 --out thesis_endpoints.md
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import numpy as np
import tyro
from rich.progress import track

from jaxpoint.camera.rig import CameraRig
from jaxpoint.config.people import (
    AccurateSettings,
    ApproximateSettings,
    HoldSettings,
    Normal,
    PeopleSettings,
    PointingSettings,
    Uniform,
)
from jaxpoint.config.person import ThesisSettings
from jaxpoint.config.simulation import SimulationSettings
from jaxpoint.detection.person.endpoints import AxisLine, Endpoints, axis_line, forearm_endpoints
from jaxpoint.detection.person.thesis_regions import of_shape
from jaxpoint.detection.region import Region, label_regions, region_of
from jaxpoint.simulate.mesh import PARTS_A_PERSON, Part
from jaxpoint.simulate.people.gesture import Gesture
from jaxpoint.simulate.simulated_session import SimulatedSession, simulate_session

ARM = {
    "left": (Part.LEFT_FOREARM, Part.LEFT_HAND, Part.LEFT_FINGER),
    "right": (Part.RIGHT_FOREARM, Part.RIGHT_HAND, Part.RIGHT_FINGER),
}
LAWS = {"accurate": "accurate", "approximate": "forearm"}
BANDS = (("below -15", -90.0, -15.0), ("-15 to 0", -15.0, 0.0), ("0 to 15", 0.0, 15.0), ("above 15", 15.0, 90.1))
SUSPECTED_DEG = float(np.degrees(np.arctan2(1.5, 17.0)))
THESIS_DEG = (4.885, 0.867)
LINES = {
    "true elbow-wrist axis": "of the simulator",
    "thesis": "tip on the outline, base the centroid",
    "thesis, step 5": "both on the upper outline",
    "axis planes, two views": "the same two views",
    "axis planes, all views": "",
}


@dataclass(frozen=True)
class ThesisEndpoints:
    """Measure what the thesis's endpoint rule alone does to the elevation."""

    seeds: tuple[int, int] = (0, 5)
    """First seed of a session, and one past the last."""
    people: int = 8
    """People a session."""
    gestures: int = 32
    """Gestures a session, of all people together."""
    any_shape: bool = False
    """Take views whose region the thesis's filters of shape reject, too."""
    out: Path = Path("thesis_endpoints.md")
    """The table, as Markdown."""


@dataclass(frozen=True)
class View:
    """The region of one view and what is made of it."""

    camera: int
    region: Region
    ends: Endpoints
    shifted: Endpoints  # with step 5
    axis: AxisLine

    @property
    def rank(self) -> float:
        """Eccentricity and number of pixels in one number."""
        return self.region.eccentricity * float(np.log(self.region.area))


@dataclass(frozen=True)
class Row:
    """One line of one gesture; degrees, positive too high."""

    law: str
    line: str
    to_target: float
    to_axis: float
    elevation: float  # of the true elbow-wrist axis


def perfect(people: int, gestures: int) -> SimulationSettings:
    """People who point without any error, with straight arms and without tremor; half of them by each law."""
    none, straight = Normal(0.0, 0.0, 0.0, 0.0), Normal(1.0, 0.0, 1.0, 1.0)
    pointing = PointingSettings(
        accurate=AccurateSettings(elbow_flexion_deg=straight, aim_error_deg=none, finger_error_deg=none),
        approximate=ApproximateSettings(
            elbow_flexion_deg=straight,
            elevation_bias_deg=none,
            azimuth_bias_deg=none,
            elevation_scatter_deg=0.0,
            azimuth_scatter_deg=0.0,
            finger_follows=Uniform(1.0, 1.0),
        ),
        hold=HoldSettings(tremor_sd_m=Uniform(0.0, 0.0)),
        accurate_share=0.5,
    )
    behaviour = PeopleSettings(play="gestures", people=people, gestures=gestures, pointing=pointing)
    return replace(SimulationSettings(), people=behaviour)


def measure(session: SimulatedSession, gesture: Gesture, any_shape: bool = False) -> list[Row]:
    """All lines of one gesture, in the middle of its hold; none where fewer than two views see the region."""
    moment = session.frame_at((gesture.hold_first_s + gesture.hold_last_s) / 2)
    views = [view for camera in range(len(session.rig)) if (view := look(session, gesture, moment, camera)) is not None]
    views = [view for view in views if any_shape or of_shape([view.region], ThesisSettings().forearm)[0]]
    if len(views) < 2:
        return []
    time_s = session.time_of(moment)
    joints = next(a for a in session.present(time_s) if a.person.number == gesture.person).joints(time_s)
    tip, elbow, wrist = (joints[f"{gesture.hand}_{name}"] for name in ("tip", "elbow", "wrist"))
    two = sorted(views, key=lambda view: -view.rank)[:2]
    estimates = {
        "true elbow-wrist axis": wrist - elbow,
        "thesis": joined(session.rig, two, lambda view: view.ends),
        "thesis, step 5": joined(session.rig, two, lambda view: view.shifted),
        "axis planes, two views": common_direction(session.rig, two, wrist - elbow),
        "axis planes, all views": common_direction(session.rig, views, wrist - elbow),
    }
    assert set(estimates) == set(LINES)
    truths = elevation_deg(gesture.target_m - tip), elevation_deg(wrist - elbow)
    found = {name: elevation_deg(line) for name, line in estimates.items()}
    return [Row(LAWS[gesture.law], name, own - truths[0], own - truths[1], truths[1]) for name, own in found.items()]


def look(session: SimulatedSession, gesture: Gesture, moment: int, camera: int) -> View | None:
    """The true region of forearm and hand in one view; None where it is too small."""
    owner, part = np.divmod(session.frame(moment, camera).labels, PARTS_A_PERSON)
    person = (owner == gesture.person) & (part > 0)
    return viewed(camera, person & np.isin(part, ARM[gesture.hand]), person)


def viewed(camera: int, arm: np.ndarray, person: np.ndarray) -> View | None:
    """What is made of the masks of forearm and hand, and of the whole person."""
    labels, regions = label_regions(arm, min_area=ThesisSettings().forearm.min_area_px + 1)
    if not regions:
        return None
    region = regions[0]
    crop, corner = region.crop(labels), np.array(region.box[:2])
    axis = axis_line(crop)
    if axis is None:
        return None
    centroid = region_of(person).centroid - corner
    ends, shifted = (forearm_endpoints(crop, centroid, shift_to_top=step5) for step5 in (False, True))
    moved = [Endpoints(own.tip + corner, own.base + corner) for own in (ends, shifted)]
    return View(camera, region, moved[0], moved[1], replace(axis, point=axis.point + corner))


def joined(rig: CameraRig, views: Sequence[View], ends: Callable[[View], Endpoints]) -> np.ndarray:
    """From the triangulated base to the triangulated tip."""
    tip, base = (meeting(rig, [(v.camera, getattr(ends(v), name)) for v in views]) for name in ("tip", "base"))
    return tip - base


def meeting(rig: CameraRig, pixels: Sequence[tuple[int, np.ndarray]]) -> np.ndarray:
    """The point nearest to the rays of some pixels, m."""
    matrix, right = np.zeros((3, 3)), np.zeros(3)
    for camera, pixel in pixels:
        origin, ray = sight(rig, camera, pixel)
        across = np.eye(3) - np.outer(ray, ray)
        matrix, right = matrix + across, right + across @ origin
    return np.linalg.solve(matrix, right)


def common_direction(rig: CameraRig, views: Sequence[View], ahead: np.ndarray) -> np.ndarray:
    """The direction that lies nearest to the planes of the views' axis lines."""
    matrix = np.zeros((3, 3))
    for view in views:
        near, far = (sight(rig, view.camera, end)[1] for end in view.axis.ends)
        normal = np.cross(near, far)  # its length is the sine of the region's: longer regions count more
        matrix += np.outer(normal, normal)
    direction = np.linalg.eigh(matrix)[1][:, 0]
    return direction if direction @ ahead > 0 else -direction


def sight(rig: CameraRig, camera: int, pixel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre of a camera (m) and unit direction through a pixel."""
    rays = rig.rays(np.tile(pixel, (len(rig), 1)))
    return np.asarray(rays.origin)[camera], np.asarray(rays.direction)[camera]


def elevation_deg(direction: np.ndarray) -> float:
    """Of a direction over the floor."""
    return float(np.degrees(np.arctan2(direction[2], np.hypot(direction[0], direction[1]))))


def markdown(rows: Sequence[Row]) -> str:
    """Mean and standard deviation of each line's elevation error, by law."""
    grouped: dict[tuple[str, str], list[Row]] = defaultdict(list)
    for row in rows:
        grouped[row.law, row.line].append(row)
    lines = [
        "Elevation error in degrees, estimated minus true: mean (standard deviation) and median (robust deviation).",
        "",
        "| law | line | gestures | against the target | median | against the forearm's axis | median |",
        "|---|---|---|---|---|---|---|",
    ]
    for (law, line), own in sorted(grouped.items(), key=lambda item: (item[0][0], list(LINES).index(item[0][1]))):
        cells = [_cells([getattr(row, name) for row in own]) for name in ("to_target", "to_axis")]
        note = f" ({LINES[line]})" if LINES[line] else ""
        lines.append(f"| {law} | {line}{note} | {len(own)} | {cells[0]} | {cells[1]} |")
    lines += ["", "The thesis's line against the forearm's axis, law `forearm`, by how the forearm points:", ""]
    lines += ["| elevation | gestures | mean | median |", "|---|---|---|---|"]
    for name, low, high in BANDS:
        errors = [row.to_axis for row in grouped["forearm", "thesis"] if low <= row.elevation < high]
        lines += [f"| {name} | {len(errors)} | {_cells(errors)} |"] if len(errors) > 1 else []
    lines += [
        "",
        f"Suspected: atan(1.5 / 17) = {SUSPECTED_DEG:.2f}. The thesis reports {THESIS_DEG[0]} (sd {THESIS_DEG[1]}).",
    ]
    return "\n".join(lines) + "\n"


def _cells(errors: Sequence[float]) -> str:
    middle = np.median(errors)
    robust = 1.4826 * np.median(np.abs(np.array(errors) - middle))
    return f"{np.mean(errors):+.2f} ({np.std(errors, ddof=1):.2f}) | {middle:+.2f} ({robust:.2f})"


def main(options: ThesisEndpoints) -> None:
    """Render, measure, write."""
    rows: list[Row] = []
    with jax.enable_x64(True):
        for seed in track(range(*options.seeds), description="sessions"):
            session = simulate_session(perfect(options.people, options.gestures), seed)
            for gesture in session.gestures:
                rows += measure(session, gesture, options.any_shape)
            options.out.write_text(markdown(rows), encoding="utf-8")
    print(markdown(rows))


if __name__ == "__main__":
    main(tyro.cli(ThesisEndpoints, description=__doc__))
