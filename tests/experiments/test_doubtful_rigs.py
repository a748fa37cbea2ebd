"""The experiment of difficult rigs: its simulator against OpenCV, its predictions against jaxpoint's, its scores."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import doubtful_rigs as study
import doubtful_rigs_determined as best
from doubtful_rigs_cameras import Cameras
from doubtful_rigs_errors import CameraError, errors_of
from doubtful_rigs_faults import Fault, faulty_cameras
from doubtful_rigs_generator import draw
from doubtful_rigs_scores import REST, Record, Result, excesses, inside, names_true_cause, outcome, summary, tallies
from jaxpoint.calibration.covariance import with_covariance
from jaxpoint.calibration.pairs import pair_table
from jaxpoint.calibration.recording import Freedom, Recording
from jaxpoint.calibration.result import Calibration, Verdict
from jaxpoint.calibration.uncertainty import uncertainty_of
from jaxpoint.config import LensSettings
from jaxpoint.errors import JaxpointError, UsageError
from jaxpoint.geometry.pose import Similarity

RING, CEILING_FROZEN, CEILING_LATE = 37, 30, 46


def cameras_of(rng: np.random.Generator, equidistant: bool, aspect: float = 1.0) -> Cameras:
    """Two cameras near the origin, looking forwards."""
    turn = Rotation.from_rotvec(rng.normal(0.0, 0.2, (2, 3))).as_matrix()
    numbers = np.array([600.0, 700.0]), np.full(2, aspect), np.array([[500.0, 300.0], [640.0, 350.0]])
    radial = np.array([[-0.1, 0.02], [0.03, 0.0]])
    size = np.array([[1000, 600], [1280, 720]])
    return Cameras(turn, rng.normal(0.0, 0.3, (2, 3)), *numbers, radial, np.full(2, equidistant), size)


@pytest.mark.parametrize("equidistant", [False, True])
def test_the_projection_is_opencvs(equidistant):
    rng = np.random.default_rng(1)
    cameras = cameras_of(rng, equidistant, aspect=16 / 15)
    points = rng.uniform([-2.0, -2.0, 1.5], [2.0, 2.0, 4.0], (50, 3))
    mine = cameras.project(np.repeat(points[:, None], 2, axis=1))
    for c in range(2):
        fx, fy = cameras.focals[c]
        matrix = np.array([[fx, 0.0, cameras.center[c, 0]], [0.0, fy, cameras.center[c, 1]], [0.0, 0.0, 1.0]])
        turn = cv2.Rodrigues(cameras.rotation[c])[0]
        shift = -cameras.rotation[c] @ cameras.position[c]
        lens = np.array([*cameras.radial[c], 0.0, 0.0])
        if equidistant:
            theirs, _ = cv2.fisheye.projectPoints(points[:, None], turn, shift, matrix, lens)
        else:
            theirs, _ = cv2.projectPoints(points, turn, shift, matrix, lens)
        np.testing.assert_allclose(mine[:, c], theirs[:, 0], atol=1e-6)
    assert fx == pytest.approx(fy * 15 / 16)


def test_a_seed_gives_one_rig_and_its_control_differs_by_the_fault_alone():
    rig, control = draw(CEILING_LATE)
    again, _ = draw(CEILING_LATE)
    np.testing.assert_array_equal(rig.tracks.pixels, again.tracks.pixels)
    (fault,) = rig.faults
    assert (fault.kind, len(fault.cameras)) == ("late", 1)
    (late,), lag = fault.cameras, int(fault.value)
    others = [c for c in range(len(rig.cameras)) if c != late]
    np.testing.assert_array_equal(rig.tracks.pixels[:, others], control.tracks.pixels[:, others])
    np.testing.assert_allclose(rig.shown[lag:, late], rig.light[:-lag], atol=1e-9)
    assert control.faults == ()
    assert 0.3 <= rig.noise_px <= 0.7
    assert 0.01 < rig.outliers.sum() / rig.tracks.visible.sum() < 0.06


def test_mirrored_and_frozen_cameras_and_other_rooms():
    (rig, control), mirrored = draw(9), 0
    assert [fault.kind for fault in rig.faults] == ["mirrored"]
    both = rig.tracks.visible[:, mirrored]
    np.testing.assert_array_equal(both, control.tracks.visible[:, mirrored])
    pixels, plain = rig.tracks.pixels[both, mirrored], control.tracks.pixels[both, mirrored]
    np.testing.assert_allclose(pixels[:, 0], rig.cameras.size[mirrored, 0] - 1 - plain[:, 0])
    np.testing.assert_allclose(pixels[:, 1], plain[:, 1])
    frozen = draw(CEILING_FROZEN)[0].tracks
    assert frozen.pixels[frozen.visible[:, 1], 1].std(axis=0).max() < 1.0
    other, _ = draw(10)
    assert np.linalg.norm(other.shown[:, 0] - other.light, axis=1).mean() > 0.5


def test_pixels_that_are_not_square_and_cuts_keep_the_view():
    cameras = cameras_of(np.random.default_rng(2), False)
    point = np.tile([0.1, -0.1, 3.0], (1, 2, 1))
    plain = cameras.project(point)[0]
    wide = faulty_cameras(cameras, (Fault("aspect", (0,), 4 / 3),))
    np.testing.assert_allclose(wide.project(point)[0, 0, 0] + 0.5, (plain[0, 0] + 0.5) / (4 / 3))
    assert wide.project(point)[0, 0, 1] == pytest.approx(plain[0, 1])
    np.testing.assert_array_equal(wide.size, [[750, 600], [1280, 720]])
    cut = faulty_cameras(cameras, (Fault("crop", (1,), 0.25, -0.1),))
    np.testing.assert_allclose(cut.project(point)[0, 1], plain[1] - [320, 0])
    np.testing.assert_array_equal(cut.size, [[1000, 600], [960, 648]])
    fisheye = faulty_cameras(cameras, (Fault("lens", (0, 1), 120.0),))
    edge = np.tan(np.deg2rad(59.99)) * cameras.rotation[0].T @ [1.0, 0.0, 0.0] + cameras.rotation[0][2]
    pixel = fisheye.project(np.repeat((cameras.position[0] + edge)[None, None], 2, axis=1))[0, 0]
    assert pixel[0] == pytest.approx(cameras.center[0, 0] + 500.0, abs=0.2)


def test_every_layout_and_fault_is_drawn_and_clocks_are_as_told():
    rigs = [draw(seed)[0] for seed in range(88)]
    drawn = {(rig.kind, rig.faults[0].kind if rig.faults else "none") for rig in rigs}
    assert len({kind for kind, _ in drawn}) == 8
    assert len(drawn) >= 72
    assert max(len(rig.faults) for rig in rigs) == 2
    for rig in rigs:
        axes = rig.cameras.rotation[:, 2]
        apart = np.rad2deg(np.arccos(np.clip((axes @ axes.T).min(), -1.0, 1.0)))
        if rig.kind in ("parallel", "tilted alike"):
            assert apart < 1e-3
        elif rig.kind == "nearly parallel":
            assert apart <= 2 * rig.layout.turn_deg + 1e-6
        for fault in rig.faults:
            if fault.kind == "rate":
                assert 29.0 <= fault.value <= 29.97


def test_the_predicted_error_is_jaxpoints_own(free_room):
    known, calibration = free_room
    calibration, room = replace(calibration, loss_scale=None), known.room
    theirs = uncertainty_of(calibration)
    cameras = Cameras(
        room.rotation, room.positions, room.focal, np.ones(4), room.center, room.distortion[:, :2], np.zeros(4, bool),
        np.asarray(room.tracks.image_sizes),
    )  # fmt: skip
    seen = (calibration.kept & calibration.point_valid[:, None])[calibration.point_valid]
    free, sigma = np.ones((4, best.PARAMETERS), bool), np.full((4, best.PARAMETERS), np.inf)
    free[:, 7] = False
    sigma[:, 8:10], sigma[:, 10:] = 0.05 * 1280, 1.0
    points = calibration.points[calibration.point_valid]
    mine = best._covariance(cameras, points, seen, calibration.sigma_px, free, sigma)
    assert mine is not None
    variance = np.diagonal(mine).reshape(4, -1)
    np.testing.assert_allclose(np.sqrt(variance[:, 6]), theirs.camera_sigmas[:, 7] / room.focal, rtol=1e-3)
    own = np.trace(np.asarray(theirs.centre_covariance), axis1=1, axis2=2)
    np.testing.assert_allclose(variance[:, 3:6].sum(axis=1), own, rtol=1e-3)


def test_parallel_axes_determine_nothing_and_a_ring_does():
    assert not best.determined(draw(0)[0]).enough
    assert best.determined(draw(29)[0]).enough  # ring, one of 8 cameras with pixels that are not square
    assert best.determined(draw(35)[0]).focal is None  # one of three cameras is late


def calibration_of(rig) -> Calibration:
    """The truth of a perspective rig as `calibrate` would return it, in another frame and unit."""
    tracks, turn = rig.tracks, Rotation.from_rotvec([0.3, -0.5, 1.0]).as_matrix()
    world = Similarity(np.asarray(0.5), turn, np.array([1.0, 2.0, -3.0]))
    moved = 0.5 * rig.light @ turn.T + [1.0, 2.0, -3.0]
    valid = tracks.visible.sum(axis=1) >= 2
    verdicts = np.where(tracks.visible & valid[:, None], Verdict.KEPT, Verdict.HIDDEN)
    parts = Freedom.of(Recording.of(tracks), LensSettings(), "radial2")
    count = tracks.cameras
    return Calibration(
        study.true_lenses(rig).transformed(world), tracks, np.where(valid[:, None], moved, 0.0), valid,
        np.zeros(tracks.pixels.shape), verdicts, rig.noise_px, True, "the truth", pair_table(tracks),
        freedom=Freedom(parts.free[:count], parts.prior_mean[:count], parts.prior_weight[:count]),
    )  # fmt: skip


def test_errors_are_those_made():
    _, rig = draw(RING)
    exact = with_covariance(calibration_of(rig))
    for error in errors_of(exact, rig):
        assert max(map(abs, error.focal)) < 1e-9
        assert max(error.centre, error.rotation_deg) < 1e-6
        assert min(*error.focal_sigma, error.centre_sigma, error.rotation_sigma_deg) > 0
    # The sigma of a centre is that of the experiment's own prediction, whatever the frame and the unit.
    predicted = max(error.centre_sigma for error in errors_of(exact, rig))
    assert predicted == pytest.approx(best.determined(rig).centre, rel=0.1)
    changed = exact.rig.cameras
    wrong = replace(exact, rig=_with(exact.rig, focal=changed.focal * np.array([[1.05, 1.0], [1.0, 1.0], [1.0, 1.0]])))
    assert errors_of(wrong, rig)[0].focal[0] == pytest.approx(0.05)
    # A wild point of the light does not move the frame; a camera left out does not count.
    wild = exact.points.copy()
    wild[:5] += 100.0
    assert max(error.centre for error in errors_of(replace(exact, points=wild), rig)) < 1e-6
    two = replace(exact, rig=exact.rig.select([0, 2]), camera_covariance=None)
    assert [error.name for error in errors_of(two, rig)] == ["cam_0", "cam_2"]
    assert errors_of(two, rig)[0].centre_square is None


def _with(rig, focal):
    lens = rig.cameras
    pose = lens.cam_from_world
    numbers = (lens.center, lens.distortion, pose.rotation, pose.translation)
    return type(rig).from_parameters(focal, *numbers, rig.image_sizes, rig.names)


def camera(name="cam_0", focal=0.001, sigma=0.002, **changes) -> CameraError:
    """A camera as far off as predicted."""
    return replace(CameraError(name, (focal, focal), (sigma, sigma), 0.001, 0.002, 1.0, 0.1, 0.2, 1.0), **changes)


def record(seed=1, kind="ring", faults=(), result=None, enough=True, control=None) -> Record:
    """A rig of three cameras."""
    good = Result(True, cameras=(camera(), camera("cam_1"), camera("cam_2")))
    own = best.Determined(0.01, 0.01) if enough else best.Determined(0.4, 0.3)
    return Record(seed, kind, None, faults, 3, 400, 0.5, 4.0, own, result or good, control or good, True)


def refused(message: str, *causes: str) -> Result:
    return Result(False, message, causes, "QualityError")


def test_wrong_is_beyond_four_sigma_and_beyond_twice_the_control():
    assert outcome(record()) == "good and right"
    wrong = Result(True, cameras=(camera(), camera(focal=-0.03), camera(rotation_deg=2.0)))
    found = excesses(record(result=wrong))
    assert [one.quantity for one in found] == ["focal", "rotation"]
    assert str(found[0]) == "cam_0 focal 3.00% (sigma 0.20%, control 0.10%)"
    assert outcome(record(result=wrong)) == "good and wrong"
    as_bad = Result(True, cameras=(camera(focal=0.02, rotation_deg=1.5), camera(focal=0.02, rotation_deg=1.5)))
    assert outcome(record(result=wrong, control=as_bad)) == "good and right"
    # Without a predicted error only the control counts; a result that is refused is not called good.
    blind = Result(True, cameras=(camera(sigma=0.0, focal=0.003),))
    assert outcome(record(result=blind)) == "good and wrong"
    assert outcome(record(result=replace(wrong, passed=False))) == "refused, other cause"
    # A rig that holds without a camera that was left out is held to its word too.
    assert outcome(record(result=replace(wrong, passed=False, holds=True))) == "good and wrong"
    rest = replace(record().result, passed=False, holds=True, message="Camera cam_2 shows the light 7 frames late.")
    assert outcome(record(faults=(Fault("late", (2,), 7.0),), result=rest)) == REST


@pytest.mark.parametrize(
    ("kind", "fault", "enough", "said", "true"),
    [
        ("ring", Fault("late", (2,), 7.0), True, "Camera 'cam_2' is late by 7 frames.", True),
        ("ring", Fault("late", (2,), 7.0), True, "Camera 'cam_1' is late by 7 frames.", False),
        ("ring", Fault("late", (2,), 7.0), True, "Camera 'cam_2' agrees with none; `--time-offsets` helps.", False),
        ("ring", Fault("rate", (2,), 29.5), True, "Camera 'cam_2' runs at 29.5, a rate of its own.", True),
        ("ring", Fault("rate", (2,), 29.5), True, "Camera 'cam_2' is not accurate.", False),
        ("ring", Fault("aspect", (0, 1, 2), 4 / 3), True, "The pixels are not square.", True),
        ("ring", Fault("crop", (1,), 0.3), True, "The image of 'cam_1' is cropped.", True),
        ("ring", Fault("crop", (1,), 0.3), True, "The adjustment did not converge.", False),
        ("ring", Fault("frozen", (1,)), True, "The light hardly moves in 'cam_1'.", True),
        ("ring", Fault("mirrored", (1,)), True, "cam_1: a mirror image", True),
        ("ring", Fault("other room", (1,)), True, "'cam_1' fits no other.", True),
        ("ring", Fault("lens", (0, 1, 2), 140.0), True, "A wide lens.", True),
        ("parallel", None, False, "The optical axes are parallel.", True),
        ("ring", None, False, "The focal lengths are not determined.", True),
        ("ring", None, False, "The light moves on a plane.", False),
        ("ring", None, True, "The focal lengths are not determined.", False),
        ("ring", None, True, "Too few frames.", False),
    ],
)  # fmt: skip
def test_a_refusal_names_the_true_cause(kind, fault, enough, said, true):
    faults = () if fault is None else (fault,)
    one = record(kind=kind, faults=faults, enough=enough, result=refused(said))
    assert names_true_cause(one) == true
    assert outcome(one) == ("refused, true cause" if true else "refused, other cause")


def test_short_causes_count_as_words():
    one = record(faults=(Fault("mirrored", (1,)),), result=refused("Camera 'cam_1' is left out.", "mirrored"))
    assert names_true_cause(one)


def test_counts_reliability_and_page(tmp_path):
    crashed = Result(False, "index 3", (), "IndexError", True)
    records = [
        record(0),
        record(1, faults=(Fault("late", (2,), 9.0), Fault("crop", (0,), 0.1)), result=refused("'cam_2' is late.")),
        record(2, "parallel", result=Result(True, cameras=(camera(focal=0.2),)), enough=False),
        record(3, "corridor", result=crashed),
    ]
    counted = tallies(records)
    assert counted["all"].rigs == 4
    assert (counted["late"].rigs, counted["crop"].rigs, counted["no fault"].rigs) == (1, 1, 3)
    assert (counted["all"].determined, counted["all"].determined_right, counted["all"].determined_refused) == (3, 1, 2)
    assert (counted["all"].crashed, counted["all"].undetermined_good) == (1, 1)
    figures = summary(records)
    assert figures["wrong_called_good"] == 1
    assert figures["determined_right"] == pytest.approx(1 / 3)
    assert figures["refusals_with_the_true_cause"] == 0.5
    results = [record.result for record in records]
    assert inside(results, "focal", (0.3, 0.5)) == [0.0, 0.75]  # of four cameras called good, one is 100 sigmas off
    assert json.loads(json.dumps(figures, allow_nan=False))["wrong"][0]["seed"] == 2
    study.write_study(tmp_path / "report.html", records, figures, {"command": "test"})
    page = (tmp_path / "report.html").read_text()
    assert "parallel" in page
    assert "20.00%" in page
    assert "index 3" in page
    study.write_study(tmp_path / "empty.html", [], summary([]), {})


def test_seeds_by_kind():
    options = study.DoubtfulRigs(seeds=(0, 24), only="ring")
    assert study.chosen_seeds(options) == [5, 13, 21]
    assert study.chosen_seeds(replace(options, only="other room")) == [10, 20, 21]
    with pytest.raises(UsageError, match="--only takes one of"):
        study.chosen_seeds(replace(options, only="square"))


def test_one_rig_is_run_kept_and_summed_up(tmp_path, monkeypatch):
    truth = calibration_of(draw(RING)[0])

    def calibrate(tracks, settings, intrinsics):
        assert (settings.lens.known, intrinsics is None) in (("none", True), ("hold", False))
        np.testing.assert_array_equal(tracks.pixels, truth.tracks.pixels)
        return truth

    monkeypatch.setattr(study, "calibrate", calibrate)
    options = study.DoubtfulRigs(seeds=(RING, RING + 1), out=tmp_path)
    study.main(options)
    assert json.loads((tmp_path / "summary.json").read_text())["wrong_called_good"] == 0
    kept = json.loads((tmp_path / "rigs" / f"{RING}.json").read_text())
    assert kept["control_held"]
    assert len(kept["result"]["cameras"]) == len(kept["control"]["cameras"]) == 3
    assert all(abs(one["focal"][0]) < 1e-9 and one["centre"] < 1e-6 for one in kept["control"]["cameras"])
    with pytest.raises(UsageError, match="--resume"):
        study.main(options)
    monkeypatch.setattr(study, "run_seed", None)
    study.main(replace(options, resume=True))


def test_an_error_of_any_kind_is_a_result(monkeypatch):
    def refuse(*_, **__):
        raise JaxpointError("Camera 'cam_1' is late.")

    def crash(*_, **__):
        raise IndexError("no camera")

    rig, _ = draw(CEILING_LATE)
    monkeypatch.setattr(study, "calibrate", refuse)
    result, _ = study.run_one(rig)
    assert (result.passed, result.crashed, result.message) == (False, False, "Camera 'cam_1' is late.")
    monkeypatch.setattr(study, "calibrate", crash)
    result, _ = study.run_one(rig)
    assert (result.passed, result.crashed, result.error) == (False, True, "IndexError")
