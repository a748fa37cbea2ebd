"""Pointings at known targets: what a bias is learnt from."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxpoint.errors import InsufficientDataError
from jaxpoint.geometry.angles import azimuth_elevation, wrap_angle


@dataclass(frozen=True)
class Pointings:
    """G gestures of people, each with the same L kinds of line."""

    gestures: tuple[str, ...]  # name of each
    people: tuple[str, ...]  # who made it
    lines: tuple[str, ...]  # kinds of line
    origins: Float[np.ndarray, "G L 3"]  # m
    directions: Float[np.ndarray, "G L 3"]  # unit length
    targets: Float[np.ndarray, "G 3"] | None = None  # m, what was meant, if it is known

    def __len__(self) -> int:
        return len(self.gestures)

    @property
    def crowd(self) -> tuple[str, ...]:
        """Everybody, once each, in the order of appearance."""
        return tuple(dict.fromkeys(self.people))

    @property
    def who(self) -> Int[np.ndarray, " G"]:
        """Number of each gesture's person in `crowd`."""
        place = {person: i for i, person in enumerate(self.crowd)}
        return np.array([place[person] for person in self.people])

    def select(self, chosen: Bool[np.ndarray, " G"] | Int[np.ndarray, " n"]) -> Pointings:
        """Some of the gestures, by mask or by numbers."""
        numbers = np.flatnonzero(chosen) if chosen.dtype == bool else chosen
        return Pointings(
            tuple(self.gestures[i] for i in numbers),
            tuple(self.people[i] for i in numbers),
            self.lines,
            self.origins[numbers],
            self.directions[numbers],
            None if self.targets is None else self.targets[numbers],
        )

    def of_lines(self, lines: tuple[str, ...]) -> Pointings:
        """The same gestures with some of the lines, in the order asked for.

        Raises:
            InsufficientDataError: a line is not there.
        """
        missing = [line for line in lines if line not in self.lines]
        if missing:
            raise InsufficientDataError(
                f"There is no line '{missing[0]}' in these pointings, which have {', '.join(self.lines)}; "
                "record it too, or take another bias."
            )
        chosen = [self.lines.index(line) for line in lines]
        return Pointings(
            self.gestures, self.people, lines, self.origins[:, chosen], self.directions[:, chosen], self.targets
        )

    @property
    def angles(self) -> Float[np.ndarray, "G L 2"]:
        """Azimuth and elevation of every line, rad. In float64, as all below: JAX's 64 bits must be on."""
        return np.asarray(azimuth_elevation(self.directions))

    @property
    def errors(self) -> Float[np.ndarray, "G 2"]:
        """By how much the first line points too far left and too high, rad: azimuth and elevation.

        Raises:
            InsufficientDataError: targets are not known.
        """
        found = self.angles[:, 0] - np.asarray(azimuth_elevation(self.to_targets))
        return np.stack([np.asarray(wrap_angle(jnp.asarray(found[:, 0]))), found[:, 1]], axis=1)

    @property
    def to_targets(self) -> Float[np.ndarray, "G 3"]:
        """Unit directions from the first line's origin to the target.

        Raises:
            InsufficientDataError: targets are not known.
        """
        if self.targets is None:
            raise InsufficientDataError("These pointings have no targets; give target_x_m, target_y_m and target_z_m.")
        gap = self.targets - self.origins[:, 0]
        return gap / np.linalg.norm(gap, axis=1, keepdims=True)

    @property
    def level(self) -> Float[np.ndarray, " G"]:
        """Cosine of the elevation of the target: by how much an error of azimuth counts."""
        return np.hypot(self.to_targets[:, 0], self.to_targets[:, 1])
