"""Derivatives of a refined calibration by what was observed: the implicit function theorem on its optimum.

At the optimum the gradient of the cost is zero, so dy = -H^-1 d(gradient) with the exact Hessian H of half the robust
sum of squares (J^T J alone is wrong where residuals are not zero). Its second-order terms keep the structure: every
residual depends on one camera and one point, so the point blocks stay 3 x 3 and are eliminated as in the solve itself
(Triggs et al. 2000, section 6; Griewank & Walther 2008, chapter 15). Which observations are believed is frozen.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxpoint.calibration.bundle import solved
from jaxpoint.calibration.schur import AbstractModel, Problem, SchurLevenbergMarquardt, Unknowns

NEWTON_STEPS = 4
GAUGE = 1e-11  # eigenvalues of the scaled reduced system below this share of the largest belong to a free gauge


def optimum(solver: SchurLevenbergMarquardt, start: Unknowns, problem: Problem) -> Unknowns:
    """Where `bundle.solve` ends, differentiable in every number of the problem, forwards and backwards.

    Pixels, weights, priors, their means and the loss's scale; not the start, on which an optimum does not depend.
    Pure; for `jit`, `grad` and `jvp`. With a free gauge the derivative is that of least camera step,
    and right for whatever does not depend on the gauge. Meaningful only where the solve has settled: give it a small
    `rtol`.
    """
    return _optimum(problem, solver, jax.lax.stop_gradient(start))


@eqx.filter_custom_jvp
def _optimum(problem: Problem, solver: SchurLevenbergMarquardt, start: Unknowns) -> Unknowns:
    end = solved(solver, start, problem)
    return _exact(solver.model, Unknowns(end.cameras, end.points), problem)


@_optimum.def_jvp
def _optimum_jvp(primals, tangents):
    problem, solver, start = primals
    end = _optimum(problem, solver, start)
    model = solver.model
    moving, still = eqx.partition(problem, eqx.is_inexact_array)
    along = jax.tree.map(_tangent, tangents[0], moving, is_leaf=lambda leaf: leaf is None)

    def gradient(y, moving):
        return _gradient(model, y, eqx.combine(moving, still))

    _, slope = jax.jvp(lambda moving: gradient(end, moving), (moving,), (along,))
    inverse = _inverse(model, end, problem)
    step = jax.lax.custom_linear_solve(
        lambda v: jax.tree.map(jnp.add, jax.jvp(lambda y: gradient(y, moving), (end,), (v,))[1], _rest(v, problem)),
        jax.tree.map(jnp.negative, slope),
        solve=lambda _, right: inverse(right),
        symmetric=True,
    )
    return end, step


def _exact(model: AbstractModel, y: Unknowns, problem: Problem) -> Unknowns:
    """Newton's steps to where the gradient vanishes to rounding: a solve that looks at its cost stops well before."""

    def step(_, y):
        slope = _gradient(model, y, problem)
        move = _inverse(model, y, problem)(slope)
        trial = jax.tree.map(jnp.subtract, y, move)
        flatter = _square(_gradient(model, trial, problem)) < _square(slope)
        return jax.tree.map(lambda new, old: jnp.where(flatter, new, old), trial, y)

    return jax.lax.fori_loop(0, NEWTON_STEPS, step, y)


def _gradient(model: AbstractModel, y: Unknowns, problem: Problem) -> Unknowns:
    return _held(jax.grad(lambda y: half_cost(model, y, problem))(y), problem)


def _square(y: Unknowns) -> Float[Array, ""]:
    return sum(((leaf**2).sum() for leaf in jax.tree.leaves(y)), start=jnp.zeros((), y.cameras.dtype))


def _tangent(tangent, value):
    """A tangent of zeros where equinox says None; None where there is nothing to move."""
    return jnp.zeros_like(value) if tangent is None and value is not None else tangent


def half_cost(model: AbstractModel, y: Unknowns, problem: Problem) -> Float[Array, ""]:
    """Half the robust sum of squares, priors included: what the solve minimises."""
    observed = jax.vmap(lambda *block: _block_cost(model, y.cameras, problem, *block))
    points = observed(y.points, problem.pixels, problem.weights).sum()
    return points + 0.5 * (problem.prior_weight * (y.cameras - problem.prior_mean) ** 2).sum()


def _block_cost(model, cameras, problem: Problem, points, pixels, weights) -> Float[Array, ""]:
    over_points = jax.vmap(_loss, in_axes=(None, None, None, None, -1, -1, -1))
    over_cameras = jax.vmap(over_points, in_axes=(None, 0, 0, None, None, 0, 0))
    return over_cameras(model, cameras, problem.constants, problem.loss_scale, points, pixels, weights).sum()


