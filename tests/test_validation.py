"""Validation against a simulated room whose truth is known."""

import dataclasses

import jax
import numpy as np
import pytest

from jaxpoint.calibration.alignment import align_to_landmarks, apply_alignment
from jaxpoint.calibration.result import Calibration, PairTable, Verdict
from jaxpoint.commands.validate import _judge as judge_lengths
from jaxpoint.errors import InsufficientDataError, UsageError
from jaxpoint.geometry.pose import Similarity
from jaxpoint.landmarks import LandmarkPixels, Lengths, locate
from jaxpoint.simulate.rooms import random_room
from jaxpoint.triangulation import triangulate
from jaxpoint.validation import LengthValidation, compare_calibrations, validate_held_out, validate_lengths

ROOM = random_room(5, cameras=5, frames=128, layout="around", visibility=1.0, outliers=0.0, noise_px=0.5)
CORNERS = np.array([[x, y, z] for x in (2.0, 3.5) for y in (1.5, 3.0) for z in (0.8, 1.8)])  # in the views of all
NAMES = tuple(f"corner_{i}" for i in range(8))
PAIRS = tuple((NAMES[i], NAMES[j]) for i in range(8) for j in range(i))


CLICKS = LandmarkPixels(NAMES, np.asarray(ROOM.rig.project(CORNERS)), np.ones((8, 5), bool))


def noisy_clicks(sigma_px: float, seed: int) -> LandmarkPixels:
    noise = np.random.default_rng(seed).normal(0, sigma_px, CLICKS.pixels.shape)
    return dataclasses.replace(CLICKS, pixels=CLICKS.pixels + noise)


def lengths() -> Lengths:
    places = dict(zip(NAMES, CORNERS))
    values = np.array([np.linalg.norm(places[a] - places[b]) for a, b in PAIRS])
    return Lengths(tuple(f"{a}-{b}" for a, b in PAIRS), PAIRS, values)


def calibration_of(rig=ROOM.rig, unit="m") -> Calibration:
    """A rig as a calibration, its points triangulated from the noisy tracks."""
    tracks = ROOM.tracks
    found = triangulate(rig, tracks.pixels, tracks.visible)
    return Calibration(
        rig=rig,
        tracks=tracks,
        points=np.asarray(found.points),
        point_valid=np.asarray(found.valid),
        residuals=np.asarray(found.residuals),
        verdicts=np.where(tracks.visible, Verdict.KEPT, Verdict.HIDDEN),
        sigma_px=0.5,
        converged=True,
        message="",
        pairs=PairTable(tracks.names, np.zeros(5, int), np.zeros((5, 5), int), np.zeros(5)),
        unit=unit,
    )


TRUTH = calibration_of()


def test_exact_clicks_give_exact_lengths():
    found = validate_lengths(TRUTH, lengths(), CLICKS)
    assert found.max_mm < 1e-5
    assert (found.count, found.warnings) == (28, ())
    np.testing.assert_allclose(found.triangulated_m, lengths().length_m, atol=1e-8)


def test_the_noise_of_the_clicks_predicts_the_errors():
    draws = [validate_lengths(TRUTH, lengths(), noisy_clicks(2.0, seed), sigma_px=2.0) for seed in range(150)]
    errors = np.stack([draw.error_mm for draw in draws])
    predicted = validate_lengths(TRUTH, lengths(), CLICKS, sigma_px=2.0)
    ratio = errors.std(axis=0) / predicted.sigma_mm  # the spread of 150 draws is known to 6 %
    assert abs(ratio.mean() - 1) < 0.06
    assert (abs(ratio - 1) < 0.25).all()
    assert np.abs(errors).mean() == pytest.approx(predicted.expected_mean_mm, rel=0.06)


def test_uncertain_cameras_widen_the_prediction():
    """Against the spread of lengths under random cameras drawn from the covariance."""
    rng = np.random.default_rng(1)
    sigmas = np.tile([1e-3] * 3 + [5e-3] * 3 + [2.0] * 4 + [1e-3] * 2 + [0] * 3, 5)
    covariance = np.diag(sigmas**2)
    calibration = dataclasses.replace(TRUTH, camera_covariance=covariance)
    predicted = validate_lengths(calibration, lengths(), CLICKS, sigma_px=1e-6)

    perturbed = jax.jit(jax.vmap(lambda camera, change: camera.perturbed(change)))
    draws = []
    for _ in range(150):
        cameras = perturbed(ROOM.rig.cameras, (rng.normal(0, 1, 75) * sigmas).reshape(5, 15))
        moved = dataclasses.replace(TRUTH, rig=dataclasses.replace(ROOM.rig, cameras=cameras))
        draws.append(validate_lengths(moved, lengths(), CLICKS).error_mm)
    ratio = np.std(draws, axis=0) / predicted.sigma_mm
    assert abs(ratio.mean() - 1) < 0.1
    assert (abs(ratio - 1) < 0.25).all()


