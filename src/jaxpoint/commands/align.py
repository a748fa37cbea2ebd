"""`jaxpoint align`: from the solver's frame to the metric room."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from jaxpoint.commands.console import Console
from jaxpoint.commands.options import Inline, Outcome, SeededOptions
from jaxpoint.config import AlignSettings, RoomConfig
from jaxpoint.errors import UsageError

if TYPE_CHECKING:
    import numpy as np

    from jaxpoint.calibration.alignment import Alignment
    from jaxpoint.calibration.result import Calibration
    from jaxpoint.landmarks import LandmarkPixels, Landmarks


@dataclass(frozen=True, kw_only=True)
class Align(SeededOptions):
    """Bring a calibration into the room, in metres with z up.

    jaxpoint align runs/room --landmarks landmarks.csv --landmark-pixels clicks.csv --out runs/room-m

    jaxpoint align runs/room --camera-centres tape.csv --out runs/room-m

    jaxpoint align runs/room --landmarks scene.csv --world unity --landmark-pixels clicks.csv --out runs/room-m

    jaxpoint align runs/room --floor 10 250 480 --length-m 2.0 --out runs/room-m

    jaxpoint align runs/room --length 10 250 --length-m 2.0 --out runs/room-m
    """

    run_folder: Annotated[Path, tyro.conf.Positional]
    """Run of `calibrate`."""
    settings: Annotated[AlignSettings, Inline] = field(default_factory=AlignSettings)

    @staticmethod
    def with_defaults(room: RoomConfig) -> Align:
        """The command's defaults under a configuration file."""
        return Align(run_folder=tyro.MISSING, settings=room.align, runtime=room.runtime)

    def run(self, console: Console) -> Outcome:
        """Align, and write a new run beside the old one."""
        from jaxpoint.commands.run_outcome import write_outcome
        from jaxpoint.runs import read_run

        out = self.needed_folder("runs/room-m")
        run = read_run(self.run_folder)
        given = (self.settings.landmarks, self.settings.landmark_pixels, self.settings.camera_centres)
        return write_outcome(
            align(run.calibration, self.settings),
            out,
            replace(run.config, align=self.settings),
            sources=[run.folder / "calibration.json", *(path for path in given if path is not None)],
            detect_seconds=run.metrics["seconds"]["detect"],
            force=self.force,
        )


def align(calibration: Calibration, settings: AlignSettings) -> Calibration:
    """The calibration in the room, aligned as the settings ask, with its covariance there.

    Raises:
        UsageError: none or more than one kind of knowledge is given.
        FileFormatError: a file is not what it should be.
        InsufficientDataError: too few points can be placed, they do not determine the room, or axes or unit are wrong.
    """
    from jaxpoint.calibration.covariance import aligned_with_covariance
    from jaxpoint.calibration.upright import check_size
    from jaxpoint.geometry.world_axes import WORLDS, world_of
    from jaxpoint.io.survey_files import read_landmark_pixels
    from jaxpoint.landmarks import CLICK_SIGMA_PX

    kinds = [settings.landmarks, settings.camera_centres, settings.floor or None, settings.length or None]
    if sum(kind is not None for kind in kinds) != 1:
        raise UsageError(
            "Give one of --landmarks, --camera-centres, --floor and --length; they are different ways to align."
        )
    world = world_of(settings.world)
    if world != WORLDS["room"] and (settings.floor or settings.length):
        raise UsageError("--world is of known points or camera centres; leave it out with --floor and --length.")
    check_not_extended(calibration)
    names = calibration.rig.names
    clicks = None if settings.landmark_pixels is None else read_landmark_pixels(settings.landmark_pixels, names)
    if settings.length:
        return _by_length(calibration, settings, clicks)
    way = _by_landmarks if settings.landmarks else _by_centres if settings.camera_centres else _by_floor
    found, known = way(calibration, settings, clicks)
    wide = check_size(_points_in_room(found, _cameras(calibration)[0]), known.points, settings.max_extent_m)
    found = replace(found, warnings=(*found.warnings, *wide))
    return aligned_with_covariance(calibration, found, known.sigmas, clicks, CLICK_SIGMA_PX)


def check_not_extended(calibration: Calibration) -> None:
    """Refuse a run of `calibrate --extend`: the frame of its cameras is that of the room that it extends.

    Raises:
        UsageError: it is one.
    """
    from jaxpoint.camera.parameters import POSE

    if calibration.freedom is not None and not calibration.freedom.free[:, POSE].all():
        raise UsageError(
            "This run extends another by `calibrate --extend`, and stands in its frame; align that one, and extend the "
            "aligned run."
        )


