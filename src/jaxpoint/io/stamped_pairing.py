"""Which frames of several cameras belong together, as a recorder's `timestamps.csv` says."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxpoint.errors import InsufficientDataError
from jaxpoint.io.frames import FrameSource
from jaxpoint.io.pairing import Pairing
from jaxpoint.io.timestamps import Timestamps


def pair_by_timestamps(stamps: Timestamps, sources: Sequence[FrameSource]) -> Pairing:
    """The moments of the timestamps; images beyond the end of a video are absent.

    Args:
        stamps: of these cameras, in their order (`Timestamps.select`).
        sources: the recording of each camera.

    Raises:
        InsufficientDataError: the timestamps speak of no frame that is there.
    """
    index = stamps.frame_index.copy()
    notes = []
    for camera, (name, source) in enumerate(zip(stamps.cameras, sources)):
        beyond = index[:, camera] >= len(source)
        if beyond.any():
            notes.append(f"Camera '{name}' stops early, with no image in {beyond.sum()} of {len(index)} frames.")
            index[beyond, camera] = -1
        dropped = int((stamps.frame_index[:, camera] < 0).sum())
        if dropped:
            notes.append(f"Camera '{name}' has no image in {dropped} of {len(index)} frames.")
    if not (index >= 0).any():
        raise InsufficientDataError("The timestamps speak of 0 frames that are there; use those of this recording.")
    return Pairing(stamps.sync_indices, index, stamps.times, "timestamps.csv", (*notes, *_drifts(stamps)))


def _drifts(stamps: Timestamps) -> list[str]:
    """Cameras whose clock leaves the others' by more than half a frame over the recording."""
    times = np.where(stamps.present, stamps.frame_time, np.nan)
    common = np.nanmedian(times, axis=1)
    period = float(np.median(np.diff(common))) if len(common) > 1 else 0.0
    notes = []
    for camera, name in enumerate(stamps.cameras):
        off = times[:, camera] - common
        held = np.isfinite(off)
        if held.sum() < 10:
            continue
        rate = np.polyfit(common[held], off[held], 1)[0]
        drift = rate * (common[-1] - common[0])
        if abs(drift) > period / 2:
            notes.append(f"The clock of camera '{name}' drifts by {1e3 * drift:+.0f} ms over the recording.")
    return notes
