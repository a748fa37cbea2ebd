"""How long does each stage of the person's detectors take, on one thread?

A session is read (recorded, or made by `jaxpoint simulate`; it needs `empty/` and a calibration), and every stage is
timed on the frames in which a person is seen, with OpenCV held to one thread. The thesis's own methods at full size
stand beside the default. Minimum, median and 95th percentile over the frames, ms; on a machine that does other work the
minimum says most. Decoding is not in it.

    jaxpoint simulate --out session --people 1 --gestures 2
    python experiments/benchmarks/person.py session --out person.md
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tyro

from jaxpoint.config.person import PersonSettings, ThesisSettings, thesis_person
from jaxpoint.detection.person.frame_motion import motion_between
from jaxpoint.detection.person.head_template import find_head
from jaxpoint.detection.person.silhouette import RoomBackground, foreground, learn_background, silhouettes
from jaxpoint.detection.person.skin import skin_mask, skin_model
from jaxpoint.detection.person.thesis_regions import thesis_forearm
from jaxpoint.detection.person.watcher import PersonWatch
from jaxpoint.errors import InsufficientDataError, UsageError
from jaxpoint.io.files import replacing
from jaxpoint.io.session import open_session
from jaxpoint.io.video import open_frames


@dataclass(frozen=True)
class Speed:
    """Time the detectors of a person."""

    session: tyro.conf.Positional[Path]
    """Folder with videos, `empty/` and a calibration."""
    frames: int = 60
    """Frames with a person that are timed, spread over cameras and the recording."""
    out: Path | None = None
    """Also write the table here."""


@dataclass(frozen=True)
class View:
    """A frame, the one before it, and what is known of its camera."""

    before: np.ndarray  # (H, W, 3)
    image: np.ndarray  # (H, W, 3)
    backgrounds: tuple[RoomBackground, RoomBackground]  # of the default and of the thesis
    focal_px: float


def main(options: Speed) -> None:
    """Time all, and print the table."""
    cv2.setNumThreads(1)
    settings = PersonSettings(), thesis_person()
    views = occupied_views(options, settings)
    rows = [
        (name, *column) for name, column in zip(("default", "thesis"), zip(*(timed(view, settings) for view in views)))
    ]
    text = markdown(rows, views[0].image.shape)
    sys.stdout.write(text)
    if options.out is not None:
        with replacing(options.out) as file:
            file.write(text.encode())


def occupied_views(options: Speed, settings: tuple[PersonSettings, PersonSettings]) -> list[View]:
    """Frames in which the default finds a silhouette.

    Raises:
        UsageError: no recording of the empty room, or no calibration.
        InsufficientDataError: nobody is seen.
    """
    session = open_session(options.session)
    if session.rig is None or not all(session.empty):
        raise UsageError(f"'{options.session}' needs a calibration and a recording of the empty room of every camera.")
    views = []
    each = -(-options.frames // len(session.names))
    for camera, (video, empty) in enumerate(zip(session.videos, session.empty)):
        assert empty is not None
        room = [image for _, image in open_frames(empty).stream()]
        backgrounds = learn_background(room, settings[0].background), learn_background(room, settings[1].background)
        focal = float(np.asarray(session.rig.cameras.focal)[camera].mean())
        seen = list(with_person(open_frames(video), backgrounds, focal, settings[0]))
        views += seen[:: max(1, len(seen) // each)][:each]
    if not views:
        raise InsufficientDataError(f"0 frames of '{options.session}' show a person; take a session with one in view.")
    return views


def with_person(
    source: Any, backgrounds: tuple[RoomBackground, RoomBackground], focal: float, settings: PersonSettings
):
    """Every fifth frame that holds a silhouette."""
    before = None
    for index, image in source.stream():
        if before is not None and index % 5 == 0:
            mask = foreground(image, backgrounds[0], settings.background)
            if silhouettes(mask, settings.silhouette):
                yield View(before, image, backgrounds, focal)
        before = image


def timed(view: View, settings: tuple[PersonSettings, PersonSettings]) -> list[dict[str, float]]:
    """Seconds of every stage of one frame, with both settings."""
    return [stages(view, background, one) for background, one in zip(view.backgrounds, settings)]


def stages(view: View, background: RoomBackground, settings: PersonSettings) -> dict[str, float]:
    """Seconds of every stage of one frame."""
    seconds: dict[str, float] = {}

    def run(name: str, stage: Callable[[], Any]) -> Any:
        started = time.perf_counter()
        result = stage()
        seconds[name] = time.perf_counter() - started
        return result

    model = skin_model(settings.skin)
    run("motion", lambda: motion_between(view.before, view.image, settings.motion))
    mask = run("foreground", lambda: foreground(view.image, background, settings.background))
    people = run("silhouettes", lambda: silhouettes(mask, settings.silhouette))
    run("heads", lambda: [find_head(person, view.focal_px, settings.head) for person in people])
    run("skin", lambda: [skin_mask(np.ascontiguousarray(person.crop(view.image)), model) for person in people])
    if settings == thesis_person():
        run("filters", lambda: [thesis_forearm(view.image, person, ThesisSettings()) for person in people])
        seconds["together"] = sum(seconds.values()) - seconds["skin"]  # which is in the filters
    else:
        watch = PersonWatch(background, 0.0, view.focal_px, settings, model)
        watch.look(view.before)
        run("together", lambda: watch.look(view.image))
    return seconds


def markdown(rows: list[tuple], shape: tuple[int, ...]) -> str:
    """The table, ms."""
    lines = [
        f"{shape[1]} x {shape[0]} px, one thread, ms a frame.\n",
        "| method | stage | minimum | median | 95 % |",
        "|---|---|---|---|---|",
    ]
    for method, *frames in rows:
        for stage in frames[0]:
            values = 1e3 * np.array([frame[stage] for frame in frames])
            figures = " | ".join(
                f"{value:.1f}" for value in (values.min(), np.median(values), np.quantile(values, 0.95))
            )
            lines.append(f"| {method} | {stage} | {figures} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main(tyro.cli(Speed, description=__doc__))
