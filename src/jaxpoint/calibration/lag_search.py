"""At which lags two cameras' images of one light can belong together: a linear epipolar fit at every lag at once.

The fit of eight points minimises a quadratic form in F. Its 9 x 9 matrix holds sums over frames of products of a
monomial of the first camera's pixel and one of the second's, so that the matrices of all lags are 36 correlations,
which the fast Fourier transform gives in milliseconds. The smallest eigenvalue of each is the misfit of the best F at
that lag. It is not robust: what it finds are candidates, to be tried by a robust fit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

LENS = -0.1  # division-model parameter assumed per half diagonal, between no distortion and a strong one
LONGEST_GAP = 500  # steps: where nobody saw the light for longer, the gap is shortened to this
LEAST_OVERLAP = 0.25  # of the frames of the camera that saw the light less,
LEAST_FRAMES = 60  # and no fewer than these, must be compared at a lag
_PAIRS = [(i, j) for i in range(3) for j in range(i, 3)]
_MONOMIAL = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])  # of two coordinates, its place in `_PAIRS`


@dataclass(frozen=True)
class Courses:
    """Where each of C cameras saw the light, on a dense grid of N steps of the recording."""

    points: Float[np.ndarray, "N C 2"]  # over half the image diagonal, from the image centre
    visible: Bool[np.ndarray, "N C"]  # no outliers among them, as far as their neighbours in time can tell
    step: float  # frames from one place of the grid to the next
    whole: bool  # False where a long gap was shortened, so that rates cannot be compared over the recording


def dense_courses(
    points: Float[np.ndarray, "F C 2"], visible: Bool[np.ndarray, "F C"], frame_ids: Int[np.ndarray, " F"], step: float
) -> Courses:
    """The points of the rows of tracks, each at its own place in time."""
    gaps = np.round(np.diff(frame_ids) / step).astype(int)
    places = np.concatenate([[0], np.cumsum(np.clip(gaps, 0, LONGEST_GAP))])
    dense = np.zeros((places[-1] + 1, *points.shape[1:]))
    seen = np.zeros(dense.shape[:2], bool)
    dense[places], seen[places] = points, visible
    return Courses(dense, seen, step, bool((gaps <= LONGEST_GAP).all()))


def monomials(points: Float[np.ndarray, "N 2"], visible: Bool[np.ndarray, " N"]) -> Float[np.ndarray, "6 N"]:
    """All products of two homogeneous coordinates of each point, conditioned; zero where it is not visible."""
    third = 1.0 + LENS * (points**2).sum(axis=1, keepdims=True)
    plane = points / np.maximum(third, 0.1)
    seen = plane[visible]
    if len(seen) < 2 or seen.std() == 0:
        return np.zeros((6, len(points)))
    plane = (plane - seen.mean(axis=0)) / np.sqrt(seen.var(axis=0).mean())
    rays = np.concatenate([plane, np.ones((len(points), 1))], axis=1)
    return np.stack([np.where(visible, rays[:, i] * rays[:, j], 0.0) for i, j in _PAIRS])


@dataclass(frozen=True)
class Misfits:
    """How badly the best epipolar geometry fits at each of L lags."""

    lags: Int[np.ndarray, " L"]  # steps by which the second camera shows the light later
    misfit: Float[np.ndarray, " L"]  # mean squared algebraic error
    count: Float[np.ndarray, " L"]  # frames compared

    def scores(self) -> Float[np.ndarray, " L"]:
        """Log-likelihood of each lag, about, over what is usual where as many frames are compared."""
        logs = np.log(np.maximum(self.misfit, 1e-9))
        order = np.argsort(self.count, kind="stable")
        usual = np.empty(len(logs))
        for part in np.array_split(order, max(1, min(8, len(order) // 30))):
            usual[part] = np.median(logs[part]) if len(part) else 0.0
        return self.count * (usual - logs)


def misfits(first: Float[np.ndarray, "6 N"], second: Float[np.ndarray, "6 M"]) -> Misfits:
    """The misfit at every lag at which enough frames are compared."""
    size = _even_length(first.shape[1] + second.shape[1])
    spectra = np.conj(np.fft.rfft(first, size, axis=1))[:, None] * np.fft.rfft(second, size, axis=1)[None]
    sums = np.fft.irfft(spectra, size, axis=2)
    lags = np.arange(size)
    lags = np.where(lags > second.shape[1] - 1, lags - size, lags)
    least = max(LEAST_FRAMES, LEAST_OVERLAP * min(first[5].sum(), second[5].sum()))
    enough = np.flatnonzero(sums[5, 5] >= least - 0.5)
    enough = enough[np.argsort(lags[enough])]
    count = sums[5, 5, enough]
    return Misfits(lags[enough], _smallest_eigenvalues(sums[..., enough] / count), count)


def _smallest_eigenvalues(sums: Float[np.ndarray, "6 6 L"]) -> Float[np.ndarray, " L"]:
    """About the smallest eigenvalue of each lag's matrix: one over the sum of all inverse ones."""
    p, q, r, s = np.meshgrid(*[range(3)] * 4, indexing="ij")
    matrix = np.moveaxis(sums[_MONOMIAL[p, r], _MONOMIAL[q, s]].reshape(9, 9, -1), 2, 0)
    inverse = np.linalg.inv(matrix + 1e-8 * np.eye(9))
    return 1.0 / np.trace(inverse, axis1=1, axis2=2)


