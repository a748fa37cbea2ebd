"""What a format of tracks is: how its files are recognised and read."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.io.formats.calibration_format import SourceFile
from jaxpoint.io.lens_files import match_names
from jaxpoint.tracks import Tracks

ImageSizes = tuple[int, int] | Mapping[str, tuple[int, int]]


@dataclass(frozen=True)
class TrackRequest:
    """What is to be read, and what the caller knows beside it."""

    files: tuple[SourceFile, ...]  # one; of a format with a file for each camera, one or more
    label: str = ""  # what the user named: a file or a folder
    one_based: bool = False  # the pixels count from 1, as Matlab's do
    image_sizes: ImageSizes | None = None  # px, of all cameras or of each by name, for files that do not say
    min_likelihood: float | None = None  # of keypoints; less sure ones are not used. None: as the format does
    individual: str | None = None  # whose keypoints are read, where a file holds several animals or people

    @property
    def path(self) -> Path:
        """The one file, or the folder, of a format that has one."""
        return self.files[0].path

    def sizes_of(self, names: Sequence[str]) -> list[tuple[int, int]]:
        """The image size of each camera, px, for files that hold none.

        Raises:
            FileFormatError: the size of a camera is not known.
        """
        if self.image_sizes is None:
            raise FileFormatError(
                f"{self.label} does not say how large the images are; give --image-size WIDTH HEIGHT (px) where all "
                "are alike, or put a file cameras.csv (camera,width,height) beside it."
            )
        if not isinstance(self.image_sizes, Mapping):
            return [self.image_sizes for _ in names]
        places = match_names(names, list(self.image_sizes))
        if places is None:
            raise FileFormatError(
                f"{self.label} has the cameras {', '.join(names)}; image sizes are known of "
                f"{', '.join(self.image_sizes)}: name the cameras alike, and give the folder of all."
            )
        sizes = list(self.image_sizes.values())
        return [sizes[place] for place in places]

    def common_size(self) -> tuple[int, int] | None:
        """The image size that all cameras have, px; None where none is given.

        Raises:
            UsageError: the cameras differ.
        """
        if not isinstance(self.image_sizes, Mapping):
            return self.image_sizes
        sizes = set(self.image_sizes.values())
        if len(sizes) != 1:
            raise UsageError(f"{self.label} needs images of one size, and these cameras have {sorted(sizes)}.")
        return sizes.pop()


@dataclass(frozen=True)
class TrackFormat:
    """One format of tracks.

    Attributes:
        name: by which it is registered.
        title: its name for people.
        recognise: whether a file or folder is one of its own, from its path and its beginning (empty where it is no
            text).
        read: from files to tracks.
        per_camera: whether a file is one camera, and a folder of them a recording.
    """

    name: str
    title: str
    recognise: Callable[[Path, str], bool]
    read: Callable[[TrackRequest], Tracks]
    per_camera: bool = False
