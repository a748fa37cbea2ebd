"""A calibration of a simulated room, made of the truth: nothing is solved."""

from dataclasses import replace

import numpy as np
import pytest
from lights import Recording, record_light
from scipy.interpolate import CubicSpline

from jaxpoint.calibration.alignment import Alignment
from jaxpoint.calibration.pairs import pair_table
from jaxpoint.calibration.result import Calibration, Stage, Verdict
from jaxpoint.geometry.pose import Similarity
from jaxpoint.report.reading import summarise
from jaxpoint.simulate.rooms import random_room
from jaxpoint.tracks import Tracks


def true_calibration(seed=3, cameras=4, frames=300, names=None) -> Calibration:
    """What a perfect solver would return for a random room with outliers."""
    room = random_room(
        seed, cameras=cameras, frames=frames, layout="around", visibility=0.85, outliers=0.04, noise_px=0.4
    )
    tracks = room.tracks
    if names:
        tracks = Tracks(tracks.pixels, tracks.visible, tracks.image_sizes, tracks.frame_ids, tracks.times, names)
    valid = tracks.visible.sum(axis=1) >= 2
    compared = tracks.visible & valid[:, None]
    residuals = np.where(compared[..., None], np.asarray(room.rig.project(room.points)) - tracks.pixels, 0.0)
    verdicts = np.where(room.is_outlier, Verdict.REPROJECTION, Verdict.KEPT)
    verdicts = np.where(compared, verdicts, np.where(tracks.visible, Verdict.FEW_VIEWS, Verdict.HIDDEN))
    return Calibration(
        rig=room.rig,
        tracks=tracks,
        points=np.where(valid[:, None], room.points, 0.0),
        point_valid=valid,
        residuals=residuals,
        verdicts=verdicts,
        sigma_px=0.4,
        converged=True,
        message="the cost no longer falls",
        pairs=pair_table(tracks),
        stages=(Stage("Pairs", {"inliers": {"a - b": "10 of 12"}}), Stage("Adjustment", {"mean_px": 0.5})),
        seconds={"init": 1.0, "adjust": 2.0, "total": 3.0},
        unit="m",
        alignment=Alignment(
            similarity=Similarity(np.array(2.5), np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([1.0, 2, 3])),
            method="landmarks",
            names=("door", "table", "lamp", "window"),
            residual_mm=np.array([6.0, 8.0, 30.0, 7.0]),
            leave_one_out_mm=(9.0, 11.0, 60.0, None),
            rms_mm=16.3,
            max_mm=30.0,
            handedness_verified=True,
        ),
    )


@pytest.fixture(scope="session")
def calibration() -> Calibration:
    return true_calibration()


@pytest.fixture(scope="session")
def unaligned(calibration) -> Calibration:
    return replace(calibration, alignment=None, unit="arbitrary")


@pytest.fixture(scope="session")
def summary(calibration):
    return summarise(calibration)


def wave(shifts, seed=0, frames=400) -> np.ndarray:
    """The same hand motion seen by unlike cameras, each shown `shift` frames late, with 0.2 px of noise (F, C, 2)."""
    rng = np.random.default_rng(seed)
    path = CubicSpline(np.arange(-20, frames + 20, 9), rng.normal(size=(49, 3)))
    views = rng.normal(size=(len(shifts), 3, 2)) * 150
    pixels = np.stack([path(np.arange(frames) - shift) @ view for shift, view in zip(shifts, views)], axis=1)
    return pixels + rng.normal(0, 0.2, pixels.shape) + 400.0


@pytest.fixture(scope="session")
def waves():
    return wave


@pytest.fixture(scope="session")
def recording(tmp_path_factory) -> Recording:
    """120 frames of a light, four of them spoilt."""
    return record_light(tmp_path_factory.mktemp("spoilt"))
