"""Settings of the head track."""

from __future__ import annotations

from dataclasses import dataclass

from jaxpoint.config.types import Count, Fraction, Positive, check_not_above
from jaxpoint.errors import UsageError


@dataclass(frozen=True)
class TrackSettings:
    """How heads seen in several views become tracks in space (thesis 6.2.3)."""

    sigma_px: Positive = 4.0
    """Standard deviation of a head's pixel coordinate, where the detector does not give one."""
    gate: Fraction = 0.999
    """Probability with which a right observation passes a chi-square gate."""
    acceleration_m_s2: Positive = 2.0
    """Standard deviation of a head's acceleration, averaged over one second."""
    speed_m_s: Positive = 1.0
    """Standard deviation of each component of a head's velocity when its track begins."""
    height_m: tuple[float, float] = (0.6, 2.2)
    """Heads lie this high above the floor (z = 0), lowest and highest."""
    separation_m: Positive = 0.2
    """The centres of two heads are never nearer than this."""
    false_heads_m2: Positive = 4.0
    """Heads seen by chance for each square metre across a line of sight: another person's, or none at all."""
    new_heads_m3: Positive = 1.0
    """How many new heads to expect in a cubic metre of a frame, against which tracks compete for what was seen."""
    confirm: tuple[Count, Count] = (3, 5)
    """A track counts once it was measured in so many of its first so many frames."""
    occlusion_s: Positive = 2.0
    """A track that is not measured for longer ends; whoever appears later is a new person."""

    def __post_init__(self) -> None:
        low, high = self.height_m
        if low >= high:
            raise UsageError(
                f"The setting 'track.height_m' cannot be used: its lowest, {low:g}, is not below its highest, {high:g};"
                " give the lower height first."
            )
        check_not_above("track.confirm[0]", self.confirm[0], "track.confirm[1]", self.confirm[1])
