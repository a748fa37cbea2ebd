"""People as regions that differ from the empty room (thesis 6.2.1, 6.2.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from jaxpoint.config.person import BackgroundSettings, SilhouetteSettings
from jaxpoint.detection.background import median_background
from jaxpoint.detection.colour import Image, scale_channels, shrink_of, shrunk
from jaxpoint.detection.region import Mask, Region, label_regions
from jaxpoint.errors import InsufficientDataError

GAIN_GRID = 8  # px between the pixels from which the common gain is taken
GAIN_RANGE = (20, 235)  # grey levels that are neither noise nor saturated
GAIN_STRIDE = 6  # the same about one person
MIN_GAIN_PIXELS = 100
MAX_GAIN = 2.0
SHADOW_BRIGHTEST = 0.97  # of the light: what is hardly darker is no shadow, and mostly no foreground
WHOLE_IMAGES = 9  # from which the background at full size is taken
GHOST_WIDTH = 320  # px, about the width of the images in which `never_clears` looks
GHOST_IMAGES = 30  # that it looks at
GHOST_REGION = 0.001  # of the image: smaller regions are noise
GHOST_EDGE = 60.0  # grey levels, of a Sobel gradient: fainter edges are not used
GHOST_RATIO = 1.5  # of the stronger edge to the weaker one
MIN_OUTLINE = 200  # px: a shorter outline in all images together is not used
SHADOW_PATCH = 5  # px, side of the squares in which a shadow is even


@dataclass(frozen=True)
class RoomBackground:
    """What a camera sees of the room alone, at 1/shrink of the image's size."""

    level: UInt8[np.ndarray, "h w 3"]  # blue, green, red: medians
    colour: UInt8[np.ndarray, "h w 3"]  # the same as Y, Cr, Cb
    threshold: UInt8[np.ndarray, "h w"]  # grey levels, of the sum of the differences in Y, Cr, Cb
    weak: UInt8[np.ndarray, "h w"]  # the same for pixels next to those above it
    shrink: int
    size: tuple[int, int]  # px, width and height of the whole image
    whole: UInt8[np.ndarray, "H W 3"]  # blue, green, red at full size: the median of a few images


@dataclass(frozen=True)
class Silhouette:
    """One region of foreground, a person as a rule."""

    mask: Bool[np.ndarray, "h w"]  # the pixels inside `box`
    box: tuple[int, int, int, int]  # px: left, top, width, height
    region: Region
    image_size: tuple[int, int]  # px, width and height

    @property
    def at_border(self) -> bool:
        """Whether it touches a side or the top of the image, so that a part of the person may be outside."""
        x, y, width, _ = self.box
        return x == 0 or y == 0 or x + width == self.image_size[0]

    @property
    def is_cut(self) -> bool:
        """Whether it touches any side of the image."""
        return self.at_border or self.box[1] + self.box[3] == self.image_size[1]

    def full(self) -> Bool[np.ndarray, "H W"]:
        """The mask in an image of the full size."""
        x, y, width, height = self.box
        whole = np.zeros(self.image_size[::-1], dtype=bool)
        whole[y : y + height, x : x + width] = self.mask
        return whole

    def crop(self, image: UInt8[np.ndarray, "H W ..."]) -> UInt8[np.ndarray, "h w ..."]:
        """The part of an image inside its box; a view, not a copy."""
        x, y, width, height = self.box
        return image[y : y + height, x : x + width]


