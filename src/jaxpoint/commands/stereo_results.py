"""What `jaxpoint stereo` writes beside a calibration: the rectification, and the depth of one pair of images."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from jaxpoint.calibration.result import Calibration
from jaxpoint.camera.rectification import Rectification, rectified_pixels, rectify
from jaxpoint.camera.rig import CameraRig
from jaxpoint.commands.options import Outcome, at
from jaxpoint.config.stereo_matching import StereoSettings
from jaxpoint.detection.disparity import disparities_of
from jaxpoint.detection.rectified_pair import RectifiedPair, maps_of, rectify_pair
from jaxpoint.errors import InsufficientDataError
from jaxpoint.extras import extra
from jaxpoint.io.board_sources import BoardSources
from jaxpoint.io.depth_files import write_depth, write_disparity, write_image, write_maps
from jaxpoint.io.ply import write_ply
from jaxpoint.report.depth_page import write_depth_page
from jaxpoint.report.stereo_pictures import stereo_sheets
from jaxpoint.runs import new_run, provenance, write_json

NEARER = 1.2  # disparity over that of the nearest board


@dataclass(frozen=True)
class StereoResults:
    """Two calibrated cameras, their images, and one pair of these."""

    rig: CameraRig
    sources: BoardSources
    dense: StereoSettings
    frame: int | None
    unit: str = "m"

    @cached_property
    def rectification(self) -> Rectification:
        """Of the two cameras."""
        return rectify(self.rig[0], self.rig[1], self.sources.frames[0].size)

    def write(
        self, folder: Path, figures: dict[str, Any], calibration: Calibration | None = None
    ) -> tuple[tuple[str, ...], dict[str, Any]]:
        """Write everything into the folder, add figures, and return lines and what a page shows."""
        rectification, maps = self.rectification, maps_of(self.rig, self.rectification)
        corners = rectified_corners(self.rig, rectification, calibration)
        dense = _reaching(self.dense, corners)
        frame, originals = self._pair()
        pair = rectify_pair(*originals, maps, rectification, dense)
        write_json(folder / "rectification.json", rectification_json(rectification, self.rig, self.unit))
        names = ("left_x", "left_y", "right_x", "right_y")
        write_maps(folder / "maps.npz", dict(zip(names, (*maps[0], *maps[1]))))
        write_image(folder / "rectified_left.png", pair.left)
        write_image(folder / "rectified_right.png", pair.right)
        write_disparity(folder / "disparity.png", pair.disparity)
        if self.unit == "m":
            write_depth(folder / "depth_mm.png", pair.depth)
        points, colors = self._cloud(pair)
        write_ply(folder / "points.ply", points, colors)
        rows = None if corners is None else corners[0][:, 1] - corners[1][:, 1]
        found = {
            "baseline": rectification.baseline,
            "baseline_unit": self.unit,
            "focal_px": float(rectification.intrinsics[0, 0]),
            "rows_rms_px": None if rows is None else float(np.sqrt((rows**2).mean())),
            "rows_max_px": None if rows is None else float(np.abs(rows).max()),
            "frame": frame,
            "disparities": disparities_of(pair.left.shape[1], dense),
            "filled": pair.filled,
            "points": len(points),
            "median_depth": float(np.nanmedian(pair.depth)) if np.isfinite(pair.depth).any() else None,
        }
        figures["stereo"] = found
        with_unit = f"{1e3 * rectification.baseline:.1f} mm" if self.unit == "m" else f"{rectification.baseline:.4g}"
        aligned = (
            "" if rows is None else f", rows agree to {found['rows_rms_px']:.3f} px (rms over {len(rows)} corners)"
        )
        lines = (
            f"baseline {with_unit}{aligned}",
            f"frame {frame}: {pair.filled:.0%} of the image has a disparity, {len(points):,} points",
        )
        return lines, {"rectified": self._shown(found, pair, originals, with_unit)}

    def _pair(self) -> tuple[int, tuple[np.ndarray, np.ndarray]]:
        """The frame that was asked for, or the middle one that both cameras have, and its images."""
        index, ids = self.sources.pairing.index, self.sources.pairing.frame_ids
        both = self.sources.shared
        if self.frame is not None:
            both = both[ids[both] == self.frame]
        if not len(both):
            raise InsufficientDataError("No frame was taken by both cameras; give images of the same moments.")
        row = int(both[len(both) // 2])
        images = [source.read(int(index[row, camera])) for camera, source in enumerate(self.sources.frames)]
        return int(ids[row]), (images[0], images[1])

    def _cloud(self, pair: RectifiedPair) -> tuple[np.ndarray, np.ndarray]:
        known = np.isfinite(pair.points).all(axis=2) & pair.covered
        if self.unit == "m":
            known &= pair.depth <= self.dense.max_depth_m
        return pair.points[known], pair.left[known][:, ::-1]

    def _shown(self, found: dict[str, Any], pair: RectifiedPair, originals, baseline: str) -> dict[str, Any]:
        rows = found["rows_rms_px"]
        tiles = [
            (baseline, "baseline"),
            ("not known" if rows is None else f"{rows:.3f} px", "rows differ, rms"),
            (f"{found['filled']:.0%}", "of the image has a disparity"),
            (f"{found['points']:,}", "points"),
        ]
        unit = "m" if self.unit == "m" else "units of the calibration"
        note = (
            f"Frame {found['frame']}. rectification.json has the rotations, K and OpenCV's Q; maps.npz the maps of "
            "remap; points.ply the cloud in the left camera's frame."
        )
        return {"tiles": tiles, "note": note, "sheets": _encoded(stereo_sheets(pair, originals, unit))}


def _encoded(sheets):
    from jaxpoint.report.html import encoded

    return encoded(sheets)


def rectified_corners(
    rig: CameraRig, rectification: Rectification, calibration: Calibration | None
) -> tuple[np.ndarray, np.ndarray] | None:
    """Where the corners that both cameras saw lie in the rectified images, px (N, 2) each; None without any."""
    if calibration is None:
        return None
    pixels = calibration.tracks.pixels[calibration.kept.all(axis=1)]
    (left, first), (right, second) = (
        rectified_pixels(rectification, rig[which], which, pixels[:, which]) for which in range(2)
    )
    good = first & second
    return (left[good], right[good]) if good.any() else None


def _reaching(dense: StereoSettings, corners: tuple[np.ndarray, np.ndarray] | None) -> StereoSettings:
    """The settings with disparities up to those of the nearest board."""
    if dense.disparities or corners is None:
        return dense
    return replace(dense, disparities=int(NEARER * (corners[0][:, 0] - corners[1][:, 0]).max(initial=1.0)))


def rectification_json(rectification: Rectification, rig: CameraRig, unit: str) -> dict[str, Any]:
    """The rectification in OpenCV's terms: R1, R2, P1, P2 and Q."""
    first = np.concatenate([rectification.intrinsics, np.zeros((3, 1))], axis=1)
    second = first.copy()
    second[0, 3] = -rectification.intrinsics[0, 0] * rectification.baseline
    return {
        "cameras": list(rig.names),
        "unit": unit,
        "image_size_px": list(rectification.size),
        "baseline": rectification.baseline,
        "R1": rectification.rotations[0].tolist(),
        "R2": rectification.rotations[1].tolist(),
        "P1": first.tolist(),
        "P2": second.tolist(),
        "Q": rectification.to_points.tolist(),
    }


def write_depth_outcome(results: StereoResults, out: Path, *, inputs: Sequence[Path], force: bool) -> Outcome:
    """A folder of the depth of a calibrated pair, and its outcome."""
    figures: dict[str, Any] = {"cameras": list(results.rig.names), "settings": asdict(results.dense)}
    made = provenance(shlex.join(["jaxpoint", *sys.argv[1:]]), inputs, 0)
    missing: list[str] = []
    shown: dict[str, Any] = {}

    def report(folder: Path) -> None:
        with extra("report.html", missing):
            write_depth_page(folder / "report.html", results.rig.names, shown["rectified"], made)

    with new_run(out, force, report) as folder:
        lines, context = results.write(folder, figures)
        shown.update(context)
        write_json(folder / "metrics.json", figures)
        write_json(folder / "provenance.json", made)
    page = out / "report.html"
    return Outcome({**figures, "run": str(out)}, (*lines, *at("Report", page)), None, tuple(missing))
