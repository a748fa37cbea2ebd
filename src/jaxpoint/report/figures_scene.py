"""Figures in space: the rig with its cameras' fields of view and the light's path, and which places were covered."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from jaxpoint.report.style import FAINT, INK, camera_colors
from jaxpoint.report.summary import Scene

_FRUSTUM = 0.22  # depth of a drawn field of view, as a fraction of the rig's size


def frusta(
    scene: Scene, sizes: Int[np.ndarray, "C 2"], focal: Float[np.ndarray, "C 2"], center: Float[np.ndarray, "C 2"]
) -> Float[np.ndarray, "C 5 3"]:
    """Tip and four image corners (clockwise from the top left) of each camera's field of view, as seen through a pinhole."""
    unit = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    plane = (unit[None] * sizes[:, None] - 0.5 - center[:, None]) / focal[:, None]
    plane *= np.minimum(1.0, 1.0 / np.abs(plane).max(axis=(1, 2), keepdims=True))  # a fish-eye would fill the figure
    rays = np.concatenate([plane, np.ones((*plane.shape[:2], 1))], axis=2)
    corners = scene.centers[:, None] + _FRUSTUM * scene.size * np.einsum("cij,cnj->cni", scene.world_from_cam, rays)
    return np.concatenate([scene.centers[:, None], corners], axis=1)


def frustum_lines(cones: Float[np.ndarray, "C 5 3"]) -> Float[np.ndarray, "C 8 2 3"]:
    """The eight edges of each field of view."""
    tip, corner = np.broadcast_to(cones[:, :1], cones[:, 1:].shape), cones[:, 1:]
    return np.concatenate([np.stack([tip, corner], 2), np.stack([corner, np.roll(corner, -1, axis=1)], 2)], axis=1)


def bounds(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest coordinates of the cameras and nearly all of the path (wild points do not count)."""
    low, high = np.quantile(scene.points, [0.005, 0.995], axis=0) if len(scene.points) else scene.centers[[0, 0]]
    low, high = np.minimum(low, scene.centers.min(axis=0)), np.maximum(high, scene.centers.max(axis=0))
    margin = 0.06 * (high - low).max()
    return low - margin, high + margin


def rig_views(scenes: list[tuple[str, Scene]], names: tuple[str, ...], cones: list[np.ndarray]) -> Figure:
    """The rig in 3-D with fields of view, names and the light's path: the thesis's figures 27 and 28."""
    figure = Figure(figsize=(10.0, 4.8 if len(scenes) > 1 else 6.0))
    for index, ((title, scene), cone) in enumerate(zip(scenes, cones, strict=True)):
        wide = 1.0 / len(scenes)
        ax = figure.add_axes((index * wide + 0.02, 0.06, wide - 0.08, 0.86), projection="3d", computed_zorder=False)
        low, high = bounds(scene)
        inside = ((scene.points >= low) & (scene.points <= high)).all(axis=1)
        ax.scatter(*scene.points[inside].T, s=2, c="#3b82d0", alpha=0.45, lw=0, depthshade=False, rasterized=True)
        for color, name, edges, tip in zip(
            camera_colors(len(names)), names, frustum_lines(cone), scene.centers, strict=True
        ):
            ax.add_collection3d(Line3DCollection(edges, colors=color, linewidths=1.2))
            ax.text(*(tip + [0, 0, 0.04 * (high - low).max()]), name, color=INK, weight="bold", fontsize=8, ha="center")
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
        ax.set(xlabel=_label("x", scene), ylabel=_label("y", scene), zlabel=_label("z", scene))
        ax.set_box_aspect(tuple(high - low), zoom=1.12)
        ax.view_init(elev=24, azim=-62)
        ax.set_title(title, loc="center", y=1.02)
        for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
            axis.set_pane_color((0.5, 0.55, 0.6, 0.06))
            axis.line.set_color(FAINT)
        ax.tick_params(labelsize=7)
        ax.locator_params(nbins=6)
    return figure


def coverage_in_space(
    scene: Scene, seen_by: Int[np.ndarray, " P"], names: tuple[str, ...], cones: np.ndarray
) -> Figure:
    """Floor plan and side view of the light's positions, coloured by the number of cameras that saw them."""
    low, high = bounds(scene)
    span = high - low
    width = (10.0 - 1.9) / 2  # of one view, in inches
    height = float(np.clip(width * max(span[1], span[2]) / span[0] + 0.8, 3.0, 8.0))
    figure = Figure(figsize=(10.0, height), layout="constrained")
    views = [figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)]
    dots = None
    for ax, axis, title in zip(views, (1, 2), ("Floor plan, from above", "Side view"), strict=True):
        dots = _flat_view(ax, axis, scene, seen_by, names, cones)
        ax.set(xlim=(low[0], high[0]), ylim=(low[axis], high[axis]), title=title)
        ax.set(xlabel=_label("x", scene), ylabel=_label("xyz"[axis], scene))
    bar = figure.colorbar(
        dots, ax=views, shrink=0.7, pad=0.01, aspect=30, label="cameras that agree on the light there"
    )
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    bar.set_ticks(list(range(2, len(names) + 1)))
    return figure


def _flat_view(ax: Axes, axis: int, scene: Scene, seen_by, names, cones):
    keep = [0, axis]
    dots = ax.scatter(
        *scene.points[:, keep].T, s=7, c=seen_by, cmap="viridis_r", vmin=1.5, vmax=len(names) + 0.5, alpha=0.8, lw=0,
        rasterized=True,
    )  # fmt: skip
    for color, name, edges, tip in zip(
        camera_colors(len(names)), names, frustum_lines(cones), scene.centers, strict=True
    ):
        ax.add_collection(LineCollection(list(edges[:, :, keep]), colors=color, linewidths=1.1))
        ax.annotate(
            name, tip[keep], xytext=(0, 6), textcoords="offset points", ha="center", weight="bold", fontsize=8,
            color=INK, annotation_clip=True,
        )  # fmt: skip
    ax.set_aspect("equal")
    return dots


def _label(axis: str, scene: Scene) -> str:
    return f"{axis}, m" if scene.unit == "m" else f"{axis}, solver's unit"
