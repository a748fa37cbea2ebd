"""The light in the dark: where it is seen, where its mirror images are, and that the detector finds it."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.optimize import brentq, minimize

from jaxpoint.config import LedSettings
from jaxpoint.config.people import PeopleSettings
from jaxpoint.config.simulation import SimulationSettings, ViewpointSettings, WaveSettings
from jaxpoint.detection.light.led import detect_led
from jaxpoint.errors import UsageError
from jaxpoint.simulate.capsules import Capsule
from jaxpoint.simulate.simulated_session import simulate_session
from jaxpoint.simulate.wave import mirrored, simulate_wave

SETTINGS = SimulationSettings(
    empty_frames=0,
    viewpoints=ViewpointSettings(cameras=2, size=(480, 270)),
    wave=WaveSettings(frames=110),
    people=PeopleSettings(play="empty"),
)


@pytest.fixture(scope="module")
def wave():
    return simulate_wave(simulate_session(SETTINGS, 4))


def test_the_light_goes_smoothly_through_the_room(wave):
    assert wave.light.shape == (110, 3)
    assert (wave.light > 0).all()
    assert (wave.light < wave.session.scene.size).all()
    assert np.linalg.norm(np.diff(wave.light, axis=0), axis=1).max() < 0.5
    assert np.ptp(wave.light, axis=0).min() > 1.0


def test_the_detector_finds_the_light_where_the_rig_projects_it(wave, tmp_path):
    expected = np.asarray(wave.session.rig.project(wave.light))
    for frame in range(wave.frames):
        cv2.imwrite(str(tmp_path / f"{frame:03d}.png"), wave.image(frame, 0))
    found = detect_led([tmp_path], LedSettings(workers=1)).tracks
    shown = np.array([wave.visible(frame, 0) for frame in range(wave.frames)])
    seen = found.visible[:, 0]
    assert shown.sum() > 40
    assert (seen & shown).sum() > 0.8 * shown.sum()
    assert (seen & ~shown).sum() < 0.05 * wave.frames
    away = np.linalg.norm(found.pixels[:, 0] - expected[:, 0], axis=1)
    assert np.median(away[seen & shown]) < 0.3


def test_a_rolling_shutter_shows_the_light_where_it_is_when_its_row_is_read(wave):
    """The row of the pixel and the moment of the light agree, by a root search of our own test."""
    rolling = replace(SETTINGS, wave=replace(SETTINGS.wave, readouts=((0, 0.9), (1, -0.6))))
    session = replace(wave.session, settings=rolling)
    shown = simulate_wave(session)
    moved = 0.0
    for camera, readout in ((0, 0.9), (1, -0.6)):
        view = session.viewpoints[camera]

        def ahead(moment, frame, view=view, readout=readout):
            row = view.project(shown.path(np.array([moment])))[0][0, 1]
            return moment - frame - readout * (row / 270 - 0.5)

        for frame in range(10, 100, 15):
            if not wave.visible(frame, camera):
                continue
            moment = brentq(ahead, frame - 0.5, frame + 0.5, (frame,))
            np.testing.assert_allclose(shown.shown(frame, camera), shown.path(np.array([moment]))[0], atol=2e-5)
            moved = max(moved, float(np.linalg.norm(shown.shown(frame, camera) - wave.light[frame])))
    assert moved > 0.02  # m
    np.testing.assert_array_equal(shown.light, wave.light)
    with pytest.raises(UsageError, match="a readout of camera 2, but there are 2 cameras"):
        simulate_wave(replace(session, settings=replace(rolling, wave=WaveSettings(readouts=((2, 0.5),)))))


def test_a_mirror_shows_the_light_by_the_shortest_way():
    corners = np.array([(1.0, 2.0, 1.5), (2.5, 2.2, 1.5), (1.0, 2.0, 0.5), (2.5, 2.2, 0.5)])
    eye, light = np.array([1.2, 0.2, 1.4]), np.array([2.4, 0.5, 0.7])
    across, down = corners[1] - corners[0], corners[2] - corners[0]

    def way(uv):
        place = corners[0] + uv[0] * across + uv[1] * down
        return np.linalg.norm(place - eye) + np.linalg.norm(light - place)

    best = minimize(way, [0.5, 0.5], tol=1e-12).x
    np.testing.assert_allclose(
        mirrored(corners, eye, light), corners[0] + best[0] * across + best[1] * down, atol=0.006
    )
    assert mirrored(corners, eye, light + np.array([0.0, 4.0, 0.0])) is None  # behind the mirror
    assert mirrored(corners, eye, light + np.array([9.0, 0.0, 0.0])) is None  # beside it


def test_a_capsule_hides_what_lies_behind_it():
    rng = np.random.default_rng(0)
    capsule = Capsule(np.array([0.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]), 0.2)
    along = np.linspace(0.0, 1.0, 400)[:, None]
    hidden = 0
    for _ in range(200):
        eye, point = rng.uniform(-1.5, 1.5, (2, 3))
        ray = eye + along * (point - eye)
        away = np.linalg.norm(ray - np.clip(ray @ [0, 0, 1.0], 0.0, 1.0)[:, None] * [0, 0, 1.0], axis=1).min()
        if abs(away - 0.2) > 0.01:
            assert capsule.hides(eye, point) == (away < 0.2)
            hidden += away < 0.2
    assert 10 < hidden < 190


def test_a_capsule_is_closed_and_looks_outwards():
    mesh = Capsule(np.array([0.1, 0.2, 0.3]), np.array([0.5, 0.1, 0.9]), 0.1).mesh(np.ones(3))
    a, b, c = (mesh.vertices[mesh.triangles[:, i]] for i in range(3))
    volume = np.einsum("tc,tc->t", a, np.cross(b, c)).sum() / 6
    length = np.linalg.norm([0.4, -0.1, 0.6])
    assert volume == pytest.approx(np.pi * 0.01 * length + 4 / 3 * np.pi * 0.001, rel=0.05)
