"""The points eliminated from the normal equations, one damped step of all unknowns, and points of cameras that stay.

Points pass in blocks under `lax.scan` and the whole Jacobian is never stored. Axes of components come first and the
block of points last, so that every operation vectorises over points.
"""

from __future__ import annotations

import functools
import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxpoint.calibration.adjustment import AbstractModel, Problem, Unknowns
from jaxpoint.geometry.linalg import (
    Symmetric,
    backward_solve,
    forward_solve,
    root_solve,
    solve_positive,
    symmetric_root,
)


class _Linear(eqx.Module):
    """A block linearised: robustly weighted residuals and derivatives, one entry a residual; zero where hidden."""

    residual: list[Float[Array, "C B"]]
    for_camera: list[tuple[Float[Array, "C B"], ...]]
    for_point: list[tuple[Float[Array, "C B"], ...]]
    costs: Float[Array, " B"]  # the robust cost of each point


class _Eliminated(eqx.Module):
    """What the points' step needs of every block, kept from the elimination; stacked over NB blocks."""

    cross: Float[Array, "*NB C m 3 B"]  # times the inverse of the transposed root
    root: Float[Array, "*NB 6 B"]
    gradient: Float[Array, "*NB 3 B"]  # times the inverse of the root
    costs: Float[Array, "*NB B"]  # of every point, before the step


def _prior_cost(cameras, problem: Problem) -> Float[Array, ""]:
    return (problem.prior_weight * (cameras - problem.prior_mean) ** 2).sum()


def _point_costs(model, state, loss_scale, points, pixels, weights) -> Float[Array, " B"]:
    """The robust cost of each point of a block: sum of w rho(|r|^2) over the cameras."""
    return _summed_loss(model._block_residuals(state, points, pixels), loss_scale, weights)


def _summed_loss(residual: Float[Array, "C r B"], loss_scale, weights: Float[Array, "C B"]) -> Float[Array, " B"]:
    loss = loss_scale**2 * jnp.log1p((residual**2).sum(axis=1) / loss_scale**2)
    return jnp.where(weights > 0, weights * loss, 0.0).sum(axis=0)


def _linearise(model, state, loss_scale, points, pixels, weights) -> _Linear:
    residual, for_camera, for_point = model._block_columns(state, points, pixels)
    seen = weights > 0
    residual = [jnp.where(seen, value, 0.0) for value in residual]
    square = sum(value**2 for value in residual)
    loss = loss_scale**2 * jnp.log1p(square / loss_scale**2)
    # Weighting alone, without the loss's curvature (Triggs et al. 2000, 4.3): with it, points whose loss is concave
    # along a residual were sent far off and steps failed one after the other (measured on real recordings).
    root = jnp.sqrt(weights / (1.0 + square / loss_scale**2))

    return _Linear(
        [value * root for value in residual],
        [tuple(column * root for column in row) for row in for_camera],
        [tuple(column * root for column in row) for row in for_point],
        (weights * loss).sum(axis=0),
    )


def _point_normal(linear: _Linear, damping) -> tuple[Float[Array, "6 B"], Float[Array, "3 B"]]:
    """Roots of the damped 3 x 3 blocks of a block of points, and their gradients."""
    by_axis = list(zip(*linear.for_point))
    xx, xy, xz, yy, yz, zz = _point_blocks(by_axis)
    more = 1.0 + damping
    gradient = [
        functools.reduce(jnp.add, [(a * b).sum(axis=0) for a, b in zip(axis, linear.residual)]) for axis in by_axis
    ]
    return symmetric_root((xx * more, xy, xz, yy * more, yz, zz * more)), jnp.stack(gradient)


def _cross(for_camera, for_point, root) -> Float[Array, "C p n"]:
    """The cross term times the inverse of the transposed root, the axes of the points one after another.

    The root's inverse goes to the small factor of J_c^T (J_x L^-T), not to the large product.
    """
    by_axis = zip(*(forward_solve(root[:, None], row) for row in for_point))
    parts = [sum(a * b[:, None] for a, b in zip(for_camera, axis)) for axis in by_axis]
    return jnp.concatenate(parts, axis=-1)


def _observations(problem: Problem) -> tuple[Float[Array, "NB C q B"], Float[Array, "NB C B"]]:
    """Pixels and weights; what is hidden may be anything, also infinite, and must not reach a product."""
    return jnp.where(problem.weights[:, :, None] > 0, problem.pixels, 0.0), problem.weights


def _total(values, axis: str | None):
    """Sums over all devices, where the blocks are spread over some."""
    return values if axis is None else jax.lax.psum(values, axis)


