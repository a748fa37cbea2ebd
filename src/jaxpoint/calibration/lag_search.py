"""At which lags two cameras' images of one light can belong together: a linear epipolar fit at every lag at once.

The fit of eight points minimises a quadratic form in F. Its 9 x 9 matrix holds sums over frames of products of a
monomial of the first camera's pixel and one of the second's, so that the matrices of all lags are 36 correlations,
which the fast Fourier transform gives in milliseconds. The smallest eigenvalue of each is the misfit of the best F at
that lag. It is not robust: what it finds are candidates, to be tried by a robust fit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

LENS = -0.1  # division-model parameter assumed per half diagonal, between no distortion and a strong one
LONGEST_GAP = 500  # steps: where nobody saw the light for longer, the gap is shortened to this
LEAST_OVERLAP = 0.25  # of the frames of the camera that saw the light less,
LEAST_STRETCH = 0.6  # and where a stretch of one is compared with all of another: of that stretch,
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


def misfits(
    first: Float[np.ndarray, "6 N"], second: Float[np.ndarray, "6 M"], overlap: float = LEAST_OVERLAP
) -> Misfits:
    """The misfit at every lag at which enough frames are compared."""
    size = _even_length(first.shape[1] + second.shape[1])
    spectra = np.conj(np.fft.rfft(first, size, axis=1))[:, None] * np.fft.rfft(second, size, axis=1)[None]
    sums = np.fft.irfft(spectra, size, axis=2)
    lags = np.arange(size)
    lags = np.where(lags > second.shape[1] - 1, lags - size, lags)
    least = max(LEAST_FRAMES, overlap * min(first[5].sum(), second[5].sum()))
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


FASTEST = 1.3  # times the rate of another camera, or one over it, is the farthest rate that is tried,
DOUBLE = 0.06  # but for rates of twice and of half of it, to within this (log)
STRETCH = 300  # times the tolerance in time: of how many frames rates are tried
NEAR = 0.012  # log rate: as far from 1 rates are tried over the whole recording
OFF_PX = 25.0  # at a width of 1280 px: how far off the light may be in time for a lag still to be found


@dataclass(frozen=True)
class Candidate:
    """A clock of a second camera, against the common clock, at which the linear fit is best."""

    offset: float  # frames late at the first frame of the tracks
    rate: float
    score: float
    middle: float = 0.0  # frames after the first of the tracks, about which it was found,
    reach: float = np.inf  # and to how many on either side
    margin: float = np.inf  # times the score of the next best

    def late(self) -> float:
        """Frames late in the middle of what was compared."""
        return self.offset + (self.rate - 1.0) * self.middle


def tolerance(
    courses: Courses, first: int, second: int, widths: Float[np.ndarray, " C"], half: Float[np.ndarray, " C"]
):
    """Steps in time by which two cameras may be off for the fit still to be seen: as far as the light moves 25 px."""
    both = courses.visible[1:] & courses.visible[:-1]
    speed = np.linalg.norm(np.diff(courses.points, axis=0), axis=-1) * half * 1280.0 / widths
    seen = [np.median(speed[both[:, c], c]) for c in (first, second) if both[:, c].any()]
    return float(np.clip(OFF_PX / max([*seen, 1e-3]), 0.5, 6.0))


@dataclass(frozen=True)
class Known:
    """A camera whose clock is known: frame `rate * t + late` of it shows the moment t of the common clock (steps)."""

    camera: int
    late: float
    rate: float


def at_one_rate(courses: Courses, first: Known, second: int, most: int) -> list[Candidate]:
    """The best lags of a second camera that runs as fast as the common clock, best first."""
    places = np.arange(len(courses.points))
    one, middle = _on_clock(courses, first, places), float(places[-1]) * courses.step / 2.0
    found = misfits(one, _sample(courses, second, places.astype(float)))
    scores = found.scores()
    best = [
        Candidate(float(found.lags[i]) * courses.step, 1.0, float(scores[i]), middle)
        for i in peaks(scores, found.lags, 5, most)
    ]
    return _with_margins(best)


def at_near_rates(courses: Courses, first: Known, second: int, steps: float, most: int) -> list[Candidate]:
    """The best lags and rates, rates near that of the common clock, over the whole recording.

    Args:
        steps: in time, by which lags may be off.
    """
    spacing = 2.0 * steps / len(courses.points)
    count = max(2, int(np.ceil(NEAR / spacing)))
    rates = np.exp(spacing * np.arange(-count, count + 1))
    places = np.arange(0, len(courses.points), max(1, round(steps)))
    found = _at_rates(courses, first, second, rates, places, LEAST_OVERLAP)
    return _with_margins([replace(one, reach=np.inf) for one in _distinct(found, 4.0 * steps * courses.step, most)])


def at_any_rate(courses: Courses, first: Known, second: int, steps: float, window: slice, most: int) -> list[Candidate]:
    """The best lags and rates, from a stretch of the first camera.

    Args:
        steps: in time, by which lags may be off.
        window: the stretch of the common clock, one of `stretches`.
    """
    places = np.arange(window.start, window.stop, max(1, round(steps)))
    spacing = 2.0 * steps / (window.stop - window.start)
    bands = ((-np.log(FASTEST), np.log(FASTEST)), *((at - DOUBLE, at + DOUBLE) for at in (-np.log(2.0), np.log(2.0))))
    rates = np.exp(np.concatenate([np.arange(low, high, spacing) for low, high in bands]))
    found = _distinct(_at_rates(courses, first, second, rates, places, LEAST_STRETCH), 4.0 * steps * courses.step, most)
    finer = [_finer(courses, first, second, best, spacing, window, steps) for best in found[:1]]
    return _with_margins([*finer, *found[1:]])


def _finer(courses, first: Known, second: int, best: Candidate, spacing: float, window: slice, steps: float):
    """The same candidate on a grid of every step in time and rates between those tried."""
    rates = best.rate * np.exp(spacing * np.linspace(-0.75, 0.75, 7))
    found = _at_rates(courses, first, second, rates, np.arange(window.start, window.stop), LEAST_STRETCH)
    near = [one for one in found if abs(one.late() - best.late()) <= 3.0 * steps * courses.step]
    finer = max(near, key=lambda one: one.score, default=best)
    return replace(finer, score=best.score)  # comparable with the others


def _at_rates(courses, first: Known, second: int, rates, places, overlap: float) -> list[Candidate]:
    """The best lags of every rate."""
    one, every = _on_clock(courses, first, places), int(places[1] - places[0])
    middle, reach = (places[0] + places[-1]) / 2.0 * courses.step, (places[-1] - places[0]) / 2.0 * courses.step
    best = []
    for rate in rates:
        whole = np.arange(0, len(courses.points) / min(rate, 1.0), every)
        found = misfits(one, _sample(courses, second, rate * whole), overlap)
        scores = found.scores() * min(1.0, rate)  # a slower camera's frames stand for several samples each
        for i in peaks(scores, found.lags, max(1, 5 // every), 3):
            # The first sample of `one` is `places[0]`, where that of the second is 0.
            offset = float(rate * (found.lags[i] * every - places[0])) * courses.step
            best.append(Candidate(offset, float(rate), float(scores[i]), float(middle), float(reach)))
    return best


def _distinct(found: list[Candidate], apart: float, most: int) -> list[Candidate]:
    """The best of the candidates, one of those that are alike in the middle of the stretch."""
    best: list[Candidate] = []
    for one in sorted(found, key=lambda one: -one.score):
        if all(abs(one.late() - other.late()) > apart for other in best):
            best.append(one)
        if len(best) == most:
            break
    return best


def _with_margins(best: list[Candidate]) -> list[Candidate]:
    following = [*(one.score for one in best[1:]), 0.0]
    return [replace(one, margin=one.score / max(score, 1e-9)) for one, score in zip(best, following)]


def _on_clock(courses: Courses, known: Known, places) -> Float[np.ndarray, "6 M"]:
    return _sample(courses, known.camera, known.rate * places + known.late)


def stretches(visible: Bool[np.ndarray, " N"], steps: float) -> list[slice]:
    """In either half of a recording the stretch in which a camera saw the light most; all of a short one.

    In a stretch of few times `steps` few rates can be told apart, so that few need be tried.
    """
    length, half = round(STRETCH * max(steps, 1.0)), len(visible) // 2
    if len(visible) <= 1.5 * length:
        return [slice(0, len(visible))]
    return [_richest(visible, slice(0, half), length), _richest(visible, slice(half, len(visible)), length)]


def _richest(visible: Bool[np.ndarray, " N"], within: slice, length: int) -> slice:
    """The part of at most this length in which a camera saw the light most."""
    if within.stop - within.start <= length:
        return within
    seen = np.concatenate([[0], np.cumsum(visible[within])])
    start = within.start + int(np.argmax(seen[length:] - seen[:-length]))
    return slice(start, start + length)


def _sample(courses: Courses, camera: int, places: Float[np.ndarray, " M"]) -> Float[np.ndarray, "6 M"]:
    """Monomials of one camera's course at these places in time: on the line between two frames, else the nearest."""
    before = np.floor(places).astype(int)
    last = len(courses.points) - 1
    near, far = (np.clip(k, 0, last) for k in (np.round(places).astype(int), before + (np.round(places) == before)))
    points, visible = courses.points[:, camera], courses.visible[:, camera]
    part = np.where(visible[far], np.abs(places - np.round(places)), 0.0)[:, None]
    return monomials(
        (1.0 - part) * points[near] + part * points[far], visible[near] & (places >= -0.5) & (places <= last + 0.5)
    )
