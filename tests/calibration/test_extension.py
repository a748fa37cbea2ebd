"""A calibrated room with one camera more, and with one that was moved."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxpoint.calibration.covariance import with_covariance
from jaxpoint.calibration.extension import extend_calibration
from jaxpoint.calibration.quality import assess
from jaxpoint.calibration.selfcal import calibrate
from jaxpoint.camera.brown import Brown
from jaxpoint.camera.kannala_brandt import KannalaBrandt
from jaxpoint.camera.mixed import embedded, mixed_lens
from jaxpoint.camera.rig import CameraRig
from jaxpoint.cli import main
from jaxpoint.config import CalibrateSettings, OutlierSettings, RoomConfig
from jaxpoint.errors import InsufficientDataError, UsageError
from jaxpoint.io.exchange import read_calibration
from jaxpoint.io.track_files import save_tracks
from jaxpoint.runs import write_run
from jaxpoint.simulate.rooms import random_room

NEW = 3


@pytest.fixture(scope="module")
def room():
    return random_room(5, cameras=5, frames=300, outliers=0.05)


@pytest.fixture(scope="module")
def known(room):
    """The room without its fourth camera."""
    return with_covariance(calibrate(room.tracks.select_cameras([0, 1, 2, 4])))


@pytest.fixture(scope="module")
def whole(room):
    return with_covariance(calibrate(room.tracks))


def sigmas(calibration):
    return np.sqrt(np.diag(calibration.camera_covariance)).reshape(len(calibration.rig), -1)


def distances(calibration):
    """From the new camera to the others, in units of that between the first two."""
    centres = np.asarray(calibration.rig.positions)
    return np.linalg.norm(centres - centres[NEW], axis=1) / np.linalg.norm(centres[0] - centres[1])


def test_a_camera_more_is_where_the_whole_calibration_has_it(room, known, whole):
    end = extend_calibration(room.tracks, known)
    assert end.converged
    assert assess(end).level == "good"
    np.testing.assert_array_equal(end.rig.positions[:3], known.rig.positions[:3])
    ours, theirs = end.rig[NEW].lens, whole.rig[NEW].lens
    assert abs(float(ours.focal[0] - theirs.focal[0])) < 2 * sigmas(whole)[NEW, 6]
    np.testing.assert_allclose(distances(end), distances(whole), atol=0.02)
    np.testing.assert_allclose(ours.focal, room.focal[NEW], atol=3 * sigmas(end)[NEW, 6])
    assert (end.kept[:, NEW] & room.is_outlier[:, NEW]).sum() <= 3
    assert (sigmas(end)[NEW] > sigmas(whole)[NEW])[[6, 8, 9]].all()  # the others lend it their errors


def test_a_moved_camera_is_found_again_and_the_others_stay(room, known, whole):
    away = Rotation.from_rotvec([0.1, -0.3, 0.05]).as_matrix()
    pose = known.rig.cameras.cam_from_world
    turned = pose.rotation.at[1].set(away @ pose.rotation[1])
    shifted = pose.translation.at[1].set(pose.translation[1] + jnp.array([0.3, -0.2, 0.5]))
    spots = lambda rig: (rig.cameras.cam_from_world.rotation, rig.cameras.cam_from_world.translation)  # noqa: E731
    stale = replace(known, rig=eqx.tree_at(spots, known.rig, (turned, shifted)))
    tracks = room.tracks.select_cameras([0, 1, 2, 4])
    end = extend_calibration(tracks, stale, moved=("cam_1",))
    assert assess(end).level == "good"
    spread = sigmas(known)[1, 3:6].max()
    np.testing.assert_allclose(end.rig.positions[1], known.rig.positions[1], atol=3 * spread)
    np.testing.assert_array_equal(end.rig.cameras.focal, known.rig.cameras.focal)
    others = [0, 2, 3]
    np.testing.assert_array_equal(end.rig.positions[jnp.array(others)], known.rig.positions[jnp.array(others)])
    # Not named, it is found out.
    wrong = extend_calibration(room.tracks, stale)
    assert [(item.cause, item.cameras) for item in wrong.findings] == [("moved camera", ("cam_1",))]
    assert "--recalibrate cam_1" in str(assess(wrong).failure)


def test_errors_of_the_others_are_handed_on():
    """Against solving again beside cameras a little shifted, turned, and of other lenses: finite differences."""
    room = random_room(5, cameras=5, frames=300, outliers=0.0, noise_px=0.1)
    settings = CalibrateSettings(outliers=OutlierSettings(loss="none"))
    known = with_covariance(calibrate(room.tracks.select_cameras([0, 1, 2, 4]), settings))
    size, step = known.rig.camera_size, 1e-5
    units = np.array([*[1.0] * 6, *[300.0] * 4, *[1.0] * (size - 10)])  # like steps of radians, lengths and pixels
    change = step * np.random.default_rng(0).normal(size=(4, size)) * units * (np.arange(size) < 12)
    cameras = jax.vmap(lambda camera, by: camera.perturbed(by))(known.rig.cameras, jnp.asarray(change))
    moved = CameraRig(cameras, known.rig.image_sizes, known.rig.names)
    covariance = np.outer(change.ravel(), change.ravel())  # of one direction of errors, of this size
    before, alone, along, after = (
        extend_calibration(room.tracks, replace(known, **parts), settings)
        for parts in ({}, {"camera_covariance": 0 * covariance}, {"camera_covariance": covariance}, {"rig": moved})
    )
    handed = np.diag(along.camera_covariance - alone.camera_covariance).reshape(5, -1)[NEW]

    def numbers(calibration):
        camera = calibration.rig[NEW]
        return np.concatenate([camera.cam_from_world.translation, camera.lens.focal])

    found = np.abs(numbers(after) - numbers(before))
    np.testing.assert_allclose(np.sqrt(handed)[3:8], found, rtol=0.05, atol=0.02 * step)


def test_the_published_recording_gets_its_last_camera_back(data_folder):
    from jaxpoint.io.track_files import read_tracks

    tracks = read_tracks(data_folder / "svoboda_arctic4", one_based=True)
    whole = with_covariance(calibrate(tracks))
    known = with_covariance(calibrate(tracks.select_cameras([0, 1, 2])))
    end = extend_calibration(tracks, known)
    assert assess(end).level == "good"
    ratio = float(end.rig.cameras.focal[3, 0] / whole.rig.cameras.focal[3, 0])
    spread = np.hypot(sigmas(end)[3, 6], sigmas(whole)[3, 6]) / float(whole.rig.cameras.focal[3, 0])
    assert abs(ratio - 1) < 3 * spread
    assert end.kept.sum() >= 0.98 * whole.kept.sum()


def test_what_cannot_be_extended_is_refused(room, known):
    four = room.tracks.select_cameras([0, 1, 2, 4])
    with pytest.raises(UsageError, match=r"no camera 'cam_9' to be found again; it has cam_0, cam_1, cam_2, cam_4"):
        extend_calibration(four, known, moved=("cam_9",))
    with pytest.raises(UsageError, match="has all cameras of these tracks already; name the moved ones"):
        extend_calibration(four, known)
    with pytest.raises(InsufficientDataError, match="1 of the tracks' cameras stay as they were"):
        extend_calibration(room.tracks.select_cameras([0, 3]), known)
    few = room.tracks.select_frames(np.arange(15))
    with pytest.raises(InsufficientDataError, match=r"agree on the light in \d+ of the \d+ frames"):
        extend_calibration(few, known)
    visible = room.tracks.visible.copy()
    visible[np.flatnonzero(visible[:, NEW])[10:], NEW] = False
    with pytest.raises(InsufficientDataError, match=r"Camera 'cam_3' sees the light in \d+ frames .* it takes 20"):
        extend_calibration(replace(room.tracks, visible=visible), known)


def test_a_room_that_did_not_pass_is_not_called_good_by_extending_it(room, known, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("jaxpoint.runs.write_report", lambda path, *_, **__: path.write_text("page"))
    write_run(tmp_path / "room", replace(known, converged=False, message="stopped early"), RoomConfig(), command="test")
    save_tracks(tmp_path / "tracks.npz", room.tracks)
    out = tmp_path / "more"
    given = ["calibrate", str(tmp_path / "tracks.npz"), "--extend", str(tmp_path / "room"), "--out", str(out)]
    assert main(given) == 5
    assert "The room that was extended did not pass: The adjustment did not converge" in capsys.readouterr().err
    assert out.is_dir()


def test_the_command_line(room, known, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("jaxpoint.runs.write_report", lambda path, *_, **__: path.write_text("page"))
    write_run(tmp_path / "room", known, RoomConfig(), command="test")
    save_tracks(tmp_path / "tracks.npz", room.tracks)
    given = ["calibrate", str(tmp_path / "tracks.npz"), "--extend", str(tmp_path / "room")]
    assert main([*given, "--recalibrate", "cam_2", "--out", str(tmp_path / "again")]) == 0
    saved = read_calibration(tmp_path / "again")
    assert saved.rig.names == room.tracks.names
    assert saved.covariance is not None
    np.testing.assert_allclose(saved.rig.positions[0], known.rig.positions[0], atol=1e-12)
    capsys.readouterr()
    for arguments, code, said in (
        (["calibrate", given[1], "--recalibrate", "cam_2"], 2, "give its run by --extend RUN"),
        ([*given, "--time-offsets"], 2, "leave out --time-offsets"),
        (["align", str(tmp_path / "again"), "--floor", "1", "2", "3", "--length-m", "1"], 2, "extends another"),
    ):
        assert main([*arguments, "--out", str(tmp_path / "never")]) == code
        assert said in capsys.readouterr().err
    assert not (tmp_path / "never").exists()


def test_a_new_camera_among_lenses_of_several_models_is_refused(room, known):
    models = (*[Brown] * 3, KannalaBrandt)
    kind, own = mixed_lens(models), np.asarray(known.rig.cameras.distortion)
    mixed = np.stack([embedded(kind, m, values[: len(m.coefficients)]) for m, values in zip(models, own)])
    lens = kind.of(known.rig.cameras.focal, known.rig.cameras.center, mixed)
    rig = replace(known.rig, cameras=replace(known.rig.cameras, lens=lens))
    with pytest.raises(UsageError, match=r"several models \(brown, kannala_brandt\), .* --lens.distortion cam_3=MODEL"):
        extend_calibration(room.tracks, replace(known, rig=rig))
