"""The page of a session with people: where each was, what was found in which frame, and pictures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float
from markupsafe import Markup

from jaxpoint.body.tracking.head_tracks import HeadTracks
from jaxpoint.io.files import StrPath
from jaxpoint.report import figures_heads, tables
from jaxpoint.report.html import Sheets, encoded, render, write_page
from jaxpoint.report.style import style, to_svg


def write_people_report(
    path: StrPath,
    figures: Mapping[str, Any],
    heads: HeadTracks | None,
    centers: Float[np.ndarray, "C 3"] | None,
    sheets: Sheets,
    provenance: Mapping[str, Any],
    config_text: str,
) -> None:
    """Write the page, whole or not at all.

    Args:
        path: of the page.
        figures: what `metrics.json` holds.
        heads: the head tracks; None where nobody could be followed.
        centers: of the cameras, m.
        sheets: caption and RGB image each.
        provenance: versions, command, inputs.
        config_text: the settings as TOML.

    Raises:
        OSError: the folder is missing or not writable.
    """
    drawn = {}
    if heads is not None and centers is not None and len(heads.people):
        with style():
            drawn = {
                "plan": Markup(to_svg(figures_heads.floor_plan(heads, centers))),
                "space": Markup(to_svg(figures_heads.in_space(heads, centers))),
                "heights": Markup(to_svg(figures_heads.heights(heads))),
            }
    sections = [("cameras", "Cameras"), *([("tracks", "Head tracks")] if drawn else []), ("pictures", "Pictures")]
    page = render(
        "people.html.j2",
        kind="jaxpoint detect person",
        title="People",
        subtitle="",
        sections=[*sections, ("provenance", "Provenance")],
        tiles=_tiles(figures),
        notes=figures["notes"],
        cameras=_cameras(figures),
        people=_people(figures),
        figures=drawn,
        sheets=encoded(sheets),
        provenance=tables.origin_table(provenance, {}, None),
        config_text=config_text,
    )
    write_page(path, page)


def _tiles(figures: Mapping[str, Any]) -> list[tuple[str, str]]:
    arms = sum(person["arms"] for person in figures["people"])
    return [
        (str(figures["moments"]), "frames"),
        (str(len(figures["cameras"])), "cameras"),
        (str(len(figures["people"])) if figures["followed"] else "–", "people followed"),
        (str(arms) if figures["followed"] else "–", "arms measured"),
    ]


def _cameras(figures: Mapping[str, Any]) -> tables.Table:
    rows = [
        [
            camera["name"],
            f"{camera['with_person']} of {camera['frames']}",
            str(camera["heads"]),
            tables.counted_reasons(camera["reasons"]),
        ]
        for camera in figures["cameras"]
    ]
    return tables.Table(["camera", "somebody in", "heads", "other frames"], rows)


def _people(figures: Mapping[str, Any]) -> tables.Table:
    rows = [[str(p["person"]), str(p["moments"]), str(p["arms"])] for p in figures["people"]]
    return tables.Table(["person", "frames followed", "arm measured in"], rows)
