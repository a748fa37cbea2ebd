"""The experiment that refits a recording: its file of cases, and its table."""

import csv
from pathlib import Path

import pytest

import refit_calibration as refit
from jaxpoint.config import load_settings
from jaxpoint.errors import UsageError
from jaxpoint.io.track_files import save_tracks

ROOT = Path(__file__).parents[2]


def test_the_cases_that_are_shipped_can_be_read():
    cases = load_settings(ROOT / "configs" / "refit.toml", refit.Cases).case
    assert len({case.name for case in cases}) == len(cases) > 5
    assert any(case.drop for case in cases)
    assert {case.calibrate.lens.distortion for case in cases} >= {"none", "radial1", "radial2", "brown"}


def test_a_wrong_key_of_a_case_is_named_by_its_path(tmp_path):
    (tmp_path / "cases.toml").write_text('[[case]]\nname = "a"\n[[case]]\nname = "b"\nremove = ["x"]\n')
    with pytest.raises(UsageError, match=r"unknown key 'case\[1\].remove'"):
        load_settings(tmp_path / "cases.toml", refit.Cases)


def test_a_row_for_every_case_also_where_it_fails(tmp_path, solved_room, monkeypatch, capsys):
    calibration = solved_room[1]
    monkeypatch.setattr(refit, "calibrate", lambda tracks, settings: calibration)
    cases = tmp_path / "cases.toml"
    cases.write_text('[[case]]\nname = "all"\n[[case]]\nname = "none such"\ndrop = ["door"]\n')
    save_tracks(tmp_path / "tracks.npz", calibration.tracks)
    refit.main(refit.Refit(tmp_path / "tracks.npz", cases, tmp_path / "table"))
    rows = list(csv.DictReader((tmp_path / "table.csv").read_text().splitlines()))
    assert [row["case"] for row in rows] == ["all", "none such"]
    assert int(rows[0]["used"]) == int(calibration.kept.sum())
    # 0.3 px of noise in each coordinate of four cameras: errors are a little larger than a Rayleigh median of 0.353.
    assert 0.3 < float(rows[0]["held_out_px"]) < 0.8
    assert "'door'" in rows[1]["remark"]
    assert capsys.readouterr().out == (tmp_path / "table.md").read_text()
