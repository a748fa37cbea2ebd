"""A format of one's own: one class, one registration, and everything knows it."""

import json
import re

import numpy as np
import pytest
from test_exchange import pixels, rig_of

from jaxpoint.cli import main
from jaxpoint.io import (
    FORMATS,
    CalibrationFormat,
    Holds,
    camera_entry,
    opencv_coefficients,
    read_image_size,
    read_numbers,
    register_format,
)
from jaxpoint.io.exchange import read_calibration, read_lenses, write_calibration


def read(request):
    cameras = []
    for name, table in request.only.json()["my_cameras"].items():
        where = f"{request.where}, {name}: "
        k, size = read_numbers(where, table, "K", (3, 3)), read_image_size(where, table["size"])
        pose = read_numbers(where, table, "R", (3, 3)), read_numbers(where, table, "t", (3,))
        cameras.append(camera_entry(where, name, size, k, table["lens"], pose=pose))
    return request.saved(cameras)


def write(saved, path):
    cameras = {
        camera.name: {
            "size": camera.size,
            "K": camera.K,
            "lens": opencv_coefficients("my format", camera, 5),
            "R": camera.rotation,
            "t": camera.translation,
        }
        for camera in saved.entries()
    }
    return {"rig.mine": json.dumps({"my_cameras": cameras}).encode()}


MINE = CalibrationFormat(
    name="mine",
    title="my format",
    patterns=("*.mine",),
    recognise=lambda path, head: re.search(r'"my_cameras"\s*:', head) is not None,
    holds=Holds(lenses="Brown", unit="m"),
    read=read,
    write=write,
)


@pytest.fixture
def mine():
    register_format(MINE)
    yield MINE
    del FORMATS["mine"]


def test_all_commands_know_it(mine, tmp_path, capsys):
    rig = rig_of("brown5")
    assert write_calibration(rig, tmp_path / "room.mine") == ()
    np.testing.assert_allclose(pixels(read_calibration(tmp_path / "room.mine").rig), pixels(rig), rtol=0, atol=1e-9)
    assert read_lenses(tmp_path / "room.mine").names == rig.names
    assert main(["convert", str(tmp_path / "room.mine"), str(tmp_path / "calibration.json")]) == 0
    assert main(["convert", "--list"]) == 0
    assert "my format" in capsys.readouterr().out


def test_a_name_is_taken_once(mine):
    register_format(MINE)  # the same again
    with pytest.raises(ValueError, match="'mine' is known already"):
        register_format(CalibrationFormat("mine", "", (), lambda path, head: False, Holds("", "m")))
