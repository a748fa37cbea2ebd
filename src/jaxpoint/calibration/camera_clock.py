"""What is found about the clocks of cameras."""

from __future__ import annotations

from dataclasses import dataclass

from jaxpoint.calibration.offset_search import PairOffset


@dataclass(frozen=True)
class CameraClock:
    """How a camera's frames lie in time against those of the largest group of cameras that agree."""

    name: str
    offset_frames: float  # positive where it shows the light late; at the first frame of the tracks
    rate: float  # its frames to one of the group's
    share_before: float  # 0..1, of its matches with others that fit one epipolar geometry, all taken as in step
    share_after: float  # and under the clocks that were found
    certain: bool  # False: no clock makes this camera fit the others well
    even: bool = True  # False: in step but for frames that its recording repeats or skips at regular intervals

    readout_frames: float | None = None  # from its first image row to its last; None where that was not searched
    readout_sigma: float | None = None  # one standard deviation

    @property
    def in_step(self) -> bool:
        """Nothing to be set right: less than half a frame late, at the same rate."""
        return abs(self.offset_frames) < 0.5 and self.rate == 1.0


@dataclass(frozen=True)
class ClockSurvey:
    """The clocks of all cameras, and what pairs of them said."""

    clocks: tuple[CameraClock, ...]
    pairs: tuple[PairOffset, ...]
