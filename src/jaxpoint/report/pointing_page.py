"""The page of what was pointed at: for a person who sees such a page for the first time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import UInt8
from markupsafe import Markup

from jaxpoint.io.files import StrPath
from jaxpoint.report import tables
from jaxpoint.report.figures_pointing import PointingScene, RoomScene, room_view
from jaxpoint.report.html import encoded, render, write_page
from jaxpoint.report.style import style, to_svg


@dataclass(frozen=True)
class GestureEntry:
    """One gesture of the page, in words and pictures."""

    number: int
    title: str
    sentence: str
    row: Sequence[str]  # of the table of all
    sheet: UInt8[np.ndarray, "H W 3"] | None  # red, green, blue; None without images of that moment
    caption: str
    scene: PointingScene
    chances: Sequence[tuple[str, float]]
    line: Sequence[tuple[str, str]]  # what is known of the line
    reasons: Sequence[str]
    truth: str = ""  # where it is known
    right: bool = False  # whether the answer is


def write_pointing_report(
    path: StrPath,
    room: RoomScene,
    gestures: Sequence[GestureEntry],
    *,
    header: Sequence[str],
    tiles: Sequence[tuple[str, str]],
    notes: Sequence[str],
    provenance: Mapping[str, Any],
    config_text: str,
    title: str = "What was pointed at",
    kind: str = "jaxpoint point",
    intro: Sequence[str] = (),
    links: Sequence[tuple[str, str]] = (),
) -> None:
    """Write the page, whole or not at all.

    Args:
        path: of the page.
        room: the room and its objects.
        gestures: in order of time.
        header: of the table of all gestures.
        tiles: figures at a glance, value and label.
        notes: what a reader should know, a sentence each.
        provenance: versions, command, inputs.
        config_text: the settings as TOML.
        title: of the page.
        kind: of the page, such as the command that made it.
        intro: sentences before the table.
        links: to other pages, name and address.

    Raises:
        OSError: the folder is missing or not writable.
    """
    shown = []
    for gesture in gestures:
        with style():
            drawn = Markup(to_svg(room_view(room, gesture.scene)))
        sheets = [] if gesture.sheet is None else encoded([(gesture.caption, gesture.sheet)])
        chances = [[name, f"{100 * chance:.0f} %" if chance >= 0.01 else "< 1 %"] for name, chance in gesture.chances]
        shown.append(
            {
                "number": gesture.number,
                "title": gesture.title,
                "sentence": gesture.sentence,
                "truth": gesture.truth,
                "right": gesture.right,
                "sheets": sheets,
                "room": drawn,
                "chances": tables.Table(["object", "probability"], chances),
                "line": tables.Table([], [list(row) for row in gesture.line]),
                "reasons": gesture.reasons,
            }
        )
    page = render(
        "pointing.html.j2",
        kind=kind,
        title=title,
        subtitle="",
        sections=[
            ("answers", "Answers"),
            ("reading", "How to read"),
            *((f"gesture-{gesture.number}", str(gesture.number)) for gesture in gestures),
            ("provenance", "Provenance"),
        ],
        tiles=tiles,
        intro=intro,
        links=links,
        answers=tables.Table(list(header), [list(gesture.row) for gesture in gestures]),
        notes=notes,
        gestures=shown,
        provenance=tables.origin_table(provenance, {}, None),
        config_text=config_text,
    )
    write_page(path, page)
