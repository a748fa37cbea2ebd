"""`jaxpoint detect led`: images to tracks."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from jaxpoint.commands.console import Console, table
from jaxpoint.commands.inputs import detection_summary, hush_opencv
from jaxpoint.commands.options import Inline, Outcome, SeededOptions, at
from jaxpoint.config import LedSettings, RoomConfig
from jaxpoint.errors import InsufficientDataError
from jaxpoint.extras import extra

if TYPE_CHECKING:
    import numpy as np

    from jaxpoint.detection.light.led import LedDetection


@dataclass(frozen=True, kw_only=True)
class DetectLed(SeededOptions):
    """Find the light in the images of every camera, and write where it was.

    jaxpoint detect led cam1/ cam2/ cam3.mp4 --out tracks.npz

    Give one folder of images or one video a camera, all of the same moments. Images are paired by the number or time in
    their names that rises from file to file, videos by their time stamps; what paired them is printed.
    """

    sources: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """One folder of images or one video a camera."""
    settings: Annotated[LedSettings, Inline] = field(default_factory=LedSettings)

    @staticmethod
    def with_defaults(room: RoomConfig) -> DetectLed:
        """The command's defaults under a configuration file."""
        return DetectLed(sources=tyro.MISSING, settings=room.detect.led, runtime=room.runtime)

    def run(self, console: Console) -> Outcome:
        """Write the tracks and, beside them, how the detection went in figures and pictures."""
        hush_opencv(self.verbose)
        from jaxpoint.detection.light.led import DetectionInterrupted, detect_led
        from jaxpoint.report.html import write_detection_section

        out = self.needed_file("tracks.npz")
        with console.progress() as progress:
            try:
                detection = detect_led(self.sources, self.settings, progress)
            except DetectionInterrupted as stop:
                kept = out.with_name(f"{out.stem}.unfinished.npz")
                _write(kept, stop.finished)
                raise KeyboardInterrupt(f"{stop} They lie in {kept}") from None
        figures = _write(out, detection)
        page = out.with_suffix(".html")
        missing: list[str] = []
        with extra(page.name, missing):
            page.unlink(missing_ok=True)  # an earlier one shows another detection
            write_detection_section(page, _strips(detection))
        rows = [
            (
                camera["name"],
                f"{camera['found']}/{camera['frames']}",
                f"{camera['sigma_px']:.3f}",
                camera["channel"],
                ", ".join(f"{count} {why}" for why, count in camera["rejected"].items()),
            )
            for camera in figures["cameras"]
        ]
        lines = table(("camera", "found", "sigma px", "channel", "rejected"), rows)
        return Outcome(
            figures,
            (*lines, *_summary(detection), f"{figures['seconds']:.1f} s", *at("Pictures", page), f"Tracks: {out}"),
            _failure(figures, page),
            tuple(missing),
        )


def _summary(detection: LedDetection) -> tuple[str, ...]:
    """What paired the frames, and where the cameras were not looked at."""
    masked = [name for name, mask in zip(detection.tracks.names, detection.masks) if mask is not None]
    without = [name for name in detection.tracks.names if name not in masked]
    folders = sorted({str(mask.parent) for mask in detection.masks if mask is not None})
    masks = f"Masks of {', '.join(masked)} from {', '.join(folders)}" if masked else ""
    paired = (f"Frames are paired by {detection.pairing.by}.",) if len(detection.tracks.names) > 1 else ()
    hidden = (masks + (f"; none of {', '.join(without)}." if without else "."),) if masked else ()
    return (*paired, *detection.pairing.notes, *hidden)


REMEDIES = {
    "dark": "switch the light on in its view, expose longer, or try another --channel",
    "too_large": "dim the room, expose shorter, or raise --led-radius-px",
    "weak": "take a brighter light or a darker room, try another --channel, or lower --min-deviations",
    "several": "leave one light on, and hide reflections and windows by --masks",
    "blurred": "wave it slower, expose shorter, or raise --max-eccentricity",
    "unlike": "raise --led-radius-px if the light is larger, and hide reflections and other moving lights by --masks",
    "at_border": "wave it further inside the image, and draw masks larger than the reflections that they hide",
    "between": "its frames are too few for the clock of the others; record all cameras at one rate",
    "no_image": "its images belong to other moments; see what paired the frames",
}


def _failure(figures: dict[str, Any], page: Path) -> InsufficientDataError | None:
    """A camera without any light is of no use, though the others are kept."""
    blind = [camera for camera in figures["cameras"] if not camera["found"]]
    if not blind:
        return None
    reason = max(blind[0]["rejected"], key=blind[0]["rejected"].get)
    see = f"See {page}; " if page.exists() else ""
    remedy = f"{see}{REMEDIES[reason]}."
    return InsufficientDataError(
        f"The light was found in 0 of {blind[0]['frames']} frames of camera '{blind[0]['name']}', most often for the "
        f"reason '{reason}'; the tracks are kept. {remedy[0].upper()}{remedy[1:]}"
    )


def _strips(detection: LedDetection) -> list[tuple[str, np.ndarray]]:
    """One row of crops, with its caption, for each camera and reason."""
    import numpy as np

    from jaxpoint.report.light_crops import contact_sheet, mask_overview

    strips = []
    for camera, name in enumerate(detection.tracks.names):
        overview = mask_overview(detection, camera)
        if overview is not None:
            strips.append((f"{name}: no light is looked for under the stripes ({detection.masks[camera]})", overview))
        counts = detection.counts(camera)
        for reason, group in groupby(contact_sheet(detection, camera), key=lambda crop: crop.reason):
            crops = list(group)
            frames = ", ".join(str(crop.frame_id) for crop in crops)
            caption = f"{name}: {counts[reason]} {reason.name.lower().replace('_', ' ')}, such as frames {frames}"
            strips.append((caption, np.concatenate([crop.image for crop in crops], axis=1)))
    return strips


def _write(out: Path, detection: LedDetection) -> dict[str, Any]:
    """The tracks as `.npz` and how the detection went as `.json`; returns the latter."""
    from jaxpoint.detection.light.led import Reason
    from jaxpoint.io.track_files import save_tracks
    from jaxpoint.runs import versions, write_json

    save_tracks(out, detection.tracks, detection.reasons, [reason.name.lower() for reason in Reason])
    figures = {
        "tracks": str(out),
        "frames": detection.tracks.frames,
        "paired_by": detection.pairing.by,
        "notes": list(detection.pairing.notes),
        "seconds": detection.seconds,
        "cameras": [
            {
                "name": name,
                "source": str(source),
                "mask": None if mask is None else str(mask),
                **asdict(stats),
                "rejected": {
                    reason.name.lower(): count
                    for reason, count in detection.counts(camera).items()
                    if reason != Reason.FOUND
                },
            }
            for camera, (name, source, mask, stats) in enumerate(
                zip(detection.tracks.names, detection.sources, detection.masks, detection.cameras)
            )
        ],
        "versions": versions(),
    }
    write_json(detection_summary(out), figures)
    return figures