def test_lengths_between_alignment_points_do_not_count():
    alignment = align_to_landmarks(CORNERS[:4], CORNERS[:4], names=NAMES[:4])
    found = validate_lengths(dataclasses.replace(TRUTH, alignment=alignment), lengths(), CLICKS)
    assert found.count == 28 - 6
    assert any("6 lengths end at points of the alignment" in warning for warning in found.warnings)
    assert found.mean_mm == pytest.approx(np.abs(found.error_mm[found.independent]).mean())
    only = Lengths(("edge",), ((NAMES[0], NAMES[1]),), np.array([1.0]))
    with pytest.raises(InsufficientDataError, match="All 1 lengths end at points used for the alignment"):
        validate_lengths(dataclasses.replace(TRUTH, alignment=alignment), only, CLICKS)


def test_lengths_need_metres_and_two_images():
    with pytest.raises(UsageError, match="unit is arbitrary"):
        validate_lengths(dataclasses.replace(TRUTH, unit="arbitrary"), lengths(), CLICKS)
    visible = CLICKS.visible.copy()
    visible[3, 1:] = False
    with pytest.raises(InsufficientDataError, match="'corner_3' is clicked in 1 image; click it in two or more"):
        validate_lengths(TRUTH, lengths(), dataclasses.replace(CLICKS, visible=visible))
    unknown = Lengths(("edge",), (("corner_0", "door"),), np.array([1.0]))
    with pytest.raises(InsufficientDataError, match="'door' is clicked in 0 images"):
        validate_lengths(TRUTH, unknown, CLICKS)


def test_locate_finds_clicks_cameras_and_frames():
    camera, frame = ROOM.tracks.names[2], str(ROOM.tracks.frame_ids[7])
    points, warnings = locate(TRUTH, ["corner_5", camera, frame], CLICKS)
    np.testing.assert_allclose(points[0], CORNERS[5], atol=1e-8)
    np.testing.assert_allclose(points[1], ROOM.positions[2], atol=1e-9)
    np.testing.assert_array_equal(points[2], TRUTH.points[7])
    assert warnings == ()
    with pytest.raises(InsufficientDataError, match="'door' is no clicked point, camera or frame"):
        locate(TRUTH, ["door"], CLICKS)
    invalid = dataclasses.replace(TRUTH, point_valid=np.zeros(128, bool))
    with pytest.raises(InsufficientDataError, match=f"light of frame {frame} has no point"):
        locate(invalid, [frame])


def test_a_wrong_click_is_a_warning():
    pixels = CLICKS.pixels.copy()
    pixels[4, 0] += 80
    _, warnings = locate(TRUTH, NAMES, dataclasses.replace(CLICKS, pixels=pixels))
    assert len(warnings) == 1
    assert "clicks on 'corner_4' miss each other" in warnings[0]


def test_landmarks_clicked_in_images_bring_a_rig_into_the_room():
    solver = Similarity(3.0, np.eye(3), np.array([1.0, 2, 3]))
    moved = dataclasses.replace(
        TRUTH,
        rig=ROOM.rig.transformed(solver),
        points=np.asarray(solver @ TRUTH.points),
        unit="arbitrary",
    )
    points, _ = locate(moved, NAMES, CLICKS)
    aligned = apply_alignment(moved, align_to_landmarks(points, CORNERS, names=NAMES))
    np.testing.assert_allclose(aligned.rig.positions, ROOM.positions, atol=1e-7)
    np.testing.assert_allclose(aligned.points, TRUTH.points, atol=1e-7)


def test_held_out_frames_show_the_noise():
    found = validate_held_out(ROOM.rig, ROOM.tracks)
    seen = ROOM.tracks.visible.sum(axis=1)
    observations = int(seen[seen >= 2].sum())
    assert found.reprojection.count == observations
    # 2 n coordinates less 3 a frame are free; noise 0.5 px.
    freedom = 2 * observations - 3 * int((seen >= 2).sum())
    expected = 0.5 * np.sqrt(freedom / observations)
    assert found.reprojection.rms_px == pytest.approx(expected, rel=0.06)
    assert found.prediction is not None
    assert found.prediction.rms_px > 0.5 * np.sqrt(2)
    assert found.prediction.count == int(seen[seen >= 3].sum())
    assert len(found.prediction.per_camera_mean_px) == 5


