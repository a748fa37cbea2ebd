"""Ends of a person's limbs in one view: where skin, or the outline, tapers into something long (SPEC 5 and 6).

The thesis keeps one region a view by fixed gates on shape. Here every long end is a candidate, with the middle line of
its last half metre; which of them is the pointing arm is decided over all views (`jaxpoint.person.arms`).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

SLICES = 24  # across a limb, from its tip inwards
SLICE_M = 0.025  # from one slice to the next
REACH_M = SLICES * SLICE_M  # how far a candidate reaches from its tip
_AXIS_M = (0.17, 0.40)  # from the tip: behind the hand, before the elbow
_MIN_AREA_M2 = 0.002
_LIMB_M = 0.15  # thicker than an arm, thinner than a trunk
CORRIDOR_M = 0.09  # on either side of a promised axis
LIMB_WIDTH_M = (0.035, 0.13)  # of a forearm, clothes included
TAPER = 0.2  # by which a width may miss that of an evenly widening forearm
HAND_M = 0.36  # beyond a place before the wrist, in which the tip is looked for
HAND_HALF_M = 0.11  # on either side of the axis: a wrist may be bent
_OPENING_PX = 9  # the trunk is found at the scale at which a limb is this wide


class Pixel(IntEnum):
    """What a pixel of a person's crop is."""

    NOTHING = 0
    PERSON = 1
    SKIN = 2


@dataclass(frozen=True)
class Crop:
    """A person's part of an image, each pixel a `Pixel`."""

    labels: UInt8[np.ndarray, "h w"]
    corner: tuple[int, int]  # px, x and y of the crop's first pixel in the image
    image_size: tuple[int, int]  # px, width and height of the whole image


@dataclass(frozen=True)
class Limb:
    """A long end in one view; S slices from the tip inwards. Pixels of the whole image."""

    tip: Float[np.ndarray, "2"]  # px
    direction: Float[np.ndarray, "2"]  # unit length, from the body to the tip
    middle: Float[np.ndarray, "S 2"]  # px, middle of each slice
    width: Float[np.ndarray, " S"]  # px, 0 where a slice holds nothing
    area: int  # px, within reach of the tip
    from_skin: bool  # else from the outline
    cut: bool  # it leaves the image at its tip

    @property
    def base(self) -> Float[np.ndarray, "2"]:
        """Middle of the slice farthest from the tip, px."""
        return self.middle[np.flatnonzero(self.width > 0)[-1]]


def find_limbs(
    crop: Crop, pixels_a_metre: float, head: Float[np.ndarray, "2"] | None, head_height_px: float
) -> list[Limb]:
    """All long ends of a person in one view, those of the skin first.

    Args:
        crop: the person's pixels.
        pixels_a_metre: how large the person appears, focal length over distance.
        head: centre of the head, px, which is not an arm; None where it was not found.
        head_height_px: height of the head.
    """
    skin = crop.labels == Pixel.SKIN
    person = crop.labels != Pixel.NOTHING
    face = _face(crop, head, head_height_px)
    limbs = _ends(skin & ~face, crop, pixels_a_metre, from_skin=True)
    return limbs + _ends(_thin(person, pixels_a_metre) & ~face, crop, pixels_a_metre, from_skin=False)


@dataclass(frozen=True)
class Strip:
    """A limb where other views promise it: the middle between its two edges at S places along it."""

    middle: Float[np.ndarray, "S 2"]  # px, of the whole image
    width: Float[np.ndarray, " S"]  # px between the edges, 0 where the corridor does not hold both
    skin: bool  # edges of skin; else of the outline


