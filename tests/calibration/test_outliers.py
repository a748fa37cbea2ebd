"""Judging observations: the noise level, the agreeing views, and what nobody can decide."""

import numpy as np
import pytest

from jaxpoint.calibration.consensus import consensus
from jaxpoint.calibration.outliers import (
    LEAST_SIGMA_PX,
    classify_observations,
    refine_coarse_to_fine,
    refine_to_convergence,
    robust_cost,
    robust_sigma,
)
from jaxpoint.calibration.recording import Freedom, Recording
from jaxpoint.calibration.result import Verdict
from jaxpoint.config import LensSettings, OutlierSettings

THRESHOLD = 4.0  # px


@pytest.mark.parametrize("views", [2, 3, 6])
def test_robust_sigma_is_unbiased_for_any_number_of_views(views):
    """Monte Carlo: noise less what a point with three coordinates takes away from it."""
    rng = np.random.default_rng(views)
    sigma, frames = 0.7, 20_000
    design = rng.normal(size=(frames, 2 * views, 3))
    noise = rng.normal(0.0, sigma, (frames, 2 * views, 1))
    q, _ = np.linalg.qr(design)
    residual = (noise - q @ (q.transpose(0, 2, 1) @ noise)).reshape(frames, views, 2)
    errors = np.linalg.norm(residual, axis=-1)
    kept = np.ones(errors.shape, bool)
    assert robust_sigma(errors, kept, 0) == pytest.approx(sigma, rel=0.03)
    # A tenth of the frames gone wild moves the median a little and no more.
    errors[: frames // 10] += 50.0
    assert robust_sigma(errors, kept, 0) == pytest.approx(sigma, rel=0.2)


def test_robust_sigma_counts_the_cameras_parameters():
    rng = np.random.default_rng(0)
    errors = np.abs(rng.normal(size=(200, 4)))
    kept = np.ones(errors.shape, bool)
    inflated = robust_sigma(errors, kept, 100) / robust_sigma(errors, kept, 0)
    assert inflated == pytest.approx(np.sqrt(1000 / 900))


def test_robust_sigma_at_the_ends():
    assert robust_sigma(np.zeros((5, 3)), np.ones((5, 3), bool), 0) == LEAST_SIGMA_PX
    assert robust_sigma(np.zeros((5, 3)), np.eye(5, 3, dtype=bool), 0) == np.inf


def clean(noisy):
    """The noisy room's recording with every outlier hidden, and the frames that all four cameras see."""
    visible = noisy.recording.visible.copy()
    visible[:300] &= ~noisy.room.is_outlier
    given = noisy.recording
    recording = Recording(given.pixels.copy(), visible, given.image_sizes, 300, 4, given.pixel_aspects, given.names)
    return recording, np.flatnonzero(visible.sum(axis=1) == 4)


def along_epipolar_line(noisy, frame, camera, other):
    """A pixel of `camera` more than 40 px off that is consistent with what `other` sees."""
    room = noisy.room
    source, point = room.positions[other], room.points[frame]
    right = room.seen(point[None])[0][0, camera]
    for factor in (1.4, 0.7, 2.0, 0.5):
        pixels, inside = room.seen((source + factor * (point - source))[None])
        if inside[0, camera] and np.linalg.norm(pixels[0, camera] - right) > 40:
            return pixels[0, camera]
    return None


@pytest.fixture(scope="module")
def epipolar_outliers(noisy):
    """Outliers along epipolar lines: in the first half of the frames three cameras see the light, then all four."""
    recording, frames = clean(noisy)
    wrong = []
    for number, frame in enumerate(frames):
        pixel = along_epipolar_line(noisy, frame, 0, 1)
        if pixel is not None:
            recording.pixels[frame, 0] = pixel
            recording.visible[frame, 3] = number >= len(frames) // 2
            wrong.append(frame)
    assert len(wrong) > 30
    return recording, np.array(wrong)


def test_an_epipolar_outlier_of_three_views_is_ambiguous(noisy, epipolar_outliers):
    """Two pairs agree firmly on different points, and nobody can say which of them is right."""
    recording, wrong = epipolar_outliers
    found = consensus(recording, noisy.truth, THRESHOLD)
    three = wrong[~recording.visible[wrong, 3]]
    assert found.ambiguous[three].mean() > 0.9
    verdicts = classify_observations(recording, noisy.truth, THRESHOLD).verdicts[three]
    assert (verdicts[found.ambiguous[three]][:, :3] == Verdict.UNDECIDED).all()
    untouched = np.setdiff1d(np.flatnonzero(recording.visible.any(axis=1)), wrong)
    assert not found.ambiguous[untouched].any()


def test_an_epipolar_outlier_of_four_views_is_found(noisy, epipolar_outliers):
    recording, wrong = epipolar_outliers
    four = wrong[recording.visible[wrong, 3]]
    found = consensus(recording, noisy.truth, THRESHOLD)
    np.testing.assert_array_equal(found.agree[four], np.tile([False, True, True, True], (len(four), 1)))
    assert np.linalg.norm(found.points[four] - noisy.truth.points[four], axis=1).max() < 0.1  # m
    verdicts = classify_observations(recording, noisy.truth, THRESHOLD).verdicts[four]
    assert (verdicts[:, 0] == Verdict.REPROJECTION).all()
    assert (verdicts[:, 1:] == Verdict.KEPT).mean() > 0.99


def test_every_verdict_has_its_reason(noisy):
    judged = classify_observations(noisy.recording, noisy.truth, THRESHOLD)
    visible, verdicts = noisy.recording.visible, judged.verdicts
    np.testing.assert_array_equal(verdicts == Verdict.HIDDEN, ~visible)
    np.testing.assert_array_equal(judged.kept, verdicts == Verdict.KEPT)
    lonely = visible & (visible.sum(axis=1) < 2)[:, None]
    assert (verdicts[lonely] == Verdict.FEW_VIEWS).all()
    wrong = np.zeros_like(visible)
    wrong[:300] = noisy.room.is_outlier
    assert not (judged.kept & wrong & (visible.sum(axis=1) >= 3)[:, None]).any()
    good = visible & ~wrong
    sound = good & (good.sum(axis=1) >= 2)[:, None] & ~(wrong & visible).any(axis=1, keepdims=True)
    assert judged.kept[sound].mean() > 0.99
    assert (judged.errors[~visible] == 0).all()


def test_a_point_behind_a_camera_is_called_so(noisy):
    """Camera 0 turned round by 180 degrees about its vertical axis sees everything behind itself."""
    truth = noisy.truth
    turned = truth.base.copy()
    flip = np.diag([-1.0, 1.0, -1.0])
    turned[0] = flip @ turned[0]
    cameras = truth.cameras.copy()
    cameras[0, 3:6] = flip @ cameras[0, 3:6]
    judged = classify_observations(noisy.recording, type(truth)(cameras, turned, truth.points), THRESHOLD)
    seen = noisy.recording.visible[:, 0] & (judged.kept[:, 1:].sum(axis=1) >= 2)
    assert seen.sum() > 50
    assert (judged.verdicts[seen, 0] == Verdict.BEHIND).mean() > 0.95


def test_what_was_rejected_comes_back(noisy):
    """Rounds grow as well as shrink: from a rig that is off, nothing stays out for once having been out."""
    freedom = Freedom.of(noisy.recording, LensSettings(), "radial2")
    off = noisy.truth.cameras.copy()
    off[:, 6] += np.array([0.05, -0.05, 0.03, -0.03])
    off[:, 10] = 0.0
    start = type(noisy.truth)(off, noisy.truth.base, noisy.truth.points)
    at_first = classify_observations(noisy.recording, start, THRESHOLD).kept.sum()
    grown = [refine_coarse_to_fine(noisy.recording, state, freedom) for state in (start, noisy.truth)]
    ends = [refine_to_convergence(noisy.recording, judged, freedom, OutlierSettings()) for judged in grown]
    assert at_first < 0.5 * ends[0].judged.kept.sum()
    np.testing.assert_array_equal(ends[0].judged.kept, ends[1].judged.kept)
    assert ends[0].converged
    assert ends[0].cost == pytest.approx(ends[1].cost, rel=1e-3)
    assert ends[0].sigma_px == pytest.approx(noisy.room.noise_px, rel=0.1)
    # The cost is that of the rig alone, whatever was believed on the way.
    again = robust_cost(noisy.recording, ends[0].judged.state)
    assert again == pytest.approx(ends[0].cost, rel=1e-9)
    # A bound on the rounds is kept and told.
    cut = refine_to_convergence(noisy.recording, grown[0], freedom, OutlierSettings(max_rounds=1))
    assert cut.rounds == 1
    assert not cut.converged
