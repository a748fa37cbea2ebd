"""`jaxpoint demo`: the whole job on the session that lies in the package, from pixels to named objects."""

from __future__ import annotations

import csv
import os
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from jaxpoint.commands.console import Console, Progress
from jaxpoint.commands.inputs import hush_opencv
from jaxpoint.commands.options import Outcome, SeededOptions, at
from jaxpoint.config import Count, RoomConfig, load_config
from jaxpoint.config.pointing import PointSettings, RoomExtent
from jaxpoint.errors import QualityError
from jaxpoint.extras import extra

if TYPE_CHECKING:
    from jaxpoint.calibration.result import Calibration
    from jaxpoint.pointing.pipeline import SessionAnswers

INTRO = (
    "Nobody told the program where the cameras are, what lenses they have, or who points at what. It saw a light waved "
    "through the dark room, from which it worked out the cameras; their places, measured by tape, put them into the "
    "room. Then it watched the people, found {gestures} gestures, and named what each of them means.",
    "The room is simulated, so the truth is known: {right} of {all} answers are right. The cameras were placed within "
    "{apart:.0f} mm of where they are; the tape alone misses by {tape:.0f} mm.",
)


@dataclass(frozen=True, kw_only=True)
class Demo(SeededOptions):
    """From pixels to named objects, on a small simulated session that lies in the package.

    jaxpoint demo --out demo-run

    A light is waved, the cameras are calibrated and aligned, people are found, their gestures measured, and what they
    point at is named and held against the truth. The first run takes a minute or three; what it compiled and found is
    kept in the user's cache folder.
    """

    open: bool = False
    """Show the report in the browser, where there is a screen."""
    workers: Count = 0
    """Processes used, one camera each; 0 takes one per core."""
    cache: Path | None = None
    """Folder in which what is found in videos is kept; by default the user's cache folder."""
    room: tyro.conf.Suppress[RoomConfig] = field(default_factory=RoomConfig)

    @staticmethod
    def with_defaults(room: RoomConfig) -> Demo:
        """The command's defaults under a configuration file."""
        return Demo(out=Path("demo-run"), room=room, runtime=room.runtime)

    def run(self, console: Console) -> Outcome:
        """The answers, with what the truth says about them."""
        hush_opencv(self.verbose)
        from jaxpoint.commands.point import check_settings

        check_settings(self.room.point)
        out = self.needed_folder("demo-run")
        with embedded_session() as session, console.progress() as progress:
            outcome = self._answered(session, out, progress)
        page = (out / "report.html").absolute()
        if (
            self.open
            and page.exists()
            and (os.name == "nt" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
        ):
            with extra("the report in the browser", []):
                webbrowser.open(page.as_uri())
        return outcome

    def _answered(self, session: Path, out: Path, progress: Progress) -> Outcome:
        from jaxpoint.commands.answers_folder import write_answers
        from jaxpoint.commands.point import Point, answer_lines
        from jaxpoint.io.exchange import read_calibration
        from jaxpoint.runs import save_run

        calibration = self._calibrated(session, progress)
        point = Point(
            session=session,
            seed=self.seed,
            force=self.force,
            cache=self.cache,
            workers=self.workers,
            settings=self._settings(session),
            person=self.room.detect.person,
            track=self.room.track,
        )
        opened, following, pointed = point.find_answers(progress, calibration)
        meant, missed = true_targets(session / "truth" / "gestures.csv", pointed)
        right = sum(answer.name == meant.get(answer.number) for answer in pointed.answers)
        true_rig = read_calibration(session / "calibration.json").rig
        apart = _apart_mm(calibration, true_rig)
        told = {
            "gestures": len(pointed.answers),
            "right": right,
            "all": len(meant) + len(missed),
            "apart": apart,
            "tape": _tape_mm(session / "camera_centres.csv", true_rig),
        }
        notes = tuple(f"Nothing was answered where somebody pointed at {name}." for name in missed)
        more = len(pointed.answers) - len(meant)
        notes += (f"{more} of {len(pointed.answers)} answers are to no gesture.",) if more else ()
        missing: list[str] = []

        def cameras(folder: Path) -> Callable[[Path, list[str]], None]:
            report = save_run(folder / "calibration", calibration, self.room, command="jaxpoint demo")
            return lambda place, notes: report(place / "calibration", notes)

        figures = write_answers(
            point,
            out,
            opened,
            following,
            replace(pointed, notes=(*pointed.notes, *notes)),
            missing,
            truth=meant,
            intro=[text.format(**told) for text in INTRO],
            tiles=[(f"{right} of {told['all']}", "named right"), (f"{apart:.0f} mm", "cameras off the truth")],
            links=[("How the cameras were found", "calibration/report.html")],
            more=cameras,
            title="From pixels to what people point at",
            kind="jaxpoint demo",
        )
        figures |= {"right": right, "all": told["all"], "camera_mm": apart, "report": str(out / "report.html")}
        lines = (
            f"Calibrated from a waved light: mean error {_mean_px(calibration):.2f} px, cameras {apart:.0f} mm from "
            "where they are.",
            *answer_lines(pointed, meant),
            *notes,
            f"{right} of {told['all']} answers are right.",
            *at("Report", out / "report.html"),
        )
        failure = None if right else QualityError(f"0 of {told['all']} gestures were answered right; please report it.")
        return Outcome(figures, lines, failure, tuple(missing))

    def _settings(self, session: Path) -> PointSettings:
        """How it is asked; the room is the session's own where none is given."""
        settings = self.room.point
        if settings.room != RoomExtent():
            return settings
        return replace(settings, room=load_config(session / "session.toml").point.room)

    def _calibrated(self, session: Path, progress: Progress) -> Calibration:
        """The cameras in the room, from the waved light and the places measured by tape."""
        from jaxpoint.calibration.selfcal import calibrate
        from jaxpoint.commands.align import align
        from jaxpoint.config import AlignSettings
        from jaxpoint.detection.light.led import detect_led
        from jaxpoint.io.files import natural_key
        from jaxpoint.io.session import recordings

        waved = recordings(session / "wave")
        names = sorted(waved, key=natural_key)
        lights = replace(self.room.detect.led, workers=self.workers)
        detection = detect_led([waved[name] for name in names], lights, progress, names)
        solved = calibrate(detection.tracks, replace(self.room.calibrate, seed=self.seed), progress=progress)
        return align(solved, AlignSettings(camera_centres=session / "camera_centres.csv"))


@contextmanager
def embedded_session() -> Iterator[Path]:
    """The folder of the session that lies in the package."""
    from importlib.resources import as_file, files

    with as_file(files("jaxpoint") / "data" / "session") as folder:
        yield folder


def true_targets(path: Path, pointed: SessionAnswers) -> tuple[dict[int, str], list[str]]:
    """What is meant, by the number of the answer, and what was meant where there is no answer."""
    with path.open(encoding="utf-8", newline="") as file:
        gestures = list(csv.DictReader(file))
    meant, missed = {}, []
    for gesture in gestures:
        first, last = int(gesture["first_frame"]), int(gesture["last_frame"])
        held = (int(gesture["hold_first"]) + int(gesture["hold_last"])) / 2
        own = [answer for answer in pointed.answers if first <= answer.frame <= last]
        if own:
            meant[min(own, key=lambda answer: abs(answer.frame - held)).number] = gesture["target"]
        else:
            missed.append(gesture["target"])
    return meant, missed


def _apart_mm(calibration: Calibration, true_rig) -> float:
    """How far the cameras are from where they are, mean."""
    import numpy as np

    order = [true_rig.names.index(name) for name in calibration.rig.names]
    apart = np.asarray(calibration.rig.positions) - np.asarray(true_rig.positions)[order]
    return float(1e3 * np.linalg.norm(apart, axis=1).mean())


def _tape_mm(path: Path, true_rig) -> float:
    """How far the measured places are from where the cameras are, mean."""
    import numpy as np

    from jaxpoint.io.survey_files import read_camera_centres

    known = read_camera_centres(path, true_rig.names)
    return float(1e3 * np.linalg.norm(known.points - np.asarray(true_rig.positions), axis=1).mean())


def _mean_px(calibration: Calibration) -> float:
    from jaxpoint.metrics import metrics

    return metrics(calibration, None)["reprojection"]["mean_px"]
