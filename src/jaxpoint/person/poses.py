"""Heads and arms from the landmarks of a pose estimator: they enter where silhouettes else would (SPEC 4)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import block_diag

from jaxpoint.camera.rig import CameraRig
from jaxpoint.config.track import TrackSettings
from jaxpoint.detect.arm import SLICES, Pixel, Strip
from jaxpoint.detect.head import HeadReason
from jaxpoint.detect.person import FrameReason
from jaxpoint.io.poses import JOINTS, Poses
from jaxpoint.io.session import Session
from jaxpoint.person.arms import HEAD_M, SEATED_M, SMALLEST_M, ArmReason, ArmView, PointingArm
from jaxpoint.person.association import stretch
from jaxpoint.person.continuity import with_neighbours
from jaxpoint.person.following import Following, Progress, follow
from jaxpoint.person.views import CameraViews
from jaxpoint.pointing.axis import LimbAxis
from jaxpoint.triangulation import triangulate

HEAD_SHARE = 0.13  # height of a head over that of a person
LEAST_HEAD_PX = 10.0
HAND_OF_STATURE = 0.108  # from the wrist to the fingertip, where no landmark gives it (Drillis & Contini)
FOREARM_M = (0.15, 0.40)  # a longer or shorter one is a mistaken side
SIDES = ("left", "right")
ARM = ("elbow", "wrist", "index")
GROSS = 0.01  # of the image's width: rms of a joint's views beyond which it is none; beyond half, views are left out
ROUNDS = 3  # of leaving out one view

_PLACE = {name: place for place, name in enumerate(JOINTS)}
_FACES = (("left_ear", "right_ear"), ("head",), ("left_ear", "right_ear", "left_eye", "right_eye", "nose"))


def views_of_poses(session: Session, poses: Poses) -> tuple[CameraViews, ...]:
    """What each camera saw, as the trackers take it: a head for each person, no pixels."""
    return tuple(_view(session, poses, camera) for camera in range(len(session.names)))


def follow_poses(
    rig: CameraRig,
    session: Session,
    poses: Poses,
    views: Sequence[CameraViews],
    settings: TrackSettings | None = None,
    progress: Progress | None = None,
) -> Following:
    """Follow everybody by their landmarks; the arm is the one stretched out farther, from triangulated joints.

    Raises:
        InsufficientDataError: fewer than two cameras.
    """
    following = follow(
        rig, views, session.times, settings, frame_ids=session.moments, progress=progress, with_arms=False
    )
    with jax.enable_x64(True):
        return replace(following, arms=_arms(rig, poses, following))


def _view(session: Session, poses: Poses, camera: int) -> CameraViews:
    own = poses.camera == camera
    pixels, seen, moment = poses.pixels[own], poses.seen[own], poses.moment[own]
    low = np.where(seen[..., None], pixels, np.inf).min(axis=1)
    high = np.where(seen[..., None], pixels, -np.inf).max(axis=1)
    box = np.concatenate([np.floor(low), np.ceil(high - low) + 1], axis=1).astype(int)
    head, found = _heads(pixels, seen)
    frames = session.frame_index[:, camera] >= 0
    reasons = np.where(frames, int(FrameReason.NOBODY), int(FrameReason.NO_IMAGE))
    reasons[moment] = int(FrameReason.PERSON)
    nothing = cv2.imencode(".png", np.full((1, 1), Pixel.NOTHING, np.uint8))[1].tobytes()
    width, height = session.sizes[camera].tolist()
    count = len(moment)
    return CameraViews(
        size=(width, height),
        reasons=reasons,
        edges=np.zeros(len(frames), int),
        grey=np.zeros(len(frames), bool),
        moment=moment,
        box=box,
        area=np.zeros(count, int),
        centroid=np.where(seen[..., None], pixels, 0).sum(axis=1) / seen.sum(axis=1)[:, None],
        head=head,
        head_score=poses.confidence[own].max(axis=1, initial=0.0),
        head_height=np.maximum(HEAD_SHARE * box[:, 3], LEAST_HEAD_PX),
        head_reason=np.where(found, int(HeadReason.FOUND), int(HeadReason.UNLIKE)),
        corner=box[:, :2],
        packed=(nothing,) * count,
    )


def _heads(
    pixels: Float[np.ndarray, "S J 2"], seen: Bool[np.ndarray, "S J"]
) -> tuple[Float[np.ndarray, "S 2"], Bool[np.ndarray, " S"]]:
    """The middle of each head: between both ears, else as given, else the middle of the face."""
    head, found = np.zeros((len(pixels), 2)), np.zeros(len(pixels), bool)
    for names in _FACES:
        place = [_PLACE[name] for name in names]
        there = seen[:, place]
        enough = there.any(axis=1) if names is _FACES[-1] else there.all(axis=1)
        middle = np.where(there[..., None], pixels[:, place], 0).sum(axis=1) / np.maximum(there.sum(axis=1), 1)[:, None]
        head = np.where((enough & ~found)[:, None], middle, head)
        found |= enough
    return head, found


def _arms(rig: CameraRig, poses: Poses, following: Following) -> dict[tuple[int, int], PointingArm | None]:
    """The arm of every person at every moment; the other arm, where neighbours say that this one was lost, is none."""
    heads, own = following.tracking.heads, _by_camera(poses, following.sightings)
    moments, people = np.nonzero(heads.present)
    names = [f"{side}_{part}" for side in SIDES for part in ARM]
    place = [_PLACE[name] for name in names]
    index = own[moments, people]
    there = index >= 0
    pixels = np.where(there[..., None, None], poses.pixels[index][:, :, place], 0.0).swapaxes(1, 2)
    seen = (there[..., None] & poses.seen[index][:, :, place]).swapaxes(1, 2)
    joints = _robust(rig, pixels, seen)
    arms: dict[tuple[int, int], PointingArm | None] = {}
    for row, (moment, person) in enumerate(zip(moments.tolist(), people.tolist())):
        head = heads.positions[moment, person]
        both = [_arm(rig, joints.of(row, slice(3 * side, 3 * side + 3)), head) for side in range(len(SIDES))]
        arms[moment, person] = max((arm for arm in both if arm is not None), key=lambda arm: arm.stretch, default=None)
    return {
        (moment, person): arm
        for person in range(heads.present.shape[1])
        for moment, arm in with_neighbours(_of(arms, person), heads.times, lambda *_: None).items()
    }


def _of(arms: Mapping[tuple[int, int], PointingArm | None], person: int) -> dict[int, PointingArm | None]:
    return {moment: arm for (moment, who), arm in arms.items() if who == person}


def _by_camera(poses: Poses, sightings: Int[np.ndarray, "F N C"]) -> Int[np.ndarray, "F N C"]:
    """Places in `poses` of what trackers count camera by camera; -1 where there is nothing."""
    places = sightings.copy()
    for camera in range(sightings.shape[2]):
        own = np.flatnonzero(poses.camera == camera)
        chosen = sightings[..., camera]
        places[..., camera] = np.where(chosen >= 0, own[chosen] if len(own) else -1, -1)
    return places


@dataclass(frozen=True)
class _Joints:
    """Triangulated joints; R moments of people by J joints, and less once some were taken."""

    points: np.ndarray  # (R, J, 3), m
    covariance: np.ndarray  # (R, J, 3, 3), m^2
    valid: np.ndarray  # (R, J)
    rms: np.ndarray  # (R, J), px
    pixels: np.ndarray  # (R, J, C, 2), px
    used: np.ndarray  # (R, J, C)

    def of(self, row: int, joints: slice) -> _Joints:
        """Some joints of one person at one moment."""
        return _Joints(*(getattr(self, one.name)[row, joints] for one in fields(self)))


def _robust(rig: CameraRig, pixels: Float[np.ndarray, "R J C 2"], seen: Bool[np.ndarray, "R J C"]) -> _Joints:
    """Joints in the room; a view that is grossly off, as of a mistaken side, is left out."""
    gross = GROSS * float(np.asarray(rig.image_sizes)[:, 0].max())
    used = seen.copy()
    solved = triangulate(rig, pixels, used)
    others = ~np.eye(seen.shape[-1], dtype=bool)  # without each view in turn
    for _ in range(ROUNDS):
        suspect = (np.asarray(solved.rms) > gross / 2) & (used.sum(axis=-1) > 2)
        if not suspect.any():
            break
        fewer = used[suspect][:, None] & others
        rms = np.asarray(triangulate(rig, np.repeat(pixels[suspect][:, None], len(others), 1), fewer).rms)
        rms = np.where(used[suspect], rms, np.inf)  # leaving out what is not used changes nothing
        used[suspect] = np.take_along_axis(fewer, rms.argmin(axis=1)[:, None, None], 1)[:, 0]
        solved = triangulate(rig, pixels, used)
    valid = np.asarray(solved.valid) & (np.asarray(solved.rms) <= gross)
    return _Joints(
        np.asarray(solved.points), np.asarray(solved.covariance), valid, np.asarray(solved.rms), pixels, used
    )


def _arm(rig: CameraRig, joints: _Joints, head: Float[np.ndarray, "3"]) -> PointingArm | None:
    """One arm from its elbow, wrist and fingertip; None where there are no two views of both elbow and wrist.

    Elbow and wrist may each be seen by two views that are not the same: no view has the whole forearm then.
    """
    elbow, wrist, tip = joints.points
    length = float(np.linalg.norm(wrist - elbow))
    counted = joints.used[0] & joints.used[1]
    if not joints.valid[:2].all() or counted.sum() < 2 or not FOREARM_M[0] < length < FOREARM_M[1]:
        return None
    direction = (wrist - elbow) / length
    has_tip = bool(joints.valid[2])
    if not has_tip:
        stature = head[2] + HEAD_M / 2
        tip = wrist + HAND_OF_STATURE * (stature if stature > SMALLEST_M else SEATED_M) * direction
    covariance = joints.covariance * np.maximum(1.0, joints.rms)[:, None, None] ** 2
    across = (np.eye(3) - np.outer(direction, direction)) / length
    of_direction = across @ (covariance[0] + covariance[1]) @ across.T
    axis = LimbAxis(
        *(jnp.asarray(part) for part in (wrist, elbow, direction, of_direction)),
        ends_covariance=jnp.asarray(block_diag(covariance[1], covariance[0])),
        rms=jnp.asarray(joints.rms[:2].max()),
        slices=jnp.asarray(counted, dtype=float),
    )
    tips = np.asarray(rig.project(tip))
    own = np.logical_and(joints.used[2], has_tip)
    tips = np.where(own[:, None], joints.pixels[2], tips)
    views = tuple(_arm_view(rig, camera, joints, bool(counted[camera]), tips[camera]) for camera in range(len(rig)))
    spread = float(np.sqrt(np.trace(covariance[2]) / 3)) if has_tip else 0.0
    return PointingArm(tip, spread, jax.tree.map(np.asarray, axis), views, stretch(tip, head))


def _arm_view(rig: CameraRig, camera: int, joints: _Joints, counted: bool, tip: np.ndarray) -> ArmView:
    elbow, wrist = joints.points[:2]
    sight = (elbow + wrist) / 2 - np.asarray(rig.positions)[camera]
    cosine = abs(float(sight @ (wrist - elbow))) / float(np.linalg.norm(sight) * np.linalg.norm(wrist - elbow))
    angle = float(np.arccos(min(1.0, cosine)))
    if not counted:
        return ArmView(ArmReason.NO_ARM, np.zeros(2), None, 0.0, angle)
    ends = joints.pixels[:2, camera]
    share = np.linspace(0.0, 1.0, SLICES)[:, None]
    strip = Strip(ends[1] + share * (ends[0] - ends[1]), np.ones(SLICES), False)
    return ArmView(ArmReason.FOUND, tip, strip, float(joints.rms[:2].max()), angle)
