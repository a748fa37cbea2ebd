"""`jaxpoint convert`: what it writes, says and refuses."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_exchange import POINTS, in_first_camera, pixels, rig_of

from jaxpoint.cli import main
from jaxpoint.io.exchange import read_calibration, write_calibration
from jaxpoint.io.formats.format_registry import FORMATS
from jaxpoint.io.rig_entries import UNSTATED, SavedCalibration


def test_convert_says_what_is_lost(tmp_path, capsys):
    source, rig = tmp_path / "calibration.json", rig_of("brown4")
    write_calibration(SavedCalibration(rig, covariance=np.eye(45)), source)
    assert main(["convert", str(source), str(tmp_path / "chain.yaml"), "--to", "kalibr", "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["format"] == "kalibr"
    assert any("covariance" in note for note in figures["notes"])
    assert main(["convert", str(tmp_path / "chain.yaml"), str(tmp_path / "out"), "--to", "easymocap"]) == 0
    said = capsys.readouterr().out
    assert "EasyMocap's intri.yml and extri.yml of 3 cameras (brown lens)" in said
    assert main(["convert", str(tmp_path / "out"), str(tmp_path / "back.toml"), "--to", "anipose"]) == 0
    back = read_calibration(tmp_path / "back.toml").rig
    np.testing.assert_allclose(pixels(back, in_first_camera(rig, POINTS)), pixels(rig), rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["IN"], "Say what to read and what to write"),
        (["IN", "OUT", "--size", "big"], "--size 'big' is no size of images"),
        (["IN", "OUT", "--unit", "mm"], r"says its unit \('m'\); leave out --unit mm"),
        (["IN", "IN", "--force"], "is read and would be replaced"),
        (["IN", "OLD.toml", "--to", "anipose"], "exists; choose another output, or replace it by --force"),
        (["IN", "no/where.toml", "--to", "anipose"], "There is no folder"),
    ],
)
def test_convert_refuses(tmp_path, capsys, arguments, message):
    write_calibration(rig_of("none"), tmp_path / "calibration.json")
    (tmp_path / "OLD.toml").write_text("")
    places = {"IN": tmp_path / "calibration.json", "OUT": tmp_path / "rig.qca.txt"}
    given = [str(places.get(a, tmp_path / a if a.endswith(".toml") else a)) for a in arguments]
    assert main(["convert", *given]) == 2
    assert re.search(message, capsys.readouterr().err)


def test_convert_lists_all_formats(capsys):
    assert main(["convert", "--list", "--json"]) == 0
    assert [fmt["name"] for fmt in json.loads(capsys.readouterr().out)["formats"]] == list(FORMATS)


def test_units_are_given_where_a_file_does_not_say_them(tmp_path):
    rig = rig_of("none")
    write_calibration(replace(SavedCalibration(rig), unit=UNSTATED), tmp_path / "in.toml", "anipose")
    arguments = [str(tmp_path / "in.toml"), str(tmp_path / "calibration.json"), "--unit", "mm"]
    assert main(["convert", *arguments]) == 0
    saved = read_calibration(tmp_path / "calibration.json")
    assert saved.unit == "m"
    np.testing.assert_allclose(saved.rig.positions, np.asarray(rig.positions) / 1000)


def test_the_page_has_a_row_for_each_format():
    """Name, reads and writes of each, in the order of `jaxpoint convert --list`."""
    page = (Path(__file__).parents[2] / "docs/reference/exchange.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([\w-]+)` \| [^|]+ \| (yes|no) \| (yes|no) \|", page, re.MULTILINE)
    known = [(f.name, "no" if f.read is None else "yes", "no" if f.write is None else "yes") for f in FORMATS.values()]
    assert rows == known
