"""A point of nearly constant velocity: Kalman filter and Rauch-Tung-Striebel smoother as `lax.scan`.

The acceleration is white noise (Bar-Shalom, Li and Kirubarajan 2001, chapter 6.2.2; the smoother: chapter 8.6), so a
second cut into more frames is the same second.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxpoint.compilation import jit


class State(eqx.Module):
    """Where a point is and how it moves: position (m), then velocity (m/s)."""

    mean: Float[Array, "*batch 6"]
    covariance: Float[Array, "*batch 6 6"]


class Innovation(NamedTuple):
    """A measurement against its prediction."""

    difference: Float[Array, "*batch 3"]  # m, measured minus predicted
    covariance: Float[Array, "*batch 3 3"]  # m^2, what it should have
    distance2: Float[Array, "*batch"]  # squared Mahalanobis length: chi-square of 3 degrees of freedom


class Filtered(NamedTuple):
    """What the filter knew at each of F frames."""

    states: State  # from all measurements up to the frame
    predicted: State  # from those before it
    innovations: Innovation  # only meaningful where there is a measurement


def begin(point: Float[Array, "3"], covariance: Float[Array, "3 3"], speed: Float[Array, ""]) -> State:
    """The state after a first measurement; `speed` (m/s) is the standard deviation of each velocity component."""
    nothing = jnp.zeros((3, 3), covariance.dtype)
    square = jnp.block([[covariance, nothing], [nothing, speed**2 * jnp.eye(3, dtype=covariance.dtype)]])
    return State(jnp.concatenate([point, jnp.zeros_like(point)]), square)


def predict(state: State, seconds: Float[Array, ""], acceleration: Float[Array, ""]) -> State:
    """The state so many seconds later; `acceleration` (m/s^2) is the standard deviation of its mean over a second."""
    move = _transition(seconds)
    return State(move @ state.mean, move @ state.covariance @ move.T + _process(seconds, acceleration))


def compare(state: State, point: Float[Array, "3"], covariance: Float[Array, "3 3"]) -> Innovation:
    """A measured point and its covariance (m^2) against a state."""
    difference = point - state.mean[:3]
    total = state.covariance[:3, :3] + covariance
    return Innovation(difference, total, difference @ jnp.linalg.solve(total, difference))


def update(state: State, point: Float[Array, "3"], covariance: Float[Array, "3 3"]) -> State:
    """The state once a point was measured, by Joseph's form: the covariance stays symmetric and positive."""
    innovation = compare(state, point, covariance)
    gain = jnp.linalg.solve(innovation.covariance, state.covariance[:3]).T
    rest = jnp.eye(6, dtype=gain.dtype) - jnp.pad(gain, ((0, 0), (0, 3)))
    square = rest @ state.covariance @ rest.T + gain @ covariance @ gain.T
    return State(state.mean + gain @ innovation.difference, square)


@jit
def filter_track(
    times: Float[Array, " F"],
    points: Float[Array, "F 3"],
    covariances: Float[Array, "F 3 3"],
    valid: Bool[Array, " F"],
    acceleration: Float[Array, ""],
    speed: Float[Array, ""],
) -> Filtered:
    """One track through F frames; it begins with the first frame, which must be measured.

    Args:
        times: s, not decreasing. Frames at the end that only fill up repeat the last.
        points: m; what stands where `valid` is False never matters.
        covariances: of the points, m^2.
        valid: where the point was measured.
        acceleration: m/s^2, as in `predict`.
        speed: m/s, as in `begin`.
    """
    eye = jnp.eye(3, dtype=points.dtype)
    points = jnp.where(valid[:, None], points, 0.0)
    covariances = jnp.where(valid[:, None, None], covariances, eye[None])
    first = begin(points[0], covariances[0], speed)

    def step(state: State, frame: tuple) -> tuple[State, Filtered]:
        seconds, point, covariance, measured = frame
        predicted = predict(state, seconds, acceleration)
        updated = update(predicted, point, covariance)
        state = jax.tree.map(lambda new, old: jnp.where(measured, new, old), updated, predicted)
        return state, Filtered(state, predicted, compare(predicted, point, covariance))

    frames = jnp.diff(times), points[1:], covariances[1:], valid[1:]
    _, later = jax.lax.scan(step, first, frames)
    start = Filtered(first, first, Innovation(jnp.zeros_like(points[0]), covariances[0], jnp.zeros_like(speed)))
    return jax.tree.map(lambda one, others: jnp.concatenate([one[None], others]), start, later)


@jit
def smooth_track(times: Float[Array, " F"], filtered: Filtered) -> State:
    """What all measurements, later ones too, say about each of F frames."""

    def step(later: State, frame: tuple[Array, State, State]) -> tuple[State, State]:
        seconds, now, predicted = frame
        gain = jnp.linalg.solve(predicted.covariance, _transition(seconds) @ now.covariance).T
        mean = now.mean + gain @ (later.mean - predicted.mean)
        square = now.covariance + gain @ (later.covariance - predicted.covariance) @ gain.T
        state = State(mean, 0.5 * (square + square.T))
        return state, state

    states = filtered.states
    last = jax.tree.map(lambda leaf: leaf[-1], states)
    before = jax.tree.map(lambda leaf: leaf[:-1], states)
    ahead = jax.tree.map(lambda leaf: leaf[1:], filtered.predicted)
    _, smooth = jax.lax.scan(step, last, (jnp.diff(times), before, ahead), reverse=True)
    return jax.tree.map(lambda some, one: jnp.concatenate([some, one[None]]), smooth, last)


def _transition(seconds: Float[Array, ""]) -> Float[Array, "6 6"]:
    return jnp.eye(6, dtype=seconds.dtype) + seconds * jnp.eye(6, k=3, dtype=seconds.dtype)


def _process(seconds: Float[Array, ""], acceleration: Float[Array, ""]) -> Float[Array, "6 6"]:
    """What white acceleration adds to the covariance in that time."""
    t = seconds
    blocks = jnp.stack([t**3 / 3, t**2 / 2, t**2 / 2, t]).reshape(2, 2)
    return acceleration**2 * jnp.kron(blocks, jnp.eye(3, dtype=t.dtype))
