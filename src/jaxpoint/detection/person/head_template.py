"""The head of an upright person in a silhouette (thesis 6.2.3)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from jaxpoint.config.person import HeadSettings
from jaxpoint.detection.person.silhouette import Silhouette
from jaxpoint.evidence.camera_evidence import HeadReason

MARGIN = 3  # px of background around the ellipse of a template; a flat template has no variance
CUT = 0.85  # of its width: where the image's top crosses a head so widely, a quarter is outside and its place unsure
OUTSIDE = 0.4  # of its width: of a head that reaches farther over a side of the image the middle is hardly seen
BODY_ABOVE = 0.15  # of its width: where so much of the person lies above it and outside, it is no head
OF_AREA = 0.35  # height of a head over the root of a silhouette's area: 0.30 to 0.42 from all sides, arms up or down
AREA_RANGE = (0.6, 2.0)  # of that height; more where furniture hides much of a person
AREA_SIGMA = (0.25, 0.45)  # of its logarithm, below and above
CUT_RANGE, CUT_SIGMA = (0.6, 3.7), (0.25, 1.0)  # the same where the image ends within the person
AREA_WEIGHT = 0.1  # of a correlation, at one sigma
RING = (1.08, 1.6)  # of the ellipse's radius: between them is what must not belong to the person
RING_OPENS = np.radians(100)  # rad from straight up
FINE = 8  # points a pixel from which templates are drawn

ANGLES = np.radians(np.linspace(-105, 105, 43))  # rad from straight up: the outline above the chin
RADII = np.linspace(0.4, 1.6, 49)  # of the expected outline, where it is looked for
OUTLINE_ROUNDS = 6
BORDER = 2.5  # px from the image's border: an outline there is where the image ends
MIN_OUTLINE = 0.5  # part of the rays that must meet the outline
OUTLINE_SIGMA = 0.04  # of the radius: hair, ears and the mask's own errors
ASPECT_SIGMA = 0.12  # of heads from all sides, in the logarithm
HEIGHT_SIGMA = 0.12  # in the logarithm, of what the correlation gives
MAX_STEP = 0.2  # of the radius, in a round


@dataclass(frozen=True)
class Head:
    """The middle of a head's outline; `score`, `x`, `y` and `height_px` are of the best place, found or not."""

    x: float  # px
    y: float  # px
    score: float  # correlation, -1..1
    height_px: float
    reason: HeadReason

    @property
    def found(self) -> bool:
        """Whether it is one."""
        return self.reason == HeadReason.FOUND


def find_head(silhouette: Silhouette, focal_px: float, settings: HeadSettings) -> Head:
    """The ellipse that correlates best with the upper part of a silhouette, refined on its outline.

    Args:
        silhouette: of one person; only its mask is read.
        focal_px: focal length of the camera, px; it gives the sizes that a head can have.
        settings: `thesis` stops after the correlation.
    """
    height = silhouette.box[3]
    heights = head_heights(focal_px, settings)
    if height < heights[0]:
        return _missing(silhouette, HeadReason.TOO_SMALL)
    if settings.method == "thesis":
        peaks = [_correlate(silhouette.mask, float(size), settings) for size in heights[heights <= height]]
        x, y, score, size = max(peaks, key=lambda peak: peak[2])
    else:
        heights, costs = _likely(heights[heights <= height], silhouette)
        if not len(heights):
            return _missing(silhouette, HeadReason.NO_SIZE_FITS)
        if silhouette.is_cut:
            settings = replace(settings, upper_part=1.0)
        peaks = [_correlate(silhouette.mask, float(size), settings) for size in heights]
        x, y, score, size = peaks[int(np.argmax([peak[2] for peak in peaks] - costs))]
        if score >= settings.min_score:
            x, y, size = _fit_outline(silhouette, x, y, size, settings.aspect)
    head = Head(x + silhouette.box[0], y + silhouette.box[1], score, size, HeadReason.FOUND)
    return replace(head, reason=_classify(head, silhouette, settings))


def _likely(
    heights: Float[np.ndarray, " N"], silhouette: Silhouette
) -> tuple[Float[np.ndarray, " M"], Float[np.ndarray, " M"]]:
    """Heights of a head that suit the person's area, and what each loses of its correlation."""
    (low, high), sigmas = (CUT_RANGE, CUT_SIGMA) if silhouette.is_cut else (AREA_RANGE, AREA_SIGMA)
    ratio = heights / (OF_AREA * np.sqrt(silhouette.region.area))
    suits = (ratio >= low) & (ratio <= high)
    sigma = np.where(ratio > 1, sigmas[1], sigmas[0])
    return heights[suits], (AREA_WEIGHT * (np.log(ratio) / sigma) ** 2)[suits]


