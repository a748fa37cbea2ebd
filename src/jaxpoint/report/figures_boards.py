"""Figures of a calibration from boards: every view's fit, how boards were held, and where a lens is known worst."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from jaxpoint.calibration.board_figures import ViewFit, lens_sigma_map, where_next
from jaxpoint.calibration.pair_poses import PairScatter
from jaxpoint.calibration.result import Calibration
from jaxpoint.report.style import BAD, FAINT, INK, PAGE, camera_colors, small_multiples

LEAST_PX, MOST_PX = 0.02, 5.0  # ends of the colours of the lens's uncertainty


def view_errors(views: Sequence[ViewFit], names: Sequence[str]) -> Figure:
    """Rms of every view, one bar each; views that fit much worse than the others in red."""
    figure = Figure(figsize=(PAGE, 1.2 + 1.6 * len(names)), layout="constrained")
    for camera, (name, color) in enumerate(zip(names, camera_colors(len(names)))):
        ax = figure.add_subplot(len(names), 1, camera + 1)
        own = [view for view in views if view.camera == camera]
        place = np.arange(len(own))
        colors = [BAD if view.poor else color for view in own]
        ax.bar(place, [view.rms_px for view in own], color=colors, width=0.75)
        step = max(len(own) // 30, 1)
        ax.set_xticks(place[::step], [str(view.frame_id) for view in own][::step], fontsize=7)
        ax.set(ylabel="rms, px", title=name, xlim=(-0.6, max(len(own), 1) - 0.4))
        ax.grid(axis="x", visible=False)
    figure.axes[-1].set_xlabel("frame")
    return figure


def ways_held(views: Sequence[ViewFit], names: Sequence[str]) -> Figure:
    """Tilt against distance of every view: a lens wants both spread out."""
    figure = Figure(figsize=(PAGE, 3.2), layout="constrained")
    ax = figure.add_subplot()
    for camera, (name, color) in enumerate(zip(names, camera_colors(len(names)))):
        own = [view for view in views if view.camera == camera]
        ax.scatter([view.distance_m for view in own], [view.tilt_deg for view in own], s=26, color=color, label=name,
                   alpha=0.8, edgecolors="none")  # fmt: skip
    ax.axhspan(25, 50, color=FAINT, alpha=0.15, lw=0)
    ax.set(xlabel="distance of the board, m", ylabel="tilt against the line of sight, degrees", ylim=(0, None))
    ax.set_xlim(0, None)
    ax.legend(ncols=max(1, min(len(names), 6)))
    return figure


def lens_certainty(calibration: Calibration, names: Sequence[str]) -> Figure:
    """How uncertain each lens is over its image, and a ring where the board should be held next."""
    sizes = np.asarray(calibration.tracks.image_sizes)
    maps = [lens_sigma_map(calibration, camera) for camera in range(len(names))]
    typical = [np.nan if one is None or not np.isfinite(one).any() else float(np.nanmedian(one)) for one in maps]
    titles = [f"{name}: {value:.2f} px in the middle of all places" for name, value in zip(names, typical)]
    figure, axes = small_multiples(titles, sizes, columns=2 if len(names) > 1 else 1, ticks=False)
    for camera, ax in enumerate(axes):
        _certainty(calibration, camera, maps[camera], ax)
    return figure


def _certainty(calibration: Calibration, camera: int, found: np.ndarray | None, ax: Axes) -> None:
    if found is None or not np.isfinite(found).any():
        return
    width, height = calibration.tracks.image_sizes[camera]
    shown = np.ma.masked_invalid(np.clip(found, LEAST_PX, MOST_PX))
    extent = (-0.5, width - 0.5, height - 0.5, -0.5)
    image = ax.imshow(shown, norm=LogNorm(LEAST_PX, MOST_PX), cmap="viridis_r", extent=extent, interpolation="bilinear")
    seen = calibration.tracks.pixels[calibration.kept[:, camera], camera]
    ax.scatter(
        *seen[:: max(len(seen) // 1500, 1)].T, s=3.0, color="white", alpha=0.5, edgecolors="none", rasterized=True
    )
    place = where_next(calibration, camera)
    if place is not None:
        ax.scatter(*place[0], s=260, facecolors="none", edgecolors=BAD, linewidths=2.2, clip_on=False, zorder=5)
    bar = ax.figure.colorbar(image, ax=ax, shrink=0.8, pad=0.02, ticks=[0.02, 0.1, 0.5, 1, 5])
    bar.ax.set_yticklabels(["0.02", "0.1", "0.5", "1", "5 px"], fontsize=7)


def pair_shifts(scatters: Sequence[PairScatter], names: Sequence[str]) -> Figure:
    """Where single views put the second camera of a pair against where all views do, mm and degrees."""
    figure = Figure(figsize=(PAGE, 3.1), layout="constrained")
    left, right = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)
    for scatter, color in zip(scatters, camera_colors(len(scatters))):
        label = f"{names[scatter.first]} – {names[scatter.second]}"
        frames = [view.frame_id for view in scatter.views]
        shift = 1e3 * np.array([np.linalg.norm(view.shift) for view in scatter.views])
        turn = np.degrees([np.linalg.norm(view.turn) for view in scatter.views])
        left.plot(frames, shift, "o", color=color, ms=4, label=label)
        right.plot(frames, turn, "o", color=color, ms=4, label=label)
    left.set(xlabel="frame", ylabel="shift, mm", ylim=(0, None))
    right.set(xlabel="frame", ylabel="turn, degrees", ylim=(0, None))
    left.legend(fontsize=7.5)
    left.tick_params(labelcolor=INK)
    return figure
