"""Settings of `jaxpoint point`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from jaxpoint.config.types import Count, Fraction, Positive


@dataclass(frozen=True)
class GestureSettings:
    """When an arm points: stretched out, and held."""

    min_stretch: Fraction = 0.19
    """The fingertip is that far from the body's upright axis, as a share of the stature; hanging arms reach 0.17."""
    min_hold_s: Positive = 0.4
    """Shorter holds are no gestures."""
    min_frames: Count = 3
    """Fewest frames of a hold in which the arm was measured."""
    min_pause_s: Positive = 0.8
    """Between two gestures of one person at least: the arm comes down and up again."""
    max_gap_s: Positive = 0.7
    """Without a measurement for longer, a hold ends."""
    tip_m: Positive = 0.12
    """The fingertip stays within this distance."""
    direction_deg: Positive = 15.0
    """The arm keeps its direction within this angle."""


@dataclass(frozen=True)
class RoomExtent:
    """The room as a box with walls along the axes; goes before the [room] of a .toml of objects."""

    low: tuple[float, float, float] | None = None
    """Lowest x, y and z of the room, m; without it the objects' file says it, or it is guessed."""
    high: tuple[float, float, float] | None = None
    """Highest x, y and z of the room, m."""


@dataclass(frozen=True)
class PointSettings:
    """How gestures become answers."""

    line: Literal["auto", "forearm", "finger", "eye-fingertip", "head-hand", "shoulder-hand", "blend"] = "auto"
    """What the line is drawn through; `auto` weighs eye and fingertip against the forearm by how the arm is held."""
    blend: dict[str, float] = field(default_factory=dict)
    """Weights of a blend, such as { forearm = 0.3, "head-hand" = 0.7 }."""
    gesture: GestureSettings = field(default_factory=GestureSettings)
    room: RoomExtent = field(default_factory=RoomExtent)
