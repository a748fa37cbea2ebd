"""Landmarks, clicked points, lengths, camera centres and known lenses in files."""

import numpy as np
import pytest

from jaxpoint.errors import FileFormatError
from jaxpoint.io.calibration import write_calibration_json
from jaxpoint.io.survey_files import (
    read_camera_centres,
    read_landmark_pixels,
    read_landmarks,
    read_lengths,
)
from jaxpoint.simulate.rooms import random_room


def write(path, text):
    path.write_text(text)
    return path


def test_landmarks(tmp_path):
    path = write(tmp_path / "landmarks.csv", "\ufeffname, x_m, y_m, z_m\n# the door\ndoor,1,2,3\ntable, 4 ,5,-6e-1\n")
    landmarks = read_landmarks(path)
    assert landmarks.names == ("door", "table")
    np.testing.assert_array_equal(landmarks.points, [[1, 2, 3], [4, 5, -0.6]])
    assert landmarks.sigmas is None
    landmarks = read_landmarks(write(path, "name,x_m,y_m,z_m,sigma_m\na,1,2,3,0.01\nb,4,5,6,0.02\n"))
    chosen = landmarks.select(["b"])
    assert chosen.points.tolist() == [[4, 5, 6]]
    assert chosen.sigmas is not None
    assert chosen.sigmas.tolist() == [0.02]


def test_landmark_pixels(tmp_path):
    path = write(tmp_path / "clicks.csv", "name,camera,x,y\ndoor,b,1,2\ntable,a,3,4\ndoor,a,5,6\n")
    clicks = read_landmark_pixels(path, ["a", "b", "c"])
    assert clicks.names == ("door", "table")
    np.testing.assert_array_equal(clicks.visible, [[1, 1, 0], [1, 0, 0]])
    np.testing.assert_array_equal(clicks.pixels[0], [[5, 6], [1, 2], [0, 0]])


def test_points_that_were_not_clicked(tmp_path):
    text = "name,cam_id,u,v\ndoor,b,1,2\ndoor,a,,\ntable,a,nan,nan\ntable,b,0,0\n"
    clicks = read_landmark_pixels(write(tmp_path / "clicks.csv", text), ["a", "b"])
    np.testing.assert_array_equal(clicks.visible, [[0, 1], [0, 1]])  # one click may lie in the corner, many do not
    for place in ("0,0", "-1,-1"):
        path = write(tmp_path / "clicks.csv", f"name,camera,x,y\ndoor,b,1,2\ndoor,a,{place}\ntable,a,{place}\n")
        with pytest.raises(FileFormatError, match=r"2 points are clicked at one and the same pixel .*cells .* empty"):
            read_landmark_pixels(path, ["a", "b"])


def test_lengths(tmp_path):
    path = write(tmp_path / "lengths.csv", "name,end_a,end_b,length_m\nedge,p,q,1.25\n")
    lengths = read_lengths(path)
    assert (lengths.names, lengths.ends, lengths.length_m.tolist()) == (("edge",), (("p", "q"),), [1.25])
    for column, value in (("length_mm", 1250), ("Length [cm]", 125), ("length (m)", 1.25)):
        write(path, f"name,end_a,end_b,{column}\nedge,p,q,{value}\n")
        assert read_lengths(path).length_m.tolist() == [1.25]


@pytest.mark.parametrize(
    ("reader", "text", "message"),
    [
        (read_landmarks, "name,x_m,y_m,z_m\na,1,2,3\na,4,5,6\n", "line 3: the name 'a' is used twice"),
        (read_landmarks, "name,x_m,y_m,z_m\na,1,2,nan\n", "line 2: column 'z_m' is nan"),
        (read_landmarks, "name,x_m,y_m,z_m,sigma_m\na,1,2,3,0\n", "'sigma_m' is 0; it must be positive"),
        (read_landmarks, "name,x_m,y_m,z_m,sigma_m\na,1,2,3,\n", "'sigma_m' is empty"),
        (read_landmarks, "name,x,y,z\na,1,2,3\n", "no column 'x_m' .*unit of 'x': name it x_m, x_cm or x_mm"),
        (read_lengths, "name,end_a,end_b,length_m\na,p,q,-1\n", "'length_m' is -1; it must be positive"),
        (read_lengths, "name,end_a,end_b,length_m\na,p,p,1\n", "both ends are 'p'"),
        (lambda p: read_landmark_pixels(p, ["a"]), "name,camera,x,y\nd,b,1,2\n", "no camera 'b'; the cameras are a"),
        (lambda p: read_landmark_pixels(p, ["a"]), "name,camera,x,y\nd,a,1,2\nd,a,1,2\n", "given twice for camera 'a'"),
    ],
)
def test_errors_say_where(tmp_path, reader, text, message):
    with pytest.raises(FileFormatError, match=message):
        reader(write(tmp_path / "file.csv", text))


def test_camera_centres_from_every_kind_of_file(tmp_path):
    room = random_room(0, cameras=4)
    cameras = room.tracks.names
    write_calibration_json(tmp_path / "calibration.json", room.rig)
    np.savetxt(tmp_path / "original_cam_centers.dat", room.positions)
    rows = [f"{name},{x},{y},{z}" for name, (x, y, z) in zip(cameras, room.positions.tolist())]
    write(tmp_path / "centres.csv", "\n".join(["name,x_m,y_m,z_m", "door,0,0,0", *reversed(rows)]))
    for path in ("calibration.json", "original_cam_centers.dat", "centres.csv", "."):
        known = read_camera_centres(tmp_path / path, cameras)
        assert known.names == cameras
        np.testing.assert_allclose(known.points, room.positions, atol=1e-9)
    assert read_camera_centres(tmp_path / "centres.csv", [*cameras[:2], "new"]).names == cameras[:2]
    with pytest.raises(FileFormatError, match="4 x 3; 5 cameras need 5 rows"):
        read_camera_centres(tmp_path / "original_cam_centers.dat", [*cameras, "new"])
    with pytest.raises(FileFormatError, match="none of which is a camera of the rig"):
        read_camera_centres(tmp_path / "centres.csv", ["new"])


def test_camera_centres_must_be_metric(tmp_path):
    room = random_room(0, cameras=3)
    write_calibration_json(tmp_path / "calibration.json", room.rig, unit="arbitrary")
    with pytest.raises(FileFormatError, match="is in the unit 'arbitrary'"):
        read_camera_centres(tmp_path / "calibration.json", room.tracks.names)
