"""`jaxpoint convert`: a calibration from any exchange format to any other."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from jaxpoint.commands.console import Console
from jaxpoint.commands.options import Options, Outcome
from jaxpoint.config import RoomConfig, Unit
from jaxpoint.errors import UsageError

if TYPE_CHECKING:
    from jaxpoint.io.formats.calibration_format import CalibrationFormat
    from jaxpoint.io.rig_entries import SavedCalibration

OWN_AXES = {"jaxpoint": "z up", "gltf": "y up"}  # formats whose world is said by what they are


@dataclass(frozen=True, kw_only=True)
class Convert(Options):
    """Convert a calibration between the formats of calibration tools.

    jaxpoint convert camera_array.toml calibration.json

    jaxpoint convert runs/room-m colmap/ --to colmap

    jaxpoint convert intri.yml extri.yml calibration.toml --to anipose --size 1920x1080

    jaxpoint convert runs/room-m rig.toml --to anipose --world opengl --out-unit mm

    jaxpoint convert --list

    The last path is the file or folder to write (or give --out). Input is recognised by what is in it. What a format
    has no place for is said in a sentence; a lens it has no place for is refused.
    """

    paths: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="IN... OUT")] = ()
    """Files or a folder to read, then the file or folder to write."""
    from_: Annotated[str | None, tyro.conf.arg(name="from")] = None
    """Format of the input, where what is in it does not tell."""
    to: str | None = None
    """Format of the output, where its name does not tell."""
    size: str | None = None
    """WIDTHxHEIGHT of all images, px, as 1920x1080: for formats that store no image size."""
    unit: Unit = None
    """Unit of the lengths of an input that does not say it."""
    world: str | None = None
    """Axes of the output where they are not those of the room (z up): opengl, opensim, opencv, ... or what x, y and z
    are in the room, as x,z,-y."""
    from_world: str | None = None
    """Axes of the input, likewise."""
    out_unit: Unit = None
    """Unit of the output, m, cm or mm, for a format that leaves it open."""
    list_: Annotated[bool, tyro.conf.arg(name="list")] = False
    """List the formats and what each has a place for."""

    @staticmethod
    def with_defaults(room: RoomConfig) -> Convert:
        """The command's defaults under a configuration file."""
        return Convert(runtime=room.runtime)

    def run(self, console: Console) -> Outcome:
        """Read, and write what the other format has a place for."""
        from jaxpoint.io.exchange import files_of, format_to_write, read_cameras, write_files

        if self.list_:
            return _listing()
        sources, target = self._sources_and_target()
        fmt = format_to_write(target, self.to)
        saved = _in_unit(sources, read_cameras(sources, self.from_, size=_size(self.size), poses=False), self.unit)
        saved, axes = self._in_worlds(saved, fmt)
        files = files_of(saved, fmt, target)
        self._spare(sources, target, files)
        write_files(target, files)
        said = (*saved.notes, *fmt.losses(saved), *axes)
        figures = {
            "out": str(target),
            "format": fmt.name,
            "files": list(files),
            "unit": saved.unit,
            "notes": list(said),
        }
        return Outcome({**figures, "cameras": list(saved.rig.names)}, (_summary(saved, fmt, target), *said))

    def _in_worlds(self, saved: SavedCalibration, fmt: CalibrationFormat) -> tuple[SavedCalibration, tuple[str, ...]]:
        """The calibration in the axes and the unit of the output, and what its reader must know of them.

        Raises:
            UsageError: a world is not known or left-handed, or the format has axes or a unit of its own.
        """
        from jaxpoint.geometry.world_axes import WORLDS, world_of
        from jaxpoint.io.world_conversion import from_world, to_unit, to_world

        world = world_of(self.world or "room")
        turned = world.axes != WORLDS["room"].axes
        if turned and fmt.name in OWN_AXES:
            raise UsageError(f"{fmt.title} always has {OWN_AXES[fmt.name]}; leave out --world {self.world}.")
        if self.from_world is not None:
            saved = from_world(saved, world_of(self.from_world))
        if turned:
            saved = to_world(saved, world)
        if self.out_unit is not None:
            saved = to_unit(saved, fmt, self.out_unit)
        said = f"The axes of the output are {world} of the room; read it with --from-world {self.world}."
        return saved, (said,) if turned else ()

    def _sources_and_target(self) -> tuple[list[Path], Path]:
        paths = list(self.paths)
        target = self.out if self.out is not None else (paths.pop() if paths else None)
        if target is None or not paths:
            raise UsageError(
                "Say what to read and what to write: jaxpoint convert IN... OUT; the formats: jaxpoint convert --list."
            )
        return paths, target

    def _spare(self, sources: list[Path], target: Path, files: dict[str, bytes]) -> None:
        """Refuse to replace what is read, and without `--force` what exists.

        Raises:
            UsageError: either, or the folder of the target does not exist.
        """
        inside = len(files) > 1 or target.is_dir()
        written = [target / name for name in files] if inside else [target]
        for path in written:
            if any(path.resolve() in (source.resolve(), (source / path.name).resolve()) for source in sources):
                raise UsageError(f"'{path}' is read and would be replaced; choose another output.")
            if path.exists() and not self.force:
                raise UsageError(f"'{path}' exists; choose another output, or replace it by --force.")
        if not target.absolute().parent.is_dir():
            raise UsageError(f"There is no folder '{target.parent}'; make it, or choose another output.")


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    match = re.fullmatch(r"([1-9]\d{0,5})[xX×]([1-9]\d{0,5})", text.strip())
    if match is None:
        raise UsageError(f"--size '{text}' is no size of images; write WIDTHxHEIGHT in pixels, as 1920x1080.")
    return int(match[1]), int(match[2])


