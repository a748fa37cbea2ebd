"""Svoboda's folders: published counts of the real recordings, and every way in which a folder can be wrong."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from jaxpoint.errors import FileFormatError
from jaxpoint.io.svoboda import read_matrix, read_rad_folder, read_svoboda

PIXELS = np.array([[[10.5, 20.0], [30.0, 40.0]], [[11.0, 21.0], [np.nan, np.nan]], [[12.0, 22.0], [32.0, 42.0]]])


def matrix_text(matrix: np.ndarray) -> str:
    return "\n".join(" ".join(f"{value:.7e}" for value in row) for row in matrix) + "\n"


def octave_text(name: str, matrix: np.ndarray) -> str:
    rows, columns = matrix.shape
    return f"# Created by Octave\n# name: {name}\n# type: matrix\n# rows: {rows}\n# columns: {columns}\n" + matrix_text(
        matrix
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two cameras, three frames, camera 1 hidden in frame 1."""
    homogeneous = np.concatenate([PIXELS, np.ones((3, 2, 1))], axis=2)
    homogeneous[np.isnan(PIXELS).any(axis=2)] = np.nan
    (tmp_path / "points.dat").write_text(matrix_text(homogeneous.transpose(1, 2, 0).reshape(6, 3)))
    (tmp_path / "IdMat.dat").write_text("1 1 1\n1 0 1\n")
    (tmp_path / "Res.dat").write_text("640 480\n752 480\n")
    return tmp_path


def test_reads_what_was_written(folder):
    tracks = read_svoboda(folder)
    np.testing.assert_array_equal(tracks.visible, [[1, 1], [1, 0], [1, 1]])
    np.testing.assert_array_equal(tracks.pixels, np.nan_to_num(PIXELS))
    np.testing.assert_array_equal(tracks.image_sizes, [[640, 480], [752, 480]])
    assert tracks.names == ("cam_0", "cam_1")


def test_one_based_pixels_move_by_one(folder):
    tracks = read_svoboda(folder, one_based=True)
    np.testing.assert_array_equal(tracks.pixels[0], PIXELS[0] - 1)
    assert (tracks.pixels[1, 1] == 0).all()  # hidden pixels stay (0, 0)


def test_octave_headers_and_not_available(folder):
    for name in ("points", "IdMat", "Res"):
        path = folder / f"{name}.dat"
        path.write_text(octave_text(name, read_matrix(path)).replace("nan", "NA"))
    np.testing.assert_array_equal(read_svoboda(folder).pixels, np.nan_to_num(PIXELS))


def test_hidden_by_either_idmat_or_nan(folder):
    (folder / "IdMat.dat").write_text("0 1 1\n1 1 1\n")  # says hidden in frame 0, and visible where the pixel is NaN
    np.testing.assert_array_equal(read_svoboda(folder).visible, [[0, 1], [1, 0], [1, 1]])


def test_names_from_camera_order(folder):
    (folder / "camera_order.txt").write_text("left\nright\n")
    assert read_svoboda(folder).names == ("left", "right")
    (folder / "camera_order.txt").write_text("left\n")
    with pytest.raises(FileFormatError, match=r"camera_order\.txt must hold 2 different names"):
        read_svoboda(folder)


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("points.dat", None, r"There is no file .*points\.dat"),
        ("IdMat.dat", "1 1\n1 0\n", r"points\.dat is 6 x 3, but IdMat\.dat is 2 x 2 and asks for 6 x 2"),
        ("Res.dat", "640 480\n", r"Res\.dat is 1 x 2, but 2 cameras need 2 rows"),
        ("Res.dat", "640 480\n752 nan\n", r"Res\.dat, row 2: \[752\.0, nan\] is not a width and height"),
        ("Res.dat", "640 480\n-752 480\n", r"Res\.dat, row 2"),
        ("IdMat.dat", "1 1 1\n1 3 1\n", r"IdMat\.dat, row 2, column 2: 3\.0 is neither 0 nor 1"),
        ("IdMat.dat", "1 1 1\n1 0\n", r"IdMat\.dat, line 2: 2 values where the lines before have 3; the file is cut"),
        ("IdMat.dat", "# rows: 3\n# columns: 3\n1 1 1\n1 0 1\n", r"holds 2 x 3 .* header says 3 x 3; the file is cut"),
        ("IdMat.dat", "1 1 1\n1 x 1\n", r"IdMat\.dat, line 2: .*only numbers"),
        ("IdMat.dat", "", r"IdMat\.dat holds no numbers"),
    ],
)
def test_broken_files_are_named(folder, file, text, message):
    (folder / file).unlink() if text is None else (folder / file).write_text(text)
    with pytest.raises(FileFormatError, match=message):
        read_svoboda(folder)


