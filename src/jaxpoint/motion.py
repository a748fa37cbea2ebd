"""How the light moves in each image, and where each camera would have seen it a fraction of a frame later."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxpoint.tracks import SERIES, Tracks

REACH = 4  # frames to either side from which the motion at a frame is taken,
SIDE = 3  # but from no more than these nearest ones
MAX_GAIN = 1.5  # a moved pixel noisier than this many times a plain one is not used
NEIGHBOURS = 3  # rows to either side of which two must predict a pixel
JUMP = 6.0  # typical errors of such predictions: a pixel farther from all of them is an outlier,
JUMP_PX = 6.0  # but not nearer than this, at an image width of 1280 px


@dataclass(frozen=True)
class Motion:
    """The light's velocity and acceleration in each image, by a local cubic (where few frames show it, a parabola).

    Both are weighted sums of the pixels of neighbouring frames; the weights say how noise passes on.
    """

    velocity: Float[np.ndarray, "F C 2"]  # px per frame; zero where not known
    acceleration: Float[np.ndarray, "F C 2"]  # px per frame^2
    velocity_weights: Float[np.ndarray, "F C W"]  # of the pixels REACH rows before to REACH rows after
    acceleration_weights: Float[np.ndarray, "F C W"]
    known: Bool[np.ndarray, "F C"]

    def gain(self, rows: Int[np.ndarray, "G C"], ahead: Float[np.ndarray, "G C"]) -> Float[np.ndarray, "G C"]:
        """Standard deviation of the pixels of these rows, moved so many frames, over that of plain ones.

        Infinite where the motion is not known, unless nothing moves.
        """
        every = np.arange(rows.shape[1])[None]
        by = ahead[..., None]
        weights = by * self.velocity_weights[rows, every] + 0.5 * by**2 * self.acceleration_weights[rows, every]
        weights[..., REACH] += 1.0
        return np.where(self.known[rows, every] | (ahead == 0), np.sqrt((weights**2).sum(axis=-1)), np.inf)


def row_delays(tracks: Tracks, readouts: Float[np.ndarray, " C"] | None) -> Float[np.ndarray, "F C"] | None:
    """Frames after the middle image row at which the row of each pixel was read; None without rolling shutters.

    Args:
        readouts: frames from the first image row to the last, negative from below.
    """
    return None if readouts is None else readouts * rows_down(tracks)


def rows_down(tracks: Tracks) -> Float[np.ndarray, "F C"]:
    """How far below the image's middle each pixel lies, as a share of the height: -0.5 to 0.5; 0 where not seen."""
    return np.where(tracks.visible, tracks.pixels[..., 1] / tracks.image_sizes[:, 1] - 0.5, 0.0)


def motion(
    pixels: Float[np.ndarray, "F C 2"],
    usable: Bool[np.ndarray, "F C"],
    frame_ids: Int[np.ndarray, " F"],
    delays: Float[np.ndarray, "F C"] | None = None,
) -> Motion:
    """The motion at every row of the tracks, from the nearest usable pixels before and after it.

    Known where a usable pixel lies within reach before and after. In a recording thinned to every n-th frame the
    reach is as many of those.

    Args:
        delays: frames by which each pixel was read late, as `row_delays` has it.
    """
    step = frame_step(frame_ids)
    around = np.arange(-REACH, REACH + 1)
    rows = np.arange(len(frame_ids))[:, None] + around
    inside = (rows >= 0) & (rows < len(frame_ids))
    rows = np.clip(rows, 0, len(frame_ids) - 1)
    ahead = (frame_ids[rows] - frame_ids[:, None]) / step  # (F, W), in steps
    near = inside & (np.abs(ahead) <= REACH)
    ahead = ahead[:, None]  # (F, 1, W), or (F, C, W)
    if delays is not None:
        ahead = ahead + (np.moveaxis(delays[rows], 1, 2) - delays[..., None]) / step
    used = near[:, None] & np.moveaxis(usable[rows], 1, 2)  # (F, C, W)
    used[..., :REACH] &= np.cumsum(used[..., REACH - 1 :: -1], axis=-1)[..., ::-1] <= SIDE
    used[..., REACH + 1 :] &= np.cumsum(used[..., REACH + 1 :], axis=-1) <= SIDE
    before, after = used[..., :REACH].sum(axis=-1), used[..., REACH + 1 :].sum(axis=-1)
    count = used.sum(axis=-1)
    known = (before >= 1) & (after >= 1) & (count >= 3)
    cubic = known & (before >= 2) & (after >= 2) & (count >= 5)
    first, second = _derivative_weights(ahead, used, known, cubic)
    # From the pixel itself, so that a light at rest has no motion at all.
    around_pixels = np.moveaxis(pixels[rows], 1, 2) - pixels[:, :, None]  # (F, C, W, 2)
    velocity, acceleration = ((part[..., None] * around_pixels).sum(axis=2) for part in (first, second))
    return Motion(velocity / step, acceleration / step**2, first / step, second / step**2, known)


