"""Levenberg-Marquardt for problems of many points seen by few cameras, as an optimistix solver.

Every residual depends on one camera and one point, so the point part of the normal equations falls into 3 x 3 blocks
that are eliminated (Schur complement; Brown 1958, Triggs et al. 2000). Points pass in blocks under `lax.scan` and the
whole Jacobian is never stored. Axes of components come first and the block of points last, so that every operation
vectorises over points.

A problem is a model (what one residual is) and a `Problem` (the data), passed through `args`:
`optx.least_squares(model.residuals, SchurLevenbergMarquardt(model), y0, args=problem)`.
"""

from __future__ import annotations

import abc
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int, PyTree


class Unknowns(eqx.Module):
    """What is solved for: p numbers a camera and 3 a point, points in NB blocks of B."""

    cameras: Float[Array, "C p"]
    points: Float[Array, "NB 3 B"]


class Problem(eqx.Module):
    """The data of one adjustment. A weight of 0 hides an observation; hidden values never matter."""

    pixels: Float[Array, "NB C 2 B"]
    weights: Float[Array, "NB C B"]
    constants: PyTree[Array]  # of the cameras, whatever the model needs; leading axis C
    free: Bool[Array, "C p"]  # camera parameters that may move
    prior_mean: Float[Array, "C p"]
    prior_weight: Float[Array, "C p"]  # 1 / sigma^2; 0 for none
    loss_scale: Float[Array, ""]  # Cauchy scale in units of the residual; a huge one gives least squares
    step_limit: Int[Array, ""]  # stop after this many steps, without recompiling


class AbstractModel(eqx.Module):
    """What one residual is. `p` numbers describe a camera, `r` a residual."""

    camera_size: eqx.AbstractClassVar[int]
    residual_size: eqx.AbstractClassVar[int]

    @abc.abstractmethod
    def state(self, cameras: Float[Array, "C p"], constants: PyTree[Array]) -> PyTree[Array]:
        """All that a residual needs to know of the cameras, computed once; every leaf has a leading axis C."""

    @abc.abstractmethod
    def residual(
        self, state: PyTree[Array], moved: Float[Array, " p"], point: Float[Array, "3"], pixel: Float[Array, "2"]
    ) -> Float[Array, " r"]:
        """The residual of one camera and point, the camera `moved` by a small step from its state."""

    @abc.abstractmethod
    def retract(
        self, cameras: Float[Array, "C p"], constants: PyTree[Array], step: Float[Array, "C p"]
    ) -> Float[Array, "C p"]:
        """The cameras after a step."""

    def residuals(self, y: Unknowns, problem: Problem) -> PyTree[Array]:
        """Robust residuals whose sum of squares is the robust cost, then those of the priors."""
        state = self.state(y.cameras, problem.constants)
        raw = _over_blocks(self._block_residuals, state, y.points, problem.pixels)
        square = (raw**2).sum(axis=2)
        scale2 = problem.loss_scale**2
        loss = scale2 * jnp.log1p(square / scale2)
        safe = jnp.where(square > 0, square, 1.0)
        shrink = jnp.sqrt(problem.weights * jnp.where(square > 0, loss / safe, 1.0))
        prior = jnp.sqrt(problem.prior_weight) * (y.cameras - problem.prior_mean)
        return raw * shrink[:, :, None], prior

    def _block_residuals(self, state, points, pixels) -> Float[Array, "C r B"]:
        zero = jnp.zeros(self.camera_size, points.dtype)
        over_points = jax.vmap(self.residual, in_axes=(None, None, -1, -1), out_axes=-1)
        over_cameras = jax.vmap(over_points, in_axes=(0, None, None, 0))
        return over_cameras(state, zero, points, pixels)

    def _block_jacobians(self, state, points, pixels):
        """Residuals (C, r, B) and Jacobians for cameras (C, r, p, B) and points (C, r, 3, B)."""

        def single(state, point, pixel):
            zero = jnp.zeros(self.camera_size, point.dtype)

            def value(both):
                return self.residual(state, both[: self.camera_size], both[self.camera_size :], pixel)

            both = jnp.concatenate([zero, point])
            return value(both), jax.jacfwd(value)(both)

        over_points = jax.vmap(single, in_axes=(None, -1, -1), out_axes=-1)
        residual, jacobian = jax.vmap(over_points, in_axes=(0, None, 0))(state, points, pixels)
        return residual, jacobian[:, :, : self.camera_size], jacobian[:, :, self.camera_size :]

    def _block_point_jacobians(self, state, points, pixels):
        """Residuals (C, r, B) and their Jacobians for the points alone (C, r, 3, B)."""
        zero = jnp.zeros(self.camera_size, points.dtype)

        def single(state, point, pixel):
            def value(point):
                return self.residual(state, zero, point, pixel)

            return value(point), jax.jacfwd(value)(point)

        over_points = jax.vmap(single, in_axes=(None, -1, -1), out_axes=-1)
        return jax.vmap(over_points, in_axes=(0, None, 0))(state, points, pixels)


