"""HDF5 files, by h5py, which is an extra."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from jaxpoint.errors import FileFormatError, MissingDependencyError

SIGNATURE = b"\x89HDF\r\n\x1a\n"


def is_hdf5(path: Path) -> bool:
    """Whether a file begins as HDF5 files do."""
    try:
        with path.open("rb") as file:
            return file.read(len(SIGNATURE)) == SIGNATURE
    except OSError:
        return False


@contextmanager
def open_hdf5(path: Path) -> Iterator[Any]:
    """An HDF5 file for reading.

    Raises:
        FileFormatError: it is damaged.
        MissingDependencyError: h5py is not installed.
    """
    try:
        import h5py
    except ModuleNotFoundError:
        raise MissingDependencyError(
            f"'{path}' is an HDF5 file, which needs h5py: pip install 'jaxpoint[h5]', or export it as CSV."
        ) from None
    try:
        with h5py.File(path) as file:
            yield file
    except OSError:
        raise FileFormatError(f"{path} is damaged or cut off (not readable as HDF5); write it again.") from None


def names_in(dataset: Any) -> tuple[str, ...]:
    """The text in a dataset of names."""
    return tuple(name.decode() if isinstance(name, bytes) else str(name) for name in dataset[()].tolist())
