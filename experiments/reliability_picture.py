"""How often answers are right beside how often they say so, as a picture; used by `pointing_evaluation.py`."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.figure import Figure
from scipy.stats import binomtest


def reliability_picture(
    given: Float[np.ndarray, " n"], right: Bool[np.ndarray, " n"], bins: tuple[float, ...], path: Path
) -> None:
    """Write a PNG: of each bin of probability the share that is right, with its Wilson interval of 95 %."""
    figure = Figure(figsize=(5.2, 5.0), layout="constrained")
    axes = figure.add_subplot(
        xlabel="probability that the answer gave itself", ylabel="share that is right", xlim=(0, 1.02), ylim=(0, 1.02),
        aspect="equal",
    )  # fmt: skip
    axes.plot([0, 1], [0, 1], color="#90a0af", linewidth=1, label="as often as said")
    for low, high in pairwise(bins):
        own = (given > low) & (given <= high)
        if own.any():
            share = right[own].mean()
            interval = binomtest(int(right[own].sum()), int(own.sum())).proportion_ci(0.95, "wilson")
            reach = [[share - interval.low], [interval.high - share]]
            axes.errorbar(given[own].mean(), share, reach, fmt="o", color="#2f7fd1", capsize=3)
            axes.annotate(f"n = {own.sum()}", (given[own].mean(), interval.low), (0, -4), textcoords="offset points",
                          ha="center", va="top", fontsize=8)  # fmt: skip
    axes.errorbar([], [], [], fmt="o", color="#2f7fd1", capsize=3, label="answers, interval of 95 %")
    axes.legend(frameon=False, loc="lower right")
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=130)
