"""`jaxpoint detect person`: a session's videos to people, their heads and their pointing arms."""

from __future__ import annotations

import shlex
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from jaxpoint.commands.console import Console, table
from jaxpoint.commands.inputs import hush_opencv
from jaxpoint.commands.nothing_found import OF_THIS_ROOM, commonest, nobody_followed, remedy_of_heights
from jaxpoint.commands.options import Inline, Outcome, SeededOptions, at
from jaxpoint.config import Count, Fraction, RoomConfig, Unit
from jaxpoint.config.person import PersonSettings
from jaxpoint.config.track import TrackSettings
from jaxpoint.errors import InsufficientDataError
from jaxpoint.extras import extra

if TYPE_CHECKING:
    from jaxpoint.body.following import Following, Progress
    from jaxpoint.evidence.camera_evidence import AbstractCameraEvidence
    from jaxpoint.io.session import Session


@dataclass(frozen=True, kw_only=True)
class DetectPerson(SeededOptions):
    """Find the people in a session's videos: silhouettes, heads, head tracks, and the arm that each stretches out.

    jaxpoint detect person session/ --out person-run

    The session is a folder with videos/cam_0.mp4, ..., calibration.json, and, better, empty/cam_0.mp4, ... of the empty
    room. Without a calibration each view is looked at alone. What was found is kept, and not looked for again in videos
    that did not change.
    """

    session: Annotated[Path, tyro.conf.Positional]
    """Folder of the session, or of its videos."""
    calibration: Path | None = None
    """Calibration to use instead of the session's own: the folder of a run, or any that `jaxpoint convert` reads."""
    unit: Unit = None
    """Unit of a calibration that does not say it, as a .toml of other programs: m, cm or mm."""
    landmarks: Path | None = None
    """What a pose estimator found, instead of the images: a CSV file with frame, camera, name, x, y, confidence, and
    person where there are several."""
    min_confidence: Fraction = 0.3
    """Landmarks below are left out."""
    detector: str = "auto"
    """What finds people: silhouettes, landmarks, or a detector of yours as module:function; auto takes landmarks where
    a file of them is given, and else silhouettes."""
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
    track: TrackSettings = field(default_factory=TrackSettings)

    @staticmethod
    def with_defaults(room: RoomConfig) -> DetectPerson:
        """The command's defaults under a configuration file."""
        return DetectPerson(session=tyro.MISSING, settings=room.detect.person, track=room.track, runtime=room.runtime)

    def run(self, console: Console) -> Outcome:
        """Write tables, head tracks and a page of pictures into `--out`."""
        hush_opencv(self.verbose)
        from jaxpoint.io.session import open_session
        from jaxpoint.io.table import check_table_path

        out = self.needed_folder("person-run")
        check_table_path(out / f"detections.{self.format}")
        session = open_session(self.session, self.calibration, self.unit)
        with console.progress() as progress:
            views, following = _seen(self, session, progress)
        missing: list[str] = []
        figures = _write(self, out, session, views, following, missing)
        failure = _failure(self, figures, _remedy(self, session, views, following))
        return Outcome(figures, _lines(figures, out), failure, tuple(missing))


def _seen(
    command: DetectPerson, session: Session, progress: Progress
) -> tuple[tuple[AbstractCameraEvidence, ...], Following | None]:
    """What the views show of people, and who is where."""
    from jaxpoint.body.following import follow
    from jaxpoint.detection.person.detectors import PeopleRequest, detect_people
    from jaxpoint.detection.person.session_watch import default_cache

    request = PeopleRequest(
        session, command.settings, command.landmarks, command.min_confidence, command.cache or default_cache(),
        command.anew, command.workers, progress,
    )  # fmt: skip
    views = detect_people(request, command.detector)
    if session.rig is None or len(session.names) < 2:
        return views, None
    following = follow(session.rig, views, session.times, command.track, frame_ids=session.frame_ids, progress=progress)
    return views, following


def _write(
    command: DetectPerson,
    out: Path,
    session: Session,
    views: tuple[AbstractCameraEvidence, ...],
    following: Following | None,
    missing: list[str],
) -> dict[str, Any]:
    import numpy as np

    from jaxpoint.config import DetectSettings, to_toml
    from jaxpoint.io.head_files import save_heads
    from jaxpoint.io.table import write_table
    from jaxpoint.report.people_page import write_people_report
    from jaxpoint.report.people_pictures import sheets
    from jaxpoint.report.people_tables import arms_table, detections_table
    from jaxpoint.runs import MARK, new_run, provenance, write_json

    figures = _figures(session, views, following)
    inputs = [*session.files, *([command.landmarks] if command.landmarks else [])]
    made = provenance(shlex.join(["jaxpoint", *sys.argv[1:]]), inputs, command.seed)
    settings = to_toml(RoomConfig(detect=DetectSettings(person=command.settings), track=command.track))

    def page(folder: Path) -> None:
        pictures: list[tuple[str, np.ndarray]] = []
        with extra("the pictures of report.html", missing):
            pictures = sheets(session, views, following)
        with extra("report.html", missing):
            write_people_report(
                folder / "report.html",
                figures,
                None if following is None else following.tracking.heads,
                None if session.rig is None else np.asarray(session.rig.positions),
                pictures,
                made,
                settings,
            )

    with new_run(out, command.force, page) as folder:
        write_json(folder / MARK, made)
        write_json(folder / "metrics.json", figures)
        (folder / "config.toml").write_text(settings, encoding="utf-8")
        write_table(folder / f"detections.{command.format}", detections_table(session, views, following))
        if following is not None:
            save_heads(folder / "heads.csv", following.tracking.heads)
            write_table(folder / f"arms.{command.format}", arms_table(session, following))
    return figures


