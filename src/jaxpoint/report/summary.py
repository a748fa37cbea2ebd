"""The numbers behind the report: a calibration as plain numpy arrays, and what is counted and averaged from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxpoint.calibration.result import Verdict

GRID = (8, 6)  # cells of an image, across and down
BEST = 0.92  # the fraction of observations beside all of them at which mean errors are compared


@dataclass(frozen=True)
class RigScene:
    """Cameras and the light's path in one frame of reference."""

    centers: Float[np.ndarray, "C 3"]
    world_from_cam: Float[np.ndarray, "C 3 3"]
    points: Float[np.ndarray, "P 3"]
    unit: str
    in_room: bool = False  # whether z is up and 0 on the floor

    @property
    def size(self) -> float:
        """Median distance of a camera from the others, in the scene's unit."""
        apart = np.linalg.norm(self.centers[:, None] - self.centers[None], axis=-1)
        return float(np.median(apart[~np.eye(len(apart), dtype=bool)]))

    def reach(self, outside: float) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
        """Lowest and highest coordinates of the cameras and of the path without its `outside` extremes at each end."""
        low, high = self.centers.min(axis=0), self.centers.max(axis=0)
        if not len(self.points):
            return low, high
        ends = np.quantile(self.points, [outside, 1 - outside], axis=0)
        return np.minimum(low, ends[0]), np.maximum(high, ends[1])

    def moved(self, scale: float, rotation: np.ndarray, translation: np.ndarray, unit: str) -> RigScene:
        """The scene after x -> scale * rotation @ x + translation."""
        return RigScene(
            scale * self.centers @ rotation.T + translation,
            rotation @ self.world_from_cam,
            scale * self.points @ rotation.T + translation,
            unit,
        )

    def levelling(self) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]:
        """Rotation and translation after which z is up as most cameras see it and x is the longest level way."""
        up = -self.world_from_cam[:, :, 1].sum(axis=0)
        up /= np.linalg.norm(up)
        level = np.eye(3) - np.outer(up, up)
        everything = np.concatenate([self.centers, self.points])
        spread = level @ np.cov(everything.T) @ level
        x = np.linalg.eigh(spread)[1][:, -1]
        rotation = np.stack([x, np.cross(up, x), up])
        return rotation, -rotation @ np.median(everything, axis=0)

    def upright(self) -> RigScene:
        """The scene turned so."""
        return self.moved(1.0, *self.levelling(), self.unit)


@dataclass(frozen=True)
class Lens:
    """How each lens bends: displacement outwards against the undistorted radius, both px from the principal point."""

    radius: Float[np.ndarray, "C N"]
    displacement: Float[np.ndarray, "C N"]
    turning: Float[np.ndarray, " C"]  # undistorted radius where the polynomial stops growing; inf if not in reach
    corner: Float[np.ndarray, " C"]  # undistorted radius of the farthest image corner
    farthest: Float[np.ndarray, " C"]  # undistorted radius of the farthest observation kept


@dataclass(frozen=True)
class Summary:
    """A calibration in plain arrays; C cameras, F frames. Pixels unless said otherwise."""

    names: tuple[str, ...]
    sizes: Int[np.ndarray, "C 2"]
    frame_ids: Int[np.ndarray, " F"]
    times: Float[np.ndarray, " F"] | None  # s
    pixels: Float[np.ndarray, "F C 2"]
    visible: Bool[np.ndarray, "F C"]
    residuals: Float[np.ndarray, "F C 2"]  # projected minus observed
    slopes: Float[np.ndarray, "F C 2 3"]  # px per unit: how pixels follow the light's point, bending left out
    verdicts: Int[np.ndarray, "F C"]
    point_valid: Bool[np.ndarray, " F"]
    sigma_px: float
    shared: Int[np.ndarray, "C C"]
    focal: Float[np.ndarray, "C 2"]
    center: Float[np.ndarray, "C 2"]
    distortion: tuple[Float[np.ndarray, "_"], ...]  # the coefficients of each lens
    lens_models: tuple[str, ...]  # names
    view_deg: Float[np.ndarray, " C"]  # between what the middles of the left and right edges see
    scene: RigScene
    lens: Lens

    @property
    def kept(self) -> Bool[np.ndarray, "F C"]:
        """Observations that the calibration believes."""
        return self.verdicts == Verdict.KEPT

    @property
    def comparable(self) -> Bool[np.ndarray, "F C"]:
        """Observations of frames that two cameras or more saw."""
        return self.visible & (self.verdicts != Verdict.FEW_VIEWS)

    @property
    def judged(self) -> Bool[np.ndarray, "F C"]:
        """Observations that have a residual, also where the views contradict each other and no point is believed."""
        return self.comparable & (self.point_valid[:, None] | (self.errors > 0))

    @property
    def rejected(self) -> Bool[np.ndarray, "F C"]:
        """Observations that have a residual and are not believed."""
        return self.judged & ~self.kept

    @property
    def errors(self) -> Float[np.ndarray, "F C"]:
        """Length of every residual."""
        return np.linalg.norm(self.residuals, axis=-1)

    @property
    def kept_fraction(self) -> float:
        """Kept observations as a fraction of those that can be compared with another camera's."""
        return float(self.kept.sum() / max(self.comparable.sum(), 1))

    @property
    def mean_px(self) -> float:
        """Mean error of the observations kept; NaN where none is."""
        return mean(self.errors[self.kept])

    @property
    def mean_all_px(self) -> float:
        """Mean error of every observation that has a residual."""
        return mean(self.errors[self.judged])


