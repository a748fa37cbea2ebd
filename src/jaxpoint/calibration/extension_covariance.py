"""How uncertain the cameras are that were found beside others which stay as they are.

The estimate x_n of the found cameras minimises the new observations with the others at their estimate x_s. To first
order dx_n = -S_nn^-1 S_ns dx_s + own error of covariance sigma^2 S_nn^-1, with S the normal equations of the new
recording, points eliminated; x_s errs as its own recording had it (Triggs et al. 2000, section 6.1).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.calibration.middle import about_its_middle, covariance_about, rig_about
from jaxpoint.calibration.normal import EXTRA, normal_equations
from jaxpoint.calibration.result import Calibration
from jaxpoint.camera.parameters import FOCAL, change_by_adjusted
from jaxpoint.camera.rig import CameraRig


def extended_covariance(
    found: Calibration, known: Calibration, stay: Bool[np.ndarray, " C"], moved: Bool[np.ndarray, " C"]
) -> Calibration:
    """The extended calibration with its covariance, or with the reason why there is none."""
    if known.camera_covariance is None or found.freedom is None:
        return replace(found, undetermined=f"The room that was extended has no covariance: {known.undetermined}")
    near, middle = about_its_middle(found)
    normal = normal_equations(near)
    size, columns = near.rig.camera_size, near.rig.camera_size + EXTRA
    count = len(near.rig)
    within = (np.arange(count)[:, None] * columns + np.arange(size)).ravel()
    matrix = normal.matrix[np.ix_(within, within)]
    free = found.freedom.free.ravel()
    weight = np.where(found.freedom.free, found.freedom.at_noise(found.sigma_px).prior_weight, 0.0).ravel()
    before = _known_covariance(near.rig, known, middle, stay, moved)
    chosen, rest = np.flatnonzero(free), np.flatnonzero(~free)
    try:
        inverse = np.linalg.inv(matrix[np.ix_(chosen, chosen)] + np.diag(weight[chosen]))
    except np.linalg.LinAlgError:
        return replace(found, undetermined="The observations do not determine the cameras that were to be found.")
    follow = np.zeros((count * size, len(rest)))
    follow[rest] = np.eye(len(rest))
    follow[chosen] = -inverse @ matrix[np.ix_(chosen, rest)]
    covariance = follow @ before[np.ix_(rest, rest)] @ follow.T
    covariance[np.ix_(chosen, chosen)] += normal.variance * inverse
    turn = _blocks(change_by_adjusted(near.rig))
    covariance = covariance_about(near.rig, turn @ covariance @ turn.T, -middle)
    return replace(found, camera_covariance=covariance, gauge=known.gauge, undetermined="")


def _known_covariance(
    rig: CameraRig, known: Calibration, middle: Float[np.ndarray, "3"], stay: Bool[np.ndarray, " C"], moved
) -> Float[np.ndarray, "D D"]:
    """Of the adjusted parameters of the rig: those of cameras that stay and lenses of moved ones, zero elsewhere."""
    assert known.camera_covariance is not None
    size, count = rig.camera_size, len(rig)
    old = covariance_about(known.rig, known.camera_covariance, middle)
    back = _blocks(np.linalg.inv(change_by_adjusted(rig_about(known.rig, middle))))
    old = back @ old @ back.T
    rows, places = [], []
    for camera, name in enumerate(rig.names):
        if stay[camera] or moved[camera]:
            first = 0 if stay[camera] else FOCAL
            start = known.rig.names.index(name) * size
            rows += range(start + first, start + size)
            places += range(camera * size + first, (camera + 1) * size)
    whole = np.zeros((count * size, count * size))
    whole[np.ix_(places, places)] = old[np.ix_(rows, rows)]
    return whole


def _blocks(blocks: Float[np.ndarray, "C p p"]) -> Float[np.ndarray, "D D"]:
    """One matrix of the blocks along its diagonal."""
    count, size = blocks.shape[:2]
    whole = np.zeros((count, size, count, size))
    each = np.arange(count)
    whole[each, :, each, :] = blocks
    return whole.reshape(count * size, count * size)
