"""Run directories: whole or not at all, nothing lost, and read back as they were."""

import json
import math
import shutil
from dataclasses import replace

import equinox as eqx
import jax
import numpy as np
import pytest

from jaxpoint.calibration.alignment import align_to_camera_centres, apply_alignment
from jaxpoint.calibration.covariance import with_covariance
from jaxpoint.calibration.quality import assess
from jaxpoint.calibration.recording import Freedom, Recording
from jaxpoint.calibration.result import Verdict
from jaxpoint.calibration.uncertainty import uncertainty_of
from jaxpoint.config import CalibrateSettings, LensSettings, RoomConfig
from jaxpoint.errors import FileFormatError, NotConvergedError, QualityError, UsageError
from jaxpoint.metrics import metrics
from jaxpoint.runs import Interrupted, new_run, provenance, read_run, write_run


def contents(folder):
    return sorted(path.name for path in folder.iterdir())


def make_run(out, text, **options):
    with new_run(out, **options) as folder:
        (folder / "provenance.json").write_text(text)


def fail_in_run(out, error, **options):
    with new_run(out, **options) as folder:
        (folder / "a").write_text("a")
        raise error


def test_a_run_appears_only_when_it_is_whole(tmp_path):
    out = tmp_path / "deep" / "run"
    with new_run(out) as folder:
        (folder / "a").write_text("a")
        assert not out.exists()
    assert contents(out) == ["a"]
    assert contents(out.parent) == ["run"]


def test_a_failure_leaves_nothing_and_an_empty_folder_is_taken(tmp_path):
    out = tmp_path / "run"
    out.mkdir()
    with pytest.raises(RuntimeError, match="half way"):
        fail_in_run(out, RuntimeError("half way"))
    assert contents(tmp_path) == ["run"]
    assert contents(out) == []
    make_run(out, "whole")
    assert contents(out) == ["provenance.json"]


def test_interruption_keeps_what_was_finished_and_the_run_before(tmp_path):
    out = tmp_path / "run"
    make_run(out, "first")
    for attempt in ("run.unfinished", "run.unfinished-2"):
        with pytest.raises(Interrupted, match=f"{attempt}$"):
            fail_in_run(out, KeyboardInterrupt(), force=True)
        assert (tmp_path / attempt / "a").read_text() == "a"
    assert (out / "provenance.json").read_text() == "first"
    with pytest.raises(KeyboardInterrupt) as caught, new_run(tmp_path / "other"):
        raise KeyboardInterrupt
    assert not isinstance(caught.value, Interrupted)
    assert contents(tmp_path) == ["run", "run.unfinished", "run.unfinished-2"]


def test_only_a_run_is_replaced_and_only_by_force(tmp_path):
    out = tmp_path / "run"
    make_run(out, "first")
    with pytest.raises(UsageError, match="not empty"):
        make_run(out, "second")
    make_run(out, "second", force=True)
    assert (out / "provenance.json").read_text() == "second"
    precious = tmp_path / "home"
    precious.mkdir()
    (precious / "letter.txt").write_text("dear")
    with pytest.raises(UsageError, match="holds no run of jaxpoint"):
        make_run(precious, "x", force=True)
    with pytest.raises(UsageError, match="is a file"):
        make_run(precious / "letter.txt", "x", force=True)
    assert contents(tmp_path) == ["home", "run"]


def test_provenance_hashes_every_input_file(tmp_path):
    (tmp_path / "points.dat").write_bytes(b"abc")
    (tmp_path / "picture.jpg").write_bytes(b"left out")
    made = provenance("jaxpoint calibrate", [tmp_path, tmp_path / "points.dat"], seed=4)
    # FIPS 180-2, the digest of "abc"
    digest = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert made["inputs"] == {str(tmp_path / "points.dat"): digest}
    assert made["seed"] == 4
    assert made["versions"]["jax"] == jax.__version__


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory, solved_room):
    """An aligned run, and the calibration and settings that it was written from."""
    known, calibration = solved_room
    aligned = apply_alignment(calibration, align_to_camera_centres(calibration.rig.positions, known.room.positions + 1))
    config = RoomConfig(calibrate=CalibrateSettings(seed=5))
    out = tmp_path_factory.mktemp("runs") / "run"
    figures = write_run(out, aligned, config, command="test", detect_seconds=1.0)
    return out, aligned, config, figures


def test_a_run_is_read_back_as_it_was(run_folder):
    out, aligned, config, figures = run_folder
    assert contents(out) == [
        "calibration.json", "calibration.toml", "config.toml", "metrics.json", "provenance.json", "report.html",
        "result.npz", "tracks.npz",
    ]  # fmt: skip
    run = read_run(out)
    assert run.config == config
    assert run.metrics == json.loads(json.dumps(figures))
    assert eqx.tree_equal(run.calibration.rig, aligned.rig, rtol=1e-12, atol=1e-12)
    assert eqx.tree_equal(run.calibration.tracks, aligned.tracks)
    for name in ("points", "point_valid", "residuals", "verdicts"):
        np.testing.assert_array_equal(getattr(run.calibration, name), getattr(aligned, name))
    assert run.calibration.unit == "m"
    assert run.calibration.stages == aligned.stages
    np.testing.assert_array_equal(run.calibration.pairs.shared, aligned.pairs.shared)
    found, wanted = run.calibration.alignment, aligned.alignment
    assert eqx.tree_equal(found.similarity, wanted.similarity, rtol=1e-12, atol=1e-12)
    assert found.leave_one_out_mm == wanted.leave_one_out_mm