def _by_landmarks(
    calibration: Calibration, settings: AlignSettings, clicks: LandmarkPixels | None
) -> tuple[Alignment, Landmarks]:
    """By points whose place is known; those that the calibration does not have are left out."""
    from jaxpoint.calibration.alignment import align_to_landmarks
    from jaxpoint.io.survey_files import read_landmarks
    from jaxpoint.landmarks import locate_some

    assert settings.landmarks is not None
    given = in_room_axes(read_landmarks(settings.landmarks), settings.world)
    known, points, warnings = locate_some(calibration, given, clicks)
    centres, rotations = _cameras(calibration)
    found = align_to_landmarks(
        points, known.points, known.sigmas, names=known.names, camera_centres=centres, camera_rotations=rotations
    )
    return replace(found, warnings=(*found.warnings, *warnings)), known


def in_room_axes(known: Landmarks, world: str) -> Landmarks:
    """Known points of another world, in the axes of the room.

    Raises:
        UsageError: there is no such world.
    """
    from jaxpoint.geometry.world_axes import world_of

    return replace(known, points=world_of(world).to_room(known.points))


def _by_centres(
    calibration: Calibration, settings: AlignSettings, clicks: LandmarkPixels | None
) -> tuple[Alignment, Landmarks]:
    """By known places of cameras; some may be missing."""
    from jaxpoint.calibration.alignment import align_to_camera_centres
    from jaxpoint.calibration.still_cameras import still_cameras
    from jaxpoint.geometry.world_axes import world_of
    from jaxpoint.io.survey_files import read_camera_centres
    from jaxpoint.landmarks import locate

    assert settings.camera_centres is not None
    names = calibration.rig.names
    usual = world_of(settings.world).unit  # of files that do not say it
    unit = settings.unit or (None if usual == "m" else usual)
    given = in_room_axes(read_camera_centres(settings.camera_centres, names, unit), settings.world)
    centres, rotations = _cameras(calibration)
    still = still_cameras(locate(calibration, given.names)[0], given.points, settings.moved_m)
    known = given.select([name for name, stays in zip(given.names, still) if stays])
    found = align_to_camera_centres(
        locate(calibration, known.names)[0],
        known.points,
        known.sigmas,
        names=known.names,
        camera_rotations=rotations,
        all_centres=centres,
    )
    absent = ", ".join(name for name in names if name not in given.names)
    warnings = (f"'{settings.camera_centres}' does not have {absent}: aligned without.",) if absent else ()
    moved = ", ".join(name for name in given.names if name not in known.names)
    warnings += (f"Moved since '{settings.camera_centres}', and aligned without: {moved}.",) if moved else ()
    return replace(found, warnings=(*found.warnings, *warnings)), known


def _by_floor(
    calibration: Calibration, settings: AlignSettings, clicks: LandmarkPixels | None
) -> tuple[Alignment, Landmarks]:
    """By points on the floor and one length."""
    from jaxpoint.calibration.alignment import align_to_floor
    from jaxpoint.landmarks import Landmarks, locate

    if settings.length_m is None:
        raise UsageError("--floor needs the distance between its first two points: --length-m METRES.")
    points, warnings = locate(calibration, settings.floor, clicks)
    found = align_to_floor(points, _cameras(calibration)[0], settings.length_m, names=settings.floor)
    known = Landmarks(settings.floor, _points_in_room(found, points))
    return replace(found, warnings=(*found.warnings, *warnings)), known


def _by_length(calibration: Calibration, settings: AlignSettings, clicks: LandmarkPixels | None) -> Calibration:
    """Metres by one length, in a frame of the calibration's own."""
    from jaxpoint.calibration.known_length import scale_by_length
    from jaxpoint.landmarks import locate

    if len(settings.length) != 2 or settings.length_m is None:
        raise UsageError("--length needs two points and the distance between them: --length A B --length-m METRES.")
    ends, _ = locate(calibration, settings.length, clicks)
    return scale_by_length(calibration, ends, settings.length_m)


def _cameras(calibration: Calibration) -> tuple[np.ndarray, np.ndarray]:
    """Centres of the cameras and rotations to them, in the calibration's frame."""
    import jax
    import numpy as np

    with jax.enable_x64(True):
        rig = calibration.rig
        return np.asarray(rig.positions), np.asarray(rig.cameras.cam_from_world.rotation)


def _points_in_room(alignment: Alignment, points: np.ndarray) -> np.ndarray:
    """Points of the calibration's frame in the room, m."""
    import jax
    import numpy as np

    with jax.enable_x64(True):
        return np.asarray(alignment.similarity @ points)