def _derivative_weights(ahead, used, known, cubic) -> tuple[np.ndarray, np.ndarray]:
    """Weights (F, C, W) of the first and second derivative at 0 of the polynomial through the used neighbours."""
    powers = ahead[..., None] ** np.arange(4)  # (F, C, W, 4), C 1 where all cameras are alike
    powers = np.where(used[..., None], powers, 0.0)
    powers = np.where(np.stack([known, known, known, cubic], axis=-1)[:, :, None], powers, 0.0)
    normal = np.einsum("fcwi,fcwj->fcij", powers, powers)
    idle = np.diagonal(normal, axis1=2, axis2=3) == 0
    normal += idle[..., None] * np.eye(4)
    solved = np.linalg.solve(normal, np.moveaxis(powers, 2, 3))  # (F, C, 4, W)
    return solved[:, :, 1], 2.0 * solved[:, :, 2]


def without_jumps(
    pixels: Float[np.ndarray, "F C 2"],
    visible: Bool[np.ndarray, "F C"],
    frame_ids: Int[np.ndarray, " F"],
    widths: Float[np.ndarray, " C"],
) -> Bool[np.ndarray, "F C"]:
    """The visible pixels but for those that lie far from every straight line through two neighbours in time.

    A light does not jump, so that those are outliers, whose motion would spoil that of the frames around. Nothing is
    said against a pixel with fewer than two neighbours.
    """
    away = _distance_from_neighbours(pixels, visible, frame_ids)
    known = visible & np.isfinite(away)
    typical = np.array([np.median(away[own, c]) if own.any() else 0.0 for c, own in enumerate(known.T)])
    return visible & ~(known & (away > np.maximum(JUMP * typical, JUMP_PX * widths / 1280.0)))


def held_still(pixels: Float[np.ndarray, "F C 2"], visible: Bool[np.ndarray, "F C"]) -> Bool[np.ndarray, "F C"]:
    """Observations that stand, three in turn or more, at exactly one pixel: an image that froze, or a light at rest."""
    held = np.zeros_like(visible)
    for camera in range(visible.shape[1]):
        rows = np.flatnonzero(visible[:, camera])
        same = (np.diff(pixels[rows, camera], axis=0) == 0).all(axis=1)
        for run in np.flatnonzero(same[1:] & same[:-1]):
            held[rows[run : run + 3], camera] = True
    return held


def _distance_from_neighbours(pixels, visible, frame_ids) -> Float[np.ndarray, "F C"]:
    """Distance from the nearest prediction by two rows around each; infinite where there is none."""
    step, rows = frame_step(frame_ids), np.arange(len(frame_ids))
    nearest = np.full(visible.shape, np.inf)
    around = [k for k in range(-NEIGHBOURS, NEIGHBOURS + 1) if k]
    for first, second in itertools.combinations(around, 2):
        a, b = (np.clip(rows + k, 0, len(rows) - 1) for k in (first, second))
        ahead_a, ahead_b = ((frame_ids[k] - frame_ids) / step for k in (a, b))
        near = (a != b) & (np.abs(ahead_a) <= NEIGHBOURS + 1) & (np.abs(ahead_b) <= NEIGHBOURS + 1)
        near &= (a != rows) & (b != rows)
        part = (ahead_a / np.where(near, ahead_a - ahead_b, 1.0))[:, None, None]
        away = np.linalg.norm(pixels[a] + part * (pixels[b] - pixels[a]) - pixels, axis=-1)
        nearest = np.where(near[:, None] & visible[a] & visible[b], np.minimum(nearest, away), nearest)
    return nearest


