"""Tables, read back by other programs' readers."""

import csv

import numpy as np
import pytest

from jaxpoint.errors import UsageError
from jaxpoint.io.table import check_table_path, write_table

COLUMNS = {
    "frame": [0, 1, 2],
    "camera": ["cam_0", "cam, 1", None],
    "x": np.array([1.25, np.nan, -1 / 3]),
}


def test_csv_is_what_the_standard_reader_sees(tmp_path):
    path = tmp_path / "table.csv"
    write_table(path, COLUMNS)
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["frame"] for row in rows] == ["0", "1", "2"]
    assert [row["camera"] for row in rows] == ["cam_0", "cam, 1", ""]
    assert rows[1]["x"] == ""
    assert float(rows[2]["x"]) == pytest.approx(-1 / 3, rel=1e-9)


def test_parquet_is_what_pyarrow_sees(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "table.parquet"
    write_table(path, COLUMNS)
    read = parquet.read_table(path).to_pydict()
    assert read["frame"] == [0, 1, 2]
    assert read["camera"] == ["cam_0", "cam, 1", None]
    assert read["x"][2] == -1 / 3


def test_another_ending_is_refused_and_nothing_is_written(tmp_path):
    with pytest.raises(UsageError, match=r"not 'table\.txt'"):
        check_table_path(tmp_path / "table.txt")
    with pytest.raises(UsageError):
        write_table(tmp_path / "table.txt", COLUMNS)
    assert not list(tmp_path.iterdir())
