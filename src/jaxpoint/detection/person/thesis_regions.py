"""The thesis's pointing regions, literally: the baseline (6.3.1, 6.3.2, 7.2.2)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from jaxtyping import Bool

from jaxpoint.config.person import ShapeSettings, SkinSettings, ThesisSettings
from jaxpoint.detection.colour import Image, is_grey
from jaxpoint.detection.person.endpoints import Endpoints, finger_endpoints, forearm_endpoints
from jaxpoint.detection.person.marker_regions import MarkerModel, marker_mask
from jaxpoint.detection.person.silhouette import Silhouette
from jaxpoint.detection.person.skin import skin_mask, skin_model
from jaxpoint.detection.region import Region, label_regions


class ThesisReason(IntEnum):
    """Why a silhouette gave a pointing region, or the first filter that left none."""

    FOUND = 0
    GREY = 1  # the image has no colour
    NO_COLOUR = 2  # no pixel of the person has the colour that is looked for
    TOO_SMALL = 3  # area
    TOO_ROUND = 4  # eccentricity
    TOO_STEEP = 5  # orientation
    WRONG_RATIO = 6  # of the axes


@dataclass(frozen=True)
class ThesisRegion:
    """A pointing region and its ends; `region` and `endpoints` are None where it was not found."""

    mask: Bool[np.ndarray, "h w"]  # the pixels inside `region.box`; (0, 0) where not found
    region: Region | None  # in the whole image
    endpoints: Endpoints | None  # px, in the whole image
    reason: ThesisReason


def thesis_forearm(image: Image, silhouette: Silhouette, settings: ThesisSettings) -> ThesisRegion:
    """Skin by hue, Cr and Cb in the silhouette; of the regions of the right shape the farthest from its centroid."""
    return _pointing(image, silhouette, _thesis_skin, settings.forearm, forearm_endpoints)


def thesis_finger(image: Image, silhouette: Silhouette, model: MarkerModel, settings: ThesisSettings) -> ThesisRegion:
    """The same with the colour of a marker; `model` should be trained with `gates="fixed"`."""
    return _pointing(image, silhouette, lambda part: marker_mask(part, model), settings.finger, finger_endpoints)


def _thesis_skin(image: Image) -> Bool[np.ndarray, "H W"]:
    return skin_mask(image, skin_model(SkinSettings(model="thesis")))


def _pointing(
    image: Image,
    silhouette: Silhouette,
    coloured: Callable[[Image], np.ndarray],
    shape: ShapeSettings,
    endpoints: Callable[[np.ndarray, np.ndarray], Endpoints],
) -> ThesisRegion:
    if is_grey(image):
        return _missing(ThesisReason.GREY)
    mask = coloured(np.ascontiguousarray(silhouette.crop(image))) & silhouette.mask
    if not mask.any():
        return _missing(ThesisReason.NO_COLOUR)
    labels, regions = label_regions(mask, min_area=shape.min_area_px + 1)
    regions, reason = of_shape(regions, shape)
    if not regions:
        return _missing(reason)
    origin = np.array(silhouette.box[:2])
    center = silhouette.region.centroid - origin
    farthest = max(regions, key=lambda region: float(np.hypot(*(region.centroid - center))))
    crop, region = farthest.crop(labels), farthest.shift(*silhouette.box[:2])
    corner = np.array(region.box[:2])
    ends = endpoints(crop, silhouette.region.centroid - corner)
    return ThesisRegion(crop, region, Endpoints(ends.tip + corner, ends.base + corner), ThesisReason.FOUND)


def of_shape(regions: list[Region], shape: ShapeSettings) -> tuple[list[Region], ThesisReason]:
    """The regions, all large enough, that pass the filters, or the first filter that leaves none."""
    steepest = np.radians(shape.max_orientation_deg)
    filters: tuple[tuple[ThesisReason, Callable[[Region], bool]], ...] = (
        (ThesisReason.TOO_ROUND, lambda region: region.eccentricity > shape.min_eccentricity),
        (ThesisReason.TOO_STEEP, lambda region: abs(region.orientation) < steepest),
        (ThesisReason.WRONG_RATIO, lambda region: shape.min_ratio < region.ratio < shape.max_ratio),
    )
    if not regions:
        return [], ThesisReason.TOO_SMALL
    for reason, passes in filters:
        regions = [region for region in regions if passes(region)]
        if not regions:
            return [], reason
    return regions, ThesisReason.FOUND


def _missing(reason: ThesisReason) -> ThesisRegion:
    return ThesisRegion(np.zeros((0, 0), dtype=bool), None, None, reason)
