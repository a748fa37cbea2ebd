"""Does the recording determine the cameras at all, and if not, which critical configuration is it?

The covariance says how well every focal length and every point of the light is determined. Where that is too little,
the geometry of the solution names the cause: critical motions of self-calibration (Sturm 1997; Kahl, Triggs and
Astrom 2000) keep their mark even where the solution drifts along the undetermined direction.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from jaxpoint.calibration.expected import expected_error
from jaxpoint.calibration.result import Calibration, Finding, Level
from jaxpoint.calibration.sight import centres, poses
from jaxpoint.calibration.uncertainty import uncertainty_of
from jaxpoint.camera.parameters import ASPECT, FOCAL
from jaxpoint.config import CalibrateSettings
from jaxpoint.errors import InsufficientDataError

POINTS = 200  # of the light, over which the expected error is taken
PARALLEL = np.deg2rad(50.0)  # axes that differ by less leave focal lengths open (4 cameras in a row: 16 % at 40)
SURELY_PARALLEL = np.deg2rad(10.0)  # the covariance deceives there: solutions drift to 0.25 of the focal length
ONE_PLACE = 0.08  # cameras nearer to each other than this share of their distance to the light
FLAT, THIN = 0.12, 0.12  # smallest (middle) over largest extent of the light: a plane (a line)
SHALLOW = 0.25  # range of the light's depth over its median, in every camera
GIVEN_UP = ("cropped image", "pixel aspect")  # priors that were wrong of this recording: the others are trusted less,
REFUTED_LIMIT = (
    0.45  # and only so much of the allowed errors is, as others may be wrong unseen (measured on doubtful rigs)
)
WORST_GAIN = 0.5  # a remedy is named if it lowers the expected error at least so much


@dataclass(frozen=True)
class Determinacy:
    """How well the recording determines a rig."""

    focal_sigmas: Float[np.ndarray, " C"]  # relative, one standard deviation
    expected: float  # rms error of the light's points that the cameras' errors make, rig's unit
    extent: float  # of the light: root mean square distance from its middle, rig's unit

    @property
    def relative(self) -> float:
        """The expected error as a share of the extent of the light."""
        return self.expected / self.extent if self.extent > 0 else float("inf")


def determinacy_of(calibration: Calibration) -> Determinacy | None:
    """From the covariance of the cameras; None without one."""
    covariance = calibration.camera_covariance
    points = calibration.points[calibration.point_valid]
    if covariance is None or len(points) < 2:
        return None
    chosen = points[np.linspace(0, len(points) - 1, min(POINTS, len(points))).astype(int)]
    found = expected_error(calibration.rig, covariance, calibration.sigma_px, chosen)
    known = found.calibration[found.seen.sum(axis=1) >= 2]
    sigmas = np.sqrt(np.maximum(np.diagonal(covariance), 0.0)).reshape(len(calibration.rig), -1)[:, FOCAL]
    spread = np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1))
    expected = float(np.sqrt(max(np.median(known), 0.0))) if len(known) else float("inf")
    return Determinacy(sigmas / np.asarray(calibration.rig.cameras.focal)[:, 0], expected, float(spread))


def determinacy_findings(calibration: Calibration, settings: CalibrateSettings) -> Iterator[Finding]:
    """The finding that the recording does not determine the rig, with the cause and what helps."""
    found = determinacy_of(calibration)
    if found is None:
        if calibration.undetermined and calibration.freedom is not None:
            cause, why, remedy = _cause(calibration)
            yield Finding(cause, "bad", f"The recording does not determine the cameras: {why}.", remedy)
        return
    worst = int(found.focal_sigmas.argmax())
    level = "bad" if _surely_parallel(calibration) else _level(calibration, found, settings)
    if level == "good":
        return
    cause, why, remedy = _cause(calibration)
    share = f"{found.relative:.1%} of" if found.relative < 1 else "more than"
    how = "hardly determines the cameras" if level == "bad" else "determines the cameras loosely"
    finding = (
        f"The recording {how}: {_focal(calibration, found, worst)}, and points of the light "
        f"are expected to be off by {share} its extent; {why}."
    )
    yield Finding(
        cause, level, finding, remedy + _with_known_lenses(calibration, found), (calibration.rig.names[worst],)
    )


def _surely_parallel(calibration: Calibration) -> bool:
    """Axes so nearly parallel that unknown focal lengths cannot be had, whatever the covariance says."""
    free = calibration.freedom is None or calibration.freedom.free[:, FOCAL].any()
    return bool(free and axes_angle(poses(calibration.rig)[0]) < SURELY_PARALLEL)


def _level(calibration: Calibration, found: Determinacy, settings: CalibrateSettings) -> Level:
    over = max(found.focal_sigmas.max() / settings.max_focal_sigma, found.relative / settings.max_expected_error)
    limit = REFUTED_LIMIT if any(item.cause in GIVEN_UP for item in calibration.findings) else 1.0
    return "bad" if over > limit else "care" if over > 0.5 * limit else "good"


def _focal(calibration: Calibration, found: Determinacy, camera: int) -> str:
    focal = float(np.asarray(calibration.rig.cameras.focal)[camera, 0])
    sigma = float(found.focal_sigmas[camera])
    shown = f"{focal:.0f} ± {focal * sigma:.0f} px" if sigma < 1 else "anything"
    return f"the focal length of {calibration.rig.names[camera]} may be {shown}"


def _with_known_lenses(calibration: Calibration, found: Determinacy) -> str:
    """What known lenses would do, computed."""
    freedom = calibration.freedom
    if freedom is None or not freedom.free[:, FOCAL].any():
        return ""
    free = freedom.free.copy()
    free[:, FOCAL:] = False
    try:
        held = uncertainty_of(replace(calibration, freedom=replace(freedom, free=free)))
    except InsufficientDataError:
        return ""
    then = determinacy_of(replace(calibration, camera_covariance=np.asarray(held.covariance)))
    if then is None or then.relative > WORST_GAIN * found.relative:
        return ""
    return (
        f"; or give known lenses (--intrinsics FILE --lens.known hold), with which {max(then.relative, 1e-4):.2%} is "
        "expected"
    )


def _cause(calibration: Calibration) -> tuple[str, str, str]:
    """The critical configuration that the solution shows: its name, a clause with the figure, and the cure."""
    rotation, _ = poses(calibration.rig)
    points = calibration.points[calibration.point_valid]
    places = centres(calibration.rig)
    angle = axes_angle(rotation)
    if calibration.freedom is not None and calibration.freedom.free[:, ASPECT].any():
        return (
            "pixel aspect",
            "the pixel aspects are unknown, and this recording leaves them open",
            "State the pixel aspect (--lens.aspect fixed for square pixels, 16/15 for PAL video), or turn one camera "
            "on its side",
        )
    if calibration.freedom is None or calibration.freedom.free[:, FOCAL].any():
        near = _nearness(places, points)
        if near < ONE_PLACE:
            return (
                "cameras in one place",
                f"the cameras stand within {near:.1%} of their distance to the light of each other",
                "Move the cameras apart",
            )
        if angle < PARALLEL:
            return (
                "parallel axes",
                f"the optical axes of all cameras are parallel within {np.rad2deg(angle):.1f} degrees, and with little "
                "relative rotation a light does not tell focal lengths",
                "Turn the cameras towards each other, by 60 degrees or more between two of them",
            )
    flat, thin = _shape(points)
    if thin < THIN:
        return "light on a line", f"the light moved along a line ({thin:.0%} as wide as long)", _WAVE
    if flat < FLAT:
        return "light on a plane", f"the light moved almost on a plane ({flat:.0%} as thick as long)", _WAVE
    depth = _depth_range(calibration)
    if depth < SHALLOW:
        return (
            "too little depth",
            f"the light's distance from each camera varies by {depth:.0%} at most",
            "Wave the light near the cameras and far from them",
        )
    if len(places) == 2:
        return "two cameras", "two cameras alone hardly tell focal lengths", "Add a third camera"
    return (
        "weak geometry",
        "too few observations at this noise, or cameras that share too little of the light's path, leave it open",
        "Wave the light longer and through the whole of every image, near and far",
    )


_WAVE = "Wave the light through the whole volume of the room, low and high, near and far"


def axes_angle(rotation: Float[np.ndarray, "C 3 3"]) -> float:
    """The largest angle between two optical axes, as lines, rad."""
    axes = rotation[:, 2]
    return float(np.arccos(np.clip(np.abs(axes @ axes.T), 0.0, 1.0)).max())


def _nearness(places: np.ndarray, points: np.ndarray) -> float:
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1).max()
    away = np.median(np.linalg.norm(points[:, None] - places[None], axis=-1)) if len(points) else np.inf
    return float(apart / away)


def _shape(points: Float[np.ndarray, "P 3"]) -> tuple[float, float]:
    """Smallest and middle extent of the light over its largest."""
    if len(points) < 4:
        return 0.0, 0.0
    centred = points - np.median(points, axis=0)
    far = np.linalg.norm(centred, axis=1)
    values = np.linalg.svd(centred[far <= 5 * np.median(far)], compute_uv=False)
    return float(values[2] / values[0]), float(values[1] / values[0])


def _depth_range(calibration: Calibration) -> float:
    """The largest over the cameras of the light's range of depth over its median."""
    rotation, translation = poses(calibration.rig)
    depth = np.einsum("cj,fj->fc", rotation[:, 2], calibration.points) + translation[:, 2]
    ranges = [
        (np.quantile(some, 0.95) - np.quantile(some, 0.05)) / max(abs(np.median(some)), 1e-12)
        for c in range(len(rotation))
        if len(some := depth[calibration.kept[:, c] & calibration.point_valid, c]) >= 4
    ]
    return float(max(ranges, default=0.0))
