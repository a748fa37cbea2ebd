"""`jaxpoint bias fit`, `apply` and `compare`, and the bias that comes with the package."""

import json
import re
from pathlib import Path

import crowds
import numpy as np
import pytest

from jaxpoint.cli import main
from jaxpoint.io.bias_files import read_bias
from jaxpoint.io.pointing_files import read_pointings, write_pointings
from jaxpoint.pointing.bias.score import errors_deg


@pytest.fixture
def table(tmp_path):
    write_pointings(tmp_path / "pointings.csv", crowds.crowd(people=4, gestures=15).of_lines(("head", "hand")))
    return tmp_path / "pointings.csv"


def test_fit_then_apply(tmp_path, table, capsys):
    bias, out = tmp_path / "bias.toml", tmp_path / "corrected.csv"
    assert main(["bias", "fit", str(table), "--out", str(bias)]) == 0
    assert "The head line points" in capsys.readouterr().out
    assert main(["bias", "apply", str(table), "--bias", str(bias), "--out", str(out)]) == 0
    found, before = read_pointings(out), read_pointings(table)
    assert found.lines == ("head",)
    assert np.median(errors_deg(found, found.directions[:, 0])) < 3
    assert np.median(errors_deg(before, before.directions[:, 0])) > 8
    assert main(["bias", "apply", str(table), "--bias", str(bias), "--out", str(out)]) == 2
    assert "--force" in capsys.readouterr().err


def test_a_bias_that_is_no_number_is_refused(tmp_path, table, capsys):
    bias, out = tmp_path / "bias.toml", tmp_path / "corrected.csv"
    text = (Path(__file__).parents[1] / "configs" / "forearm_bias.toml").read_text()
    for number in ("nan", "inf"):
        bias.write_text(re.sub(r"azimuth_deg = .*", f"azimuth_deg = {number}", text))
        assert main(["bias", "apply", str(table), "--bias", str(bias), "--out", str(out)]) == 7
        assert f"model.azimuth_deg is {number}, which is no finite number" in capsys.readouterr().err
    assert not out.exists()


def test_fit_of_one_person(tmp_path, table, capsys):
    bias, own, anna = (tmp_path / name for name in ("bias.toml", "anna.csv", "anna.toml"))
    everybody = read_pointings(table)
    write_pointings(own, everybody.select(np.arange(3)))
    assert main(["bias", "fit", str(own), "--out", str(bias)]) == 4
    assert "1 people do not show how people differ" in capsys.readouterr().err
    assert main(["bias", "fit", str(table), "--lines", "hand", "--out", str(bias)]) == 0
    assert main(["bias", "fit", str(own), "--shared", str(bias), "--out", str(anna), "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["gestures"] == 3
    assert read_bias(anna).lines == ("hand",)
    assert main(["bias", "fit", str(own), "--shared", str(bias), "--model", "blend", "--out", str(own)]) == 2
    assert "must name a file that ends in .toml" in capsys.readouterr().err


def test_compare(table, capsys):
    assert main(["bias", "compare", str(table), "--json"]) == 0
    models = json.loads(capsys.readouterr().out)["models"]
    assert list(models) == ["none", "constant-elevation", "constant", "polynomial", "blend"]
    assert models["constant"]["median_deg"] < models["constant-elevation"]["median_deg"] < models["none"]["median_deg"]
    assert models["none"]["low_deg"] < models["none"]["median_deg"] < models["none"]["high_deg"]
    assert main(["bias", "compare", str(table), "--lines", "finger"]) == 4
    assert "no line 'finger'" in capsys.readouterr().err
    assert main(["bias", "compare", str(table), "--out", "scores.csv"]) == 2
    assert "leave out --out" in capsys.readouterr().err


def test_the_forearm_of_the_package_is_the_studys():
    """The mean errors of the study's notes, drawn by its slips a little to the robust middle."""
    bias = read_bias(Path(__file__).parents[1] / "configs" / "forearm_bias.toml")
    assert bias.lines == ("forearm",)
    assert (bias.fitted.people, bias.fitted.gestures, bias.fitted.targets) == (7, 945, 27)
    np.testing.assert_allclose(np.rad2deg(bias.model.offset), [14.98, 15.52], atol=2.5)
