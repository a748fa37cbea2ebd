"""One camera's look for people: frame by frame, from an image to heads and crops."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from jaxpoint.config.person import PersonSettings
from jaxpoint.detection.colour import Image, is_grey
from jaxpoint.detection.person.clothes import shirt_like_skin
from jaxpoint.detection.person.crop import Crop
from jaxpoint.detection.person.frame_motion import motion_image, motion_of
from jaxpoint.detection.person.head_template import Head, find_head
from jaxpoint.detection.person.silhouette import (
    AdaptiveBackground,
    RoomBackground,
    Silhouette,
    close_gaps,
    foreground,
    sharpen,
    silhouettes,
)
from jaxpoint.detection.person.skin import SkinModel, skin_mask, skin_model, white_balance, white_gains
from jaxpoint.evidence.camera_evidence import FrameReason
from jaxpoint.evidence.limb_slices import Pixel

DARK = 16.0  # grey levels: brighter than this are fewer than 1 % of the pixels of an image without light
BLOWN = 0.5  # part of the pixels that are saturated in an image with too much
SATURATED = 250
MARGIN = 0.35  # of a silhouette's height, around it: an arm may be cut off from the trunk
GAP = 0.2  # of a head's height, the widest gap in a limb that is closed
COLOURED = 0.1  # part of the room's pixels with colour, beyond which an image without any differs by that alone
SEAM_PX = 3  # on either side of an outline, within which it is decided at the image's own size
SEAM_LEVELS = 18.0  # grey levels, sum of the differences in Y, Cr and Cb: foreground at that size


@dataclass(frozen=True)
class Sighting:
    """A person in one image, or what may be one."""

    silhouette: Silhouette
    head: Head
    crop: Crop


@dataclass(frozen=True)
class Look:
    """What one frame of one camera held."""

    reason: FrameReason
    edges: int  # moving edge pixels
    grey: bool  # the image has no colour, so that skin cannot be recognised
    sightings: tuple[Sighting, ...] = ()


class PersonWatch:
    """Looks through one camera's frames in their order; remembers the last image and whether anybody was there."""

    def __init__(
        self,
        background: RoomBackground | None,
        motion_threshold: float,
        focal_px: float,
        settings: PersonSettings,
        model: SkinModel | None = None,
    ):
        """
        Args:
            background: of the empty room; None learns while watching (`background.method` mog2 or knn).
            motion_threshold: edge pixels above which something moves.
            focal_px: focal length, px.
            settings: of all stages.
            model: of skin; by default the one that the settings name.
        """
        self._room = None if background is None else background.whole
        self._in_colour = background is not None and not is_grey(background.whole, COLOURED)
        balanced = settings.skin.white_balance
        self._gains = white_gains(background.whole) if balanced and background is not None else None
        self._background = background if background is not None else AdaptiveBackground(settings.background)
        self._threshold = motion_threshold
        self._focal = focal_px
        self._settings = settings
        self._model = model or skin_model(settings.skin)
        self._previous: Image | None = None
        self._before: UInt8[np.ndarray, "h w 3"] | None = None  # the same, prepared for the detection of motion
        self._moving = self._still = 0
        self._occupied = True  # until a first look has shown otherwise

    def look(self, image: Image) -> Look:
        """The next frame."""
        spoilt = _exposure(image)
        previous, self._previous = self._previous, image
        before, self._before = self._before, motion_image(image, self._settings.motion)
        if spoilt is not None:
            return Look(spoilt, 0, False)
        edges = 0
        if previous is not None and before is not None:
            if _same(previous, image):
                return Look(FrameReason.REPEATED, 0, False)
            motion = motion_of(before, self._before, self._settings.motion)
            edges = motion.edges
            if motion.is_light_switch:
                self._occupied = True
                return Look(FrameReason.LIGHT_SWITCHED, edges, False)
            self._count(edges)
        if not self._occupied:
            return Look(FrameReason.IDLE, edges, False)
        return self._look_at_people(image, edges)

    def _count(self, edges: int) -> None:
        """Hysteresis of motion; a person who stands still stays, as long as a silhouette does."""
        moving = edges > self._threshold
        self._moving, self._still = (self._moving + 1, 0) if moving else (0, self._still + 1)
        if self._moving >= self._settings.motion.frames_on:
            self._occupied = True

    def _look_at_people(self, image: Image, edges: int) -> Look:
        grey = is_grey(image)
        if grey and self._in_colour:
            return Look(FrameReason.WITHOUT_COLOUR, edges, grey)
        if isinstance(self._background, AdaptiveBackground):
            mask = self._background.foreground(image)
        else:
            mask = foreground(image, self._background, self._settings.background)
        found = silhouettes(mask, self._settings.silhouette)
        if not found:
            self._occupied = self._still < self._settings.motion.frames_off
            return Look(FrameReason.NOBODY, edges, grey)
        sightings = tuple(self._sighting(image, mask, silhouette, grey) for silhouette in found)
        return Look(FrameReason.PERSON, edges, grey, sightings)

    def _sighting(self, image: Image, mask: UInt8[np.ndarray, "H W"], silhouette: Silhouette, grey: bool) -> Sighting:
        head = find_head(silhouette, self._focal, self._settings.head)
        gap = int(GAP * head.height_px) if head.found else 0
        model = None if grey else self._model
        return Sighting(silhouette, head, cut_crop(image, mask, silhouette, model, self._room, gap, self._gains, head))