def _in_unit(sources: list[Path], saved: SavedCalibration, unit: str | None) -> SavedCalibration:
    """In metres, where the unit is given and the file does not say it."""
    from jaxpoint.io.rig_entries import UNSTATED, in_metres

    if unit is None:
        return saved
    if saved.unit != UNSTATED:
        raise UsageError(f"'{sources[0]}' says its unit ('{saved.unit}'); leave out --unit {unit}.")
    return in_metres(saved, unit)


def _summary(saved: SavedCalibration, fmt: CalibrationFormat, target: Path) -> str:
    cameras = f"{len(saved.rig)} cameras" if len(saved.rig) > 1 else "1 camera"
    lens = " and ".join(sorted({model.name for model in saved.rig.lens_models}))
    what = "" if saved.posed else ", lenses without poses"
    return f"{fmt.title} of {cameras} ({lens} lens{what}): {target}"


def _listing() -> Outcome:
    from jaxpoint.io.formats.format_registry import FORMATS

    width = max(len(name) for name in FORMATS)
    lines = [
        f"{fmt.name:<{width}}  {fmt.title} ({', '.join(fmt.patterns)}; {_ways(fmt)}): {fmt.holds.lenses}; unit "
        f"{fmt.holds.unit}; {fmt.holds.poses}; pixel (0, 0) {fmt.holds.pixels}"
        for fmt in FORMATS.values()
    ]
    figures = [
        {
            "name": fmt.name,
            "title": fmt.title,
            "files": list(fmt.patterns),
            "reads": fmt.read is not None,
            "writes": fmt.write is not None,
            "lenses": fmt.holds.lenses,
            "unit": fmt.holds.unit,
            "poses": fmt.holds.poses,
            "pixels": fmt.holds.pixels,
        }
        for fmt in FORMATS.values()
    ]
    return Outcome({"formats": figures}, tuple(lines))


def _ways(fmt: CalibrationFormat) -> str:
    return "read and written" if fmt.read and fmt.write else "read" if fmt.read else "written"
