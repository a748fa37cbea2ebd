"""The quality gate of a calibration from boards: fit, inliers, what is known of each lens, poor views, coverage."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from jaxpoint.calibration.board_figures import ViewFit, different_views, view_fits, where_next
from jaxpoint.calibration.normal import normal_equations
from jaxpoint.calibration.pair_poses import pair_scatter
from jaxpoint.calibration.quality import GateCheck, Quality, plain_checks
from jaxpoint.calibration.result import Calibration, Finding, Level
from jaxpoint.calibration.shared_checks import shared_lens_findings
from jaxpoint.camera.camera import POSE_NAMES
from jaxpoint.config import CalibrateSettings

FEWEST_VIEWS = 3  # different ones that a lens takes
FEW_VIEWS, COVERED = 8, 0.6  # views of a camera, and share of its image's cells: with less it deserves a look
TILTED = 15.0  # degrees: boards that are all seen more frontally do not tell a focal length
LOOSE = 0.2  # of the largest focal sigma that is allowed: from here on worth a word
SCATTER = 3.0  # times what the corners explain: poses between two cameras differ from view to view


def assess_boards(calibration: Calibration, settings: CalibrateSettings | None = None) -> Quality:
    """Hold a calibration of `calibrate_boards` against its settings; needs its covariance."""
    settings = settings or CalibrateSettings()
    views = view_fits(calibration)
    found = [*_shared(calibration), *calibration.findings, *_poor(calibration, views),
             *_lenses(calibration, settings, views), *_coverage(calibration, views), *_pairs(calibration)]  # fmt: skip
    order = {"bad": 0, "care": 1, "good": 2}
    return Quality(tuple(_checks(calibration, settings)), tuple(sorted(found, key=lambda item: order[item.level])))


def _shared(calibration: Calibration) -> Iterator[Finding]:
    """Lenses that were said to be one, and are not."""
    if calibration.freedom is not None and calibration.freedom.owner is not None:
        yield from shared_lens_findings(calibration, normal_equations(calibration))


def _checks(calibration: Calibration, settings: CalibrateSettings) -> Iterator[GateCheck]:
    yield from plain_checks(calibration, settings, int(calibration.tracks.visible.sum()), "corners")
    for name, sigma in zip(calibration.rig.names, focal_sigmas(calibration)):
        yield GateCheck(
            f"Focal length of {name}, one standard deviation",
            f"{sigma:.2%}" if np.isfinite(sigma) else "not determined",
            f"at most {settings.max_focal_sigma:.0%}",
            "good" if sigma <= settings.max_focal_sigma else "bad",
            f"the focal length of {name} is known to {sigma:.0%} only; hold the board tilted by 30 to 45 degrees, near "
            "and far, in every part of the image"
            if np.isfinite(sigma)
            else f"the views do not determine the lens of {name}; hold the board tilted to all sides",
        )


def focal_sigmas(calibration: Calibration) -> np.ndarray:
    """(C,) relative standard deviation of each focal length; infinite without a covariance."""
    cameras = len(calibration.rig)
    if calibration.camera_covariance is None:
        return np.full(cameras, np.inf)
    own = np.sqrt(np.maximum(np.diagonal(calibration.camera_covariance), 0.0)).reshape(cameras, -1)
    return own[:, len(POSE_NAMES)] / np.asarray(calibration.rig.cameras.focal)[:, 0]


def _poor(calibration: Calibration, views: list[ViewFit]) -> Iterator[Finding]:
    poor = [view for view in views if view.poor]
    if not poor:
        return
    worst = sorted(poor, key=lambda view: -view.rms_px)[:4]
    names = calibration.rig.names
    shown = ", ".join(f"{names[view.camera]} frame {view.frame_id} ({view.rms_px:.2f} px)" for view in worst)
    yield Finding(
        "poor views",
        "care",
        f"{len(poor)} of {len(views)} views fit much worse than the others: {shown}.",
        "Look whether the board moved or was bent there, or its corners are wrong, and leave such images out",
        tuple(dict.fromkeys(names[view.camera] for view in poor)),
    )


def _lenses(calibration: Calibration, settings: CalibrateSettings, views: list[ViewFit]) -> Iterator[Finding]:
    sigmas = focal_sigmas(calibration)
    for camera, name in enumerate(calibration.rig.names):
        own = [view for view in views if view.camera == camera]
        if not own or not sigmas[camera] > LOOSE * settings.max_focal_sigma:
            continue
        tilt = max(view.tilt_deg for view in own)
        level: Level = "bad" if sigmas[camera] > settings.max_focal_sigma else "care"
        known = f"is known to {sigmas[camera]:.1%} only" if np.isfinite(sigmas[camera]) else "is not determined"
        why = f"{len(own)} views, tilted by {tilt:.0f} degrees at most"
        cause = "frontal board" if tilt < TILTED else "loose focal length"
        yield Finding(
            cause,
            level,
            f"The focal length of {name} {known} ({why}).",
            "Hold the board tilted by 30 to 45 degrees to all sides, near and far",
            (name,),
        )


def _coverage(calibration: Calibration, views: list[ViewFit]) -> Iterator[Finding]:
    for camera, name in enumerate(calibration.rig.names):
        count, places = sum(view.camera == camera for view in views), different_views(calibration, camera)
        share = float(calibration.pairs.coverage[camera])
        if places >= FEW_VIEWS and share >= COVERED:
            continue
        level: Level = "bad" if places < FEWEST_VIEWS else "care"
        place = where_next(calibration, camera)
        there = "in the parts without corners" if place is None else f"in the {place[1]} of the image"
        yield Finding(
            "coverage",
            level,
            f"Camera {name} has {count} views of {places} different poses, with corners in {share:.0%} of its image.",
            f"Hold the board next {there}, tilted",
            (name,),
        )


def _pairs(calibration: Calibration) -> Iterator[Finding]:
    """Cameras that do not stand still to each other from view to view, as boards have it."""
    names = calibration.rig.names
    for scatter in pair_scatter(calibration):
        if scatter.ratio <= SCATTER:
            continue
        yield Finding(
            "boards disagree",
            "care",
            f"Between {names[scatter.first]} and {names[scatter.second]} single views put the second camera "
            f"{1e3 * scatter.shift_m:.1f} mm and {scatter.turn_deg:.2f} degrees from where all do (rms), "
            f"{scatter.ratio:.0f} times what the noise of corners explains: the images are not of the same moment and "
            "the board moved, or it is not flat.",
            "Hold the board still for every image (on a stand), or trigger the cameras together",
            (names[scatter.first], names[scatter.second]),
        )
