"""heads.csv: what is written is read back, and what is wrong is said."""

from dataclasses import fields, replace

import numpy as np
import pytest

from jaxpoint.body.tracking.head_tracks import HeadTracks, Status
from jaxpoint.errors import FileFormatError
from jaxpoint.io.head_files import HEAD_COLUMNS, read_heads, save_heads


@pytest.fixture
def heads():
    """Two people over four frames; the second comes in the third."""
    rng = np.random.default_rng(0)
    status = np.array([[1, 0], [3, 0], [5, 2], [4, 1]])
    present = status > 0
    used = np.zeros((4, 2, 3), bool)
    used[0, 0], used[1, 0, 1], used[2, 1, [0, 2]], used[3, 1] = True, True, True, True
    return HeadTracks(
        frame_ids=np.array([10, 11, 12, 14]),
        times=np.array([0.8, 0.88, 0.96, 1.12]),
        people=np.array([1, 3]),
        positions=np.where(present[..., None], rng.uniform(0, 5, (4, 2, 3)), 0.0).round(5),
        sigma=np.where(present, 0.01234, 0.0),
        used=used,
        status=status,
        cameras=("cam_2", "cam_10", "door"),
    )


def same(one, other):
    for field in fields(HeadTracks):
        np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name), err_msg=field.name)


def test_what_is_written_is_read_back(heads, tmp_path):
    save_heads(tmp_path / "heads.csv", heads)
    same(read_heads(tmp_path / "heads.csv"), heads)
    assert (tmp_path / "heads.csv").read_text().splitlines()[:2] == [
        ",".join(HEAD_COLUMNS),
        f"10,0.8,1,{','.join(f'{x:.5f}' for x in heads.positions[0, 0])},0.01234,cam_2|cam_10|door,measured",
    ]


def test_cameras_may_be_named(heads, tmp_path):
    save_heads(tmp_path / "heads.csv", heads)
    read = read_heads(tmp_path / "heads.csv", ("window", "door", "cam_10", "cam_2"))
    np.testing.assert_array_equal(read.used, np.concatenate([np.zeros((4, 2, 1), bool), heads.used[..., ::-1]], axis=2))


def test_nobody_is_a_table_without_lines(heads, tmp_path):
    save_heads(tmp_path / "heads.csv", replace(heads, status=np.full((4, 2), int(Status.ABSENT))))
    read = read_heads(tmp_path / "heads.csv", heads.cameras)
    assert read.positions.shape == (0, 0, 3)
    assert read.used.shape == (0, 0, 3)


def test_a_name_that_would_be_cut_is_refused(heads, tmp_path):
    with pytest.raises(ValueError, match=r"cannot be written to heads\.csv"):
        save_heads(tmp_path / "heads.csv", replace(heads, cameras=("a|b", "c", "d")))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("12,0.96,3,1,2,1.6,0.01,door,measured", "line 6: person 3 is a second time in frame 12"),
        ("15,1.2,3,1,2,1.6,0.01,door,guessed", "line 6: the status 'guessed' is none of measured,"),
        ("15,1.2,3,1,2,1.6,0.01,attic,measured", "line 6: the camera 'attic' is none of cam_2"),
        ("15,1.2,3,1,,1.6,0.01,door,measured", "line 6: column 'y_m' is empty"),
    ],
)
def test_damage_is_named(heads, tmp_path, line, message):
    path = tmp_path / "heads.csv"
    save_heads(path, heads)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:5], line, *lines[5:]]) + "\n")
    with pytest.raises(FileFormatError, match=message):
        read_heads(path, heads.cameras)
