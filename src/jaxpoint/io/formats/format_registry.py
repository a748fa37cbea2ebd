"""All exchange formats by name. To add one, write its file beside this one and list it here, or `register_format`."""

from __future__ import annotations

from jaxpoint.errors import UsageError
from jaxpoint.io.formats import (
    anipose_toml,
    calibration_json_format,
    caliscope_toml,
    colmap_rig,
    colmap_text,
    dlt_csv,
    easymocap_yml,
    gltf_scene,
    kalibr_yaml,
    mrcal_cameramodel,
    multicamselfcal_folder,
    nerf_transforms,
    opencv_storage,
    pose2sim_toml,
    qualisys_xml,
    ros_camera_info,
    strand_braid_xml,
    vicon_xcp,
)
from jaxpoint.io.formats.calibration_format import CalibrationFormat

FORMATS: dict[str, CalibrationFormat] = {
    module.FORMAT.name: module.FORMAT
    for module in (
        calibration_json_format,
        anipose_toml,
        caliscope_toml,
        pose2sim_toml,
        opencv_storage,
        kalibr_yaml,
        ros_camera_info,
        colmap_text,
        colmap_rig,
        nerf_transforms,
        easymocap_yml,
        mrcal_cameramodel,
        qualisys_xml,
        vicon_xcp,
        dlt_csv,
        multicamselfcal_folder,
        strand_braid_xml,
        gltf_scene,
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
