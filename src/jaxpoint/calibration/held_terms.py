"""A lens model that was chosen poorer than the lens: a score test of the radial coefficients that are held."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from jaxpoint.calibration.normal import normal_equations
from jaxpoint.calibration.recording import NOISE_PX, Freedom
from jaxpoint.calibration.result import Calibration, Finding
from jaxpoint.camera.brown import Brown
from jaxpoint.camera.camera import Camera
from jaxpoint.camera.parameters import COEFFICIENTS, FOCAL, chosen_coefficients
from jaxpoint.camera.pinhole import Pinhole

CHANCE = 1e-4  # that held coefficients explain the residuals as well as free ones
MATTERS = 0.01  # change of a focal length under the free ones from which the result is wrong, not only improvable


def held_term_findings(calibration: Calibration) -> Iterator[Finding]:
    """Whether k1 and k2, where they are held, would explain what the solution does not."""
    tested = _as_brown(calibration)
    if tested is None or tested.freedom is None:
        return
    freedom = tested.freedom.at_noise(tested.sigma_px)
    free = freedom.free.copy()
    free[:, COEFFICIENTS] |= chosen_coefficients(Brown, ("k1", "k2"))[None]
    count = int(free.sum() - freedom.free.sum())
    if not count or not freedom.free[:, FOCAL].any():
        return
    try:
        step = normal_equations(tested).solve(replace(freedom, free=free))
    except np.linalg.LinAlgError:
        return
    if chi2.sf(step.gain, count) >= CHANCE:
        return
    change = np.abs(step.change[:, FOCAL])
    worst = int(np.abs(step.change[:, COEFFICIENTS.start]).argmax())
    yield Finding(
        "lens model",
        "bad" if change.max() > MATTERS else "care",
        f"The recording refutes the lens model that was asked for: with k1 and k2 free, that of "
        f"{calibration.rig.names[worst]} would change most, and focal lengths by up to {change.max():.1%}.",
        "Let the recording choose (--lens.distortion auto)",
        (calibration.rig.names[worst],),
    )


def _as_brown(calibration: Calibration) -> Calibration | None:
    """The calibration with Brown's lenses; None where the lens is of a kind that this test is not for."""
    cameras, freedom = calibration.rig.cameras, calibration.freedom
    if freedom is None or not calibration.sigma_px > 0 or not isinstance(cameras.lens, Brown | Pinhole):
        return None
    if isinstance(cameras.lens, Brown):
        return calibration
    more = ((0, 0), (0, len(Brown.coefficients)))
    sigmas = [coefficient.prior_sigma for coefficient in Brown.coefficients]
    weight = np.pad(freedom.prior_weight, more)
    weight[:, COEFFICIENTS] = (NOISE_PX / np.array(sigmas)) ** 2
    lens = Brown.of(cameras.focal, cameras.center)
    return replace(
        calibration,
        rig=replace(calibration.rig, cameras=Camera(lens, cameras.cam_from_world)),
        freedom=Freedom(np.pad(freedom.free, more), np.pad(freedom.prior_mean, more), weight),
    )
