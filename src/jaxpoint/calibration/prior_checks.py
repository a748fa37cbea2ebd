"""Priors that were given up, and priors that the final solution still contradicts."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.calibration.aspects import aspect_text
from jaxpoint.calibration.known_lenses import given_lenses
from jaxpoint.calibration.normal import NormalEquations
from jaxpoint.calibration.prior_choice import REFUTED, doubts_of, with_free_aspects
from jaxpoint.calibration.recording import Freedom
from jaxpoint.calibration.result import Calibration, Finding
from jaxpoint.camera.parameters import ASPECT, CENTER
from jaxpoint.camera.rig import CameraRig

ASPECT_OPEN = 0.05  # sigma of a log aspect from which square pixels are taken on trust


def prior_findings(calibration: Calibration, normal: NormalEquations | None) -> Iterator[Finding]:
    """Principal points outside their image or far from their prior, and aspects that nothing tells."""
    names = calibration.rig.names
    center, sizes = np.asarray(calibration.rig.cameras.center), np.asarray(calibration.rig.image_sizes)
    outside = np.asarray(((center < -0.5) | (center > sizes - 0.5)).any(axis=1))
    if outside.any():
        chosen = tuple(name for name, yes in zip(names, outside) if yes)
        yield Finding(
            "principal point",
            "bad",
            f"The principal points of {', '.join(chosen)} lie outside the image: the solution is wrong, the images "
            "were cropped by more than half, or their pixels are not square.",
            "State the pixel aspect (--lens.aspect 16/15 for PAL video), use uncropped images, or give known lenses "
            "(--intrinsics FILE --lens.known hold)",
            chosen,
        )
        return
    doubts = None if normal is None else doubts_of(calibration, normal)
    if doubts is not None and (doubts.any_center and doubts.centers.max() > REFUTED):
        off = center - (sizes - 1) / 2.0
        worst = int(doubts.centers.argmax())
        yield Finding(
            "principal point",
            "bad",
            f"The principal point of {names[worst]} is drawn {np.linalg.norm(off[worst]):.0f} px from the middle of "
            f"its image, {doubts.centers[worst]:.1f} sigmas beyond its prior, and no other assumption explains it: "
            "cropped images, pixels that are not square, or a wrong solution.",
            "State the pixel aspect (--lens.aspect), use uncropped images, give known lenses (--intrinsics FILE "
            "--lens.known hold), or wave the light longer",
            (names[worst],),
        )
    if normal is not None:
        yield from _open_aspect(calibration, normal)


def given_up(before: Freedom, after: Freedom, rig: CameraRig, another_lens: bool = False) -> Iterator[Finding]:
    """What priors that were given up say of the cameras.

    Args:
        another_lens: the data chose another lens model than the one that is tried first.
    """
    count, sizes = len(rig), np.asarray(rig.image_sizes)
    looser = np.asarray((after.prior_weight[:count, CENTER] < before.prior_weight[:count, CENTER]).any(axis=1))
    looser |= (after.prior_mean[:count, CENTER] != before.prior_mean[:count, CENTER]).any(axis=1)
    looser &= ~given_lenses(before)[:count]
    if looser.any():
        chosen = _named(rig, looser)
        off = np.linalg.norm(np.asarray(rig.cameras.center) - (sizes - 1) / 2.0, axis=1)[looser]
        yield Finding(
            "cropped image",
            "care",
            f"The principal point lies {_pixels(off)} from the middle of the image in {', '.join(chosen)}, which "
            "refutes the prior that it lies near it; the prior was given up there.",
            "Were these images cropped, or shifted by a stabiliser? The solution allows for it; uncropped images or "
            "known lenses (--intrinsics) are more accurate",
            chosen,
        )
    aspects = np.asarray(rig.cameras.focal)[:, 1] / np.asarray(rig.cameras.focal)[:, 0]
    moved = np.abs(np.log(aspects) + before.prior_mean[:count, ASPECT]) > 1e-6
    if not before.free[:count, ASPECT].any() and moved.any():
        shown = " and ".join(sorted({aspect_text(float(value)) for value in aspects[moved]}))
        solved = "; it was solved for" if after.free[:count, ASPECT].any() else ""
        # A rig far from the truth pulls at all priors; with two of them gone nothing is left that would show it.
        also = [what for what, yes in (("principal points off", looser.any()), ("another lens", another_lens)) if yes]
        doubtful = bool(also)
        beside = f"; with {' and '.join(also)} too, either may stand for another fault" if doubtful else ""
        yield Finding(
            "pixel aspect",
            "bad" if doubtful else "care",
            f"The pixels of {', '.join(_named(rig, moved))} are {shown} times as wide as high{solved}; square ones are "
            f"refuted by the recording{beside}.",
            "State the aspect to be sure (--lens.aspect 16/15 for PAL video), or scale the images to square pixels",
            _named(rig, moved),
        )


def _named(rig: CameraRig, chosen: Bool[np.ndarray, " C"]) -> tuple[str, ...]:
    return tuple(name for name, yes in zip(rig.names, chosen) if yes)


def _pixels(values: Float[np.ndarray, " N"]) -> str:
    low, high = values.min(), values.max()
    return f"{high:.0f} px" if len(values) == 1 else f"{low:.0f} to {high:.0f} px"


def _open_aspect(calibration: Calibration, normal: NormalEquations) -> Iterator[Finding]:
    """That square pixels are taken on trust, where the recording would not show another aspect."""
    freedom = calibration.freedom
    if freedom is None or freedom.free[:, ASPECT].any() or not freedom.free[:, CENTER].any():
        return
    if calibration.tracks.pixel_aspects is not None or (freedom.prior_mean[:, ASPECT] != 0).any():
        return
    try:
        everyone = np.ones(len(freedom.free), bool)
        loose = with_free_aspects(freedom.at_noise(calibration.sigma_px), everyone, calibration.sigma_px)
        sigma = float(normal.solve(loose).sigmas[:, ASPECT].max())
    except np.linalg.LinAlgError:
        return
    if sigma <= ASPECT_OPEN:
        return
    yield Finding(
        "pixel aspect",
        "good",
        f"Square pixels are taken on trust: the recording tells the pixel aspect to ± {sigma:.0%} only.",
        "Nearly all cameras have them; anamorphic video (PAL, NTSC, 1440 x 1080) needs --lens.aspect",
    )
