"""Points and poses eliminated from the normal equations, a damped step of all unknowns, and points of fixed cameras.

What is eliminated passes in blocks under `lax.scan` and the whole Jacobian is never stored. Axes of components come
first and the block last, so that every operation vectorises over it. Points of 3 coordinates and poses of 6 go through
the same code: see `eliminated`.
"""

from __future__ import annotations

import functools
import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxpoint.calibration.adjustment import AbstractModel, PointPriors, Problem, Unknowns
from jaxpoint.calibration.eliminated import AbstractEliminated, FreePoints, TargetPoses
from jaxpoint.geometry.linalg import (
    Symmetric,
    backward_solve,
    forward_solve,
    root_solve,
    solve_positive,
    symmetric_root,
    upper_triangle,
)


class _Group(eqx.Module):
    """Unknowns of one kind that are eliminated, and what was seen of them; NB blocks, or one of them."""

    kind: AbstractEliminated
    values: Float[Array, "*NB n B"]
    pixels: Float[Array, "*NB C q N"]
    weights: Float[Array, "*NB C N"]
    priors: PointPriors | None

    def block(self, data: tuple) -> _Group:
        """One block, from what a scan over `over` gives."""
        return _Group(self.kind, *data)

    @property
    def over(self) -> tuple:
        """What a scan over the blocks takes."""
        return self.values, self.pixels, self.weights, self.priors

    def at(self, values: Float[Array, "n B"]) -> _Group:
        """The same observations of other unknowns."""
        return eqx.tree_at(lambda group: group.values, self, values)


def _groups(y: Unknowns, problem: Problem) -> list[_Group]:
    """The points, then each target's poses."""
    groups = [_Group(FreePoints(), y.points, *_mask_hidden(problem.pixels, problem.weights), problem.point_priors)]
    for poses, target in zip(y.poses, problem.targets):
        groups.append(_Group(TargetPoses(target.shape), poses, *_mask_hidden(target.pixels, target.weights), None))
    return groups


def _mask_hidden(pixels: Float[Array, "NB C q N"], weights: Float[Array, "NB C N"]):
    """Pixels and weights; what is hidden may be anything, also infinite, and must not reach a product."""
    return jnp.where(weights[:, :, None] > 0, pixels, 0.0), weights


class _Linear(eqx.Module):
    """A block linearised: robustly weighted residuals and derivatives, one entry a residual; zero where hidden."""

    residual: list[Float[Array, "C N"]]
    for_camera: list[tuple[Float[Array, "C N"], ...]]
    by_step: list[tuple[Float[Array, "C N"], ...]]  # of the eliminated unknowns
    costs: Float[Array, " B"]  # the robust cost of each unknown


class _Eliminated(eqx.Module):
    """What the step of the eliminated unknowns needs of every block; stacked over NB blocks. e = d (d + 1) / 2."""

    cross: Float[Array, "*NB C m d B"]  # times the inverse of the transposed root
    root: Float[Array, "*NB e B"]
    gradient: Float[Array, "*NB d B"]  # times the inverse of the root
    costs: Float[Array, "*NB B"]  # of every unknown, before the step


def _prior_cost(cameras, problem: Problem) -> Float[Array, ""]:
    return (problem.prior_weight * (cameras - problem.prior_mean) ** 2).sum()


def _own_prior(group: _Group) -> tuple[Float[Array, " B"], Float[Array, "3 B"]]:
    """Weights of the priors of points, and how far these are from them."""
    assert group.priors is not None
    return group.priors.weight, group.values - group.priors.mean


def _costs(model, state, loss_scale, group: _Group) -> Float[Array, " B"]:
    """The robust cost of each unknown of a block: sum of w rho(|r|^2) over its observations, and its prior."""
    residual = model._block_residuals(state, group.kind.places(group.values), group.pixels)
    loss = loss_scale**2 * jnp.log1p((residual**2).sum(axis=1) / loss_scale**2)
    costs = group.kind.summed(jnp.where(group.weights > 0, group.weights * loss, 0.0).sum(axis=0))
    return costs if group.priors is None else costs + _prior_costs(group)


def _prior_costs(group: _Group) -> Float[Array, " B"]:
    weight, off = _own_prior(group)
    return weight * (off**2).sum(axis=0)


