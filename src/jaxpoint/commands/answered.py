"""What `point` and `demo` share: the folder of answers."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxpoint.config import RoomConfig

if TYPE_CHECKING:
    from jaxpoint.answer.pipeline import Pointed
    from jaxpoint.commands.point import Point
    from jaxpoint.io.session import Session
    from jaxpoint.person.following import Following
    from jaxpoint.report.pointing import GestureShown


def write_answers(
    command: Point,
    out: Path,
    session: Session,
    following: Following,
    pointed: Pointed,
    *,
    truth: Mapping[int, str] | None = None,
    intro: Sequence[str] = (),
    links: Sequence[tuple[str, str]] = (),
    tiles: Sequence[tuple[str, str]] = (),
    more: Callable[[Path], object] | None = None,
    title: str = "What was pointed at",
    kind: str = "jaxpoint point",
) -> dict[str, Any]:
    """The folder of answers, whole or not at all, and its figures.

    Args:
        command: its settings.
        truth: what is meant, by the number of the gesture.
        intro, links, tiles, title, kind: of the page.
        more: writes what else belongs into the folder.
    """
    from jaxpoint.answer.sentence import as_json
    from jaxpoint.answer.shown import HEADER, gestures_shown, images_of, room_scene
    from jaxpoint.answer.tables import gestures_table
    from jaxpoint.config import DetectSettings, to_toml
    from jaxpoint.io.table import write_table
    from jaxpoint.report.pointing import write_pointing_report
    from jaxpoint.runs import MARK, new_run, provenance, write_json

    assert session.rig is not None
    made = provenance(shlex.join(["jaxpoint", *sys.argv[1:]]), command.inputs(session), command.seed)
    config = RoomConfig(detect=DetectSettings(person=command.person), track=command.track, point=command.settings)
    gestures = [as_json(answer) for answer in pointed.answers]
    figures: dict[str, Any] = {"gestures": gestures, "notes": list(pointed.notes), "moments": len(session.moments)}
    if truth is not None:
        figures["truth"] = [truth.get(answer.number) for answer in pointed.answers]
    images = images_of(session, pointed.moments)
    shown = gestures_shown(session, following, pointed, images, truth)
    sure = sum(not answer.ambiguous for answer in pointed.answers)
    with new_run(out, command.force) as folder:
        write_json(folder / MARK, made)
        write_json(folder / "metrics.json", figures)
        write_json(folder / "gestures.json", gestures)
        (folder / "config.toml").write_text(to_toml(config), encoding="utf-8")
        write_table(folder / f"gestures.{command.format}", gestures_table(pointed.answers))
        _write_pictures(folder / "pictures", shown)
        if more is not None:
            more(folder)
        write_pointing_report(
            folder / "report.html",
            room_scene(pointed, session.rig),
            shown,
            header=[*HEADER, "in truth", "right"] if truth else list(HEADER),
            tiles=[
                *tiles,
                (str(len(pointed.answers)), "gestures"),
                (str(sure), "with one clear answer"),
                (str(len(pointed.scene.objects)), "objects known"),
                (str(len(session.names)), "cameras"),
            ],
            notes=pointed.notes,
            intro=intro,
            links=links,
            title=title,
            kind=kind,
            provenance=made,
            config_text=to_toml(config),
        )
    return figures


def _write_pictures(folder: Path, shown: Sequence[GestureShown]) -> None:
    from jaxpoint.report.pointing_sheet import save_sheet

    folder.mkdir()
    for gesture in shown:
        save_sheet(
            folder / f"gesture_{gesture.number}.jpg", gesture.sheet, f"Gesture {gesture.number}. {gesture.sentence}"
        )
