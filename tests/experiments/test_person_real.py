"""The detectors on real video: who never leaves is noticed, and a given room shows him, his head and his arm."""

from itertools import islice

import numpy as np
import pytest

from jaxpoint.detection.person.silhouette import never_clears
from jaxpoint.io.video import open_frames
from person_balancing import is_forearm, joint_track, looked_at, still
from person_pictures import SETTINGS, read_video
from pose2sim import read_labels, video_rig

CAMERA = 3  # cam04


@pytest.fixture(scope="module")
def folder(data_folder):
    return data_folder / "pose2sim_single"


@pytest.fixture(scope="module")
def images(folder):
    return read_video(folder / "videos" / "cam04.mp4")


def test_one_who_never_leaves_is_told_from_those_who_pass(images, data_folder):
    stays = never_clears(images[::5], SETTINGS.background)
    assert stays > 0.2
    street = open_frames(data_folder / "opencv_vtest" / "vtest.avi").stream()
    passing = [image for _, image in islice(street, 0, 400, 16)]
    assert never_clears(passing, SETTINGS.background) < 0.05


def test_a_given_room_shows_the_man_and_his_head(folder, images):
    rig = video_rig(folder)
    cap = joint_track(rig, read_labels(), "cap")
    chosen = np.arange(0, 100, 10)
    wanted = np.asarray(rig.project(cap))[chosen, CAMERA]
    focal = float(rig.cameras.focal[CAMERA, 0])
    scale = focal / np.asarray(rig.depth(cap))[chosen, CAMERA]  # px a metre
    room = still(folder, "cam04", images)
    found = looked_at([images[k] for k in chosen], "given", room, focal, wanted)
    assert all(one is not None and one[1].found for one in found)
    off = np.array([np.hypot(one[1].x - x, one[1].y - y) for one, (x, y) in zip(found, wanted)]) / scale
    assert np.median(off) < 0.05
    assert (off < 0.15).sum() >= 9
    # A man of about 1.8 m with one leg up: his silhouette is as large as he is.
    area = np.array([one[0].region.area for one in found]) / scale**2
    assert ((area > 0.4) & (area < 1.1)).all(), area


def test_a_region_along_a_forearm():
    elbow, wrist = np.array([100.0, 100.0]), np.array([160.0, 40.0])  # up to the right: 45 degrees with y up
    assert is_forearm(np.array([130.0, 70.0]), np.pi / 4, elbow, wrist)
    assert is_forearm(np.array([130.0, 70.0]), np.pi / 4, wrist, elbow)
    assert not is_forearm(np.array([130.0, 70.0]), -np.pi / 4, elbow, wrist)
    assert not is_forearm(np.array([190.0, 70.0]), np.pi / 4, elbow, wrist)