def cut_strip(
    crop: Crop,
    axis: Float[np.ndarray, "S 2"],
    across: Float[np.ndarray, "2"],
    pixels_a_metre: float,
) -> Strip:
    """The edges of a limb across a promised axis, to a fraction of a pixel.

    Skin and outline are both tried; the one with more slices of a forearm's width counts, the skin where they are
    equal. Where a run reaches the border of the corridor (a shirt of that colour behind), there is no edge.

    Args:
        crop: the person's pixels.
        axis: places along the promised axis, px of the whole image.
        across: unit vector across it in the image.
        pixels_a_metre: how large the person appears there.
    """
    half = CORRIDOR_M * pixels_a_metre
    offsets = np.linspace(-half, half, 2 * int(np.ceil(half)) + 1)
    places = axis[:, None] + offsets[None, :, None] * across - np.array(crop.corner)
    x, y = places[..., 0].astype(np.float32), places[..., 1].astype(np.float32)
    best: tuple[np.ndarray, np.ndarray] | None = None
    skin = True
    for value in (Pixel.SKIN, Pixel.PERSON):
        mask = (crop.labels >= value).astype(np.uint8) * 255
        strip = cv2.remap(mask, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        low, high = _edges(strip.astype(np.float32) / 255, offsets)
        whole = (low > -half + 1) & (high < half - 1)
        width = np.where(whole & _tapers(high - low, whole, pixels_a_metre), high - low, 0.0)
        if best is None or (width > 0).sum() > (best[1] > 0).sum():
            best, skin = ((low + high) / 2, width), value == Pixel.SKIN
    middle, width = best
    return Strip(axis + middle[:, None] * across, width, skin)


def _tapers(
    width: Float[np.ndarray, " S"], whole: Bool[np.ndarray, " S"], pixels_a_metre: float
) -> Bool[np.ndarray, " S"]:
    """Slices as wide as a forearm that widens evenly to the elbow: a hole, a hand or a shirt behind is none."""
    low, high = (limit * pixels_a_metre for limit in LIMB_WIDTH_M)
    usable = whole & (width >= low) & (width <= high)
    if usable.sum() < 3:
        return usable
    place = np.linspace(-1, 1, len(width))
    weight = usable.astype(float)
    expected = width
    for _ in range(5):
        rows = np.stack([np.ones_like(place), place], axis=1)
        normal = rows.T @ (weight[:, None] * rows) + np.diag([1e-9, 0.5])
        expected = rows @ np.linalg.solve(normal, rows.T @ (weight * width))
        weight = usable / (1 + ((width - expected) / (0.07 * np.maximum(expected, low))) ** 2)
    return usable & (np.abs(width - expected) <= TAPER * np.maximum(expected, low))


def find_tips(
    crop: Crop,
    start: Float[np.ndarray, "2"],
    ahead: Float[np.ndarray, "2"],
    pixels_a_metre: float,
) -> list[Float[np.ndarray, "2"]]:
    """Where the limb may end beyond a place on its axis: by the skin, and by the outline (a capped finger is no skin).

    Args:
        crop: the person's pixels.
        start: a place on the axis before the wrist, px.
        ahead: unit vector along the axis towards the tip.
        pixels_a_metre: how large the person appears there.
    """
    length, half = HAND_M * pixels_a_metre, HAND_HALF_M * pixels_a_metre
    corner = np.array(crop.corner)
    ends = start + np.array([[0.0, -half], [0.0, half], [length, -half], [length, half]]) @ np.array(
        [ahead, [-ahead[1], ahead[0]]]
    )
    low = np.maximum(np.floor(ends.min(axis=0)).astype(int) - corner, 0)
    high = np.minimum(np.ceil(ends.max(axis=0)).astype(int) + 1 - corner, crop.labels.shape[::-1])
    if (high - low < 3).any():
        return []
    part = crop.labels[low[1] : high[1], low[0] : high[0]]
    rows, columns = np.mgrid[low[1] : high[1], low[0] : high[0]]
    offset = np.stack([columns, rows], axis=-1) + corner - start
    along, across = offset @ ahead, offset @ np.array([-ahead[1], ahead[0]])
    room = (along > -1) & (along < length) & (np.abs(across) < half)
    tips = []
    for value in (Pixel.SKIN, Pixel.PERSON):
        _, labels = cv2.connectedComponents(((part >= value) & room).astype(np.uint8), connectivity=8)
        near = (along < 0.03 * pixels_a_metre + 2) & (np.abs(across) < 0.03 * pixels_a_metre + 1) & (labels > 0)
        if not near.any():
            continue
        own = labels == np.bincount(labels[near]).argmax()
        tip = _end_of(offset[own])
        if tip is not None and tip @ ahead < length - 1.5:
            tips.append(start + tip)
    return tips


def _end_of(offsets: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "2"] | None:
    """The far end of a hand: along the direction of its farthest pixel, half a pixel beyond the last ones."""
    distance = np.hypot(offsets[:, 0], offsets[:, 1])
    far = int(distance.argmax())
    if distance[far] < 2:
        return None
    direction = offsets[far] / distance[far]
    reach = offsets @ direction
    return offsets[reach > reach.max() - 1.5].mean(axis=0) + 0.5 * direction


def _edges(
    strip: Float[np.ndarray, "S n"], offsets: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " S"], Float[np.ndarray, " S"]]:
    """Both ends of the run above one half that is nearest to the middle of each row; equal where there is none."""
    rows, count = strip.shape
    place = np.arange(count)
    inside = strip >= 0.5
    nearest = np.where(inside, np.abs(place - (count - 1) / 2), count).argmin(axis=1)
    row = np.arange(rows)
    first = np.maximum.accumulate(np.where(inside, -1, place), axis=1)[row, nearest] + 1
    last = np.minimum.accumulate(np.where(inside, count, place)[:, ::-1], axis=1)[:, ::-1][row, nearest] - 1
    some = inside.any(axis=1)
    first, last = np.where(some, first, 0), np.where(some, last, 0)
    spacing = offsets[1] - offsets[0]
    low = offsets[first] - spacing * _beyond(strip[row, first], strip[row, np.maximum(first - 1, 0)])
    high = offsets[last] + spacing * _beyond(strip[row, last], strip[row, np.minimum(last + 1, count - 1)])
    return np.where(some, low, 0.0), np.where(some, high, 0.0)


