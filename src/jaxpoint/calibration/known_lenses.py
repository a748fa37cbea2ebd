"""Given lenses that the recording contradicts: a file of another mode, zoom or camera."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.calibration.normal import NormalEquations
from jaxpoint.calibration.recording import NOISE_PX, SIGMA_KNOWN, Freedom
from jaxpoint.calibration.result import Calibration, Finding
from jaxpoint.camera.parameters import ASPECT, CENTER, FOCAL

REFUTED = 4.0  # sigmas of what a careful lens calibration leaves open (1 % of a focal length) and of this recording
LOOSE = 0.5  # sigma of a log focal length, and of a principal point in image widths, that are unknown again


@dataclass(frozen=True)
class LensTest:
    """Given focal lengths against what the recording says when each lens by itself is unknown."""

    given: Float[np.ndarray, " C"]  # px
    found: Float[np.ndarray, " C"]  # px
    sigmas: Float[np.ndarray, " C"]  # of their difference; 0 where no lens was given

    @property
    def refuted(self) -> Bool[np.ndarray, " C"]:
        """Cameras whose given lens is contradicted."""
        return self.sigmas > REFUTED


def given_lenses(freedom: Freedom) -> Bool[np.ndarray, " C"]:
    """Cameras with a given lens: only these have a prior on the focal length."""
    return freedom.prior_weight[:, FOCAL] > 2 * (NOISE_PX / LOOSE) ** 2


def lens_test(calibration: Calibration, normal: NormalEquations) -> LensTest | None:
    """Free the lens of one camera at a time, the others as they are; None where no lens was given."""
    if calibration.freedom is None or not given_lenses(calibration.freedom).any():
        return None
    freedom = calibration.freedom.at_noise(calibration.sigma_px)
    widths = np.asarray(calibration.rig.image_sizes)[:, 0].astype(float)
    given, solution = freedom.prior_mean[:, FOCAL], normal.parameters[:, FOCAL]
    found, sigmas = solution.copy(), np.zeros(len(given))
    for camera in np.flatnonzero(given_lenses(calibration.freedom)).tolist():
        try:
            step = normal.solve(unknown_again(freedom, camera, widths, calibration.sigma_px))
        except np.linalg.LinAlgError:
            return None
        found[camera] += np.clip(step.change[camera, FOCAL], -1.0, 1.0)
        spread = np.hypot(step.sigmas[camera, FOCAL], SIGMA_KNOWN[0])
        sigmas[camera] = abs(found[camera] - given[camera]) / spread
    return LensTest(np.exp(given), np.exp(found), sigmas)


def unknown_again(freedom: Freedom, camera: int, widths: Float[np.ndarray, " C"], noise_px: float) -> Freedom:
    """The freedom with hardly a prior on the lens of one camera, for pixels of this noise."""
    free, weight = freedom.free.copy(), freedom.prior_weight.copy()
    free[camera, FOCAL:] = True
    free[camera, ASPECT] = freedom.free[camera, ASPECT]
    weight[camera, FOCAL] = (noise_px / LOOSE) ** 2
    weight[camera, CENTER] = (noise_px / (LOOSE * widths[camera])) ** 2
    return replace(freedom, free=free, prior_weight=weight).with_shared_priors()


def refuted_lenses(test: LensTest, names: tuple[str, ...]) -> Iterator[Finding]:
    """What is said of given lenses that were given up."""
    for camera in np.flatnonzero(test.refuted):
        yield Finding(
            "given lens",
            "care",
            f"The recording contradicts the given lens of {names[camera]} (focal length {test.given[camera]:.0f} px, "
            f"about {test.found[camera]:.0f} px here); it was solved for as if nothing were known.",
            f"Is the file of another mode, zoom or resolution of {names[camera]}? Give the right one",
            (names[camera],),
        )


def known_lens_findings(calibration: Calibration, normal: NormalEquations | None) -> Iterator[Finding]:
    """Given lenses that do not belong to the recording."""
    test = None if normal is None else lens_test(calibration, normal)
    if test is None:
        return
    for camera in np.flatnonzero(test.refuted):
        name = calibration.rig.names[camera]
        yield Finding(
            "given lens",
            "bad",
            f"The recording contradicts the given lens of {name}: its focal length is {test.given[camera]:.0f} px in "
            f"the file and about {test.found[camera]:.0f} px here ({test.sigmas[camera]:.0f} sigmas).",
            f"Is the file of another mode, zoom or resolution of {name}? Give the right one, or calibrate without "
            "known lenses",
            (name,),
        )
