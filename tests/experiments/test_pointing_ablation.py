"""The batched Monte Carlo of pointing: one pointing by OpenCV and scipy, exactness, predicted errors, its tables."""

import csv
import json
from dataclasses import fields
from typing import Any, cast

import cv2
import jax
import numpy as np
import pytest
from scipy.optimize import least_squares

import pointing_ablation as ablation
from jaxpoint.pointing.bias.models import Constant
from pointing_conditions import Row, mean_of, median_of
from pointing_monte_carlo import Condition, Noise, _normal, disturbed, jobs_of, line_ends, point
from pointing_people import Setting, gestures_of, law
from pointing_pictures import SWEEPS, draw_lines, draw_sweeps

PLANES, JOINED = Condition("forearm", "planes", 2), Condition("forearm", "endpoints", 2)


@pytest.fixture(scope="module")
def rooms():
    return gestures_of([Setting.drawn(0, 65)], law(0.0), people=2, each=4)


def seen(condition, pixel=0.0, calibration=0.0, **others):
    return Condition(condition.line, condition.method, condition.views, noise=Noise.of(pixel, calibration, **others))


def cameras_of(job):
    """OpenCV's numbers of every camera: rotation vector, translation, matrix, lens."""
    own = job.cameras
    for k in range(own.focal.shape[0]):
        focal, center = np.asarray(own.focal[k]), np.asarray(own.center[k])
        matrix = np.array([[focal[0], 0, center[0]], [0, focal[1], center[1]], [0, 0, 1]])
        pose = own.cam_from_world
        rotation, translation = np.asarray(pose.rotation[k]), np.asarray(pose.translation[k])
        yield rotation, translation, matrix, np.asarray(own.distortion[k])


def projected(camera, point):
    rotation, translation, matrix, lens = camera
    return cv2.projectPoints(point[None], cv2.Rodrigues(rotation)[0], translation, matrix, lens)[0].ravel()


def triangulated(cameras, pixels, start):
    """The point of least squared pixel error, by scipy on OpenCV's projection."""
    return least_squares(
        lambda x: np.concatenate([projected(c, x) - p for c, p in zip(cameras, pixels)]), start, xtol=1e-14, ftol=1e-14
    ).x


def ray(camera, pixel):
    rotation, _, matrix, lens = camera
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-14)
    ideal = cv2.undistortPoints(pixel[None, None], matrix, lens, None, None, None, criteria).ravel()
    return rotation.T @ np.array([*ideal, 1.0])


def first_met(corners, origin, direction):
    """Number of the nearest rectangle on a ray, -1 for none."""
    best, found = np.inf, -1
    for k, (lt, rt, lb, _) in enumerate(corners):
        solution = np.linalg.solve(np.stack([rt - lt, lb - lt, -direction], axis=1), origin - lt)
        if (solution[:2] >= 0).all() and (solution[:2] <= 1).all() and 0 < solution[2] < best:
            best, found = solution[2], k
    return found


@pytest.mark.parametrize("condition", [PLANES, JOINED], ids=["planes", "ends"])
def test_one_pointing_by_opencv_and_scipy(rooms, condition):
    """The noise is drawn anew from the same key; everything else is not ours."""
    asked, size = seen(condition, pixel=2.0), 64
    job = jobs_of(rooms, asked)[0]
    sample = point(rooms, asked, 3, seed=5, size=size)
    key = jax.random.split(jax.random.key(5, impl="unsafe_rbg"), len(jobs_of(rooms, asked)))[0]
    noise = 2.0 * np.asarray(_normal(jax.random.split(key, 3)[2], (2, 3, 2, size), np.dtype(float)))
    cameras, own = list(cameras_of(job)), rooms[0]
    corners = [np.asarray(thing.corners) for thing in Setting.drawn(0, 65).things]
    for k in range(2 * len(job.numbers)):  # two draws of every gesture of the first job
        number = job.numbers[k % len(job.numbers)]
        ends = [own.points[name][number] for name in ("elbow", "wrist", "tip")]
        pixels = [[projected(c, end) + noise[:, e, v, k] for v, c in enumerate(cameras)] for e, end in enumerate(ends)]
        tip = triangulated(cameras, pixels[2], ends[2])
        if condition.method == "planes":
            normals = [np.cross(ray(c, pixels[0][v]), ray(c, pixels[1][v])) for v, c in enumerate(cameras)]
            direction = np.cross(*normals)
            direction *= np.sign(direction @ (ends[1] - ends[0]))
        else:
            direction = triangulated(cameras, pixels[1], ends[1]) - triangulated(cameras, pixels[0], ends[0])
        direction /= np.linalg.norm(direction)
        to = own.target[number] - ends[2]
        np.testing.assert_allclose(sample.scored.origin[k], tip, atol=1e-6)
        np.testing.assert_allclose(sample.scored.direction[k], direction, atol=1e-6)
        assert sample.gesture[k] == number
        angle = np.arccos(direction @ to / np.linalg.norm(to))
        assert sample.scored.angle[k] == pytest.approx(angle, abs=1e-5)
        turn = np.arctan2(direction[1], direction[0]) - np.arctan2(to[1], to[0])
        assert np.exp(1j * sample.scored.azimuth[k]) == pytest.approx(np.exp(1j * turn), abs=1e-5)
        rise = np.arctan2(direction[2], np.hypot(*direction[:2])) - np.arctan2(to[2], np.hypot(*to[:2]))
        assert sample.scored.elevation[k] == pytest.approx(rise, abs=1e-5)
        assert sample.scored.right[k] == (first_met(corners, tip, direction) == own.meant[number])


