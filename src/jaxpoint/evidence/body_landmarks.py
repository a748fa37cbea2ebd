"""Joints in single views, as pose estimators give them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxpoint.evidence.camera_evidence import AbstractCameraEvidence, FrameReason, HeadReason
from jaxpoint.evidence.person_evidence import JOINTS, PLACE_OF, AbstractPersonEvidence, SeenJoints

HEAD_SHARE = 0.13  # height of a head over that of a person
LEAST_HEAD_PX = 10.0
_FACES = (("left_ear", "right_ear"), ("head",), ("left_ear", "right_ear", "left_eye", "right_eye", "nose"))


@dataclass(frozen=True)
class BodyLandmarks:
    """S people in single images, in order of frames, with J landmarks each (`JOINTS`)."""

    frame: Int[np.ndarray, " S"]  # place among the session's frames, rising
    camera: Int[np.ndarray, " S"]  # place among the session's cameras
    pixels: Float[np.ndarray, "S J 2"]  # px
    seen: Bool[np.ndarray, "S J"]
    confidence: Float[np.ndarray, "S J"]

    @staticmethod
    def of(people: Iterable[tuple[int, int, Mapping[str, Sequence[float]]]]) -> BodyLandmarks:
        """Landmarks of people in single images, in any order.

        Args:
            people: of each the place of its frame and of its camera in the session, and by the name of a joint x and y
                (px) and, where it is known, the confidence.

        Raises:
            ValueError: a joint of another name.
        """
        found = sorted(people, key=lambda one: one[:2])
        unknown = sorted({name for _, _, joints in found for name in joints} - set(JOINTS))
        if unknown:
            raise ValueError(f"There is no joint '{unknown[0]}'; name them as {', '.join(JOINTS)}.")
        values = np.zeros((len(found), len(JOINTS), 3))
        seen = np.zeros(values.shape[:2], bool)
        for row, (_, _, joints) in enumerate(found):
            for name, (x, y, *confidence) in joints.items():
                values[row, PLACE_OF[name]] = x, y, *(confidence or [1.0])
                seen[row, PLACE_OF[name]] = True
        frame, camera = np.array([one[:2] for one in found], dtype=int).reshape(len(found), 2).T
        return BodyLandmarks(frame, camera, values[..., :2], seen, values[..., 2])


@dataclass(frozen=True)
class LandmarkPerson(AbstractPersonEvidence):
    """Joints alone; nothing is known of the outline."""

    found: SeenJoints

    def joints(self) -> SeenJoints:
        """The joints."""
        return self.found


@dataclass(frozen=True, kw_only=True)
class LandmarkViews(AbstractCameraEvidence):
    """The joints of people in one camera's images."""

    pixels: Float[np.ndarray, "S J 2"]  # px
    seen: Bool[np.ndarray, "S J"]
    confidence: Float[np.ndarray, "S J"]

    def person(self, sighting: int) -> LandmarkPerson:
        """The joints of one sighting."""
        return LandmarkPerson(SeenJoints(self.pixels[sighting], self.seen[sighting]))

    @cached_property
    def head_certainty(self) -> Float[np.ndarray, " S"]:
        """The highest confidence of each person's landmarks."""
        return self.confidence.max(axis=1, initial=0.0)


def landmark_views(
    landmarks: BodyLandmarks, sizes: Int[np.ndarray, "C 2"], has_image: Bool[np.ndarray, "F C"]
) -> tuple[LandmarkViews, ...]:
    """The landmarks camera by camera, with the head of each person.

    Args:
        landmarks: of all cameras.
        sizes: of the images, px, width and height.
        has_image: whether each camera has an image of each frame.
    """
    return tuple(_view(landmarks, camera, sizes[camera], has_image[:, camera]) for camera in range(len(sizes)))


def _view(
    landmarks: BodyLandmarks, camera: int, size: Sequence[int] | Int[np.ndarray, "2"], has_image: Bool[np.ndarray, " F"]
) -> LandmarkViews:
    own = landmarks.camera == camera
    pixels, seen, frame = landmarks.pixels[own], landmarks.seen[own], landmarks.frame[own]
    box = _boxes(pixels, seen)
    head, found = _heads(pixels, seen)
    reasons = np.where(has_image, int(FrameReason.NOBODY), int(FrameReason.NO_IMAGE))
    reasons[frame] = int(FrameReason.PERSON)
    return LandmarkViews(
        size=(int(size[0]), int(size[1])),
        reasons=reasons,
        frame=frame,
        box=box,
        head=head,
        head_height=np.maximum(HEAD_SHARE * box[:, 3], LEAST_HEAD_PX),
        head_reason=np.where(found, int(HeadReason.FOUND), int(HeadReason.UNLIKE)),
        pixels=pixels,
        seen=seen,
        confidence=landmarks.confidence[own],
    )


def _boxes(pixels: Float[np.ndarray, "S J 2"], seen: Bool[np.ndarray, "S J"]) -> Int[np.ndarray, "S 4"]:
    """Left, top, width and height of what is seen of each person, px."""
    low = np.where(seen[..., None], pixels, np.inf).min(axis=1)
    high = np.where(seen[..., None], pixels, -np.inf).max(axis=1)
    return np.concatenate([np.floor(low), np.ceil(high - low) + 1], axis=1).astype(int)


def _heads(
    pixels: Float[np.ndarray, "S J 2"], seen: Bool[np.ndarray, "S J"]
) -> tuple[Float[np.ndarray, "S 2"], Bool[np.ndarray, " S"]]:
    """The middle of each head: between both ears, else as given, else the middle of the face."""
    head, found = np.zeros((len(pixels), 2)), np.zeros(len(pixels), bool)
    for names in _FACES:
        place = [PLACE_OF[name] for name in names]
        there = seen[:, place]
        enough = there.any(axis=1) if names is _FACES[-1] else there.all(axis=1)
        middle = np.where(there[..., None], pixels[:, place], 0).sum(axis=1) / np.maximum(there.sum(axis=1), 1)[:, None]
        head = np.where((enough & ~found)[:, None], middle, head)
        found |= enough
    return head, found
