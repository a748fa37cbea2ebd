"""What to do next: concrete advice computed from the data. Every rule is a function of plain arrays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxpoint.calibration.camera_clock import CameraClock
from jaxpoint.calibration.clock_findings import (
    HELD,
    Timing,
    cause,
    contradicts,
    finding,
    flags,
    held_share,
    readout_flags,
)
from jaxpoint.calibration.pairs import MIN_FRAMES
from jaxpoint.motion import motion
from jaxpoint.report.gathered import edge_of_lens, gathered_place, gathered_time
from jaxpoint.report.summary import GRID, Lens, RigScene, Summary, cell_means, image_coverage
from jaxpoint.report.sync import time_offsets
from jaxpoint.tracks import Tracks

ENOUGH_SHARED = 30  # frames that a camera should share with at least two others
BORDER = 6.0  # px from the edge of an image within which a light may be cut off
ENOUGH_COVERAGE = 0.4  # fraction of the cells of an image that the light should visit
LEAST_OFFSET = 0.2  # frames; pairs of cameras in step come to 0.11 at most (simulated), 0.03 (real recordings)
SURE_READOUT = 6.0  # sigmas of a readout time; global shutters come to 3.3 (simulated), 1.5 (real), wide lenses to 4.8
LIKELY_READOUT = 3.0  # sigmas from which a camera is named where another is sure,
LEAST_READOUT = 0.1  # frames; and not below this
LEAST_RESIDUAL_OFFSET = 0.05  # frames, of residuals; cameras in step come to 0.01 at most, simulated or real
_EDGE = 0.03  # of a camera's observations beyond the radius from which its lens model fails: it is no mere border
_REACHED = 0.9  # of the radius where a lens model folds back; light that was seen there shaped it
_WHOLE = 0.8  # of a camera's observations that are rejected: it fits the others at no time
_SOLVE_OFFSETS = "Calibrate with `--time-offsets` (calibrate.time_offsets = true), which solves for the offsets"


@dataclass(frozen=True)
class Advice:
    """One finding and its remedy; `urgent` ones make the calibration doubtful."""

    finding: str
    remedy: str
    urgent: bool = False


def advise(summary: Summary) -> list[Advice]:
    """All that the data says about the recording and the cameras, urgent things first."""
    names, sizes = summary.names, summary.sizes
    found = [
        *on_recording(names, summary.pixels, summary.visible, sizes, summary.shared),
        *on_views(summary.visible),
        *on_outliers(names, sizes, summary.pixels, summary.judged, summary.rejected, summary.frame_ids),
        *on_borders(names, sizes, summary.pixels, summary.rejected),
        *on_timing(summary),
        *on_space(names, summary.scene),
        *on_lenses(names, summary.lens),
        *on_principal_points(names, sizes, summary.center),
        *on_pattern(summary),
    ]
    return sorted(found, key=lambda advice: not advice.urgent)


def advise_on_tracks(tracks: Tracks, clocks: Sequence[CameraClock] = ()) -> list[Advice]:
    """What tracks alone say, before anything is solved; urgent things first.

    Args:
        clocks: as `calibration.clocks.find_clocks` finds them.
    """
    shared = tracks.visible.T.astype(int) @ tracks.visible.astype(int)
    found = [
        *on_recording(tracks.names, tracks.pixels, tracks.visible, tracks.image_sizes, shared),
        *on_views(tracks.visible),
        *on_clocks(clocks, Timing.of(tracks), held_share(tracks)),
        *on_offsets(clocks),
        *on_readouts(clocks),
    ]
    return sorted(found, key=lambda advice: not advice.urgent)


def on_recording(
    names: Sequence[str],
    pixels: Float[np.ndarray, "F C 2"],
    visible: Bool[np.ndarray, "F C"],
    sizes: Int[np.ndarray, "C 2"],
    shared: Int[np.ndarray, "C C"],
) -> Iterator[Advice]:
    """Too little of an image visited; a camera that shares too few frames."""
    partners = shared.copy()
    np.fill_diagonal(partners, -1)  # nobody's own best partner
    ranked = -np.sort(-partners, axis=1)[:, : min(2, len(names) - 1)]
    told: set[int] = set()
    for camera in np.argsort(ranked.sum(axis=1), kind="stable").tolist():
        order = np.argsort(-partners[camera], kind="stable")[: ranked.shape[1]]
        weak = [int(k) for k in order if partners[camera, k] < ENOUGH_SHARED]
        if told.issuperset(weak):  # also where nothing is weak
            continue
        told.add(camera)
        pairs = " and ".join(f"{partners[camera, k]} with {names[k]}" for k in weak)
        yield Advice(
            f"Camera {names[camera]} shares too few frames with the others: only {pairs}.",
            f"Wave the light longer where {names[camera]} and {names[weak[0]]} both see it; "
            f"{ENOUGH_SHARED} frames with each of two cameras are the least.",
            urgent=bool(ranked[camera, 0] < MIN_FRAMES),
        )
    for camera, count in enumerate(image_coverage(pixels, visible, sizes)):
        covered = float(np.mean(count > 0))
        if not covered:
            yield Advice(
                f"Camera {names[camera]} never saw the light.",
                "Look at its pictures of `jaxpoint detect led`, wave the light in its view, or leave the camera out.",
                urgent=True,
            )
        elif covered < ENOUGH_COVERAGE:
            yield Advice(
                f"Camera {names[camera]} saw the light in {covered:.0%} of its image only, {_empty_side(count)}.",
                f"Its lens is guessed where the light never was: wave it there too, until {ENOUGH_COVERAGE:.0%} of "
                "the cells are visited.",
                urgent=covered < 0.15,
            )


def on_views(visible: Bool[np.ndarray, "F C"]) -> Iterator[Advice]:
    """Hardly any frame seen by three cameras, so that errors along an epipolar line stay hidden."""
    views = visible.sum(axis=1)
    usable = (views >= 2).sum()
    if visible.shape[1] > 2 and usable and (views >= 3).sum() < 0.3 * usable:
        yield Advice(
            f"Only {(views >= 3).sum() / usable:.0%} of the usable frames are seen by three or more cameras.",
            "With two views a wrong detection can hide along the line of sight of the other camera: wave the light "
            "where three views overlap.",
        )


def on_outliers(
    names: Sequence[str],
    sizes: Int[np.ndarray, "C 2"],
    pixels: Float[np.ndarray, "F C 2"],
    judged: Bool[np.ndarray, "F C"],
    rejected: Bool[np.ndarray, "F C"],
    frame_ids: Int[np.ndarray, " F"],
) -> Iterator[Advice]:
    """Outliers that gather in one camera, at one place of its image or at one time."""
    rate = rejected.sum(axis=0) / np.maximum(judged.sum(axis=0), 1)
    for camera, name in enumerate(names):
        count = int(rejected[:, camera].sum())
        if count < 8:
            continue
        others = float(np.median(np.delete(rate, camera))) if len(names) > 1 else 0.0
        place = gathered_place(pixels[rejected[:, camera], camera], sizes[camera])
        edge = edge_of_lens(pixels[:, camera], sizes[camera], judged[:, camera], rejected[:, camera])
        if edge is not None and place is None:
            limit, beyond, within = edge
            yield Advice(
                f"Camera {name} has {beyond:.0%} of its observations rejected that lie more than {limit:.0f} px from "
                f"the middle of its image, and {within:.0%} of the others.",
                "The lens bends more there than its model: ask for another "
                '(lens.distortion = "brown" or "fisheye"), or leave out what lies beyond.',
                urgent=bool(rate[camera] - within > _EDGE * (beyond - within)),
            )
            continue  # so neither a reflection nor a touched camera is the cause
        if rate[camera] > max(0.05, 3 * others):
            yield Advice(
                f"Camera {name} has {rate[camera]:.0%} of its observations rejected; the others {others:.0%}.",
                "Look at its worst frames below: a second light, a reflection, a camera that was moved or is out of "
                "step, or one whose recording belongs to another room or day.",
                urgent=bool(rate[camera] > 0.3),
            )
        if place is not None:
            share, (x, y) = place
            yield Advice(
                f"{share:.0%} of the outliers of camera {name} lie near pixel ({x:.0f}, {y:.0f}).",
                "Something there looks like the light: cover that lamp, window or reflection, or mask it "
                "(`detect led --masks`).",
            )
        when = gathered_time(judged[:, camera], rejected[:, camera])
        if when is not None:
            span = f"frames {frame_ids[when[0]]} to {frame_ids[when[1]]}"
            yield _of_a_time(name, span, everywhere=bool(rate[camera] > _WHOLE))


def _of_a_time(name: str, span: str, everywhere: bool) -> Advice:
    """Of a camera that the others contradict for a while; `everywhere`: at nearly all times."""
    remedy = "Was the camera touched, or its recording interrupted, then? Leave that part out and calibrate again."
    if everywhere:
        remedy = (
            "It fits the others nowhere: see whether its images are of the same room and times, and not mirrored or "
            "turned; or leave it out."
        )
    return Advice(f"Camera {name} is rejected almost throughout {span}.", remedy, urgent=True)


def on_borders(
    names: Sequence[str],
    sizes: Int[np.ndarray, "C 2"],
    pixels: Float[np.ndarray, "F C 2"],
    rejected: Bool[np.ndarray, "F C"],
) -> Iterator[Advice]:
    """Outliers at the edge of the image, where a part of the light is outside."""
    near = rejected & np.any((pixels < BORDER) | (pixels > sizes - 1 - BORDER), axis=2)
    share = near.sum(axis=0) / np.maximum(rejected.sum(axis=0), 1)
    cameras = np.flatnonzero((share > 0.2) & (near.sum(axis=0) >= 8)).tolist()
    if cameras:
        listed = ", ".join(f"{share[c]:.0%} of those of {names[c]}" for c in cameras)
        yield Advice(
            f"Many outliers lie within {BORDER:g} px of the edge of the image: {listed}.",
            "There the light is cut off and its middle misplaced: rejecting them is right, nothing needs to be done.",
        )


def on_timing(summary: Summary) -> Iterator[Advice]:
    """Residuals that follow the light's motion: a camera out of step."""
    moving = motion(summary.pixels, summary.visible, summary.frame_ids)
    judged = summary.judged & summary.point_valid[:, None]
    offset, sigma = time_offsets(summary.residuals, judged, moving, summary.slopes, summary.sigma_px)
    certain = np.abs(offset) > np.maximum(6 * sigma, LEAST_RESIDUAL_OFFSET)
    for camera in np.flatnonzero(certain):
        when = "after" if offset[camera] > 0 else "before"
        yield Advice(
            f"The residuals of camera {summary.names[camera]} follow the light's motion: it shows it at least "
            f"{abs(offset[camera]):.2f} frames {when} the others.",
            f"{_SOLVE_OFFSETS} up to 2 frames (`jaxpoint check` finds larger ones, and rates), or mend the "
            "synchronisation (trigger, dropped frames, clocks).",
            urgent=bool(abs(offset[camera]) > 0.1),
        )


