"""A point of nearly constant velocity: Kalman filter and Rauch-Tung-Striebel smoother as `lax.scan`.

The acceleration is white noise (Bar-Shalom, Li and Kirubarajan 2001, chapter 6.2.2; the smoother: chapter 8.6), so a
second cut into more frames is the same second.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxpoint.compilation import jit
from jaxpoint.geometry.arrays import AnyArray


class State(eqx.Module):
    """Where a point is and how it moves: position (m), then velocity (m/s)."""

    mean: Float[AnyArray, "*batch 6"]
    covariance: Float[AnyArray, "*batch 6 6"]


class Filtered(NamedTuple):
    """What the filter knew at each of F frames."""

    states: State  # from all measurements up to the frame
    predicted: State  # from those before it
    distance2: Float[Array, " F"]  # of each measurement from its prediction, see `distance2`


def begin(point: Float[Array, "3"], information: Float[Array, "3 3"], speed: Float[Array, ""]) -> State:
    """The state after a first measurement, of two views at least; `speed` (m/s) is the sd of a velocity component."""
    nothing, eye = jnp.zeros_like(information), jnp.eye(3, dtype=information.dtype)
    square = jnp.block([[jnp.linalg.inv(information), nothing], [nothing, speed**2 * eye]])
    return State(jnp.concatenate([point, jnp.zeros_like(point)]), square)


def predict(state: State, seconds: Float[Array, ""], acceleration: Float[Array, ""]) -> State:
    """The state so many seconds later; `acceleration` (m/s^2) is the standard deviation of its mean over a second."""
    move = _transition(seconds)
    return State(move @ state.mean, move @ state.covariance @ move.T + _process(seconds, acceleration))


def distance2(state: State, point: Float[Array, "3"], information: Float[Array, "3 3"]) -> Float[Array, ""]:
    """Squared distance of a measurement from a state in standard deviations: chi-square of the information's rank."""
    difference = point - state.mean[:3]
    return difference @ _weight(state, information) @ difference


def update(state: State, point: Float[Array, "3"], information: Float[Array, "3 3"]) -> State:
    """The state once a point was measured.

    A measurement is a point (m) and its information, the inverse of its covariance (1/m^2). One view knows nothing
    along its line of sight: its information has rank 2, and the point is any on that line. No information changes
    nothing.
    Joseph's form keeps the covariance symmetric and positive.
    """
    weight = _weight(state, information)
    gain = state.covariance[:, :3] @ weight
    rest = jnp.eye(6, dtype=gain.dtype) - jnp.pad(gain, ((0, 0), (0, 3)))
    noise = state.covariance[:, :3] @ _share(state, information, weight) @ state.covariance[:3]
    square = rest @ state.covariance @ rest.T + noise
    return State(state.mean + gain @ (point - state.mean[:3]), 0.5 * (square + square.T))


def _weight(state: State, information: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Inverse of the covariance of a measurement minus its prediction, also where the information is singular."""
    return _share(state, information, information)


def _share(state: State, information: Float[Array, "3 3"], right: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """(1 + information times the state's covariance)^-1 times `right`."""
    return jnp.linalg.solve(jnp.eye(3, dtype=right.dtype) + information @ state.covariance[:3, :3], right)


@jit
def filter_track(
    times: Float[Array, " F"],
    points: Float[Array, "F 3"],
    informations: Float[Array, "F 3 3"],
    acceleration: Float[Array, ""],
    speed: Float[Array, ""],
) -> Filtered:
    """One track through F frames; it begins with the first, which two views at least must have measured.

    Args:
        times: s, not decreasing. Frames at the end that only fill up repeat the last.
        points: m; finite, and without effect where there is no information.
        informations: of the points, 1/m^2; 0 where there is no measurement.
        acceleration: m/s^2, as in `predict`.
        speed: m/s, as in `begin`.
    """
    first = begin(points[0], informations[0], speed)

    def step(state: State, frame: tuple) -> tuple[State, Filtered]:
        seconds, point, information = frame
        predicted = predict(state, seconds, acceleration)
        state = update(predicted, point, information)
        return state, Filtered(state, predicted, distance2(predicted, point, information))

    _, later = jax.lax.scan(step, first, (jnp.diff(times), points[1:], informations[1:]))
    start = Filtered(first, first, jnp.zeros_like(speed))
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
