"""`jaxpoint point`: what people in a session point at."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from jaxpoint.commands.console import Console, Progress
from jaxpoint.commands.inputs import hush_opencv
from jaxpoint.commands.options import Inline, Outcome, SeededOptions, at
from jaxpoint.config import Count, Fraction, RoomConfig, Unit
from jaxpoint.config.person import PersonSettings
from jaxpoint.config.pointing import PointSettings
from jaxpoint.config.track import TrackSettings
from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.extras import extra

if TYPE_CHECKING:
    from jaxpoint.body.following import Following
    from jaxpoint.calibration.result import Calibration
    from jaxpoint.io.session import Session
    from jaxpoint.pointing.pipeline import SessionAnswers


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
    """Calibration to use instead of the session's own: the folder of a run, or any that `jaxpoint convert` reads."""
    unit: Unit = None
    """Unit of a calibration that does not say it, as a .toml of other programs: m, cm or mm."""
    landmarks: Path | None = None
    """What a pose estimator found, instead of the images: CSV, as `detect person --landmarks` takes it."""
    min_confidence: Fraction = 0.3
    """Landmarks below are left out."""
    detector: str = "auto"
    """What finds people: silhouettes, landmarks, or a detector of yours as module:function; auto takes landmarks where
    a file of them is given, and else silhouettes."""
    times: Path | None = None
    """CSV of gestures, `start_s,end_s`; they are looked for without it."""
    words: Path | None = None
    """CSV of what was said, `word,start_s,end_s`: "this" and its like pair with gestures, names count as evidence."""
    bias: Path | None = None
    """bias.toml of `bias fit`: how far people's lines miss, to be taken off."""
    speak: bool = False
    """Say the answers aloud; needs espeak-ng."""
    follow: bool = False
    """Print one JSON line a gesture on standard output as soon as all are answered, for a robot; nothing else."""
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
        from jaxpoint.commands.answers_folder import write_answers
        from jaxpoint.io.table import check_table_path
        from jaxpoint.report.answer_text import as_json, check_speaker

        out = self.needed_folder("answers")
        check_table_path(out / f"gestures.{self.format}")
        check_settings(self.settings)
        if self.speak:
            check_speaker()
        with console.progress() as progress:
            session, following, pointed = self.find_answers(progress)
        missing: list[str] = []
        with extra("the answers on standard output", missing):  # a robot waits for them; who reads them may have gone
            if self.follow:
                console.say([json.dumps(as_json(answer), allow_nan=False) for answer in pointed.answers])
            else:
                console.say([*answer_lines(pointed), *pointed.notes])
        figures = write_answers(self, out, session, following, pointed, missing)
        with extra("the voice", missing):
            self._speak(pointed)
        lines = () if self.follow else (f"Tables: {out}", *at("Report", out / "report.html"))
        return Outcome(figures, lines, missing=() if self.follow else tuple(missing))

    def _speak(self, pointed: SessionAnswers) -> None:
        """Say the answers where that is wanted."""
        from jaxpoint.report.answer_text import sentence, speak

        for answer in pointed.answers if self.speak else ():
            speak(sentence(answer))

    def find_answers(
        self, progress: Progress, calibration: Calibration | None = None
    ) -> tuple[Session, Following, SessionAnswers]:
        """Session, arms and answers; nothing is written. A calibration that was just made goes before a file's."""
        from jaxpoint.body.following import follow
        from jaxpoint.commands.nothing_found import nobody_followed, remedy_of_heights
        from jaxpoint.detection.person.detectors import PeopleRequest, detect_people
        from jaxpoint.detection.person.session_watch import default_cache
        from jaxpoint.io.bias_files import read_bias
        from jaxpoint.io.exchange import read_calibration
        from jaxpoint.io.object_scene import read_scene
        from jaxpoint.io.session import check_session, open_session
        from jaxpoint.io.speech import read_times, read_words
        from jaxpoint.pointing.line_hypotheses import correction_of
        from jaxpoint.pointing.pipeline import answer_gestures, room_of
        from jaxpoint.report.notes import merged_notes

        session = open_session(self.session, self.calibration, self.unit)
        check_session(session)
        assert session.rig is not None
        scene, database = read_scene(self._objects_file(), room_of(self.settings.room))
        correction = None if self.bias is None else correction_of(read_bias(self.bias))
        times = None if self.times is None else read_times(self.times)
        words = () if self.words is None else read_words(self.words)
        if calibration is None:
            saved = read_calibration(self.calibration or self.session / "calibration.json")
            known, covariance = saved.rig.names, saved.covariance
        else:
            known, covariance = calibration.rig.names, calibration.camera_covariance
            rig = calibration.rig.select([known.index(name) for name in session.names])
            session = replace(session, rig=rig, calibration=None)
            assert session.rig is not None
        request = PeopleRequest(
            session, self.person, self.landmarks, self.min_confidence, self.cache or default_cache(), self.anew,
            self.workers, progress,
        )  # fmt: skip
        views = detect_people(request, self.detector)
        following = follow(
            session.rig, views, session.times, self.track, frame_ids=session.frame_ids, progress=progress
        )
        if not len(following.tracking.heads.people):
            heads = [int(view.head_found.sum()) for view in views]
            raise nobody_followed(heads, self.track, remedy_of_heights(session, views, self.track))
        found = answer_gestures(
            session.rig,
            following,
            scene,
            self.settings,
            times=times,
            words=words,
            camera_covariance=_in_order(covariance, known, session.names),
            correction=correction,
            notes=merged_notes([*session.notes, *database.warnings, *(note for view in views for note in view.notes)]),
        )
        return session, following, found

    def inputs(self, session: Session) -> list[Path]:
        """All files that the answers were made from."""
        given = (self.bias, self.times, self.words, self.landmarks)
        return [*session.files, self._objects_file(), *(path for path in given if path is not None)]

    def _objects_file(self) -> Path:
        if self.objects is not None:
            return self.objects
        own = self.session / "objects.csv"
        if not own.is_file():
            raise FileFormatError(f"'{self.session}' has no objects.csv; say by --objects what can be pointed at.")
        return own


