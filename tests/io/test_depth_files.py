"""Point clouds, disparities and depths as other programs read them."""

import cv2
import numpy as np
import pytest

from jaxpoint.io.depth_files import write_depth, write_disparity
from jaxpoint.io.ply import write_ply


def test_a_cloud_is_read_back_byte_by_byte(tmp_path):
    rng = np.random.default_rng(0)
    points, colors = rng.normal(size=(7, 3)), rng.integers(0, 256, (7, 3)).astype(np.uint8)
    write_ply(tmp_path / "points.ply", points, colors)
    header, _, data = (tmp_path / "points.ply").read_bytes().partition(b"end_header\n")
    assert header.startswith(b"ply\nformat binary_little_endian 1.0\n")
    assert b"element vertex 7\n" in header
    rows = np.frombuffer(data, dtype=[("xyz", "<f4", 3), ("rgb", "u1", 3)])
    np.testing.assert_allclose(rows["xyz"], points, rtol=1e-6)
    np.testing.assert_array_equal(rows["rgb"], colors)


def test_clouds_that_are_none_are_refused(tmp_path):
    with pytest.raises(ValueError, match="1 coordinates are not finite"):
        write_ply(tmp_path / "a.ply", np.array([[np.nan, 0, 0]]), np.zeros((1, 3), np.uint8))
    assert not list(tmp_path.iterdir())


def test_disparity_and_depth_have_sixteen_bits(tmp_path):
    write_disparity(tmp_path / "d.png", np.array([[1.5, np.nan, 300.0]]))
    write_depth(tmp_path / "z.png", np.array([[1.2345, np.inf, 70.0]]))
    disparity, depth = (cv2.imread(str(tmp_path / name), cv2.IMREAD_UNCHANGED) for name in ("d.png", "z.png"))
    assert disparity.dtype == depth.dtype == np.uint16
    np.testing.assert_array_equal(disparity, [[384, 0, 0]])
    np.testing.assert_array_equal(depth, [[1234, 0, 0]])
