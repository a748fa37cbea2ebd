"""`jaxpoint objects add`: one line more in a database of objects, from measured or from clicked corners."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from jaxpoint.commands.console import Console
from jaxpoint.commands.inputs import check_no_out
from jaxpoint.commands.options import Options, Outcome
from jaxpoint.config import RoomConfig, Unit
from jaxpoint.errors import FileFormatError, UsageError

if TYPE_CHECKING:
    import numpy as np

ORDER = ("lt", "rt", "lb", "rb")


@dataclass(frozen=True, kw_only=True)
class ObjectsAdd(Options):
    """Add a rectangle to a database of objects: one line more, written whole or not at all.

    Measured corners, in metres, left-top, right-top, left-bottom, right-bottom, x y z each:

    jaxpoint objects add objects.csv --name poster --corners 1 0 2  2 0 2  1 0 1  2 0 1 --tags paper wall

    Or its corners clicked in two or more images of a calibrated room (camera,corner,x,y with the corners lt, rt, lb,
    rb), which are triangulated:

    jaxpoint objects add objects.csv --name poster --views clicks.csv --calibration runs/room-m
    """

    objects: Annotated[Path, tyro.conf.Positional]
    """Database: a CSV or TOML file that is there already."""
    name: str
    """What it is called; no other object may have this name."""
    kind: str = ""
    """Sort of thing, such as picture."""
    tags: tuple[str, ...] = ()
    """Other words by which people call it."""
    corners: tuple[float, ...] = ()
    """Twelve numbers, m: left-top, right-top, left-bottom, right-bottom, x y z each."""
    views: Path | None = None
    """CSV of clicked corners, camera,corner,x,y, instead of `--corners`; needs `--calibration`."""
    calibration: Path | None = None
    """The room's cameras in metres, with `--views`: a calibration.json or the folder of a run."""
    unit: Unit = None
    """Unit of a calibration that does not say it, as a .toml of other programs: m, cm or mm."""

    @staticmethod
    def with_defaults(room: RoomConfig) -> ObjectsAdd:
        """The command's defaults under a configuration file."""
        return ObjectsAdd(objects=tyro.MISSING, name=tyro.MISSING, runtime=room.runtime)

    def run(self, console: Console) -> Outcome:
        """Find the corners, and append."""
        import numpy as np

        from jaxpoint.io.objects_adding import append_object
        from jaxpoint.pointing.objects import Rectangle, Thing
        from jaxpoint.pointing.survey import survey

        check_no_out(self.out, f"writes into '{self.objects}'")
        if bool(self.corners) == (self.views is not None):
            raise UsageError("Give either --corners (twelve numbers, m) or --views with --calibration.")
        sigma, source = None, "measured"
        if self.views is not None:
            corners, sigma, count = _clicked(self.views, self.calibration, self.unit)
            source = f"clicked in {count} views; one standard deviation of a corner is {1000 * sigma:.1f} mm"
        elif len(self.corners) == 12:
            corners = np.reshape(self.corners, (4, 3))
        else:
            raise UsageError(f"--corners has {len(self.corners)} numbers; four corners have 12.")
        thing = Thing(self.name, Rectangle(corners), self.kind.strip(), tuple(" ".join(self.tags).split()))
        warnings = append_object(self.objects, thing)
        (found,) = survey([thing])
        figures = {
            **found.figures,
            "corners_m": corners.tolist(),
            "corner_sigma_m": sigma,
            "database": str(self.objects),
            "warnings": warnings,
        }
        width, height = found.size_m
        line = (
            f"Added '{self.name}' to {self.objects}: {width:.3f} x {height:.3f} m, corners {source}, "
            f"{1000 * found.residual_m:.1f} mm off their plane."
        )
        return Outcome(figures, (line, *warnings))


def _clicked(views: Path, calibration: Path | None, unit: str | None) -> tuple[np.ndarray, float, int]:
    """Corners (m), the largest standard deviation of one in any direction (m), and how many cameras took part."""
    import numpy as np

    from jaxpoint.io.calibration import read_calibration
    from jaxpoint.io.files import read_table
    from jaxpoint.io.rig_entries import needs_metres
    from jaxpoint.landmarks import CLICK_SIGMA_PX, MISCLICK_PX
    from jaxpoint.triangulation import triangulate

    if calibration is None:
        raise UsageError("--views needs the cameras: --calibration FILE, a calibration.json or the folder of a run.")
    saved = needs_metres(calibration, read_calibration(calibration), unit)
    rig = saved.rig
    pixels, seen = np.zeros((4, len(rig), 2)), np.zeros((4, len(rig)), bool)
    for row in read_table(views, ("camera", "corner", "x", "y")):
        camera, corner = row.camera(rig.names), row.text("corner")
        if corner not in ORDER:
            raise row.error(f"there is no corner '{corner}'; the corners are {', '.join(ORDER)}.")
        place = ORDER.index(corner), camera
        if seen[place]:
            raise row.error(f"the corner '{corner}' is given twice for camera '{rig.names[camera]}'; keep one.")
        pixels[place], seen[place] = (row.number("x"), row.number("y")), True
    for corner, count in zip(ORDER, seen.sum(axis=1)):
        if count < 2:
            raise FileFormatError(f"{views} has the corner '{corner}' in {count} images; click it in two or more.")
    found = triangulate(rig, pixels, seen, sigma_px=CLICK_SIGMA_PX)
    miss = np.linalg.norm(np.asarray(found.residuals), axis=-1).max(axis=1)
    if miss.max() > MISCLICK_PX:
        raise FileFormatError(
            f"{views}: the clicks on the corner '{ORDER[int(miss.argmax())]}' miss each other by {miss.max():.0f} px "
            f"(at most {MISCLICK_PX:.0f}); click it again."
        )
    spread = np.sqrt(np.linalg.eigvalsh(np.asarray(found.covariance))[:, -1].max())
    return np.asarray(found.points), float(spread), int(seen.any(axis=0).sum())
