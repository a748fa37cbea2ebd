"""Masks: where in a camera's images no light is looked for. Black is left out, white is looked at."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.io.images import IMAGE_SUFFIXES, read_grey

FOLDER = "masks"
WHITE = 128  # grey levels from which a pixel is looked at

Mask = Bool[np.ndarray, "H W"]  # True where a light is looked for


def mask_files(given: Path | None, sources: Sequence[Path], names: Sequence[str]) -> tuple[Path | None, ...]:
    """The mask of each camera, None where it has none.

    Args:
        given: the folder of masks; None takes the folders `masks` beside the recordings, where there are any.
        sources: recordings of each camera.
        names: of the cameras; a mask is called like its camera or its recording.

    Raises:
        UsageError: no such folder, none in it, or a mask of no camera.
        FileFormatError: two masks of one camera.
    """
    if given is not None and not given.is_dir():
        raise UsageError(f"There is no folder of masks '{given}'; give one with an image a camera, such as cam_0.png.")
    folders = [source.absolute().parent / FOLDER if given is None else given for source in sources]
    found = {folder: _images(folder) for folder in dict.fromkeys(folders)}
    if given is not None and not found[given]:
        raise UsageError(f"The folder '{given}' holds no masks; put one image a camera there, such as {names[0]}.png.")
    files = tuple(
        found[folder].get(name) or found[folder].get(_stem(source))
        for folder, source, name in zip(folders, sources, names)
    )
    for masks in found.values():
        _refuse_strangers(masks, set(files), sources, names)
    return files


def read_mask(file: Path, size: tuple[int, int]) -> Mask:
    """A mask for images of this size (px, width and height).

    Raises:
        FileFormatError: it cannot be decoded, has another size, or hides everything.
    """
    grey = read_grey(file)
    if (grey.shape[1], grey.shape[0]) != size:
        raise FileFormatError(
            f"The mask '{file}' is {grey.shape[1]} x {grey.shape[0]} px but the camera's images are {size[0]} x "
            f"{size[1]}; draw it on an image of this camera."
        )
    mask = grey >= WHITE
    if not mask.any():
        raise FileFormatError(f"The mask '{file}' is black all over; black is left out, so paint white where to look.")
    return mask


def _images(folder: Path) -> dict[str, Path]:
    """The images of a folder by their names, none where there is no such folder."""
    found: dict[str, Path] = {}
    files = sorted(folder.iterdir()) if folder.is_dir() else []
    for file in files:
        if file.suffix.lower() not in IMAGE_SUFFIXES or file.name.startswith("."):
            continue
        if file.stem in found:
            raise FileFormatError(f"'{found[file.stem]}' and '{file}' are masks of one camera; keep one of them there.")
        found[file.stem] = file
    return found


def _refuse_strangers(
    masks: dict[str, Path], used: set[Path | None], sources: Sequence[Path], names: Sequence[str]
) -> None:
    """A mask of no camera is a misspelt one; those of recordings that lie beside the given ones are left alone."""
    beside = {_stem(path) for source in sources for path in source.absolute().parent.iterdir()}
    for name, file in masks.items():
        if file not in used and name not in beside:
            raise UsageError(
                f"The mask '{file}' belongs to no camera; the cameras are {', '.join(names)}. Name it like one of them."
            )


def _stem(path: Path) -> str:
    return path.name if path.is_dir() else path.stem
