"""The session that lies in the package: small, whole, and made by the settings that it names."""

from importlib.resources import as_file, files

import numpy as np
import pytest

from jaxpoint.io.session import open_session, recordings
from jaxpoint.io.video import open_frames


@pytest.fixture(scope="module")
def folder():
    with as_file(files("jaxpoint") / "data" / "session") as folder:
        yield folder


def test_it_is_small_and_whole(folder):
    assert sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) < 8e6
    session = open_session(folder)
    assert len(session.names) == 6
    assert session.rig is not None
    for camera, video in enumerate(session.videos):
        images = sum(1 for _ in open_frames(video).stream())
        assert images == (session.frame_index[:, camera] >= 0).sum()
    assert len((folder / "truth" / "gestures.csv").read_text().splitlines()) == 1 + 8
    assert len((folder / "objects.csv").read_text().splitlines()) > 20


def test_its_light_is_bright_where_it_is_projected(folder):
    rig = open_session(folder).rig
    light = np.loadtxt(folder / "truth" / "light.csv", delimiter=",", skiprows=1)[:, 1:]
    seen = 0
    for camera, name in enumerate(rig.names):
        pixels = np.asarray(rig.project(light))[:, camera]
        for frame, image in open_frames(recordings(folder / "wave")[name]).stream(np.arange(0, len(light), 20)):
            y, x = np.unravel_index(np.argmax(image[..., 2]), image.shape[:2])
            seen += np.hypot(*(pixels[frame] - (x, y))) < 3
    assert seen > 0.5 * 6 * len(range(0, len(light), 20))
