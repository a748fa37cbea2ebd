"""Settings of the detectors of a person: motion, silhouette, head, skin, marker, and the thesis's filters.

Sizes are in pixels of the image as it is unless the field says otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from jaxpoint.config.types import Count, Fraction, Positive, check_not_above


@dataclass(frozen=True)
class MotionSettings:
    """When something moves before a camera (thesis 6.2.1)."""

    width_px: Count = 320
    """Images are compared at the whole fraction of their size nearest to this width; 0, the thesis's, is all of it."""
    canny_low: Positive = 50.0
    """Lower threshold of the Canny detector on the difference of two images, grey levels."""
    canny_high: Positive = 100.0
    """Upper threshold of the Canny detector."""
    deviations: Positive = 5.0
    """The threshold lies this many standard deviations above the empty room's mean count of edge pixels."""
    floor_px: Count = 12
    """Fewest edge pixels at that width that are motion, however quiet the room; 50 at the thesis's full size."""
    min_pairs: Count = 50
    """Fewest pairs of successive images from which the threshold is learnt."""
    frames_on: Count = 3
    """Motion begins with this many frames above the threshold in a row."""
    frames_off: Count = 10
    """It ends with this many below it in a row."""
    switch_fraction: Fraction = 0.3
    """When more of the image's pixels than this change, it may be a light that is switched."""
    switch_one_sign: Fraction = 0.9
    """It is one if this part of them changes in the same direction."""
    switch_levels: Positive = 15.0
    """Grey levels by which a pixel must change to count for it."""

    def __post_init__(self) -> None:
        check_not_above("motion.canny_low", self.canny_low, "motion.canny_high", self.canny_high)


@dataclass(frozen=True)
class BackgroundSettings:
    """What the room looks like without people (thesis 6.2.1)."""

    method: Literal["static", "mog2", "knn"] = "static"
    """`static`: per-pixel median and MAD over frames, or of an empty room; `mog2`, `knn`: OpenCV's adaptive ones."""
    width_px: Count = 640
    """Images are compared at the whole fraction of their size nearest to this width; 0, the thesis's, is all of it."""
    threshold: Positive = 25.0
    """Least sum of the differences in Y, Cr and Cb that is foreground, grey levels."""
    deviations: Positive = 6.0
    """The sum must also exceed this many of the pixel's own deviations (scaled MAD)."""
    weak_threshold: Positive = 14.0
    """Least sum that is foreground next to such pixels: white hair before a white wall."""
    reach_px: Count = 12
    """How far from them that holds, at the width above; 0 is the thesis's."""
    follow_light: bool = True
    """Divide out a common gain of each colour channel: flicker, exposure, a slow change of light."""
    shadows: bool = True
    """Take what is only darker, in the same colour and by a bounded factor, for a shadow and not for a person."""
    shadow_darkest: Fraction = 0.75
    """A shadow keeps at least this fraction of the light."""
    shadow_colour: Positive = 8.0
    """Largest sum of the differences in Cr and Cb of a shadow, grey levels."""
    shadow_texture: Positive = 0.05
    """Largest standard deviation, among neighbours, of the factor by which a shadow darkens the room."""
    min_frames: Count = 10
    """Fewest images from which a background is learnt."""
    max_frames: Count = 100
    """Images used, spread over the recording."""
    history: Count = 500
    """Adaptive only: frames that the background remembers."""


@dataclass(frozen=True)
class SilhouetteSettings:
    """From foreground pixels to people (thesis 6.2.2)."""

    width_px: Count = 640
    """Regions are formed at the whole fraction of the image nearest to this width; 0, the thesis's, is all of it."""
    thicken: Count = 0
    """Times that regions grow by a pixel without merging; 1 is the thesis's, and makes everyone too wide."""
    close_px: Count = 5
    """Side of the square that closes gaps, at the width above; the thesis's default is 7."""
    min_fraction: Fraction = 0.002
    """Regions smaller than this fraction of the image are no people."""
    people: Count = 4
    """Most silhouettes returned, the largest first; 1 is the thesis's."""


@dataclass(frozen=True)
class HeadSettings:
    """How a head is found in a silhouette (thesis 6.2.3)."""

    method: Literal["outline", "thesis"] = "outline"
    """`thesis`: the best ellipse by normalised correlation; `outline`: an ellipse with nothing of the person above and
    beside it, refined on the outline above the chin."""
    height_m: Positive = 0.24
    """Height of a head."""
    nearest_m: Positive = 1.0
    """Nearest distance from the camera."""
    farthest_m: Positive = 6.0
    """Farthest distance from the camera."""
    heights: Count = 10
    """Sizes of the ellipse between the two, evenly spaced in the logarithm."""
    aspect: Positive = 0.78
    """Width of a head over its height."""
    template_px: Count = 16
    """The silhouette is resampled so that a head has this height; correlation costs more with every pixel."""
    min_score: Fraction = 0.7
    """Least correlation of a head; the thesis's is 0.6."""
    upper_part: Fraction = 0.5
    """Part of the silhouette, from its top, that is searched."""

    def __post_init__(self) -> None:
        check_not_above("head.nearest_m", self.nearest_m, "head.farthest_m", self.farthest_m)


