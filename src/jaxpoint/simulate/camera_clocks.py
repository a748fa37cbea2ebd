"""When each camera really takes its images: in step, or late, drifting, losing and repeating frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.random import Generator

from jaxpoint.config.simulation import SimulationSettings


@dataclass(frozen=True)
class Clocks:
    """F common moments of C cameras."""

    present: Bool[np.ndarray, "F C"]  # whether the camera's file has an image of that moment
    source: Int[np.ndarray, "F C"]  # moment whose image it is; an earlier one where a camera repeats itself
    shown_s: Float[np.ndarray, "F C"]  # time that the image really shows
    stamped_s: Float[np.ndarray, "F C"]  # time that the camera says

    @property
    def moments(self) -> int:
        """Number of common moments, F."""
        return len(self.present)

    @property
    def frame_index(self) -> Int[np.ndarray, "F C"]:
        """Position in the camera's own file; -1 where it has no image."""
        return np.where(self.present, np.cumsum(self.present, axis=0) - 1, -1)


def make_clocks(rng: Generator, settings: SimulationSettings, moments: int) -> Clocks:
    """The clocks of a session of so many common moments, with the faults that are asked for."""
    faults, cameras = settings.faults, settings.viewpoints.cameras
    common = np.arange(moments) / settings.frames_per_second
    late = rng.uniform(0.0, faults.clock_offset_s, cameras)
    rate = 1 + rng.uniform(-faults.clock_drift, faults.clock_drift, cameras)
    shown = common[:, None] * rate + late
    present = rng.random((moments, cameras)) >= faults.dropped
    for camera, second in faults.stops:
        present[common >= second, camera] = False
    present[1::2, list(faults.half_rate)] = False
    stamped = np.repeat(common[:, None], cameras, axis=1)
    source = np.repeat(np.arange(moments)[:, None], cameras, axis=1)
    for moment, camera in np.argwhere(rng.random((moments, cameras)) < faults.doubled):
        source[moment, camera] = source[max(moment - 1, 0), camera]
    return Clocks(present, source, np.take_along_axis(shown, source, axis=0), stamped)
