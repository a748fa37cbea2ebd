"""What one camera shows of people over a recording, whoever found it."""

from __future__ import annotations

import abc
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from jaxpoint.evidence.person_evidence import AbstractPersonEvidence

HEAD_ASPECT = 0.78  # width of a head over its height
OUTSIDE = 0.15  # of a head's width or height that may lie beyond the image's border


class FrameReason(IntEnum):
    """What a frame of one camera held."""

    PERSON = 0
    NO_IMAGE = 1  # the camera has no image of this frame
    REPEATED = 2  # the same image as before: a frame was doubled
    TOO_DARK = 3
    BLOWN_OUT = 4  # more than half of the pixels are saturated
    LIGHT_SWITCHED = 5  # most of the image changed in one direction
    IDLE = 6  # nothing moved, and nobody was there before
    NOBODY = 7  # nothing that is large enough differs from the room
    WITHOUT_COLOUR = 8  # the empty room was recorded in colour, so that all of a grey image differs from it


class HeadReason(IntEnum):
    """Why a person in one view has a head, or has none."""

    FOUND = 0
    TOO_SMALL = 1  # the silhouette is no higher than the smallest head
    NO_SIZE_FITS = 2  # no head between the nearest and the farthest distance fits the silhouette
    UNLIKE = 3  # nothing in its upper part is enough like an ellipse
    OUT_OF_VIEW = 4  # too much of it is beyond the image's border


@dataclass(frozen=True, kw_only=True)
class AbstractCameraEvidence(abc.ABC):
    """F frames of one camera, with S sightings of people in all of them."""

    size: tuple[int, int]  # px, width and height
    reasons: Int[np.ndarray, " F"]  # values of `FrameReason`
    frame: Int[np.ndarray, " S"]  # place among the F frames, rising
    box: Int[np.ndarray, "S 4"]  # px: left, top, width, height
    head: Float[np.ndarray, "S 2"]  # px
    head_height: Float[np.ndarray, " S"]  # px
    head_reason: Int[np.ndarray, " S"]  # values of `HeadReason`
    notes: tuple[str, ...] = ()  # what to know of the recording, a sentence each

    @abc.abstractmethod
    def person(self, sighting: int) -> AbstractPersonEvidence:
        """What is known of the person of one sighting."""

    def of(self, frame: int) -> range:
        """The sightings of one frame."""
        first, last = np.searchsorted(self.frame, [frame, frame + 1])
        return range(int(first), int(last))

    @property
    def head_found(self) -> Bool[np.ndarray, " S"]:
        """Sightings whose head was found."""
        return self.head_reason == HeadReason.FOUND

    @property
    def head_cut(self) -> Bool[np.ndarray, " S"]:
        """Sightings whose head was found, but too much of it lies outside the image to trust its place."""
        return self.head_reason == HeadReason.OUT_OF_VIEW

    @property
    def head_inside(self) -> Bool[np.ndarray, " S"]:
        """Sightings whose head lies in the image but for a small part: what is cut by the border may be a shoulder."""
        half = self.head_height[:, None] / 2 * np.array([HEAD_ASPECT, 1.0])
        beyond = np.maximum(half - self.head, self.head + half - np.array(self.size))
        return np.all(beyond <= 2 * OUTSIDE * half, axis=1)

    # For tables and pictures; a detector that has them overrides these.

    @property
    def moving_edges(self) -> Int[np.ndarray, " F"]:
        """Moving edge pixels of each image; 0 where motion is not looked at."""
        return np.zeros(len(self.reasons), int)

    @property
    def colourless(self) -> Bool[np.ndarray, " F"]:
        """Images without colour."""
        return np.zeros(len(self.reasons), bool)

    @property
    def silhouette_px(self) -> Int[np.ndarray, " S"]:
        """Area of each silhouette; 0 where there is none."""
        return np.zeros(len(self.frame), int)

    @property
    def head_certainty(self) -> Float[np.ndarray, " S"]:
        """How sure the detector is of each head, up to 1; 0 where it does not say."""
        return np.zeros(len(self.frame))

    def labels(self, sighting: int) -> tuple[UInt8[np.ndarray, "h w"], tuple[int, int]] | None:
        """The `Pixel`s of a person's part of the image, and its corner (x, y); None where the outline is unknown."""
        return None