@pytest.mark.parametrize("condition", [PLANES, JOINED], ids=["planes", "ends"])
def test_without_noise_lines_are_exact_and_a_bias_comes_off(rooms, condition):
    asked = seen(condition)
    rear, front = line_ends(rooms[0], asked)
    true = (front - rear) / np.linalg.norm(front - rear, axis=1, keepdims=True)
    plain = point(rooms, asked, 1, size=64)
    np.testing.assert_allclose(plain.scored.direction, true[plain.gesture], atol=1e-9)
    np.testing.assert_allclose(plain.scored.origin, rooms[0].points["tip"][plain.gesture], atol=1e-9)
    turned = point(rooms, asked, 1, size=64, model=Constant(np.array([0.1, 0.05])))
    np.testing.assert_allclose(turned.scored.elevation, plain.scored.elevation - 0.05, atol=1e-9)
    np.testing.assert_allclose(np.sin(turned.scored.azimuth - plain.scored.azimuth + 0.1), 0.0, atol=1e-9)


def test_planes_need_no_correspondence_and_ends_do(rooms):
    slid = {c.method: point(rooms, seen(c, slide=0.03), 8, size=64) for c in (PLANES, JOINED)}
    rear, front = line_ends(rooms[0], PLANES)
    true = (front - rear) / np.linalg.norm(front - rear, axis=1, keepdims=True)
    off = {name: np.abs(s.scored.direction - true[s.gesture]).max() for name, s in slid.items()}
    assert off["planes"] < 1e-9
    assert off["endpoints"] > 0.02


def test_errors_grow_as_the_predicted_covariance_says(rooms):
    """By OpenCV's own derivatives: of each end (J^T J)^-1 sigma^2, then of the direction between them."""
    asked = [seen(JOINED, pixel=sigma) for sigma in (0.25, 0.5)]
    samples = [point(rooms, one, 3000, size=64) for one in asked]
    rear, front = line_ends(rooms[0], JOINED)
    for job in jobs_of(rooms, JOINED):
        cameras = list(cameras_of(job))
        for number in job.numbers:
            spread = np.zeros((3, 3))
            for end in (rear[number], front[number]):
                rows = []
                for rotation, translation, matrix, lens in cameras:
                    given = cv2.Rodrigues(rotation)[0], translation, matrix, lens
                    rows.append(cv2.projectPoints(end[None], *given)[1][:, 3:6] @ rotation)
                spread += np.linalg.inv(np.concatenate(rows).T @ np.concatenate(rows))
            span = front[number] - rear[number]
            along = span / np.linalg.norm(span)
            across = np.eye(3) - np.outer(along, along)
            per_px = np.sqrt(np.trace(across @ spread @ across)) / np.linalg.norm(span)
            for sigma, sample in zip((0.25, 0.5), samples):
                off = sample.scored.direction[sample.gesture == number] - along
                assert np.sqrt((off**2).sum(axis=1).mean()) == pytest.approx(sigma * per_px, rel=0.05)