def mean(values: np.ndarray) -> float:
    """Mean, NaN of nothing (without numpy's warning)."""
    return float(values.mean()) if values.size else float("nan")


def px(value: float, digits: int = 3) -> str:
    """A length in pixels as text."""
    return f"{value:.{digits}f} px" if np.isfinite(value) else "unknown"


def kept_curve(errors: Float[np.ndarray, " N"]) -> tuple[np.ndarray, np.ndarray]:
    """Mean error of the best observations against the fraction of them that is kept.

    Returns:
        fraction: 1/N .. 1.
        mean: mean of the smallest so many errors, px.
    """
    ordered = np.sort(errors)
    count = np.arange(1, len(ordered) + 1)
    return count / max(len(ordered), 1), np.cumsum(ordered) / count


def mean_of_best(errors: Float[np.ndarray, " N"], fraction: float) -> float:
    """Mean of the smallest `fraction` of the errors, px; NaN of nothing."""
    count = int(np.ceil(fraction * len(errors)))
    return mean(np.sort(errors)[:count])


def image_cells(pixels: Float[np.ndarray, "N 2"], size: Int[np.ndarray, " 2"]) -> Int[np.ndarray, "N 2"]:
    """Column and row of the 8 x 6 grid cell of each pixel."""
    cells = np.floor((pixels + 0.5) / size * np.array(GRID)).astype(int)
    return np.clip(cells, 0, np.array(GRID) - 1)


def image_coverage(
    pixels: Float[np.ndarray, "F C 2"], visible: Bool[np.ndarray, "F C"], sizes: Int[np.ndarray, "C 2"]
) -> Int[np.ndarray, "C 6 8"]:
    """How often the light visited each cell of each camera's image."""
    counts = np.zeros((len(sizes), GRID[1], GRID[0]), dtype=int)
    for camera, size in enumerate(sizes):
        column, row = image_cells(pixels[visible[:, camera], camera], size).T
        np.add.at(counts[camera], (row, column), 1)
    return counts


def cell_means(
    pixels: Float[np.ndarray, "N 2"], residuals: Float[np.ndarray, "N 2"], size: Int[np.ndarray, " 2"]
) -> tuple[Float[np.ndarray, "6 8 2"], Int[np.ndarray, "6 8"]]:
    """Mean residual in each cell of an image (px, zero where empty), and the number of residuals there."""
    column, row = image_cells(pixels, size).T
    total = np.zeros((GRID[1], GRID[0], 2))
    count = np.zeros((GRID[1], GRID[0]), dtype=int)
    np.add.at(total, (row, column), residuals)
    np.add.at(count, (row, column), 1)
    return total / np.maximum(count, 1)[..., None], count


def worst_outliers(summary: Summary, count: int = 12) -> list[tuple[int, int]]:
    """Camera and row (place in F) of the rejected observations with the largest residuals, worst first."""
    rows, cameras = np.nonzero(summary.rejected)
    order = np.argsort(-summary.errors[rows, cameras], kind="stable")[:count]
    return [(int(cameras[i]), int(rows[i])) for i in order]
