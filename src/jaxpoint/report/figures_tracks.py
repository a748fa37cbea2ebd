"""Figures of tracks alone, before anything is solved."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Int
from matplotlib.figure import Figure

from jaxpoint.report.style import PAGE, camera_colors

_COLUMNS = 600  # no page shows more frames side by side


def timeline(names: tuple[str, ...], visible: Bool[np.ndarray, "F C"], frame_ids: Int[np.ndarray, " F"]) -> Figure:
    """When each camera saw the light: one band a camera, paler where it saw it in a part of the frames only."""
    figure = Figure(figsize=(PAGE, 0.9 + 0.27 * (len(names) + 1)), layout="constrained")
    ax = figure.add_subplot()
    edges = np.unique(np.linspace(0, len(frame_ids), min(_COLUMNS, len(frame_ids)) + 1).astype(int))
    share = np.add.reduceat(visible.astype(float), edges[:-1], axis=0) / np.diff(edges)[:, None]
    step = np.append(frame_ids, frame_ids[-1] + 1)[edges]
    for camera, color in enumerate(camera_colors(len(names))):
        bars = np.stack([step[:-1], np.diff(step)], axis=1)
        shown = share[:, camera] > 0
        if not shown.any():  # matplotlib draws no bars of no length
            continue
        ax.broken_barh(
            [tuple(bar) for bar in bars[shown]], (camera - 0.35, 0.7), facecolors=color,
            alpha=share[shown, camera], lw=0, rasterized=True,
        )  # fmt: skip
    ax.set(ylim=(len(names) - 0.5, -0.5), xlim=(step[0], step[-1]), xlabel="frame")
    ax.set_yticks(range(len(names)), names)
    ax.grid(axis="y", visible=False)
    return figure
