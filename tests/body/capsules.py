"""A person of capsules, drawn into the images of a rig: truth for whatever reads arms out of masks."""

from dataclasses import dataclass

import cv2
import numpy as np

from jaxpoint.camera.rig import CameraRig
from jaxpoint.detection.person.crop import Crop
from jaxpoint.detection.person.silhouette_evidence import SilhouetteEvidence
from jaxpoint.evidence.limb_slices import Pixel

SHIFT = 4  # bits of sub-pixel that OpenCV draws with


@dataclass(frozen=True)
class Capsule:
    """A limb between two joints, with a radius at each (m)."""

    a: np.ndarray
    b: np.ndarray
    radius_a: float
    radius_b: float
    label: Pixel


@dataclass(frozen=True)
class CapsulePerson:
    """Joints (m) of a standing person and what to draw."""

    joints: dict[str, np.ndarray]
    capsules: tuple[Capsule, ...]


def capsule_person(place, forearm, upper, *, sleeve=1.0, hand_bend=0.0, bare=False) -> CapsulePerson:
    """A person at `place` (x, y) whose right forearm and upper arm point along unit vectors.

    Args:
        place: on the floor, m.
        forearm, upper: directions towards the hand.
        sleeve: share of the upper arm that is covered.
        hand_bend: angle by which the hand leaves the forearm's axis upwards, rad.
        bare: the trunk is of skin too.
    """
    x, y = place
    up = np.array([0.0, 0.0, 1.0])
    shoulder = np.array([x, y - 0.2, 1.42])
    elbow = shoulder + 0.30 * upper
    wrist = elbow + 0.26 * forearm
    side = np.cross(forearm, up)
    side = side / np.linalg.norm(side)
    hand = np.cos(hand_bend) * forearm + np.sin(hand_bend) * np.cross(side, forearm)
    knuckle, tip = wrist + 0.09 * hand, wrist + 0.19 * hand
    other = np.array([x, y + 0.2, 1.42])
    other_elbow, other_wrist = other + np.array([0.02, 0.06, -0.30]), other + np.array([0.06, 0.08, -0.55])
    hip = np.array([0.0, 0.09, 0.0])
    head, neck, pelvis = np.array([x, y, 1.62]), np.array([x, y, 1.45]), np.array([x, y, 0.95])
    cut = shoulder + sleeve * (elbow - shoulder)
    trunk = Pixel.SKIN if bare else Pixel.PERSON
    capsules = (
        Capsule(neck, pelvis, 0.13, 0.14, trunk),
        Capsule(shoulder, other, 0.06, 0.06, trunk),
        Capsule(pelvis + hip, np.array([x, y + 0.1, 0.05]), 0.08, 0.05, Pixel.PERSON),
        Capsule(pelvis - hip, np.array([x, y - 0.1, 0.05]), 0.08, 0.05, Pixel.PERSON),
        Capsule(head - 0.04 * up, head + 0.04 * up, 0.075, 0.08, Pixel.SKIN),
        Capsule(other, other_elbow, 0.05, 0.045, Pixel.PERSON),
        Capsule(other_elbow, other_wrist, 0.042, 0.028, Pixel.SKIN),
        Capsule(other_wrist, other_wrist + np.array([0.02, 0.0, -0.15]), 0.03, 0.015, Pixel.SKIN),
        Capsule(shoulder, cut, 0.05, 0.045, Pixel.PERSON),
        Capsule(cut, elbow, 0.045, 0.042, Pixel.SKIN),
        Capsule(elbow, wrist, 0.042, 0.028, Pixel.SKIN),
        Capsule(wrist, knuckle, 0.03, 0.03, Pixel.SKIN),
        Capsule(knuckle, tip - 0.008 * hand, 0.01, 0.008, Pixel.SKIN),
    )
    joints = {"head": head, "shoulder": shoulder, "elbow": elbow, "wrist": wrist, "tip": tip}
    return CapsulePerson(joints, capsules)


def draw(person: CapsulePerson, rig: CameraRig, camera: int) -> Crop:
    """The person's pixels in one image, nearer limbs over farther ones."""
    ends = np.array([[c.a, c.b] for c in person.capsules])
    pixels = np.asarray(rig.project(ends))[..., camera, :]
    depth = np.asarray(rig.depth(ends))[..., camera]
    focal = float(rig.cameras.focal[camera].mean())
    width, height = (int(n) for n in rig.image_sizes[camera])
    image = np.zeros((height, width), np.uint8)
    for i in np.argsort(-depth.mean(axis=1)):
        capsule = person.capsules[i]
        if depth[i].min() < 0.2:
            continue
        radii = focal * np.array([capsule.radius_a, capsule.radius_b]) / depth[i]
        outline = np.concatenate([_circle(p, r) for p, r in zip(pixels[i], radii)])
        hull = cv2.convexHull(outline.astype(np.float32))
        cv2.fillConvexPoly(image, np.round(hull * 2**SHIFT).astype(np.int32), int(capsule.label), shift=SHIFT)
    return Crop(image, (0, 0), (width, height))


def evidence(crops: list[Crop | None]) -> list[SilhouetteEvidence | None]:
    """What views that hold these pixels show of the person."""
    return [None if crop is None else SilhouetteEvidence(crop) for crop in crops]


def _circle(centre, radius):
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    return centre + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
