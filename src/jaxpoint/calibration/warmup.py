"""Compile what a calibration will need while it is busy with something else.

Compilation dominates a small problem, and it can use another core: as soon as the shapes are known, the programs of
the later stages are run once on nothing in a background thread. JAX then finds them compiled.
"""

from __future__ import annotations

import threading

import jax
import numpy as np

from jaxpoint.calibration import factorization, hypotheses, outliers
from jaxpoint.calibration.bundle import FOCAL, SIZE
from jaxpoint.calibration.recording import Freedom, Recording, RigState, adjust
from jaxpoint.calibration.twoview import NormalisedTracks


def warm_up(recording: Recording, data: NormalisedTracks) -> None:
    """Start compiling the programs of the first solution and of the adjustment, in the order of their use."""
    for task in (_first_solution, _adjustment):
        threading.Thread(target=_run, args=(task, recording, data), daemon=True).start()


def _run(task, recording, data) -> None:
    with jax.enable_x64(True):
        task(recording, data)


def _first_solution(recording: Recording, data: NormalisedTracks) -> None:
    nothing = np.zeros(data.visible.shape, bool)
    lenses = np.zeros(recording.cameras)
    start = factorization.factorise(data, lenses, nothing, np.random.default_rng(0))
    factorization.refine(data, start, nothing, 1.0)
    hypotheses.compile_upgrade(recording, data)


def _adjustment(recording: Recording, data: NormalisedTracks) -> None:
    size = len(recording.image_sizes)
    cameras = np.zeros((size, SIZE))
    cameras[:, FOCAL] = np.log(1000.0)
    state = RigState(cameras, np.tile(np.eye(3), (size, 1, 1)), np.zeros((len(recording.pixels), 3)))
    held = Freedom(cameras > np.inf, np.zeros_like(cameras), np.zeros_like(cameras))
    adjust(recording, state, np.zeros(recording.visible.shape, bool), held, loss_scale=1.0, steps=1)
    outliers.judge(recording, state, 1.0)
