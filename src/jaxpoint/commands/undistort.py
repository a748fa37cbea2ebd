"""`jaxpoint undistort`: images or videos without the distortion of their lenses."""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from jaxpoint.commands.console import Console
from jaxpoint.commands.inputs import hush_opencv
from jaxpoint.commands.options import Options, Outcome
from jaxpoint.config import Positive, RoomConfig
from jaxpoint.errors import UsageError

if TYPE_CHECKING:
    from jaxpoint.camera.rig import CameraRig
    from jaxpoint.io.board_sources import BoardSources


@dataclass(frozen=True, kw_only=True)
class Undistort(Options):
    """Write images or videos as lenses without distortion would have seen them, and the maps for it.

    jaxpoint undistort images/ --calibration runs/lens --out undistorted

    The folder also gets a calibration.json that belongs to the undistorted images.
    """

    sources: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """A session, or images or a video for each camera."""
    calibration: Path
    """A run or a file of cameras or lenses."""
    camera: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """Name of the camera in the calibration, once for each source; by default sources are named like cameras."""
    zoom: Positive = 1.0
    """Focal length over that of the lens in the middle of its image; below 1 more of its edges is seen."""

    @staticmethod
    def with_defaults(room: RoomConfig) -> Undistort:
        """The command's defaults under a configuration file."""
        return Undistort(sources=tyro.MISSING, calibration=tyro.MISSING, runtime=room.runtime)

    def run(self, console: Console) -> Outcome:
        """Write images or videos, maps, and the calibration of what is written."""
        hush_opencv(self.verbose)
        from jaxpoint.detection.undistortion import Undistortion, write_undistorted
        from jaxpoint.io.board_sources import open_board_sources
        from jaxpoint.io.calibration import write_calibration_json
        from jaxpoint.io.depth_files import write_maps
        from jaxpoint.io.exchange import read_calibration
        from jaxpoint.runs import new_run, provenance, write_json

        out, sources = self.needed_folder("undistorted"), open_board_sources(self.sources)
        saved = read_calibration(self.calibration)
        rig = self._rig(saved.rig, sources)
        lines: list[str] = []
        with console.progress() as progress, new_run(out, self.force) as folder:
            done = []
            for index, (name, source) in enumerate(zip(rig.names, sources.frames)):
                own = Undistortion.of(rig[index], source.size, self.zoom)
                done.append(own)
                path = write_undistorted(source, own, folder / name, lambda k, n, name=name: progress(name, k, n))
                write_maps(folder / f"{name}_maps.npz", {"x": own.map_x, "y": own.map_y, "intrinsics": own.intrinsics})
                lines.append(f"{name}: {len(source)} images, {out / path.name}")
            flat = _flat_rig(rig, done)
            write_calibration_json(folder / "calibration.json", flat, unit=saved.unit, in_room=saved.in_room)
            made = provenance(shlex.join(["jaxpoint", *sys.argv[1:]]), [self.calibration], 0)
            write_json(folder / "provenance.json", made)
        figures = {"folder": str(out), "cameras": list(rig.names), "images": [len(one) for one in sources.frames]}
        return Outcome(figures, tuple(lines))

    def _rig(self, rig: CameraRig, sources: BoardSources) -> CameraRig:
        """The cameras of the sources, in their order."""
        from jaxpoint.camera.rig import CameraRig

        names = self.camera or (rig.names if len(rig) == len(sources.names) == 1 else sources.names)
        lost = [name for name in names if name not in rig.names]
        if lost or len(names) != len(sources.names):
            raise UsageError(
                f"The sources are {', '.join(sources.names)}, but '{self.calibration}' has the cameras "
                f"{', '.join(rig.names)}; say which is which by --camera NAME, once for each source."
            )
        chosen = rig.select([rig.names.index(name) for name in names])
        for name, known, source in zip(names, chosen.image_sizes.tolist(), sources.frames):
            if tuple(known) != tuple(source.size):
                raise UsageError(
                    f"The images of '{source.path}' are {source.size[0]} x {source.size[1]} px, but the calibration "
                    f"knows camera '{name}' with {known[0]} x {known[1]}; use the calibration of this recording."
                )
        return CameraRig(chosen.cameras, chosen.image_sizes, tuple(names), chosen.reach)


def _flat_rig(rig: CameraRig, done: list) -> CameraRig:
    """The same cameras with the lenses of their undistorted images."""
    import numpy as np

    from jaxpoint.camera.pinhole import Pinhole
    from jaxpoint.camera.rig import CameraRig

    matrices = np.stack([own.intrinsics for own in done])
    pose = rig.cameras.cam_from_world
    return CameraRig.from_parameters(
        matrices[:, [0, 1], [0, 1]],
        matrices[:, :2, 2],
        np.zeros((len(rig), 0)),
        pose.rotation,
        pose.translation,
        np.asarray(rig.image_sizes),
        rig.names,
        Pinhole,
    )
