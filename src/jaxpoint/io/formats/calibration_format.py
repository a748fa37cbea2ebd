"""What an exchange format of calibrations is: how its files are recognised, read and written, and what they hold."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec

from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.io.dialect import decode
from jaxpoint.io.files import UNITS, read_text
from jaxpoint.io.formats.storage_tree import parse_json
from jaxpoint.io.rig_entries import (
    UNSTATED,
    CameraEntry,
    SavedCalibration,
    check_entry,
    in_metres,
    rig_of_entries,
)

HEAD = 1 << 17  # bytes in which a file says what it is
KNOWN_UNITS = {"m": "metres", "cm": "centimetres", "mm": "millimetres"}
UNSIZED = (0, 0)  # px, the image size of a camera in a format that stores none


@dataclass(frozen=True)
class SourceFile:
    """A file that may hold cameras, read when it is looked at."""

    path: Path

    @cached_property
    def text(self) -> str:
        """All of it.

        Raises:
            FileFormatError: there is no such file, or it is not text.
        """
        return read_text(self.path)

    def json(self) -> Any:
        """What stands in it.

        Raises:
            FileFormatError: it is not JSON.
        """
        return parse_json(self.path, self.text)

    @cached_property
    def head(self) -> str:
        """Its beginning, enough to recognise it; empty where it is no text or cannot be read."""
        try:
            with self.path.open("rb") as file:
                start = file.read(HEAD)
            return decode(self.path, start[: start.rfind(b"\n") + 1] if len(start) == HEAD else start)
        except (OSError, FileFormatError):
            return ""


@dataclass(frozen=True)
class Request:
    """What is to be read, and what the caller knows beside it."""

    files: tuple[SourceFile, ...]
    title: str = "the format"  # its name for people
    poses: bool = True  # False: cameras may be lenses without poses
    size: tuple[int, int] | None = None  # px, of all images, for formats that store none
    label: str = ""  # what the user named: a file or a folder

    @property
    def where(self) -> str:
        """What messages begin with."""
        return self.label or str(self.files[0].path)

    @property
    def only(self) -> SourceFile:
        """The one file of a format that has one.

        Raises:
            UsageError: there are more.
        """
        if len(self.files) != 1:
            names = ", ".join(file.path.name for file in self.files)
            raise UsageError(f"{self.title} is one file, and these are {len(self.files)} ({names}); name one of them.")
        return self.files[0]

    def saved(
        self,
        cameras: Sequence[CameraEntry],
        *,
        unit: str = "m",
        notes: Sequence[str] = (),
        provenance: Mapping[str, Any] | None = None,
        in_room: bool = True,
    ) -> SavedCalibration:
        """The calibration of these cameras; lengths in mm or cm become metres.

        Raises:
            FileFormatError: a value is impossible, or a pose is missing where poses are needed.
            UsageError: an image size is not in the file and was not given.
        """
        sized = [self._sized(camera) for camera in cameras]
        for camera in sized:
            check_entry(f"{self.where}, camera '{camera.name}': ", camera)
        posed = all(camera.rotation is not None and camera.translation is not None for camera in sized)
        without = [camera.name for camera in sized if camera.rotation is None]
        if without and len(without) < len(sized):
            notes = (*notes, f"{self.where}: only lenses were taken, because camera '{without[0]}' has no pose.")
        rig = rig_of_entries(self.where, sized, self.poses)
        saved = SavedCalibration(
            rig, unit, provenance=dict(provenance or {}), in_room=in_room, posed=posed, notes=tuple(notes)
        )
        return in_metres(saved, unit) if unit in UNITS else saved

    def _sized(self, camera: CameraEntry) -> CameraEntry:
        if camera.size != UNSIZED:
            return camera
        return msgspec.structs.replace(camera, size=self.needed_size(f"camera '{camera.name}'"))

    def needed_size(self, what: str) -> tuple[int, int]:
        """The image size (px) that the caller gave.

        Raises:
            UsageError: none was given.
        """
        if self.size is None:
            raise UsageError(
                f"{self.where} holds no image size of {what}; give it: --size 1920x1080 (width x height, px), or "
                "size=(1920, 1080) in Python."
            )
        return self.size


@dataclass(frozen=True)
class Holds:
    """What the files of a format have a place for."""

    lenses: str  # in words
    unit: str  # of lengths: "m", "mm", "any" (the file says it), or UNSTATED
    poses: str = "camera from world"  # how they stand there, in words
    pixels: str = "centre"  # what (0, 0) is: the "centre" of the first pixel, or its "corner"
    sizes: bool = True  # whether image sizes are kept
    world: bool = True  # whether the world frame is kept; False: it becomes that of the first camera
    room: bool = False  # whether a file tells a frame that is not the room's, because it says so or is a camera's


Reader = Callable[[Request], SavedCalibration]
Writer = Callable[[SavedCalibration, Path], Mapping[str, bytes]]


@dataclass(frozen=True)
class CalibrationFormat:
    """One exchange format.

    Attributes:
        name: what `--from`, `--to` and `format=` call it.
        title: its name for people.
        patterns: names of its files, as "*.cameramodel"; OUT is matched with them, and folders are searched by them.
        recognise: whether a file is one of its own, from path and beginning; no guess: two formats never both agree.
        holds: what its files have a place for.
        read: from files to a calibration; None where it is only written.
        write: from a calibration and where it goes to the files: their names, and what is in them; None where it is
            only read.
        rename: what the cameras are called there, from what they are called here.
        more_losses: sentences of what else its files change, such as a lens that is fitted.
        per_camera: whether each camera may have a file of its own, so that every file of a folder must be read.
        needs_poses: whether it cannot be written of lenses without poses.
    """

    name: str
    title: str
    patterns: tuple[str, ...]
    recognise: Callable[[Path, str], bool]
    holds: Holds
    read: Reader | None = None
    write: Writer | None = None
    rename: Callable[[tuple[str, ...]], tuple[str, ...]] = tuple
    more_losses: Callable[[SavedCalibration], Sequence[str]] = lambda saved: ()
    per_camera: bool = False
    needs_poses: bool = True

    def losses(self, saved: SavedCalibration) -> tuple[str, ...]:
        """A sentence for each thing that its files have no place for; lenses it has no place for are refused."""
        if self.name == "jaxpoint":
            return ()
        lost = []
        if saved.covariance is not None:
            lost.append("the covariance of the cameras")
        if saved.time_offsets is not None:
            lost.append("the time offsets of the cameras")
        if saved.readout_times is not None:
            lost.append("the readout times of the cameras")
        if saved.rig.reach is not None:
            lost.append("how far each lens model holds (reach_px)")
        if not self.holds.sizes:
            lost.append("the image sizes (reading asks for --size)")
        said = [f"{self.title} has no place for {thing}; calibration.json keeps it." for thing in lost]
        if (names := self.rename(saved.rig.names)) != saved.rig.names:
            said.append(f"{self.title} names the cameras {', '.join(names)} for {', '.join(saved.rig.names)}.")
        if saved.posed and not self.holds.world:
            said.append(relative_frame(self.title, saved))
        if saved.posed and saved.unit not in KNOWN_UNITS and self.holds.unit != "any":
            unit = "whose unit was not stated" if saved.unit == UNSTATED else "in an arbitrary unit"
            said.append(f"{self.title} does not say the unit of lengths, and these are lengths {unit}.")
        if saved.posed and saved.unit == "m" and not saved.in_room and not self.holds.room:
            said.append(f"{self.title} does not say that its frame is not the room's (these metres have no floor).")
        if saved.posed and saved.unit in KNOWN_UNITS and self.holds.unit == UNSTATED:
            said.append(
                f"{self.title} does not say the unit of lengths (these are {KNOWN_UNITS[saved.unit]}): read it with "
                f"--unit {saved.unit}."
            )
        return (*said, *self.more_losses(saved))


def relative_frame(title: str, saved: SavedCalibration) -> str:
    """The sentence of a format whose poses are relative to the first camera."""
    return f"{title} has no world frame: poses are relative to camera '{saved.rig.names[0]}'."
