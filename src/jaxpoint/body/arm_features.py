"""What tells an arm that points from other limbs that views may agree on: a leg, a hanging or a reversed arm.

Each feature is weak: the hand is bare, nothing of the person lies beyond its tip, the forearm widens towards the elbow,
the elbow hangs on a shoulder, the hand lies on the forearm's axis and farther out than the elbow, many slices were
measured, no view looks past it. Together, weighed by a logistic regression (`experiments/arm_features.py`), they
decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np
from jaxtyping import Float

from jaxpoint.body.limb_association import SHOULDER_BELOW_M
from jaxpoint.body.limb_axis import LimbAxis
from jaxpoint.body.strips import Strip
from jaxpoint.camera.rig import CameraRig
from jaxpoint.evidence.limb_slices import Pixel
from jaxpoint.evidence.person_evidence import AbstractPersonEvidence

ELBOW_M = 0.33  # from the middle between the shoulders to the elbow of an arm that points
BEYOND_M = (0.03, 0.12)  # behind the tip, where nothing of the person should be
MIN_SLICES = 8  # of a view whose widths show how the limb widens
MOST_PAST = 2  # more views that look past it count no more
_HAND, _BEHIND = 6, 5  # places that are looked at
# Where nothing can be seen, as of a hand that no view holds whole: the mean of arms and others.
_UNSEEN_HAND, _UNSEEN_BEYOND = 0.6, 0.3
_NEAREST_M = 0.3


@dataclass(frozen=True)
class ArmFeatures:
    """What is known of a measured limb."""

    stretch: float  # m, of the tip from the body's upright axis
    slices: float  # that count, of all views together
    skin: float  # part of the hand that is bare
    beyond: float  # part of the places beyond the tip that are still the person
    bent: float  # m, from the tip to the forearm's axis
    outward: float  # cosine between the forearm and the horizontal from the shoulders to the tip
    widens: float  # growth of the width from wrist to elbow, as a part of the width
    elbow: float  # m, by which the elbow is farther from, or nearer to, the shoulders than of an arm that points
    past: float  # views that look past it

    @property
    def log_odds(self) -> float:
        """Of an arm that points."""
        return float(np.dot(WEIGHTS, astuple(self)) + CONSTANT)


# In the order of `ArmFeatures`: fitted to ordinary gestures (`experiments/arm_features.py --seeds 210 220`) and,
# together with them, to hard ones, of which arms were missed or mistaken before.
WEIGHTS = np.array([4.0, 0.029, 3.9, -1.9, -40.0, 6.2, 4.4, -12.6, -1.5])
CONSTANT = -8.7


def arm_features(
    rig: CameraRig,
    people: Sequence[AbstractPersonEvidence | None],
    head: Float[np.ndarray, "3"],
    axis: LimbAxis,
    tip: Float[np.ndarray, "3"],
    strips: Sequence[Strip | None],
    forearm_m: tuple[float, float],
    past: int,
) -> ArmFeatures:
    """The features of a limb that was measured in the images.

    Args:
        rig: the cameras.
        people: what each view shows of the person; None where it shows nothing.
        head: centre of the head, m.
        axis: of the forearm.
        tip: of the hand, m.
        strips: the forearm in each view that is used.
        forearm_m: from the tip to the wrist and to the elbow, m.
        past: views that look past it.
    """
    ahead, near = np.asarray(axis.direction), np.asarray(axis.near)
    foot = near + ((tip - near) @ ahead) * ahead
    wrist, elbow = foot - forearm_m[0] * ahead, foot - forearm_m[1] * ahead
    shoulders = head - np.array([0.0, 0.0, SHOULDER_BELOW_M])
    skin, beyond = _hand(rig, people, wrist, tip)
    out = tip - shoulders
    flat = np.array([out[0], out[1], 0.0])
    reach = float(np.linalg.norm(flat))
    return ArmFeatures(
        stretch=reach + max(0.0, float(out[2])),
        slices=float(np.asarray(axis.slices).sum()),
        skin=skin,
        beyond=beyond,
        bent=float(np.linalg.norm(tip - foot)),
        outward=float(ahead @ flat) / max(reach, 1e-6),
        widens=_widens(strips),
        elbow=abs(float(np.linalg.norm(elbow - shoulders)) - ELBOW_M),
        past=float(min(past, MOST_PAST)),
    )


def _hand(
    rig: CameraRig,
    people: Sequence[AbstractPersonEvidence | None],
    wrist: Float[np.ndarray, "3"],
    tip: Float[np.ndarray, "3"],
) -> tuple[float, float]:
    """Part of the hand that is skin, and part beyond the tip that is the person: means of the views that hold them."""
    ahead = (tip - wrist) / max(float(np.linalg.norm(tip - wrist)), 1e-6)
    inside = wrist + np.linspace(0, 1, _HAND + 2)[1:-1, None] * (tip - wrist)
    places = np.concatenate([inside, tip + np.linspace(*BEYOND_M, _BEHIND)[:, None] * ahead])
    pixels, depth = np.asarray(rig.project(places)), np.asarray(rig.depth(places))
    sizes = np.asarray(rig.image_sizes)
    held = (pixels >= 0).all(axis=-1) & (pixels <= sizes - 1).all(axis=-1) & (depth > _NEAREST_M)
    coloured = any(person is not None and person.shows_skin for person in people)
    skin, beyond = [], []
    for camera, person in enumerate(people):
        if person is None or not person.outlined:
            continue
        seen = person.pixels_at(pixels[:, camera])
        if coloured and held[:_HAND, camera].all():
            skin.append(np.mean(seen[:_HAND] == Pixel.SKIN))
        if held[_HAND:, camera].all():
            beyond.append(np.mean(seen[_HAND:] != Pixel.NOTHING))
    return float(np.mean(skin or [_UNSEEN_HAND])), float(np.mean(beyond or [_UNSEEN_BEYOND]))


def _widens(strips: Sequence[Strip | None]) -> float:
    """Growth of the width over the whole span, as a part of the width: the middle of all views, -1 to 1."""
    growth = []
    for strip in strips:
        place = np.flatnonzero(strip.width > 0) if strip is not None else np.zeros(0, int)
        if strip is not None and len(place) >= MIN_SLICES:
            width = strip.width[place]
            slope = np.polyfit(place - place.mean(), width / np.median(width), 1)[0]
            growth.append(slope * (len(strip.width) - 1))
    return float(np.clip(np.median(growth), -1, 1)) if growth else 0.0
