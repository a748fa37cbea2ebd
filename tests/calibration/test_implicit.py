"""Derivatives of an optimum against solving again, what they cost when the second order is left out, and batches."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from scipy.spatial.transform import Rotation

from jaxpoint.calibration.bundle import LEAST_SQUARES, CameraModel, to_blocks
from jaxpoint.calibration.implicit import optimum
from jaxpoint.calibration.schur import Problem, SchurLevenbergMarquardt, Unknowns
from jaxpoint.camera.brown import Brown
from jaxpoint.camera.parameters import size_of
from jaxpoint.compilation import jit_once

MODEL = CameraModel()
SOLVER = SchurLevenbergMarquardt(MODEL, rtol=1e-16, xtol=1e-12)
NOISE_PX = 2.0
blocks_of_residuals = jax.vmap(MODEL._block_residuals, in_axes=(None, 0, 0))
FIELDS = ("pixels", "weights", "prior_mean", "prior_weight", "loss_scale")


def problem_of(scale, *, cameras=4, frames=40, block=20, seed=3):
    """Few frames with much noise, some hidden; two camera parameters held, one point seen by nobody."""
    rng = np.random.default_rng(seed)
    base = Rotation.from_euler("y", np.linspace(-0.5, 0.5, cameras)[:, None]).as_matrix()
    numbers = np.zeros((cameras, size_of(Brown)))
    numbers[:, 3:6] = rng.uniform([-0.5, -0.5, 4.5], [0.5, 0.5, 5.5], (cameras, 3))
    numbers[:, 6], numbers[:, 8:10], numbers[:, 10] = np.log(800.0), (640.0, 360.0), -0.1
    points = rng.uniform(-1.0, 1.0, (frames, 3))
    start = Unknowns(jnp.asarray(numbers), jnp.asarray(to_blocks(points, block)))
    weights = np.where(rng.random((frames, cameras)) < 0.9, rng.uniform(0.5, 1.5, (frames, cameras)), 0.0)
    weights[:, :2] = 1.0
    weights[-1] = 0.0
    sigma = [*6 * [0.05], 0.03, 0.01, 5, 5, 0.05, 0.05, 0.005, 0.005, 0.005]
    free = np.ones((cameras, size_of(Brown)), bool)
    free[0, :2] = False
    state = MODEL.state(start.cameras, jnp.asarray(base))
    noise = rng.normal(0.0, NOISE_PX, (frames, cameras, 2))
    nowhere = jnp.zeros((len(start.points), cameras, 2, block))
    problem = Problem(
        blocks_of_residuals(state, start.points, nowhere) + to_blocks(noise, block),
        jnp.asarray(to_blocks(weights, block)),
        jnp.asarray(base),
        jnp.asarray(free),
        jnp.asarray(numbers),
        jnp.asarray(np.tile(1.0 / np.array(sigma) ** 2, (cameras, 1))),
        jnp.asarray(scale, jnp.float64),
        jnp.asarray(300),
    )
    return problem, start


def number(end):
    """One number of the answer: a direction between two points, with a focal length."""
    arm = end.points[0, :, 1] - end.points[0, :, 0]
    return arm[0] / jnp.linalg.norm(arm) + end.cameras[1, 6]


def value_and_gradient(problem, start):
    return eqx.filter_value_and_grad(lambda problem: number(optimum(SOLVER, start, problem)))(problem)


both = jit_once(value_and_gradient)
together = jit_once(jax.vmap(value_and_gradient))


def moved(problem, name, by):
    return eqx.tree_at(lambda p: getattr(p, name), problem, getattr(problem, name) + by)


def direction_of(problem, name, rng):
    """Where it may go, a thousandth of a pixel or of itself: hidden pixels and held parameters stay."""
    value = np.asarray(getattr(problem, name))
    direction = rng.normal(size=value.shape)
    if name == "pixels":
        direction = direction * (problem.weights > 0)[:, :, None]
    else:
        direction = direction * (problem.free if name == "prior_mean" else value)
    return 1e-3 * direction / np.sqrt((direction**2).sum()) * (np.abs(value).max() if name == "prior_weight" else 1.0)


def differences(problem, start, names, rng):
    """The derivative along a random direction of some parts, and by solving again on either side."""
    directions = {name: direction_of(problem, name, rng) for name in names}
    gradient = both(problem, start)[1]
    along = sum(float((getattr(gradient, name) * direction).sum()) for name, direction in directions.items())

    def at(sign):
        there = problem
        for name, direction in directions.items():
            there = moved(there, name, sign * direction)
        return float(both(there, start)[0])

    return along, (at(1.0) - at(-1.0)) / 2


@pytest.mark.parametrize("name", FIELDS)
@pytest.mark.parametrize("scale", [LEAST_SQUARES, 3.0])
def test_the_gradient_is_that_of_solving_again(scale, name):
    problem, start = problem_of(scale)
    along, numeric = differences(problem, start, [name], np.random.default_rng(5))
    if name == "loss_scale" and scale == LEAST_SQUARES:
        assert abs(along) < 1e-12  # least squares know no scale
    else:
        assert along == pytest.approx(numeric, rel=1e-5)


def test_the_gradient_of_a_whole_room():
    """6 cameras, 500 points, 4 blocks of them."""
    problem, start = problem_of(4.0, cameras=6, frames=500, block=125)
    along, numeric = differences(problem, start, ["pixels", "prior_mean"], np.random.default_rng(7))
    assert along == pytest.approx(numeric, rel=1e-5)


def test_what_is_hidden_or_held_has_no_influence():
    problem, start = problem_of(3.0)
    gradient = both(problem, start)[1]
    hidden = np.asarray(problem.weights == 0)
    assert not np.asarray(gradient.pixels).transpose(0, 1, 3, 2)[hidden].any()
    assert not np.asarray(gradient.prior_mean)[~np.asarray(problem.free)].any()
    wild = eqx.tree_at(lambda p: p.pixels, problem, jnp.where(hidden[:, :, None], jnp.nan, problem.pixels))
    np.testing.assert_array_equal(both(wild, start)[1].pixels, gradient.pixels)


def test_recordings_of_one_shape_in_one_batch():
    problems, starts = zip(*(problem_of(3.0, seed=seed) for seed in range(3)))
    values, gradients = together(*(jax.tree.map(lambda *leaves: jnp.stack(leaves), *all) for all in (problems, starts)))
    for i, (problem, start) in enumerate(zip(problems, starts)):
        value, gradient = both(problem, start)
        assert float(values[i]) == pytest.approx(float(value), rel=1e-9)
        for name in FIELDS:
            alone = np.asarray(getattr(gradient, name))
            np.testing.assert_allclose(getattr(gradients, name)[i], alone, rtol=1e-6, atol=1e-6 * np.abs(alone).max())


def test_gauss_newton_alone_would_be_wrong():
    """A dense Hessian moves the whole answer as forward and reverse derivatives do; J^T J alone misses by far."""
    problem, start = problem_of(LEAST_SQUARES)
    direction = jnp.asarray(direction_of(problem, "pixels", np.random.default_rng(5)))
    seen = (problem.weights > 0)[:, :, None]

    def residuals(y, by):
        raw = blocks_of_residuals(MODEL.state(y.cameras, problem.constants), y.points, problem.pixels + by)
        raw = jnp.where(seen, raw * jnp.sqrt(problem.weights)[:, :, None], 0.0)
        return jnp.append(raw, jnp.sqrt(problem.prior_weight) * (y.cameras - problem.prior_mean))

    @jit_once
    def moving(by):
        still = jnp.zeros_like(by)
        end, step = jax.jvp(lambda by: optimum(SOLVER, start, moved(problem, "pixels", by)), (still,), (by,))
        flat, back = ravel_pytree(end)
        jacobian = jax.jacfwd(lambda y: residuals(back(y), still))(flat)

        def slope(y, by):
            value, pull = jax.vjp(lambda y: residuals(back(y), by), y)
            return pull(value)[0]

        exact = jax.jacfwd(lambda y: slope(y, still))(flat)
        change = jax.jvp(lambda by: slope(flat, by), (still,), (by,))[1]
        return end, step, change, exact, jacobian.T @ jacobian

    end, step, change, exact, gauss_newton = moving(direction)
    points_seen = jnp.broadcast_to(seen.any(axis=1), start.points.shape)
    free = np.asarray(ravel_pytree(Unknowns(problem.free.astype(float), points_seen.astype(float)))[0]).astype(bool)

    def by_dense(hessian):
        return -np.linalg.solve(np.asarray(hessian)[np.ix_(free, free)], np.asarray(change)[free])

    forward = np.asarray(ravel_pytree(step)[0])
    assert not forward[~free].any()
    np.testing.assert_allclose(forward[free], by_dense(exact), rtol=1e-6, atol=1e-8 * np.abs(forward).max())
    off = np.abs(forward[free] - by_dense(gauss_newton)) / np.abs(forward[free])
    assert np.median(off) > 1e-3
    reverse = float((both(problem, start)[1].pixels * direction).sum())
    assert float(jax.jvp(number, (end,), (step,))[1]) == pytest.approx(reverse, rel=1e-7)