def learn_background(images: Sequence[Image], settings: BackgroundSettings) -> RoomBackground:
    """Median and MAD of every pixel over images of one camera, spread over the recording or of the empty room.

    Each image is first brought to the light of the median of all (`follow_light`), so that flicker does not widen the
    thresholds.

    Raises:
        InsufficientDataError: fewer than `min_frames` images.
    """
    if len(images) < settings.min_frames:
        raise InsufficientDataError(
            f"A background is learnt from at least {settings.min_frames} images, and there are {len(images)}; record "
            "the empty room for longer, or lower `background.min_frames`."
        )
    chosen = np.unique(np.linspace(0, len(images) - 1, min(len(images), settings.max_frames)).round().astype(int))
    shrink = shrink_of(images[0].shape[1], settings.width_px)
    small = np.stack([shrunk(images[i], shrink) for i in chosen])
    if settings.follow_light:
        reference = np.median(small[:: max(1, len(small) // 15)], axis=0).astype(np.uint8)
        small = np.stack([_in_light_of(reference, image) for image in small])
    level = np.stack([median_background(small[..., channel]).level for channel in range(3)], axis=-1)
    in_colour = np.stack([cv2.cvtColor(image, cv2.COLOR_BGR2YCrCb) for image in small])
    channels = [median_background(in_colour[..., channel]) for channel in range(3)]
    deviation = np.sqrt(sum(channel.deviation**2 for channel in channels))
    deviations = settings.deviations * deviation
    return RoomBackground(
        level=np.round(level).astype(np.uint8),
        colour=np.round(np.stack([channel.level for channel in channels], axis=-1)).astype(np.uint8),
        threshold=_levels(np.maximum(settings.threshold, deviations)),
        weak=_levels(np.maximum(settings.weak_threshold, deviations)),
        shrink=shrink,
        size=(images[0].shape[1], images[0].shape[0]),
        whole=_median([images[i] for i in chosen[:: max(1, len(chosen) // WHOLE_IMAGES)]]),
    )


def _median(images: Sequence[Image]) -> Image:
    middle = (len(images) - 1) // 2
    return np.partition(np.stack(images), middle, axis=0)[middle]


def _levels(threshold: Float32[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w"]:
    return np.floor(np.minimum(threshold, 255)).astype(np.uint8)


def never_clears(images: Sequence[Image], settings: BackgroundSettings) -> float:
    """Part (0..1) of the foreground's outlines that are edges of the background and not of the image.

    The outline of a person is an edge of the image. Where the median took a person who hardly leaves for the room,
    the foreground is what the person left, and its outline an edge of the median: beyond about a tenth the background
    holds somebody. A person who does not move at all cannot be noticed.
    """
    settings = replace(settings, width_px=GHOST_WIDTH, shadows=False, reach_px=0)
    background = learn_background(images, settings)
    room = _edges(background.level)
    left = real = 0
    for i in np.unique(np.linspace(0, len(images) - 1, GHOST_IMAGES).round().astype(int)):
        seen = _edges(shrunk(images[i], background.shrink))
        outline = _outline(foreground(images[i], background, settings), background.level.shape)
        ours, others = seen[outline], room[outline]
        clear = np.maximum(ours, others) > GHOST_EDGE
        left += np.count_nonzero(clear & (others > GHOST_RATIO * ours))
        real += np.count_nonzero(clear & (ours > GHOST_RATIO * others))
    return left / max(left + real, MIN_OUTLINE)


def foreground(image: Image, background: RoomBackground, settings: BackgroundSettings) -> UInt8[np.ndarray, "H W"]:
    """Pixels that are not the empty room, 255 where they are.

    Raises:
        ValueError: the image has another size than the background.
    """
    size = (image.shape[1], image.shape[0])
    if size != background.size:
        raise ValueError(f"The image has {size[0]} x {size[1]} px and the background {background.size}; learn it anew.")
    small = shrunk(image, background.shrink)
    if settings.follow_light:
        small = _in_light_of(background.level, small)
    colour = cv2.cvtColor(small, cv2.COLOR_BGR2YCrCb)
    difference = cv2.absdiff(colour, background.colour)
    y, cr, cb = cv2.split(difference)
    total = cv2.add(cv2.add(y, cr), cb)  # saturates at 255
    sure = cv2.compare(total, background.threshold, cv2.CMP_GT)
    x, y, width, height = cv2.boundingRect(sure)
    reach = settings.reach_px
    part = np.s_[max(y - reach, 0) : y + height + reach, max(x - reach, 0) : x + width + reach]
    mask = np.zeros_like(sure)
    if width:
        weak = cv2.compare(total[part], background.weak[part], cv2.CMP_GT)
        if settings.shadows:
            weak = cv2.bitwise_and(weak, _without_shade(colour[part], background.colour[part], settings))
        mask[part] = _grow(cv2.bitwise_and(sure[part], weak), weak, reach)
    return _enlarge(mask, background.size)


def _grow(sure: UInt8[np.ndarray, "h w"], weak: UInt8[np.ndarray, "h w"], reach: int) -> UInt8[np.ndarray, "h w"]:
    """What is sure, and what leads to it over weak pixels in `reach` steps: Canny's hysteresis, bounded."""
    square = np.ones((3, 3), np.uint8)
    for _ in range(reach):
        sure = cv2.bitwise_and(cv2.dilate(sure, square), weak)
    return sure


def sharpen(
    mask: UInt8[np.ndarray, "h w"],
    image: Image,
    room: Image,
    threshold: float,
    reach: int,
) -> UInt8[np.ndarray, "h w"]:
    """The mask with its outline decided anew at the image's own size, within `reach` px on either side.

    Args:
        mask: foreground, made at a smaller size; a crop.
        image: the same crop of the image.
        room: the same crop of the background, `RoomBackground.whole`.
        threshold: least sum of differences in Y, Cr and Cb.
        reach: px.
    """
    square = np.ones((3, 3), np.uint8)
    outer, inner = cv2.dilate(mask, square, iterations=reach), cv2.erode(mask, square, iterations=reach)
    x, y, width, height = cv2.boundingRect(outer)
    if not width:
        return inner
    part = np.s_[y : y + height, x : x + width]
    image, room = scale_channels(image[part], _gains_outside(outer, image, room)), room[part]
    y, cr, cb = cv2.split(
        cv2.absdiff(cv2.cvtColor(image, cv2.COLOR_BGR2YCrCb), cv2.cvtColor(room, cv2.COLOR_BGR2YCrCb))
    )
    differs = cv2.threshold(cv2.add(cv2.add(y, cr), cb), threshold, 255, cv2.THRESH_BINARY)[1]
    inner[part] = cv2.bitwise_or(inner[part], cv2.bitwise_and(outer[part], cv2.medianBlur(differs, 3)))
    return inner


def _gains_outside(mask: UInt8[np.ndarray, "h w"], image: Image, room: Image) -> Float[np.ndarray, "3"]:
    """By which each channel of the image becomes the room, outside a mask."""
    outside = np.flatnonzero(mask[::GAIN_STRIDE, ::GAIN_STRIDE].ravel() == 0)
    if len(outside) < MIN_GAIN_PIXELS:
        return np.ones(3)
    seen, wanted = (one[::GAIN_STRIDE, ::GAIN_STRIDE].reshape(-1, 3)[outside].mean(axis=0) for one in (image, room))
    return np.clip((wanted + 1) / (seen + 1), 1 / MAX_GAIN, MAX_GAIN)


class AdaptiveBackground:
    """OpenCV's MOG2 or KNN: for rooms without a recording of their own, where people keep moving."""

    def __init__(self, settings: BackgroundSettings):
        shadows = settings.shadows
        if settings.method == "knn":
            self._model = cv2.createBackgroundSubtractorKNN(history=settings.history, detectShadows=shadows)
        else:
            self._model = cv2.createBackgroundSubtractorMOG2(history=settings.history, detectShadows=shadows)
        self._model.setShadowThreshold(settings.shadow_darkest)
        self._width_px = settings.width_px

    def foreground(self, image: Image) -> UInt8[np.ndarray, "H W"]:
        """As `foreground`; the image also becomes a part of the background."""
        mask = self._model.apply(shrunk(image, shrink_of(image.shape[1], self._width_px)))
        mask = cv2.threshold(mask, 200, 255, cv2.THRESH_BINARY)[1]  # 127 is a shadow
        return _enlarge(mask, (image.shape[1], image.shape[0]))


def silhouettes(mask: Mask, settings: SilhouetteSettings) -> list[Silhouette]:
    """Thickened, closed and connected: the people in a mask of foreground, the largest first."""
    size = (mask.shape[1], mask.shape[0])
    bits = np.ascontiguousarray(mask).view(np.uint8)
    shrink = shrink_of(size[0], settings.width_px)
    if shrink > 1:
        shape = (-(-size[0] // shrink), -(-size[1] // shrink))
        bits = cv2.resize(bits, shape, interpolation=cv2.INTER_NEAREST)
    bits = cv2.threshold(bits, 0, 255, cv2.THRESH_BINARY)[1]
    margin = settings.thicken + settings.close_px
    x, y, width, height = cv2.boundingRect(bits)
    part = np.s_[max(y - margin, 0) : y + height + margin, max(x - margin, 0) : x + width + margin]
    bits[part] = _mend(bits[part], settings)
    labels, regions = label_regions(bits, min_area=max(1, int(settings.min_fraction * bits.size)))
    return [_silhouette(labels, region, shrink, size) for region in regions[: settings.people]]


def _mend(bits: UInt8[np.ndarray, "h w"], settings: SilhouetteSettings) -> UInt8[np.ndarray, "h w"]:
    for _ in range(settings.thicken):
        bits = thicken(bits)
    return close_gaps(bits, settings.close_px) if settings.close_px else bits


def thicken(mask: UInt8[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w"]:
    """Every region grown by a pixel, except where two regions would touch (thesis 6.2.2, hit-or-miss)."""
    grown = cv2.dilate(mask, np.ones((3, 3), np.uint8))
    count, labels = cv2.connectedComponents(mask, connectivity=8, ltype=cv2.CV_16U)
    if count <= 2:
        return grown
    near = np.ones((5, 5), np.uint8)
    highest = cv2.dilate(labels, near)
    lowest = cv2.erode(np.where(labels == 0, np.uint16(65535), labels), near)
    return cv2.bitwise_and(grown, cv2.compare(highest, lowest, cv2.CMP_LE)) | mask


def close_gaps(mask: UInt8[np.ndarray, "h w"], side: int) -> UInt8[np.ndarray, "h w"]:
    """Dilated, then eroded (thesis eq. 6.1 prints the symbol of opening); nothing comes in over the image's border."""
    return cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((side, side), np.uint8))


def _silhouette(labels: np.ndarray, region: Region, shrink: int, size: tuple[int, int]) -> Silhouette:
    """At the image's full size; the outline is smoothed over the pixels that were joined."""
    if shrink == 1:
        return Silhouette(region.crop(labels), region.box, region, size)
    x, y, width, height = (shrink * value for value in region.box)
    width, height = min(width, size[0] - x), min(height, size[1] - y)
    small = region.crop(labels).view(np.uint8) * np.uint8(255)
    mask = cv2.resize(small, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_LINEAR)[:height, :width] > 127
    shift = (shrink - 1) / 2
    whole = replace(
        region,
        area=int(np.count_nonzero(mask)),
        centroid=shrink * region.centroid + shift,
        major=shrink * region.major,
        minor=shrink * region.minor,
        box=(x, y, width, height),
    )
    return Silhouette(mask, whole.box, whole, size)


def _enlarge(mask: UInt8[np.ndarray, "h w"], size: tuple[int, int]) -> UInt8[np.ndarray, "H W"]:
    if mask.shape == size[::-1]:
        return mask
    shrink = round(size[0] / mask.shape[1])
    x, y, width, height = cv2.boundingRect(mask)
    whole = np.zeros(size[::-1], dtype=np.uint8)
    if width:
        part = mask[y : y + height, x : x + width]
        part = cv2.resize(part, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_NEAREST)
        target = whole[shrink * y : shrink * (y + height), shrink * x : shrink * (x + width)]
        target[:] = part[: target.shape[0], : target.shape[1]]
    return whole


def _in_light_of(reference: UInt8[np.ndarray, "h w 3"], image: UInt8[np.ndarray, "h w 3"]) -> np.ndarray:
    """The image times one gain a channel: the median ratio to the reference, of pixels that tell it."""
    rows = np.s_[GAIN_GRID // 2 :: GAIN_GRID, GAIN_GRID // 2 :: GAIN_GRID]
    wanted, seen = reference[rows].reshape(-1, 3).astype(np.float32), image[rows].reshape(-1, 3).astype(np.float32)
    low, high = GAIN_RANGE
    usable = ((wanted > low) & (wanted < high) & (seen > low) & (seen < high)).all(axis=1)
    if np.count_nonzero(usable) < MIN_GAIN_PIXELS:
        return image
    gain = np.median(wanted[usable] / seen[usable], axis=0)
    gain = np.clip(gain, 1 / MAX_GAIN, MAX_GAIN)
    if np.abs(gain - 1).max() < 1e-3:
        return image
    return scale_channels(image, gain)


def _without_shade(
    colour: UInt8[np.ndarray, "h w 3"], room: UInt8[np.ndarray, "h w 3"], settings: BackgroundSettings
) -> UInt8[np.ndarray, "h w"]:
    """255 except where the image is the room, darker by a bounded and even factor and of its colour (Y, Cr, Cb).

    The factor of a shadow is even; that of an arm before planks of its own colour holds the planks' pattern.
    """
    light, cr, cb = (plane.astype(np.float32) for plane in cv2.split(colour))
    room_light, room_cr, room_cb = (plane.astype(np.float32) for plane in cv2.split(room))
    factor = light / np.maximum(room_light, 1)
    # A colour fades towards grey (128) as it darkens.
    faded = np.abs(cr - 128 - factor * (room_cr - 128)) + np.abs(cb - 128 - factor * (room_cb - 128))
    shadow = (factor >= settings.shadow_darkest) & (factor <= SHADOW_BRIGHTEST) & (faded <= settings.shadow_colour)
    mean = cv2.blur(factor, (SHADOW_PATCH, SHADOW_PATCH))
    variance = cv2.blur(factor * factor, (SHADOW_PATCH, SHADOW_PATCH)) - mean * mean
    shadow &= variance <= settings.shadow_texture**2
    return np.where(shadow, np.uint8(0), np.uint8(255))


def _edges(small: UInt8[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w"]:
    """Largest gradient within a pixel of each."""
    smooth = cv2.GaussianBlur(small, (3, 3), 0)
    parts = [cv2.Sobel(smooth, cv2.CV_32F, 1 - axis, axis) for axis in (0, 1)]
    strength = np.sqrt(sum((part**2).sum(axis=2) for part in parts))
    return cv2.dilate(strength, np.ones((3, 3), np.uint8))


def _outline(mask: UInt8[np.ndarray, "H W"], shape: tuple[int, ...]) -> Bool[np.ndarray, "h w"]:
    """Border of the foreground's larger regions."""
    small = cv2.resize(mask, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST)
    square = np.ones((3, 3), np.uint8)
    small = cv2.morphologyEx(close_gaps(small, 3), cv2.MORPH_OPEN, square)
    labels, regions = label_regions(small, min_area=max(1, int(GHOST_REGION * small.size)))
    kept = np.isin(labels, [region.label for region in regions]).astype(np.uint8)
    return cv2.morphologyEx(kept, cv2.MORPH_GRADIENT, square) > 0
