"""Derivatives of an optimum against solving again, and what they cost when the second order is left out."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxpoint.calibration.bundle import LEAST_SQUARES, SIZE, BrownModel, to_blocks
from jaxpoint.calibration.implicit import half_cost, optimum
from jaxpoint.calibration.schur import Problem, SchurLevenbergMarquardt, Unknowns

MODEL = BrownModel()
SOLVER = SchurLevenbergMarquardt(MODEL, rtol=1e-16, xtol=1e-12)
FRAMES, CAMERAS, NOISE_PX = 24, 4, 2.0


def problem_of(scale):
    """A few frames with much noise, some hidden; two camera parameters held, one point seen by nobody."""
    rng = np.random.default_rng(3)
    base = Rotation.from_euler("y", [[0.0], [0.5], [-0.5], [0.3]]).as_matrix()
    cameras = np.zeros((CAMERAS, SIZE))
    cameras[:, 3:6] = [[0, 0, 5], [-0.5, 0.1, 5], [0.5, 0, 5.5], [0, -0.4, 4.5]]
    cameras[:, 6], cameras[:, 8:10], cameras[:, 10] = np.log(800.0), (640.0, 360.0), -0.1
    points = rng.uniform(-1.0, 1.0, (FRAMES, 3))
    start = Unknowns(jnp.asarray(cameras), jnp.asarray(to_blocks(points, FRAMES)))
    weights = (rng.random((FRAMES, CAMERAS)) < 0.9).astype(float)
    weights[:, :2] = 1.0
    weights[-1] = 0.0
    sigma = [*6 * [0.05], 0.03, 0.01, 5, 5, 0.05, 0.05, 0.005, 0.005, 0.005]
    free = np.ones((CAMERAS, SIZE), bool)
    free[0, :2] = False
    problem = Problem(
        jnp.zeros((1, CAMERAS, 2, FRAMES)),
        jnp.asarray(to_blocks(weights, FRAMES)),
        jnp.asarray(base),
        jnp.asarray(free),
        jnp.asarray(cameras),
        jnp.asarray(np.tile(1.0 / np.array(sigma) ** 2, (CAMERAS, 1))),
        jnp.asarray(scale),
        jnp.asarray(300),
    )
    exact = MODEL._block_residuals(MODEL.state(start.cameras, problem.constants), start.points[0], problem.pixels[0])
    noise = to_blocks(rng.normal(0.0, NOISE_PX, (FRAMES, CAMERAS, 2)), FRAMES)
    return problem_with(problem, pixels=exact[None] + noise), start


def problem_with(problem, **parts):
    return eqx.tree_at(lambda p: [getattr(p, name) for name in parts], problem, list(parts.values()))


@jax.jit
def told(pixels, mean, scale, problem, start):
    """One number of the answer: a direction between two points, with a focal length."""
    end = optimum(SOLVER, start, problem_with(problem, pixels=pixels, prior_mean=mean, loss_scale=scale))
    arm = end.points[0, :, 1] - end.points[0, :, 0]
    return arm[0] / jnp.linalg.norm(arm) + end.cameras[1, 6]


gradients_of = jax.jit(jax.grad(told, argnums=(0, 1, 2)))


@pytest.mark.parametrize("scale", [LEAST_SQUARES, 3.0])
def test_the_gradient_is_that_of_solving_again(scale):
    problem, start = problem_of(scale)
    arguments = (problem.pixels, problem.prior_mean, problem.loss_scale)
    gradients = gradients_of(*arguments, problem, start)
    rng = np.random.default_rng(5)
    for which, (argument, gradient) in enumerate(zip(arguments[: 3 if scale < 10 else 2], gradients)):
        direction = jnp.asarray(rng.normal(size=argument.shape)) * jnp.where(jnp.abs(argument) > 0, 1.0, 0.0)
        size = 1e-3 / float(jnp.sqrt((direction**2).sum()))
        if which == 1:
            direction = direction * problem.free

        def at(step, which=which, direction=direction):
            moved = [a + step * direction if i == which else a for i, a in enumerate(arguments)]
            return float(told(*moved, problem, start))

        numeric = (at(size) - at(-size)) / (2 * size)
        assert float((gradient * direction).sum()) == pytest.approx(numeric, rel=1e-5, abs=1e-9)
    hidden = np.asarray(problem.weights == 0)
    assert not np.asarray(gradients[0]).transpose(0, 1, 3, 2)[hidden].any()


def test_forward_and_reverse_agree():
    problem, start = problem_of(3.0)
    direction = jnp.asarray(np.random.default_rng(6).normal(size=problem.pixels.shape))
    rest = (problem.prior_mean, problem.loss_scale, problem, start)
    forward = jax.jit(lambda pixels: jax.jvp(lambda p: told(p, *rest), (pixels,), (direction,))[1])(problem.pixels)
    reverse = (gradients_of(problem.pixels, *rest)[0] * direction).sum()
    assert float(forward) == pytest.approx(float(reverse), rel=1e-7)


def test_gauss_newton_alone_would_be_wrong():
    """At 2 px of noise the second-order terms matter: without them the test above would fail."""
    problem, start = problem_of(LEAST_SQUARES)
    end = jax.jit(optimum)(SOLVER, start, problem)
    exact = np.asarray(jax.hessian(lambda p: half_cost(MODEL, Unknowns(end.cameras, p), problem))(end.points))

    def residual(points):
        raw = MODEL._block_residuals(MODEL.state(end.cameras, problem.constants), points[0], problem.pixels[0])
        return (raw * jnp.sqrt(problem.weights[0])[:, None]).ravel()

    jacobian = np.asarray(jax.jacfwd(residual)(end.points)).reshape(-1, 3 * FRAMES)
    gauss_newton = jacobian.T @ jacobian
    assert np.abs(exact.reshape(gauss_newton.shape) - gauss_newton).max() > 1e-4 * np.abs(gauss_newton).max()
