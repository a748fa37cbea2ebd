"""Compile what a calibration will need while it is busy with something else.

Compilation dominates a small problem, and it can use another core: as soon as the shapes are known, the programs of
the later stages are run once on nothing in a background thread. JAX then finds them compiled.
"""

from __future__ import annotations

import threading

import jax
import numpy as np

from jaxpoint.calibration import factorization, hypotheses, outliers
from jaxpoint.calibration.recording import Freedom, Recording, RigState, adjust
from jaxpoint.calibration.twoview import NormalisedTracks
from jaxpoint.camera.lenses import LensChoice
from jaxpoint.camera.parameters import FOCAL, size_of
from jaxpoint.config import LensSettings

_compiled: set[tuple[int | str | bytes, ...]] = set()  # shapes whose programs this process has


class WarmUp:
    """Compilations under way. Wait for them before calling the programs, or they are compiled twice."""

    def __init__(self, recording: Recording, data: NormalisedTracks, choice: LensChoice):
        """Of these lenses."""
        shape = (*recording.visible.shape, choice.model.name, choice.free.tobytes())
        tasks = () if shape in _compiled else (_first_solution, _adjustment)
        _compiled.add(shape)
        self._threads = [
            threading.Thread(target=_run, args=(task, recording, data, choice), daemon=True) for task in tasks
        ]
        for thread in self._threads:
            thread.start()

    def wait(self) -> None:
        """Return when everything is compiled."""
        for thread in self._threads:
            thread.join()


def _run(task, recording, data, choice: LensChoice) -> None:
    with jax.enable_x64(True):
        task(recording, data, choice)


def _first_solution(recording: Recording, data: NormalisedTracks, choice: LensChoice) -> None:
    nothing = np.zeros(data.visible.shape, bool)
    lenses = np.zeros(recording.cameras)
    start = factorization.factorise_tracks(data, lenses, nothing, np.random.default_rng(0))
    factorization.refine(data, start, nothing, 1.0)
    hypotheses.compile_upgrade(recording, data)


def _adjustment(recording: Recording, data: NormalisedTracks, choice: LensChoice) -> None:
    size, lens = len(recording.image_sizes), choice.model
    cameras = np.zeros((size, size_of(lens)))
    cameras[:, FOCAL] = np.log(1000.0)
    state = RigState(cameras, np.tile(np.eye(3), (size, 1, 1)), np.zeros((len(recording.pixels), 3)), lens)
    usual = Freedom.of(recording, LensSettings(), choice)  # of a large rig, what is free is part of the program
    adjust(recording, state, np.zeros(recording.visible.shape, bool), usual, loss_scale=1.0, steps=1)
    outliers.classify_observations(recording, state, 1.0)
