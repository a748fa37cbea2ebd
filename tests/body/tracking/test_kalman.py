"""Filter and smoother against dense least squares over the whole trajectory, and their covariances by Monte Carlo."""

import numpy as np
import pytest
from scipy.linalg import cholesky
from scipy.stats import chi2

from jaxpoint.body.tracking.kalman import filter_track, smooth_track

ACCELERATION, SPEED = 1.7, 0.8
TRIALS = 400
TIMES = np.cumsum([0.0, 0.04, 0.04, 0.12, 0.04, 0.5, 0.04, 0.04, 0.04, 0.2, 0.08, 0.04])


def motion(seconds):
    """Transition and process covariance of a point of constant velocity under white acceleration, by the textbook."""
    move = np.kron([[1.0, seconds], [0.0, 1.0]], np.eye(3))
    noise = np.kron([[seconds**3 / 3, seconds**2 / 2], [seconds**2 / 2, seconds]], np.eye(3))
    return move, ACCELERATION**2 * noise


def measurements(rng, truth, views=(3, 0, 1, 2, 3)):
    """Points with information of full rank, of rank 2 (one view), and none, in turn."""
    points, informations = [], []
    for frame, place in enumerate(truth):
        rays = rng.normal(size=(views[frame % len(views)], 3))
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        planes = np.eye(3) - rays[:, :, None] * rays[:, None]
        information = (planes / rng.uniform(0.01, 0.05, len(rays))[:, None, None] ** 2).sum(axis=0)
        values, axes = np.linalg.eigh(information)
        spread = np.where(values > 1e-6, 1 / np.sqrt(np.maximum(values, 1e-6)), 0.0)
        points.append(place + axes @ (spread * rng.normal(size=3)))
        informations.append(information)
    return np.array(points), np.array(informations)


def simulated(rng, times=TIMES, **kind):
    state = np.concatenate([rng.uniform(0, 5, 3), SPEED * rng.normal(size=3)])
    states = [state]
    for seconds in np.diff(times):
        move, noise = motion(seconds)
        states.append(move @ states[-1] + cholesky(noise, lower=True) @ rng.normal(size=6))
    states = np.array(states)
    return states, *measurements(rng, states[:, :3], **kind)


def run(times, points, informations):
    filtered = filter_track(times, points, informations, np.float64(ACCELERATION), np.float64(SPEED))
    return filtered, smooth_track(times, filtered)


def dense(times, points, informations):
    """All frames' states at once: the minimum of every term of the posterior, and its whole covariance."""
    frames = len(times)
    normal, right = np.zeros((6 * frames, 6 * frames)), np.zeros(6 * frames)
    normal[3:6, 3:6] += np.eye(3) / SPEED**2
    for frame in range(frames):
        here = slice(6 * frame, 6 * frame + 3)
        normal[here, here] += informations[frame]
        right[here] += informations[frame] @ points[frame]
    for frame, seconds in enumerate(np.diff(times)):
        move, noise = motion(seconds)
        both = slice(6 * frame, 6 * frame + 12)
        rows = np.hstack([-move, np.eye(6)])
        normal[both, both] += rows.T @ np.linalg.solve(noise, rows)
    square = np.linalg.inv(normal)
    return (square @ right).reshape(frames, 6), square


def test_smoother_is_the_dense_least_squares_solution():
    _, points, informations = simulated(np.random.default_rng(0))
    _, smooth = run(TIMES, points, informations)
    mean, square = dense(TIMES, points, informations)
    np.testing.assert_allclose(smooth.mean, mean, atol=1e-8)
    for frame in range(len(TIMES)):
        own = slice(6 * frame, 6 * frame + 6)
        np.testing.assert_allclose(smooth.covariance[frame], square[own, own], rtol=1e-6, atol=1e-10)


def test_filter_is_the_dense_solution_of_the_frames_so_far():
    _, points, informations = simulated(np.random.default_rng(1))
    filtered, _ = run(TIMES, points, informations)
    for frames in (2, 5, 6, len(TIMES)):
        mean, square = dense(TIMES[:frames], points[:frames], informations[:frames])
        np.testing.assert_allclose(filtered.states.mean[frames - 1], mean[-1], atol=1e-8)
        np.testing.assert_allclose(filtered.states.covariance[frames - 1], square[-6:, -6:], rtol=1e-6, atol=1e-10)


