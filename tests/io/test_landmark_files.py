"""Landmarks of a pose estimator in a file: names, and what is refused."""

from importlib.resources import files
from pathlib import Path

import pytest

from jaxpoint.cli import main
from jaxpoint.evidence.person_evidence import JOINTS
from jaxpoint.io.landmark_files import joint_of, read_poses
from jaxpoint.io.session import open_session

SESSION = Path(str(files("jaxpoint"))) / "data" / "session"
HEADER = "frame,camera,name,x,y,confidence,person"


def test_names_of_common_estimators():
    names = {"LWrist": "left_wrist", "RElbow": "right_elbow", "LEFT_INDEX": "left_index", "Nose": "nose"}
    names |= {"right_index_finger_tip": "right_index", "leftShoulder": "left_shoulder", "left ear": "left_ear"}
    assert {name: joint_of(name) for name in names} == names
    assert all(joint_of(joint) == joint for joint in JOINTS)


def test_weak_landmarks_are_left_out(tmp_path):
    path = tmp_path / "landmarks.csv"
    path.write_text(f"{HEADER}\n8,cam_0,head,20,30,0.9,0\n8,cam_0,left_wrist,40,50,0.2,0\n")
    poses = read_poses(path, open_session(SESSION), 0.3)
    assert poses.seen.sum() == 1


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("8,cam_9,head,20,30,0.9,0", "no camera 'cam_9'"),
        ("9999,cam_0,head,20,30,0.9,0", "no frame 9999"),
        ("8,cam_0,head,20,30,90,0", "'confidence' is 90"),
        ("8,cam_0,head,20,,0.9,0", "'y' is empty"),
        ("8,cam_0,tail,20,30,0.9,0", "known name, the first is 'tail'"),
        ("8,cam_0,head,-5000,30,0.9,0", "line 2: (-5000, 30) lies far outside the image of camera 'cam_0', which has"),
        ("8,cam_0,head,0.4,0.3,0.9,0\n8,cam_1,head,1.1,0.2,0.9,0", "between 0.2 and 1.1, as fractions of the image do"),
        ("8,cam_0,head,20,30,0.9,0\n8,cam_0,head,25,30,0.9,0", "'head' twice"),
    ],
)
def test_bad_landmarks_are_told(tmp_path, capsys, line, says):
    path = tmp_path / "landmarks.csv"
    path.write_text(f"{HEADER}\n{line}\n")
    out = tmp_path / "run"
    assert main(["detect", "person", str(SESSION), "--landmarks", str(path), "--out", str(out)]) == 7
    assert says in capsys.readouterr().err
    assert not out.exists()
