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
import functools
import itertools
import re
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax.extend.core import JaxprEqn, Var
from jaxtyping import Array, Bool, Float, Int, PyTree

from jaxpoint.geometry.linalg import (
    Symmetric,
    backward_solve,
    forward_solve,
    root_solve,
    solve_positive,
    symmetric_root,
)


class Unknowns(eqx.Module):
    """What is solved for: p numbers a camera and 3 a point, points in NB blocks of B."""

    cameras: Float[Array, "C p"]
    points: Float[Array, "NB 3 B"]


class Problem(eqx.Module):
    """The data of one adjustment. A weight of 0 hides an observation; hidden values never matter."""

    pixels: Float[Array, "NB C q B"]  # what a model needs of an observation: of most the pixel, q = 2
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

    @property
    def moving(self) -> tuple[int, ...]:
        """The camera parameters that the reduced system knows; the others are held, whatever `Problem.free` says."""
        return tuple(range(self.camera_size))

    @abc.abstractmethod
    def state(self, cameras: Float[Array, "C p"], constants: PyTree[Array]) -> PyTree[Array]:
        """All that a residual needs to know of the cameras, computed once; every leaf has a leading axis C."""

    @abc.abstractmethod
    def residual(
        self, state: PyTree[Array], moved: Float[Array, " p"], point: Float[Array, "3"], pixel: Float[Array, " q"]
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

    def columns(
        self, state: PyTree[Array], point: Float[Array, "3"], pixel: Float[Array, " q"]
    ) -> tuple[tuple, tuple, tuple]:
        """The residual and its derivatives as scalars: r, then r of p for the camera, then r of 3 for the point.

        Scalars, because arrays are only put together once, weighted and in the order that the products want. By
        forward differentiation; a model whose derivatives are worth writing out overrides it.
        """

        def value(both):
            return self.residual(state, both[: self.camera_size], both[self.camera_size :], pixel)

        both = jnp.concatenate([jnp.zeros(self.camera_size, point.dtype), point])
        residual, jacobian = value(both), jax.jacfwd(value)(both)
        rows = [tuple(jacobian[r, i] for i in range(self.camera_size + 3)) for r in range(self.residual_size)]
        return (
            tuple(residual[r] for r in range(self.residual_size)),
            tuple(row[: self.camera_size] for row in rows),
            tuple(row[self.camera_size :] for row in rows),
        )

    def _block_residuals(self, state, points, pixels) -> Float[Array, "C r B"]:
        zero = jnp.zeros(self.camera_size, points.dtype)
        over_points = jax.vmap(self.residual, in_axes=(None, None, -1, -1), out_axes=-1)
        over_cameras = jax.vmap(over_points, in_axes=(0, None, None, 0))
        return over_cameras(state, zero, points, pixels)

    def _block_columns(self, state, points, pixels):
        """`columns` of a block; every scalar becomes (C, B)."""
        over_points = jax.vmap(self.columns, in_axes=(None, -1, -1), out_axes=-1)
        return jax.vmap(over_points, in_axes=(0, None, 0))(state, points, pixels)


def _over_blocks(function, state, points, pixels):
    return jax.lax.map(lambda block: function(state, *block), (points, pixels))


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


class SchurState(eqx.Module):
    """Where the iteration stands."""

    damping: Float[Array, ""]
    cost: Float[Array, ""]
    steps: Int[Array, ""]
    failures: Int[Array, ""]  # trials in a row that did not lower the cost
    careful: Bool[Array, ""]  # some trial did not
    quiet: Bool[Array, ""]  # the last step promised and brought next to nothing
    stuck: Bool[Array, ""]  # damping grew without bound: no step lowers the cost any more
    broken: Bool[Array, ""]  # the cost is not finite, or no step has a finite one


class SchurLevenbergMarquardt(optx.AbstractLeastSquaresSolver):
    """Levenberg-Marquardt with the points eliminated, for `optx.least_squares(solver.model.residuals, solver, ...)`.

    Any other function is refused while the program is traced; `options={"own_residuals": True}` saves that comparison
    (0.06 s a program) for callers who pass the model's residuals by construction.

    Successful where the last step promised and brought next to nothing, or where no step lowers a finite cost any more.
    Otherwise the result says that a step limit was reached, that of the problem or `max_steps`, or that costs are not
    finite. `stats` has the robust `cost`, whether the solve was `settled` (successful), and the last `damping`.

    Damping is scaled by the diagonal (Marquardt): times 0.1 after success until a trial fails, from then on times 1/3;
    times 2, 4, 8, ... after failures in a row. With `project_points` the points are solved anew for every trial of
    the cameras (variable projection; exact where the residual is linear in the point).
    """

    model: AbstractModel
    rtol: float | Array = 1e-8  # of the cost: a step of the cameras that promises less is the end
    atol: float | Array = 1e-14
    xtol: float = 1e-4  # and the largest camera step then, as the change of cost it would make unopposed over the cost
    norm: Callable[[PyTree], Array] = eqx.field(static=True, default=optx.max_norm)
    start_damping: float = 1e-4
    project_points: bool = eqx.field(static=True, default=False)
    axis: str | None = eqx.field(static=True, default=None)  # of the mesh over which blocks are spread (`parallel`)

    MIN_DAMPING: ClassVar[float] = 1e-10  # below it the reduced system of a free gauge is not always positive
    MAX_DAMPING: ClassVar[float] = 1e12

    def init(self, fn, y: Unknowns, args: Problem, options: dict[str, Any], f_struct, aux_struct, tags) -> SchurState:
        """The state before the first step.

        Raises:
            ValueError: `fn` is another function than the residuals of the model.
        """
        if not options.get("own_residuals"):
            _check_function(fn, self.model, y, args)
        dtype = y.cameras.dtype
        return SchurState(
            jnp.asarray(self.start_damping, dtype),
            jnp.asarray(jnp.inf, dtype),
            jnp.asarray(0),
            jnp.asarray(0),
            jnp.asarray(False),
            jnp.asarray(False),
            jnp.asarray(False),
            jnp.asarray(False),
        )

    def step(self, fn, y: Unknowns, args: Problem, options: dict[str, Any], state: SchurState, tags):
        """One trial: kept if it lowers the cost."""
        trial, before, cost, promise, reach = _trial(self.model, y, args, state.damping, self.project_points, self.axis)
        better = cost < before  # False for NaN
        decrease = jnp.where(better, before - cost, 0.0)
        # What single points of a robust problem still gain long after the cameras stand must not hold up the end;
        # a valley of the focal lengths lowers the cost by next to nothing while the cameras still travel.
        small = (promise <= self.rtol * before + self.atol) & (reach <= self.xtol * before + self.atol)
        small = small & (decrease <= jnp.sqrt(self.rtol) * before + self.atol)
        failures = jnp.where(better, 0, state.failures + 1)
        eased = jnp.maximum(state.damping * jnp.where(state.careful, 1.0 / 3.0, 0.1), self.MIN_DAMPING)
        damping = jnp.where(better, eased, state.damping * 2.0**failures)
        stuck = damping > self.MAX_DAMPING
        new_y = jax.tree.map(lambda new, old: jnp.where(better, new, old), trial, y)
        new_state = SchurState(
            damping,
            jnp.where(better, cost, before),
            state.steps + 1,
            failures,
            state.careful | ~better,
            # After a failure the damping is large, and a small step says little.
            better & small & (state.failures == 0),
            stuck,
            ~better & (~jnp.isfinite(before) | (stuck & ~jnp.isfinite(cost))),
        )
        return new_y, new_state, None

    def terminate(self, fn, y, args: Problem, options: dict[str, Any], state: SchurState, tags):
        settled = state.quiet | state.stuck
        limited = ~settled & (state.steps >= args.step_limit)
        result = optx.RESULTS.where(limited, optx.RESULTS.nonlinear_max_steps_reached, optx.RESULTS.successful)
        return settled | limited | state.broken, optx.RESULTS.where(state.broken, optx.RESULTS.nonfinite, result)

    def postprocess(self, fn, y, aux, args: Problem, options, state: SchurState, tags, result):
        settled = result == optx.RESULTS.successful
        return y, aux, {"cost": state.cost, "settled": settled, "damping": state.damping}


def _check_function(fn: Callable, model: AbstractModel, y: Unknowns, problem: Problem) -> None:
    """Refuse a function whose operations are not those of the model's residuals: its optimum would be another."""
    if _operations(fn, y, problem) != _operations(model.residuals, y, problem):
        raise ValueError(
            f"SchurLevenbergMarquardt minimises the residuals of its own model ({type(model).__name__}) and was given "
            "another function; pass `solver.model.residuals`, or take `optimistix.LevenbergMarquardt` for the other."
        )


def _operations(function: Callable, y: Unknowns, problem: Problem) -> str:
    """What a function does with these arguments, operation by operation, without addresses in memory.

    Optimistix wraps every output in a function that does nothing but pass it on; such are left out.
    """
    traced = jax.make_jaxpr(function)(y, problem).jaxpr
    passed = {eqn.outvars[0]: eqn.invars[0] for eqn in traced.eqns if _passes_on(eqn)}
    kept = [eqn for eqn in traced.eqns if not _passes_on(eqn)]
    outputs = [passed.get(out, out) if isinstance(out, Var) else out for out in traced.outvars]
    return re.sub("0x[0-9a-f]+", "", str(traced.replace(eqns=kept, outvars=outputs)))


def _passes_on(equation: JaxprEqn) -> bool:
    inner = equation.params.get("call_jaxpr")
    return inner is not None and not inner.eqns


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


def _trial(model, y: Unknowns, problem: Problem, damping, project_points: bool, axis: str | None = None):
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
