"""What `point` and `demo` share: the folder of answers."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxpoint.config import RoomConfig
from jaxpoint.extras import extra

if TYPE_CHECKING:
    from jaxpoint.body.following import Following
    from jaxpoint.commands.point import Point
    from jaxpoint.io.session import Session
    from jaxpoint.pointing.pipeline import SessionAnswers
    from jaxpoint.report.pointing_page import GestureEntry


def write_answers(
    command: Point,
    out: Path,
    session: Session,
    following: Following,
    pointed: SessionAnswers,
    missing: list[str] | None = None,
    *,
    truth: Mapping[int, str] | None = None,
    intro: Sequence[str] = (),
    links: Sequence[tuple[str, str]] = (),
    tiles: Sequence[tuple[str, str]] = (),
    more: Callable[[Path], Callable[[Path, list[str]], None]] | None = None,
    title: str = "What was pointed at",
    kind: str = "jaxpoint point",
) -> dict[str, Any]:
    """The folder of answers, whole or not at all, then its pictures and its page; returns its figures.

    Args:
        command: its settings.
        missing: takes a sentence for each picture or page that could not be made.
        truth: what is meant, by the number of the gesture.
        intro, links, tiles, title, kind: of the page.
        more: writes what else belongs into the folder, and returns what writes its pages into the folder's last place.
    """
    from jaxpoint.config import DetectSettings, to_toml
    from jaxpoint.io.table import write_table
    from jaxpoint.report.answer_text import as_json
    from jaxpoint.report.gesture_pictures import HEADER, gesture_entries, images_of, room_scene
    from jaxpoint.report.gesture_table import gestures_table
    from jaxpoint.report.pointing_page import write_pointing_report
    from jaxpoint.runs import MARK, new_run, provenance, write_json

    assert session.rig is not None
    made = provenance(shlex.join(["jaxpoint", *sys.argv[1:]]), command.inputs(session), command.seed)
    config = RoomConfig(detect=DetectSettings(person=command.person), track=command.track, point=command.settings)
    gestures = [as_json(answer) for answer in pointed.answers]
    figures: dict[str, Any] = {"gestures": gestures, "notes": list(pointed.notes), "moments": len(session.frame_ids)}
    if truth is not None:
        figures["truth"] = [truth.get(answer.number) for answer in pointed.answers]
    notes = [] if missing is None else missing
    pages: list[Callable[[Path, list[str]], None]] = []

    def show(folder: Path) -> None:
        for write in pages:
            write(folder, notes)
        shown: list[GestureEntry] = []
        with extra("pictures and report.html", notes):
            shown = gesture_entries(session, following, pointed, images_of(session, pointed.frames), truth, notes)
        if shown:
            _write_pictures(folder / "pictures", shown, notes)
            with extra("report.html", notes):
                page(folder / "report.html", shown)

    def page(path: Path, shown: Sequence[GestureEntry]) -> None:
        assert session.rig is not None
        sure = sum(not answer.ambiguous for answer in pointed.answers)
        write_pointing_report(
            path,
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

    with new_run(out, command.force, show) as folder:
        write_json(folder / MARK, made)
        write_json(folder / "metrics.json", figures)
        write_json(folder / "gestures.json", gestures)
        (folder / "config.toml").write_text(to_toml(config), encoding="utf-8")
        write_table(folder / f"gestures.{command.format}", gestures_table(pointed.answers))
        if more is not None:
            pages.append(more(folder))
    return figures


def _write_pictures(folder: Path, shown: Sequence[GestureEntry], missing: list[str]) -> None:
    from jaxpoint.report.pointing_sheet import save_sheet

    for gesture in shown:
        if gesture.sheet is None:
            continue
        name = f"gesture_{gesture.number}.jpg"
        with extra(f"pictures/{name}", missing):
            folder.mkdir(exist_ok=True)
            save_sheet(folder / name, gesture.sheet, f"Gesture {gesture.number}. {gesture.sentence}")
