"""Clocks of cameras as flags give them: `--offset cam_2=37`, `--rate cam_2=29.83`, `--readout all=0.6`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from jaxpoint.config import InputSettings
from jaxpoint.errors import InsufficientDataError, UsageError

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Bool, Float

    from jaxpoint.calibration.result import Calibration
    from jaxpoint.tracks import Tracks

ALL = "all"  # in `--rate` and `--readout`, every camera that is not named
LONGEST = 1.0  # frames: a camera reads an image before it takes the next


def without_left_out(tracks: Tracks, names: Sequence[str]) -> Tracks:
    """The tracks without these cameras.

    Raises:
        UsageError: a name is not among the cameras.
        InsufficientDataError: none is left.
    """
    _check_known(tracks, names, "--leave-out")
    return tracks.select_cameras([i for i, name in enumerate(tracks.names) if name not in names]) if names else tracks


def on_given_clock(tracks: Tracks, settings: InputSettings) -> Tracks:
    """The tracks brought to one clock by the offsets, rates and readout times of the settings, if any is given.

    Raises:
        UsageError: a camera that is not there or named twice, or a number that cannot be used.
        InsufficientDataError: a camera has nothing left.
    """
    if not settings.offset and not settings.rate and not settings.readout:
        return tracks
    import numpy as np

    from jaxpoint.motion import moved_to_clock

    offsets, rates = given_offsets(tracks, settings.offset), given_rates(tracks, settings.rate)
    readouts = given_readouts(tracks, settings.readout) if settings.readout else None
    usable = _usable(tracks)
    for camera in np.flatnonzero(rates != 1.0).tolist():
        tracks, rates[camera] = _evenly(tracks, camera, usable, float(rates[camera]))
    moved = moved_to_clock(tracks, offsets, rates, _usable(tracks), readouts)
    empty = np.flatnonzero(tracks.visible.any(axis=0) & ~moved.visible.any(axis=0))
    if len(empty):
        raise InsufficientDataError(
            f"Brought to one clock, camera '{tracks.names[empty[0]]}' has no light left in the frames "
            f"{tracks.frame_ids[0]} to {tracks.frame_ids[-1]} of the tracks; look at the sign and size of its "
            "--offset, --rate and --readout."
        )
    return moved


def _usable(tracks: Tracks) -> Bool[np.ndarray, "F C"]:
    """The observations from which the light's motion is taken."""
    from jaxpoint.motion import without_jumps

    return without_jumps(tracks.pixels, tracks.visible, tracks.series_ids, tracks.image_sizes[:, 0].astype(float))


def _evenly(tracks: Tracks, camera: int, usable, rate: float) -> tuple[Tracks, float]:
    """The tracks with a camera's frames evenly in time, and its rate then.

    A recording at 30 frames a second of a camera that gives 29.83 repeats a frame now and then (one of 30.17 skips
    one); its light must not be moved evenly, but the frames be counted as the camera gave them.
    """
    from jaxpoint.repeats import regular_steps, without_steps

    for in_file in (1.0 / rate, rate):
        steps = regular_steps(tracks, camera, usable, in_file)
        if steps is not None:
            left = in_file / steps.rate
            known_well = abs(left - 1.0) * float(tracks.frame_ids.max() - tracks.frame_ids.min()) < 1.0
            return without_steps(tracks, camera, steps), 1.0 if known_well else left
    return tracks, rate


def given_offsets(tracks: Tracks, given: Sequence[str]) -> Float[np.ndarray, " C"]:
    """Frames by which each camera shows the light late; 0 where it is not named."""
    import numpy as np

    values = _values(given, "--offset", "cam_2=37")
    _check_known(tracks, values, "--offset")
    return np.array([values.get(name, 0.0) for name in tracks.names])


def given_rates(tracks: Tracks, given: Sequence[str]) -> Float[np.ndarray, " C"]:
    """Frames of each camera to one of the common clock, whose rate is `all`, else that of the tracks' times."""
    import numpy as np

    values = _values(given, "--rate", "cam_2=29.83")
    for name, rate in values.items():
        if rate <= 0:
            raise UsageError(f"--rate {name}={rate:g} cannot be used; a rate is a positive number of frames a second.")
    common = values.pop(ALL, None)
    _check_known(tracks, values, "--rate")
    if not values:
        return np.ones(tracks.cameras)
    common = common or rate_of_times(tracks)
    if common is None:
        raise UsageError(
            f"--rate {next(iter(values))}={next(iter(values.values())):g} says nothing without the rate of the other "
            f"cameras, and the tracks hold no times; give that too: --rate {ALL}=30."
        )
    return np.array([values.get(name, common) / common for name in tracks.names])


def given_readouts(tracks: Tracks, given: Sequence[str]) -> Float[np.ndarray, " C"]:
    """Frames that each camera takes from its first image row to its last; 0 where neither it nor `all` is named."""
    import numpy as np

    values = _values(given, "--readout", "cam_2=0.6")
    for name, frames in values.items():
        if abs(frames) > LONGEST:
            raise UsageError(
                f"--readout {name}={frames:g} cannot be used; from its first row to its last a camera takes at most "
                f"{LONGEST:g} frame. Give frames, not milliseconds: the line delay times the rows times the frame rate."
            )
    common = values.pop(ALL, 0.0)
    _check_known(tracks, values, "--readout")
    return np.array([values.get(name, common) for name in tracks.names])


def with_known_readouts(tracks: Tracks, settings: InputSettings, calibration: Calibration) -> Tracks:
    """The tracks of another recording on one clock, where a calibration knows the readout times of its cameras.

    As they are where the settings give readout times: those were heeded when the tracks were read.
    """
    known = calibration.readout_times
    if known is None or settings.readout:
        return tracks
    import numpy as np

    from jaxpoint.motion import moved_to_clock

    values = dict(zip(calibration.rig.names, known.frames.tolist()))
    readouts = np.array([values.get(name, 0.0) for name in tracks.names])
    return moved_to_clock(tracks, np.zeros(tracks.cameras), usable=_usable(tracks), readouts=readouts)


def rate_of_times(tracks: Tracks) -> float | None:
    """Frames a second, as the times of the tracks have it; None without times."""
    import numpy as np

    if tracks.times is None or tracks.frames < 2:
        return None
    seconds, frames = np.diff(tracks.times), np.diff(tracks.series_ids)
    rate = float(np.median(frames[seconds > 0] / seconds[seconds > 0])) if (seconds > 0).any() else 0.0
    return rate if rate > 0 else None


def _values(given: Sequence[str], flag: str, example: str) -> dict[str, float]:
    """NAME=NUMBER, each name once."""
    values: dict[str, float] = {}
    for text in given:
        name, equals, number = text.rpartition("=")
        value = _number(number)
        if not equals or not name or value is None:
            raise UsageError(
                f"{flag} {text} cannot be read; give a camera's name and a number, as in {flag} {example}."
            )
        if name in values:
            raise UsageError(
                f"{flag} is given twice for '{name}', {values[name]:g} and {value:g} (flags add to the configuration "
                "file); keep one."
            )
        values[name] = value
    return values


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _check_known(tracks: Tracks, names, flag: str) -> None:
    for name in names:
        if name not in tracks.names:
            raise UsageError(f"{flag} names a camera '{name}', but the tracks have {', '.join(tracks.names)}.")
