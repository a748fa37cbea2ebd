"""Numbers drawn from the distributions of the settings."""

from __future__ import annotations

from typing import cast

import numpy as np

from jaxpoint.config.people import Normal, Uniform


def draw(rng: np.random.Generator, spread: Uniform | Normal) -> float:
    """One number of a distribution."""
    if isinstance(spread, Uniform):
        return float(rng.uniform(spread.low, spread.high))
    for _ in range(1000):
        value = rng.normal(spread.mean, spread.sd)
        if spread.low <= value <= spread.high:
            return float(value)
    return float(np.clip(spread.mean, spread.low, spread.high))


def chosen(rng: np.random.Generator, shares: dict[str, float]) -> str:
    """One of the names, each as often as its share says."""
    weights = np.array(list(shares.values()), float)
    return cast(str, rng.choice(list(shares), p=weights / weights.sum()))
