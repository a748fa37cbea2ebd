"""The benchmark of the person's detectors: that it times every stage on frames with a person, and says so."""

import numpy as np
import person as benchmark
import pytest

from jaxpoint.config.person import PersonSettings, thesis_person
from jaxpoint.detection.person.silhouette import learn_background

SETTINGS = PersonSettings(), thesis_person()


@pytest.fixture(scope="module")
def view():
    """A block with a head before a plain wall."""
    rng = np.random.default_rng(0)
    room = np.full((180, 240, 3), (150, 140, 130), np.float32)
    rows, columns = np.mgrid[:180, :240]
    body = (np.abs(columns - 120) < 18) & (rows > 70) | (np.hypot(columns - 120, rows - 55) < 14)

    def shot(scene):
        return np.clip(scene + rng.normal(0, 2, scene.shape), 0, 255).astype(np.uint8)

    empty = [shot(room) for _ in range(20)]
    backgrounds = tuple(learn_background(empty, settings.background) for settings in SETTINGS)
    return benchmark.View(empty[-1], shot(np.where(body[..., None], (60, 40, 150), room)), backgrounds, 200.0)


def test_every_stage_of_both_methods_has_its_row(view):
    timed = benchmark.timed(view, SETTINGS)
    for frame in timed:
        assert {"motion", "foreground", "silhouettes", "heads", "skin", "together"} <= frame.keys()
        assert all(seconds > 0 for seconds in frame.values())
        assert frame["together"] > frame["foreground"] / 3
    text = benchmark.markdown([("default", timed[0], timed[0]), ("thesis", timed[1])], view.image.shape)
    assert text.startswith("240 x 180 px, one thread")
    assert text.count("\n| default |") == len(timed[0])
    assert text.count("\n| thesis |") == len(timed[1])


def test_figures_are_of_all_frames():
    frames = [{"motion": 0.001 * ms} for ms in (1, 2, 3, 4, 10)]
    assert "| default | motion | 1.0 | 3.0 | 8.8 |" in benchmark.markdown([("default", *frames)], (720, 1280, 3))
