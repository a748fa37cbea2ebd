"""Ends of a person's limbs in one view: where skin, or the outline, tapers into something long (thesis 6.2, 6.3).

The thesis keeps one region a view by fixed gates on shape. Here every long end is a candidate, with the middle line of
its last half metre; which of them is the pointing arm is decided over all views (`jaxpoint.body.limb_arms`).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxpoint.detection.person.crop import Crop
from jaxpoint.evidence.limb_slices import REACH_M, SLICE_M, SLICES, LimbEnd, Pixel

_AXIS_M = (0.17, 0.40)  # from the tip: behind the hand, before the elbow
_MIN_AREA_M2 = 0.002
_MIN_LENGTH_M = 0.06
_MOST_PARTS = 5  # of skin, and of the outline: two arms, two legs and one more
_MOST_POINTS = 800  # px of a limb that are looked at
_ROUNDS = 2  # of cutting slices and fitting an axis to them
_LIMB_M = 0.15  # thicker than an arm, thinner than a trunk
_OPENING_PX = 9  # the trunk is found at the scale at which a limb is this wide


def find_limb_ends(
    crop: Crop, pixels_a_metre: float, head: Float[np.ndarray, "2"] | None, head_height_px: float
) -> list[LimbEnd]:
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


def _limbs(ends: list[_End], crop: Crop, pixels_a_metre: float) -> list[LimbEnd]:
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
        width_px = strides[i] * count[i] / step
        limbs.append(LimbEnd(place, used[i], end.tip + middle[i], width_px, area, end.from_skin, cut))
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