def reduced_system(model, y: Unknowns, problem: Problem, point_damping, axis: str | None = None):
    """Camera blocks (C, m, m), what eliminating the points takes from them (D, D), the gradient left (D,); D = C m.

    Of the m parameters that move, and what the points' own step needs afterwards.
    """
    state = model.state(y.cameras, problem.constants)
    moving = np.array(model.moving)
    cameras, size = len(y.cameras), len(moving)
    panels = _panels(cameras * size)

    def add(carry, block):
        diagonal, gradient, product = carry
        linear = _linearise(model, state, problem.loss_scale, *block)
        root, pull = _point_normal(linear, point_damping)
        for_camera = [jnp.stack([row[i] for i in moving], axis=1) for row in linear.for_camera]
        for own, residual in zip(for_camera, linear.residual):
            diagonal = diagonal + jnp.einsum("cpn,cqn->cpq", own, own)
            gradient = gradient + jnp.einsum("cpn,cn->cp", own, residual)
        cross, pull = _cross(for_camera, linear.for_point, root), jnp.stack(forward_solve(root, pull))
        left = cross.reshape(cameras * size, -1)
        gradient = gradient - (left @ pull.reshape(-1)).reshape(cameras, size)
        cross = cross.reshape(cameras, size, 3, -1)
        product = [part + left[rows] @ left[: rows.stop].T for part, rows in zip(product, panels)]
        return (diagonal, gradient, product), _Eliminated(cross, root, pull, linear.costs)

    dtype = y.cameras.dtype
    start = (
        jnp.zeros((cameras, size, size), dtype),
        jnp.zeros((cameras, size), dtype),
        [jnp.zeros((rows.stop - rows.start, rows.stop), dtype) for rows in panels],
    )
    blocks = (y.points, *_observations(problem))
    sums, kept = jax.lax.scan(add, start, blocks)
    diagonal, gradient, product = _total(sums, axis)
    product = _mirrored(product)
    free = problem.free[:, moving]
    prior = jnp.where(free, problem.prior_weight[:, moving], 0.0)
    diagonal = jnp.where(free[:, :, None] & free[:, None, :], diagonal, 0.0)
    gradient = jnp.where(free, gradient, 0.0) + prior * (y.cameras - problem.prior_mean)[:, moving]
    diagonal = diagonal + prior[:, :, None] * jnp.eye(size, dtype=dtype)[None]
    free = free.reshape(-1)
    product = jnp.where(free[:, None] & free[None, :], product, 0.0)
    return diagonal, product, gradient.reshape(-1), kept


PANELS, LEAST_PANEL = 4, 128  # at most so many, of so many rows at least