def frame_step(frame_ids: Int[np.ndarray, " F"]) -> float:
    """Frames of the recording from one row of the tracks to the next of the same point, as a rule.

    Args:
        frame_ids: `Tracks.series_ids`.
    """
    steps = np.diff(frame_ids)
    steps = steps[steps < SERIES // 2]
    return float(np.median(steps)) if len(steps) else 1.0


@dataclass(frozen=True)
class OnClock:
    """Every camera's pixel nearest to each row's moment on the common clock, and what moves it there."""

    rows: Int[np.ndarray, "F C"]  # of the camera's own frames
    ahead: Float[np.ndarray, "F C"]  # frames from that pixel to the moment, at most half a step
    down: Float[np.ndarray, "F C"]  # of that pixel, as `rows_down` has it
    pixels: Float[np.ndarray, "F C 2"]  # moved to the moment
    velocity: Float[np.ndarray, "F C 2"]  # px per frame, then
    acceleration: Float[np.ndarray, "F C 2"]
    visible: Bool[np.ndarray, "F C"]  # False also where the motion is not known well enough

    def applied(self, tracks: Tracks) -> Tracks:
        """The tracks on the common clock."""
        return replace(tracks, pixels=self.pixels, visible=self.visible)

    def back(self, values: Bool[np.ndarray, "F C"]) -> Bool[np.ndarray, "F C"]:
        """What holds for a pixel on the common clock, written at the camera's own frame; False where none was used."""
        own = np.zeros_like(values)
        frame, camera = np.nonzero(self.visible & values)
        own[self.rows[frame, camera], camera] = True
        return own


def on_clock(
    tracks: Tracks,
    moving: Motion,
    offsets: Float[np.ndarray, " C"],
    rates: Float[np.ndarray, " C"] | None = None,
    readouts: Float[np.ndarray, " C"] | None = None,
) -> OnClock:
    """Each camera's pixels at the moments of the common clock.

    Args:
        moving: of the tracks, with the delays of these readouts.
        offsets: frames by which each camera shows a point late, at the first frame of the tracks and the middle row.
        rates: frames of each camera to one of the common clock; 1 each where they are not given.
        readouts: frames from the first image row to the last, negative from below; none where they are not given.
    """
    ids = tracks.series_ids.astype(float)
    elapsed = (tracks.frame_ids - tracks.frame_ids.min(initial=0)).astype(float)
    rates = np.ones(tracks.cameras) if rates is None else rates
    # An exact shift where the rate is 1, so that a whole number of frames is a matter of rows alone.
    wanted = ids[:, None] + offsets + (rates - 1.0) * elapsed[:, None]
    rows, ahead = _nearest_rows(tracks, wanted, row_delays(tracks, readouts))
    every = np.arange(tracks.cameras)[None]
    velocity, bend = moving.velocity[rows, every], moving.acceleration[rows, every]
    near = np.abs(ahead) <= 0.5 * frame_step(tracks.series_ids) * _apart(velocity, tracks, readouts) + 1e-9
    visible = tracks.visible[rows, every] & near & (moving.gain(rows, ahead) <= MAX_GAIN)
    by = ahead[..., None]
    pixels = tracks.pixels[rows, every] + by * velocity + 0.5 * by**2 * bend
    shown, rate = visible[..., None], rates[:, None]
    return OnClock(
        rows,
        ahead,
        rows_down(tracks)[rows, every],
        np.where(shown, pixels, 0.0),
        np.where(shown, rate * (velocity + by * bend), 0.0),
        np.where(shown, rate**2 * bend, 0.0),
        visible,
    )


def _nearest_rows(
    tracks: Tracks, wanted: Float[np.ndarray, "F C"], delays: Float[np.ndarray, "F C"] | None
) -> tuple[Int[np.ndarray, "F C"], Float[np.ndarray, "F C"]]:
    """The rows whose pixels were taken nearest to the wanted frames of each camera, and the frames from there."""
    ids = tracks.series_ids.astype(float)
    after = np.clip(np.searchsorted(ids, wanted), 1, len(ids) - 1)
    rows = np.where(wanted - ids[after - 1] <= ids[after] - wanted, after - 1, after)
    if delays is None:
        return rows, wanted - ids[rows]
    # A row's delay is that of its pixel, so that only a row with a pixel can be nearest.
    every = np.arange(tracks.cameras)[None]
    around = np.clip(rows + np.arange(-1, 2)[:, None, None], 0, len(ids) - 1)
    ahead = wanted - ids[around] - delays[around, every]
    nearest = np.where(tracks.visible[around, every], np.abs(ahead), np.inf).argmin(axis=0)[None]
    return tuple(np.take_along_axis(part, nearest, axis=0)[0] for part in (around, ahead))


def _apart(velocity: Float[np.ndarray, "F C 2"], tracks: Tracks, readouts) -> Float[np.ndarray, "F C"] | float:
    """Frames between two sightings: more than 1 where the light moves along with the rows that are read."""
    if readouts is None:
        return 1.0
    return 1.0 / np.clip(1.0 - readouts * velocity[..., 1] / tracks.image_sizes[:, 1], 0.5, 2.0)


def moved_to_clock(
    tracks: Tracks,
    offsets: Float[np.ndarray, " C"],
    rates: Float[np.ndarray, " C"] | None = None,
    usable: Bool[np.ndarray, "F C"] | None = None,
    readouts: Float[np.ndarray, " C"] | None = None,
) -> Tracks:
    """The tracks on the common clock, as `on_clock` has them.

    Args:
        usable: observations from which the motion is taken; all where it is not given.
    """
    usable = tracks.visible if usable is None else usable
    moving = motion(tracks.pixels, usable, tracks.series_ids, row_delays(tracks, readouts))
    return on_clock(tracks, moving, offsets, rates, readouts).applied(tracks)
