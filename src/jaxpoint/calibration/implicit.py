"""Derivatives of a refined calibration by what was observed: the implicit function theorem on its optimum.

At the optimum the gradient of the cost is zero, so dy = -H^-1 d(gradient) with the exact Hessian H of half the robust
sum of squares (J^T J alone is wrong where residuals are not zero). Its second-order terms keep the structure: every
residual depends on one camera and one point, so the point blocks stay 3 x 3 and are eliminated as in the solve itself
(Triggs et al. 2000, section 6; Griewank & Walther 2008, chapter 15). Which observations are believed is frozen.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxpoint.calibration.bundle import run_solver
from jaxpoint.calibration.schur import AbstractModel, Problem, SchurLevenbergMarquardt, Unknowns

NEWTON_STEPS = 4
GAUGE = 1e-11  # eigenvalues of the scaled reduced system below this share of the largest belong to a free gauge


def optimum(solver: SchurLevenbergMarquardt, start: Unknowns, problem: Problem) -> Unknowns:
    """Where `bundle.solve` ends, differentiable in every number of the problem, forwards and backwards.

    Pixels, weights, priors, their means and the loss's scale; not the start, on which an optimum does not depend.
    Pure; for `jit`, `grad` and `jvp`. With a free gauge the derivative is that of least camera step,
    and right for whatever does not depend on the gauge. Meaningful only where the solve has settled: give it a small
    `rtol`.

    Raises:
        ValueError: the problem has targets, priors of points or shared lenses, which have no derivatives here.
    """
    if problem.targets or problem.point_priors is not None or problem.owner is not None:
        raise ValueError(
            "Problems with targets, priors of points or shared lenses have no implicit derivatives; leave these out."
        )
    return _optimum(problem, solver, jax.lax.stop_gradient(start))[0]


class _Factors(eqx.Module):
    """The exact Hessian taken apart: what the points' elimination leaves, and the reduced system's eigenvectors."""

    cross: Float[Array, "NB B C p 3"]
    points: Float[Array, "NB B 3 3"]  # inverses of the points' own blocks
    vectors: Float[Array, "D D"]  # of the reduced system, scaled; D = C p
    inverse: Float[Array, " D"]  # of its eigenvalues; 0 where a gauge is free
    scale: Float[Array, " D"]

    def solve(self, right: Unknowns) -> Unknowns:
        """H^-1 right; of the reduced system the pseudo-inverse."""
        pull = jnp.einsum("nbij,njb->nbi", self.points, right.points)
        left = right.cameras - jnp.einsum("nbcpj,nbj->cp", self.cross, pull)
        step = self.vectors @ (self.inverse * (self.vectors.T @ (left.reshape(-1) / self.scale))) / self.scale
        step = step.reshape(right.cameras.shape)
        moved = jnp.einsum("nbcpj,cp->nbj", self.cross, step)
        return Unknowns(step, jnp.moveaxis(pull - jnp.einsum("nbij,nbj->nbi", self.points, moved), 2, 1))


@eqx.filter_custom_jvp
def _optimum(problem: Problem, solver: SchurLevenbergMarquardt, start: Unknowns) -> tuple[Unknowns, _Factors]:
    end = run_solver(solver, start, problem)
    return _exact(solver.model, Unknowns(end.cameras, end.points), problem)


@_optimum.def_jvp
def _optimum_jvp(primals, tangents):
    problem, solver, start = primals
    end, factors = _optimum(problem, solver, start)
    model = solver.model
    moving, still = eqx.partition(problem, eqx.is_inexact_array)
    along = jax.tree.map(_tangent, tangents[0], moving, is_leaf=lambda leaf: leaf is None)

    def gradient(y, moving):
        return _gradient(model, y, eqx.combine(moving, still))

    _, slope = jax.jvp(lambda moving: gradient(end, moving), (moving,), (along,))
    step = jax.lax.custom_linear_solve(
        lambda v: jax.tree.map(jnp.add, jax.jvp(lambda y: gradient(y, moving), (end,), (v,))[1], _rest(v, problem)),
        jax.tree.map(jnp.negative, slope),
        solve=lambda _, right: factors.solve(right),
        symmetric=True,
    )
    # The factors only serve `solve`, of which the derivative is never asked.
    return (end, factors), (step, jax.tree.map(jnp.zeros_like, factors))


def _exact(model: AbstractModel, y: Unknowns, problem: Problem) -> tuple[Unknowns, _Factors]:
    """Newton's steps to where the gradient vanishes to rounding: a solve that looks at its cost stops well before.

    Of all places that it tries, the flattest. The loop holds the Hessian once, and that is most of what is compiled.
    """

    def flattening(carry):
        steps, flatter, *_ = carry
        return flatter & (steps <= NEWTON_STEPS)

    def step(carry):
        steps, _, trial, best, least, kept = carry
        slope, factors = _derivatives(model, trial, problem)
        flatter = _square(slope) < least
        best, least, kept = jax.tree.map(
            lambda new, old: jnp.where(flatter, new, old), (trial, _square(slope), factors), (best, least, kept)
        )
        return steps + 1, flatter, jax.tree.map(jnp.subtract, trial, factors.solve(slope)), best, least, kept

    start = (jnp.asarray(0), jnp.asarray(True), y, y, jnp.asarray(jnp.inf, y.cameras.dtype), _no_factors(y))
    *_, end, _, factors = jax.lax.while_loop(flattening, step, start)
    return end, factors


def _gradient(model: AbstractModel, y: Unknowns, problem: Problem) -> Unknowns:
    return _zero_held(jax.grad(lambda y: half_cost(model, y, problem))(y), problem)


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


def _zero_held(y: Unknowns, problem: Problem) -> Unknowns:
    """Zero where a parameter is held or a point is not seen."""
    return Unknowns(jnp.where(problem.free, y.cameras, 0.0), jnp.where(_seen(problem)[:, None], y.points, 0.0))


def _rest(y: Unknowns, problem: Problem) -> Unknowns:
    """What `_zero_held` leaves out: the Hessian is the unit matrix there."""
    return jax.tree.map(jnp.subtract, y, _zero_held(y, problem))


def _seen(problem: Problem):
    return (problem.weights > 0).any(axis=1)


def _no_factors(y: Unknowns) -> _Factors:
    (count, size), (blocks, _, block) = y.cameras.shape, y.points.shape
    shapes = (blocks, block, count, size, 3), (blocks, block, 3, 3), 2 * (count * size,), (count * size,)
    cross, points, vectors, numbers = (jnp.zeros(shape, y.cameras.dtype) for shape in shapes)
    return _Factors(cross, points, vectors, numbers, numbers)


def _derivatives(model: AbstractModel, y: Unknowns, problem: Problem) -> tuple[Unknowns, _Factors]:
    """The gradient, and the Hessian with its points eliminated, the reduced system by its eigenvalues."""
    size, dtype = y.cameras.shape[1], y.cameras.dtype

    def one(camera, constants, point, pixel, weight):
        def slope(both):
            def loss(x):
                return _loss(model, x[:size], constants, problem.loss_scale, x[size:], pixel, weight)

            found = jax.grad(loss)(both)
            return found, found

        return jax.jacfwd(slope, has_aux=True)(jnp.concatenate([camera, point]))

    over_cameras = jax.vmap(one, in_axes=(0, 0, None, 0, 0))
    over_points = jax.vmap(over_cameras, in_axes=(None, None, -1, -1, -1))

    def add(total, block):
        hessian, slope = over_points(y.cameras, problem.constants, *block)  # (B, C, p + 3, p + 3), (B, C, p + 3)
        seen = (block[2] > 0).any(axis=0)
        points = jnp.where(seen[:, None, None], hessian[:, :, size:, size:].sum(axis=1), jnp.eye(3, dtype=dtype)[None])
        cross, inverse = hessian[:, :, :size, size:], jnp.linalg.inv(points)
        cross = jnp.where(problem.free[None, :, :, None], cross, 0.0)
        taken = jnp.einsum("bcpi,bij,bdqj->cpdq", cross, inverse, cross)
        new = hessian[:, :, :size, :size].sum(axis=0), taken, slope[:, :, :size].sum(axis=0)
        return jax.tree.map(jnp.add, total, new), (slope[:, :, size:].sum(axis=1).T, cross, inverse)

    count = len(y.cameras)
    start = tuple(jnp.zeros(shape, dtype) for shape in ((count, size, size), 2 * (count, size), (count, size)))
    sums, (by_points, cross, points) = jax.lax.scan(add, start, (y.points, problem.pixels, problem.weights))
    own, taken, by_cameras = sums
    by_cameras = by_cameras + problem.prior_weight * (y.cameras - problem.prior_mean)
    slope = _zero_held(Unknowns(by_cameras, by_points), problem)
    return slope, _Factors(cross, points, *_eigenvalues(_own_blocks(own, problem), taken))


def _own_blocks(own: Float[Array, "C p p"], problem: Problem) -> Float[Array, "C p p"]:
    """The cameras' blocks with their priors; a held parameter has a lone 1."""
    unit = jnp.eye(own.shape[1], dtype=own.dtype)[None]
    both = problem.free[:, :, None] & problem.free[:, None, :]
    return jnp.where(
        both, own + problem.prior_weight[:, :, None] * unit, jnp.where(problem.free[:, :, None], 0.0, unit)
    )


def _eigenvalues(
    own: Float[Array, "C p p"], taken: Float[Array, "C p C p"]
) -> tuple[Float[Array, "D D"], Float[Array, " D"], Float[Array, " D"]]:
    """Eigenvectors of the reduced system in units in which the own blocks' diagonals are 1, inverses, and the units."""
    count, size, _ = own.shape
    each = jnp.arange(count)
    reduced = (-taken).at[each, :, each, :].add(own).reshape(count * size, count * size)
    scale = jnp.sqrt(jnp.abs(jnp.diagonal(own, axis1=1, axis2=2)).reshape(-1))
    scale = jnp.where(scale > 0, scale, 1.0)
    values, vectors = jnp.linalg.eigh(reduced / (scale[:, None] * scale[None, :]))
    firm = values > GAUGE * values[-1]
    return vectors, jnp.where(firm, 1.0 / jnp.where(firm, values, 1.0), 0.0), scale
