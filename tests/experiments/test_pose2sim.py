"""The real recording pose2sim_single: its cameras put right by the still room, and the joints seen by eye."""

import numpy as np
import pytest

from pose2sim import (
    JOINTS,
    Labels,
    fitted_shifts,
    located,
    missed,
    moved,
    read_labels,
    read_places,
    still_rig,
    video_rig,
)


@pytest.fixture(scope="module")
def folder(data_folder):
    return data_folder / "pose2sim_single"


@pytest.fixture(scope="module")
def rig(folder):
    return video_rig(folder)


def lengths(errors: np.ndarray, labels: Labels) -> np.ndarray:
    return np.linalg.norm(errors, axis=-1)[labels.seen]


def stacked(joints: tuple[str, ...] = JOINTS) -> Labels:
    found = [labels for (_, joint), labels in sorted(read_labels().items()) if joint in joints]
    return Labels(
        tuple(labels.names[0] for labels in found),
        np.concatenate([labels.pixels for labels in found]),
        np.concatenate([labels.seen for labels in found]),
    )


def test_a_shift_a_camera_makes_the_still_room_agree(folder):
    calibrated, places = still_rig(folder), read_places()
    shifts = fitted_shifts(calibrated, places)
    assert np.median(lengths(missed(calibrated, places), places)) > 9
    assert np.median(lengths(missed(moved(calibrated, shifts), places), places)) < 1
    # Half of the places tell the same as the other half: the images are moved, and not the places chosen to fit.
    for half in (slice(0, None, 2), slice(1, None, 2)):
        some = Labels(places.names[half], places.pixels[half], places.seen[half])
        np.testing.assert_allclose(fitted_shifts(calibrated, some), shifts, atol=4)


def test_joints_seen_by_eye_agree_over_the_views(rig, folder):
    labels = stacked()
    assert len(labels.names) == 100
    assert labels.seen.sum() == 382
    errors = lengths(missed(rig, labels), labels)
    # The still room put the cameras right; no label took part in that.
    assert np.median(errors) < 3.5
    assert np.quantile(errors, 0.9) < 6.5
    assert errors.max() < 12
    caps = stacked(("cap",))
    assert np.median(lengths(missed(rig, caps), caps)) < 2.6


@pytest.mark.parametrize(("side", "spread"), [("left", 0.010), ("right", 0.016)])
def test_the_forearm_keeps_its_length(rig, side, spread):
    ends = []
    for joint in (f"{side}_elbow", f"{side}_wrist"):
        found = located(rig, stacked((joint,)))
        ends.append(np.where(np.asarray(found.valid)[:, None], np.asarray(found.points), np.nan))
    length = np.linalg.norm(ends[0] - ends[1], axis=1)
    assert np.isfinite(length).sum() >= 19
    assert 0.24 < np.nanmean(length) < 0.28  # m, of a grown man
    assert np.nanstd(length) < spread
