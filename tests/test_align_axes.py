"""Axes and units of known points: the case files and rooms of other kinds; what is right is not refused."""

import re
from pathlib import Path

import jax
import numpy as np
import pytest

from jaxpoint.calibration.pairs import pair_table
from jaxpoint.calibration.result import Calibration, Verdict
from jaxpoint.calibration.upright import CameraAxes, check_size, check_upright
from jaxpoint.commands.align import align
from jaxpoint.config import AlignSettings
from jaxpoint.errors import InsufficientDataError, UsageError
from jaxpoint.geometry.pose import Similarity
from jaxpoint.geometry.world_axes import world_of
from jaxpoint.io.exchange import read_calibration
from jaxpoint.io.survey_files import read_landmarks
from jaxpoint.io.track_files import read_tracks
from jaxpoint.triangulation import triangulate

TURNED = {
    "z points down": lambda x, y, z: (x, -y, -z),
    "y points up": lambda x, y, z: (x, z, -y),
    "y points down": lambda x, y, z: (x, -z, y),
    "x points up": lambda x, y, z: (z, y, -x),
    "x points down": lambda x, y, z: (-z, y, x),
}


@pytest.fixture(scope="module")
def solved(data_folder) -> Calibration:
    """The cameras of the case, in a frame of their own, as a calibration of its tracks."""
    cases = data_folder.parent / "cases"
    tracks = read_tracks(cases / "15-axes/tracks.csv")
    tracks = tracks.select_frames(np.arange(64))
    rig = read_calibration(cases / "17-known-lenses/full.json").rig
    frame = Similarity(0.3, np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0], np.array([1.0, -2.0, 3.0]))
    frame = replace_rotation(frame)
    with jax.enable_x64(True):
        rig = rig.transformed(frame)
        found = triangulate(rig, tracks.pixels, tracks.visible)
    valid = np.asarray(found.valid)
    verdicts = np.where(tracks.visible & valid[:, None], Verdict.KEPT, Verdict.HIDDEN)
    return Calibration(
        rig=rig,
        tracks=tracks,
        points=np.asarray(found.points),
        point_valid=valid,
        residuals=np.asarray(found.residuals),
        verdicts=verdicts,
        sigma_px=0.3,
        converged=True,
        message="known",
        pairs=pair_table(tracks),
        stages=(),
        seconds={},
        unit="arbitrary",
    )


def replace_rotation(frame: Similarity) -> Similarity:
    rotation = np.asarray(frame.rotation)
    return Similarity(frame.scale, rotation * np.sign(np.linalg.det(rotation)), frame.translation)


def by(solved: Calibration, landmarks: Path, **more) -> Calibration:
    clicks = landmarks.parent / "clicks.csv"
    return align(solved, AlignSettings(landmarks=landmarks, landmark_pixels=clicks, **more))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "zdown",
            r"5 of 5 cameras come out below the floor .*z points down: .*\(x, y, z\) -> \(x, -y, -z\), in the file",
        ),
        ("yup", r"upright along the room's y axis, not along z\. y points up .*\(x, y, z\) -> \(x, -z, y\)"),
        ("mm", r"are \d{4} m wide; in mm these would be \d\.?\d* m: name the columns x_mm,y_mm,z_mm"),
        ("cm", r"are \d{3} m wide; in cm these would be \d\.?\d* m: name the columns x_cm,y_cm,z_cm"),
    ],
)
def test_the_case_files(data_folder, solved, name, message):
    with pytest.raises(InsufficientDataError, match=message):
        by(solved, data_folder.parent / f"cases/15-axes/{name}.csv")


def test_the_right_file_and_its_units(data_folder, solved, tmp_path):
    folder = data_folder.parent / "cases/15-axes"
    right = by(solved, folder / "m.csv")
    assert right.alignment is not None
    assert right.alignment.rms_mm < 20
    assert not any("lower than" in text or "wide" in text for text in right.alignment.warnings)
    (tmp_path / "clicks.csv").write_text((folder / "clicks.csv").read_text())
    for unit in ("mm", "cm"):
        for header in (f"name,x_{unit},y_{unit},z_{unit}", f"Name,x [{unit}],Y [{unit}],z ({unit})"):
            lines = (folder / f"{unit}.csv").read_text().splitlines()[1:]
            (tmp_path / "named.csv").write_text("\n".join([header, *lines]))
            same = by(solved, tmp_path / "named.csv")
            np.testing.assert_allclose(same.rig.positions, right.rig.positions, atol=1e-6)


def test_landmarks_without_a_place_are_left_out_and_named(data_folder, solved, tmp_path):
    folder = data_folder.parent / "cases/15-axes"
    lines = (folder / "m.csv").read_text().splitlines()
    (tmp_path / "clicks.csv").write_text((folder / "clicks.csv").read_text())
    (tmp_path / "more.csv").write_text("\n".join([*lines, "9999,1,2,3", "cupboard,1,1,1"]))
    found = by(solved, tmp_path / "more.csv")
    assert found.alignment is not None
    assert any(
        "2 of 8 landmarks have no place" in text and "'9999', 'cupboard'" in text for text in found.alignment.warnings
    )
    (tmp_path / "more.csv").write_text("\n".join([*lines[:4], *(f"{9000 + i},{i},2,3" for i in range(4))]))
    with pytest.raises(InsufficientDataError, match="4 of 7 landmarks have no place in this calibration"):
        by(solved, tmp_path / "more.csv")