def _even_length(least: int) -> int:
    """A length of at least this that transforms fast: 2 to some power, or three quarters of one."""
    size = 64
    while size < least:
        size *= 2
    return size * 3 // 4 if size * 3 // 4 >= least else size


def peaks(scores: Float[np.ndarray, " L"], lags: Int[np.ndarray, " L"], apart: int, most: int) -> Iterator[int]:
    """Indices of the best lags, best first, no two within `apart`; none at an end of what could be compared."""
    left = np.where(scores > 0, scores, -np.inf)
    for _ in range(most):
        if not len(left) or not np.isfinite(left.max()):
            return
        best = int(left.argmax())
        near = np.abs(lags - lags[best]) <= apart
        if 0 < best < len(lags) - 1:
            yield best
        left[near] = -np.inf


FASTEST = 2.2  # times the rate of another camera, or one over it, is the farthest rate that is tried
OFF_PX = 25.0  # at a width of 1280 px: how far off the light may be in time for a lag still to be found


@dataclass(frozen=True)
class Candidate:
    """A clock of a second camera, against the common clock, at which the linear fit is best."""

    offset: float  # frames late at the first frame of the tracks
    rate: float
    score: float
    middle: float  # frames after the first of the tracks, about which it was found,
    reach: float  # and to how many on either side


def tolerance(
    courses: Courses, first: int, second: int, widths: Float[np.ndarray, " C"], half: Float[np.ndarray, " C"]
):
    """Steps in time by which two cameras may be off for the fit still to be seen: as far as the light moves 25 px."""
    both = courses.visible[1:] & courses.visible[:-1]
    speed = np.linalg.norm(np.diff(courses.points, axis=0), axis=-1) * half * 1280.0 / widths
    seen = [np.median(speed[both[:, c], c]) for c in (first, second) if both[:, c].any()]
    return float(np.clip(OFF_PX / max([*seen, 1e-3]), 0.5, 6.0))


def at_one_rate(courses: Courses, first: int, late: float, rate: float, second: int, most: int) -> list[Candidate]:
    """The best lags of a second camera that runs as fast as the common clock.

    Args:
        first: a camera of which frame `rate * t + late` shows the moment t of the common clock (steps).
    """
    places = np.arange(len(courses.points))
    one = _sampled(courses, first, rate * places + late)
    found = misfits(one, _sampled(courses, second, places.astype(float)))
    scores = found.scores()
    span = float(len(places)) * courses.step
    return [
        Candidate(float(found.lags[i]) * courses.step, 1.0, float(scores[i]), span / 2, np.inf)
        for i in peaks(scores, found.lags, 5, most)
    ]


