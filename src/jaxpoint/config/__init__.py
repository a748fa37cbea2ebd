"""Settings of every command, and how they are read."""

from jaxpoint.config.loading import check_settings, load_settings, to_toml
from jaxpoint.config.room import (
    AlignSettings,
    CalibrateSettings,
    DetectSettings,
    EpipolarSettings,
    InputSettings,
    LedSettings,
    LensSettings,
    OutlierSettings,
    RoomConfig,
    RuntimeSettings,
    ValidateSettings,
    load_config,
)
from jaxpoint.config.stereo_matching import StereoSettings
from jaxpoint.config.types import Count, Fraction, Positive, Unit

__all__ = [
    "AlignSettings",
    "CalibrateSettings",
    "Count",
    "DetectSettings",
    "EpipolarSettings",
    "Fraction",
    "InputSettings",
    "LedSettings",
    "LensSettings",
    "OutlierSettings",
    "Positive",
    "RoomConfig",
    "RuntimeSettings",
    "StereoSettings",
    "Unit",
    "ValidateSettings",
    "check_settings",
    "load_config",
    "load_settings",
    "to_toml",
]