def _loss(model: AbstractModel, camera, constants, scale, point, pixel, weight) -> Float[Array, ""]:
    """Half the robust cost of one observation; exactly zero, with its derivatives, where it is hidden."""
    alone = jax.tree.map(lambda leaf: leaf[None], constants)
    state = jax.tree.map(lambda leaf: leaf[0], model.state(camera[None], alone))
    pixel = jnp.where(weight > 0, pixel, 0.0)
    square = (model.residual(state, jnp.zeros_like(camera), point, pixel) ** 2).sum()
    return 0.5 * jnp.where(weight > 0, weight * scale**2 * jnp.log1p(square / scale**2), 0.0)


def _held(y: Unknowns, problem: Problem) -> Unknowns:
    """Zero where a parameter is held or a point is not seen."""
    return Unknowns(jnp.where(problem.free, y.cameras, 0.0), jnp.where(_seen(problem)[:, None], y.points, 0.0))


def _rest(y: Unknowns, problem: Problem) -> Unknowns:
    """What `_held` leaves out: the Hessian is the unit matrix there."""
    return jax.tree.map(jnp.subtract, y, _held(y, problem))


def _seen(problem: Problem):
    return (problem.weights > 0).any(axis=1)


class _Blocks(NamedTuple):
    """The exact Hessian: of the cameras (C, p, p), across (NB, B, C, p, 3), inverses of the points' (NB, B, 3, 3)."""

    cameras: Array
    cross: Array
    points: Array


def _inverse(model: AbstractModel, y: Unknowns, problem: Problem):
    """The function H^-1 v, the points eliminated; the pseudo-inverse of the reduced system where a gauge is free."""
    blocks = _hessian(model, y, problem)
    count, size = y.cameras.shape
    carried = jnp.einsum("nbcpi,nbij->nbcpj", blocks.cross, blocks.points)
    reduced = -jnp.einsum("nbcpj,nbdqj->cpdq", carried, blocks.cross)
    each = jnp.arange(count)
    reduced = reduced.at[each, :, each, :].add(blocks.cameras).reshape(count * size, count * size)
    scale = jnp.sqrt(jnp.abs(jnp.diagonal(blocks.cameras, axis1=1, axis2=2)).reshape(-1))
    scale = jnp.where(scale > 0, scale, 1.0)
    values, vectors = jnp.linalg.eigh(reduced / (scale[:, None] * scale[None, :]))
    firm = values > GAUGE * values[-1]
    divided = jnp.where(firm, 1.0 / jnp.where(firm, values, 1.0), 0.0)

    def solve(right: Unknowns) -> Unknowns:
        points = jnp.moveaxis(right.points, 1, 2)  # (NB, B, 3)
        left = right.cameras - jnp.einsum("nbcpj,nbj->cp", carried, points)
        step = vectors @ (divided * (vectors.T @ (left.reshape(-1) / scale))) / scale
        step = step.reshape(count, size)
        points = points - jnp.einsum("nbcpj,cp->nbj", blocks.cross, step)
        return Unknowns(step, jnp.moveaxis(jnp.einsum("nbij,nbj->nbi", blocks.points, points), 2, 1))

    return solve


def _hessian(model: AbstractModel, y: Unknowns, problem: Problem) -> _Blocks:
    size = y.cameras.shape[1]

    def one(camera, constants, point, pixel, weight):
        def value(both):
            return _loss(model, both[:size], constants, problem.loss_scale, both[size:], pixel, weight)

        return jax.hessian(value)(jnp.concatenate([camera, point]))

    over_cameras = jax.vmap(one, in_axes=(0, 0, None, 0, 0))
    over_points = jax.vmap(over_cameras, in_axes=(None, None, -1, -1, -1))

    def add(total, block):
        hessian = over_points(y.cameras, problem.constants, *block)  # (B, C, p + 3, p + 3)
        points = hessian[:, :, size:, size:].sum(axis=1)
        seen = (block[2] > 0).any(axis=0)
        points = jnp.where(seen[:, None, None], points, jnp.eye(3, dtype=points.dtype)[None])
        return total + hessian[:, :, :size, :size].sum(axis=0), (hessian[:, :, :size, size:], jnp.linalg.inv(points))

    start = jnp.zeros((len(y.cameras), size, size), y.cameras.dtype)
    cameras, (cross, points) = jax.lax.scan(add, start, (y.points, problem.pixels, problem.weights))
    unit = jnp.eye(size, dtype=y.cameras.dtype)[None]
    cameras = cameras + problem.prior_weight[:, :, None] * unit
    free = problem.free
    cameras = jnp.where(free[:, :, None] & free[:, None, :], cameras, unit)
    cameras = jnp.where(free[:, :, None] | free[:, None, :] | (unit > 0), cameras, 0.0)
    cameras = jnp.where(free[:, :, None] == free[:, None, :], cameras, 0.0)
    return _Blocks(cameras, jnp.where(free[None, None, :, :, None], cross, 0.0), points)
