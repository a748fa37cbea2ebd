"""`jaxpoint triangulate`: tracks and a calibration to points in 3-D."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from jaxpoint.commands.console import Console, table
from jaxpoint.commands.inputs import tracks_from
from jaxpoint.commands.options import Inline, Options, Outcome
from jaxpoint.config import InputSettings, Positive, RoomConfig
from jaxpoint.config.types import Unit
from jaxpoint.errors import InsufficientDataError, UsageError

if TYPE_CHECKING:
    from jaxpoint.calibration.track_points import TrackPoints
    from jaxpoint.io.point_formats.point_series import PointSeries
    from jaxpoint.io.rig_entries import SavedCalibration
    from jaxpoint.tracks import Tracks


@dataclass(frozen=True, kw_only=True)
class Triangulate(Options):
    """Points in 3-D of a light, a wand, a board, or the keypoints of a pose estimator, by a calibration.

    jaxpoint triangulate runs/room-m tracks.npz --out points.csv

    jaxpoint triangulate calibration.toml keypoints/ --unit mm --fps 60 --out points.trc

    The name of `--out` says the format: a table (.csv), C3D or OpenSim's TRC. Keypoints of DeepLabCut and SLEAP are a
    folder of one file a camera.
    """

    calibration: Annotated[Path, tyro.conf.Positional]
    """A run, or a calibration of any format that `jaxpoint convert --list` names."""
    tracks: Annotated[Path, tyro.conf.Positional]
    """Tracks (.npz, .csv, .h5), or a folder of them."""
    unit: Unit = None
    """Unit of a calibration that does not say it: m, cm or mm."""
    fps: Positive | None = None
    """Frames a second, for C3D and TRC, where the tracks hold no times."""
    world: str | None = None
    """Axes of the points: room (z up), opensim, opengl, opencv, unity, unreal, ... or what x, y and z are in the room,
    as x,z,-y; by default opensim (y up) for .trc, else the room."""
    max_error_px: Positive = 15.0
    """Points with a larger reprojection error lose the views that contradict the others, or are left out."""
    input: Annotated[InputSettings, Inline] = field(default_factory=InputSettings)

    @staticmethod
    def with_defaults(room: RoomConfig) -> Triangulate:
        """The command's defaults under a configuration file."""
        return Triangulate(calibration=tyro.MISSING, tracks=tyro.MISSING, input=room.input, runtime=room.runtime)

    def run(self, console: Console) -> Outcome:
        """Triangulate and write."""
        from jaxpoint.calibration.track_points import points_of_tracks
        from jaxpoint.geometry.world_axes import world_of
        from jaxpoint.io.point_formats.point_files import point_format_of, write_points
        from jaxpoint.io.point_formats.point_series import series_of

        fmt = point_format_of(self.needed_out("points.csv"))
        out = self.needed_file(f"points{self.needed_out('points.csv').suffix}")
        world = world_of(self.world or fmt.world)
        saved, tracks = self._inputs()
        found = points_of_tracks(saved.rig, tracks, self.max_error_px, saved.covariance)
        series = series_of(tracks, found, self.fps).in_world(world)
        said = [*write_points(out, series), *self._notes(saved)]
        figures = {
            "out": str(out),
            "points": int(series.present.sum()),
            "of": int((tracks.visible.sum(axis=1) >= 2).sum()),
            "frames": len(series.frame_ids),
            "sigma_px": found.sigma_px,
            "world": str(world),
            "fps": series.rate_hz,
            "names": list(series.names),
            "notes": said,
        }
        return Outcome(figures, (*_lines(tracks, found, series), *said, f"Points: {out} (axes {world} of the room)"))

    def _inputs(self) -> tuple[SavedCalibration, Tracks]:
        """The calibration in metres and the tracks, of the same cameras in the same order.

        Raises:
            UsageError: the unit is not known, or a camera of the tracks is not in the calibration.
            InsufficientDataError: there is but one camera.
        """
        from jaxpoint.io.exchange import read_calibration
        from jaxpoint.io.lens_files import match_names
        from jaxpoint.io.rig_entries import needs_unit, select_cameras

        saved = needs_unit(self.calibration, read_calibration(self.calibration), self.unit)
        rig = saved.rig
        sizes = {name: (int(wide), int(high)) for name, (wide, high) in zip(rig.names, rig.image_sizes.tolist())}
        tracks = tracks_from(self.tracks, self.input, sizes)
        places = match_names(tracks.names, rig.names)
        if places is None:
            raise UsageError(
                f"'{self.tracks}' has the cameras {', '.join(tracks.names)}, the calibration {', '.join(rig.names)}; "
                "name them alike."
            )
        if tracks.cameras < 2:
            raise InsufficientDataError(f"'{self.tracks}' is of one camera; give a folder with a file for each.")
        return select_cameras(saved, places), tracks

    def _notes(self, saved: SavedCalibration) -> list[str]:
        """What must be known of the calibration."""
        name, notes = f"'{self.calibration}'", []
        if not saved.in_room:
            notes.append(f"{name} has metres, but neither floor nor up: the axes are those of its own frame.")
        if saved.time_offsets is not None and not self.input.offset:
            notes.append(
                f"{name} found cameras out of step; the tracks were taken as they are, so give --offset "
                "if they were recorded so too."
            )
        return notes


def _lines(tracks: Tracks, found: TrackPoints, series: PointSeries) -> list[str]:
    """A table of the points, and the noise."""
    import numpy as np

    rows = []
    for point, name in enumerate(series.names):
        own = series.present[:, point]
        if not own.any():
            rows.append((name, "0", "", ""))
            continue
        error, sigma = np.median(series.rms_px[own, point]), np.median(series.sigmas_m[own, point])
        rows.append((name, f"{own.sum()}", f"{error:.2f}", f"{1e3 * sigma:.3g}"))
    left_out = int((tracks.visible & ~found.used).sum())
    return [
        *table(("point", "frames", "error px", "sigma mm"), rows),
        f"noise {found.sigma_px:.2f} px; {left_out} of {int(tracks.visible.sum())} observations were not used",
    ]
