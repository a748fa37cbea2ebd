"""`jaxpoint detect marker`: a session's videos and a few picked pixels to the tip of a coloured marker."""

from __future__ import annotations

import shlex
import sys
from collections import Counter
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from jaxpoint.commands.console import Console, table
from jaxpoint.commands.inputs import hush_opencv
from jaxpoint.commands.nothing_found import OF_THIS_ROOM, commonest
from jaxpoint.commands.options import Inline, Outcome, SeededOptions, at
from jaxpoint.config import Count, RoomConfig, Unit
from jaxpoint.config.person import MarkerSettings, PersonSettings
from jaxpoint.errors import InsufficientDataError
from jaxpoint.extras import extra

if TYPE_CHECKING:
    from jaxpoint.body.marker_tips import MarkerTip
    from jaxpoint.detection.person.marker_regions import MarkerModel
    from jaxpoint.evidence.marker_views import MarkerViews
    from jaxpoint.io.session import Session

_FAINT = "Pick more of the marker, in other light too, or widen --marker.deviations."


@dataclass(frozen=True, kw_only=True)
class DetectMarker(SeededOptions):
    """Find a coloured marker on a pointing finger in a session's videos, and its tip in the room.

    jaxpoint detect marker session/ --samples samples.csv --out marker-run

    Say in samples.csv (camera,frame,x,y and, if wanted, radius_px) where the marker lies in a few images; its colour is
    learnt there. It is looked for on people, so a recording of the empty room helps as it does for detect person.
    Without a calibration each view is looked at alone.
    """

    session: Annotated[Path, tyro.conf.Positional]
    """Folder of the session, or of its videos."""
    samples: Path
    """Where the marker lies in some images: camera,frame,x,y[,radius_px]; frame is the number of the frame."""
    calibration: Path | None = None
    """Calibration to use instead of the session's own: the folder of a run, or any that `jaxpoint convert` reads."""
    unit: Unit = None
    """Unit of a calibration that does not say it, as a .toml of other programs: m, cm or mm."""
    format: Literal["csv", "parquet"] = "csv"
    """Form of the tables; parquet needs pyarrow."""
    cache: Path | None = None
    """Folder in which what is found in videos is kept, by their content and the settings; by default the user's cache
    folder."""
    anew: bool = False
    """Look through the videos again, whatever was kept."""
    workers: Count = 0
    """Processes used, one camera each; 0 takes one per core."""
    settings: Annotated[PersonSettings, Inline] = field(default_factory=PersonSettings)
    marker: MarkerSettings = field(default_factory=MarkerSettings)

    @staticmethod
    def with_defaults(room: RoomConfig) -> DetectMarker:
        """The command's defaults under a configuration file."""
        return DetectMarker(
            session=tyro.MISSING,
            samples=tyro.MISSING,
            settings=room.detect.person,
            marker=room.detect.marker,
            runtime=room.runtime,
        )

    def run(self, console: Console) -> Outcome:
        """Write tables and a page of pictures into `--out`."""
        hush_opencv(self.verbose)
        from jaxpoint.body.marker_tips import marker_tips
        from jaxpoint.detection.person.marker_watch import learn_marker, watch_markers
        from jaxpoint.detection.person.session_watch import default_cache
        from jaxpoint.io.marker_samples import read_marker_samples
        from jaxpoint.io.session import open_session
        from jaxpoint.io.table import check_table_path

        out = self.needed_folder("marker-run")
        check_table_path(out / f"detections.{self.format}")
        session = open_session(self.session, self.calibration, self.unit)
        samples = read_marker_samples(self.samples, session, self.marker.sample_radius_px)
        model = learn_marker(session, samples, self.marker)
        kept = self.cache or default_cache()
        with console.progress() as progress:
            markers = watch_markers(
                session,
                model,
                self.settings,
                self.marker,
                cache=kept,
                anew=self.anew,
                workers=self.workers,
                progress=progress,
            )
        tips = None
        if session.rig is not None and len(session.names) > 1:
            tips = marker_tips(session.rig, markers, self.marker)
        missing: list[str] = []
        figures = _write(self, out, session, model, markers, tips, missing)
        return Outcome(figures, _lines(figures, out), _failure(figures), tuple(missing))


