"""Landmarks of a pose estimator: the true joints of the embedded session, as noisy pixels with mistakes."""

import csv
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from jaxpoint.cli import main
from jaxpoint.io.session import open_session

SESSION = Path(str(files("jaxpoint"))) / "data" / "session"
FRAMES = range(8, 22)
HEADER = "frame,camera,name,x,y,confidence,person"
GIVEN = {
    "head": "head",
    **{f"{side}_{part}": f"{side}_{part}" for side in ("left", "right") for part in ("elbow", "wrist")},
    **{f"{side}_tip": f"{side}_index" for side in ("left", "right")},
}


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def truth() -> dict[tuple[int, str], np.ndarray]:
    """Of the one person who is there: place of each joint in each frame, m."""
    found = [row for row in rows(SESSION / "truth" / "joints.csv") if int(row["frame"]) in FRAMES]
    assert len({row["person"] for row in found}) == 1
    return {(int(row["frame"]), row["joint"]): np.array([float(row[f"{a}_m"]) for a in "xyz"]) for row in found}


def landmark_lines(rng: np.random.Generator) -> list[str]:
    """What an estimator could say of the true joints: half a pixel off, some missing, one camera mixes up the sides."""
    session, joints = open_session(SESSION), truth()
    lines = []
    for (frame, joint), place in joints.items():
        if joint not in GIVEN:
            continue
        pixels = np.asarray(session.rig.project(place)) + rng.normal(0, 0.5, (len(session.names), 2))
        ahead = np.asarray(session.rig.depth(place)) > 0.3
        for camera, (x, y) in enumerate(pixels):
            width, height = session.sizes[camera]
            if not ahead[camera] or not (0 <= x < width and 0 <= y < height) or rng.random() < 0.1:
                continue
            name = GIVEN[joint]
            if camera == 2 and frame % 3 == 0 and joint != "head":
                name = name.replace("left", "LEFT").replace("right", "left").replace("LEFT", "right")
            lines.append(f"{frame},{session.names[camera]},{name},{x:.2f},{y:.2f},0.9,0")
    return lines


@pytest.fixture(scope="module")
def landmarks(tmp_path_factory):
    path = tmp_path_factory.mktemp("poses") / "landmarks.csv"
    path.write_text("\n".join([HEADER, *landmark_lines(np.random.default_rng(5))]))
    return path


def test_landmarks_become_heads_and_arms(landmarks, tmp_path):
    out = tmp_path / "run"
    assert main(["detect", "person", str(SESSION), "--landmarks", str(landmarks), "--out", str(out)]) == 0
    joints = truth()
    arms = [row for row in rows(out / "arms.csv") if row["reason"] == "found"]
    held = [row for row in arms if 11 <= int(row["frame"]) <= 17]  # the hold of the first gesture
    assert len(held) >= 6  # in one frame only the other arm is seen by two views
    angles, tips = [], []
    for row in held:
        frame = int(row["frame"])
        axis = joints[frame, "right_wrist"] - joints[frame, "right_elbow"]
        direction = np.array([float(row[f"direction_{a}"]) for a in "xyz"])
        angles.append(np.degrees(np.arccos(direction @ axis / np.linalg.norm(axis))))
        tip = np.array([float(row[f"tip_{a}_m"]) for a in "xyz"])
        tips.append(np.linalg.norm(tip - joints[frame, "right_tip"]))
        assert angles[-1] < 4 * float(row["sigma_deg"])
    assert np.median(angles) < 2.0
    assert np.median(tips) < 0.02
    seen = [row for row in rows(out / "detections.csv") if row["arm_reason"] == "found"]
    assert all(row["tip_x"] and row["base_x"] for row in seen)
    assert {row["camera"] for row in seen} <= set(open_session(SESSION).names)


def test_a_forearm_that_no_view_has_whole_is_none_and_ends_nothing(landmarks, tmp_path, capsys):
    """The elbow in some cameras and the wrist in the others: both can be triangulated, but no view is used."""
    header, *lines = landmarks.read_text().splitlines()
    apart = [
        line
        for line in lines
        if ("elbow" not in line or line.split(",")[1] in ("cam_0", "cam_1", "cam_2"))
        and ("wrist" not in line or line.split(",")[1] not in ("cam_0", "cam_1", "cam_2"))
    ]
    (tmp_path / "apart.csv").write_text("\n".join([header, *apart]))
    given = ["--landmarks", str(tmp_path / "apart.csv"), "--out", str(tmp_path / "out")]
    assert main(["point", str(SESSION), *given]) == 4
    assert "a whole forearm was measured in 0 only" in capsys.readouterr().err


def test_landmarks_without_heads_are_told_so(landmarks, tmp_path, capsys):
    header, *lines = landmarks.read_text().splitlines()
    (tmp_path / "arms.csv").write_text("\n".join([header, *(line for line in lines if ",head," not in line)]))
    given = ["--landmarks", str(tmp_path / "arms.csv"), "--out", str(tmp_path / "out")]
    assert main(["detect", "person", str(SESSION), *given]) == 4
    assert "give landmarks of heads too" in capsys.readouterr().err
