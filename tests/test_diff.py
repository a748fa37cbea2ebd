"""`jaxpoint diff`: what it prints and writes, and what it refuses."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jaxpoint.calibration.covariance import with_covariance
from jaxpoint.calibration.recording import Freedom, Recording
from jaxpoint.camera.rig import CameraRig
from jaxpoint.cli import main
from jaxpoint.config import LensSettings, RoomConfig
from jaxpoint.io.calibration import write_calibration_json
from jaxpoint.runs import write_run

MOVED = 1  # the camera that is moved
SHIFT_M = 0.05


@pytest.fixture(scope="module")
def runs(tmp_path_factory, solved_room):
    """Two runs of one room, between which one camera was moved."""
    truth = solved_room[1]
    count = truth.tracks.cameras
    parts = Freedom.of(Recording.of(truth.tracks), LensSettings(), "radial2")
    freedom = Freedom(parts.free[:count], parts.prior_mean[:count], parts.prior_weight[:count])
    first = with_covariance(replace(truth, freedom=freedom, unit="m"))
    shift = jnp.zeros((count, 3)).at[MOVED, 0].set(SHIFT_M)
    rig = eqx.tree_at(lambda rig: rig.cameras.cam_from_world.translation, first.rig, replace_fn=lambda t: t + shift)
    folder = tmp_path_factory.mktemp("diff")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("jaxpoint.runs.write_report", lambda path, *_, **__: Path(path).write_text("page"))
        for name, calibration in (("first", first), ("second", replace(first, rig=rig))):
            write_run(folder / name, calibration, RoomConfig(), command="test")
    return folder, first, rig


def run(*arguments, capsys):
    code = main(["diff", *(str(argument) for argument in arguments)])
    return code, *capsys.readouterr()


def test_a_moved_camera_is_found_and_shown(runs, tmp_path, capsys):
    folder, first, _ = runs
    code, out, err = run(folder / "first", folder / "second", "--out", tmp_path / "page", capsys=capsys)
    name = first.rig.names[MOVED]
    assert (code, err.count("\n")) == (5, 1)
    assert f"what their uncertainties allow, most of all in {name}" in err
    assert f"{name} stands out" in out
    assert next(line for line in out.splitlines() if line.startswith(name)).endswith("*")
    assert out.splitlines()[-1] == f"Report: {tmp_path / 'page' / 'report.html'}"
    page = (tmp_path / "page" / "report.html").read_text(encoding="utf-8")
    assert "These calibrations are not consistent" in page
    assert page.count('<svg class="figure"') == 2
    figures = json.loads((tmp_path / "page" / "diff.json").read_text())
    assert (figures["consistent"], figures["culprits"]) == (False, [name])
    apart = {camera["name"]: camera["centre"] for camera in figures["cameras"]}
    assert apart[name] == pytest.approx(1e3 * SHIFT_M, rel=0.1)
    assert max(value for other, value in apart.items() if other != name) < 5
    code, out, _ = run(folder / "first", folder / "second", "--json", capsys=capsys)
    assert json.loads(out) == figures


def test_the_same_run_is_consistent_with_itself(runs, capsys):
    code, out, _ = run(runs[0] / "first", runs[0] / "first", "--json", capsys=capsys)
    figures = json.loads(out)
    assert (code, figures["consistent"], figures["culprits"]) == (0, True, [])
    assert figures["points_rms"] < 1e-5


def test_a_run_that_was_marked_is_said_to_be(runs, tmp_path, capsys):
    shutil.copytree(runs[0] / "second", tmp_path / "marked")
    metrics = tmp_path / "marked" / "metrics.json"
    metrics.write_text(json.dumps(json.loads(metrics.read_text()) | {"failure": "it did not settle"}))
    _, out, _ = run(runs[0] / "first", tmp_path / "marked", capsys=capsys)
    assert f"'{tmp_path / 'marked'}' was marked when it was made: it did not settle" in out
    assert f"'{runs[0] / 'first'}' was marked" not in out


def test_files_without_covariance_still_differ(runs, tmp_path, capsys):
    folder, first, rig = runs
    turned = [2, 0, 1]  # another order, one camera fewer
    write_calibration_json(tmp_path / "other.json", rig.select(turned), unit="m")
    code, out, _ = run(folder / "first" / "calibration.json", tmp_path / "other.json", "--json", capsys=capsys)
    figures = json.loads(out)
    assert (code, figures["consistent"], len(figures["cameras"])) == (0, None, 3)
    apart = {camera["name"]: camera["centre"] for camera in figures["cameras"]}
    assert apart[first.rig.names[MOVED]] == pytest.approx(1e3 * SHIFT_M, rel=0.1)
    notes = " ".join(figures["notes"])
    assert f"only '{folder / 'first' / 'calibration.json'}' has them: {first.rig.names[3]}" in notes
    assert "is no run" in notes
    assert "other.json' holds no covariance" in notes


def test_as_they_stand_both_need_metres_and_a_known_frame(runs, tmp_path, capsys):
    folder, _, rig = runs
    code, _, err = run(folder / "first", folder / "second", "--no-align", capsys=capsys)
    assert (code, "is not in the frame of the room; align it first" in err) == (2, True)
    in_room = [tmp_path / "first.json", tmp_path / "second.json"]
    for path in in_room:
        saved = json.loads((folder / path.stem / "calibration.json").read_text())
        assert saved.pop("in_room") is False
        path.write_text(json.dumps(saved))
    code, out, _ = run(*in_room, "--no-align", "--json", capsys=capsys)
    figures = json.loads(out)
    assert (code, figures["consistent"]) == (0, None)
    assert "does not say how well its frame is known" in " ".join(figures["notes"])
    still = [camera["centre"] for c, camera in enumerate(figures["cameras"]) if c != MOVED]
    np.testing.assert_allclose(still, 0.0, atol=1e-6)
    write_calibration_json(tmp_path / "solver.json", rig, unit="arbitrary")
    code, _, err = run(in_room[0], tmp_path / "solver.json", "--no-align", capsys=capsys)
    assert (code, "is not in metres; align it first" in err) == (2, True)


def test_what_cannot_be_compared_is_refused(runs, tmp_path, capsys):
    folder, _, rig = runs
    strangers = CameraRig(rig.cameras, rig.image_sizes, tuple("wxyz"))
    write_calibration_json(tmp_path / "strangers.json", strangers)
    code, out, err = run(folder / "first", tmp_path / "strangers.json", "--out", tmp_path / "page", capsys=capsys)
    assert (code, out, "have no camera in common" in err) == (2, "", True)
    write_calibration_json(tmp_path / "large.json", CameraRig(rig.cameras, 2 * rig.image_sizes, rig.names))
    code, _, err = run(folder / "first", tmp_path / "large.json", capsys=capsys)
    assert (code, "has images of" in err) == (2, True)
    write_calibration_json(tmp_path / "one.json", rig.select([0]))
    code, _, err = run(folder / "first", tmp_path / "one.json", capsys=capsys)
    assert (code, "1 camera in common" in err) == (4, True)
    code, _, err = run(folder / "first", tmp_path / "nothing.json", capsys=capsys)
    assert code == 7
    assert not (tmp_path / "page").exists()


def test_a_run_without_covariance_says_why_and_nothing_is_judged(runs, tmp_path, capsys):
    folder, first, _ = runs
    bare = replace(first, camera_covariance=None, gauge=None, undetermined="The light hardly moved.")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("jaxpoint.runs.write_report", lambda path, *_, **__: Path(path).write_text("page"))
        write_run(tmp_path / "bare", bare, RoomConfig(), command="test")
    code, out, err = run(folder / "second", tmp_path / "bare", capsys=capsys)
    assert (code, err) == (0, "")
    assert f"'{tmp_path / 'bare'}' holds no covariance, because of this: The light hardly moved." in out