def _over_blocks(function, state, points, pixels):
    return jax.lax.map(lambda block: function(state, *block), (points, pixels))


class _Eliminated(eqx.Module):
    """What back-substitution needs of every block, kept from the elimination; stacked over NB blocks."""

    cross: Float[Array, "*NB C p 3 B"]
    inverse: Float[Array, "*NB 3 3 B"]
    gradient: Float[Array, "*NB 3 B"]
    costs: Float[Array, "*NB B"]  # of every point, before the step


class _Normal(eqx.Module):
    """The normal equations of one block of points."""

    cameras: Float[Array, "C p p"]
    camera_gradient: Float[Array, "C p"]
    cross: Float[Array, "C p 3 B"]
    points: Float[Array, "3 3 B"]
    point_gradient: Float[Array, "3 B"]
    costs: Float[Array, " B"]  # the robust cost of each point


class SchurState(eqx.Module):
    """Where the iteration stands."""

    damping: Float[Array, ""]
    cost: Float[Array, ""]
    steps: Int[Array, ""]
    quiet: Int[Array, ""]  # successive accepted steps that hardly lowered the cost
    stuck: Bool[Array, ""]  # damping grew without bound: no step lowers the cost any more


class SchurLevenbergMarquardt(optx.AbstractLeastSquaresSolver):
    """Levenberg-Marquardt with the points eliminated.

    Damping is scaled by the diagonal (Marquardt), times 0.1 after success and times 4 after failure. With
    `project_points` the points are solved anew for every trial of the cameras (variable projection; exact where the
    residual is linear in the point).
    """

    model: AbstractModel
    rtol: float | Array = 1e-8  # relative decrease of the cost below which a step is quiet; two such are the end
    atol: float | Array = 1e-14
    xtol: float = 1e-4  # and the largest camera step then, as the change of cost it would make unopposed over the cost
    norm: Callable[[PyTree], Array] = optx.max_norm
    start_damping: float = 1e-4
    project_points: bool = eqx.field(static=True, default=False)

    MAX_DAMPING: ClassVar[float] = 1e12

    def init(self, fn, y: Unknowns, args: Problem, options: dict[str, Any], f_struct, aux_struct, tags) -> SchurState:
        """The state before the first step."""
        dtype = y.cameras.dtype
        return SchurState(
            jnp.asarray(self.start_damping, dtype),
            jnp.asarray(jnp.inf, dtype),
            jnp.asarray(0),
            jnp.asarray(0),
            jnp.asarray(False),
        )

    def step(self, fn, y: Unknowns, args: Problem, options: dict[str, Any], state: SchurState, tags):
        """One trial: kept if it lowers the cost."""
        trial, before, cost, reach = _trial(self.model, y, args, state.damping, self.project_points)
        better = cost < before  # False for NaN
        decrease = jnp.where(better, before - cost, 0.0)
        # A valley of the focal lengths lowers the cost by next to nothing while the cameras still travel.
        small = (decrease <= self.rtol * before + self.atol) & (reach <= self.xtol * before + self.atol)
        damping = jnp.where(better, jnp.maximum(state.damping * 0.1, 1e-12), state.damping * 4.0)
        new_y = jax.tree.map(lambda new, old: jnp.where(better, new, old), trial, y)
        new_state = SchurState(
            damping,
            jnp.where(better, cost, before),
            state.steps + 1,
            jnp.where(better, jnp.where(small, state.quiet + 1, 0), state.quiet),
            damping > self.MAX_DAMPING,
        )
        return new_y, new_state, None

    def terminate(self, fn, y, args: Problem, options: dict[str, Any], state: SchurState, tags):
        done = (state.quiet >= 2) | state.stuck | (state.steps >= args.step_limit)
        return done, optx.RESULTS.successful

    def postprocess(self, fn, y, aux, args: Problem, options, state: SchurState, tags, result):
        settled = (state.quiet >= 2) | state.stuck
        return y, aux, {"cost": state.cost, "settled": settled, "damping": state.damping}


