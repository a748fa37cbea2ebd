"""A limb along a predicted axis in one view: its edges across the axis, and where it may end."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from jaxpoint.detection.person.crop import Crop
from jaxpoint.evidence.limb_slices import LimbEdges, Pixel

CORRIDOR_M = 0.09  # on either side of a predicted axis
HAND_M = 0.36  # beyond a place before the wrist, in which the tip is looked for
HAND_HALF_M = 0.11  # on either side of the axis: a wrist may be bent


def find_edges(
    crop: Crop,
    axis: Float[np.ndarray, "S 2"],
    across: Float[np.ndarray, "2"],
    pixels_a_metre: float,
) -> LimbEdges:
    """The edges of a limb across a predicted axis, to a fraction of a pixel.

    Args:
        crop: the person's pixels.
        axis: places along the predicted axis, px of the whole image.
        across: unit vector across it in the image.
        pixels_a_metre: how large the person appears there.
    """
    half = CORRIDOR_M * pixels_a_metre
    offsets = np.linspace(-half, half, 2 * int(np.ceil(half)) + 1)
    places = axis[:, None] + offsets[None, :, None] * across - np.array(crop.corner)
    low, high = _runs(_sample(crop.labels, places), offsets)
    return LimbEdges(axis, across, low, high, half, pixels_a_metre)


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


def _sample(labels: UInt8[np.ndarray, "h w"], places: Float[np.ndarray, "S n 2"]) -> Float[np.ndarray, "2 S n"]:
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


def _runs(
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