def on_clocks(clocks: Sequence[CameraClock], timing: Timing, held: Float[np.ndarray, " C"]) -> Iterator[Advice]:
    """Cameras late by whole frames or of a rate of their own, with the flags that set it right; cameras that fit none.

    Args:
        held: of each camera, as `report.clocks.held_share` has it.
    """
    wrong = [clock for clock in clocks if clock.certain and contradicts(clock)]
    if wrong:
        yield Advice(
            " ".join(finding(clock, timing) for clock in wrong),
            f"Give `{flags(wrong, timing)}`, which brings the tracks to one clock.",
            urgent=True,
        )
    for clock, share in zip(clocks, held):
        if not clock.certain or share > HELD:
            yield Advice(*cause(float(share), clock), urgent=True)


def on_offsets(clocks: Sequence[CameraClock]) -> Iterator[Advice]:
    """Cameras out of step by so little that a calibration can solve for it."""
    late = [
        clock
        for clock in clocks
        if clock.certain and not contradicts(clock) and abs(clock.offset_frames) >= LEAST_OFFSET
    ]
    if late:
        said = [f"{c.name} shows the light about {abs(c.offset_frames):.1f} frames {_when(c)}" for c in late]
        yield Advice(
            f"The cameras are out of step: {', '.join(said)}.",
            f"{_SOLVE_OFFSETS}; better still, trigger the cameras together.",
            urgent=any(abs(clock.offset_frames) >= 0.5 for clock in late),
        )


