"""What one camera saw of people over a recording: made once from video, kept, and never looked at as video again."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from zipfile import BadZipFile

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxpoint.detect.arm import Crop
from jaxpoint.detect.colour import Image
from jaxpoint.detect.head import HeadReason
from jaxpoint.detect.person import FrameReason, Look, PersonWatch, Sighting
from jaxpoint.errors import FileFormatError
from jaxpoint.io.files import replacing

HEAD_ASPECT = 0.78  # width of a head over its height
OUTSIDE = 0.15  # of a head's width or height that may lie beyond the image's border
FORMAT = 4  # of the kept files; higher whenever a detector gives other results


@dataclass(frozen=True)
class CameraViews:
    """F moments of one camera, with S sightings of people in all of them."""

    size: tuple[int, int]  # px, width and height
    reasons: Int[np.ndarray, " F"]  # values of `FrameReason`
    edges: Int[np.ndarray, " F"]  # moving edge pixels
    grey: Bool[np.ndarray, " F"]  # images without colour
    moment: Int[np.ndarray, " S"]  # place among the F moments, rising
    box: Int[np.ndarray, "S 4"]  # px: left, top, width, height of the silhouette
    area: Int[np.ndarray, " S"]  # px
    centroid: Float[np.ndarray, "S 2"]  # px
    head: Float[np.ndarray, "S 2"]  # px
    head_score: Float[np.ndarray, " S"]
    head_height: Float[np.ndarray, " S"]  # px
    head_reason: Int[np.ndarray, " S"]  # values of `HeadReason`
    corner: Int[np.ndarray, "S 2"]  # px, of each crop
    packed: tuple[bytes, ...]  # crops, as PNG
    notes: tuple[str, ...] = ()

    def of(self, moment: int) -> range:
        """The sightings of one moment."""
        first, last = np.searchsorted(self.moment, [moment, moment + 1])
        return range(int(first), int(last))

    def crop(self, sighting: int) -> Crop:
        """The pixels of one sighting."""
        labels = np.asarray(cv2.imdecode(np.frombuffer(self.packed[sighting], np.uint8), cv2.IMREAD_GRAYSCALE))
        x, y = self.corner[sighting]
        return Crop(labels, (int(x), int(y)), self.size)


def watch(
    frames: Iterable[tuple[int, Image | None]],
    moments: int,
    size: tuple[int, int],
    watcher: PersonWatch,
    advance: Callable[[int, int], None] | None = None,
    notes: Sequence[str] = (),
) -> CameraViews:
    """Look through one camera's frames.

    Args:
        frames: moment and image in their order; None, or a moment left out, where the camera has no frame.
        moments: F.
        size: px, width and height.
        watcher: fresh, for this camera.
        advance: called with moments done and to do.
        notes: to keep with the views.
    """
    looks = [Look(FrameReason.NO_IMAGE, 0, False)] * moments
    kept: list[tuple[int, _Kept]] = []
    for moment, image in frames:
        if image is not None:
            look = watcher.look(image)
            kept += [(moment, _packed(sighting)) for sighting in look.sightings]
            looks[moment] = replace(look, sightings=())
        if advance:
            advance(moment + 1, moments)
    return _gathered(looks, kept, size, notes)


@dataclass(frozen=True)
class _Kept:
    """A sighting with its crop packed, so that a recording fits in memory."""

    values: tuple
    png: bytes


def _packed(sighting: Sighting) -> _Kept:
    silhouette, head, crop = sighting.silhouette, sighting.head, sighting.crop
    png = cv2.imencode(".png", crop.labels, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()
    values = (
        silhouette.box, silhouette.region.area, silhouette.region.centroid, (head.x, head.y), head.score,
        head.height_px, int(head.reason), crop.corner,
    )  # fmt: skip
    return _Kept(values, png)


def _gathered(
    looks: Sequence[Look], kept: Sequence[tuple[int, _Kept]], size: tuple[int, int], notes: Sequence[str]
) -> CameraViews:
    shapes = ((4,), (), (2,), (2,), (), (), (), (2,))
    kinds = (int, int, float, float, float, float, int, int)
    names = ("box", "area", "centroid", "head", "head_score", "head_height", "head_reason", "corner")
    columns = {
        name: np.array([one.values[i] for _, one in kept], dtype=kind).reshape(len(kept), *shape)
        for i, (name, shape, kind) in enumerate(zip(names, shapes, kinds))
    }
    return CameraViews(
        size=size,
        reasons=np.array([look.reason for look in looks], dtype=int),
        edges=np.array([look.edges for look in looks], dtype=int),
        grey=np.array([look.grey for look in looks], dtype=bool),
        moment=np.array([moment for moment, _ in kept], dtype=int),
        packed=tuple(one.png for _, one in kept),
        notes=tuple(notes),
        **columns,
    )


_ARRAYS = (
    "reasons", "edges", "grey", "moment", "box", "area", "centroid", "head", "head_score", "head_height",
    "head_reason", "corner",
)  # fmt: skip


def save_views(path: Path, views: CameraViews) -> None:
    """Keep the views of one camera in a file; it appears whole or not at all."""
    ends = np.cumsum([len(png) for png in views.packed], dtype=int)
    arrays = {name: getattr(views, name) for name in _ARRAYS}
    blob = np.frombuffer(b"".join(views.packed), np.uint8)
    with replacing(path) as file:
        np.savez(
            file, format=FORMAT, size=views.size, notes=np.array(views.notes, dtype=str), ends=ends, blob=blob, **arrays
        )


def load_views(path: Path) -> CameraViews:
    """What `save_views` kept.

    Raises:
        FileFormatError: it is no such file, or of another version.
    """
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as kept:
            if int(kept["format"]) != FORMAT:
                raise FileFormatError(f"'{path}' was kept by another version of jaxpoint; delete it.")
            blob, ends = kept["blob"].tobytes(), kept["ends"].tolist()
            packed = tuple(blob[first:last] for first, last in zip([0, *ends], ends))
            arrays = {name: kept[name] for name in _ARRAYS}
            width, height = (int(n) for n in kept["size"])
            return CameraViews(size=(width, height), packed=packed, notes=tuple(kept["notes"].tolist()), **arrays)
    except (OSError, EOFError, BadZipFile, ValueError, KeyError) as error:
        raise FileFormatError(f"'{path}' cannot be read as kept detections ({error}); delete it.") from None


def head_found(views: CameraViews) -> Bool[np.ndarray, " S"]:
    """Sightings whose head was found."""
    return views.head_reason == HeadReason.FOUND


def head_cut(views: CameraViews) -> Bool[np.ndarray, " S"]:
    """Sightings whose head was found, but too much of it lies outside the image to trust its place."""
    return views.head_reason == HeadReason.OUT_OF_VIEW


def head_inside(views: CameraViews) -> Bool[np.ndarray, " S"]:
    """Sightings whose head lies in the image but for a small part: what is cut by the border may be a shoulder."""
    half = views.head_height[:, None] / 2 * np.array([HEAD_ASPECT, 1.0])
    beyond = np.maximum(half - views.head, views.head + half - np.array(views.size))
    return np.all(beyond <= 2 * OUTSIDE * half, axis=1)
