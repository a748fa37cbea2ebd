"""Cameras that were said to have one lens, and do not: a score test of lenses of their own (Rao 1948)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from jaxpoint.calibration.normal import NormalEquations
from jaxpoint.calibration.result import Calibration, Finding
from jaxpoint.camera.parameters import FOCAL

CHANCE = 1e-4  # that one lens explains the residuals as well as one for each camera
MATTERS = 0.01  # change of a focal length under its own lens from which the result is wrong, not only improvable


def shared_lens_findings(calibration: Calibration, normal: NormalEquations | None) -> Iterator[Finding]:
    """Whether lenses of their own would explain what a shared one does not."""
    freedom = calibration.freedom
    if normal is None or freedom is None or freedom.owner is None or not freedom.free[:, FOCAL].any():
        return
    owner, freedom = freedom.owner, freedom.at_noise(calibration.sigma_px)
    weight = freedom.prior_weight.copy()
    weight[:, FOCAL:] = weight[owner, FOCAL:]
    own = replace(freedom, prior_weight=weight, owner=None)
    try:
        step = normal.solve(own)
    except np.linalg.LinAlgError:
        return
    if chi2.sf(step.gain, own.parameters - freedom.parameters) >= CHANCE:
        return
    change = np.exp(np.clip(step.change[:, FOCAL], -1.0, 1.0)) - 1.0
    groups = [np.flatnonzero(owner == camera) for camera in np.unique(owner)]
    worst = max(groups, key=lambda group: float(np.ptp(change[group])))
    spread = float(np.ptp(change[worst]))
    names = tuple(calibration.rig.names[camera] for camera in worst)
    yield Finding(
        "shared lens",
        "bad" if spread > MATTERS else "care",
        f"The recording refutes that {', '.join(names)} have one lens: with lenses of their own their focal lengths "
        f"would differ by about {spread:.1%}.",
        "Name only cameras of one kind at the same zoom and focus (--lens.shared), or leave it out",
        names,
    )