def _linearise(model, state, loss_scale, group: _Group) -> _Linear:
    places = group.kind.places(group.values)
    residual, for_camera, for_point = model._block_columns(state, places, group.pixels)
    seen = group.weights > 0
    residual = [jnp.where(seen, value, 0.0) for value in residual]
    square = sum(value**2 for value in residual)
    loss = loss_scale**2 * jnp.log1p(square / loss_scale**2)
    # Weighting alone, without the loss's curvature (Triggs et al. 2000, 4.3): with it, points whose loss is concave
    # along a residual were sent far off and steps failed one after the other (measured on real recordings).
    root = jnp.sqrt(group.weights / (1.0 + square / loss_scale**2))
    costs = group.kind.summed((group.weights * loss).sum(axis=0))

    return _Linear(
        [value * root for value in residual],
        [tuple(column * root for column in row) for row in for_camera],
        [group.kind.by_step(group.values, tuple(column * root for column in row)) for row in for_point],
        costs if group.priors is None else costs + _prior_costs(group),
    )


def _own_normal(linear: _Linear, group: _Group, damping) -> tuple[Float[Array, "e B"], Float[Array, "d B"]]:
    """Roots of the damped d x d blocks of a block of unknowns, and their gradients."""
    by_axis = list(zip(*linear.by_step))
    blocks = _own_blocks(by_axis, group)
    more = 1.0 + damping
    pairs = upper_triangle(group.kind.size)
    damped = tuple(block * more if i == j else block for (i, j), block in zip(pairs, blocks))
    return symmetric_root(damped), _own_gradient(by_axis, linear.residual, group)


def _own_gradient(by_axis, residual, group: _Group) -> Float[Array, "d B"]:
    parts = [functools.reduce(jnp.add, [(a * b).sum(axis=0) for a, b in zip(axis, residual)]) for axis in by_axis]
    gradient = jnp.stack([group.kind.summed(part) for part in parts])
    if group.priors is None:
        return gradient
    weight, off = _own_prior(group)
    return gradient + weight[None] * off


def _own_blocks(by_axis, group: _Group) -> Symmetric:
    """J^T J of the unknowns, from their derivatives axis by axis, and the weights of their priors."""
    pairs = upper_triangle(group.kind.size)
    blocks = [
        functools.reduce(jnp.add, [(a * b).sum(axis=0) for a, b in zip(by_axis[i], by_axis[j])]) for i, j in pairs
    ]
    blocks = [group.kind.summed(block) for block in blocks]
    if group.priors is None:
        return tuple(blocks)
    return tuple(block + group.priors.weight if i == j else block for (i, j), block in zip(pairs, blocks))


def _cross(for_camera, linear: _Linear, group: _Group, root) -> Float[Array, "C p n"]:
    """The cross term times the inverse of the transposed root, the axes of the unknowns one after another.

    The root's inverse goes to the small factor of J_c^T (J_x L^-T), not to the large product.
    """
    spread = group.kind.spread(root)[:, None]
    by_axis = zip(*(forward_solve(spread, row) for row in linear.by_step))
    products = ([a * b[:, None] for a, b in zip(for_camera, axis)] for axis in by_axis)
    parts = [group.kind.summed(functools.reduce(jnp.add, product)) for product in products]
    return jnp.concatenate(parts, axis=-1)


def _total(values, axis: str | None):
    """Sums over all devices, where the blocks are spread over some."""
    return values if axis is None else jax.lax.psum(values, axis)


def reduced_system(model, y: Unknowns, problem: Problem, point_damping, axis: str | None = None):
    """Camera blocks (C, m, m), what eliminating the points takes from them (D, D), the gradient left (D,); D = C m.

    Of the m parameters that move, and what the points' own step needs afterwards.
    """
    state = model.state(y.cameras, problem.constants)
    moving = np.array(model.moving)
    cameras, size, dtype = len(y.cameras), len(moving), y.cameras.dtype
    panels = _panels(cameras * size)

    def add(group: _Group, carry, block):
        diagonal, gradient, product = carry
        group = group.block(block)
        linear = _linearise(model, state, problem.loss_scale, group)
        root, pull = _own_normal(linear, group, point_damping)
        for_camera = [jnp.stack([row[i] for i in moving], axis=1) for row in linear.for_camera]
        for own, residual in zip(for_camera, linear.residual):
            diagonal = diagonal + jnp.einsum("cpn,cqn->cpq", own, own)
            gradient = gradient + jnp.einsum("cpn,cn->cp", own, residual)
        cross, pull = _cross(for_camera, linear, group, root), jnp.stack(forward_solve(root, pull))
        left = cross.reshape(cameras * size, -1)
        gradient = gradient - (left @ pull.reshape(-1)).reshape(cameras, size)
        cross = cross.reshape(cameras, size, group.kind.size, -1)
        product = [part + left[rows] @ left[: rows.stop].T for part, rows in zip(product, panels)]
        return (diagonal, gradient, product), _Eliminated(cross, root, pull, linear.costs)

    sums = (
        jnp.zeros((cameras, size, size), dtype),
        jnp.zeros((cameras, size), dtype),
        [jnp.zeros((rows.stop - rows.start, rows.stop), dtype) for rows in panels],
    )
    kept: list[_Eliminated] = []
    for group in _groups(y, problem):
        sums, own = jax.lax.scan(functools.partial(add, group), sums, group.over)
        kept.append(own)
    diagonal, gradient, product = _total(sums, axis)
    product = _mirror(product)
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