def _prior_cost(cameras, problem: Problem) -> Float[Array, ""]:
    return (problem.prior_weight * (cameras - problem.prior_mean) ** 2).sum()


def _point_costs(model, state, loss_scale, points, pixels, weights) -> Float[Array, " B"]:
    """The robust cost of each point of a block: sum of w rho(|r|^2) over the cameras."""
    return _summed_loss(model._block_residuals(state, points, pixels), loss_scale, weights)


def _summed_loss(residual: Float[Array, "C r B"], loss_scale, weights: Float[Array, "C B"]) -> Float[Array, " B"]:
    loss = loss_scale**2 * jnp.log1p((residual**2).sum(axis=1) / loss_scale**2)
    return jnp.where(weights > 0, weights * loss, 0.0).sum(axis=0)


def _normal(model, state, free, loss_scale, points, pixels, weights) -> _Normal:
    residual, for_camera, for_point = model._block_jacobians(state, points, pixels)
    costs = _summed_loss(residual, loss_scale, weights)
    # A hidden observation may be anything, also infinite: it must not reach a product.
    seen = (weights > 0)[:, None]
    residual = jnp.where(seen, residual, 0.0)
    # Weighting alone, without the loss's curvature (Triggs et al. 2000, 4.3): with it, points whose loss is concave
    # along a residual were sent far off and steps failed one after the other (measured on real recordings).
    root = jnp.sqrt(weights / (1.0 + (residual**2).sum(axis=1) / loss_scale**2))[:, None]
    for_camera = jnp.where(seen[:, :, None] & free[:, None, :, None], for_camera, 0.0) * root[:, :, None]
    for_point = jnp.where(seen[:, :, None], for_point, 0.0) * root[:, :, None]
    residual = residual * root
    cameras = for_camera.shape[0]
    flat = jnp.moveaxis(for_camera, 2, 1).reshape(cameras, model.camera_size, -1)
    return _Normal(
        cameras=jnp.einsum("cpn,cqn->cpq", flat, flat),
        camera_gradient=jnp.einsum("cpn,cn->cp", flat, residual.reshape(cameras, -1)),
        cross=(for_camera[:, :, :, None] * for_point[:, :, None]).sum(axis=1),
        points=(for_point[:, :, :, None] * for_point[:, :, None]).sum(axis=(0, 1)),
        point_gradient=(for_point * residual[:, :, None]).sum(axis=(0, 1)),
        costs=costs,
    )