def _beyond(inner: Float[np.ndarray, " S"], outer: Float[np.ndarray, " S"]) -> Float[np.ndarray, " S"]:
    """Share of a pixel by which an edge lies beyond the last place above one half."""
    return np.where(inner > outer, (inner - 0.5) / np.maximum(inner - outer, 1e-6), 0.0)


def _face(crop: Crop, head: Float[np.ndarray, "2"] | None, height: float) -> Bool[np.ndarray, "h w"]:
    mask = np.zeros(crop.labels.shape, np.uint8)
    if head is not None and height > 0:
        x, y = head - np.array(crop.corner)
        centre = (round(float(x)), round(float(y + 0.08 * height)))
        cv2.ellipse(mask, centre, (round(0.46 * height), round(0.64 * height)), 0, 0, 360, 1, -1)
    return mask.astype(bool)


def _thin(person: Bool[np.ndarray, "h w"], pixels_a_metre: float) -> Bool[np.ndarray, "h w"]:
    """What sticks out of the trunk: the silhouette less its opening by a disc wider than an arm."""
    factor = min(1.0, _OPENING_PX / (_LIMB_M * pixels_a_metre))
    height, width = person.shape
    small = cv2.resize(
        person.astype(np.uint8) * 255,
        (max(1, round(width * factor)), max(1, round(height * factor))),
        interpolation=cv2.INTER_AREA,
    )
    padded = cv2.copyMakeBorder(
        (small > 127).astype(np.uint8),
        _OPENING_PX,
        _OPENING_PX,
        _OPENING_PX,
        _OPENING_PX,
        cv2.BORDER_CONSTANT,
        value=(0,),
    )
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_OPENING_PX, _OPENING_PX))
    trunk = cv2.dilate(cv2.morphologyEx(padded, cv2.MORPH_OPEN, disc), np.ones((3, 3), np.uint8))
    trunk = trunk[_OPENING_PX:-_OPENING_PX, _OPENING_PX:-_OPENING_PX]
    return person & (cv2.resize(trunk, (width, height), interpolation=cv2.INTER_LINEAR) == 0)