def test_prediction_finds_the_camera_that_moved():
    cameras = jax.vmap(lambda camera, change: camera.perturbed(change))(
        ROOM.rig.cameras, np.zeros((5, 15)) + 0.02 * np.eye(5, 15)[[1, 1, 3, 1, 1]] * (np.arange(5) == 2)[:, None]
    )
    found = validate_held_out(dataclasses.replace(ROOM.rig, cameras=cameras), ROOM.tracks)
    assert found.prediction is not None
    assert int(np.argmax(found.prediction.per_camera_mean_px)) == 2
    # Predicted by the four right cameras, the wrong one is off by more than its own pull lets its residual show.
    assert found.prediction.per_camera_mean_px[2] > 1.2 * found.reprojection.per_camera_mean_px[2]


def test_held_out_frames_that_cannot_be_used():
    pixels, sizes = ROOM.tracks.pixels, ROOM.tracks.image_sizes
    lonely = np.zeros(pixels.shape[:2], bool)
    lonely[:, 0] = True
    one_view = type(ROOM.tracks).from_pixels(pixels, sizes, lonely, names=ROOM.tracks.names)
    with pytest.raises(InsufficientDataError, match="None of the 128 held-out frames is seen by two cameras"):
        validate_held_out(ROOM.rig, one_view)
    with pytest.raises(ValueError, match="select alike"):
        validate_held_out(ROOM.rig, ROOM.tracks.select_cameras([1, 0, 2, 3, 4]))


def test_comparison_sees_through_a_similarity():
    solver = Similarity(2.5, np.eye(3)[[1, 2, 0]], np.array([1.0, 2, 3]))
    moved = calibration_of(ROOM.rig.transformed(solver), "arbitrary")
    found = compare_calibrations(TRUTH, moved)
    assert found.unit == "mm"
    assert found.centre.max() < 1e-3
    assert found.rotation_deg.max() < 1e-6
    assert found.pixel_rms < 1e-4
    assert compare_calibrations(moved, TRUTH).unit == "arbitrary"


def test_comparison_names_the_camera_that_differs():
    change = np.zeros((5, 15))
    change[3, 3:7] = 0.02, 0, 0, 4.0
    cameras = jax.vmap(lambda camera, step: camera.perturbed(step))(ROOM.rig.cameras, change)
    found = compare_calibrations(TRUTH, calibration_of(dataclasses.replace(ROOM.rig, cameras=cameras)))
    assert int(np.argmax(found.centre)) == 3
    assert found.centre[3] == pytest.approx(20, abs=6)  # the others take over a part of its shift
    np.testing.assert_allclose(found.focal_px, [0, 0, 0, 2, 0], atol=1e-9)
    assert found.pixel_rms > 1


def test_parts_without_a_frame_in_common():
    third = np.arange(128) % 3 == 0

    def part(frames):
        fields = {name: getattr(TRUTH, name)[frames] for name in ("points", "point_valid", "residuals", "verdicts")}
        return dataclasses.replace(TRUTH, tracks=ROOM.tracks.select_frames(frames), **fields)

    first, second = part(~third), part(third)
    assert compare_calibrations(first, second).pixel_rms < 1e-6
    hardly = dataclasses.replace(first, point_valid=np.arange(len(first.points)) < 2)
    with pytest.raises(InsufficientDataError, match="Only 2 frames have a point in both rigs"):
        compare_calibrations(hardly, second)
    with pytest.raises(ValueError, match="The cameras differ"):
        compare_calibrations(TRUTH, dataclasses.replace(TRUTH, rig=ROOM.rig.select([1, 0, 2, 3, 4])))


@pytest.mark.parametrize(
    ("found", "says"),
    [
        ([1.02, 2.04, 3.061], "all come out 2.0% too long, so it is the scale"),
        ([0.97, 1.94, 2.911], "all come out 3.0% too short"),
        ([1.001, 2.2, 2.999], "look at 'second' first"),
    ],
)
def test_lengths_that_miss_name_the_scale_or_the_worst(found, says):
    measured, found = np.array([1.0, 2.0, 3.0]), np.array(found)
    error = 1e3 * (found - measured)
    lengths = LengthValidation(
        names=("first", "second", "third"),
        length_m=measured,
        triangulated_m=found,
        error_mm=error,
        sigma_mm=np.ones(3),
        independent=np.ones(3, bool),
        count=3,
        mean_mm=float(np.abs(error).mean()),
        max_mm=float(np.abs(error).max()),
        expected_mean_mm=1.0,
        warnings=(),
    )
    assert says in str(judge_lengths(lengths, 10.0))
    assert judge_lengths(lengths, 1000.0) is None
