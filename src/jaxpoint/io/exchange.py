"""Calibrations from and to files of every exchange format: recognised by what is in them, or named."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from contextlib import ExitStack
from fnmatch import fnmatch
from pathlib import Path

from jaxpoint.calibration.result import Calibration
from jaxpoint.camera.rig import CameraRig
from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.io.files import StrPath, natural_key, replacing
from jaxpoint.io.formats.calibration_format import CalibrationFormat, Request, SourceFile
from jaxpoint.io.formats.format_registry import FORMATS, format_of_name
from jaxpoint.io.rig_entries import SavedCalibration

logger = logging.getLogger(__name__)
Paths = StrPath | Sequence[StrPath]


def read_calibration(
    path: Paths, format: str | None = None, *, size: tuple[int, int] | None = None
) -> SavedCalibration:
    """A rig from a file, several files, or a folder of any format that `jaxpoint convert --list` names.

    Args:
        path: one or more files, a folder of them, or the folder of a run.
        format: its name; None to recognise it by what is in the files.
        size: width and height of all images (px), for formats that store none.

    Raises:
        FileFormatError: it is of no format, of several, or a value is missing or wrong (the message gives its place).
        UsageError: there is no such format, or a size is needed and not given.
    """
    saved = read_cameras(path, format, size=size)
    for note in saved.notes:
        logger.warning("%s", note)
    return saved


def read_lenses(path: Paths, format: str | None = None, *, size: tuple[int, int] | None = None) -> CameraRig:
    """Known lenses from whatever `read_calibration` reads, with or without poses.

    Raises:
        FileFormatError: as `read_calibration`, or a lens is of a model that is not known.
        UsageError: as `read_calibration`.
    """
    return read_cameras(path, format, size=size, poses=False).rig


def read_cameras(
    path: Paths, format: str | None = None, *, size: tuple[int, int] | None = None, poses: bool = True
) -> SavedCalibration:
    """As `read_calibration`, without a word of what must be known beside it; `poses` False lets cameras go without."""
    paths = _paths(path)
    label = str(paths[0]) if len(paths) == 1 else ", ".join(map(str, paths))
    wanted = None if format is None else format_of_name(format)
    files, folder = _files(paths, wanted)
    chosen, files = _chosen(label, files, folder, wanted)
    if chosen.read is None:
        raise UsageError(f"{chosen.title} is only written, not read.")
    return chosen.read(Request(files, chosen.title, poses, size, label))


def is_calibration(path: StrPath) -> bool:
    """Whether a file is of some exchange format, by what is in it."""
    file = SourceFile(Path(path))
    return any(fmt.recognise(file.path, file.head) for fmt in FORMATS.values() if fmt.read is not None)


def _paths(path: Paths) -> list[Path]:
    given = [path] if isinstance(path, str) or not isinstance(path, Sequence) else list(path)
    if not given:
        raise UsageError("Give one or more files to read.")
    return [Path(one) for one in given]


def _files(paths: list[Path], wanted: CalibrationFormat | None) -> tuple[list[SourceFile], bool]:
    """The files to look at, and whether they are all of a folder (of which some may be other things)."""
    if len(paths) == 1 and paths[0].is_dir():
        run = paths[0] / "calibration.json"
        if run.is_file() and (wanted is None or run.name in wanted.patterns):
            return [SourceFile(run)], False
        known = [pattern for one in FORMATS.values() for pattern in one.patterns]
        inside = [path for path in paths[0].iterdir() if path.is_file() and any(_fits(path, p) for p in known)]
        return [SourceFile(path) for path in sorted(inside, key=lambda path: natural_key(path.name))], True
    for path in paths:
        if not path.is_file():
            what = "is a folder; name its files" if path.is_dir() else "is not there; check the path"
            raise FileFormatError(f"There is no file {path}: it {what}.")
    return [SourceFile(path) for path in paths], False


def _fits(path: Path, pattern: str) -> bool:
    return fnmatch(path.name.lower(), pattern.lower())


def _chosen(
    label: str, files: list[SourceFile], folder: bool, wanted: CalibrationFormat | None
) -> tuple[CalibrationFormat, tuple[SourceFile, ...]]:
    """The format, and which of the files are of it."""
    if wanted is not None:
        own = [file for file in files if any(_fits(file.path, pattern) for pattern in wanted.patterns)]
        return wanted, tuple(_of_folder(label, wanted, own) if folder else files)
    claims = {
        name: own
        for name, one in FORMATS.items()
        if one.read is not None and (own := [file for file in files if one.recognise(file.path, file.head)])
    }
    if not claims:
        raise FileFormatError(
            f"{label} holds no calibration of a known format; name it by --from NAME (format= in Python) if it is one "
            f"of {', '.join(name for name, one in FORMATS.items() if one.read is not None)}."
        )
    if len(claims) > 1:
        raise FileFormatError(
            f"{label} holds calibrations of several formats ({', '.join(claims)}); name one by --from NAME (format= in "
            "Python), or give its files alone."
        )
    name, own = next(iter(claims.items()))
    other = [file.path.name for file in files if file not in own]
    if other and not folder:
        raise FileFormatError(
            f"{other[0]} is no file of {FORMATS[name].title}, as {own[0].path.name} is; leave it out."
        )
    return FORMATS[name], tuple(_of_folder(label, FORMATS[name], own, files) if folder else own)


def _of_folder(
    label: str, fmt: CalibrationFormat, own: list[SourceFile], files: Sequence[SourceFile] = ()
) -> list[SourceFile]:
    """The files of a folder; none of a format with one file a camera may be left out in silence."""
    if not own:
        raise FileFormatError(f"{label} holds no file of {fmt.title} ({', '.join(fmt.patterns)}).")
    if fmt.per_camera:
        for file in files:
            if file not in own and any(_fits(file.path, pattern) for pattern in fmt.patterns):
                raise FileFormatError(
                    f"{file.path} is no file of {fmt.title}, as {own[0].path.name} beside it is; mend it, or name the "
                    "files one by one."
                )
    return own


def write_calibration(
    calibration: Calibration | SavedCalibration | CameraRig, path: StrPath, format: str | None = None
) -> tuple[str, ...]:
    """Write a calibration in any format that `jaxpoint convert --list` names, at once or not at all.

    Args:
        calibration: a `CameraRig` counts as one in metres.
        path: the file, or the folder of a format of several files; existing files are replaced.
        format: its name; None where the name of the file says it, as `camera_array.toml` does.

    Returns:
        A sentence for each thing that the format has no place for and that is lost, such as the covariance.

    Raises:
        UsageError: there is no such format, the name does not say it, or it has no place for a lens.
        ValueError: a number is not finite.
    """
    saved, chosen = saved_of(calibration), format_to_write(Path(path), format)
    write_files(Path(path), files_of(saved, chosen, Path(path)))
    return chosen.losses(saved)


def saved_of(calibration: Calibration | SavedCalibration | CameraRig) -> SavedCalibration:
    """What of a calibration goes into files."""
    if isinstance(calibration, SavedCalibration):
        return calibration
    if isinstance(calibration, CameraRig):
        return SavedCalibration(calibration)
    return SavedCalibration(
        calibration.rig,
        calibration.unit,
        calibration.camera_covariance,
        calibration.gauge,
        time_offsets=calibration.time_offsets,
        in_room=calibration.in_room,
        readout_times=calibration.readout_times,
    )


def format_to_write(path: Path, name: str | None) -> CalibrationFormat:
    """The format to write: that of the name, or the only one whose files are called so.

    Raises:
        UsageError: there is no such format, none is called so, several are, or it is only read.
    """
    writable = [one for one in FORMATS.values() if one.write is not None]
    if name is not None:
        fmt = format_of_name(name)
        if fmt.write is None:
            raise UsageError(f"{fmt.title} is only read, not written.")
        return fmt
    exact = [one for one in writable if path.name.lower() in (pattern.lower() for pattern in one.patterns)]
    fits = exact or [one for one in writable if any(_fits(path, pattern) for pattern in one.patterns)]
    if len(fits) != 1:
        which = "no format's" if not fits else f"that of several formats ({', '.join(one.name for one in fits)})"
        raise UsageError(
            f"The name '{path.name}' is {which}; say the format by --to NAME (format= in Python): `jaxpoint convert "
            "--list` names them all."
        )
    return fits[0]


def files_of(saved: SavedCalibration, fmt: CalibrationFormat, path: Path) -> dict[str, bytes]:
    """What a format writes: names of files and what is in them.

    Raises:
        UsageError: it has no place for a lens, needs poses and there are none, is several files and `path` is one, or
            others of its files are in the folder.
    """
    assert fmt.write is not None
    if fmt.holds.unit == "mm" and saved.unit != "m":
        raise UsageError(
            f"{fmt.title} is in millimetres, and these lengths are in no known unit ('{saved.unit}'); give --unit, or "
            "bring them into the room by `jaxpoint align`."
        )
    if not saved.posed and fmt.needs_poses:
        raise UsageError(f"{fmt.title} needs the poses of the cameras, and there are only lenses.")
    files = dict(fmt.write(saved, path))
    if len(files) > 1 and any(_fits(path, pattern) for pattern in fmt.patterns) and not path.is_dir():
        raise UsageError(
            f"{fmt.title} is {len(files)} files here ({', '.join(files)}); name a folder, not '{path.name}'."
        )
    inside = path.iterdir() if fmt.per_camera and path.is_dir() else ()
    others = [file.name for file in inside if file.name not in files and any(_fits(file, p) for p in fmt.patterns)]
    if others:
        raise UsageError(f"'{path}' holds {others[0]} already, which would be read as a camera too; name a new folder.")
    return files


def write_files(path: Path, files: dict[str, bytes]) -> None:
    """One file as `path`, several into the folder `path`; all at once or none.

    Raises:
        UsageError: there are several, and `path` is a file.
    """
    if len(files) == 1 and not path.is_dir():
        with replacing(path) as file:
            file.write(next(iter(files.values())))
        return
    if path.is_file():
        raise UsageError(f"{', '.join(files)} do not fit into the one file '{path}'; name a folder.")
    made = not path.exists()
    path.mkdir(exist_ok=True)
    try:
        with ExitStack() as stack:
            for name, content in files.items():
                stack.enter_context(replacing(path / name)).write(content)
    except BaseException:
        if made and not any(path.iterdir()):
            path.rmdir()
        raise
