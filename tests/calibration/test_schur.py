"""The structured Levenberg-Marquardt against scipy, optimistix's own, and dense algebra."""

import logging

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from jaxpoint.calibration.bundle import LEAST_SQUARES, CameraModel, to_blocks
from jaxpoint.calibration.recording import Freedom, Recording, RigState, adjust, place_points, project
from jaxpoint.calibration.schur import (
    AbstractModel,
    Problem,
    SchurLevenbergMarquardt,
    Unknowns,
    solve_points,
)
from jaxpoint.config import LensSettings

FRAMES = 20  # that the dense solvers see
LOSS = 2.0  # px


def predicted(cameras, base, points):
    """Pixels (F, C, 2) by the definition of the model, written anew in numpy (docs, "conventions")."""
    turned = Rotation.from_rotvec(cameras[:, :3]).as_matrix() @ base
    local = np.einsum("cij,fj->fci", turned, points) + cameras[:, 3:6]
    x, y = np.moveaxis(local[..., :2] / local[..., 2:], -1, 0)
    log_focal, log_aspect, cx, cy, k1, k2, p1, p2, k3 = cameras[:, 6:].T
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    v = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    focal = np.exp(log_focal)
    return np.stack([focal * np.exp(log_aspect) * u + cx, focal * v + cy], axis=-1)


def cauchy_root(difference, scale):
    """Residuals whose squares sum to scale^2 log(1 + |d|^2 / scale^2), one loss for both coordinates."""
    square = (difference**2).sum(axis=-1)
    return difference * np.sqrt(scale**2 * np.log1p(square / scale**2) / np.maximum(square, 1e-300))[..., None]


@pytest.fixture(scope="module")
def small(noisy):
    """The first frames of the noisy room, with a start that is a few per cent off."""
    kept = noisy.recording.visible & (np.arange(len(noisy.recording.visible)) < FRAMES)[:, None]
    kept &= (kept.sum(axis=1) >= 2)[:, None]
    rng = np.random.default_rng(0)
    cameras = noisy.truth.cameras.copy()
    cameras[:, :3] = rng.normal(0.0, 0.01, (4, 3))
    cameras[:, 3:6] += rng.normal(0.0, 0.05, (4, 3))
    cameras[:, 6] += rng.normal(0.0, 0.03, 4)
    start = RigState(cameras, noisy.truth.base, noisy.truth.points + rng.normal(0.0, 0.05, noisy.truth.points.shape))
    freedom = Freedom.of(noisy.recording, LensSettings(), "radial2")
    return noisy.recording, start, kept, freedom


@pytest.fixture(scope="module")
def solved(small):
    return adjust(*small, loss_scale=LOSS, rtol=1e-10, steps=300)


def test_the_optimum_is_that_of_scipy(small, solved):
    recording, start, kept, freedom = small
    used = np.flatnonzero(kept.any(axis=1))
    pixels, seen = recording.pixels[used], kept[used]
    begin = start.rebased()

    def residuals(numbers):
        cameras = begin.cameras.copy()
        cameras[freedom.free] = numbers[: freedom.free.sum()]
        points = numbers[freedom.free.sum() :].reshape(-1, 3)
        difference = (predicted(cameras, begin.base, points) - pixels)[seen]
        prior = np.sqrt(freedom.prior_weight) * (cameras - freedom.prior_mean)
        return np.concatenate([cauchy_root(difference, LOSS).ravel(), prior.ravel()])

    numbers = np.concatenate([begin.cameras[freedom.free], begin.points[used].ravel()])
    theirs = least_squares(residuals, numbers, x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=200)
    assert solved.settled
    assert solved.cost == pytest.approx(2 * theirs.cost, rel=1e-6)
    ours = np.exp(solved.state.cameras[:, 6])
    np.testing.assert_allclose(ours, np.exp(theirs.x[: freedom.free.sum()].reshape(4, -1)[:, 6]), rtol=1e-4)
    at_ours = residuals(np.concatenate([solved.state.cameras[freedom.free], solved.state.points[used].ravel()]))
    assert (at_ours**2).sum() == pytest.approx(solved.cost, rel=1e-9)


def test_what_is_projected_is_the_definition(noisy):
    pixels, depth = project(noisy.truth)
    seen = noisy.recording.visible
    expected = predicted(noisy.truth.cameras, noisy.truth.base, noisy.truth.points)
    np.testing.assert_allclose(pixels[seen], expected[seen], atol=1e-9)
    local = np.einsum("cij,fj->fci", noisy.truth.base, noisy.truth.points) + noisy.truth.cameras[:, 3:6]
    np.testing.assert_allclose(depth, local[..., 2], atol=1e-12)