def _missing(silhouette: Silhouette, reason: HeadReason) -> Head:
    x, y = silhouette.region.centroid
    return Head(float(x), float(y), 0.0, 0.0, reason)


def _classify(head: Head, silhouette: Silhouette, settings: HeadSettings) -> HeadReason:
    if head.score < settings.min_score:
        return HeadReason.UNLIKE
    half = settings.aspect * head.height_px / 2
    beside = max(half - head.x, head.x + half - silhouette.image_size[0])
    if beside > OUTSIDE * 2 * half:
        return HeadReason.OUT_OF_VIEW
    if silhouette.box[1] > 0:
        return HeadReason.FOUND
    left = round(head.x - half) - silhouette.box[0]
    above = np.count_nonzero(silhouette.mask[0, max(left, 0) : max(left + round(2 * half), 0)])
    crown = head.y - head.height_px / 2
    is_cut = above > (CUT if crown <= 1 else BODY_ABOVE) * 2 * half
    return HeadReason.OUT_OF_VIEW if is_cut else HeadReason.FOUND


def head_heights(focal_px: float, settings: HeadSettings) -> Float[np.ndarray, " N"]:
    """Heights of a head in the image, px, the smallest first: focal length times height over distance."""
    size = focal_px * settings.height_m
    return np.geomspace(size / settings.farthest_m, size / settings.nearest_m, settings.heights)


@lru_cache(maxsize=16)
def head_template(height: float, aspect: float) -> UInt8[np.ndarray, "h w"]:
    """A filled ellipse of 255 with a margin of 0; pixels on its outline hold the part that is inside."""
    return _shrunk(_radius(height, aspect, MARGIN)[0] <= 1)


@lru_cache(maxsize=16)
def ring_template(height: float, aspect: float) -> Float32[np.ndarray, "h w"]:
    """An ellipse of mean 1 less a ring of mean 1 around it, open below, where the neck and the shoulders are."""
    radius, from_top = _radius(height, aspect, math.ceil((RING[1] - 1) * height / 2))
    inside = _shrunk(radius <= 1).astype(np.float32)
    ring = _shrunk((radius >= RING[0]) & (radius <= RING[1]) & (from_top <= RING_OPENS)).astype(np.float32)
    return inside / inside.sum() - ring / ring.sum()


def _radius(height: float, aspect: float, margin: int) -> tuple[Float[np.ndarray, "H W"], Float[np.ndarray, "H W"]]:
    """Radius in half axes and angle from straight up (rad) on a grid `FINE` times finer than pixels."""
    half = np.array([height / 2, aspect * height / 2])
    size = np.ceil(half).astype(int) + margin
    rows, columns = (((np.arange((2 * n + 1) * FINE) + 0.5) / FINE - n - 0.5) / h for n, h in zip(size, half))
    return np.hypot(rows[:, None], columns[None]), np.abs(np.arctan2(columns[None], -rows[:, None]))


