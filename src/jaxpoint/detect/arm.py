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
_MIN_LENGTH_M = 0.06
_MOST_PARTS = 5  # of skin, and of the outline: two arms, two legs and one more
_MOST_POINTS = 800  # px of a limb that are looked at
_ROUNDS = 2  # of cutting slices and fitting an axis to them
_SLOPE_PRIOR = 0.5  # slices, by which an even width is expected
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

    def at(self, pixels: Float[np.ndarray, "n 2"]) -> UInt8[np.ndarray, " n"]:
        """The `Pixel`s nearest to places of the whole image; NOTHING outside the crop."""
        inside = np.round(pixels - np.array(self.corner))
        height, width = self.labels.shape
        held = np.all((inside >= 0) & (inside < (width, height)), axis=1)
        x, y = np.where(held[:, None], inside, 0).astype(int).T
        return np.where(held, self.labels[y, x], np.uint8(Pixel.NOTHING))


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
    ends = _ends(skin & ~face, crop, pixels_a_metre, from_skin=True)
    ends += _ends(_thin(person, pixels_a_metre) & ~face, crop, pixels_a_metre, from_skin=False)
    return _limbs(ends, crop, pixels_a_metre)


@dataclass(frozen=True)
class Strip:
    """A limb where other views promise it: the middle between its two edges at S places along it."""

    middle: Float[np.ndarray, "S 2"]  # px, of the whole image
    width: Float[np.ndarray, " S"]  # px between the edges, 0 where the corridor does not hold both
    skin: bool  # edges of skin; else of the outline


@dataclass(frozen=True)
class Edges:
    """Both ends of the run across a promised axis at S places along it: first of the skin, then of the outline."""

    axis: Float[np.ndarray, "S 2"]  # px, of the whole image
    across: Float[np.ndarray, "2"]  # unit
    low: Float[np.ndarray, "2 S"]  # px from the axis; both 0 where nothing lies across it
    high: Float[np.ndarray, "2 S"]
    half: float  # px, half the corridor's width
    pixels_a_metre: float

    def at(self, offsets: Float[np.ndarray, " S"]) -> Float[np.ndarray, "S 2"]:
        """Pixels of the whole image at distances from the axis."""
        return self.axis + offsets[:, None] * self.across


def find_edges(
    crop: Crop,
    axis: Float[np.ndarray, "S 2"],
    across: Float[np.ndarray, "2"],
    pixels_a_metre: float,
) -> Edges:
    """The edges of a limb across a promised axis, to a fraction of a pixel.

    Args:
        crop: the person's pixels.
        axis: places along the promised axis, px of the whole image.
        across: unit vector across it in the image.
        pixels_a_metre: how large the person appears there.
    """
    half = CORRIDOR_M * pixels_a_metre
    offsets = np.linspace(-half, half, 2 * int(np.ceil(half)) + 1)
    places = axis[:, None] + offsets[None, :, None] * across - np.array(crop.corner)
    low, high = _edges(_sampled(crop.labels, places), offsets)
    return Edges(axis, across, low, high, half, pixels_a_metre)


def cut_strip(edges: Edges) -> Strip:
    """The limb between both its edges: of skin or of the outline, whichever has more slices of a forearm's width.

    Where a run reaches the border of the corridor (a shirt of that colour behind), there is no edge.
    """
    low, high = edges.low, edges.high
    whole = (low > 1 - edges.half) & (high < edges.half - 1)
    width = np.where(_tapers(high - low, whole, edges.pixels_a_metre), high - low, 0.0)
    kind = int((width > 0).sum(axis=1).argmax())
    return Strip(edges.at((low + high)[kind] / 2), width[kind], kind == 0)