def test_hidden_observations_never_matter(small, solved):
    recording, start, kept, freedom = small
    rng = np.random.default_rng(1)
    wild = rng.choice([np.nan, np.inf, -np.inf, 1e30], recording.pixels.shape)
    spoilt = Recording(
        np.where(kept[..., None], recording.pixels, wild), kept, recording.image_sizes, recording.frames, 4,
        recording.pixel_aspects, recording.names,
    )  # fmt: skip
    again = adjust(spoilt, start, kept, freedom, loss_scale=LOSS, rtol=1e-10, steps=300)
    assert again.cost == solved.cost
    np.testing.assert_array_equal(again.state.cameras, solved.state.cameras)


def test_the_order_of_cameras_never_matters(small, solved):
    recording, start, kept, freedom = small
    order = np.array([2, 0, 3, 1])
    turned = Recording(
        recording.pixels[:, order], recording.visible[:, order], recording.image_sizes[order], recording.frames, 4,
        recording.pixel_aspects[order], tuple(recording.names[i] for i in order),
    )  # fmt: skip
    begin = RigState(start.cameras[order], start.base[order], start.points)
    free = Freedom(freedom.free[order], freedom.prior_mean[order], freedom.prior_weight[order])
    again = adjust(turned, begin, kept[:, order], free, loss_scale=LOSS, rtol=1e-10, steps=300)
    assert again.cost == pytest.approx(solved.cost, rel=1e-9)
    np.testing.assert_allclose(np.exp(again.state.cameras[:, 6]), np.exp(solved.state.cameras[order, 6]), rtol=1e-5)


def test_held_parameters_stay(small):
    recording, start, kept, _ = small
    hold = Freedom.of(recording, LensSettings(), "radial2", hold=True)
    end = adjust(recording, start, kept, hold, loss_scale=LOSS)
    np.testing.assert_array_equal(end.state.cameras[:, 6:], start.cameras[:, 6:])
    assert (end.state.cameras[:, :6] != start.rebased().cameras[:, :6]).all()


