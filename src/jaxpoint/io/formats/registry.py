"""All exchange formats by name. To add one, write its file beside this one and list it here, or `register_format`."""

from __future__ import annotations

from jaxpoint.errors import UsageError
from jaxpoint.io.formats import (
    anipose_toml,
    calibration_json_format,
    caliscope_toml,
    pose2sim_toml,
)
from jaxpoint.io.formats.calibration_format import CalibrationFormat

FORMATS: dict[str, CalibrationFormat] = {
    module.FORMAT.name: module.FORMAT
    for module in (
        calibration_json_format,
        anipose_toml,
        caliscope_toml,
        pose2sim_toml,
    )
}


def register_format(fmt: CalibrationFormat) -> None:
    """Make a format known by its name, to Python and to the commands of the program that registers it.

    Raises:
        ValueError: another format has the name.
    """
    if FORMATS.get(fmt.name, fmt) is not fmt:
        raise ValueError(f"A format called '{fmt.name}' is known already; choose another name.")
    FORMATS[fmt.name] = fmt


def format_of_name(name: str) -> CalibrationFormat:
    """The format of a name.

    Raises:
        UsageError: there is none.
    """
    if name not in FORMATS:
        raise UsageError(
            f"There is no format '{name}'; the formats are {', '.join(FORMATS)} (`jaxpoint convert --list`)."
        )
    return FORMATS[name]
