"""Levenberg-Marquardt for problems of many points seen by few cameras, as an optimistix solver.

Every residual depends on one camera and one point, so the point part of the normal equations falls into 3 x 3 blocks
that are eliminated (Schur complement; Brown 1958, Triggs et al. 2000): see `elimination`.

A problem is a model (what one residual is) and a `Problem` (the data), passed through `args`:
`optx.least_squares(model.residuals, SchurLevenbergMarquardt(model), y0, args=problem)`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jax.extend.core import JaxprEqn, Var
from jaxtyping import Array, Bool, Float, Int, PyTree

from jaxpoint.calibration.adjustment import AbstractModel, Problem, Unknowns
from jaxpoint.calibration.elimination import reduced_system, solve_points, trial_step

__all__ = ["AbstractModel", "Problem", "SchurLevenbergMarquardt", "Unknowns", "reduced_system", "solve_points"]


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
        trial, before, cost, promise, reach = trial_step(
            self.model, y, args, state.damping, self.project_points, self.axis
        )
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
