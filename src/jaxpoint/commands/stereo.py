"""`jaxpoint stereo`: two cameras calibrated from boards or taken from a run, rectified, and depth of one pair."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from jaxpoint.commands.console import Console
from jaxpoint.commands.inputs import hush_opencv
from jaxpoint.commands.options import Options, Outcome
from jaxpoint.config import Count, LensSettings, OutlierSettings, RoomConfig
from jaxpoint.config.stereo_matching import StereoSettings
from jaxpoint.errors import UsageError

if TYPE_CHECKING:
    from jaxpoint.io.board_sources import BoardSources


@dataclass(frozen=True, kw_only=True)
class Stereo(Options):
    """Calibrate two cameras from images of a board, rectify them, and find the depth of a pair of images.

    jaxpoint stereo left/ right/ --board chessboard:9x6:25mm --out runs/stereo

    Images are paired by the numbers in their names, videos by their time stamps. With --calibration nothing is solved:
    jaxpoint stereo left/ right/ --calibration runs/room cam_0 cam_1 --out runs/depth
    """

    sources: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Images or a video of the left and of the right camera, or a session of these two."""
    board: str | None = None
    """chessboard:9x6:25mm (inner corners), charuco:7x5:40mm:30mm:DICT_4X4_50 (squares), aprilgrid:6x6:55mm:0.3 (tags),
    or a TOML file."""
    calibration: tuple[Path, str, str] | None = None
    """A run or calibration file, and the names of the left and the right camera in it."""
    frame: Count | None = None
    """Number of the pair of images whose depth is found; the middle one if not given."""
    every: Count = 0
    """Look for the board in every so many frames; 0 takes all images, and of videos 300 frames at most."""
    lens: LensSettings = field(default_factory=LensSettings)
    outliers: OutlierSettings = field(default_factory=OutlierSettings)
    stereo: StereoSettings = field(default_factory=StereoSettings)
    room: tyro.conf.Suppress[RoomConfig] = field(default_factory=RoomConfig)

    @staticmethod
    def with_defaults(room: RoomConfig) -> Stereo:
        """The command's defaults under a configuration file."""
        return Stereo(
            sources=tyro.MISSING, lens=room.calibrate.lens, outliers=room.calibrate.outliers, stereo=room.stereo,
            room=room, runtime=room.runtime,
        )  # fmt: skip

    def run(self, console: Console) -> Outcome:
        """Solve or read, then rectify and match."""
        hush_opencv(self.verbose)
        from jaxpoint.io.board_sources import open_board_sources

        if (self.board is None) == (self.calibration is None):
            raise UsageError("Give either --board, to calibrate the two cameras, or --calibration RUN LEFT RIGHT.")
        if not self.stereo.block % 2:
            raise UsageError(f"--stereo.block must be an odd number, not {self.stereo.block}.")
        out, sources = self.needed_folder("runs/stereo"), open_board_sources(self.sources)
        if len(sources.names) != 2:
            raise UsageError(
                f"Stereo takes two cameras, and {len(sources.names)} were given ({', '.join(sources.names)}); name the "
                "left and the right one."
            )
        self._check_frame(sources)
        return self._read(out, sources) if self.calibration is not None else self._solve(out, sources, console)

    def _solve(self, out: Path, sources: BoardSources, console: Console) -> Outcome:
        from jaxpoint.calibration.board_calibration import calibrate_boards
        from jaxpoint.calibration.covariance import with_board_covariance
        from jaxpoint.camera.lenses import check_setting
        from jaxpoint.commands.board_outcome import write_board_outcome
        from jaxpoint.commands.stereo_results import StereoResults
        from jaxpoint.detection.board.board_search import detect_board
        from jaxpoint.detection.board.board_spec import read_board

        assert self.board is not None
        board = read_board(self.board)
        if self.lens.distortion != "auto":
            check_setting(self.lens.distortion)  # before any work
        settings = replace(self.room.calibrate, lens=self.lens, outliers=self.outliers)
        with console.progress() as progress:
            detection = detect_board(sources, board, every=self.every, progress=progress)
            solved = with_board_covariance(calibrate_boards(detection.tracks, settings, progress=progress))
        room = replace(self.room, calibrate=settings, stereo=self.stereo, runtime=self.runtime)

        def more(folder: Path, figures: dict[str, Any]) -> tuple[tuple[str, ...], dict[str, Any]]:
            results = StereoResults(solved.rig, sources, self.stereo, self.frame)
            return results.write(folder, figures, solved)

        given = [path for path in (*self.sources, self.config) if path is not None]
        title = f"{sources.names[0]} and {sources.names[1]}"
        return write_board_outcome(
            solved, detection, out, room, title=title, sources=given, force=self.force, more=more
        )

    def _read(self, out: Path, sources: BoardSources) -> Outcome:
        from jaxpoint.camera.rig import CameraRig
        from jaxpoint.commands.stereo_results import StereoResults, write_depth_outcome
        from jaxpoint.io.exchange import read_calibration

        assert self.calibration is not None
        path, *names = self.calibration
        saved = read_calibration(path)
        lost = [name for name in names if name not in saved.rig.names]
        if lost:
            raise UsageError(f"'{path}' has no camera '{lost[0]}'; it has {', '.join(saved.rig.names)}.")
        chosen = saved.rig.select([saved.rig.names.index(name) for name in names])
        for name, known, source in zip(names, chosen.image_sizes.tolist(), sources.frames):
            if tuple(known) != tuple(source.size):
                raise UsageError(
                    f"The images of '{source.path}' are {source.size[0]} x {source.size[1]} px, but '{path}' knows "
                    f"camera '{name}' with {known[0]} x {known[1]}; use the calibration of this recording."
                )
        rig = CameraRig(chosen.cameras, chosen.image_sizes, tuple(names), chosen.reach)
        results = StereoResults(rig, sources, self.stereo, self.frame, saved.unit)
        return write_depth_outcome(results, out, inputs=[path, *self.sources], force=self.force)

    def _check_frame(self, sources: BoardSources) -> None:
        """Refuse a frame that not both cameras have, before anything is solved."""
        both = sources.pairing.frame_ids[sources.shared]
        if self.frame is not None and self.frame not in both:
            among = f"; choose one of {both.min()} to {both.max()}" if len(both) else ""
            raise UsageError(f"There is no frame {self.frame} of both cameras{among}.")
