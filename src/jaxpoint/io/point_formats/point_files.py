"""Points out to a file whose ending says the format. To add one, write its file beside this one and list it here."""

from __future__ import annotations

from pathlib import Path

from jaxpoint.errors import UsageError
from jaxpoint.io.files import StrPath, replacing
from jaxpoint.io.point_formats import points_c3d, points_csv, points_trc
from jaxpoint.io.point_formats.point_series import PointFormat, PointSeries

POINT_FORMATS = {one.suffix: one for one in (points_csv.FORMAT, points_c3d.FORMAT, points_trc.FORMAT)}


def point_format_of(path: Path) -> PointFormat:
    """The format of a file that is to be written, with what it needs at hand.

    Raises:
        UsageError: its name ends otherwise.
        MissingDependencyError: what writes it is not installed.
    """
    if path.suffix.lower() not in POINT_FORMATS:
        raise UsageError(f"Points go to a file that ends in {', '.join(POINT_FORMATS)}, not '{path.name}'.")
    fmt = POINT_FORMATS[path.suffix.lower()]
    fmt.check(path)
    return fmt


def write_points(path: StrPath, series: PointSeries) -> tuple[str, ...]:
    """Write points, at once or not at all, in the format that the name of the file says.

    Returns:
        A sentence for each thing that the format has no place for.

    Raises:
        UsageError: there is no such format, or it needs the rate of the frames and that is not known.
        MissingDependencyError: what writes it is not installed.
    """
    fmt = point_format_of(Path(path))
    content = fmt.content(series)
    with replacing(path) as file:
        file.write(content)
    return fmt.losses