def check_settings(settings: PointSettings) -> None:
    """Refuse a room of no extent, and weights that make no line.

    Raises:
        UsageError: as `room_of`; or there are no weights, or one is of a line that does not exist.
    """
    from jaxpoint.pointing.pipeline import room_of
    from jaxpoint.pointing.pointing_line import weights_of

    room_of(settings.room)
    if settings.line != "blend":
        return
    try:
        weights_of(settings.blend)
    except ValueError as error:
        raise UsageError(f"{error} Give them in [point.blend] of the file of --config.") from None


def answer_lines(pointed: SessionAnswers, truth: Mapping[int, str] | None = None) -> tuple[str, ...]:
    """A line an answer, for a person who reads the terminal; with the truth where it is known."""
    from jaxpoint.report.answer_text import sentence

    lines = []
    for answer in pointed.answers:
        meant = (truth or {}).get(answer.number)
        verdict = "" if meant is None else " (right)" if meant == answer.name else f" (wrong: {meant})"
        sure = f"{100 * answer.probability:3.0f} %"
        lines.append(
            f"{answer.number:3d}  {answer.time_s:6.1f} s  person {answer.person}  {sure}  {sentence(answer)}{verdict}"
        )
    return tuple(lines)


def _in_order(covariance: Any, known: Sequence[str], names: Sequence[str]) -> Any:
    """A covariance of all cameras of a file as one of those of the session, in its order."""
    if covariance is None:
        return None
    import numpy as np

    size = len(covariance) // len(known)  # parameters a camera
    rows = np.concatenate([size * known.index(name) + np.arange(size) for name in names])
    return covariance[np.ix_(rows, rows)]