@dataclass(frozen=True)
class SkinSettings:
    """Which colours are skin (thesis 6.3.1)."""

    model: Literal["fitted", "box", "thesis"] = "fitted"
    """`fitted`: log-likelihood ratio of Gaussians; `box`: Cr 133 to 173, Cb 77 to 127; `thesis`: hue and that box."""
    red_wrap: bool = False
    """Thesis only: hues just below red count as skin as well."""
    white_balance: bool = False
    """Divide out the room's cast of colour first."""
    threshold: float = -0.25
    """Fitted only: least log-likelihood ratio of skin to anything else, nats."""


@dataclass(frozen=True)
class MarkerSettings:
    """How a coloured marker on the finger is found (thesis 6.3.2)."""

    gates: Literal["sigma", "fixed"] = "sigma"
    """`sigma`: `deviations` of the picked pixels, within half and twice the fixed gates; `fixed`: those three."""
    deviations: Positive = 4.0
    """Half width of a gate in standard deviations of the picked pixels."""
    hue_gate: Positive = 10.0
    """Half width in hue, in OpenCV's units of 2 degrees."""
    saturation_gate: Positive = 60.0
    """Half width in saturation, of 255."""
    value_gate: Positive = 70.0
    """Half width in value, of 255."""
    min_pixels: Count = 20
    """Fewest pixels from which a marker's colour is learnt."""
    min_saturation: Positive = 40.0
    """A marker of less saturation has no hue that could be told from grey."""
    min_area_px: Count = 7
    """Regions of this area or less are not the marker."""
    reach_px: Count = 6
    """How far outside the silhouette the marker may lie, which is often the outermost part of the person."""
    candidates: Count = 4
    """Regions of one silhouette that may be the marker, the largest; over several views, the one that they share is."""
    sample_radius_px: Positive = 1.0
    """Pixels this near to a picked one are picked too, where the samples do not say otherwise."""
    max_length_m: Positive = 0.15
    """What is longer in the room is no marker."""
    agree_m: Positive = 0.03
    """How far from a place in the room the middle of a region may be seen, for its view to count."""


@dataclass(frozen=True)
class ShapeSettings:
    """The thesis's filters of a region's shape; pixels of the image as it is."""

    min_area_px: Count
    """Regions of this area or less are rejected."""
    min_eccentricity: Fraction
    """Rounder regions are rejected."""
    max_orientation_deg: Positive
    """Steeper regions are rejected."""
    min_ratio: Positive
    """Least ratio of the axes."""
    max_ratio: Positive
    """Largest ratio of the axes."""


@dataclass(frozen=True)
class ThesisSettings:
    """The thesis's pointing regions: what shape they must have (6.3.1, 6.3.2)."""

    forearm: ShapeSettings = field(default_factory=lambda: ShapeSettings(100, 0.75, 55.0, 2.0, 11.0))
    """Of a forearm of bare skin."""
    finger: ShapeSettings = field(default_factory=lambda: ShapeSettings(7, 0.75, 60.0, 3.0, 8.0))
    """Of a marker on the finger."""


@dataclass(frozen=True)
class PersonSettings:
    """How a person is found in the images of a calibrated room."""

    motion: MotionSettings = field(default_factory=MotionSettings)
    background: BackgroundSettings = field(default_factory=BackgroundSettings)
    silhouette: SilhouetteSettings = field(default_factory=SilhouetteSettings)
    head: HeadSettings = field(default_factory=HeadSettings)
    skin: SkinSettings = field(default_factory=SkinSettings)


def thesis_person() -> PersonSettings:
    """The thesis's own methods and defaults at every stage: the baseline.

    Its regions of pointing have settings of their own, `ThesisSettings`; its marker is found with `gates="fixed"`.
    """
    return PersonSettings(
        motion=MotionSettings(width_px=0, floor_px=50),
        background=BackgroundSettings(width_px=0, reach_px=0, follow_light=False, shadows=False),
        silhouette=SilhouetteSettings(width_px=0, thicken=1, close_px=7, people=1),
        head=HeadSettings(method="thesis", template_px=24, min_score=0.6),
        skin=SkinSettings(model="thesis"),
    )
