"""`jaxpoint objects add`: one object more in a database, from measured values or from clicked points."""

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

    from jaxpoint.pointing.shapes.shape import AbstractShape, Field


@dataclass(frozen=True, kw_only=True)
class ObjectsAdd(Options):
    """Add an object to a database: one entry more, written whole or not at all.

    A rectangle by its measured corners, in metres, left-top, right-top, left-bottom, right-bottom, x y z each:

    jaxpoint objects add objects.csv --name poster --corners 1 0 2  2 0 2  1 0 1  2 0 1 --tags paper wall

    Or its corners clicked in two or more images of a calibrated room (camera,corner,x,y with the corners lt, rt, lb,
    rb), which are triangulated:

    jaxpoint objects add objects.csv --name poster --views clicks.csv --calibration runs/room-m

    Other shapes by the values that files of objects have of them, in metres and degrees:

    jaxpoint objects add objects.toml --name lamp --shape sphere --measures center 3 2 2.1 radius 0.15
    """

    objects: Annotated[Path, tyro.conf.Positional]
    """Database: a CSV or TOML file that is there already."""
    name: str
    """What it is called; no other object may have this name."""
    kind: str = ""
    """Sort of thing, such as picture."""
    tags: tuple[str, ...] = ()
    """Other words by which people call it."""
    shape: str = "rectangle"
    """Its shape, such as rectangle, box or sphere."""
    corners: tuple[float, ...] = ()
    """Twelve numbers, m: left-top, right-top, left-bottom, right-bottom, x y z each."""
    measures: tuple[str, ...] = ()
    """Values of the shape, m and degrees, each after its name: center X Y Z size X Y Z yaw_deg A (box), center X Y Z
    radius R (sphere)."""
    views: Path | None = None
    """CSV of clicked corners, camera,corner,x,y, instead of `--corners`; needs `--calibration`."""
    calibration: Path | None = None
    """The room's cameras in metres, with `--views`: the folder of a run, or any that `jaxpoint convert` reads."""
    unit: Unit = None
    """Unit of a calibration that does not say it, as a .toml of other programs: m, cm or mm."""

    @staticmethod
    def with_defaults(room: RoomConfig) -> ObjectsAdd:
        """The command's defaults under a configuration file."""
        return ObjectsAdd(objects=tyro.MISSING, name=tyro.MISSING, runtime=room.runtime)

    def run(self, console: Console) -> Outcome:
        """Find the values, and append."""
        from jaxpoint.io.objects_adding import append_object
        from jaxpoint.pointing.objects import Thing
        from jaxpoint.pointing.survey import survey

        check_no_out(self.out, f"writes into '{self.objects}'")
        given = [bool(self.corners), bool(self.measures), self.views is not None]
        if sum(given) != 1:
            raise UsageError(
                "Give either --corners (twelve numbers, m), --measures, or --views with --calibration; one of them."
            )
        shape = _known_shape(self.shape)
        sigma, source = None, "measured"
        if self.views is not None:
            points, sigma, count = _triangulate_clicks(self.views, _points_of(shape), self.calibration, self.unit)
            source = f"clicked in {count} views; one standard deviation of a corner is {1000 * sigma:.1f} mm"
            values = [points]
        elif self.corners:
            values = [_by_points(_points_of(shape), self.corners)]
        else:
            values = _by_names(shape, self.measures)
        thing = Thing(self.name, shape(*values), self.kind.strip(), tuple(" ".join(self.tags).split()))
        warnings = append_object(self.objects, thing)
        (found,) = survey([thing])
        figures = {
            **{f"{field.name}_m": field.to_file(value, 1.0) for field, value in _lengths(thing.shape)},
            **found.figures,
            "corner_sigma_m": sigma,
            "database": str(self.objects),
            "warnings": warnings,
        }
        sides = " x ".join(f"{side:.3f}" for side in found.size_m)
        line = f"Added '{self.name}' to {self.objects}: {sides} m, {_origin(thing.shape, source)}."
        return Outcome(figures, (line, *warnings))


def _known_shape(name: str) -> type[AbstractShape]:
    from jaxpoint.pointing.shapes.registry import shapes

    known = shapes()
    if name not in known:
        raise UsageError(f"There is no shape '{name}'; choose among {', '.join(known)}.")
    return known[name]


def _points_of(shape: type[AbstractShape]) -> Field:
    """The field of a shape that is described by points alone."""
    if len(shape.fields) != 1 or not shape.fields[0].points:
        raise UsageError(f"A {shape.name} is not described by points; give --measures {_usage(shape)}.")
    return shape.fields[0]