def at_any_rate(
    courses: Courses, first: int, late: float, rate: float, second: int, steps: float, most: int
) -> list[Candidate]:
    """The best lags and rates of a second camera, from a stretch of the first one.

    Args:
        steps: in time, by which lags may be off.
    """
    every = max(1, round(steps))
    window = _richest(courses.visible[:, first], round(300 * steps))
    places = np.arange(window.start, window.stop, every)
    one = _sampled(courses, first, rate * places + late)
    spacing = 2.0 * steps / len(range(window.start, window.stop))
    count = int(np.ceil(np.log(FASTEST) / spacing))
    rates = np.exp(np.linspace(-np.log(FASTEST), np.log(FASTEST), 2 * count + 1))
    found = []
    for tried in rates:
        found += _at_rate(courses, one, second, tried, places, every, most)
    finer = []
    for best in _distinct(found, window, 4.0 * steps * courses.step, most):
        finer.append(_finer(courses, (first, late, rate), second, best, spacing, window, steps))
    return sorted(finer, key=lambda one: -one.score)


def _finer(courses, first, second, best: Candidate, spacing: float, window: slice, steps: float) -> Candidate:
    """The same candidate on a grid of every step in time and rates between those tried."""
    camera, late, rate = first
    places = np.arange(window.start, window.stop)
    one = _sampled(courses, camera, rate * places + late)
    tried = best.rate * np.exp(spacing * np.linspace(-0.75, 0.75, 7))
    about = best.offset + (best.rate - 1.0) * best.middle
    near = [
        found
        for value in tried
        for found in _at_rate(courses, one, second, value, places, 1, 3)
        if abs(found.offset + (found.rate - 1.0) * found.middle - about) <= 3.0 * steps * courses.step
    ]
    return max([best, *near], key=lambda one: one.score)


def _at_rate(courses, one, second, rate: float, places, every: int, most: int) -> list[Candidate]:
    whole = np.arange(0, len(courses.points) / min(rate, 1.0), every)
    found = misfits(one, _sampled(courses, second, rate * whole))
    scores = found.scores()
    middle, reach = (places[0] + places[-1]) / 2.0 * courses.step, (places[-1] - places[0]) / 2.0 * courses.step
    start = places[0]  # the first sample of `one`, where the second's samples begin at 0
    return [
        Candidate(
            float(rate * (found.lags[i] * every - start)) * courses.step, float(rate), float(scores[i]), middle, reach
        )
        for i in peaks(scores, found.lags, max(1, 5 // every), most)
    ]


def _distinct(found: list[Candidate], window: slice, apart: float, most: int) -> list[Candidate]:
    """The best of the candidates, one of those that are alike in the middle of the stretch."""
    best: list[Candidate] = []
    for one in sorted(found, key=lambda one: -one.score):
        late = one.offset + (one.rate - 1.0) * one.middle
        if all(abs(late - other.offset - (other.rate - 1.0) * other.middle) > apart for other in best):
            best.append(one)
        if len(best) == most:
            break
    return best


def _richest(visible: Bool[np.ndarray, " N"], length: int) -> slice:
    """The stretch of at most this length in which a camera saw the light most."""
    if len(visible) <= length:
        return slice(0, len(visible))
    seen = np.concatenate([[0], np.cumsum(visible)])
    start = int(np.argmax(seen[length:] - seen[:-length]))
    return slice(start, start + length)


def _sampled(courses: Courses, camera: int, places: Float[np.ndarray, " M"]) -> Float[np.ndarray, "6 M"]:
    """Monomials of one camera's course at these places in time, the nearest frame of each."""
    nearest = np.round(places).astype(int)
    inside = (nearest >= 0) & (nearest < len(courses.points))
    nearest = np.clip(nearest, 0, len(courses.points) - 1)
    return monomials(courses.points[nearest, camera], courses.visible[nearest, camera] & inside)