def _figures(
    session: Session, views: tuple[AbstractCameraEvidence, ...], following: Following | None
) -> dict[str, Any]:
    from jaxpoint.evidence.camera_evidence import FrameReason
    from jaxpoint.report.notes import merged_notes

    cameras = []
    for name, view in zip(session.names, views):
        reasons = Counter(FrameReason(int(reason)).name.lower() for reason in view.reasons)
        cameras.append(
            {
                "name": name,
                "frames": len(view.reasons),
                "with_person": reasons.pop("person", 0),
                "heads": int(view.head_found.sum()),
                "without_colour": int(view.colourless.sum()),
                "reasons": dict(reasons),
            }
        )
    people = []
    if following is not None:
        heads = following.tracking.heads
        for person, number in enumerate(heads.people.tolist()):
            found = [arm is not None for (_, who), arm in following.arms.items() if who == person]
            people.append({"person": number, "moments": int(heads.present[:, person].sum()), "arms": sum(found)})
    notes = merged_notes([*session.notes, *(note for view in views for note in view.notes)])
    return {
        "moments": len(session.frame_ids),
        "cameras": cameras,
        "people": people,
        "followed": following is not None,
        "notes": notes,
    }


def _lines(figures: dict[str, Any], out: Path) -> tuple[str, ...]:
    rows = [
        (
            camera["name"],
            f"{camera['with_person']}/{camera['frames']}",
            camera["heads"],
            ", ".join(f"{count} {why}" for why, count in camera["reasons"].items()),
        )
        for camera in figures["cameras"]
    ]
    lines = table(("camera", "person in", "heads", "other frames"), rows)
    for person in figures["people"]:
        lines += (f"Person {person['person']}: {person['moments']} frames, the arm in {person['arms']}.",)
    if not figures["followed"]:
        lines += ("No head tracks and arms: these need a calibration (--calibration) and two cameras or more.",)
    return (*lines, *figures["notes"], f"Tables: {out}", *at("Report", out / "report.html"))


def _remedy(
    command: DetectPerson, session: Session, views: tuple[AbstractCameraEvidence, ...], following: Following | None
) -> str:
    """What helps where nobody could be followed."""
    if following is None or len(following.tracking.heads.people):
        return OF_THIS_ROOM
    return remedy_of_heights(session, views, command.track)


def _failure(
    command: DetectPerson, figures: dict[str, Any], remedy: str = OF_THIS_ROOM
) -> InsufficientDataError | None:
    cameras = figures["cameras"]
    if not any(camera["with_person"] for camera in cameras):
        nobody = f"Nobody was found in {figures['moments']} frames of {len(cameras)} cameras; "
        if command.landmarks is not None:
            return InsufficientDataError(f"{nobody}lower --min-confidence, which is {command.min_confidence:g}.")
        return InsufficientDataError(f"{nobody}the table says what each frame held, {commonest(cameras)}")
    if figures["people"] or not figures["followed"]:
        return None
    heads = [camera["heads"] for camera in cameras]
    if sum(count > 0 for count in heads) < 2:
        return _why_unfollowed(command, cameras)
    return nobody_followed(heads, command.track, remedy)


def _why_unfollowed(command: DetectPerson, cameras: Sequence[Mapping[str, Any]]) -> InsufficientDataError:
    """Why nobody could be followed: no heads at all, heads of one view only, or heads that do not agree."""
    heads = [camera["heads"] for camera in cameras if camera["heads"]]
    failed = (
        f"Nobody could be followed in the room: {sum(heads)} heads were seen by {len(heads)} of {len(cameras)} cameras"
    )
    if not heads and command.landmarks is not None:
        return InsufficientDataError(
            f"{failed}; give landmarks of heads too: 'head', both ears, or 'nose' and both eyes."
        )
    if not heads:
        return InsufficientDataError(
            f"{failed}, though they show somebody; heads must be inside the images, and between --head.nearest-m "
            f"({command.settings.head.nearest_m:g}) and --head.farthest-m ({command.settings.head.farthest_m:g}) away."
        )
    return InsufficientDataError(
        f"{failed}, and it takes two that see the same head: turn the views so that they overlap, and see in the table "
        "what stood in the way in the others."
    )