def _usage(shape: type[AbstractShape]) -> str:
    """The words of `--measures`."""
    return " ".join(" ".join((field.name, *(column.upper() for column in _short(field)))) for field in shape.fields)


def _short(field: Field) -> tuple[str, ...]:
    return tuple(column.removeprefix(f"{field.name}_") for column in field.columns) if field.size else ("value",)


def _by_points(field: Field, numbers: tuple[float, ...]) -> np.ndarray:
    import numpy as np

    if len(numbers) != len(field.columns):
        raise UsageError(
            f"--corners has {len(numbers)} numbers; {len(field.points)} {field.name} have {len(field.columns)}."
        )
    return np.reshape(numbers, field.size)


def _by_names(shape: type[AbstractShape], words: tuple[str, ...]) -> list:
    """The values of a shape from its fields' names, each followed by its numbers."""
    import numpy as np

    names = [field.name for field in shape.fields]
    if words[0] not in names:
        raise UsageError(f"--measures begins with '{words[0]}'; a {shape.name} takes {_usage(shape)}.")
    given: dict[str, list[float]] = {}
    for word in words:
        if word in given:
            raise UsageError(f"--measures has '{word}' twice; give it once.")
        if word in names:
            given[word] = []
        else:
            given[list(given)[-1]].append(_number(word, shape))
    values = []
    for field in shape.fields:
        numbers = given.get(field.name, [] if field.default is None else [field.default])
        if len(numbers) != len(field.columns):
            raise UsageError(
                f"--measures has {len(numbers)} numbers for '{field.name}' where {len(field.columns)} are needed; a "
                f"{shape.name} takes {_usage(shape)}."
            )
        values.append(field.from_file(np.reshape(numbers, field.size) if field.size else numbers[0], 1.0))
    return values


def _number(word: str, shape: type[AbstractShape]) -> float:
    import math

    try:
        number = float(word)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise UsageError(f"--measures has '{word}', which is no finite number; a {shape.name} takes {_usage(shape)}.")
    return number


def _lengths(shape: AbstractShape) -> list[tuple[Field, np.ndarray]]:
    return [(field, value) for field, value in zip(shape.fields, shape.values) if not field.angle]


def _origin(shape: AbstractShape, source: str) -> str:
    """Where the values come from, and how well points fit the shape."""
    if not shape.fields[0].points:
        return f"a {shape.name}, {source}"
    return f"{shape.fields[0].name} {source}, {1000 * shape.residual:.1f} mm off their plane"


def _triangulate_clicks(
    views: Path, field: Field, calibration: Path | None, unit: str | None
) -> tuple[np.ndarray, float, int]:
    """Points (m), the largest standard deviation of one in any direction (m), and how many cameras took part."""
    import numpy as np

    from jaxpoint.io.exchange import read_calibration
    from jaxpoint.io.files import read_table
    from jaxpoint.io.rig_entries import needs_metres
    from jaxpoint.landmarks import CLICK_SIGMA_PX, MISCLICK_PX
    from jaxpoint.triangulation import triangulate

    if calibration is None:
        raise UsageError("--views needs the cameras: --calibration FILE, a calibration.json or the folder of a run.")
    saved = needs_metres(calibration, read_calibration(calibration), unit)
    rig = saved.rig
    order = field.points
    pixels, seen = np.zeros((len(order), len(rig), 2)), np.zeros((len(order), len(rig)), bool)
    for row in read_table(views, ("camera", "corner", "x", "y")):
        camera, corner = row.camera(rig.names), row.text("corner")
        if corner not in order:
            raise row.error(f"there is no corner '{corner}'; the corners are {', '.join(order)}.")
        place = order.index(corner), camera
        if seen[place]:
            raise row.error(f"the corner '{corner}' is given twice for camera '{rig.names[camera]}'; keep one.")
        pixels[place], seen[place] = (row.number("x"), row.number("y")), True
    for corner, count in zip(order, seen.sum(axis=1)):
        if count < 2:
            raise FileFormatError(f"{views} has the corner '{corner}' in {count} images; click it in two or more.")
    found = triangulate(rig, pixels, seen, sigma_px=CLICK_SIGMA_PX)
    miss = np.linalg.norm(np.asarray(found.residuals), axis=-1).max(axis=1)
    if miss.max() > MISCLICK_PX:
        raise FileFormatError(
            f"{views}: the clicks on the corner '{order[int(miss.argmax())]}' miss each other by {miss.max():.0f} px "
            f"(at most {MISCLICK_PX:.0f}); click it again."
        )
    spread = np.sqrt(np.linalg.eigvalsh(np.asarray(found.covariance))[:, -1].max())
    return np.asarray(found.points), float(spread), int(seen.any(axis=0).sum())