def on_readouts(clocks: Sequence[CameraClock]) -> Iterator[Advice]:
    """Matches that miss each other along the light's motion the more the lower they lie: rolling shutters."""
    rolling = [
        (clock.name, clock.readout_frames, clock.readout_sigma)
        for clock in clocks
        if clock.readout_frames is not None and clock.readout_sigma is not None
    ]
    likely = [one for one in rolling if abs(one[1]) > max(LIKELY_READOUT * one[2], LEAST_READOUT)]
    if any(abs(by) > SURE_READOUT * sigma for _, by, sigma in likely):
        said = [
            f"{abs(by):.2f} ± {sigma:.2f} frames {'after' if by > 0 else 'before'} in {name}"
            for name, by, sigma in likely
        ]
        yield Advice(
            f"The last image row is read after the first (rolling shutters): {', '.join(said)}.",
            "Calibrate with `--readout-times` (calibrate.readout_times = true), which solves for them; where they are "
            f"known, give `{readout_flags([name for name, _, _ in likely], [by for _, by, _ in likely])}`.",
        )


def _when(clock: CameraClock) -> str:
    return "late" if clock.offset_frames > 0 else "early"


def on_space(names: Sequence[str], scene: RigScene) -> Iterator[Advice]:
    """A light that stayed on a plane, or a quarter of the covered volume that it hardly visited."""
    scene = scene if scene.in_room else scene.upright()
    if len(scene.points) < 20:
        return
    low, high = np.quantile(scene.points, [0.01, 0.99], axis=0)
    inner = scene.points[((scene.points >= low) & (scene.points <= high)).all(axis=1)]
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(inner.T)), 0.0))
    if spread[0] < 0.08 * spread[2]:
        yield Advice(
            f"The light moved almost on a plane: its spread across is {spread[0] / spread[2]:.0%} of that along.",
            "Wave it low and high, near and far, through the whole volume.",
            urgent=bool(spread[0] < 0.02 * spread[2]),
        )
    middle = (low + high)[:2] / 2
    right, back = (inner[:, :2] > middle).T
    for x, y in ((0, 0), (1, 0), (0, 1), (1, 1)):
        share = float(np.mean((right == x) & (back == y)))
        if share < 0.06:
            corner = np.where([x, y], high[:2], low[:2])
            nearest = int(np.linalg.norm(scene.centers[:, :2] - (corner + middle) / 2, axis=1).argmin())
            yield Advice(
                f"Coverage of the room is lopsided: the quarter nearest camera {names[nearest]} holds {share:.0%} of "
                "the light's positions.",
                "Walk with the light through that quarter of the floor plan too.",
            )


