"""Tracks: where each camera saw which point, frame by frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxpoint.errors import InsufficientDataError
from jaxpoint.targets import Target

NO_TARGET = NO_ROW = -1
SERIES = 2**40  # from one point's frames to the next one's in `series_ids`: more than any recording has


class PointPrior(eqx.Module):
    """Where the points of some rows are known to lie, in the frame of the room."""

    points: Float[np.ndarray, "F 3"]  # m
    sigmas: Float[np.ndarray, " F"]  # m, standard deviation of each coordinate; infinite where nothing is known


class Tracks(eqx.Module):
    """Pixels of points in C cameras: each of the F rows is one physical point at one time.

    A waved light is one point in F frames. The points of a target (a board's corners, a wand's ends) share frames and
    are told apart by `point_ids`; static points of a room are rows of one frame. A hidden point has `visible` False
    and pixel (0, 0); NaN never means "missing". Build one with `Tracks.from_pixels`, which accepts NaN and checks
    everything; put several together with `join_tracks`.
    """

    pixels: Float[np.ndarray, "F C 2"]  # px, (0, 0) is the centre of the top-left pixel
    visible: Bool[np.ndarray, "F C"]
    image_sizes: Int[np.ndarray, "C 2"]  # px, width and height
    frame_ids: Int[np.ndarray, " F"]  # number of the frame in the recording
    times: Float[np.ndarray, " F"] | None = None  # s
    names: tuple[str, ...] = eqx.field(static=True, default=())
    pixel_aspects: Float[np.ndarray, " C"] | None = None  # width over height of a pixel, as the videos state it
    point_ids: Int[np.ndarray, " F"] | None = None  # which point; of a target its index there. None: all are one light
    target_ids: Int[np.ndarray, " F"] | None = None  # index into `targets`, -1 for points of none
    targets: tuple[Target, ...] = eqx.field(static=True, default=())
    prior: PointPrior | None = None
    point_names: tuple[str, ...] = eqx.field(static=True, default=())  # of the points of no target, by their ids

    @staticmethod
    def from_pixels(
        pixels: Float[np.ndarray, "F C 2"],
        image_sizes: Int[np.ndarray, "C 2"],
        visible: Bool[np.ndarray, "F C"] | None = None,
        frame_ids: Int[np.ndarray, " F"] | None = None,
        times: Float[np.ndarray, " F"] | None = None,
        names: Sequence[str] = (),
        pixel_aspects: Float[np.ndarray, " C"] | None = None,
        point_ids: Int[np.ndarray, " F"] | None = None,
        target: Target | None = None,
        prior: PointPrior | None = None,
        point_names: Sequence[str] = (),
    ) -> Tracks:
        """Checked tracks from an array of pixels, NaN (or `visible` False) where a point was not seen.

        Args:
            point_ids: where there are several points; rows are then sorted by point and frame.
            target: the rigid target whose points these are; `point_ids` are indices of its points.
            prior: where rows are known to lie; these enter the adjustment and hold its frame.
            point_names: of the points by their ids, as an estimator of poses calls them.

        Raises:
            ValueError: shapes do not fit, an infinite pixel, a name used twice, a point twice in one frame, or a
                point id that the target does not have.
        """
        pixels = np.array(pixels, dtype=np.float64)
        if pixels.ndim != 3 or pixels.shape[2] != 2:
            raise ValueError(f"Pixels must have shape (frames, cameras, 2), not {pixels.shape}.")
        frames, cameras, _ = pixels.shape
        seen = _seen(pixels, visible)
        sizes, names = _checked_cameras(cameras, image_sizes, names)
        ids = np.arange(frames) if frame_ids is None else np.asarray(frame_ids).astype(np.int64)
        if ids.shape != (frames,):
            raise ValueError(f"`frame_ids` has shape {ids.shape}, but there are {frames} frames.")
        if times is not None:
            times = np.asarray(times, dtype=np.float64)
            if times.shape != (frames,):
                raise ValueError(f"`times` has shape {times.shape}, but there are {frames} frames.")
        if pixel_aspects is not None:
            pixel_aspects = _checked_aspects(cameras, pixel_aspects)
        plain = Tracks(np.where(seen[..., None], pixels, 0.0), seen, sizes, ids, times, names, pixel_aspects)
        if point_ids is None and target is None and prior is None:
            return plain
        return replace(_with_points(plain, point_ids, target, prior), point_names=tuple(point_names))

    def point_name(self, point: int) -> str:
        """What a point of no target is called: its name, or its number where it has none."""
        return self.point_names[point] if 0 <= point < len(self.point_names) else str(point)

    @property
    def cameras(self) -> int:
        """Number of cameras, C."""
        return self.pixels.shape[1]

    @property
    def frames(self) -> int:
        """Number of frames, F."""
        return self.pixels.shape[0]

    @property
    def extent(self) -> str:
        """How much there is, in words: frames of a light, or points in frames."""
        if self.point_ids is None:
            return f"{self.frames:,} frames"
        return f"{self.frames:,} points in {len(np.unique(self.frame_ids)):,} frames"

    def without_targets(self) -> Tracks:
        """The same rows, each a point by itself: what is known of shapes is left out."""
        if self.target_ids is None:
            return self
        return replace(self, target_ids=np.full(self.frames, NO_TARGET), targets=())

    @property
    def series_ids(self) -> Int[np.ndarray, " F"]:
        """Frame numbers of which neighbours are neighbours in time of one point; `frame_ids` where there is one."""
        if self.point_ids is None:
            return self.frame_ids
        changed = np.diff(self.point_ids) != 0
        if self.target_ids is not None:
            changed |= np.diff(self.target_ids) != 0
        rank = np.concatenate([[0], np.cumsum(changed)])
        return SERIES * rank + self.frame_ids - self.frame_ids.min(initial=0)

    def rows_of_target(self, number: int, wanted: Bool[np.ndarray, " F"]) -> Int[np.ndarray, "M K"]:
        """The wanted rows of one of the targets, by frame and point of the target; -1 where there is none."""
        if self.target_ids is None or self.point_ids is None:
            raise ValueError("These tracks have no targets.")
        own = np.flatnonzero((self.target_ids == number) & wanted)
        frames, place = np.unique(self.frame_ids[own], return_inverse=True)
        rows = np.full((len(frames), len(self.targets[number].points)), NO_ROW)
        rows[place.ravel(), self.point_ids[own]] = own
        return rows

    def rows_by_name(self) -> dict[str, int]:
        """The row of each frame of the light: the first point that is of no target."""
        rows = np.arange(self.frames)
        if self.point_ids is not None and self.target_ids is not None:
            loose = self.target_ids == NO_TARGET
            rows = rows[loose & (self.point_ids == self.point_ids[loose].min(initial=0))]
        return {str(self.frame_ids[row]): int(row) for row in rows}

    def of_one_point(self) -> Tracks:
        """The tracks of the point that was seen most often, through time."""
        if self.point_ids is None or self.target_ids is None:
            return self
        different, index = np.unique(np.stack([self.target_ids, self.point_ids]), axis=1, return_inverse=True)
        seen = np.bincount(index.ravel(), self.visible.sum(axis=1), minlength=different.shape[1])
        return self.select_frames(index.ravel() == seen.argmax())

    def select_frames(self, frames: np.ndarray) -> Tracks:
        """The tracks of some rows only (a bool mask or indices into F)."""
        chosen = {name: _chosen(getattr(self, name), frames) for name in ROWS}
        prior = self.prior
        if prior is not None:
            prior = PointPrior(prior.points[frames], prior.sigmas[frames])
        return replace(self, **chosen, prior=prior)

    def select_cameras(self, cameras: Sequence[int]) -> Tracks:
        """The tracks of some cameras only, in the order given.

        Raises:
            InsufficientDataError: no camera is left.
        """
        index = list(cameras)
        if not index:
            raise InsufficientDataError("No camera is left; keep at least two.")
        return replace(
            self,
            pixels=self.pixels[:, index],
            visible=self.visible[:, index],
            image_sizes=self.image_sizes[index],
            names=tuple(self.names[i] for i in index),
            pixel_aspects=_chosen(self.pixel_aspects, index),
        )


def _seen(pixels: Float[np.ndarray, "F C 2"], visible: np.ndarray | None) -> Bool[np.ndarray, "F C"]:
    """Which pixels are there: those that are no NaN, or those said to be visible."""
    if np.isinf(pixels).any():
        frame, camera, _ = np.argwhere(np.isinf(pixels))[0]
        raise ValueError(
            f"The pixel of camera {camera} in frame {frame} is infinite; write NaN where the light was not seen."
        )
    given = np.asarray(np.isfinite(pixels).all(axis=2))
    if visible is None:
        return given
    visible = np.asarray(visible, dtype=bool)
    if visible.shape != given.shape:
        raise ValueError(f"`visible` has shape {visible.shape}, but the pixels need {given.shape}.")
    if (visible & ~given).any():
        frame, camera = np.argwhere(visible & ~given)[0]
        raise ValueError(
            f"Camera {camera} in frame {frame} is marked visible but its pixel is NaN; mark it hidden or give its "
            "pixel."
        )
    return visible


def _checked_cameras(
    cameras: int, image_sizes: np.ndarray, names: Sequence[str]
) -> tuple[Int[np.ndarray, "C 2"], tuple[str, ...]]:
    sizes = np.asarray(image_sizes).astype(np.int64)
    if sizes.shape != (cameras, 2) or (sizes <= 0).any():
        raise ValueError(f"Image sizes must be {cameras} rows of positive width and height, not {sizes.tolist()}.")
    names = tuple(names) or tuple(f"cam_{i}" for i in range(cameras))
    if len(names) != cameras or len(set(names)) != cameras:
        raise ValueError(f"{cameras} cameras need {cameras} different names, not {list(names)}.")
    return sizes, names


def _checked_aspects(cameras: int, pixel_aspects: np.ndarray) -> Float[np.ndarray, " C"]:
    aspects = np.asarray(pixel_aspects, dtype=np.float64)
    if aspects.shape != (cameras,) or not (np.isfinite(aspects) & (aspects > 0)).all():
        raise ValueError(f"{cameras} cameras need as many positive pixel aspects, not {aspects.tolist()}.")
    return aspects


ROWS = ("pixels", "visible", "frame_ids", "times", "point_ids", "target_ids")  # fields with a leading axis F


def _chosen(values: np.ndarray | None, index) -> np.ndarray | None:
    return None if values is None else values[index]


def _with_points(
    plain: Tracks, point_ids: np.ndarray | None, target: Target | None, prior: PointPrior | None
) -> Tracks:
    """Tracks of several points, sorted by point and frame, once it is checked that each row is another one."""
    points = np.zeros(plain.frames, np.int64) if point_ids is None else np.asarray(point_ids).astype(np.int64)
    if points.shape != (plain.frames,):
        raise ValueError(f"`point_ids` has shape {points.shape}, but there are {plain.frames} rows.")
    if target is not None and ((points < 0) | (points >= len(target.points))).any():
        wrong = points[(points < 0) | (points >= len(target.points))][0]
        raise ValueError(
            f"Target '{target.name}' has points 0 to {len(target.points) - 1}, but a row has point {wrong}."
        )
    if prior is not None:
        _check_prior(prior, plain.frames)
    rows = np.stack([points, plain.frame_ids], axis=1)
    different, count = np.unique(rows, axis=0, return_counts=True)
    if (count > 1).any():
        point, frame = different[count > 1][0]
        raise ValueError(f"Point {point} has two rows in frame {frame}; keep one of them.")
    targets = () if target is None else (target,)
    ids = np.full(plain.frames, NO_TARGET if target is None else 0)
    whole = replace(plain, point_ids=points, target_ids=ids, targets=targets, prior=prior)
    return whole.select_frames(np.lexsort((plain.frame_ids, points)))


def _check_prior(prior: PointPrior, rows: int) -> None:
    if prior.points.shape != (rows, 3) or prior.sigmas.shape != (rows,):
        raise ValueError(
            f"The prior has shapes {prior.points.shape} and {prior.sigmas.shape}, but {rows} rows need {(rows, 3)} and "
            f"{(rows,)}."
        )
    known = np.isfinite(prior.sigmas)
    if not (prior.sigmas > 0).all() or not np.isfinite(prior.points[known]).all():
        raise ValueError("A prior needs positive sigmas (infinite where nothing is known), and finite points.")


def join_tracks(*parts: Tracks) -> Tracks:
    """Several tracks of the same cameras as one: a light and a board, say, or two wands.

    Points without a target are told apart by their ids: where two parts use the same ones, the later part's are raised.

    Raises:
        ValueError: the cameras differ.
    """
    first = parts[0]
    for part in parts[1:]:
        if part.names != first.names or (part.image_sizes != first.image_sizes).any():
            raise ValueError(
                f"Tracks of the same cameras can be joined, not of {list(first.names)} and {list(part.names)}."
            )
    targets = tuple(target for part in parts for target in part.targets)
    if len({target.name for target in targets}) < len(targets):
        raise ValueError(f"Targets need different names, not {[target.name for target in targets]}.")
    joined = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in ("pixels", "visible", "frame_ids")
    }
    points, owners = _joined_ids(parts)
    known_times = [part.times for part in parts if part.times is not None]
    times = np.concatenate(known_times) if len(known_times) == len(parts) else None
    prior = None
    if any(part.prior is not None for part in parts):
        known = [part.prior or _no_prior(part.frames) for part in parts]
        prior = PointPrior(*(np.concatenate([getattr(one, name) for one in known]) for name in ("points", "sigmas")))
    names = _joined_names(parts)
    whole = replace(
        first,
        **joined,
        times=times,
        point_ids=points,
        target_ids=owners,
        targets=targets,
        prior=prior,
        point_names=names,
    )
    return whole.select_frames(np.lexsort((whole.frame_ids, points, owners)))


def _no_prior(rows: int) -> PointPrior:
    return PointPrior(np.zeros((rows, 3)), np.full(rows, np.inf))


def _joined_ids(parts: Sequence[Tracks]) -> tuple[np.ndarray, np.ndarray]:
    """Point and target of each row; points of no target get ids that no earlier part has."""
    points, owners, before = [], [], 0
    for part, free in zip(parts, _first_ids(parts)):
        own = np.zeros(part.frames, np.int64) if part.point_ids is None else part.point_ids.copy()
        owner = np.full(part.frames, NO_TARGET) if part.target_ids is None else part.target_ids.copy()
        loose = owner == NO_TARGET
        own[loose] += free
        owner[~loose] += before
        before += len(part.targets)
        points.append(own)
        owners.append(owner)
    return np.concatenate(points), np.concatenate(owners)


def _first_ids(parts: Sequence[Tracks]) -> list[int]:
    """What is added to the ids of each part's loose points, so that no earlier part has them."""
    first = [0]
    for part in parts[:-1]:
        own = np.zeros(part.frames, np.int64) if part.point_ids is None else part.point_ids
        loose = own if part.target_ids is None else own[part.target_ids == NO_TARGET]
        first.append(first[-1] + max(int(loose.max(initial=-1)) + 1, len(part.point_names)))
    return first


def _joined_names(parts: Sequence[Tracks]) -> tuple[str, ...]:
    """Names of the loose points under their ids in the whole; none where no part has any."""
    names: list[str] = []
    for part, first in zip(parts, _first_ids(parts)):
        if part.point_names:
            names += [*(str(number) for number in range(len(names), first)), *part.point_names]
    return tuple(names)