def _mirror(panels: list[Float[Array, "n k"]]) -> Float[Array, "D D"]:
    """The whole matrix of which `_panels` were computed."""
    if len(panels) == 1:
        return panels[0]
    size = panels[-1].shape[1]
    lower = jnp.tril(jnp.concatenate([jnp.pad(part, ((0, 0), (0, size - part.shape[1]))) for part in panels]))
    return lower + jnp.tril(lower, -1).T


def _camera_step(
    diagonal, product, gradient, damping, owner: Int[Array, " D"] | None
) -> tuple[Float[Array, "C p"], Float[Array, ""], Float[Array, ""]]:
    """The damped step of the cameras, what it promises to gain, and the change that its parts would make singly.

    Parameters that equal others move with them: their equations are added up, and the step is copied.
    """
    cameras, size, _ = diagonal.shape
    own = jnp.diagonal(diagonal, axis1=1, axis2=2)
    if owner is not None:
        own = jnp.zeros(own.size, own.dtype).at[owner].add(own.reshape(-1)).reshape(own.shape)
        gradient = jnp.zeros_like(gradient).at[owner].add(gradient)
    scale = jnp.where(own > 0, own, 1.0)
    matrix = -product.reshape(cameras, size, cameras, size)
    each = jnp.arange(cameras)
    matrix = matrix.at[each, :, each, :].add(diagonal)
    matrix = matrix.reshape(cameras * size, cameras * size)
    if owner is not None:
        matrix = jnp.zeros_like(matrix).at[owner].add(matrix)
        matrix = jnp.zeros_like(matrix).at[:, owner].add(matrix)
    scale = jnp.sqrt(scale.reshape(-1))
    held = (own <= 0).reshape(-1)
    # In units in which every diagonal entry of the undamped camera block is 1; a held parameter gets a lone 1.
    matrix = matrix / (scale[:, None] * scale[None, :]) + jnp.diag(jnp.where(held, 1.0, damping))
    scaled = -solve_positive(matrix, gradient / scale)
    step = scaled / scale
    promise = -gradient @ step
    step = step if owner is None else step[owner]
    return step.reshape(cameras, size), promise, (scaled**2).sum()


def trial_step(model, y: Unknowns, problem: Problem, damping, project_points: bool, axis: str | None = None):
    """The unknowns after one damped step, the cost before and after, and promise and reach of the camera step.

    Where the whole step would fail, every point whose own cost grew stays where it is: one wild point of a robust
    problem must not hold up the others. (Always done, it would spoil good steps: Ladybug-49 took 183 instead of 27.)
    """
    point_damping = jnp.zeros_like(damping) if project_points else damping
    diagonal, product, gradient, kept = reduced_system(model, y, problem, point_damping, axis)
    step, promise, reach = _camera_step(diagonal, product, gradient, damping, _owner(model, problem))
    whole = jnp.zeros_like(y.cameras).at[:, np.array(model.moving)].set(step)
    moved = model.retract(y.cameras, problem.constants, whole)
    state = model.state(moved, problem.constants)

    def update(group: _Group, total, block):
        data, eliminated = block
        group = group.block(data)
        values = group.values
        if project_points:
            more = [group.kind.moved(values, _own_step(model, state, problem.loss_scale, group, point_damping))]
        else:
            pull = eliminated.gradient + (eliminated.cross * step[:, :, None, None]).sum(axis=(0, 1))
            trial = group.kind.moved(values, -jnp.stack(backward_solve(eliminated.root, pull)))
            more = [trial, *_polish(model, state, problem.loss_scale, group.at(trial))]
        trials = jnp.stack([*more, values])
        costs = jax.vmap(lambda trial: _costs(model, state, problem.loss_scale, group.at(trial)))(trials)
        costs = jnp.where(jnp.isnan(costs), jnp.inf, costs)  # NaN never wins
        choices = [jnp.argmin(costs[:-1], axis=0), jnp.argmin(costs, axis=0)]
        gone, safe = (jnp.take_along_axis(trials, choice[None, None], axis=0)[0] for choice in choices)
        return total + jnp.stack([costs[:-1].min(axis=0).sum(), costs.min(axis=0).sum()]), (gone, safe)

    total, ends = jnp.zeros(2, step.dtype), []
    for group, own in zip(_groups(y, problem), kept):
        total, end = jax.lax.scan(functools.partial(update, group), total, (group.over, own))
        ends.append(end)
    costs, before = _total((total, sum(own.costs.sum() for own in kept)), axis)
    costs, before = costs + _prior_cost(moved, problem), before + _prior_cost(y.cameras, problem)
    fine = costs[0] < before
    points, *poses = (jnp.where(fine, gone, safe) for gone, safe in ends)
    return Unknowns(moved, points, tuple(poses)), before, jnp.where(fine, costs[0], costs[1]), promise, reach


