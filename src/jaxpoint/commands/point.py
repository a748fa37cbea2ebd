"""`jaxpoint point`: what people in a session point at."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from jaxpoint.commands.console import Console, Progress, table
from jaxpoint.commands.inputs import hush_opencv
from jaxpoint.commands.options import Inline, Outcome, SeededOptions
from jaxpoint.config import Count, RoomConfig
from jaxpoint.config.person import PersonSettings
from jaxpoint.config.point import PointSettings
from jaxpoint.config.track import TrackSettings
from jaxpoint.errors import FileFormatError

if TYPE_CHECKING:
    from jaxpoint.answer.pipeline import Pointed
    from jaxpoint.io.session import Session
    from jaxpoint.person.following import Following


@dataclass(frozen=True, kw_only=True)
class Point(SeededOptions):
    """Say what the people in a session point at: their gestures, lines, and the objects that are meant.

    jaxpoint point session/ --objects session/objects.csv --out answers

    The session is that of `detect person`, with a calibration in metres. Gestures are arms that are stretched out and
    held; or give their times, or words with times.
    """

    session: Annotated[Path, tyro.conf.Positional]
    """Folder of the session."""
    objects: Path | None = None
    """What can be pointed at, a .csv or .toml; by default the session's own objects.csv."""
    calibration: Path | None = None
    """Calibration to use instead of the session's own: a calibration.json or the folder of a run."""
    times: Path | None = None
    """CSV of gestures, `start_s,end_s`; they are looked for without it."""
    words: Path | None = None
    """CSV of what was said, `word,start_s,end_s`: "this" and its like pair with gestures, names count as evidence."""
    speak: bool = False
    """Say the answers aloud; needs espeak-ng."""
    follow: bool = False
    """Print one JSON line a gesture on standard output, for a robot; nothing else."""
    format: Literal["csv", "parquet"] = "csv"
    """Form of the table; parquet needs pyarrow."""
    cache: Path | None = None
    """Folder in which what is found in videos is kept; by default the user's cache folder."""
    anew: bool = False
    """Look through the videos again, whatever was kept."""
    workers: Count = 0
    """Processes used, one camera each; 0 takes one per core."""
    settings: Annotated[PointSettings, Inline] = field(default_factory=PointSettings)
    person: PersonSettings = field(default_factory=PersonSettings)
    track: TrackSettings = field(default_factory=TrackSettings)

    @staticmethod
    def with_defaults(room: RoomConfig) -> Point:
        """The command's defaults under a configuration file."""
        return Point(
            session=tyro.MISSING,
            settings=room.point,
            person=room.detect.person,
            track=room.track,
            runtime=room.runtime,
        )

    def run(self, console: Console) -> Outcome:
        """Write gestures, pictures and a page into `--out`."""
        hush_opencv(self.verbose)
        from jaxpoint.answer.sentence import as_json, check_speaker, sentence, speak
        from jaxpoint.io.table import check_table_path
        from jaxpoint.runs import check_out

        out = self.needed_out("answers")
        check_out(out, self.force)
        check_table_path(out / f"gestures.{self.format}")
        if self.speak:
            check_speaker()
        with console.progress() as progress:
            session, following, pointed = self.answered(progress)
            figures = write_answers(self, out, session, following, pointed)
        if self.follow:
            lines = tuple(json.dumps(as_json(answer), allow_nan=False) for answer in pointed.answers)
        else:
            lines = (*answer_lines(pointed), *pointed.notes, f"Tables: {out}", f"Report: {out / 'report.html'}")
        if self.speak:
            for answer in pointed.answers:
                speak(sentence(answer))
        return Outcome(figures, lines)

    def answered(self, progress: Progress) -> tuple[Session, Following, Pointed]:
        """Session, arms and answers; nothing is written."""
        from jaxpoint.answer.pipeline import check_session, pointed, scene_of
        from jaxpoint.answer.words import read_times, read_words
        from jaxpoint.io.calibration import read_calibration
        from jaxpoint.io.session import open_session
        from jaxpoint.person.following import follow
        from jaxpoint.person.recording import default_cache, watch_session

        session = open_session(self.session, self.calibration)
        check_session(session)
        assert session.rig is not None
        scene, _ = scene_of(self._objects_file())
        times = None if self.times is None else read_times(self.times)
        words = () if self.words is None else read_words(self.words)
        saved = read_calibration(self.calibration or self.session / "calibration.json")
        views = watch_session(
            session,
            self.person,
            cache=self.cache or default_cache(),
            anew=self.anew,
            workers=self.workers,
            progress=progress,
        )
        following = follow(
            session.rig, views, session.times, self.track, frame_ids=session.moments, progress=progress
        )
        covariance = _in_order(saved.covariance, saved.rig.names, session.names)
        found = pointed(
            session, following, scene, self.settings, times=times, words=words, camera_covariance=covariance
        )
        return session, following, found

    def _objects_file(self) -> Path:
        if self.objects is not None:
            return self.objects
        own = self.session / "objects.csv"
        if not own.is_file():
            raise FileFormatError(f"'{self.session}' has no objects.csv; say by --objects what can be pointed at.")
        return own


def answer_lines(pointed: Pointed) -> tuple[str, ...]:
    """A table for a person who reads the terminal."""
    from jaxpoint.answer.sentence import sentence

    rows = [
        (str(answer.number), f"{answer.time_s:.1f} s", str(answer.person), f"{100 * answer.probability:.0f} %", sentence(answer))
        for answer in pointed.answers
    ]  # fmt: skip
    return tuple(line.rstrip() for line in table(("gesture", "time", "person", "sure", "answer"), rows))


def write_answers(
    command: Any,
    out: Path,
    session: Session,
    following: Following,
    pointed: Pointed,
    *,
    truth: Mapping[int, str] | None = None,
    intro: Sequence[str] = (),
    tiles: Sequence[tuple[str, str]] = (),
    more: Callable[[Path], None] | None = None,
) -> dict[str, Any]:
    """The folder of answers, whole or not at all, and its figures.

    Args:
        command: with `session`, `seed`, `force`, `settings`, `person` and `track`.
        truth: what is meant, by the number of the gesture.
        intro, tiles: more for the page.
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
    made = provenance(shlex.join(["jaxpoint", *sys.argv[1:]]), [command.session], command.seed)
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
        write_table(folder / f"gestures.{getattr(command, 'format', 'csv')}", gestures_table(pointed.answers))
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
            provenance=made,
            config_text=to_toml(config),
        )
    return figures


def _write_pictures(folder: Path, shown: Sequence[Any]) -> None:
    import cv2

    folder.mkdir()
    for gesture in shown:
        cv2.imwrite(str(folder / f"gesture_{gesture.number}.jpg"), gesture.sheet[..., ::-1])


def _in_order(covariance: Any, known: Sequence[str], names: Sequence[str]) -> Any:
    """A covariance of all cameras of a file as one of those of the session, in its order."""
    if covariance is None:
        return None
    import numpy as np

    rows = np.concatenate([15 * known.index(name) + np.arange(15) for name in names])
    return covariance[np.ix_(rows, rows)]
