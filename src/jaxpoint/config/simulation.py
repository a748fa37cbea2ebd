"""Settings of the simulated recording: the room, its cameras, their sensors and faults; people have their own.

What varies is a distribution, drawn from the seed once a session (or camera). Plain Python, as all settings are.
"""

# ruff: noqa: RUF009 (a Uniform cannot change)

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from msgspec import Meta

from jaxpoint.config.people import PeopleSettings, Uniform
from jaxpoint.config.types import Count, Fraction, Positive

AtLeastOne = Annotated[int, Meta(ge=1)]
ImageSide = Annotated[int, Meta(ge=32, multiple_of=2)]
"""Of an image, px: the colours of a video are stored for two pixels at once."""
Readout = Annotated[float, Meta(ge=-1, le=1)]
"""Frames from the first image row to the last."""
FrameRate = Annotated[float, Meta(ge=0.01, le=1000)]
"""Frames a second that an mp4 file can have."""


@dataclass(frozen=True)
class SceneSettings:
    """The room of 6 x 5 x 3 m and its light."""

    lamp_brightness: Uniform = Uniform(0.7, 1.3)
    """Of each lamp, drawn apart; 1 lights the room evenly."""
    lamp_warmth: Uniform = Uniform(-0.15, 0.25)
    """Red over blue of the lamps: 0 is white, 0.25 an incandescent lamp."""
    indirect: Uniform = Uniform(0.8, 1.2)
    """Strength of the light that walls and ceiling send back."""


@dataclass(frozen=True)
class ViewpointSettings:
    """Where the cameras hang and what lenses they have."""

    cameras: AtLeastOne = 6
    size: tuple[ImageSide, ImageSide] = (1280, 720)
    """Width and height of the images, px."""
    field_of_view_deg: Uniform = Uniform(55.0, 85.0)
    """Across the width of the image."""
    height_m: Uniform = Uniform(1.8, 2.8)
    k1: Uniform = Uniform(-0.28, 0.03)
    """Radial distortion; k2 is about k1 squared."""
    tangential: Positive = 5e-4
    """Standard deviation of p1 and p2."""
    center_sd: Fraction = 0.012
    """Standard deviation of the principal point, as a fraction of the width."""
    roll_sd_deg: Positive = 3.0


@dataclass(frozen=True)
class SensorSettings:
    """From light to 8-bit images."""

    exposure: Uniform = Uniform(0.75, 1.25)
    """Of each camera; 1 shows a white wall at about three quarters of the range."""
    white_balance: Uniform = Uniform(0.92, 1.08)
    """Gains of red and of blue in each camera."""
    vignetting: Uniform = Uniform(0.0, 0.3)
    """Share of the light that is missing in the corners."""
    full_well_e: Uniform = Uniform(4000.0, 12000.0)
    """Electrons at the top of the range: what makes the Poisson noise."""
    read_noise_e: Uniform = Uniform(4.0, 12.0)
    """Standard deviation, electrons."""
    jpeg_quality: Uniform = Uniform(75.0, 95.0)
    """Of each camera's compression."""
    shutter_s: Uniform = Uniform(0.006, 0.02)
    """Time in which what moves is smeared."""


@dataclass(frozen=True)
class LightChangeSettings:
    """How the light varies while the cameras record."""

    flicker: Fraction = 0.01
    """Standard deviation of the brightness of successive frames, all lamps together."""
    drift: Fraction = 0.05
    """Largest slow change, as clouds make it."""
    drift_s: Positive = 60.0
    """Period of the slow change."""


@dataclass(frozen=True)
class FaultSettings:
    """What goes wrong in recordings; nothing by default."""

    dropped: Fraction = 0.0
    """Share of frames that a camera loses."""
    doubled: Fraction = 0.0
    """Share of frames in which a camera repeats the one before."""
    clock_offset_s: Fraction = 0.0
    """Cameras run late by up to so much."""
    clock_drift: Fraction = 0.0
    """Relative error of the cameras' clocks, up to so much."""
    stops: tuple[tuple[Count, Positive], ...] = ()
    """Camera number and the second at which it stops."""
    half_rate: tuple[Count, ...] = ()
    """Numbers of cameras that record every second frame only."""
    grey: tuple[Count, ...] = ()
    """Numbers of cameras that record no colour."""
    exposure_factor: tuple[tuple[Count, Positive], ...] = ()
    """Camera number and the factor by which it is exposed wrongly: 0.03 is too dark, 8 blown out."""


@dataclass(frozen=True)
class WaveSettings:
    """A light waved through the dark room."""

    frames: Annotated[int, Meta(ge=2)] = 300
    frames_per_second: FrameRate = 25.0
    darkness: Uniform = Uniform(0.001, 0.004)
    """Light left in the room, over the light of the session."""
    led_radius_m: Uniform = Uniform(0.007, 0.010)
    """Radius of the matt ball around the LED."""
    reflections: Fraction = 1.0
    """Strength of the mirror images in screens, window and table tops."""
    glints: Count = 2
    """Small steady lights, as devices on standby have them."""
    readouts: tuple[tuple[Count, Readout], ...] = ()
    """Camera number and the frames that its rolling shutter takes from its first image row to its last, negative from
    below; the others have global shutters."""


@dataclass(frozen=True)
class SimulationSettings:
    """A whole simulated session, one table a field."""

    frames_per_second: FrameRate = 12.5
    empty_frames: Count = 60
    """Frames of the empty room, recorded before anyone enters."""
    scene: SceneSettings = field(default_factory=SceneSettings)
    viewpoints: ViewpointSettings = field(default_factory=ViewpointSettings)
    sensor: SensorSettings = field(default_factory=SensorSettings)
    light: LightChangeSettings = field(default_factory=LightChangeSettings)
    faults: FaultSettings = field(default_factory=FaultSettings)
    wave: WaveSettings = field(default_factory=WaveSettings)
    people: PeopleSettings = field(default_factory=PeopleSettings)
