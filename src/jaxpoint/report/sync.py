"""Are the cameras in step? Two looks at it, one before anything is solved and one after."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

MAX_LAG = 12  # frames tried to either side
_MIN_SAMPLES = 60


def image_velocity(
    pixels: Float[np.ndarray, "F C 2"], visible: Bool[np.ndarray, "F C"], frame_ids: Int[np.ndarray, " F"]
) -> tuple[Float[np.ndarray, "F C 2"], Bool[np.ndarray, "F C"]]:
    """Central differences of the light's pixel, px per frame, and where they exist (zero elsewhere)."""
    velocity = np.zeros_like(pixels)
    known = np.zeros_like(visible)
    steps = np.diff(frame_ids)
    if len(frame_ids) < 3:
        return velocity, known
    # Recordings thinned to every n-th frame have a step of n; a longer step is a gap.
    step = np.median(steps)
    regular = (steps[1:] == step) & (steps[:-1] == step)
    known[1:-1] = visible[2:] & visible[:-2] & visible[1:-1] & regular[:, None]
    velocity[1:-1] = (pixels[2:] - pixels[:-2]) / (2.0 * step)
    return np.where(known[..., None], velocity, 0.0), known


def speed_lags(
    pixels: Float[np.ndarray, "F C 2"], visible: Bool[np.ndarray, "F C"], frame_ids: Int[np.ndarray, " F"]
) -> tuple[Int[np.ndarray, "C C"], Float[np.ndarray, "C C"]]:
    """By how many frames one camera lags another, from how fast the light moves in their images.

    The hand stops and starts in all images at the same time, whatever the geometry, so the logarithms of the image
    speeds are most alike at the right lag.

    Returns:
        lag: `lag[a, b]` > 0 when camera b shows in frame f + lag what camera a shows in frame f. In rows of the tracks.
        likeness: the correlation at that lag; NaN where fewer than 60 frames can be compared.
    """
    velocity, known = image_velocity(pixels, visible, frame_ids)
    speed = np.log(np.linalg.norm(velocity, axis=-1) + 0.5)
    cameras = visible.shape[1]
    lag = np.zeros((cameras, cameras), dtype=int)
    likeness = np.full((cameras, cameras), np.nan)
    for a in range(cameras):
        for b in range(a + 1, cameras):
            tried = [_correlation(speed, known, a, b, k) for k in range(-MAX_LAG, MAX_LAG + 1)]
            if np.isnan(tried).all():
                continue
            best = int(np.nanargmax(tried))
            lag[a, b], lag[b, a] = best - MAX_LAG, MAX_LAG - best
            likeness[a, b] = likeness[b, a] = tried[best]
    return lag, likeness


def time_offsets(
    residuals: Float[np.ndarray, "F C 2"],
    kept: Bool[np.ndarray, "F C"],
    pixels: Float[np.ndarray, "F C 2"],
    visible: Bool[np.ndarray, "F C"],
    frame_ids: Int[np.ndarray, " F"],
) -> tuple[Float[np.ndarray, " C"], Float[np.ndarray, " C"]]:
    """By how much each camera lags the others, from residuals that follow the light's motion in the image.

    A camera that shows the light dt after the others sees it v dt behind, so projected minus observed is v dt. The
    adjustment shares the effect among the cameras: read the figures relative to each other.

    Returns:
        offset: frames; positive where the camera shows the light's motion after the others.
        sigma: its standard error; infinite where the light never moved.
    """
    velocity, known = image_velocity(pixels, visible, frame_ids)
    use = (known & kept)[..., None]
    v, r = np.where(use, velocity, 0.0), np.where(use, residuals, 0.0)
    square = (v**2).sum(axis=(0, 2))
    safe = np.where(square > 0, square, 1.0)
    offset = (v * r).sum(axis=(0, 2)) / safe
    rest = ((r - v * offset[:, None]) ** 2 * use).sum(axis=(0, 2)) / np.maximum(2 * use.sum(axis=(0, 2)) - 1, 1)
    return offset, np.where(square > 0, np.sqrt(rest / safe), np.inf)


def _correlation(speed, known, a, b, lag) -> float:
    """Correlation of the speeds of a in frame f and of b in frame f + lag."""
    frames = len(speed)
    first = slice(max(0, -lag), frames - max(0, lag))
    second = slice(max(0, lag), frames - max(0, -lag))
    both = known[first, a] & known[second, b]
    if both.sum() < _MIN_SAMPLES:
        return float("nan")
    x, y = speed[first, a][both], speed[second, b][both]
    if x.std() == 0 or y.std() == 0:
        return float("nan")
    return float(np.corrcoef(x, y)[0, 1])