def test_a_calibration_errs_as_it_is_told(rooms):
    cameras = jobs_of(rooms, PLANES)[0].cameras
    draw = jax.jit(jax.vmap(lambda key: disturbed(cameras, Noise.of(calibration=2.0), key)))
    many = draw(jax.random.split(jax.random.key(0), 4000))
    pose = many.cam_from_world
    places = -np.einsum("ncij,nci->ncj", np.asarray(pose.rotation), np.asarray(pose.translation))
    np.testing.assert_allclose(places.std(axis=0), 0.010, rtol=0.05)
    np.testing.assert_allclose((np.asarray(many.focal) / np.asarray(cameras.focal)).std(axis=0), 0.004, rtol=0.05)
    turns = np.einsum("ncij,ckj->ncik", np.asarray(pose.rotation), np.asarray(cameras.cam_from_world.rotation))
    np.testing.assert_allclose(turns[:, :, 0, 1].std(axis=0), np.deg2rad(0.1), rtol=0.05)


def test_intervals_are_over_people():
    rng = np.random.default_rng(0)
    who = np.repeat(np.arange(25), 400)
    values = rng.normal(size=25)[who] + 0.1 * rng.normal(size=len(who))
    mean, low, high = mean_of(values, who, 0)
    assert low < mean < high
    assert (high - low) / (2 * 1.96) == pytest.approx(0.2, rel=0.35)  # 1 / sqrt(25), not 1 / sqrt(10,000)
    assert np.ptp(median_of(values, who, 0)[1:]) > 0.3


def test_detection_rates_ask_for_two_right_views(tmp_path):
    def views(gesture, right, finger="no_cap"):
        return [
            {"seed": 1, "gesture": gesture, "frame": 0, "default": "right" if k < right else "wrong", "visible": 0.9,
             "angle_deg": 80.0 if k < 3 else 10.0, "thesis": "none", "thesis_finger": finger}
            for k in range(4)
        ]  # fmt: skip

    rows = [*views(0, 4), *views(1, 1), *views(2, 2, "right"), *views(3, 0)]
    (tmp_path / "seed_1.json").write_text(json.dumps({"views": rows, "gestures": []}))
    rates = ablation.detection_rates(tmp_path)
    # Of four gestures with three good views each: three, none, one and no pair of both right.
    assert rates["default"] == ablation.Rate(100 * 4 / 12, 12, 50.0, 4)
    assert rates["thesis"] == ablation.Rate(0.0, 12, 0.0, 4)
    assert rates["thesis_finger"] == ablation.Rate(100.0, 3, 100.0, 1)
    with pytest.raises(SystemExit, match="0 files"):
        ablation.detection_rates(tmp_path / "elsewhere")


@pytest.mark.parametrize(
    ("extent", "message"),
    [
        ({"rooms": 0}, "--rooms is 0; it must be 1 at least"),
        ({"objects": 0}, "--objects is 0"),
        ({"draws": -1}, "--draws is -1"),
        ({"people": 1, "rooms": 1}, "1 person in all cannot be fitted and scored too"),
    ],
)
def test_too_little_to_score_is_refused_in_a_sentence(tmp_path, extent, message):
    with pytest.raises(SystemExit, match=message):
        ablation.main(ablation.PointingAblation(out=tmp_path / "out", **extent))
    assert not list(tmp_path.iterdir())


def row(section: str, value: float) -> Row:
    told: dict[str, Any] = dict.fromkeys((field.name for field in fields(Row)), 1.0)
    return Row(**told | {"section": section, "line": "forearm", "method": "planes", "people": "approximate",
                         "views": "all", "correction": "constant", "varied": "noise", "value": value})  # fmt: skip


def test_a_sweep_without_pointings_is_drawn_as_such():
    rows = [row(section, value) for section, _ in SWEEPS if section != "distance" for value in (1.0, 2.0)]
    figure = draw_sweeps(rows)
    empty = [axes.get_title() for axes in figure.axes if any("too few" in text.get_text() for text in axes.texts)]
    assert empty == ["Distance"]


def test_rows_say_what_they_were_made_with(tmp_path):
    options = ablation.PointingAblation(rooms=2, people=4, gestures=3)
    ablation.write_rows(tmp_path / "table.csv", [row("views", 2.0)], options)
    with (tmp_path / "table.csv").open() as file:
        (told,) = csv.DictReader(file)
    assert (told["rooms"], told["people_a_room"], told["gestures_a_person"]) == ("2", "4", "3")


@pytest.mark.parametrize("count", [3, 10])
def test_as_many_pointings_are_claimed_as_drawn(monkeypatch, count):
    errors = np.arange(30.0), np.arange(1.0, count + 1)
    monkeypatch.setattr("pointing_pictures.absolute", lambda *_: errors)
    axes = draw_lines(cast(Any, None)).axes[0]
    assert axes.get_title() == f"Azimuth error, {count} pointings"
    assert len(axes.get_xticks()) == count