def test_one_program_serves_recordings_of_many_lengths(noisy, solved, caplog):
    freedom = Freedom.of(noisy.recording, LensSettings(), "brown")
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        for frames in (300, 301, 450):
            index = np.arange(frames) % 300
            recording = Recording.of(noisy.room.tracks.select_frames(index))
            points = np.zeros((len(recording.visible), 3))
            points[:frames] = noisy.room.points[index]
            start = RigState(noisy.truth.cameras, noisy.truth.base, points)
            end = adjust(recording, start, recording.visible, freedom, loss_scale=LOSS, steps=frames // 100)
            assert end.steps == frames // 100
    assert not [record for record in caplog.records if "Compiling" in record.getMessage()]


def dense_problem(frames=8, step_limit=100, scale=LEAST_SQUARES):
    """A problem small enough for any solver: 4 cameras, one block, priors on everything."""
    rng = np.random.default_rng(3)
    base = Rotation.from_euler("y", [[0.0], [0.4], [-0.4], [0.2]]).as_matrix()
    cameras = np.zeros((4, 15))
    cameras[:, 3:6] = [[0, 0, 5], [-0.5, 0.1, 5], [0.5, 0, 5.5], [0, -0.4, 4.5]]
    cameras[:, 6], cameras[:, 8:10] = np.log(800.0), (640.0, 360.0)
    cameras[:, 10] = -0.1
    points = rng.uniform(-1.0, 1.0, (frames, 3))
    pixels = predicted(cameras, base, points) + rng.normal(0.0, 0.5, (frames, 4, 2))
    sigma = [*6 * [0.1], 0.05, 0.01, 10, 10, 0.1, 0.1, 0.01, 0.01, 0.01]  # no gauge is left free
    weight = np.tile(1.0 / np.array(sigma) ** 2, (4, 1))
    problem = Problem(
        jnp.asarray(to_blocks(pixels, frames)),
        jnp.ones((1, 4, frames)),
        jnp.asarray(base),
        jnp.ones((4, 15), bool),
        jnp.asarray(cameras),
        jnp.asarray(weight),
        jnp.asarray(scale),
        jnp.asarray(step_limit),
    )
    begin = points + rng.normal(0.0, 0.02, points.shape)
    return problem, Unknowns(jnp.asarray(cameras), jnp.asarray(to_blocks(begin, frames)))


MODEL = CameraModel()
STRUCTURED = SchurLevenbergMarquardt(MODEL, rtol=1e-12)


@eqx.filter_jit
def run(solver, start, problem, max_steps):
    return optx.least_squares(MODEL.residuals, solver, start, args=problem, max_steps=max_steps, throw=False)


def half_squares(y, problem):
    return 0.5 * sum((part**2).sum() for part in MODEL.residuals(y, problem))


@pytest.mark.parametrize("scale", [LEAST_SQUARES, 1.0])
def test_the_optimum_is_that_of_plain_levenberg_marquardt(scale):
    problem, start = dense_problem(scale=scale)
    ours = run(STRUCTURED, start, problem, 200)
    theirs = run(optx.LevenbergMarquardt(rtol=1e-10, atol=1e-10), start, problem, 300)
    assert ours.result == optx.RESULTS.successful
    np.testing.assert_allclose(ours.stats["cost"], 2 * half_squares(theirs.value, problem), rtol=1e-8)
    np.testing.assert_allclose(ours.stats["cost"], 2 * half_squares(ours.value, problem), rtol=1e-12)
    for a, b in zip(*(MODEL.residuals(solution.value, problem) for solution in (ours, theirs))):
        np.testing.assert_allclose(a, b, atol=1e-3)


def test_the_step_is_that_of_the_dense_normal_equations():
    """One damped step against (J^T J + damping diag) on the whole Jacobian."""
    problem, start = dense_problem()
    damping = 1e-4

    def moved(both):
        cameras = MODEL.retract(start.cameras, problem.constants, both[:60].reshape(4, 15))
        points = start.points + both[60:].reshape(1, 3, -1)
        return jnp.concatenate([part.ravel() for part in MODEL.residuals(Unknowns(cameras, points), problem)])

    zero = jnp.zeros(60 + start.points.size)
    residual, jacobian = np.asarray(moved(zero)), np.asarray(jax.jit(jax.jacfwd(moved))(zero))
    normal = jacobian.T @ jacobian
    step = -np.linalg.solve(normal + damping * np.diag(np.diag(normal)), jacobian.T @ residual)
    end = run(eqx.tree_at(lambda s: s.start_damping, STRUCTURED, damping), start, step_limited(problem, 1), 200)
    expected = MODEL.retract(start.cameras, problem.constants, jnp.asarray(step[:60].reshape(4, 15)))
    np.testing.assert_allclose(end.value.cameras, expected, atol=1e-7)
    # The points go on from there, the cameras standing: each ends at least as well as in the dense step.
    dense = Unknowns(expected, start.points + step[60:].reshape(1, 3, -1))
    ours, theirs = ((MODEL.residuals(y, problem)[0] ** 2).sum(axis=(0, 1, 2)) for y in (end.value, dense))
    assert (ours <= theirs * (1 + 1e-9)).all()
    np.testing.assert_allclose(end.value.points, dense.points, atol=1e-3)


def step_limited(problem, steps):
    return eqx.tree_at(lambda p: p.step_limit, problem, jnp.asarray(steps))


def test_max_steps_and_throw_behave_as_optimistix_says():
    problem, start = dense_problem()
    early = run(STRUCTURED, start, problem, 2)
    assert early.result == optx.RESULTS.nonlinear_max_steps_reached
    assert not early.stats["settled"]
    with pytest.raises(eqx.EquinoxRuntimeError, match="maximum number of"):
        optx.least_squares(MODEL.residuals, STRUCTURED, start, args=problem, max_steps=2, throw=True)
    limited = run(STRUCTURED, start, step_limited(problem, 2), 200)
    assert limited.result == optx.RESULTS.nonlinear_max_steps_reached
    assert limited.stats["num_steps"] == 2
    assert not limited.stats["settled"]
    np.testing.assert_allclose(limited.value.cameras, early.value.cameras)


def test_another_function_than_the_residuals_of_the_model_is_refused():
    problem, start = dense_problem()

    def doubled(y, problem):
        return jax.tree.map(lambda part: 2.0 * part, MODEL.residuals(y, problem))

    for other in (doubled, lambda y, problem: y.cameras - problem.prior_mean):
        with pytest.raises(ValueError, match=r"own model \(CameraModel\) and was given another function; pass"):
            optx.least_squares(other, STRUCTURED, start, args=problem)
    same = optx.least_squares(lambda y, problem: MODEL.residuals(y, problem), STRUCTURED, start, args=problem)
    assert same.result == optx.RESULTS.successful


def test_a_cost_that_is_not_finite_is_no_success():
    """From the start, or for every step: nothing settles, and nothing moves."""
    problem, start = dense_problem()
    wild = eqx.tree_at(lambda p: p.prior_mean, problem, problem.prior_mean.at[0, 6].set(jnp.nan))
    for broken in (wild, eqx.tree_at(lambda p: p.pixels, problem, problem.pixels.at[0, 0, 0, 0].set(jnp.inf))):
        end = run(STRUCTURED, start, broken, 200)
        assert end.result == optx.RESULTS.nonfinite
        assert not end.stats["settled"]
        assert end.stats["num_steps"] == 1
        np.testing.assert_array_equal(end.value.cameras, start.cameras)
    with pytest.raises(eqx.EquinoxRuntimeError, match="Nonfinite"):
        optx.least_squares(MODEL.residuals, STRUCTURED, start, args=wild, throw=True)


def test_points_of_held_cameras_are_those_of_scipy(noisy):
    recording, truth = noisy.recording, noisy.truth
    start = RigState(truth.cameras, truth.base, truth.points + 0.1)
    placed = place_points(recording, start, recording.visible, LOSS)
    frames = np.flatnonzero(recording.visible.sum(axis=1) >= 3)[:20]
    for frame in frames:
        seen = recording.visible[frame]

        def residuals(point, frame=frame, seen=seen):
            difference = predicted(truth.cameras, truth.base, point[None])[0] - recording.pixels[frame]
            return cauchy_root(difference[seen], LOSS).ravel()

        theirs = least_squares(residuals, start.points[frame], xtol=1e-12, ftol=1e-12)
        ours = residuals(placed.points[frame])
        assert (ours**2).sum() <= 2 * theirs.cost * (1 + 1e-4) + 1e-8
    np.testing.assert_array_equal(placed.cameras, truth.cameras)


def test_points_that_nobody_sees_stay_finite():
    problem, start = dense_problem()
    weights = problem.weights.at[0, :, 0].set(0.0).at[0, 1:, 1].set(0.0)  # nobody, and one camera only
    problem = eqx.tree_at(lambda p: p.weights, problem, weights)
    points = jax.jit(lambda y, p: solve_points(MODEL, y, p, 8))(start, problem).points
    assert np.isfinite(points).all()
    np.testing.assert_array_equal(points[0, :, 0], start.points[0, :, 0])
    end = run(STRUCTURED, start, problem, 200)
    assert np.isfinite(end.value.points).all()
    assert np.isfinite(end.value.cameras).all()
    np.testing.assert_array_equal(end.value.points[0, :, 0], start.points[0, :, 0])


@pytest.mark.parametrize("depth", [4.0, 0.2])  # the second is beyond the radius at which the polynomial is held
def test_derivatives_written_out_are_those_of_forward_differentiation(depth):
    rng = np.random.default_rng(6)
    numbers = jnp.asarray(
        np.concatenate([rng.normal(0, 0.3, 2), [depth], [6.7, 0.05, 640, 360], rng.normal(0, 0.1, 5)])
    )
    state = jnp.asarray(Rotation.from_rotvec(rng.normal(size=3)).as_matrix()), numbers
    point, pixel = jnp.asarray(rng.normal(0, 0.1, 3)), jnp.asarray([600.0, 400.0])
    ours, expected = MODEL.columns(state, point, pixel), AbstractModel.columns(MODEL, state, point, pixel)
    for a, b in zip(ours, expected):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9)


def test_parameters_left_out_end_as_those_held():
    problem, start = dense_problem()
    held = (7, 12, 13, 14)
    free = np.ones((4, 15), bool)
    free[:, held] = False
    problem = eqx.tree_at(lambda p: p.free, problem, jnp.asarray(free))
    whole = run(STRUCTURED, start, problem, 200)
    small = run(SchurLevenbergMarquardt(CameraModel(held=held), rtol=1e-12), start, problem, 200)
    np.testing.assert_allclose(small.value.cameras, whole.value.cameras, atol=1e-9)
    np.testing.assert_allclose(small.stats["cost"], whole.stats["cost"], rtol=1e-12)
