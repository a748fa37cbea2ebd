"""Figures in space: the rig with its cameras' fields of view and the light's path, and which places were covered."""

from __future__ import annotations

from typing import cast

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from jaxpoint.report.style import INK, PAGE, camera_colors, quiet_axes
from jaxpoint.report.summary import RigScene

_FRUSTUM = (0.22, 0.06)  # depth of a drawn field of view, as fractions of the rig's and of the whole scene's size


def frusta(
    scene: RigScene, sizes: Int[np.ndarray, "C 2"], focal: Float[np.ndarray, "C 2"], center: Float[np.ndarray, "C 2"]
) -> Float[np.ndarray, "C 5 3"]:
    """Tip and four image corners (clockwise from the top left) of each camera's field of view, undistorted."""
    unit = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    plane = (unit[None] * sizes[:, None] - 0.5 - center[:, None]) / focal[:, None]
    plane *= np.minimum(1.0, 1.0 / np.abs(plane).max(axis=(1, 2), keepdims=True))  # a fish-eye would fill the figure
    rays = np.concatenate([plane, np.ones((*plane.shape[:2], 1))], axis=2)
    low, high = scene.reach(0.05)
    depth = max(_FRUSTUM[0] * scene.size, _FRUSTUM[1] * float(np.linalg.norm(high - low)))
    corners = scene.centers[:, None] + depth * np.einsum("cij,cnj->cni", scene.world_from_cam, rays)
    return np.concatenate([scene.centers[:, None], corners], axis=1)


def frustum_lines(cones: Float[np.ndarray, "C 5 3"]) -> Float[np.ndarray, "C 8 2 3"]:
    """The eight edges of each field of view."""
    tip, corner = np.broadcast_to(cones[:, :1], cones[:, 1:].shape), cones[:, 1:]
    return np.concatenate([np.stack([tip, corner], 2), np.stack([corner, np.roll(corner, -1, axis=1)], 2)], axis=1)


def bounds(scene: RigScene, cones: Float[np.ndarray, "C 5 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest coordinates of the cameras' fields of view and nearly all of the path (but no wild points)."""
    drawn = cones.reshape(-1, 3)
    low, high = scene.reach(0.005)
    low, high = np.minimum(low, drawn.min(axis=0)), np.maximum(high, drawn.max(axis=0))
    margin = 0.04 * (high - low).max()
    return low - margin, high + margin


def rig_views(scenes: list[tuple[str, RigScene]], names: tuple[str, ...], cones: list[np.ndarray]) -> Figure:
    """The rig in 3-D with fields of view, names and the light's path: the thesis's figures 27 and 28."""
    figure = Figure(figsize=(PAGE, 5.0 if len(scenes) > 1 else 6.0))
    wide = 1.0 / len(scenes)
    for index, ((title, scene), cone) in enumerate(zip(scenes, cones, strict=True)):
        place = (index * wide, 0.07, wide - 0.08, 0.88)
        ax = cast(Axes3D, figure.add_axes(place, projection="3d", computed_zorder=False))
        _solid_view(ax, scene, names, cone)
        ax.set_title(title, loc="center", y=0.98)
    return figure


def _solid_view(ax: Axes3D, scene: RigScene, names: tuple[str, ...], cones: np.ndarray) -> None:
    low, high = bounds(scene, cones)
    inside = scene.points[((scene.points >= low) & (scene.points <= high)).all(axis=1)]
    ax.scatter(*inside.T, s=2, c="#3b82d0", alpha=0.45, lw=0, depthshade=False, rasterized=True)
    lift = 0.04 * (high - low).max()
    edges = frustum_lines(cones)
    for camera, (color, name) in enumerate(zip(camera_colors(len(names)), names, strict=True)):
        ax.add_collection3d(Line3DCollection(list(edges[camera]), colors=color, linewidths=1.2))
        x, y, z = scene.centers[camera]
        ax.text(x, y, z + lift, name, color=INK, weight="bold", fontsize=8, ha="center")
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    ax.set(xlabel=_label("x", scene), ylabel=_label("y", scene), zlabel=_label("z", scene))
    ax.set_box_aspect(tuple(high - low), zoom=0.88)  # pyright: ignore[reportArgumentType]
    ax.view_init(elev=24, azim=-62)
    quiet_axes(ax)


def coverage_in_space(
    scene: RigScene, seen_by: Int[np.ndarray, " P"], names: tuple[str, ...], cones: np.ndarray
) -> Figure:
    """Floor plan and side view of the light's positions, coloured by the number of cameras that saw them."""
    low, high = bounds(scene, cones)
    span = high - low
    width = (PAGE - 1.9) / 2  # of one view, in inches
    height = float(np.clip(width * max(span[1], span[2]) / span[0] + 0.8, 3.0, 8.0))
    figure = Figure(figsize=(PAGE, height), layout="constrained")
    views = [figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)]
    dots = [_flat_view(ax, axis, scene, seen_by, names, cones) for ax, axis in zip(views, (1, 2), strict=True)]
    for ax, axis, title in zip(views, (1, 2), ("Floor plan, from above", "Side view"), strict=True):
        ax.set(xlim=(low[0], high[0]), ylim=(low[axis], high[axis]), title=title)
        ax.set(xlabel=_label("x", scene), ylabel=_label("xyz"[axis], scene))
    bar = figure.colorbar(dots[0], ax=views, shrink=0.7, pad=0.01, aspect=30, label="cameras that agree")
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    bar.set_ticks(list(range(2, len(names) + 1)))
    return figure


def _flat_view(ax: Axes, axis: int, scene: RigScene, seen_by, names, cones):
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


def _label(axis: str, scene: RigScene) -> str:
    return f"{axis}, m" if scene.unit == "m" else f"{axis}, solver's unit"
