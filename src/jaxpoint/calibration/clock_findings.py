"""What the clocks of cameras mean, in sentences: who is late, who runs at another rate, and the flags against it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxpoint.calibration.camera_clock import CameraClock
from jaxpoint.motion import held_still
from jaxpoint.tracks import Tracks

FAR = 2.0  # frames: an offset that `calibrate --time-offsets` does not find by itself
HELD = 0.2  # share of a camera's sightings that stand on one pixel while the light moves: its image froze


@dataclass(frozen=True)
class Timing:
    """What flags are written with."""

    rate: float | None  # frames a second of the common clock, where times say
    span: float  # frames from the first to the last of the tracks

    @staticmethod
    def of(tracks: Tracks) -> Timing:
        """As tracks have it."""
        seconds = np.diff(tracks.times) if tracks.times is not None else np.zeros(0)
        moving = seconds > 0
        rate = float(np.median(np.diff(tracks.series_ids)[moving] / seconds[moving])) if moving.any() else None
        return Timing(rate, float(np.ptp(tracks.frame_ids)))


def contradicts(clock: CameraClock) -> bool:
    """A calibration of these tracks as they are would go wrong by this camera."""
    return not clock.certain or abs(clock.offset_frames) >= FAR or clock.rate != 1.0


def finding(clock: CameraClock, timing: Timing) -> str:
    """What is so about a camera that is late by whole frames or runs at a rate of its own."""
    offset = _round_offset(clock)
    late = f"shows the light {abs(offset):g} frames {'late' if offset > 0 else 'early'}"
    if clock.rate == 1.0:
        return f"Camera {clock.name} {late}."
    common = _common(timing.rate)
    rate = f"{float(_rate(clock, timing)):.2f}"
    if not clock.even:
        interval = f"{1.0 / abs(1.0 - 1.0 / clock.rate):.0f}"
        does = "repeats" if clock.rate > 1.0 else "skips"
        runs = f"{does} a frame every {interval} frames, as one of {rate} frames a second recorded at {common:g} does"
    elif timing.rate is None:
        runs = f"runs {clock.rate:.5g} times as fast as the others, as {rate} frames a second beside {common:g}"
    else:
        runs = f"runs at {rate} frames a second beside {common:g}"
    return f"Camera {clock.name} {runs}" + (f" and {late} at the first." if abs(offset) >= 0.5 else ".")


def flags(clocks: Sequence[CameraClock], timing: Timing) -> str:
    """The flags that bring these cameras to the clock of the others."""
    common = _common(timing.rate)
    late = [f"--offset {_quote(c.name)}={_round_offset(c):g}" for c in clocks if abs(_round_offset(c)) >= 0.1]
    rates = [f"--rate {_quote(c.name)}={_rate(c, timing)}" for c in clocks if c.rate != 1.0]
    return " ".join([*late, *([f"--rate all={common:g}"] if rates else []), *rates])


def readout_flags(names: Sequence[str], frames: Sequence[float]) -> str:
    """The flags that give readout times."""
    return " ".join(f"--readout {_quote(name)}={value:.3g}" for name, value in zip(names, frames))


def cause(held: float, clock: CameraClock) -> tuple[str, str]:
    """Why a camera fits no other, as far as its tracks tell, and what to do.

    Args:
        held: as `held_share` has it.
    """
    leave = f"Leave it out by `--leave-out {_quote(clock.name)}`"
    if held > HELD:
        return (
            f"The light of camera {clock.name} stands on one pixel in {held:.0%} of its frames, and moves in others.",
            f"Its image froze. {leave}, or record anew.",
        )
    said = (
        f"Camera {clock.name} fits no other, in step or at any lag or rate that was tried: at best "
        f"{clock.share_after:.0%} of its matches agree on one epipolar geometry"
    )
    return (
        f"{said}.",
        f"Is it of this recording and room, was it moved, did it lose frames, or is it full of reflections? {leave}.",
    )


def held_share(tracks: Tracks) -> Float[np.ndarray, " C"]:
    """Fraction of each camera's sightings that stand on one pixel while the light moves in most others."""
    held = held_still(tracks.pixels, tracks.visible)
    moving = (tracks.visible & ~held).sum(axis=1, keepdims=True)
    others = moving >= np.maximum(1, tracks.visible.sum(axis=1, keepdims=True) / 2.0)
    return (held & others).sum(axis=0) / np.maximum(tracks.visible.sum(axis=0), 1)


def problems(clocks: Sequence[CameraClock], timing: Timing, held: Float[np.ndarray, " C"]) -> Iterator[str]:
    """Why tracks do not suffice as they are: cameras that contradict the others, the remedy last."""
    wrong = [clock for clock in clocks if clock.certain and contradicts(clock)]
    if wrong:
        yield " ".join(finding(clock, timing) for clock in wrong) + f" Give {flags(wrong, timing)}."
    for clock, share in zip(clocks, held):
        if not clock.certain or share > HELD:
            yield " ".join(cause(float(share), clock))


def _round_offset(clock: CameraClock) -> float:
    """Whole frames where it is nearly so: those are shifted exactly."""
    whole = float(np.round(clock.offset_frames))
    return whole if abs(clock.offset_frames - whole) < 0.15 else float(np.round(clock.offset_frames, 1))


def _common(rate: float | None) -> float:
    """A rate as people write it; where it is not known 30 will do, as only ratios matter."""
    return 30.0 if rate is None else float(f"{rate:.5g}")


def _rate(clock: CameraClock, timing: Timing) -> str:
    """Frames a second that the camera gave, with as many digits as matter: a fiftieth of a frame over the recording."""
    common = _common(timing.rate)
    digits = int(np.clip(np.ceil(np.log10(max(timing.span, 1.0) * 50.0 / common)), 2, 7))
    rate = common * (clock.rate if clock.even else 1.0 / clock.rate)
    return f"{rate:.{digits}f}".rstrip("0").rstrip(".")


def _quote(name: str) -> str:
    """A name as a shell takes it."""
    import shlex

    return shlex.quote(name)