def inverse_3x3(matrix: Float[Array, "3 3 B"]) -> Float[Array, "3 3 B"]:
    """Inverse of symmetric 3 x 3 matrices by cofactors; the identity where a point is not seen at all."""
    trace = matrix[0, 0] + matrix[1, 1] + matrix[2, 2]
    seen = trace > 0
    scale = jnp.where(seen, trace, 1.0)
    a, b, c = matrix[0, 0] / scale, matrix[0, 1] / scale, matrix[0, 2] / scale
    d, e, f = matrix[1, 1] / scale, matrix[1, 2] / scale, matrix[2, 2] / scale
    one = jnp.where(seen, 1e-15, 1.0)  # keeps points that one camera alone sees away from 0 / 0
    a, d, f = a + one, d + one, f + one
    aa, bb, cc = d * f - e * e, c * e - b * f, b * e - c * d
    dd, ee, ff = a * f - c * c, b * c - a * e, a * d - b * b
    factor = 1.0 / ((a * aa + b * bb + c * cc) * scale)
    return jnp.stack([jnp.stack([aa, bb, cc]), jnp.stack([bb, dd, ee]), jnp.stack([cc, ee, ff])]) * factor[None, None]


def _damped(points: Float[Array, "3 3 B"], damping) -> Float[Array, "3 3 B"]:
    return points * (1.0 + damping * jnp.eye(3, dtype=points.dtype)[:, :, None])


def _reduced(model, y: Unknowns, problem: Problem, point_damping):
    """Camera blocks (C, p, p), what eliminating the points takes from them (D, D), the gradient left (D,); D = C p.

    And what the points' own step needs afterwards.
    """
    state = model.state(y.cameras, problem.constants)
    cameras, size = y.cameras.shape

    def add(carry, block):
        diagonal, gradient, product, moved = carry
        normal = _normal(model, state, problem.free, problem.loss_scale, *block)
        inverse = inverse_3x3(_damped(normal.points, point_damping))
        solved = (normal.cross[:, :, :, None] * inverse[None, None]).sum(axis=2)
        left = solved.reshape(cameras * size, -1)
        product = product + left @ normal.cross.reshape(cameras * size, -1).T
        moved = moved + left @ normal.point_gradient.reshape(-1)
        kept = _Eliminated(normal.cross, inverse, normal.point_gradient, normal.costs)
        return (diagonal + normal.cameras, gradient + normal.camera_gradient, product, moved), kept

    dtype, total = y.cameras.dtype, cameras * size
    start = (
        jnp.zeros((cameras, size, size), dtype),
        jnp.zeros((cameras, size), dtype),
        jnp.zeros((total, total), dtype),
        jnp.zeros(total, dtype),
    )
    blocks = (y.points, problem.pixels, problem.weights)
    (diagonal, gradient, product, moved), kept = jax.lax.scan(add, start, blocks)
    prior = jnp.where(problem.free, problem.prior_weight, 0.0)
    gradient = gradient + prior * (y.cameras - problem.prior_mean)
    diagonal = diagonal + prior[:, :, None] * jnp.eye(size, dtype=dtype)[None]
    return diagonal, product, gradient.reshape(-1) - moved, kept


def _camera_step(diagonal, product, gradient, damping) -> tuple[Float[Array, "C p"], Float[Array, ""]]:
    """The damped step of the cameras, and the change of cost that its parts would make one by one."""
    cameras, size, _ = diagonal.shape
    own = jnp.diagonal(diagonal, axis1=1, axis2=2)
    scale = jnp.where(own > 0, own, 1.0)
    matrix = -product.reshape(cameras, size, cameras, size)
    each = jnp.arange(cameras)
    matrix = matrix.at[each, :, each, :].add(diagonal)
    matrix = matrix.reshape(cameras * size, cameras * size)
    scale = jnp.sqrt(scale.reshape(-1))
    held = (own <= 0).reshape(-1)
    # In units in which every diagonal entry of the undamped camera block is 1; a held parameter gets a lone 1.
    matrix = matrix / (scale[:, None] * scale[None, :]) + jnp.diag(jnp.where(held, 1.0, damping))
    factor = jax.scipy.linalg.cho_factor(matrix)
    scaled = -jax.scipy.linalg.cho_solve(factor, gradient / scale)
    return (scaled / scale).reshape(cameras, size), (scaled**2).sum()


