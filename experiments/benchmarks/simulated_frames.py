"""How long does a simulated camera frame take, from people's corners to the compressed image?

Frames of 1280 x 720 of a session, on one thread, by wall clock and by the processor time of the process; on a machine
with other work the second says more, and is still too high. What cameras share (the people's surface, and their light)
is counted apart. "Moving" are frames in which the arm goes up, "held" those in which it points, "nobody" those of the
empty room.

    python experiments/benchmarks/simulated_frames.py
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import cv2
import numpy as np
import tyro

from jaxpoint.commands.console import table
from jaxpoint.config.people import PeopleSettings
from jaxpoint.config.simulation import SimulationSettings
from jaxpoint.simulate.simulated_session import SimulatedSession, simulate_session


@dataclass(frozen=True)
class SimulatedFrames:
    """What is timed."""

    seed: int = 0
    gestures: int = 4


def main(settings: SimulatedFrames) -> None:
    """Print the table."""
    cv2.setNumThreads(1)
    simulation = SimulationSettings(people=PeopleSettings(play="gestures", gestures=settings.gestures, people=2))
    (session,), wall, cpu = _timed([lambda: simulate_session(simulation, settings.seed)])
    rows = [("whole session, once (s)", 1, f"{wall[0]:.1f}", f"{cpu[0]:.1f}")]
    for name, moments in _moments(session).items():
        frames, shared = [], []
        for moment in moments:
            shared.append(_timed([partial(session.at, session.time_of(moment))])[1:])
            cameras = range(len(session.viewpoints))
            frames.append(_timed([partial(session.frame, moment, camera) for camera in cameras])[1:])
        rows.append((f"{name}: a camera's frame (ms)", len(moments) * len(session.viewpoints), *_medians(frames)))
        rows.append((f"{name}: shared by the cameras (ms)", len(moments), *_medians(shared)))
    sys.stdout.write("\n".join(table(("", "n", "wall, median", "processor, median"), rows)) + "\n")


def _moments(session: SimulatedSession) -> dict[str, list[int]]:
    moving, held = [], []
    for gesture in session.gestures:
        moving.append(session.frame_at((gesture.first_s + gesture.hold_first_s) / 2))
        held.append(session.frame_at((gesture.hold_first_s + gesture.hold_last_s) / 2))
    return {"held": held, "moving": moving, "nobody": [0, 1]}


def _timed(work: list[Callable[[], Any]]) -> tuple[list[Any], list[float], list[float]]:
    """Results, and seconds by wall clock and by processor time."""
    results, wall, cpu = [], [], []
    for step in work:
        started, spent = time.perf_counter(), time.process_time()
        results.append(step())
        wall.append(time.perf_counter() - started)
        cpu.append(time.process_time() - spent)
    return results, wall, cpu


def _medians(timings: list[list[list[float]]]) -> tuple[str, str]:
    wall, cpu = (np.median(np.concatenate([np.asarray(part[i]) for part in timings])) for i in range(2))
    return f"{1e3 * wall:.0f}", f"{1e3 * cpu:.0f}"


if __name__ == "__main__":
    main(tyro.cli(SimulatedFrames))