def test_what_was_free_is_kept_so_that_the_uncertainty_can_be_asked_later(tmp_path, solved_room):
    calibration = solved_room[1]
    cameras = calibration.tracks.cameras
    parts = Freedom.of(Recording.of(calibration.tracks), LensSettings(), "radial2")
    freedom = Freedom(parts.free[:cameras], parts.prior_mean[:cameras], parts.prior_weight[:cameras])
    stated = with_covariance(replace(calibration, freedom=freedom, loss_scale=0.6))
    write_run(tmp_path / "run", stated, RoomConfig(), command="test")
    again = read_run(tmp_path / "run").calibration
    assert (again.loss_scale, again.gauge) == (0.6, "free")
    np.testing.assert_allclose(again.camera_covariance, stated.camera_covariance)
    asked = uncertainty_of(again)
    np.testing.assert_allclose(asked.covariance, stated.camera_covariance, rtol=1e-6, atol=1e-12)


def test_a_run_of_earlier_days_is_read_and_says_what_it_lacks(tmp_path, run_folder):
    out = tmp_path / "run"
    shutil.copytree(run_folder[0], out)
    with np.load(out / "result.npz") as stored:
        arrays = dict(stored)
    about = json.loads(str(arrays.pop("about")))
    for key in ("loss_scale", "undetermined"):
        del about[key]
    np.savez(out / "result.npz", about=np.array(json.dumps(about)), **arrays)
    found = read_run(out).calibration
    assert (found.freedom, found.loss_scale) == (None, None)
    with pytest.raises(UsageError, match="calibrate again"):
        uncertainty_of(found)


def test_a_damaged_run_is_named(tmp_path, run_folder):
    out = tmp_path / "run"
    shutil.copytree(run_folder[0], out)
    (out / "result.npz").write_bytes((out / "result.npz").read_bytes()[:300])
    with pytest.raises(FileFormatError, match=r"result\.npz is damaged"):
        read_run(out)
    with pytest.raises(FileFormatError, match=r"has no metrics\.json"):
        read_run(tmp_path)


def test_metrics_are_those_of_the_kept_and_of_all(solved_room):
    room, calibration = solved_room[0].room, solved_room[1]
    figures = metrics(calibration, detect_seconds=3.0)
    errors = {"kept": [], "all": []}
    for frame, camera in np.argwhere(calibration.tracks.visible):
        if not calibration.point_valid[frame]:
            continue
        x, y = calibration.residuals[frame, camera]
        errors["all"].append(math.hypot(x, y))
        if not room.is_outlier[frame, camera]:
            errors["kept"].append(math.hypot(x, y))
    few = int((calibration.tracks.visible & ~calibration.point_valid[:, None]).sum())
    reprojection = figures["reprojection"]
    assert reprojection["mean_all_px"] == pytest.approx(np.mean(errors["all"]))
    assert figures["observations"]["total"] == len(errors["all"]) + few
    assert figures["observations"]["used"] == len(errors["kept"])
    assert reprojection["mean_px"] == pytest.approx(np.mean(errors["kept"]))
    assert reprojection["std_px"] == pytest.approx(np.std(errors["kept"]))
    assert reprojection["rms_px"] == pytest.approx(np.sqrt(np.mean(np.square(errors["kept"]))))
    assert figures["seconds"] == {"detect": 3.0, "init": 0.5, "adjust": 1.5, "total": 5.0}
    assert figures["cameras"][1]["focal_px"] == pytest.approx([room.focal[1]] * 2)
    assert figures["cameras"][1]["distortion"] == pytest.approx(room.distortion[1])


def test_metrics_stay_json_where_a_camera_lost_everything(solved_room):
    calibration = solved_room[1]
    verdicts = calibration.verdicts.copy()
    verdicts[:, 2] = Verdict.HIDDEN
    figures = metrics(replace(calibration, verdicts=verdicts))
    json.dumps(figures, allow_nan=False)
    assert figures["reprojection"]["per_camera_mean_px"][2] is None
    empty = metrics(replace(calibration, verdicts=np.full_like(verdicts, Verdict.HIDDEN), sigma_px=float("nan")))
    json.dumps(empty, allow_nan=False)
    assert empty["reprojection"]["mean_px"] is None


def test_the_gate_names_what_failed(solved_room):
    calibration = solved_room[1]
    assert assess(calibration).failure is None
    assert isinstance(assess(replace(calibration, converged=False)).failure, NotConvergedError)
    error = assess(calibration, CalibrateSettings(max_mean_px=0.1)).failure
    assert isinstance(error, QualityError)
    assert "above the 0.1 px allowed" in str(error)
    assert "Only 9" in str(assess(calibration, CalibrateSettings(min_kept=0.999)).failure)


def test_frames_that_one_camera_saw_fail_no_gate(solved_room):
    calibration = solved_room[1]
    alone = np.zeros_like(calibration.verdicts, dtype=bool)
    alone[::2, 0] = calibration.tracks.visible[::2, 0]
    verdicts = np.where(alone, Verdict.FEW_VIEWS, calibration.verdicts)
    verdicts[::2, 1:] = Verdict.HIDDEN
    visible = verdicts != Verdict.HIDDEN
    sparse = replace(
        calibration, verdicts=verdicts, tracks=eqx.tree_at(lambda t: t.visible, calibration.tracks, visible)
    )
    assert sparse.kept.sum() < 0.8 * visible.sum()
    assert assess(sparse, CalibrateSettings(min_kept=0.9)).passed