def _panels(size: int) -> list[slice]:
    """Rows of a symmetric matrix that are computed together, up to the diagonal; a small one's all at once."""
    count = min(max(size // LEAST_PANEL, 1), PANELS)
    edges = [size * i // count for i in range(count + 1)]
    return [slice(*ends) for ends in itertools.pairwise(edges)]


def _mirrored(panels: list[Float[Array, "n k"]]) -> Float[Array, "D D"]:
    """The whole matrix of which `_panels` were computed."""
    if len(panels) == 1:
        return panels[0]
    size = panels[-1].shape[1]
    lower = jnp.tril(jnp.concatenate([jnp.pad(part, ((0, 0), (0, size - part.shape[1]))) for part in panels]))
    return lower + jnp.tril(lower, -1).T


def _camera_step(
    diagonal, product, gradient, damping
) -> tuple[Float[Array, "C p"], Float[Array, ""], Float[Array, ""]]:
    """The damped step of the cameras, what it promises to gain, and the change that its parts would make singly."""
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
    scaled = -solve_positive(matrix, gradient / scale)
    step = (scaled / scale).reshape(cameras, size)
    return step, -gradient @ step.reshape(-1), (scaled**2).sum()


def trial_step(model, y: Unknowns, problem: Problem, damping, project_points: bool, axis: str | None = None):
    """The unknowns after one damped step, the cost before and after, and promise and reach of the camera step.

    Where the whole step would fail, every point whose own cost grew stays where it is: one wild point of a robust
    problem must not hold up the others. (Always done, it would spoil good steps: Ladybug-49 took 183 instead of 27.)
    """
    point_damping = jnp.zeros_like(damping) if project_points else damping
    diagonal, product, gradient, kept = reduced_system(model, y, problem, point_damping, axis)
    step, promise, reach = _camera_step(diagonal, product, gradient, damping)
    whole = jnp.zeros_like(y.cameras).at[:, np.array(model.moving)].set(step)
    moved = model.retract(y.cameras, problem.constants, whole)
    state = model.state(moved, problem.constants)

    def update(total, block):
        points, pixels, weights, eliminated = block
        if project_points:
            more = [points + _point_step(model, state, problem.loss_scale, points, pixels, weights, point_damping)]
        else:
            pull = eliminated.gradient + (eliminated.cross * step[:, :, None, None]).sum(axis=(0, 1))
            trial = points - jnp.stack(backward_solve(eliminated.root, pull))
            more = [trial, *_polished(model, state, problem.loss_scale, trial, pixels, weights)]
        trials = jnp.stack([*more, points])
        costs = jax.vmap(lambda trial: _point_costs(model, state, problem.loss_scale, trial, pixels, weights))(trials)
        costs = jnp.where(jnp.isnan(costs), jnp.inf, costs)  # NaN never wins
        choices = [jnp.argmin(costs[:-1], axis=0), jnp.argmin(costs, axis=0)]
        gone, safe = (jnp.take_along_axis(trials, choice[None, None], axis=0)[0] for choice in choices)
        return total + jnp.stack([costs[:-1].min(axis=0).sum(), costs.min(axis=0).sum()]), (gone, safe)

    blocks = (y.points, *_observations(problem), kept)
    costs, (gone, safe) = jax.lax.scan(update, jnp.zeros(2, step.dtype), blocks)
    costs, before = _total((costs, kept.costs.sum()), axis)
    costs, before = costs + _prior_cost(moved, problem), before + _prior_cost(y.cameras, problem)
    fine = costs[0] < before
    points = jnp.where(fine, gone, safe)
    return Unknowns(moved, points), before, jnp.where(fine, costs[0], costs[1]), promise, reach


LEAP = 4.0


def _polished(model, state, loss_scale, points, pixels, weights) -> list[Float[Array, "3 B"]]:
    """Points moved once more, the cameras standing: by Newton's step, and by a leap along Gauss-Newton's.

    A point whose views disagree creeps under Gauss-Newton with robust weights, and a few such points would set the
    number of steps of the whole. Newton's step has the loss's curvature, d^2 rho / 2 = w J^T J - 2 (w J^T r)
    (w J^T r)^T / s^2; where that is indefinite it is simply no good, and the leap gains most.
    """
    linear = _linearise(model, state, loss_scale, points, pixels, weights)
    by_axis = list(zip(*linear.for_point))
    slope = [functools.reduce(jnp.add, map(jnp.multiply, axis, linear.residual)) for axis in by_axis]
    gradient = [part.sum(axis=0) for part in slope]
    bend = 2.0 / (loss_scale**2 * jnp.where(weights > 0, weights, 1.0))
    plain = _point_blocks(by_axis)
    bent = tuple(block - (bend * slope[i] * slope[j]).sum(axis=0) for (i, j), block in zip(UPPER, plain))
    leap, newton = (-jnp.stack(root_solve(symmetric_root(blocks), gradient)) for blocks in (plain, bent))
    return [points + newton, points + LEAP * leap]


UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def _point_blocks(by_axis) -> Symmetric:
    """J^T J of the points, from their derivatives axis by axis."""
    return tuple(
        functools.reduce(jnp.add, [(a * b).sum(axis=0) for a, b in zip(by_axis[i], by_axis[j])]) for i, j in UPPER
    )


def _point_step(model, state, loss_scale, points, pixels, weights, damping) -> Float[Array, "3 B"]:
    """One damped Gauss-Newton step of the points alone."""
    linear = _linearise(model, state, loss_scale, points, pixels, weights)
    root, gradient = _point_normal(linear, damping)
    return -jnp.stack(root_solve(root, gradient))


def solve_points(model: AbstractModel, y: Unknowns, problem: Problem, steps: int) -> Float[Array, "NB 3 B"]:
    """The best points for cameras that stay as they are: every point by itself, with a damping of its own."""
    state = model.state(y.cameras, problem.constants)

    def block(_, data):
        start, pixels, weights = data

        def step(carry, _):
            points, damping, cost = carry
            move = _point_step(model, state, problem.loss_scale, points, pixels, weights, damping)
            trial = points + move
            after = _point_costs(model, state, problem.loss_scale, trial, pixels, weights)
            better = after < cost
            damping = jnp.where(better, damping * 0.1, damping * 10.0)
            return (jnp.where(better[None], trial, points), damping, jnp.where(better, after, cost)), None

        cost = _point_costs(model, state, problem.loss_scale, start, pixels, weights)
        begin = (start, jnp.full_like(cost, 1e-4), cost)
        return None, jax.lax.scan(step, begin, None, length=steps)[0][0]

    return jax.lax.scan(block, None, (y.points, *_observations(problem)))[1]
