"""What one adjustment is: the unknowns, the data, and the model that says what one residual is.

Points pass in NB blocks of B. Where targets of known shape were seen, their poses are unknowns beside the points.
"""

from __future__ import annotations

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PyTree

from jaxpoint.calibration.eliminated import TargetPoses


class Unknowns(eqx.Module):
    """What is solved for: p parameters of a camera, 3 coordinates of a point, and the poses of each target."""

    cameras: Float[Array, "C p"]
    points: Float[Array, "NB 3 B"]
    poses: tuple[Float[Array, "_ 12 _"], ...] = ()  # of each target in blocks of its own, see `eliminated.POSE`


class SeenTarget(eqx.Module):
    """What was seen of one target of K points, in MB blocks of M poses; N = K M, point by point, then pose by pose."""

    shape: Float[Array, "K 3"]
    pixels: Float[Array, "MB C q N"]
    weights: Float[Array, "MB C N"]


class PointPriors(eqx.Module):
    """Where points are known to lie."""

    mean: Float[Array, "NB 3 B"]
    weight: Float[Array, "NB B"]  # 1 / sigma^2 of each coordinate, in px^2 as the residuals; 0 for none


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
    point_priors: PointPriors | None = None
    targets: tuple[SeenTarget, ...] = ()  # those whose poses are unknowns
    owner: Int[Array, "C p"] | None = None  # flat place of the parameter that each one equals; None: all are their own


class AbstractModel(eqx.Module):
    """What one residual is. `p` parameters describe a camera; a residual has `r` entries."""

    @property
    @abc.abstractmethod
    def camera_size(self) -> int:
        """p."""

    @property
    @abc.abstractmethod
    def residual_size(self) -> int:
        """r."""

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
        seen = [(y.points, problem.pixels, problem.weights)]
        for poses, target in zip(y.poses, problem.targets):
            seen.append((jax.vmap(TargetPoses(target.shape).places)(poses), target.pixels, target.weights))
        observed = tuple(self._robust(state, problem.loss_scale, *group) for group in seen)
        prior = jnp.sqrt(problem.prior_weight) * (y.cameras - problem.prior_mean)
        known = problem.point_priors
        more = () if known is None else (jnp.sqrt(known.weight)[:, None] * (y.points - known.mean),)
        return (*observed, prior, *more)

    def _robust(self, state, loss_scale, points, pixels, weights) -> Float[Array, "NB C r B"]:
        raw = _over_blocks(self._block_residuals, state, points, pixels)
        square = (raw**2).sum(axis=2)
        scale2 = loss_scale**2
        loss = scale2 * jnp.log1p(square / scale2)
        safe = jnp.where(square > 0, square, 1.0)
        shrink = weights * jnp.where(square > 0, loss / safe, 1.0)
        root = jnp.where(shrink > 0, jnp.sqrt(jnp.where(shrink > 0, shrink, 1.0)), 0.0)
        return raw * root[:, :, None]

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