def test_a_frame_without_information_changes_nothing_wherever_its_point_is():
    _, points, informations = simulated(np.random.default_rng(2))
    assert not informations[1].any()
    filtered, smooth = run(TIMES, points, informations)
    np.testing.assert_allclose(filtered.states.mean[1], filtered.predicted.mean[1])
    moved = points.copy()
    moved[1] += 100.0
    np.testing.assert_array_equal(run(TIMES, moved, informations)[1].mean, smooth.mean)


def test_filling_up_at_the_end_changes_nothing():
    _, points, informations = simulated(np.random.default_rng(3))
    _, smooth = run(TIMES, points, informations)
    times = np.append(TIMES, [TIMES[-1]] * 3)
    filled = run(times, np.vstack([points, np.zeros((3, 3))]), np.concatenate([informations, np.zeros((3, 3, 3))]))[1]
    np.testing.assert_allclose(filled.mean[: len(TIMES)], smooth.mean, atol=1e-10)
    np.testing.assert_allclose(filled.covariance[: len(TIMES)], smooth.covariance, atol=1e-10)


def test_more_frames_without_measurements_are_the_same_time():
    _, points, informations = simulated(np.random.default_rng(4))
    _, smooth = run(TIMES, points, informations)
    times = np.sort(np.append(TIMES, TIMES[4] + np.array([0.1, 0.2, 0.3])))
    old = np.isin(times, TIMES)
    more_points, more = np.zeros((len(times), 3)), np.zeros((len(times), 3, 3))
    more_points[old], more[old] = points, informations
    finer = run(times, more_points, more)[1]
    np.testing.assert_allclose(finer.mean[old], smooth.mean, atol=1e-8)


@pytest.fixture(scope="module")
def squares():
    """Normalised squared errors of 400 trajectories in every frame, in the mean, with their degrees of freedom."""
    rng = np.random.default_rng(5)
    found = []
    for _ in range(TRIALS):
        truth, points, informations = simulated(rng, views=(2, 3, 2))
        filtered, smooth = run(TIMES, points, informations)
        found.append([normalised(truth, state) for state in (filtered.states, smooth)] + [filtered.distance2])
    return dict(zip(("filter", "smoother", "innovation"), np.mean(found, axis=0)))


def normalised(truth, state):
    error = truth - np.asarray(state.mean)
    return np.einsum("fi,fi->f", error, np.linalg.solve(state.covariance, error[..., None])[..., 0])


@pytest.mark.parametrize(("which", "degrees"), [("filter", 6), ("smoother", 6), ("innovation", 3)])
def test_covariances_are_those_of_the_errors(squares, which, degrees):
    low, high = chi2.ppf([5e-5, 1 - 5e-5], degrees * TRIALS) / TRIALS
    mean = squares[which][1:]  # the first frame has no innovation
    assert ((mean >= low) & (mean <= high)).all(), mean


def test_information_of_a_view_is_that_of_a_point_far_away_along_it():
    """Rank 2 is the limit of a covariance that grows without end along the line of sight."""
    _, points, informations = simulated(np.random.default_rng(6))
    frame = 2
    values = np.linalg.eigvalsh(informations[frame])
    assert values[0] < 1e-9 * values[1]
    axis = np.linalg.eigh(informations[frame])[1][:, 0]
    shifted = points.copy()
    shifted[frame] += 3.0 * axis
    np.testing.assert_allclose(
        run(TIMES, shifted, informations)[1].mean, run(TIMES, points, informations)[1].mean, atol=1e-8
    )
    nearly = informations.copy()
    nearly[frame] = np.linalg.inv(
        np.linalg.inv(informations[frame] + np.outer(axis, axis)) + (1e4**2 - 1) * np.outer(axis, axis)
    )
    np.testing.assert_allclose(run(TIMES, points, nearly)[1].mean, run(TIMES, points, informations)[1].mean, atol=1e-5)
