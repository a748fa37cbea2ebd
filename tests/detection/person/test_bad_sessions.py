"""Sessions that are spoilt in one camera: what is read of them says so, and the other cameras are not touched."""

import contextlib

import bad_sessions as bad
import cv2
import numpy as np
import pytest

from jaxpoint.config.person import PersonSettings
from jaxpoint.detection.person.silhouette import learn_background
from jaxpoint.detection.person.watcher import Look, PersonWatch
from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.evidence.camera_evidence import FrameReason
from jaxpoint.io.calibration import write_calibration_json
from jaxpoint.io.session import open_session
from jaxpoint.io.video import open_frames

FRAMES = 24
SIZE = (160, 120)
CAMERAS = ("cam_0", "cam_1", "cam_2")


def room(camera: int) -> np.ndarray:
    """An empty wall with some texture and colour."""
    rng = np.random.default_rng(camera)
    coarse = rng.integers(60, 160, (SIZE[1] // 8, SIZE[0] // 8, 3)).astype(np.uint8)
    return np.kron(coarse, np.ones((8, 8, 1), np.uint8))


def images(camera: int) -> list[np.ndarray]:
    """Somebody in blue crosses it."""
    rng = np.random.default_rng(10 + camera)
    frames = []
    for k in range(FRAMES):
        image = np.clip(room(camera) + rng.normal(0, 2, (SIZE[1], SIZE[0], 3)), 0, 255).astype(np.uint8)
        image[40:115, 10 + 5 * k : 30 + 5 * k] = (220, 40, 20)
        frames.append(image)
    return frames


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    folder = tmp_path_factory.mktemp("session") / "good"
    return bad.good_session(folder, {name: images(i) for i, name in enumerate(CAMERAS)})


def looks(folder, camera: str, background: np.ndarray | None = None, noise: int = 3) -> list[Look]:
    """What a watch of one camera says of every frame; the background is that of its empty room, if not given.

    Its noise is that of each of three channels, or one for all.
    """
    rng = np.random.default_rng(99)
    alone = (room(CAMERAS.index(camera)) if background is None else background).astype(float)
    empty = [np.clip(alone + rng.normal(0, 2, (*alone.shape[:2], noise)), 0, 255).astype(np.uint8) for _ in range(20)]
    settings = PersonSettings()
    watch = PersonWatch(learn_background(empty, settings.background), 20.0, 150.0, settings)
    source = open_frames(folder / "videos" / f"{camera}.avi")
    return [watch.look(image) for _, image in source.stream()]


def reasons(folder, camera: str) -> list[FrameReason]:
    """The reasons alone."""
    return [look.reason for look in looks(folder, camera)]


def test_a_good_session_has_nothing_to_tell(good):
    session = open_session(good)
    assert session.names == CAMERAS
    assert session.notes == ()
    np.testing.assert_array_equal(session.frame_index, np.tile(np.arange(FRAMES)[:, None], 3))
    assert reasons(good, "cam_1") == [FrameReason.PERSON] * FRAMES


@pytest.mark.parametrize(
    ("spoil", "note"),
    [
        (bad.stops, f"Camera 'cam_1' stops early, with no image in {FRAMES // 2} of {FRAMES} frames"),
        (bad.dropped, f"Camera 'cam_1' has no image in 3 of {FRAMES} frames"),
        (bad.shorter, f"'cam_1' has {FRAMES // 2} frames, others up to {FRAMES}"),
        (bad.other_rate, "unlike frame rates"),
    ],
)
def test_what_is_missing_is_told(good, tmp_path, spoil, note):
    session = open_session(spoil(good, tmp_path / "bad", "cam_1"))
    assert any(note in told for told in session.notes), session.notes
    others = [0, 2]
    whole = session.frame_index[:, others]
    step = 2 if spoil is bad.other_rate else 1
    np.testing.assert_array_equal(whole, np.tile(np.arange(0, FRAMES, step)[:, None], 2))


def test_dropped_frames_leave_the_others_in_step(good, tmp_path):
    lost = (3, 4, 9)
    session = open_session(bad.dropped(good, tmp_path / "bad", "cam_1", lost))
    np.testing.assert_array_equal(np.flatnonzero(session.frame_index[:, 1] < 0), lost)
    source = open_frames(session.videos[1])
    kept = images(1)
    for frame in (2, 5, 12):  # the same picture as in the good session, up to the compression
        image = source.read(int(session.frame_index[frame, 1]))
        assert np.abs(image.astype(int) - kept[frame]).mean() < 6
        assert np.abs(image.astype(int) - kept[frame - 2]).mean() > 6


def test_a_drifting_clock_is_told(good, tmp_path):
    assert open_session(bad.drifting(good, tmp_path / "slow", "cam_1", 1.001)).notes == ()
    (note,) = open_session(bad.drifting(good, tmp_path / "fast", "cam_1", 1.05)).notes
    assert "clock of camera 'cam_1' drifts by +92 ms" in note


def test_an_empty_file_is_an_error(good, tmp_path):
    with pytest.raises(FileFormatError, match="0 frames"):
        open_session(bad.empty_file(good, tmp_path / "bad", "cam_1"))


def test_a_file_that_is_cut_off_gives_what_it_has(good, tmp_path):
    session = open_session(bad.cut_off(good, tmp_path / "bad", "cam_1"))
    source = open_frames(session.videos[1])
    read = []
    with contextlib.suppress(FileFormatError):  # said by whoever reads on
        for k, _ in source.stream():
            read.append(k)
    assert 0 < len(read) < FRAMES


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [(bad.dark, FrameReason.TOO_DARK), (bad.blown_out, FrameReason.BLOWN_OUT)],
)
def test_spoilt_exposure_is_the_reason_of_every_frame(good, tmp_path, spoil, reason):
    assert reasons(spoil(good, tmp_path / "bad", "cam_1"), "cam_1") == [reason] * FRAMES


def test_repeated_frames_are_known(good, tmp_path):
    told = reasons(bad.doubled(good, tmp_path / "bad", "cam_1", (3, 9)), "cam_1")
    assert [k for k, reason in enumerate(told) if reason == FrameReason.REPEATED] == [4, 10]


def test_grey_images_still_show_a_person(good, tmp_path):
    folder = bad.grey(good, tmp_path / "bad", "cam_1")
    monochrome = np.repeat(cv2.cvtColor(room(1), cv2.COLOR_BGR2GRAY)[..., None], 3, axis=2)
    told = looks(folder, "cam_1", monochrome, noise=1)
    assert all(look.grey and look.reason == FrameReason.PERSON for look in told)
    assert open_session(folder).notes == ()


def test_grey_images_are_left_out_where_the_empty_room_has_colour(good, tmp_path):
    """All of them would differ from it."""
    told = looks(bad.grey(good, tmp_path / "bad", "cam_1"), "cam_1")
    assert all(look.reason == FrameReason.WITHOUT_COLOUR and not look.sightings for look in told)


def test_an_empty_room_shows_nobody(good, tmp_path):
    told = reasons(bad.nobody(good, tmp_path / "bad", "cam_1"), "cam_1")
    assert set(told) <= {FrameReason.NOBODY, FrameReason.IDLE}


def test_who_is_half_out_of_view_touches_the_border(good, tmp_path):
    folder = bad.half_out_of_view(good, tmp_path / "bad", "cam_1")
    shown = [image for _, image in open_frames(folder / "videos" / "cam_1.avi").stream()]
    told = looks(folder, "cam_1", np.median(np.stack(shown), axis=0))
    boxes = {k: look.sightings[0].silhouette for k, look in enumerate(told) if look.sightings}
    assert not boxes[6].at_border
    assert boxes[12].at_border  # its left edge is at x = 150 of 160


def test_videos_of_another_size_than_the_calibration_are_refused(good, tmp_path, solved_room):
    _, calibration = solved_room
    rig = calibration.rig.select([0, 1, 2])
    folder = bad.other_size(good, tmp_path / "bad", "cam_1")
    write_calibration_json(folder / "calibration.json", rig)
    with pytest.raises(UsageError, match=r"is \d+ x \d+ px, but"):
        open_session(folder)