def _shrunk(fine: Bool[np.ndarray, "H W"]) -> UInt8[np.ndarray, "h w"]:
    bits = fine.view(np.uint8) * np.uint8(255)
    return cv2.resize(bits, (fine.shape[1] // FINE, fine.shape[0] // FINE), interpolation=cv2.INTER_AREA)


def _correlate(
    mask: Bool[np.ndarray, "h w"], height: float, settings: HeadSettings
) -> tuple[float, float, float, float]:
    """Best place (x, y) in the upper part of a mask for a head of this height, its correlation, and the height.

    Mask and template are resampled, as the cost of a correlation grows with the fourth power of the scale.
    """
    scale = min(1.0, settings.template_px / height)
    thesis = settings.method == "thesis"
    template = (head_template if thesis else ring_template)(round(scale * height, 3), settings.aspect)
    rows, columns = template.shape[0] // 2, template.shape[1] // 2
    upper = max(round(settings.upper_part * mask.shape[0]), 1)
    part = mask[: upper + round(rows / scale)].view(np.uint8) * np.uint8(255)
    size = (max(round(scale * part.shape[1]), 1), max(round(scale * part.shape[0]), 1))
    factors = size[0] / part.shape[1], size[1] / part.shape[0]
    part = cv2.resize(part, size, interpolation=cv2.INTER_AREA)
    padded = cv2.copyMakeBorder(part, rows, rows, columns, columns, cv2.BORDER_CONSTANT, value=(0,))
    if thesis:
        scores = cv2.matchTemplate(padded, template, cv2.TM_CCOEFF_NORMED)
    else:
        scores = cv2.matchTemplate(padded.astype(np.float32), template, cv2.TM_CCORR) / 255
    scores = scores[: max(round(factors[1] * upper), 1)]
    _, score, _, (x, y) = cv2.minMaxLoc(scores)
    dx, dy = _vertex(scores[y], x), _vertex(scores[:, x], y)
    return (x + dx + 0.5) / factors[0] - 0.5, (y + dy + 0.5) / factors[1] - 0.5, score, height


def _vertex(values: Float32[np.ndarray, " N"], peak: int) -> float:
    """Place of the parabola's vertex through a peak and its neighbours, from the peak."""
    if not 0 < peak < len(values) - 1:
        return 0.0
    left, middle, right = (float(value) for value in values[peak - 1 : peak + 2])
    bend = left - 2 * middle + right
    return 0.5 * (left - right) / bend if bend < 0 else 0.0


def _fit_outline(
    silhouette: Silhouette, x: float, y: float, height: float, aspect: float
) -> tuple[float, float, float]:
    """Centre and height of an upright ellipse on the outline from ear over crown to ear; robust least squares.

    The chin is left out: neck, collar and shoulders hide it from most sides. So is the image's border.
    """
    half = np.array([aspect * height / 2, height / 2])
    place = np.array([x, y])
    corner, size = np.array(silhouette.box[:2]), np.array(silhouette.image_size)
    first, last = BORDER - corner, size - 1 - BORDER - corner
    bits = silhouette.mask[: math.ceil(y + 2 * height) + 1].astype(np.float32)  # what lies farther below is not reached
    for _ in range(OUTLINE_ROUNDS):
        points, found = _outline(bits, place, half)
        found &= ((points > first) & (points < last)).all(axis=1)
        if np.count_nonzero(found) < MIN_OUTLINE * len(ANGLES):
            break
        step = _ellipse_step((points[found] - place) / half, half, height, aspect)
        place, half = place + half * step[:2], half * np.exp(step[2:])
    return float(place[0]), float(place[1]), float(2 * half[1])


def _outline(
    mask: Float32[np.ndarray, "h w"], place: Float[np.ndarray, "2"], half: Float[np.ndarray, "2"]
) -> tuple[Float[np.ndarray, "A 2"], Bool[np.ndarray, " A"]]:
    """Where rays from the middle leave the mask first, and which of them do so near the expected outline."""
    directions = half * np.stack([np.sin(ANGLES), -np.cos(ANGLES)], axis=1)
    places = (place + RADII[:, None, None] * directions).astype(np.float32)  # R A 2
    values = cv2.remap(mask, places[..., 0], places[..., 1], cv2.INTER_LINEAR)
    outside = values < 0.5
    first = outside.argmax(axis=0)
    found = outside.any(axis=0) & (first > 0)
    rays = np.arange(len(ANGLES))
    inner, outer = values[np.maximum(first - 1, 0), rays], values[first, rays]
    drop = np.where(found, inner - outer, 1.0)
    part = np.clip((inner - 0.5) / drop, 0, 1)
    radius = RADII[np.maximum(first - 1, 0)] + part * (RADII[1] - RADII[0])
    return place + radius[:, None] * directions, found


def _ellipse_step(
    offsets: Float[np.ndarray, "N 2"], half: Float[np.ndarray, "2"], height: float, aspect: float
) -> Float[np.ndarray, "4"]:
    """One Gauss-Newton step, Cauchy loss, in centre (half axes) and in the logarithms of both half axes.

    Args:
        offsets: points of the outline from the centre, in half axes: on a circle of radius 1 where the ellipse fits.
        half: half axes, px, drawn to `height` and `aspect`: the outline above the chin hardly tells the height.
        height: of the head by correlation, px.
        aspect: of a head.
    """
    radius = np.hypot(*offsets.T)
    residual = (radius - 1) / OUTLINE_SIGMA
    unit = offsets / radius[:, None]
    slopes = np.concatenate([unit, offsets * unit], axis=1) / OUTLINE_SIGMA
    weights = 1 / (1 + residual**2)
    priors = np.array([[0, 0, 1, -1], [0, 0, 0, 1]]) / [[ASPECT_SIGMA], [HEIGHT_SIGMA]]
    apart = np.log([aspect * half[1] / half[0], height / 2 / half[1]]) / [ASPECT_SIGMA, HEIGHT_SIGMA]
    normal = (slopes * weights[:, None]).T @ slopes + priors.T @ priors + 1e-6 * np.eye(4)
    step = np.linalg.solve(normal, slopes.T @ (weights * residual) + priors.T @ apart)
    return np.clip(step, -MAX_STEP, MAX_STEP)
