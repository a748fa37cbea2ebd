"""Tracks: where each camera saw the light, frame by frame."""

from __future__ import annotations

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxpoint.errors import InsufficientDataError


class Tracks(eqx.Module):
    """Pixels of one moving light in C cameras over F frames.

    A hidden light has `visible` False and pixel (0, 0); NaN never means "missing". Build one with
    `Tracks.from_pixels`, which accepts NaN and checks everything.
    """

    pixels: Float[np.ndarray, "F C 2"]  # px, (0, 0) is the centre of the top-left pixel
    visible: Bool[np.ndarray, "F C"]
    image_sizes: Int[np.ndarray, "C 2"]  # px, width and height
    frame_ids: Int[np.ndarray, " F"]  # number of the frame in the recording
    times: Float[np.ndarray, " F"] | None = None  # s
    names: tuple[str, ...] = eqx.field(static=True, default=())
    pixel_aspects: Float[np.ndarray, " C"] | None = None  # width over height of a pixel, as the videos state it

    @staticmethod
    def from_pixels(
        pixels: Float[np.ndarray, "F C 2"],
        image_sizes: Int[np.ndarray, "C 2"],
        visible: Bool[np.ndarray, "F C"] | None = None,
        frame_ids: Int[np.ndarray, " F"] | None = None,
        times: Float[np.ndarray, " F"] | None = None,
        names: Sequence[str] = (),
        pixel_aspects: Float[np.ndarray, " C"] | None = None,
    ) -> Tracks:
        """Checked tracks from an array of pixels, NaN (or `visible` False) where the light was not seen.

        Raises:
            ValueError: shapes do not fit, an infinite pixel, or a name used twice.
        """
        pixels = np.array(pixels, dtype=np.float64)
        if pixels.ndim != 3 or pixels.shape[2] != 2:
            raise ValueError(f"Pixels must have shape (frames, cameras, 2), not {pixels.shape}.")
        frames, cameras, _ = pixels.shape
        if np.isinf(pixels).any():
            frame, camera, _ = np.argwhere(np.isinf(pixels))[0]
            raise ValueError(
                f"The pixel of camera {camera} in frame {frame} is infinite; write NaN where the light was not seen."
            )
        seen = np.asarray(np.isfinite(pixels).all(axis=2))
        if visible is not None:
            visible = np.asarray(visible, dtype=bool)
            if visible.shape != (frames, cameras):
                raise ValueError(f"`visible` has shape {visible.shape}, but the pixels need {(frames, cameras)}.")
            if (visible & ~seen).any():
                frame, camera = np.argwhere(visible & ~seen)[0]
                raise ValueError(
                    f"Camera {camera} in frame {frame} is marked visible but its pixel is NaN; "
                    "mark it hidden or give its pixel."
                )
            seen = visible
        sizes = np.asarray(image_sizes).astype(np.int64)
        if sizes.shape != (cameras, 2) or (sizes <= 0).any():
            raise ValueError(f"Image sizes must be {cameras} rows of positive width and height, not {sizes.tolist()}.")
        names = tuple(names) or tuple(f"cam_{i}" for i in range(cameras))
        if len(names) != cameras or len(set(names)) != cameras:
            raise ValueError(f"{cameras} cameras need {cameras} different names, not {list(names)}.")
        ids = np.arange(frames) if frame_ids is None else np.asarray(frame_ids).astype(np.int64)
        if ids.shape != (frames,):
            raise ValueError(f"`frame_ids` has shape {ids.shape}, but there are {frames} frames.")
        if times is not None:
            times = np.asarray(times, dtype=np.float64)
            if times.shape != (frames,):
                raise ValueError(f"`times` has shape {times.shape}, but there are {frames} frames.")
        if pixel_aspects is not None:
            pixel_aspects = np.asarray(pixel_aspects, dtype=np.float64)
            if pixel_aspects.shape != (cameras,) or not (np.isfinite(pixel_aspects) & (pixel_aspects > 0)).all():
                raise ValueError(
                    f"{cameras} cameras need as many positive pixel aspects, not {pixel_aspects.tolist()}."
                )
        return Tracks(np.where(seen[..., None], pixels, 0.0), seen, sizes, ids, times, names, pixel_aspects)

    @property
    def cameras(self) -> int:
        """Number of cameras, C."""
        return self.pixels.shape[1]

    @property
    def frames(self) -> int:
        """Number of frames, F."""
        return self.pixels.shape[0]

    def select_frames(self, frames: np.ndarray) -> Tracks:
        """The tracks of some frames only (a bool mask or indices into F)."""
        times = None if self.times is None else self.times[frames]
        return Tracks(
            self.pixels[frames],
            self.visible[frames],
            self.image_sizes,
            self.frame_ids[frames],
            times,
            self.names,
            self.pixel_aspects,
        )

    def select_cameras(self, cameras: Sequence[int]) -> Tracks:
        """The tracks of some cameras only, in the order given.

        Raises:
            InsufficientDataError: no camera is left.
        """
        index = list(cameras)
        if not index:
            raise InsufficientDataError("No camera is left; keep at least two.")
        return Tracks(
            self.pixels[:, index],
            self.visible[:, index],
            self.image_sizes[index],
            self.frame_ids,
            self.times,
            tuple(self.names[i] for i in index),
            None if self.pixel_aspects is None else self.pixel_aspects[index],
        )
