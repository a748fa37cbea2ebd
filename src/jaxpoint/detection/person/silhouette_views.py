"""What one camera saw of people over a recording: made once from video, kept, and never looked at as video again."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from jaxpoint.detection.colour import Image
from jaxpoint.detection.person.crop import PackedCrop
from jaxpoint.detection.person.silhouette_evidence import SilhouetteEvidence
from jaxpoint.detection.person.watcher import Look, PersonWatch, Sighting
from jaxpoint.errors import FileFormatError
from jaxpoint.evidence.camera_evidence import AbstractCameraEvidence, FrameReason
from jaxpoint.io.files import replacing

FORMAT = 4  # of the kept files; higher whenever a detector gives other results


@dataclass(frozen=True, kw_only=True)
class SilhouetteViews(AbstractCameraEvidence):
    """The silhouettes of people in one camera's images, with their crops packed."""

    edges: Int[np.ndarray, " F"]  # moving edge pixels
    grey: Bool[np.ndarray, " F"]  # images without colour
    area: Int[np.ndarray, " S"]  # px
    centroid: Float[np.ndarray, "S 2"]  # px
    head_score: Float[np.ndarray, " S"]
    corner: Int[np.ndarray, "S 2"]  # px, of each crop
    packed: tuple[bytes, ...]  # crops, as PNG

    def person(self, sighting: int) -> SilhouetteEvidence:
        """The pixels of one sighting."""
        x, y = self.corner[sighting]
        return SilhouetteEvidence(PackedCrop(self.packed[sighting], (int(x), int(y)), self.size))

    @property
    def moving_edges(self) -> Int[np.ndarray, " F"]:
        """Moving edge pixels of each image."""
        return self.edges

    @property
    def colourless(self) -> Bool[np.ndarray, " F"]:
        """Images without colour."""
        return self.grey

    @property
    def silhouette_px(self) -> Int[np.ndarray, " S"]:
        """Area of each silhouette."""
        return self.area

    @property
    def head_certainty(self) -> Float[np.ndarray, " S"]:
        """The correlation of each head with its template."""
        return self.head_score

    def labels(self, sighting: int) -> tuple[UInt8[np.ndarray, "h w"], tuple[int, int]]:
        """The pixels of a person's part of the image, and its corner (x, y)."""
        crop = self.person(sighting).crop
        return crop.labels, crop.corner


def watch(
    images: Iterable[tuple[int, Image | None]],
    frames: int,
    size: tuple[int, int],
    watcher: PersonWatch,
    advance: Callable[[int, int], None] | None = None,
    notes: Sequence[str] = (),
) -> SilhouetteViews:
    """Look through one camera's frames.

    Args:
        images: frame and image in their order; None, or a frame left out, where the camera has no image.
        frames: F.
        size: px, width and height.
        watcher: fresh, for this camera.
        advance: called with frames done and to do.
        notes: to keep with the views.
    """
    looks = [Look(FrameReason.NO_IMAGE, 0, False)] * frames
    kept: list[tuple[int, _PackedSighting]] = []
    for frame, image in images:
        if image is not None:
            look = watcher.look(image)
            kept += [(frame, _pack(sighting)) for sighting in look.sightings]
            looks[frame] = replace(look, sightings=())
        if advance:
            advance(frame + 1, frames)
    return _collect(looks, kept, size, notes)


@dataclass(frozen=True)
class _PackedSighting:
    """A sighting with its crop packed, so that a recording fits in memory."""

    values: tuple
    png: bytes


def _pack(sighting: Sighting) -> _PackedSighting:
    silhouette, head, crop = sighting.silhouette, sighting.head, sighting.crop
    values = (
        silhouette.box, silhouette.region.area, silhouette.region.centroid, (head.x, head.y), head.score,
        head.height_px, int(head.reason), crop.corner,
    )  # fmt: skip
    return _PackedSighting(values, PackedCrop.of(crop).png)


def _collect(
    looks: Sequence[Look], kept: Sequence[tuple[int, _PackedSighting]], size: tuple[int, int], notes: Sequence[str]
) -> SilhouetteViews:
    shapes = ((4,), (), (2,), (2,), (), (), (), (2,))
    kinds = (int, int, float, float, float, float, int, int)
    names = ("box", "area", "centroid", "head", "head_score", "head_height", "head_reason", "corner")
    columns = {
        name: np.array([one.values[i] for _, one in kept], dtype=kind).reshape(len(kept), *shape)
        for i, (name, shape, kind) in enumerate(zip(names, shapes, kinds))
    }
    return SilhouetteViews(
        size=size,
        reasons=np.array([look.reason for look in looks], dtype=int),
        edges=np.array([look.edges for look in looks], dtype=int),
        grey=np.array([look.grey for look in looks], dtype=bool),
        frame=np.array([frame for frame, _ in kept], dtype=int),
        packed=tuple(one.png for _, one in kept),
        notes=tuple(notes),
        **columns,
    )


_ARRAYS = (
    "reasons", "edges", "grey", "frame", "box", "area", "centroid", "head", "head_score", "head_height",
    "head_reason", "corner",
)  # fmt: skip


def save_views(path: Path, views: SilhouetteViews) -> None:
    """Keep the views of one camera in a file; it appears whole or not at all."""
    ends = np.cumsum([len(png) for png in views.packed], dtype=int)
    arrays = {name: getattr(views, name) for name in _ARRAYS}
    blob = np.frombuffer(b"".join(views.packed), np.uint8)
    with replacing(path) as file:
        np.savez(
            file, format=FORMAT, size=views.size, notes=np.array(views.notes, dtype=str), ends=ends, blob=blob, **arrays
        )


def load_views(path: Path) -> SilhouetteViews:
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
            return SilhouetteViews(size=(width, height), packed=packed, notes=tuple(kept["notes"].tolist()), **arrays)
    except (OSError, EOFError, BadZipFile, ValueError, KeyError) as error:
        raise FileFormatError(f"'{path}' cannot be read as kept detections ({error}); delete it.") from None