@pytest.mark.parametrize(("old", "new"), [("1.0500000e+01", "inf"), ("1.0000000e+00 1", "2.0000000e+00 1")])
def test_infinite_pixels_and_wrong_third_rows(folder, old, new):
    path = folder / "points.dat"
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(FileFormatError, match=r"points\.dat, camera 1, column 1: .* is not u, v, 1"):
        read_svoboda(folder)


def test_strawlab_counts(data_folder):
    tracks = read_svoboda(data_folder / "svoboda_strawlab2010")
    assert tracks.visible.sum(axis=0).tolist() == [943, 1122, 1049, 800]  # its README
    assert tracks.visible.all(axis=1).sum() == 539
    assert (tracks.image_sizes == [752, 480]).all()
    assert tracks.names[0] == "sericomyia-mobile.local_0"


def test_arctic_counts_and_lens(data_folder):
    folder = data_folder / "svoboda_arctic4"
    tracks = read_svoboda(folder, one_based=True)
    assert tracks.visible.sum(axis=0).tolist() == [443, 444, 454, 406]  # its README
    assert (tracks.visible.sum(axis=1) >= 2).sum() == 476
    rig = read_rad_folder(folder, tracks.image_sizes, tracks.names, one_based=True)
    np.testing.assert_allclose(np.asarray(rig.cameras.focal)[:, 0], [919.9, 711.6, 779.9, 855.5], atol=0.06)
    np.testing.assert_allclose(np.asarray(rig.cameras.center), [[318.5, 238.5]] * 4)
    coefficients = np.asarray(rig.cameras.distortion)
    np.testing.assert_allclose(coefficients[:, 0], [-0.2388, -0.1788, -0.0252, 0.2142], atol=1e-4)
    assert (coefficients[:, 1:] == 0).all()


def test_published_calibration_reprojects(data_folder):
    """K and distortion as we read them, with the published points and matrices, give the means of its README."""
    folder = data_folder / "svoboda_arctic4"
    rig = read_rad_folder(folder, np.tile([640, 480], (4, 1)))
    inliers = [read_matrix(folder / f"cam{camera}.points4cal.dat") for camera in (1, 2, 3, 4)]
    matrices = [read_matrix(folder / f"camera{camera}.Pmat.cal") for camera in (1, 2, 3, 4)]
    pixels = np.zeros((max(map(len, inliers)), 4, 2))
    for camera, rows in enumerate(inliers):
        pixels[: len(rows), camera] = rows[:, 4:6]
    undistorted = np.asarray(rig.undistort(pixels)[0])
    means = []
    for camera, (rows, matrix) in enumerate(zip(inliers, matrices)):
        projected = rows[:, :4] @ matrix.T
        errors = projected[:, :2] / projected[:, 2:] - undistorted[: len(rows), camera]
        means.append(np.linalg.norm(errors, axis=1).mean())
    np.testing.assert_allclose(means, [0.309, 0.325, 0.378, 0.451], atol=0.001)


def test_rad_files_that_are_wrong(tmp_path):
    good = "\n".join(f"K{i}{j} = {900.0 * (i == j < 3) + (i == j == 3)}" for i in (1, 2, 3) for j in (1, 2, 3))
    good += "\n\n" + "\n".join(f"kc{i} = 0.0" for i in (1, 2, 3, 4))
    sizes = np.array([[640, 480]])
    with pytest.raises(FileFormatError, match=r"0 \.rad files for 1 cameras"):
        read_rad_folder(tmp_path, sizes)
    path = tmp_path / "cam1.rad"
    for text, message in (
        (good.replace("kc3 = 0.0", ""), "no number for kc3"),
        (good.replace("K12 = 0.0", "K12 = 5.0"), "no skew"),
        (good.replace("kc1 = 0.0", "kc1 = nan"), "no number for kc1"),
        (good.replace("kc1 = 0.0", "kc1 = x"), "x is not a number"),
    ):
        path.write_text(text)
        with pytest.raises(FileFormatError, match=message):
            read_rad_folder(tmp_path, sizes)


def test_nothing_but_the_three_files_is_needed(data_folder, tmp_path):
    for name in ("points.dat", "IdMat.dat", "Res.dat"):
        shutil.copyfile(data_folder / "svoboda_strawlab2010" / name, tmp_path / name)
    assert read_svoboda(tmp_path).names == ("cam_0", "cam_1", "cam_2", "cam_3")
