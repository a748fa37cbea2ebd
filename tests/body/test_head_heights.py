"""A calibration in another unit or upside down: `detect person` and `point` say so, by the height of the heads."""

import json
import tomllib

import numpy as np
import pytest
import tomli_w
from test_joint_arms import HEADER, SESSION, landmark_lines

from jaxpoint.body.head_heights import height_remedy
from jaxpoint.cli import main
from jaxpoint.io.exchange import read_calibration
from jaxpoint.io.formats.anipose_toml import write_calibration_toml

TURN = np.diag([1.0, -1.0, -1.0])


@pytest.mark.parametrize(
    ("height", "message"),
    [
        (None, "^$"),
        (1.7, "^$"),
        (165.0, "at 165 m .*calibration is in cm, so give --unit cm"),
        (1650.4, r"at 1.65e\+03 m .*calibration is in mm"),
        (-1.62, r"at -1.62 m .*z points down; .*\(x, -y, -z\)"),
        (20.0, "at 20 m .*in metres, z points up, and z = 0 is the floor"),
    ],
)
def test_heights_name_unit_and_axes(height, message):
    import re

    assert re.search(message, height_remedy(height, 0.6, 2.2))


@pytest.fixture(scope="module")
def landmarks(tmp_path_factory):
    path = tmp_path_factory.mktemp("heights") / "landmarks.csv"
    path.write_text("\n".join([HEADER, *landmark_lines(np.random.default_rng(5))]))
    return path


def spoilt(path, scale: float, turn: np.ndarray):
    """The session's calibration in another unit and frame, still called metres."""
    content = json.loads((SESSION / "calibration.json").read_text())
    for camera in content["cameras"]:
        camera["translation"] = [scale * value for value in camera["translation"]]
        camera["rotation"] = (np.array(camera["rotation"]) @ turn.T).tolist()
    path.write_text(json.dumps({**content, "covariance": None}))
    return path


@pytest.mark.parametrize(
    ("scale", "turn", "message"),
    [(1000.0, np.eye(3), "the calibration is in mm, so give --unit mm"), (1.0, TURN, "z points down")],
)
@pytest.mark.parametrize("command", [("detect", "person"), ("point",)])
def test_both_commands_say_it(landmarks, tmp_path, capsys, command, scale, turn, message):
    wrong = spoilt(tmp_path / "calibration.json", scale, turn)
    given = ("--calibration", wrong, "--landmarks", landmarks, "--out", tmp_path / "out")
    assert main([str(part) for part in (*command, SESSION, *given)]) == 4
    error = capsys.readouterr().err
    assert "Nobody could be followed in the room" in error
    assert message in error


def test_a_toml_without_unit_is_asked_for_it(landmarks, tmp_path, capsys):
    path, rig = tmp_path / "anipose.toml", read_calibration(SESSION / "calibration.json").rig
    write_calibration_toml(path, rig)
    content = tomllib.loads(path.read_text())
    del content["metadata"]["unit"]
    for section in content.values():
        if "translation" in section:
            section["translation"] = [1000 * value for value in section["translation"]]
    path.write_text(tomli_w.dumps(content))
    given = ["detect", "person", SESSION, "--calibration", path, "--landmarks", landmarks, "--out", tmp_path / "out"]
    assert main([str(part) for part in given]) == 2
    assert "does not say its unit; give --unit mm, cm or m (a .toml may say unit" in capsys.readouterr().err
    assert main([*map(str, given), "--unit", "mm"]) == 0
    content["metadata"]["unit"] = "mm"
    path.write_text(tomli_w.dumps(content))
    np.testing.assert_allclose(read_calibration(path).rig.positions, rig.positions, atol=1e-9)