def beside_one_edge(
    edges: Edges, width: Float[np.ndarray, " S"], axis: Float[np.ndarray, " S"], within: float
) -> Strip | None:
    """The limb beside the one edge that it has, where something of its colour lies on its other side.

    Args:
        edges: across the axis.
        width: of the limb, as other views have it, px.
        axis: where all views see the axis, px from the promised one.
        within: distance from the axis up to which a slice is the limb's, px.

    Returns:
        The run and the side with the most slices near the axis; None where there are none.
    """
    some = edges.high > edges.low
    best = None
    for kind in range(2):
        for side, offset in ((edges.low, width / 2), (edges.high, -width / 2)):
            clean = some[kind] & (np.abs(side[kind]) < edges.half - 1)
            middle = side[kind] + offset
            held = clean & (np.abs(middle - axis) <= within)
            if held.any() and (best is None or held.sum() > (best.width > 0).sum()):
                best = Strip(edges.at(middle), np.where(held, width, 0.0), kind == 0)
    return best


def _sampled(labels: UInt8[np.ndarray, "h w"], places: Float[np.ndarray, "S n 2"]) -> Float[np.ndarray, "2 S n"]:
    """How much of skin, and of the person, lies at places between pixels, 0 to 1; nothing outside."""
    low = np.maximum(np.floor(places.min(axis=(0, 1))).astype(int) - 1, 0)
    high = np.ceil(places.max(axis=(0, 1))).astype(int) + 2
    part = labels[low[1] : max(high[1], 0), low[0] : max(high[0], 0)]
    if not part.size:
        return np.zeros((2, *places.shape[:2]))
    x, y = cv2.split((places - low).astype(np.float32))
    masks = (cv2.threshold(part, kind - 1, 255, cv2.THRESH_BINARY)[1] for kind in (Pixel.SKIN, Pixel.PERSON))
    # Outside the image is nothing: OpenCV's default border is a constant 0.
    return np.stack([cv2.remap(mask, x, y, cv2.INTER_LINEAR) for mask in masks]) / 255.0


def _tapers(
    width: Float[np.ndarray, "K S"], whole: Bool[np.ndarray, "K S"], pixels_a_metre: float
) -> Bool[np.ndarray, "K S"]:
    """Slices as wide as a forearm that widens evenly to the elbow: a hole, a hand or a shirt behind is none."""
    low, high = (limit * pixels_a_metre for limit in LIMB_WIDTH_M)
    usable = whole & (width >= low) & (width <= high)
    place = np.linspace(-1, 1, width.shape[1])
    powers = np.stack([np.ones_like(place), place, place**2], axis=1)
    weight = usable.astype(float)
    expected = width
    for _ in range(5):
        n, x, xx = (weight @ powers + [1e-9, 0.0, _SLOPE_PRIOR]).T
        y, xy = ((weight * width) @ powers[:, :2]).T
        level, slope = (xx * y - x * xy), (n * xy - x * y)
        expected = (level[:, None] + slope[:, None] * place) / (n * xx - x * x)[:, None]
        weight = usable / (1 + ((width - expected) / (0.07 * np.maximum(expected, low))) ** 2)
    tapers = usable & (np.abs(width - expected) <= TAPER * np.maximum(expected, low))
    return np.where(usable.sum(axis=1, keepdims=True) < 3, usable, tapers)


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
    x = (np.arange(low[0], high[0]) + corner[0] - start[0])[None]
    y = (np.arange(low[1], high[1]) + corner[1] - start[1])[:, None]
    along, across = ahead[0] * x + ahead[1] * y, ahead[0] * y - ahead[1] * x
    room = (along > -1) & (along < length) & (np.abs(across) < half)
    tips = []
    for value in (Pixel.SKIN, Pixel.PERSON):
        _, labels = cv2.connectedComponents(((part >= value) & room).astype(np.uint8), connectivity=8)
        near = (along < 0.03 * pixels_a_metre + 2) & (np.abs(across) < 0.03 * pixels_a_metre + 1) & (labels > 0)
        if not near.any():
            continue
        rows, columns = np.nonzero(labels == np.bincount(labels[near]).argmax())
        tip = _end_of(np.stack([x[0, columns], y[rows, 0]], axis=1))
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
    strips: Float[np.ndarray, "K S n"], offsets: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "K S"], Float[np.ndarray, "K S"]]:
    """Both ends of the run above one half that is nearest to the middle of each row; equal where there is none."""
    count = len(offsets)
    strip = strips.reshape(-1, count)
    place = np.arange(count)
    inside = strip >= 0.5
    nearest = np.where(inside, np.abs(place - (count - 1) / 2), count).argmin(axis=1)
    row = np.arange(len(strip))
    first = np.where(inside | (place > nearest[:, None]), -1, place).max(axis=1) + 1
    last = np.where(inside | (place < nearest[:, None]), count, place).min(axis=1) - 1
    some = inside.any(axis=1)
    first, last = np.where(some, first, 0), np.where(some, last, 0)
    spacing = offsets[1] - offsets[0]
    low = offsets[first] - spacing * _beyond(strip[row, first], strip[row, np.maximum(first - 1, 0)])
    high = offsets[last] + spacing * _beyond(strip[row, last], strip[row, np.minimum(last + 1, count - 1)])
    shape = strips.shape[:2]
    return np.where(some, low, 0.0).reshape(shape), np.where(some, high, 0.0).reshape(shape)


