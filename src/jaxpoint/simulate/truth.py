"""What is true of one person in one camera's image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxpoint.simulate.mesh import PARTS_A_PERSON, Part
from jaxpoint.simulate.people.simulated_person import Side
from jaxpoint.simulate.render import Drawn, LitPeople, label_of, samples_alone
from jaxpoint.simulate.viewpoints import Viewpoint

ARM = {
    "left": (Part.LEFT_UPPER_ARM, Part.LEFT_FOREARM, Part.LEFT_HAND, Part.LEFT_FINGER),
    "right": (Part.RIGHT_UPPER_ARM, Part.RIGHT_FOREARM, Part.RIGHT_HAND, Part.RIGHT_FINGER),
}


@dataclass(frozen=True)
class ViewTruth:
    """One person, one image. The arm is the one that points in the present gesture, or else in the next."""

    person: int
    hand: Side
    forearm_visible: float  # share of its pixels, 0..1: in the scene over those of the arm drawn alone
    forearm_angle_deg: float  # between elbow-wrist axis and line of sight, 0..90
    finger_visible: float
    silhouette_px: int
    head: Float[np.ndarray, "2"]  # px; NaN behind the camera
    elbow: Float[np.ndarray, "2"]
    wrist: Float[np.ndarray, "2"]
    tip: Float[np.ndarray, "2"]


def view_truth(
    view: Viewpoint,
    people: LitPeople,
    shown: Drawn,
    person: int,
    hand: Side,
    joints: dict[str, Float[np.ndarray, "3"]],
) -> ViewTruth:
    """The truth of a person whose joints (m) these are, in an image."""
    elbow, wrist = joints[f"{hand}_elbow"], joints[f"{hand}_wrist"]
    pixels = view.project(np.stack([joints["head"], elbow, wrist, joints[f"{hand}_tip"]]))[0]
    arm = [label_of(part, person) for part in ARM[hand]]
    forearm, finger = (_visible(view, people, shown, part, arm) for part in (arm[1], arm[3]))
    first = PARTS_A_PERSON * person
    silhouette = int(shown.pixels[max(1, first) : first + PARTS_A_PERSON].sum())
    return ViewTruth(person, hand, forearm, _angle_deg(view, elbow, wrist), finger, silhouette, *pixels)


def _visible(view: Viewpoint, people: LitPeople, shown: Drawn, label: int, arm: list[int]) -> float:
    seen = int(shown.samples[label])
    alone = samples_alone(view, people, label, arm) if seen else 0
    return min(1.0, seen / alone) if alone else 0.0


def _angle_deg(view: Viewpoint, elbow: np.ndarray, wrist: np.ndarray) -> float:
    """Between the forearm and the line of sight to its middle."""
    axis, sight = wrist - elbow, (elbow + wrist) / 2 - view.position
    cosine = abs(axis @ sight) / np.linalg.norm(axis) / np.linalg.norm(sight)
    return float(np.rad2deg(np.arccos(min(1.0, cosine))))
