"""`jaxpoint intrinsics`: the lens of one camera from images of a board."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import tyro

from jaxpoint.commands.console import Console
from jaxpoint.commands.inputs import hush_opencv
from jaxpoint.commands.options import Options, Outcome
from jaxpoint.config import CalibrateSettings, Count, LensSettings, OutlierSettings, RoomConfig
from jaxpoint.errors import UsageError


@dataclass(frozen=True, kw_only=True)
class Intrinsics(Options):
    """Calibrate the lens of one camera from images of a board (Zhang 2000).

    jaxpoint intrinsics images/ --board chessboard:9x6:25mm --out runs/lens

    The run is like that of `calibrate`: its calibration.json is what `--intrinsics` of other commands takes. Ten views
    or more, tilted by 30 to 45 degrees to all sides, near and far, up to the corners of the image, make a good lens.
    """

    images: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """A folder of images, images, or a video."""
    board: str
    """chessboard:9x6:25mm (inner corners), charuco:7x5:40mm:30mm:DICT_4X4_50 (squares), aprilgrid:6x6:55mm:0.3 (tags),
    or a TOML file."""
    name: str | None = None
    """Of the camera; by default that of the folder or video."""
    every: Count = 0
    """Look at every so many frames; 0 takes all images, and of a video 300 frames at most."""
    lens: LensSettings = field(default_factory=LensSettings)
    outliers: OutlierSettings = field(default_factory=OutlierSettings)
    room: tyro.conf.Suppress[RoomConfig] = field(default_factory=RoomConfig)

    @staticmethod
    def with_defaults(room: RoomConfig) -> Intrinsics:
        """The command's defaults under a configuration file."""
        settings: CalibrateSettings = room.calibrate
        return Intrinsics(
            images=tyro.MISSING, board=tyro.MISSING, lens=settings.lens, outliers=settings.outliers, room=room,
            runtime=room.runtime,
        )  # fmt: skip

    def run(self, console: Console) -> Outcome:
        """Find the board, solve, write the run, and judge it."""
        hush_opencv(self.verbose)
        from jaxpoint.calibration.board_calibration import calibrate_boards
        from jaxpoint.calibration.covariance import with_board_covariance
        from jaxpoint.camera.lenses import check_setting
        from jaxpoint.commands.board_outcome import write_board_outcome
        from jaxpoint.detection.board.board_search import detect_board
        from jaxpoint.detection.board.board_spec import read_board
        from jaxpoint.io.board_sources import open_board_sources

        out, board = self.needed_folder("runs/lens"), read_board(self.board)
        if self.lens.distortion != "auto":
            check_setting(self.lens.distortion)  # before any work
        if self.lens.known != "none":
            raise UsageError(f"--lens.known {self.lens.known} belongs to rigs; `intrinsics` solves for the lens.")
        sources = open_board_sources(self.images, [] if self.name is None else [self.name])
        if len(sources.names) > 1:
            raise UsageError(
                f"{len(sources.names)} cameras were given ({', '.join(sources.names)}), and `intrinsics` takes one; "
                "for two of them there is `jaxpoint stereo`, for more `jaxpoint detect board` and `jaxpoint calibrate`."
            )
        settings = replace(self.room.calibrate, lens=self.lens, outliers=self.outliers)
        with console.progress() as progress:
            detection = detect_board(sources, board, every=self.every, progress=progress)
            solved = calibrate_boards(detection.tracks, settings, progress=progress)
        room = replace(self.room, calibrate=settings, runtime=self.runtime)
        given = [path for path in (*self.images, self.config) if path is not None]
        return write_board_outcome(
            with_board_covariance(solved), detection, out, room, title=f"Lens of {detection.names[0]}",
            sources=given, force=self.force,
        )  # fmt: skip
