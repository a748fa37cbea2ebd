"""What a calibration returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxpoint.tracks import Tracks

if TYPE_CHECKING:
    from jaxpoint.calibration.recording import Freedom
    from jaxpoint.camera.rig import CameraRig


class Verdict(IntEnum):
    """What became of one observation."""

    KEPT = 0
    HIDDEN = 1  # the camera did not see the light
    FEW_VIEWS = 2  # fewer than two cameras saw it in this frame: no point to compare with
    REPROJECTION = 3  # too far from where the other cameras say the light is
    BEHIND = 4  # its point lies behind the camera
    UNDECIDED = 5  # the views contradict each other and too few agree to say which is wrong


@dataclass(frozen=True)
class PairTable:
    """What the cameras share, known before anything is solved."""

    names: tuple[str, ...]
    seen: Int[np.ndarray, " C"]  # frames in which each camera saw the light
    shared: Int[np.ndarray, "C C"]  # frames seen by both
    coverage: Float[np.ndarray, " C"]  # fraction of an 8 x 6 grid of image cells that the light visited
    inliers: Int[np.ndarray, "C C"] | None = None  # of the shared ones, those that fit the pair's epipolar geometry


@dataclass(frozen=True)
class Stage:
    """One step of the pipeline, for the report: its name and figures a person can compare."""

    name: str
    figures: dict[str, Any]


Level = Literal["good", "care", "bad"]


@dataclass(frozen=True)
class Finding:
    """Something that a user must know about a calibration: the cause, what was found, and what helps."""

    cause: str  # one or two words that stay the same from version to version, such as "parallel axes"
    level: Level  # "bad": the calibration does not pass because of it
    finding: str  # a sentence with the figure
    remedy: str
    cameras: tuple[str, ...] = ()  # that it concerns
    left_out: bool = False  # these cameras are none of the rig any more


@dataclass(frozen=True)
class TimeOffsets:
    """By how much cameras ran out of step, in frames of the recording; the first camera is the clock."""

    frames: Float[np.ndarray, " C"]  # positive: the camera shows the light late; the first is 0
    sigma: Float[np.ndarray, " C"]  # one standard deviation; of the first 0


@dataclass(frozen=True)
class ReadoutTimes:
    """How long rolling shutters take from the first image row to the last, in frames of the recording."""

    frames: Float[np.ndarray, " C"]  # negative: read from below, as by a camera that hangs upside down
    sigma: Float[np.ndarray, " C"]  # one standard deviation


@dataclass(frozen=True)
class FrameHold:
    """What holds a calibration's scale and frame beside its observations.

    Targets of known size, known points, or cameras that stayed as another calibration has them.
    """

    open_freedoms: int  # of a similarity that nothing holds: 6 with targets (no scale), 0 with known points
    scale_sigma: float  # standard deviation of the scale that the sizes of targets leave, as a share of it
    in_room: bool = True  # where no freedom is open: whether the frame is that of the room


@dataclass(frozen=True)
class Calibration:
    """A calibrated rig, the light's path, and what became of every observation.

    With `time_offsets` or `readout_times`, `tracks` are not as recorded: every observation stands where its camera saw
    the light at the row's moment on the first camera's clock. Lengths are in the solver's own unit until the result is
    aligned, unless targets of known size or known points gave it its scale (`unit` is "m" then).

    Not a pytree: it is the record of a finished solve, in numpy on the host, with verdicts, words and settings that no
    program could take. Its `rig` and `tracks` are pytrees; derivatives of a calibration come from `chain_of`.
    """

    rig: CameraRig
    tracks: Tracks
    points: Float[np.ndarray, "F 3"]  # the light; zeros where `point_valid` is False
    point_valid: Bool[np.ndarray, " F"]
    residuals: Float[np.ndarray, "F C 2"]  # px, projected minus observed; 0 where there is no point or no pixel
    verdicts: Int[np.ndarray, "F C"]  # values of `Verdict`
    sigma_px: float  # robust standard deviation of one pixel coordinate
    converged: bool
    message: str  # why the solver stopped, in words
    pairs: PairTable
    stages: tuple[Stage, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)  # init, adjust, total
    unit: str = "arbitrary"  # or "m"
    alignment: Any | None = None  # calibration.alignment.Alignment once aligned
    camera_covariance: Float[np.ndarray, "D D"] | None = None  # D = p C, in the order of `Camera.perturbed`
    gauge: str | None = None  # what holds the frame of that covariance, see `uncertainty`: "free" or "landmarks"
    undetermined: str = ""  # why there is no covariance, in words
    seed: int = 0
    freedom: Freedom | None = None  # of the C cameras in the last adjustment; `uncertainty_of` needs it
    loss_scale: float | None = None  # px, of its Cauchy loss; None for least squares
    time_offsets: TimeOffsets | None = None  # where they were solved for
    readout_times: ReadoutTimes | None = None  # where they were solved for
    hold: FrameHold | None = None  # targets or known points that took part in the adjustment
    findings: tuple[Finding, ...] = ()  # what `calibrate` met on the way; `calibration.quality` adds the rest

    @property
    def kept(self) -> Bool[np.ndarray, "F C"]:
        """The observations that the calibration believes."""
        return self.verdicts == Verdict.KEPT

    @property
    def in_room(self) -> bool:
        """Whether the frame is that of the room: aligned with it, or held by known points."""
        return self.alignment is not None or (
            self.hold is not None and self.hold.open_freedoms == 0 and self.hold.in_room
        )

    @property
    def comparable(self) -> Bool[np.ndarray, "F C"]:
        """The observations of frames that two cameras or more saw: only these can be believed or not."""
        return self.tracks.visible & (self.verdicts != Verdict.FEW_VIEWS)

    @property
    def errors(self) -> Float[np.ndarray, "F C"]:
        """Length of every residual, px."""
        return np.linalg.norm(self.residuals, axis=-1)