def _owner(model: AbstractModel, problem: Problem) -> Int[Array, " D"] | None:
    """Which of the parameters that move each one equals."""
    if problem.owner is None:
        return None
    moving = np.array(model.moving)
    camera = problem.owner[:, moving] // problem.owner.shape[1]
    return (camera * len(moving) + jnp.arange(len(moving))[None]).reshape(-1)


LEAP = 4.0


def _polish(model, state, loss_scale, group: _Group) -> list[Float[Array, "n B"]]:
    """Unknowns moved once more, the cameras standing: by Newton's step, and by a leap along Gauss-Newton's.

    A point whose views disagree creeps under Gauss-Newton with robust weights, and a few such points would set the
    number of steps of the whole. Newton's step has the loss's curvature, d^2 rho / 2 = w J^T J - 2 (w J^T r)
    (w J^T r)^T / s^2; where that is indefinite it is simply no good, and the leap gains most.
    """
    linear = _linearise(model, state, loss_scale, group)
    by_axis = list(zip(*linear.by_step))
    slope = [functools.reduce(jnp.add, map(jnp.multiply, axis, linear.residual)) for axis in by_axis]
    gradient = _own_gradient(by_axis, linear.residual, group)
    bend = 2.0 / (loss_scale**2 * jnp.where(group.weights > 0, group.weights, 1.0))
    plain = _own_blocks(by_axis, group)
    pairs = upper_triangle(group.kind.size)
    bent = tuple(
        block - group.kind.summed((bend * slope[i] * slope[j]).sum(axis=0)) for (i, j), block in zip(pairs, plain)
    )
    leap, newton = (-jnp.stack(root_solve(symmetric_root(blocks), gradient)) for blocks in (plain, bent))
    return [group.kind.moved(group.values, move) for move in (newton, LEAP * leap)]


def _own_step(model, state, loss_scale, group: _Group, damping) -> Float[Array, "d B"]:
    """One damped Gauss-Newton step of the eliminated unknowns alone."""
    root, gradient = _own_normal(_linearise(model, state, loss_scale, group), group, damping)
    return -jnp.stack(root_solve(root, gradient))


def solve_points(model: AbstractModel, y: Unknowns, problem: Problem, steps: int) -> Unknowns:
    """The best points and poses for cameras that stay as they are: each by itself, with a damping of its own."""
    state = model.state(y.cameras, problem.constants)

    def solve(group: _Group, _, data):
        group = group.block(data)

        def step(carry, _):
            values, damping, cost = carry
            own = group.at(values)
            trial = group.kind.moved(values, _own_step(model, state, problem.loss_scale, own, damping))
            after = _costs(model, state, problem.loss_scale, group.at(trial))
            better = after < cost
            damping = jnp.where(better, damping * 0.1, damping * 10.0)
            return (jnp.where(better[None], trial, values), damping, jnp.where(better, after, cost)), None

        cost = _costs(model, state, problem.loss_scale, group)
        begin = (group.values, jnp.full_like(cost, 1e-4), cost)
        return None, jax.lax.scan(step, begin, None, length=steps)[0][0]

    points, *poses = (
        jax.lax.scan(functools.partial(solve, group), None, group.over)[1] for group in _groups(y, problem)
    )
    return Unknowns(y.cameras, points, tuple(poses))