def cut_crop(
    image: Image,
    mask: UInt8[np.ndarray, "H W"],
    silhouette: Silhouette,
    model: SkinModel | None,
    room: Image | None = None,
    gap_px: int = 0,
    gains: Float[np.ndarray, "3"] | None = None,
    head: Head | None = None,
) -> Crop:
    """The surroundings of a silhouette: which pixels are foreground, and which of them skin.

    Args:
        image: the whole image.
        mask: its foreground.
        silhouette: of the person.
        model: of skin; None where the image has no colour.
        room: the image without people, by which outlines are sharpened; None where it is not known.
        gap_px: gaps of this width are closed: a limb before something of its own colour has holes.
        gains: of blue, green, red, that divide out the room's cast of colour before skin is recognised; None leaves it.
        head: by whose face a shirt of the colour of skin is recognised; None trusts the model alone.
    """
    x, y, width, height = silhouette.box
    reach = int(MARGIN * height)
    left, top = max(x - reach, 0), max(y - reach, 0)
    right, bottom = min(x + width + reach, image.shape[1]), min(y + height + 2 * SEAM_PX, image.shape[0])
    own = mask[top:bottom, left:right].copy()
    own[y - top : y - top + height, x - left : x - left + width] |= silhouette.mask.view(np.uint8) * np.uint8(255)
    if gap_px > 1:
        own = close_gaps(own, gap_px | 1)
    part = image[top:bottom, left:right]
    if room is not None:
        own = sharpen(own, part, room[top:bottom, left:right], SEAM_LEVELS, SEAM_PX)
    x, y, width, height = cv2.boundingRect(own)  # it is never empty: the silhouette has an inside
    own, part = (one[y : y + height, x : x + width] for one in (own, part))
    labels = cv2.threshold(own, 0, int(Pixel.PERSON), cv2.THRESH_BINARY)[1]
    if model is not None:
        colours = part if gains is None else white_balance(part, gains)
        skin = skin_mask(np.ascontiguousarray(colours), model) & (own > 0)
        if head is not None and head.found:
            place = (head.x - left - x, head.y - top - y, head.height_px)
            shirt = shirt_like_skin(part, own > 0, skin, place)
            skin = skin if shirt is None else skin & ~shirt
        labels[skin] = Pixel.SKIN
    return Crop(labels, (left + x, top + y), silhouette.image_size)


def _exposure(image: Image) -> FrameReason | None:
    blue, green, red = (image[4::16, 4::16, channel] for channel in range(3))
    some = np.maximum(np.maximum(blue, green), red)
    if np.percentile(some, 99) < DARK:
        return FrameReason.TOO_DARK
    return FrameReason.BLOWN_OUT if np.mean(some >= SATURATED) > BLOWN else None


def _same(previous: Image, image: Image) -> bool:
    """Whether two images are one: a new one would have other noise."""
    return np.array_equal(previous[::8, ::8], image[::8, ::8])
