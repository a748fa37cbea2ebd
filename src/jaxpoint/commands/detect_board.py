"""`jaxpoint detect board`: images of a calibration board to tracks of its corners."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from jaxpoint.commands.console import Console, table
from jaxpoint.commands.inputs import detection_summary, hush_opencv
from jaxpoint.commands.options import Options, Outcome, at
from jaxpoint.config import Count, RoomConfig
from jaxpoint.errors import InsufficientDataError
from jaxpoint.extras import extra

if TYPE_CHECKING:
    from jaxpoint.detection.board.board_search import BoardDetection


@dataclass(frozen=True, kw_only=True)
class DetectBoard(Options):
    """Find a calibration board in the images of every camera, and write where its corners were.

    jaxpoint detect board session/ --board charuco:7x5:40mm:30mm:DICT_4X4_50 --out tracks.npz

    Give a session, or one folder of images, some images ("folder/left*.jpg") or one video a camera. `jaxpoint
    calibrate` takes the tracks.
    """

    sources: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """A session, or images or a video for each camera."""
    board: str
    """chessboard:9x6:25mm (inner corners), charuco:7x5:40mm:30mm:DICT_4X4_50 (squares), aprilgrid:6x6:55mm:0.3 (tags),
    or a TOML file."""
    timestamps: Path | None = None
    """timestamps.csv of caliscope: which frames of the files belong together; by default that of a session that
    has one."""
    every: Count = 0
    """Look at every so many frames; 0 takes all images, and of videos 300 frames at most."""

    @staticmethod
    def with_defaults(room: RoomConfig) -> DetectBoard:
        """The command's defaults under a configuration file."""
        return DetectBoard(sources=tyro.MISSING, board=tyro.MISSING, runtime=room.runtime)

    def run(self, console: Console) -> Outcome:
        """Write the tracks and, beside them, how the detection went in figures and pictures."""
        hush_opencv(self.verbose)
        from jaxpoint.detection.board.board_search import detect_board, notes_of
        from jaxpoint.detection.board.board_spec import read_board
        from jaxpoint.io.board_sources import open_board_sources
        from jaxpoint.io.track_files import save_tracks
        from jaxpoint.report.board_pictures import board_strips
        from jaxpoint.report.html import write_detection_section
        from jaxpoint.runs import write_json

        out, board = self.needed_file("tracks.npz"), read_board(self.board)
        with console.progress() as progress:
            sources = open_board_sources(self.sources, timestamps=self.timestamps)
            detection = detect_board(sources, board, every=self.every, progress=progress)
        save_tracks(out, detection.tracks)
        figures = detection_figures(detection, out)
        write_json(detection_summary(out), figures)
        page, missing = out.with_suffix(".html"), list[str]()
        with extra(page.name, missing):
            page.unlink(missing_ok=True)  # an earlier one shows another detection
            write_detection_section(page, board_strips(detection))
        rows = [
            (camera["name"], f"{camera['found']}/{camera['frames']}", camera["corners"], _rejected(camera))
            for camera in figures["cameras"]
        ]
        lines = table(("camera", "found", "corners", "not found"), rows)
        blind = [camera["name"] for camera in figures["cameras"] if not camera["found"]]
        failure = InsufficientDataError(
            f"The board was found in 0 frames of camera '{blind[0]}'; the tracks are kept. See {page}, and show the "
            "board to that camera too."
        ) if blind else None  # fmt: skip
        return Outcome(
            figures,
            (*lines, *notes_of(detection), f"{detection.seconds:.1f} s", *at("Pictures", page), f"Tracks: {out}"),
            failure,
            tuple(missing),
        )


def _rejected(camera: dict[str, Any]) -> str:
    return ", ".join(f"{count} {why.replace('_', ' ')}" for why, count in camera["rejected"].items())


def detection_figures(detection: BoardDetection, tracks: Path | None = None) -> dict[str, Any]:
    """How the detection went, for JSON."""
    from jaxpoint.detection.board.abstract_board import BoardReason
    from jaxpoint.detection.board.board_search import counts_of, notes_of

    found = detection.reasons == BoardReason.FOUND
    return {
        **({} if tracks is None else {"tracks": str(tracks)}),
        "board": detection.board.spec,
        "frames": len(detection.frame_ids),
        "frames_with_the_board": int(found.any(axis=1).sum()),
        "paired_by": detection.sources.pairing.by,
        "notes": list(notes_of(detection)),
        "seconds": detection.seconds,
        "cameras": [
            {
                "name": name,
                "source": str(detection.sources.paths[camera]),
                "frames": int((detection.reasons[:, camera] != BoardReason.NO_IMAGE).sum()),
                "found": int(found[:, camera].sum()),
                "corners": int(detection.tracks.visible[:, camera].sum()),
                "mirrored": int((detection.mirrored & found)[:, camera].sum()),
                "rejected": {
                    why: count
                    for why, count in counts_of(detection, camera).items()
                    if why not in ("found", "no_image")
                },
            }
            for camera, name in enumerate(detection.names)
        ],
    }