def _beyond(inner: Float[np.ndarray, " R"], outer: Float[np.ndarray, " R"]) -> Float[np.ndarray, " R"]:
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


@dataclass(frozen=True)
class _End:
    """An end of a component of the mask."""

    tip: Float[np.ndarray, "2"]  # px, a pixel of it
    points: Int[np.ndarray, "n 2"]  # px, its pixels within reach of the tip
    from_skin: bool


def _ends(mask: Bool[np.ndarray, "h w"], crop: Crop, pixels_a_metre: float, *, from_skin: bool) -> list[_End]:
    """Both ends of every component that is large enough, the largest first."""
    bits = mask.view(np.uint8)
    left, top, width, height = cv2.boundingRect(bits)
    cleaned = (
        cv2.morphologyEx(bits[top : top + height, left : left + width], cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
        if width
        else bits[:0, :0]
    )
    if not cleaned.any():
        return []
    _, labels, stats, _ = cv2.connectedComponentsWithStats(cleaned, connectivity=8)
    large = (stats[:, 4] >= _MIN_AREA_M2 * pixels_a_metre**2) & (
        stats[:, 2:4].max(axis=1) >= _MIN_LENGTH_M * pixels_a_metre
    )
    order = [i for i in np.argsort(-stats[:, 4], kind="stable") if i > 0 and large[i]]
    ends = []
    for index in order[:_MOST_PARTS]:
        x, y, width, height, _ = stats[index]
        ys, xs = np.nonzero(labels[y : y + height, x : x + width] == index)
        points = np.stack([xs + (x + left + crop.corner[0]), ys + (y + top + crop.corner[1])], axis=1)
        for tip in _extremes(points):
            near = points[((points - tip) ** 2).sum(axis=1) < (REACH_M * pixels_a_metre) ** 2]
            ends.append(_End(tip.astype(float), near, from_skin))
    return ends


def _extremes(points: Int[np.ndarray, "n 2"]) -> tuple[Int[np.ndarray, "2"], Int[np.ndarray, "2"]]:
    """The two ends of a component: the pixel farthest from its middle, and the one farthest from that."""
    first = points[np.argmax(((points - points.mean(axis=0)) ** 2).sum(axis=1))]
    return first, points[np.argmax(((points - first) ** 2).sum(axis=1))]


def _limbs(ends: list[_End], crop: Crop, pixels_a_metre: float) -> list[Limb]:
    """The limbs that have these ends; all at once, as every step costs far more than the numbers in it."""
    if not ends:
        return []
    strides = [1 + len(end.points) // _MOST_POINTS for end in ends]
    owner = np.repeat(np.arange(len(ends)), [len(end.points[::k]) for end, k in zip(ends, strides)])
    tips = np.stack([end.tip for end in ends])
    offsets = np.concatenate([end.points[::k] for end, k in zip(ends, strides)]) - tips[owner]
    direction = _towards_tip(offsets, owner, len(ends), _AXIS_M[1] * pixels_a_metre)
    step = SLICE_M * pixels_a_metre
    for _ in range(_ROUNDS):
        along, middle, count = _slices(offsets, owner, direction, step)
        used, direction = direction, _axes(middle, count > 0, direction)
    limbs = []
    for i, end in enumerate(ends):
        last = offsets[owner == i][along[owner == i] < max(1.5, 0.006 * pixels_a_metre)]
        place = end.tip + last.mean(axis=0) + 0.5 * used[i]
        width, height = crop.image_size
        cut = bool((place < 3).any() or place[0] > width - 4 or place[1] > height - 4)
        area = strides[i] * int(count[i].sum())
        limbs.append(Limb(place, used[i], end.tip + middle[i], strides[i] * count[i] / step, area, end.from_skin, cut))
    return limbs


def _towards_tip(offsets, owner, count: int, reach: float) -> Float[np.ndarray, "L 2"]:
    """Unit vectors from the mean of the pixels within reach to the tip."""
    within = (offsets**2).sum(axis=1) < reach**2
    inward = np.stack([np.bincount(owner[within], offsets[within, i], minlength=count) for i in range(2)], axis=1)
    return -inward / np.maximum(np.linalg.norm(inward, axis=1, keepdims=True), 1e-9)


def _slices(offsets, owner, direction: Float[np.ndarray, "L 2"], step: float):
    """Middle (L, S, 2) and number (L, S) of each slice's pixels across an axis, and where each pixel lies along it."""
    limbs = len(direction)
    along = -(offsets * direction[owner]).sum(axis=1)
    first = np.full(limbs, np.inf)
    np.minimum.at(first, owner, along)
    along = along - first[owner]
    index = np.minimum((along / step).astype(int), SLICES) + owner * (SLICES + 1)
    size = limbs * (SLICES + 1)
    count = np.bincount(index, minlength=size)
    total = [np.bincount(index, offsets[:, i], minlength=size) for i in range(2)]
    middle = np.stack(total, axis=1) / np.maximum(count, 1)[:, None]
    return along, middle.reshape(limbs, SLICES + 1, 2)[:, :SLICES], count.reshape(limbs, SLICES + 1)[:, :SLICES]


def _axes(
    middle: Float[np.ndarray, "L S 2"], held: Bool[np.ndarray, "L S"], direction: Float[np.ndarray, "L 2"]
) -> Float[np.ndarray, "L 2"]:
    """Directions towards the tips of the lines through the slices behind the hand; of all where these are too few."""
    behind = (np.arange(SLICES) * SLICE_M >= _AXIS_M[0]) & (np.arange(SLICES) * SLICE_M < _AXIS_M[1])
    forearm = held & behind
    use = np.where(forearm.sum(axis=1, keepdims=True) < 4, held, forearm).astype(float)
    weight, axis = use, direction
    for _ in range(3):
        total = np.maximum(weight.sum(axis=1), 1e-9)
        off = middle - np.einsum("ls,lsi->li", weight, middle)[:, None] / total[:, None, None]
        xx, xy, yy = (np.einsum("ls,ls,ls->l", weight, off[..., i], off[..., j]) for i, j in ((0, 0), (0, 1), (1, 1)))
        angle = 0.5 * np.arctan2(2 * xy, xx - yy)
        axis = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        miss = np.abs(off[..., 1] * axis[:, :1] - off[..., 0] * axis[:, 1:])
        scale = np.maximum(1.0, 1.5 * (use * miss).sum(axis=1) / np.maximum(use.sum(axis=1), 1))
        weight = use / (1 + (miss / scale[:, None]) ** 2)
    axis = axis * np.where((axis * direction).sum(axis=1) > 0, 1.0, -1.0)[:, None]
    return np.where(use.sum(axis=1, keepdims=True) < 3, direction, axis)
