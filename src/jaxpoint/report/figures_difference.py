"""Figures of two calibrations against each other: in every image, and over the room."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Bool, Float
from matplotlib import colormaps
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from jaxpoint.calibration.difference import Difference
from jaxpoint.calibration.sight import centres, in_view, project
from jaxpoint.report.style import INK, PAGE, camera_colors, small_multiples

_ACROSS = 16  # arrows along the longer side of an image
_ARROW = 0.05  # length of the longest usual arrow, as a fraction of the image's or the room's width


@dataclass(frozen=True)
class ImageShifts:
    """Where the second calibration projects what the first sees at a pixel, at the usual distance; one camera."""

    pixels: Float[np.ndarray, "Y X 2"]
    shifts: Float[np.ndarray, "Y X 2"]  # px
    valid: Bool[np.ndarray, "Y X"]


def image_shifts(found: Difference) -> list[ImageShifts]:
    """The shift over every image, at the median distance of the places that the camera sees."""
    shifts = []
    for c in range(len(found.first)):
        width, height = np.asarray(found.first.image_sizes)[c]
        step = max(width, height) / _ACROSS
        axes = [
            (np.arange(max(int(side / step), 2)) + 0.5) * side / max(int(side / step), 2) for side in (width, height)
        ]
        pixels = np.stack(np.meshgrid(*axes), axis=-1) - 0.5
        with jax.enable_x64(True):
            ray = found.first[c].ray(pixels.reshape(-1, 2))
            sight = np.asarray(ray.direction)
        places = found.places[found.seen[:, c]] if found.seen[:, c].any() else found.places
        origin = centres(found.first)[c]
        there = origin + np.median(np.linalg.norm(places - origin, axis=1)) * sight
        valid = in_view(found.first, there)[:, c] & near_the_image(found, there, c)
        moved = project(found.second, there)[:, c] - pixels.reshape(-1, 2)
        shape = pixels.shape[:2]
        shifts.append(ImageShifts(pixels, moved.reshape(*shape, 2), valid.reshape(shape)))
    return shifts


def near_the_image(found: Difference, there: Float[np.ndarray, "N 3"], camera: int) -> Bool[np.ndarray, " N"]:
    """Whether the second camera projects them at all: a place may fall just outside of its image."""
    pixels = project(found.second, there)[:, camera]
    size = np.asarray(found.second.image_sizes)[camera]
    return (np.abs(pixels - size / 2) < size).all(axis=1)


def shift_maps(found: Difference, names: tuple[str, ...]) -> tuple[Figure, float]:
    """The size of the shift as colour, on one scale whose end (px) comes second, and its direction as arrows."""
    maps = image_shifts(found)
    sizes = np.asarray(found.first.image_sizes)
    lengths = [np.linalg.norm(one.shifts, axis=-1) for one in maps]
    everything = np.concatenate([length[one.valid] for length, one in zip(lengths, maps)] or [np.ones(1)])
    top = max(float(np.quantile(everything, 0.95)) if everything.size else 1.0, 1e-9)
    titles = [f"{name}: {rms:.2f} px" for name, rms in zip(names, found.pixels)]
    figure, axes = small_multiples(titles, sizes, ticks=False)
    for ax, one, length, size in zip(axes, maps, lengths, sizes, strict=True):
        shown = np.ma.masked_where(~one.valid, length)
        extent = (-0.5, size[0] - 0.5, size[1] - 0.5, -0.5)
        ax.imshow(shown, extent=extent, cmap=colormaps["viridis_r"], norm=Normalize(0, top), interpolation="nearest")
        scale = _ARROW * size[0] / top
        at, by = one.pixels[one.valid], one.shifts[one.valid] * scale
        ax.quiver(*at.T, *by.T, angles="xy", scale_units="xy", scale=1, color="white", width=0.0035)
        ax.set(xlim=extent[:2], ylim=extent[2:])
    return figure, top


def room_map(found: Difference, names: tuple[str, ...], unit: str) -> Figure:
    """Floor plan and side view: the places, coloured by how far apart both calibrations triangulate them."""
    apart = 1e3 * np.linalg.norm(found.moved, axis=1)
    top = max(float(np.quantile(apart, 0.95)), 1e-9)
    low, high = (end(np.concatenate([found.places, centres(found.first)]), axis=0) for end in (np.min, np.max))
    width = (PAGE - 1.9) / 2
    span = np.maximum(high - low, 1e-9)
    figure = Figure(
        figsize=(PAGE, float(np.clip(width * max(span[1], span[2]) / span[0] + 0.8, 3.0, 8.0))), layout="constrained"
    )
    views = [figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)]
    titles = ("From above", "From the side") if unit == "mm" else ("Along z", "Along y")
    for ax, keep, title in zip(views, ([0, 1], [0, 2]), titles, strict=True):
        dots = ax.scatter(
            *found.places[:, keep].T, s=12, c=apart, cmap="viridis_r", vmin=0, vmax=top, lw=0, rasterized=True
        )
        for color, name, center in zip(camera_colors(len(names)), names, centres(found.first), strict=True):
            ax.plot(*center[keep], "o", ms=7, mfc=color, mec=INK, mew=0.8)
            ax.annotate(
                name, center[keep], xytext=(0, 7), textcoords="offset points", ha="center", weight="bold", fontsize=8,
                color=INK, annotation_clip=True,
            )  # fmt: skip
        length = "m" if unit == "mm" else "unit of the first"
        ax.set(title=title, xlabel=f"{'xyz'[keep[0]]}, {length}", ylabel=f"{'xyz'[keep[1]]}, {length}", aspect="equal")
    bar = figure.colorbar(dots, ax=views, shrink=0.8, pad=0.01, aspect=30, label=f"apart, {unit}")
    bar.outline.set_visible(False)  # pyright: ignore[reportCallIssue]
    return figure