def _write(
    command: DetectMarker,
    out: Path,
    session: Session,
    model: MarkerModel,
    markers: tuple[MarkerViews, ...],
    tips: list[MarkerTip] | None,
    missing: list[str],
) -> dict[str, Any]:
    import numpy as np

    from jaxpoint.config import DetectSettings, to_toml
    from jaxpoint.io.table import write_table
    from jaxpoint.report.marker_page import write_marker_report
    from jaxpoint.report.marker_pictures import marker_sheets, track_of
    from jaxpoint.report.marker_tables import room_table, views_table
    from jaxpoint.runs import MARK, new_run, provenance, write_json

    figures = {"run": str(out), **_figures(command, session, model, markers, tips)}
    made = provenance(shlex.join(["jaxpoint", *sys.argv[1:]]), [*session.files, command.samples], command.seed)
    settings = to_toml(RoomConfig(detect=DetectSettings(person=command.settings, marker=command.marker)))

    def page(folder: Path) -> None:
        pictures: list[tuple[str, np.ndarray]] = []
        with extra("the pictures of report.html", missing):
            pictures = marker_sheets(session, markers, tips)
        with extra("report.html", missing):
            write_marker_report(
                folder / "report.html",
                figures,
                None if tips is None else track_of(session, tips),
                None if session.rig is None else np.asarray(session.rig.positions),
                pictures,
                made,
                settings,
            )

    with new_run(out, command.force, page) as folder:
        write_json(folder / MARK, made)
        write_json(folder / "metrics.json", figures)
        (folder / "config.toml").write_text(settings, encoding="utf-8")
        write_table(folder / f"detections.{command.format}", views_table(session, markers, tips))
        if tips is not None:
            write_table(folder / f"markers.{command.format}", room_table(session, tips))
    return figures


def _figures(
    command: DetectMarker,
    session: Session,
    model: MarkerModel,
    markers: tuple[MarkerViews, ...],
    tips: list[MarkerTip] | None,
) -> dict[str, Any]:
    from jaxpoint.detection.person.marker_regions import is_mixture
    from jaxpoint.report.marker_tables import why
    from jaxpoint.report.notes import merged_notes

    cameras = []
    for name, own in zip(session.names, markers):
        reasons = Counter(why(own, frame) for frame in range(len(own.reasons)))
        cameras.append({"name": name, "frames": len(own.reasons), "found": reasons.pop("found", 0), "reasons": reasons})
    notes = merged_notes([*session.notes, *(note for own in markers for note in own.notes)])
    if is_mixture(model, command.marker):
        notes.append(
            "The samples seem to hold several colours: the gates of hue, saturation and value "
            f"({model.hue_gate:g}, {model.saturation_gate:g}, {model.value_gate:g}) are as wide as they go. Pick the "
            "marker's middle, with a smaller radius_px."
        )
    figures: dict[str, Any] = {
        "moments": len(session.frame_ids),
        "model": asdict(model),
        "cameras": cameras,
        "in_room": None,
        "notes": notes,
    }
    if tips is not None:
        reasons = Counter(tip.reason.name.lower() for tip in tips if not tip.found)
        figures["in_room"] = {"tips": sum(tip.found for tip in tips), "reasons": reasons}
    return figures


def _lines(figures: dict[str, Any], out: Path) -> tuple[str, ...]:
    rows = [
        (camera["name"], f"{camera['found']}/{camera['frames']}", _counts(camera["reasons"]))
        for camera in figures["cameras"]
    ]
    lines = table(("camera", "marker in", "other frames"), rows)
    room = figures["in_room"]
    if room is None:
        lines += ("No tips in the room: these need a calibration (--calibration) and two cameras or more.",)
    else:
        others = f"; others: {_counts(room['reasons'])}" if room["reasons"] else ""
        lines += (f"Tips in the room: {room['tips']} of {figures['moments']} frames{others}.",)
    return (*lines, *figures["notes"], f"Tables: {out}", *at("Report", out / "report.html"))


def _counts(reasons: dict[str, int]) -> str:
    return ", ".join(f"{count} {reason}" for reason, count in reasons.items())


def _failure(figures: dict[str, Any]) -> InsufficientDataError | None:
    cameras, room = figures["cameras"], figures["in_room"]
    found = [camera["found"] for camera in cameras if camera["found"]]
    if not found:
        return InsufficientDataError(
            f"The marker was found in none of {figures['moments']} frames of {len(cameras)} cameras; the table says "
            f"what each frame held, {commonest(cameras, _FAINT)}"
        )
    if room is None or room["tips"]:
        return None
    return InsufficientDataError(
        f"The marker has no tip in the room in any of {figures['moments']} frames ({_counts(room['reasons'])}), though"
        f" {len(found)} of {len(cameras)} cameras show it in {sum(found)} images. {OF_THIS_ROOM} {_FAINT}"
    )