def _ends(mask: Bool[np.ndarray, "h w"], crop: Crop, pixels_a_metre: float, *, from_skin: bool) -> list[Limb]:
    """Both ends of every component that is large enough."""
    cleaned = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
    _, labels, stats, _ = cv2.connectedComponentsWithStats(cleaned, connectivity=8)
    limbs = []
    for index in range(1, len(stats)):
        x, y, width, height, area = stats[index]
        if area < _MIN_AREA_M2 * pixels_a_metre**2 or max(width, height) < 0.06 * pixels_a_metre:
            continue
        ys, xs = np.nonzero(labels[y : y + height, x : x + width] == index)
        points = np.stack([xs + x, ys + y], axis=1) + np.array(crop.corner)
        for tip in _extremes(points):
            limb = _limb_from(points, tip, pixels_a_metre, crop, from_skin)
            if limb is not None:
                limbs.append(limb)
    return limbs


def _extremes(points: Int[np.ndarray, "n 2"]) -> list[Float[np.ndarray, "2"]]:
    """The two ends of a component: the pixel farthest from its middle, and the one farthest from that."""
    first = points[np.argmax(((points - points.mean(axis=0)) ** 2).sum(axis=1))]
    second = points[np.argmax(((points - first) ** 2).sum(axis=1))]
    return [first.astype(float), second.astype(float)]


def _limb_from(
    points: Int[np.ndarray, "n 2"], tip: Float[np.ndarray, "2"], pixels_a_metre: float, crop: Crop, from_skin: bool
) -> Limb | None:
    """The limb that ends at a pixel: its axis from the slices behind the hand, twice."""
    near = points[((points - tip) ** 2).sum(axis=1) < (REACH_M * pixels_a_metre) ** 2]
    within = near[((near - tip) ** 2).sum(axis=1) < (_AXIS_M[1] * pixels_a_metre) ** 2]
    inward = within.mean(axis=0) - tip
    length = float(np.hypot(*inward))
    if length < 3:
        return None
    direction = -inward / length
    limb = None
    for _ in range(3):
        limb = _limb_along(near, tip, direction, SLICE_M * pixels_a_metre, crop, from_skin)
        fitted = _axis_of(limb)
        if fitted is None:
            break
        direction = fitted
    return limb


def _axis_of(limb: Limb) -> Float[np.ndarray, "2"] | None:
    """Direction towards the tip of the line through the slices behind the hand; of all where these are too few."""
    slices = np.arange(SLICES)
    held = limb.width > 0
    forearm = held & (slices >= _AXIS_M[0] / SLICE_M) & (slices < _AXIS_M[1] / SLICE_M)
    if forearm.sum() < 4:
        forearm = held
    if forearm.sum() < 3:
        return None
    middle = limb.middle[forearm]
    weight = np.ones(len(middle))
    axis = limb.direction
    for _ in range(3):
        centre = weight @ middle / weight.sum()
        _, _, rows = np.linalg.svd(np.sqrt(weight)[:, None] * (middle - centre), full_matrices=False)
        axis = rows[0]
        off = np.abs((middle - centre) @ np.array([-axis[1], axis[0]]))
        weight = 1 / (1 + (off / max(1.0, 1.5 * float(np.median(off)))) ** 2)
    return axis if axis @ limb.direction > 0 else -axis


def _limb_along(
    points: Int[np.ndarray, "n 2"],
    tip: Float[np.ndarray, "2"],
    direction: Float[np.ndarray, "2"],
    step: float,
    crop: Crop,
    from_skin: bool,
) -> Limb:
    """Slices across an axis, and the tip as the end of what lies along it."""
    normal = np.array([-direction[1], direction[0]])
    along = (tip - points) @ direction
    across = (points - tip) @ normal
    first = along.min()
    index = np.floor((along - first) / step).astype(int)
    kept = index < SLICES
    count = np.bincount(index[kept], minlength=SLICES)
    total_across = np.bincount(index[kept], across[kept], minlength=SLICES)
    total_along = np.bincount(index[kept], along[kept], minlength=SLICES)
    safe = np.maximum(count, 1)
    middle = tip - (total_along / safe)[:, None] * direction + (total_across / safe)[:, None] * normal
    end = points[along < first + max(1.5, 0.006 / SLICE_M * step)].mean(axis=0)
    end = end + 0.5 * direction
    width, height = crop.image_size
    cut = bool((end < 3).any() or end[0] > width - 4 or end[1] > height - 4)
    return Limb(end, direction, middle, count / step, int(kept.sum()), from_skin, cut)
