"""Shared by all tests: where the real recordings lie, and strict JAX settings."""

import ctypes
import gc
import os
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import hypothesis
import jax
import jaxtyping
import numpy as np
import pytest

from jaxpoint.calibration.pairs import pair_table
from jaxpoint.calibration.recording import Freedom, Recording
from jaxpoint.calibration.result import Calibration, Stage, Verdict
from jaxpoint.commands.inputs import user_cache
from jaxpoint.commands.kept_programs import trim_programs
from jaxpoint.compilation import keep_programs
from jaxpoint.config import LensSettings
from jaxpoint.simulate.known import known_in
from jaxpoint.simulate.rooms import random_room

# Compilation takes half the time of a first run. The older emitters are quicker (`jaxpoint.compilation`), and programs
# are kept in the user's cache folder for the next run. With XLA_FLAGS set, to nothing even, programs are compiled as
# users have them. Processes that tests start inherit all of it.
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false")
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    programs = user_cache() / "test-programs"
    with suppress(OSError):  # without a folder that can be written, every run is a first one
        programs.mkdir(parents=True, exist_ok=True)
        trim_programs(programs, time.time())
        os.environ["JAX_COMPILATION_CACHE_DIR"] = str(keep_programs(programs))
        os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
        os.environ["JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"] = "-1"
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
# `HYPOTHESIS_PROFILE=repeatable` draws the same examples every time; without it each run looks for new ones.
hypothesis.settings.register_profile("repeatable", derandomize=True)
hypothesis.settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "default"))


# A compiled program takes some 13 memory maps and 0.25 MB (measured). Linux ends a process that wants more than its
# limit of maps, 65530 by default: one worker of the suite would reach it, with 6 GB.
MAPS = Path("/proc/self/maps")
MAX_MAPS = 8_000


@pytest.fixture(autouse=True)
def _few_programs():
    """Forgets compiled programs after a test where a process holds many, and gives their memory back."""
    yield
    if MAPS.exists() and MAPS.read_bytes().count(b"\n") > MAX_MAPS:
        jax.clear_caches()
        gc.collect()
        getattr(ctypes.CDLL(None), "malloc_trim", int)(0)


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The folder of real recordings, named by the environment variable JAXPOINT_DATA."""
    value = os.environ.get("JAXPOINT_DATA")
    if not value:
        pytest.skip("JAXPOINT_DATA is not set: it names the folder of real recordings.")
    folder = Path(value)
    assert folder.is_dir(), f"JAXPOINT_DATA names {folder}, which is not a folder."
    return folder


@pytest.fixture(scope="session")
def solved_room():
    """A small simulated room with its true calibration, as if solved, and what was measured in it."""
    room = random_room(3, cameras=4, frames=80, layout="around", visibility=0.9, outliers=0.03, noise_px=0.3)
    tracks, rig = room.tracks, room.rig
    point_valid = tracks.visible.sum(axis=1) >= 2
    judged = tracks.visible & point_valid[:, None]
    residuals = np.where(judged[..., None], np.asarray(rig.project(room.points)) - tracks.pixels, 0.0)
    verdicts = np.where(room.is_outlier, Verdict.REPROJECTION, Verdict.KEPT)
    verdicts = np.where(point_valid[:, None], verdicts, Verdict.FEW_VIEWS)
    verdicts = np.where(tracks.visible, verdicts, Verdict.HIDDEN)
    calibration = Calibration(
        rig=rig,
        tracks=tracks,
        points=room.points,
        point_valid=point_valid,
        residuals=residuals,
        verdicts=verdicts,
        sigma_px=0.3,
        converged=True,
        message="the truth of a simulation",
        pairs=pair_table(tracks),
        stages=(Stage("truth", {"cost": 1.0}),),
        seconds={"init": 0.5, "adjust": 1.5, "total": 2.0},
    )
    return known_in(room, 0), calibration


@pytest.fixture(scope="session")
def free_room(solved_room):
    """The same, its calibration saying what was free, as `calibrate` does; the first 40 frames."""
    known, truth = solved_room
    first = slice(0, 40)
    parts = {name: getattr(truth, name)[first] for name in ("points", "point_valid", "residuals", "verdicts")}
    tracks = truth.tracks.select_frames(np.arange(40))
    freedom = Freedom.of(Recording.of(tracks), LensSettings(), "radial2")
    freedom = Freedom(*(part[:4] for part in (freedom.free, freedom.prior_mean, freedom.prior_weight)))
    return known, replace(truth, tracks=tracks, **parts, freedom=freedom, loss_scale=2 * truth.sigma_px)


@pytest.fixture
def any_shape():
    """Lets arguments of wrong shape through to the library's own checks, where annotations are checked in tests."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)
