"""The page of a session with a coloured marker: what each camera found, the tip in the room, and pictures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float
from markupsafe import Markup

from jaxpoint.io.files import StrPath
from jaxpoint.report import figures_marker, tables
from jaxpoint.report.html import Sheets, encoded, render, write_page
from jaxpoint.report.style import style, to_svg


def write_marker_report(
    path: StrPath,
    figures: Mapping[str, Any],
    track: figures_marker.TipTrack | None,
    centers: Float[np.ndarray, "C 3"] | None,
    sheets: Sheets,
    provenance: Mapping[str, Any],
    config_text: str,
) -> None:
    """Write the page, whole or not at all.

    Args:
        path: of the page.
        figures: what `metrics.json` holds.
        track: the tip in the room; None where it could not be looked for there.
        centers: of the cameras, m.
        sheets: caption and RGB image each.
        provenance: versions, command, inputs.
        config_text: the settings as TOML.

    Raises:
        OSError: the folder is missing or not writable.
    """
    drawn = {}
    if track is not None and centers is not None and track.found.any():
        names = [camera["name"] for camera in figures["cameras"]]
        with style():
            drawn = {
                "plan": Markup(to_svg(figures_marker.floor_plan(track, names, centers))),
                "space": Markup(to_svg(figures_marker.in_space(track, names, centers))),
                "time": Markup(to_svg(figures_marker.over_time(track))),
            }
    sections = [("cameras", "Cameras"), *([("tips", "Tips in the room")] if drawn else []), ("pictures", "Pictures")]
    page = render(
        "marker.html.j2",
        kind="jaxpoint detect marker",
        title="Coloured marker",
        subtitle="",
        sections=[*sections, ("provenance", "Provenance")],
        tiles=_tiles(figures, track),
        notes=figures["notes"],
        swatch=_swatch(figures["model"]),
        cameras=_cameras(figures),
        others=_others(figures),
        ray_cm=100 * figures_marker.RAY_M,
        figures=drawn,
        sheets=encoded(sheets),
        provenance=tables.origin_table(provenance, {}, None),
        config_text=config_text,
    )
    write_page(path, page)


def _tiles(figures: Mapping[str, Any], track: figures_marker.TipTrack | None) -> list[tuple[str, str]]:
    tiles = [(str(figures["moments"]), "frames"), (str(len(figures["cameras"])), "cameras")]
    if track is None:
        return [*tiles, ("–", "tips in the room")]
    tiles.append((str(int(track.found.sum())), "tips in the room"))
    if track.found.any():
        tiles.append((f"{100 * np.median(track.spread[track.found]):.1f} cm", "views apart, median"))
    return tiles


def _cameras(figures: Mapping[str, Any]) -> tables.Table:
    rows = [
        [camera["name"], f"{camera['found']} of {camera['frames']}", tables.counted_reasons(camera["reasons"])]
        for camera in figures["cameras"]
    ]
    return tables.Table(["camera", "marker in", "other frames"], rows)


def _others(figures: Mapping[str, Any]) -> str:
    """Why frames have no tip in the room."""
    room = figures["in_room"]
    if room is None:
        return "Tips in the room need a calibration (--calibration) and two cameras or more."
    return f"Frames without a tip in the room: {tables.counted_reasons(room['reasons'])}." if room["reasons"] else ""


def _swatch(model: Mapping[str, float]) -> str:
    """The colour that was learnt, as CSS writes it: hue of 360, lightness instead of value."""
    value, saturation = model["value"] / 255, model["saturation"] / 255
    light = value * (1 - saturation / 2)
    share = 0.0 if light in (0.0, 1.0) else (value - light) / min(light, 1 - light)
    return f"hsl({2 * model['hue']:.0f} {100 * share:.0f}% {100 * light:.0f}%)"
