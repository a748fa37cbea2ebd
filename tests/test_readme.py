"""What the README shows works as it stands there."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from jaxpoint.cli import parse
from jaxpoint.config import RoomConfig, load_config
from jaxpoint.geometry.line import Ray
from jaxpoint.io.calibration import read_calibration_json
from jaxpoint.io.tracks import save_tracks
from jaxpoint.pointing.line import PointingLine

README = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


COMMANDS = sorted(
    set(
        re.findall(
            r"jaxpoint (?:detect|objects|bias|check|calibrate|align|validate|diff|simulate|demo|point) [^`#\n]*", README
        )
    )
)


@pytest.mark.parametrize("line", COMMANDS)
def test_every_command_is_understood(line):
    words = shlex.split(line)[1:]
    assert type(parse(words)).__name__.lower() in (words[0], "".join(words[:2]))


def test_the_commands_were_found():
    assert {line.split()[1] for line in COMMANDS} >= {
        "detect",
        "bias",
        "check",
        "calibrate",
        "align",
        "validate",
        "diff",
        "point",
        "demo",
    }


def test_the_python_example_runs(tmp_path, monkeypatch, solved_room, capsys):
    calibration = solved_room[1]
    save_tracks(tmp_path / "tracks.npz", calibration.tracks)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("jaxpoint.calibration.selfcal.calibrate", lambda tracks: calibration)
    example, uncertainty, devices = (
        block for block in blocks("python") if "chain_of" not in block and "read_objects" not in block
    )
    names: dict = {}
    exec(example, names)
    for line in re.findall(r"^from jaxpoint.*", uncertainty + devices, re.MULTILINE):
        exec(line, names)
    np.testing.assert_allclose(names["camera"].position, solved_room[0].room.positions[2], atol=1e-9)
    assert names["found"].valid.shape == (calibration.tracks.frames,)
    assert capsys.readouterr().out


def test_the_derivatives_shown_are_there(free_room, capsys):
    known, calibration = free_room
    clicks = known.clicks
    arm = slice(8, 10)  # two clicked points that are no landmarks
    names = {
        "calibration": calibration,
        "arm_pixels": clicks.pixels[arm],
        "arm_visible": clicks.visible[arm],
        "landmarks": known.landmarks.points,
        "clicks": clicks.pixels[:8],
        "clicked": clicks.visible[:8],
    }
    (example,) = (block for block in blocks("python") if "chain_of" in block)
    exec(example, names)
    assert names["by"].light.shape == calibration.tracks.pixels.shape
    assert all(np.abs(part).max() > 0 for part in (names["by"].light, names["by"].landmarks, names["by"].clicks))
    assert capsys.readouterr().out


def test_the_objects_shown_are_pointed_at(tmp_path, monkeypatch):
    (example,) = (block for block in blocks("python") if "read_objects" in block)
    (tmp_path / "session").mkdir()
    corners = ",".join(f"{corner}_{axis}" for corner in ("lt", "rt", "lb", "rb") for axis in "xyz")
    (tmp_path / "session/objects.csv").write_text(f"name,unit,{corners}\nposter,m,1,0,2,2,0,2,1,0,1,2,0,1\n")
    monkeypatch.chdir(tmp_path)
    line = PointingLine(Ray.through(np.array([1.5, 3.0, 1.4]), np.array([1.5, 0.0, 1.5])), 1e-4 * np.eye(6))
    names = {"lines": line}
    exec(example, names)
    assert bool(names["hits"].valid[0])
    assert float(names["answer"].probability[0]) > 0.5


def test_the_calibration_shown_can_be_read(tmp_path):
    (example,) = blocks("json")
    (tmp_path / "calibration.json").write_text(example)
    read = read_calibration_json(tmp_path / "calibration.json")
    shown = json.loads(example)["cameras"][0]
    np.testing.assert_array_equal(read.rig.cameras.focal[0], [shown["K"][0][0], shown["K"][1][1]])


def test_the_settings_shown_can_be_read(tmp_path):
    (example,) = blocks("toml")
    (tmp_path / "room.toml").write_text(example)
    assert load_config(tmp_path / "room.toml") != RoomConfig()
