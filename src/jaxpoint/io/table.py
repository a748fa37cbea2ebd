"""Tables of named columns, as CSV or Parquet by the file's ending."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from jaxpoint.errors import MissingDependencyError, UsageError
from jaxpoint.io.files import replacing

DIGITS = 10  # significant, of numbers in a CSV file


def check_table_path(path: Path) -> None:
    """Refuse a table's name before any work is done.

    Raises:
        UsageError: it ends neither in .csv nor in .parquet.
        MissingDependencyError: Parquet without pyarrow.
    """
    if path.suffix not in (".csv", ".parquet"):
        raise UsageError(f"A table's name ends in .csv or .parquet, not '{path.name}'.")
    if path.suffix == ".parquet":
        _pyarrow()


def write_table(path: Path, columns: Mapping[str, Sequence | np.ndarray]) -> None:
    """Write columns of equal length; a number that is not there is NaN or None and stays empty.

    Raises:
        UsageError: another ending than .csv or .parquet.
        MissingDependencyError: Parquet without pyarrow.
    """
    check_table_path(path)
    with replacing(path) as file:
        if path.suffix == ".parquet":
            arrow, parquet = _pyarrow()
            parquet.write_table(
                arrow.table({name: arrow.array(list(column)) for name, column in columns.items()}), file
            )
            return
        text = io.TextIOWrapper(file, encoding="utf-8", newline="")
        rows = csv.writer(text, lineterminator="\n")
        rows.writerow(columns)
        rows.writerows([_cell(value) for value in row] for row in zip(*columns.values()))
        text.flush()
        text.detach()


def is_number(cell: str) -> bool:
    """Whether a cell of a table holds a number."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _cell(value: object) -> object:
    if isinstance(value, float | np.floating):
        return "" if np.isnan(value) else f"{value:.{DIGITS}g}"
    return "" if value is None else value


def _pyarrow():
    try:
        import pyarrow
        import pyarrow.parquet
    except ModuleNotFoundError:
        raise MissingDependencyError("Parquet needs pyarrow: pip install 'jaxpoint[tables]', or name a .csv.") from None
    return pyarrow, pyarrow.parquet
