"""All formats of tracks by name. To add one, write its file beside this one and list it here, or `register_tracks`."""

from __future__ import annotations

from jaxpoint.io import clicked_points, svoboda
from jaxpoint.io.formats.calibration_format import SourceFile
from jaxpoint.io.track_formats import (
    caliscope_corners,
    deeplabcut_csv,
    deeplabcut_h5,
    long_csv,
    sleap_csv,
    sleap_h5,
)
from jaxpoint.io.track_formats.track_format import TrackFormat

TRACK_FORMATS: dict[str, TrackFormat] = {
    one.name: one
    for one in (
        svoboda.TRACK_FORMAT,
        caliscope_corners.FORMAT,
        clicked_points.FORMAT,
        deeplabcut_csv.FORMAT,
        deeplabcut_h5.FORMAT,
        sleap_h5.FORMAT,
        sleap_csv.FORMAT,
        long_csv.FORMAT,  # the last: it takes any table, so that what is wrong in it is said
    )
}


def register_tracks(fmt: TrackFormat) -> None:
    """Make a format of tracks known to `read_tracks`, and to the commands of the program that registers it.

    It is asked before those of the package.

    Raises:
        ValueError: another format has the name.
    """
    if TRACK_FORMATS.get(fmt.name, fmt) is not fmt:
        raise ValueError(f"A format of tracks called '{fmt.name}' is known already; choose another name.")
    others = {name: one for name, one in TRACK_FORMATS.items() if name != fmt.name}
    TRACK_FORMATS.clear()
    TRACK_FORMATS.update({fmt.name: fmt, **others})


def recognised(source: SourceFile) -> TrackFormat | None:
    """The format of a file or folder; None where it is of none."""
    return next((one for one in TRACK_FORMATS.values() if one.recognise(source.path, source.head)), None)
