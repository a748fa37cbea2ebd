"""People through a recording: heads from all views to tracks, and each person's arm in each frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Float, Int

from jaxpoint.body.arm import PointingArm
from jaxpoint.body.continuity import with_neighbours
from jaxpoint.body.joint_arms import SeenArms, joint_arms
from jaxpoint.body.limb_arms import find_arm, find_arm_again
from jaxpoint.body.tracking.head_tracks import Tracking
from jaxpoint.body.tracking.tracker import track_heads
from jaxpoint.camera.rig import CameraRig
from jaxpoint.config.track import TrackSettings
from jaxpoint.evidence.camera_evidence import AbstractCameraEvidence
from jaxpoint.evidence.person_evidence import AbstractPersonEvidence

HEAD_SIGMA = 0.07  # of its height, the error of a head's middle in one view
CUT_HEAD_SIGMA = 0.15  # the same where much of it is outside the image
ARM_M = 1.0  # from a head, the farthest that its arm is seen
NEAREST_M = 0.3  # as near to a camera as a head is taken to be
INSIDE = 0.15  # of its box's height, by which a head may lie outside the silhouette that it belongs to

Progress = Callable[[str, int, int], None]
"""Called with what is done, how much of it is done, and how much there is."""
ArmsOfAll = dict[tuple[int, int], PointingArm | None]
"""By frame and person."""


@dataclass(frozen=True)
class Following:
    """N people over F frames by C cameras."""

    tracking: Tracking
    sightings: Int[np.ndarray, "F N C"]  # which sighting of each camera is the person; -1 where none
    arms: ArmsOfAll  # by frame and person, where the person is in the room


def follow(
    rig: CameraRig,
    views: Sequence[AbstractCameraEvidence],
    times: Float[np.ndarray, " F"],
    settings: TrackSettings | None = None,
    *,
    frame_ids: Int[np.ndarray, " F"] | None = None,
    progress: Progress | None = None,
) -> Following:
    """Follow everybody and find their arms.

    Args:
        rig: the cameras, C of them, m.
        views: what each camera saw of the same F frames.
        times: s.
        settings: of the head track.
        frame_ids: numbers of the frames.
        progress: called with what is done, how much of it, and how much there is.

    Raises:
        InsufficientDataError: fewer than two cameras.
    """
    pixels, valid, sigma, doubtful, index = _heads(views, len(times))

    def report(share: float) -> None:
        if progress:
            progress("heads", round(share * len(times)), len(times))

    settings = settings or TrackSettings()
    tracking = track_heads(
        rig, pixels, valid, times, settings, sigma_px=sigma, doubtful=doubtful, frame_ids=frame_ids, progress=report
    )
    with jax.enable_x64(True):
        return _with_arms(rig, views, _with_sightings(rig, views, tracking, index), progress)


def _with_sightings(
    rig: CameraRig, views: Sequence[AbstractCameraEvidence], tracking: Tracking, index: Int[np.ndarray, "F C K"]
) -> Following:
    """Whose each sighting is."""
    heads = tracking.heads
    sightings = np.full(tracking.candidates.shape, -1)
    projected, depth = np.asarray(rig.project(heads.positions)), np.asarray(rig.depth(heads.positions))
    reach = ARM_M * np.asarray(rig.cameras.focal).mean(axis=1) / np.maximum(depth, NEAREST_M)  # px
    for frame, person in np.argwhere(heads.present).tolist():
        place = projected[frame, person]
        sightings[frame, person] = [
            _sighting(views[c], frame, index[frame, c], int(tracking.candidates[frame, person, c]), place[c])
            if depth[frame, person, c] > 0
            else -1
            for c in range(len(views))
        ]
    for frame, person, camera in np.argwhere((sightings < 0) & heads.present[..., None] & (depth > 0)).tolist():
        others = sightings[frame, :, camera]
        place = projected[frame, person, camera]
        sightings[frame, person, camera] = _beside(
            views[camera], frame, others, place, float(reach[frame, person, camera])
        )
    return Following(tracking, sightings, {})


@dataclass(frozen=True)
class _ArmSearch:
    """Looks for arms in the evidence of all views."""

    rig: CameraRig
    views: Sequence[AbstractCameraEvidence]
    following: Following
    head_px: Float[np.ndarray, "F N C 2"]

    def people(self, frame: int, person: int) -> list[AbstractPersonEvidence | None]:
        """What each view shows of a person in a frame."""
        own = self.following.sightings[frame, person].tolist()
        return [self.views[camera].person(sighting) if sighting >= 0 else None for camera, sighting in enumerate(own)]

    def by_joints(self, present: Sequence[tuple[int, int]]) -> ArmsOfAll:
        """The arms that joints show, of all frames and people together."""
        heads = self.following.tracking.heads.positions
        seen = SeenArms.of([self.people(*one) for one in present])
        return dict(zip(present, joint_arms(self.rig, seen, np.array([heads[one] for one in present]).reshape(-1, 3))))

    def by_outlines(self, frame: int, person: int) -> PointingArm | None:
        """The arm that outlines show."""
        head = self.following.tracking.heads.positions[frame, person]
        return find_arm(self.rig, self.people(frame, person), head, self.head_px[frame, person])

    def beside(self, arms: ArmsOfAll, frame: int, other: int, person: int) -> PointingArm | None:
        """The arm in a frame where that of another frame predicts it."""
        head, before = self.following.tracking.heads.positions[[frame, other], person]
        arm = arms[other, person]
        if arm is None:
            return None
        return find_arm_again(self.rig, self.people(frame, person), head, arm, head - before)


def _with_arms(
    rig: CameraRig, views: Sequence[AbstractCameraEvidence], following: Following, progress: Progress | None
) -> Following:
    """The arms of everybody in every frame: by joints where views show them, else by outlines."""
    heads = following.tracking.heads
    search = _ArmSearch(rig, views, following, np.asarray(rig.project(heads.positions)))
    arms = search.by_joints([(int(frame), int(person)) for frame, person in np.argwhere(heads.present)])
    for frame in range(len(heads.positions)):
        for person in np.flatnonzero(heads.present[frame]).tolist():
            if arms[frame, person] is None:
                arms[frame, person] = search.by_outlines(frame, person)
        if progress:
            progress("arms", frame + 1, len(heads.positions))
    for person in range(heads.present.shape[1]):
        own = {frame: arm for (frame, who), arm in arms.items() if who == person}
        agreed = with_neighbours(own, heads.times, lambda f, o, who=person: search.beside(arms, f, o, who))
        arms.update({(frame, person): arm for frame, arm in agreed.items()})
    return replace(following, arms=arms)


def _heads(views: Sequence[AbstractCameraEvidence], frames: int):
    """Candidates of heads as arrays (F, C, K).

    Pixels, which there are, their errors (px), which are doubtful, and whose sighting each is.
    """
    most = max((int(np.bincount(view.frame).max(initial=1)) for view in views if len(view.frame)), default=1)
    pixels = np.zeros((frames, len(views), most, 2))
    valid = np.zeros((frames, len(views), most), bool)
    sigma = np.ones((frames, len(views), most))
    doubtful = np.zeros((frames, len(views), most), bool)
    index = np.full((frames, len(views), most), -1)
    for camera, view in enumerate(views):
        found, whole = view.head_found, view.head_inside
        place = np.arange(len(view.frame)) - np.searchsorted(view.frame, view.frame)
        pixels[view.frame, camera, place] = view.head
        valid[view.frame, camera, place] = found | view.head_cut
        relative = np.where(found, HEAD_SIGMA, CUT_HEAD_SIGMA)
        sigma[view.frame, camera, place] = np.maximum(1.0, relative * view.head_height)
        doubtful[view.frame, camera, place] = ~(found & whole)
        index[view.frame, camera, place] = np.arange(len(view.frame))
    return pixels, valid, sigma, doubtful, index


def _sighting(view: AbstractCameraEvidence, frame: int, index: np.ndarray, used: int, head: np.ndarray) -> int:
    """The sighting whose head was used; else the one whose box holds the head, the largest first."""
    if used >= 0:
        return int(index[used])
    head = np.clip(head, 0, np.array(view.size) - 1)  # the rest of a person cut by the image's border is still there
    for sighting in view.of(frame):
        x, y, width, height = view.box[sighting]
        margin = INSIDE * height
        if x - margin <= head[0] <= x + width + margin and y - margin <= head[1] <= y + height:
            return sighting
    return -1


def _beside(view: AbstractCameraEvidence, frame: int, others: np.ndarray, head: np.ndarray, reach: float) -> int:
    """The nearest sighting of nobody else at the image's border, beyond which the head is: an arm that reaches in."""
    size = np.array(view.size)
    if ((head >= 0) & (head < size)).all():
        return -1
    best, least = -1, reach
    for sighting in view.of(frame):
        low, extent = view.box[sighting, :2], view.box[sighting, 2:]
        cut = (low <= 0).any() or (low + extent >= size).any()
        apart = float(np.linalg.norm(head - np.clip(head, low, low + extent)))
        if cut and apart < least and sighting not in others:
            best, least = sighting, apart
    return best