def on_lenses(names: Sequence[str], lens: Lens) -> Iterator[Advice]:
    """A lens polynomial that folds back within the image: where the light never was, or because the lens is wider."""
    for camera in np.flatnonzero(lens.turning <= lens.corner).tolist():
        reached = lens.farthest[camera] >= _REACHED * lens.turning[camera]
        yield Advice(
            f"The lens model of camera {names[camera]} stops growing {lens.turning[camera]:.0f} px from its middle, "
            "before the image corner.",
            "Pixels beyond cannot be undistorted, though the light was there: the lens is too wide for this model; "
            'try a fisheye (lens.distortion = "fisheye"), or do not use the edge of that image.'
            if reached
            else "Pixels beyond cannot be undistorted: wave the light into the corners of that image, or ask for fewer "
            'distortion terms (lens.distortion = "radial1").',
        )


def on_principal_points(
    names: Sequence[str], sizes: Int[np.ndarray, "C 2"], center: Float[np.ndarray, "C 2"]
) -> Iterator[Advice]:
    """A principal point far from the middle of the image."""
    off = (center - (sizes - 1) / 2) / sizes[:, :1]
    for camera in np.flatnonzero(np.abs(off).max(axis=1) > 0.12).tolist():
        yield Advice(
            f"The principal point of camera {names[camera]} lies {np.linalg.norm(off[camera]):.0%} of the image width "
            "from its middle.",
            "Was the image cropped, are its pixels not square, or is its size given wrongly? If none of these, cover "
            "more of that image with the light.",
        )


def on_pattern(summary: Summary) -> Iterator[Advice]:
    """Residuals that point the same way in parts of an image: something the camera model does not describe."""
    found = []
    for camera, name in enumerate(summary.names):
        kept = summary.kept[:, camera]
        residual = summary.residuals[kept, camera]
        mean, count = cell_means(summary.pixels[kept, camera], residual, summary.sizes[camera])
        full = count >= 8
        if full.sum() < 8:
            continue
        energy = float((residual**2).sum(axis=-1).mean())
        pattern = float((mean[full] ** 2).sum(axis=-1).mean())
        noise = energy * float((1.0 / count[full]).mean())
        if pattern - noise > max(2 * noise, 0.25 * energy):
            found.append(f"{np.sqrt(pattern - noise):.2f} px in {name}")
    if found:
        yield Advice(
            f"The residuals point the same way over whole parts of the image: {', '.join(found)}.",
            'A lens needs more terms (lens.distortion = "brown"), or a camera or its focus moved during the recording.',
        )


def _empty_side(count: np.ndarray) -> str:
    """Which side of the image is emptiest, in words."""
    filled = count > 0
    sides = {
        "nothing in the left part": filled[:, : GRID[0] // 2],
        "nothing in the right part": filled[:, GRID[0] // 2 :],
        "nothing in the upper part": filled[: GRID[1] // 2],
        "nothing in the lower part": filled[GRID[1] // 2 :],
    }
    text, part = min(sides.items(), key=lambda item: item[1].mean())
    if part.mean() > 0.6 * filled.mean():
        return "with gaps on all sides"
    return text if not part.any() else text.replace("nothing", "little")