def _trial(model, y: Unknowns, problem: Problem, damping, project_points: bool):
    """The unknowns after one damped step, the cost before and after, and the reach of the camera step.

    Every point whose own cost would grow stays where it is: one wild point of a robust problem must not make the
    whole step fail.
    """
    point_damping = jnp.zeros_like(damping) if project_points else damping
    diagonal, product, gradient, kept = _reduced(model, y, problem, point_damping)
    step, reach = _camera_step(diagonal, product, gradient, damping)
    moved = model.retract(y.cameras, problem.constants, step)
    state = model.state(moved, problem.constants)

    def update(total, block):
        points, pixels, weights, eliminated = block
        if project_points:
            trial = points + _point_step(model, state, problem.loss_scale, points, pixels, weights, point_damping)
        else:
            pull = eliminated.gradient + (eliminated.cross * step[:, :, None, None]).sum(axis=(0, 1))
            trial = points - (eliminated.inverse * pull[None]).sum(axis=1)
        both = jnp.concatenate([points, trial], axis=1)
        seen, twice = jnp.concatenate([pixels, pixels], axis=2), jnp.concatenate([weights, weights], axis=1)
        stay, go = jnp.split(_point_costs(model, state, problem.loss_scale, both, seen, twice), 2)
        better = go < stay
        return total + jnp.where(better, go, stay).sum(), jnp.where(better[None], trial, points)

    blocks = (y.points, problem.pixels, problem.weights, kept)
    cost, points = jax.lax.scan(update, _prior_cost(moved, problem), blocks)
    before = _prior_cost(y.cameras, problem) + kept.costs.sum()
    return Unknowns(moved, points), before, cost, reach


def _point_step(model, state, loss_scale, points, pixels, weights, damping) -> Float[Array, "3 B"]:
    """One damped Gauss-Newton step of the points alone."""
    residual, jacobian = model._block_point_jacobians(state, points, pixels)
    weight = weights / (1.0 + (residual**2).sum(axis=1) / loss_scale**2)
    root = jnp.where(weights > 0, jnp.sqrt(weight), 0.0)[:, None]
    seen = (weights > 0)[:, None]
    residual = jnp.where(seen, residual, 0.0) * root
    jacobian = jnp.where(seen[:, :, None], jacobian, 0.0) * root[:, :, None]
    normal = (jacobian[:, :, :, None] * jacobian[:, :, None]).sum(axis=(0, 1))
    gradient = (jacobian * residual[:, :, None]).sum(axis=(0, 1))
    return -(inverse_3x3(_damped(normal, damping)) * gradient[None]).sum(axis=1)


def solve_points(model: AbstractModel, y: Unknowns, problem: Problem, steps: int) -> Float[Array, "NB 3 B"]:
    """The best points for cameras that stay as they are: every point by itself, with a damping of its own."""
    state = model.state(y.cameras, problem.constants)

    def block(_, data):
        start, pixels, weights = data

        def step(carry, _):
            points, damping, cost = carry
            move = _point_step(model, state, problem.loss_scale, points, pixels, weights, damping[None, None])
            trial = points + move
            after = _point_costs(model, state, problem.loss_scale, trial, pixels, weights)
            better = after < cost
            damping = jnp.where(better, damping * 0.1, damping * 10.0)
            return (jnp.where(better[None], trial, points), damping, jnp.where(better, after, cost)), None

        cost = _point_costs(model, state, problem.loss_scale, start, pixels, weights)
        begin = (start, jnp.full_like(cost, 1e-4), cost)
        return None, jax.lax.scan(step, begin, None, length=steps)[0][0]

    return jax.lax.scan(block, None, (y.points, problem.pixels, problem.weights))[1]
