"""What is kept of a camera's views: the same when it is read back, and never what is not whole."""

from dataclasses import fields

import numpy as np
import pytest

from jaxpoint.config.person import PersonSettings
from jaxpoint.detection.person.silhouette import learn_background
from jaxpoint.detection.person.silhouette_views import load_views, save_views, watch
from jaxpoint.detection.person.watcher import PersonWatch
from jaxpoint.errors import FileFormatError
from jaxpoint.evidence.camera_evidence import FrameReason

SIZE = (320, 240)


def images(count: int, person: bool) -> list[np.ndarray]:
    """A wall, and a block with a head before it that moves."""
    rng = np.random.default_rng(1)
    rows, columns = np.mgrid[: SIZE[1], : SIZE[0]]
    shots = []
    for k in range(count):
        x = 100 + 6 * k
        body = (np.abs(columns - x) < 20) & (rows > 78) | (np.hypot(columns - x, rows - 70) < 16)
        scene = np.where((body & person)[..., None], (60, 90, 160), (150, 140, 130))
        shots.append(np.clip(scene + rng.normal(0, 2, scene.shape), 0, 255).astype(np.uint8))
    return shots


@pytest.fixture(scope="module")
def views():
    settings = PersonSettings()
    background = learn_background(images(20, person=False), settings.background)
    watcher = PersonWatch(background, 12.0, 280.0, settings)
    shots = images(5, person=True)
    frames = [(0, shots[0]), (1, shots[1]), (2, shots[1]), (3, None), (4, shots[4])]
    return watch(frames, 6, SIZE, watcher, notes=["a note"])


def test_every_frame_has_its_reason(views):
    wanted = [FrameReason.PERSON, FrameReason.PERSON, FrameReason.REPEATED, FrameReason.NO_IMAGE, FrameReason.PERSON]
    assert views.reasons.tolist() == [*wanted, FrameReason.NO_IMAGE]
    assert [len(views.of(frame)) for frame in range(6)] == [1, 1, 0, 0, 1, 0]


def test_the_crop_holds_the_person_and_nothing_else(views):
    crop = views.person(0).crop
    x, y = crop.corner
    rows, columns = np.nonzero(crop.labels)
    middle = np.array([columns.mean() + x, rows.mean() + y])
    np.testing.assert_allclose(middle, views.centroid[0], atol=2)
    assert abs(np.count_nonzero(crop.labels) / views.area[0] - 1) < 0.1
    assert crop.labels[0].any()
    assert crop.labels[-1].any()


def test_read_back_it_is_the_same(views, tmp_path):
    save_views(tmp_path / "kept.npz", views)
    again = load_views(tmp_path / "kept.npz")
    for field in fields(views):
        np.testing.assert_array_equal(getattr(again, field.name), getattr(views, field.name), err_msg=field.name)


@pytest.mark.parametrize("content", [b"", b"nothing of ours", b"PK\x03\x04 cut off"])
def test_other_files_are_refused(tmp_path, content):
    path = tmp_path / "kept.npz"
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match="delete it"):
        load_views(path)


def test_a_file_cut_off_in_the_middle_is_refused(views, tmp_path):
    path = tmp_path / "kept.npz"
    save_views(path, views)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(FileFormatError, match="delete it"):
        load_views(path)
