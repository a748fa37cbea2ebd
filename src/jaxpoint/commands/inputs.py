"""What several commands read: tracks, known intrinsics, how long the detection took, numbers of a flag."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from jaxpoint.config import InputSettings, LensSettings
from jaxpoint.errors import FileFormatError, InsufficientDataError, UsageError

if TYPE_CHECKING:
    from jaxpoint.camera.rig import CameraRig
    from jaxpoint.tracks import Tracks


logger = logging.getLogger(__name__)
MAX_OUTSIDE = 0.05  # fraction of a camera's lights


def tracks_from(path: Path, settings: InputSettings, sizes: Mapping[str, tuple[int, int]] | None = None) -> Tracks:
    """The tracks of a command, without the cameras that are left out, and on one clock as far as the settings say.

    `sizes` are those of the images (px) by camera where a calibration says them, for files that do not.

    Raises:
        FileFormatError: the file or folder is not what it should be.
        InsufficientDataError: there are no frames, or the timestamps belong to another recording, or an offset leaves
            nothing of a camera.
        UsageError: a camera named in the settings is not in the tracks, or its offset or rate cannot be used.
    """
    from jaxpoint.commands.given_clocks import on_given_clock, without_left_out
    from jaxpoint.io.clicked_points import wand_tracks, with_static_points
    from jaxpoint.io.timestamps import read_timestamps, synchronise
    from jaxpoint.io.track_files import read_tracks

    tracks = read_tracks(
        path,
        one_based=settings.one_based,
        image_sizes=settings.image_size or sizes,
        min_likelihood=settings.min_likelihood,
        individual=settings.individual,
    )
    if not tracks.frames:
        raise InsufficientDataError(f"'{path}' holds 0 frames; record the light and detect it first.")
    if settings.wand_m is not None:
        tracks = wand_tracks(tracks, settings.wand_m, path)
    if settings.static_points is not None:
        tracks = with_static_points(tracks, settings.static_points, settings.image_size)
    tracks = without_left_out(tracks, settings.leave_out)
    _check_inside(tracks, path)
    if settings.timestamps is not None:
        tracks = synchronise(tracks, read_timestamps(settings.timestamps))
    return on_given_clock(tracks, settings)


def _check_inside(tracks: Tracks, path: Path) -> None:
    """A few lights outside their image are wrong detections; many mean that the image size is wrong."""
    inside = ((tracks.pixels >= -1) & (tracks.pixels <= tracks.image_sizes)).all(axis=2)
    outside = (tracks.visible & ~inside).sum(axis=0) / tracks.visible.sum(axis=0).clip(min=1)
    worst = int(outside.argmax())
    if outside[worst] > MAX_OUTSIDE:
        width, height = tracks.image_sizes[worst]
        raise FileFormatError(
            f"{outside[worst]:.0%} of the lights of camera '{tracks.names[worst]}' in '{path}' lie outside its image "
            f"of {width} x {height} px; correct the image size."
        )


def intrinsics_from(settings: InputSettings, tracks: Tracks) -> CameraRig | None:
    """Known lenses in the order of the tracks' cameras, or None where no file was given.

    Lenses of images of another size but the same shape are scaled, with a warning.

    Raises:
        FileFormatError: the file is not what it should be.
        UsageError: a camera is missing in it, or has images of another shape there.
    """
    from jaxpoint.io.exchange import read_lenses
    from jaxpoint.io.svoboda import read_rad_folder

    path = settings.intrinsics
    if path is None:
        return None
    if path.is_dir() and any(path.glob("*.rad")):
        return read_rad_folder(path, tracks.image_sizes, tracks.names, settings.one_based)
    sizes = {(int(width), int(height)) for width, height in tracks.image_sizes}
    lenses = read_lenses(path, size=sizes.pop() if len(sizes) == 1 else None)
    return _lenses_at_size(path, _in_order(path, lenses, tracks, settings.intrinsics_by_order), tracks)


def _in_order(path: Path, rig: CameraRig, tracks: Tracks, by_order: bool) -> CameraRig:
    """The lenses of the tracks' cameras under their names."""
    from jaxpoint.camera.rig import CameraRig
    from jaxpoint.io.lens_files import match_names

    places = list(range(len(rig))) if by_order else match_names(tracks.names, rig.names)
    if places is None or len(places) != len(tracks.names):
        alike = len(rig) == len(tracks.names) and not by_order
        remedy = "name them alike" + (", or give --intrinsics-by-order" if alike else "; every camera needs a lens")
        raise UsageError(
            f"'{path}' has the cameras {', '.join(rig.names)}, but the tracks have {', '.join(tracks.names)}: {remedy}."
        )
    chosen = rig.select(places)
    return CameraRig(chosen.cameras, chosen.image_sizes, tracks.names, chosen.reach)


def _lenses_at_size(path: Path, rig: CameraRig, tracks: Tracks) -> CameraRig:
    """The lenses at the size of the tracks' images."""
    from jaxpoint.io.lens_files import scale_lenses

    known, wanted = rig.image_sizes.tolist(), tracks.image_sizes.tolist()
    if known == wanted:
        return rig
    for name, (width, height), (wide, high) in zip(tracks.names, known, wanted):
        if abs(width * high - height * wide) > max(wide, high):  # a pixel's rounding of either side is none
            raise UsageError(
                f"Camera '{name}' has images of {wide} x {high} px, but '{path}' knows its lens for {width} x {height}:"
                " another shape, so cropped or of another mode; calibrate that lens in the mode that was recorded."
            )
    by = sorted({f"{wide / width:.3g}" for (width, _), (wide, _) in zip(known, wanted)})
    logger.warning("The lenses of '%s' are for images of another size and were scaled by %s.", path, " and ".join(by))
    return scale_lenses(rig, tracks.image_sizes)


def check_lens(lens: LensSettings, intrinsics: Path | None) -> None:
    """Refuse known intrinsics without their use, and their use without them.

    Raises:
        UsageError: either.
    """
    if intrinsics is not None and lens.known == "none":
        raise UsageError("With --intrinsics say what becomes of them: --lens.known hold, or --lens.known refine.")
    if intrinsics is None and lens.known != "none":
        raise UsageError(f"--lens.known {lens.known} needs a file of known intrinsics: --intrinsics FILE.")


def check_no_out(out: Path | None, does: str = "only prints") -> None:
    """Refuse `--out` where a command writes nothing there.

    Raises:
        UsageError: it was given.
    """
    if out is not None:
        raise UsageError(f"The command {does}, and nothing would come to '{out}'; leave out --out.")


def detection_summary(tracks: Path) -> Path:
    """Where `detect` writes how it went, beside the tracks."""
    return tracks.with_suffix(".json")


def hush_opencv(verbose: bool) -> None:
    """Keep OpenCV from printing what our own errors say in a sentence; to be called before it is imported."""
    if not verbose:
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
        os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")


def user_cache() -> Path:
    """Where the command line keeps what need not be made again: the user's cache folder."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxpoint"