@pytest.mark.parametrize("name", ["opengl", "unity", "unreal", "opencv", "y,x,z"])
def test_landmarks_of_another_world(data_folder, solved, tmp_path, name):
    folder = data_folder.parent / "cases/15-axes"
    right = by(solved, folder / "m.csv")
    known, world = read_landmarks(folder / "m.csv"), world_of(name)
    places = (100 if world.unit == "cm" else 1) * world.from_room(known.points)
    header = f"name,x_{world.unit},y_{world.unit},z_{world.unit}"
    lines = [",".join([one, *map(repr, place)]) for one, place in zip(known.names, places.tolist())]
    (tmp_path / "there.csv").write_text("\n".join([header, *lines]))
    (tmp_path / "clicks.csv").write_text((folder / "clicks.csv").read_text())
    found = by(solved, tmp_path / "there.csv", world=name)
    np.testing.assert_allclose(found.rig.positions, right.rig.positions, atol=1e-9)
    if name in ("opengl", "unity"):
        with pytest.raises(InsufficientDataError, match=f"--world {name}"):
            by(solved, tmp_path / "there.csv")


def test_the_remedy_of_the_message_works(data_folder, solved):
    folder = data_folder.parent / "cases/15-axes"
    right = by(solved, folder / "m.csv")
    for file in ("yup.csv", "zdown.csv"):
        with pytest.raises(InsufficientDataError, match="--world") as refused:
            by(solved, folder / file)
        world = re.search(r"--world[ =](\S+?)\.?$", str(refused.value))[1]
        np.testing.assert_allclose(by(solved, folder / file, world=world).rig.positions, right.rig.positions, atol=1e-6)


def test_axes_go_with_known_points_alone(solved):
    with pytest.raises(UsageError, match="leave it out with --floor"):
        align(solved, AlignSettings(floor=("0", "1", "2"), length_m=1.0, world="unity"))


def stand(elevation: float, roll: float = 0.0, count: int = 6, height: float = 2.5) -> CameraAxes:
    """A ring of cameras that look inwards, so many degrees above level, each rolled about its axis."""
    azimuth = np.linspace(0, 2 * np.pi, count, endpoint=False)
    e, r = np.deg2rad([elevation, roll])
    out = np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=1)
    z = np.array([0.0, 0.0, 1.0])
    ahead = -np.cos(e) * out + np.sin(e) * z
    up = np.cos(e) * z + np.sin(e) * out
    right = np.cross(ahead, up)
    up, right = np.cos(r) * up + np.sin(r) * right, np.cos(r) * right - np.sin(r) * up
    return CameraAxes(3 * out + height * z, right, up, ahead)


def seen_from(one: CameraAxes, turn) -> CameraAxes:
    return CameraAxes(*(np.stack(turn(*part.T), axis=1) for part in (one.centres, one.right, one.up, one.ahead)))


GRID = np.array([313334.1, 5154531.2, 0.0])  # m, UTM
FLOOR = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0.7], [0, -1, 1.9]])


@pytest.mark.parametrize("elevation", [-60.0, -25.0, 0.0, 15.0])
@pytest.mark.parametrize("name", TURNED)
def test_every_turn_is_named(elevation, name):
    turn = TURNED[name]
    with pytest.raises(InsufficientDataError, match=name):
        check_upright(seen_from(stand(elevation), turn), np.stack(turn(*FLOOR.T), axis=1))


@pytest.mark.parametrize(
    ("one", "known"),
    [
        (stand(-25.0), FLOOR),
        (stand(-90.0), FLOOR),  # straight down
        (stand(-25.0, roll=180.0), FLOOR),  # mounted upside down
        (stand(-25.0, roll=90.0), FLOOR),  # on their sides
        (stand(30.0, height=0.3), FLOOR),  # on the floor, looking up
        (stand(-25.0, height=-0.4), FLOOR - [0, 0, 3.0]),  # the origin at the ceiling
        (stand(-25.0, height=-0.4), 0 * FLOOR + [[1, 0, 0], [0, 1, 0], [2, 0, 0], [0, 2, 0]]),  # marks at the ceiling
        (stand(-25.0, height=0.4), FLOOR + np.array([0, 0, 1.0])),  # low cameras
    ],
)
def test_what_is_right_is_not_refused(one, known):
    """Nothing is raised; at most a warning, where most cameras are lower than the landmarks."""
    for warning in check_upright(one, known):
        assert "lower than the landmarks; check that z points up" in warning


def test_straight_down_and_upside_down_rooms_are_still_known():
    turn = TURNED["z points down"]
    for one in (stand(-90.0), stand(-80.0, roll=90.0), stand(-30.0, roll=90.0)):
        with pytest.raises(InsufficientDataError, match="z points down"):
            check_upright(seen_from(one, turn), np.stack(turn(*FLOOR.T), axis=1))


@pytest.mark.parametrize(
    ("width", "step", "message"),
    [
        (4.3, 0.1, None),
        (120.3, 0.1, "wide"),  # a warning
        (25.0, 1.0, None),
        (90.0, 1.0, "in cm these would be 0.9 m"),
        (450.0, 0.1, "in cm these would be 4.5 m"),
        (4300.0, 0.1, "in mm these would be 4.3 m"),
        (0.004, 0.0001, "4 mm wide altogether; give the known places in metres"),
    ],
)
def test_sizes(width, step, message):
    known = np.array([[0, 0, 0], [width, 0, 0], [0, width / 2, 0]])
    known = np.round(known / step) * step
    if width == 120.3 or message is None:
        assert bool(check_size(known, known, 300.0)) == (message is not None)
        assert not check_size(known + GRID, known + GRID, 300.0)
        return
    with pytest.raises(InsufficientDataError, match=message):
        check_size(known, known, 300.0)
    if width > 1:
        check_size(known, known + 0.01, 1e4)
