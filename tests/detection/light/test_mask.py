"""Masks: where no light is looked for."""

import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from jaxpoint import LedSettings, detect_led
from jaxpoint.detection.light.led import Reason
from jaxpoint.detection.light.mask import mask_files, read_mask
from jaxpoint.errors import FileFormatError, UsageError
from jaxpoint.io.session import recordings
from jaxpoint.report.light_crops import HIDDEN, contact_sheet, mask_overview

ALONE = LedSettings(workers=1, min_frames=30)
WINDOW = np.s_[10:70, 100:150]


@pytest.fixture(scope="module")
def folder(tmp_path_factory, drawing):
    """A light on its way, and beside it a brighter one that blinks in a window at (120, 40); `masks` hides that."""
    root = tmp_path_factory.mktemp("masked")
    rng = np.random.default_rng(5)
    (root / "cam_0").mkdir()
    for k in range(60):
        blink = drawing.light(120, 40, 200.0) if k % 2 else 0.0
        image = drawing.image(drawing.light(20 + k, 60 + 0.4 * k, 120.0) + blink, rng)
        cv2.imwrite(str(root / "cam_0" / f"{k:03d}.png"), image)
    shutil.copytree(root / "cam_0", root / "cam_1")
    return root


def draw_mask(folder, name="cam_0", size=(160, 120), hidden=WINDOW):
    folder.mkdir(exist_ok=True)
    mask = np.full(size[::-1], 255, np.uint8)
    mask[hidden] = 0
    cv2.imwrite(str(folder / f"{name}.png"), mask)
    return folder


def test_a_masked_reflection_is_never_the_light(folder, tmp_path):
    sources = [folder / "cam_0", folder / "cam_1"]
    detection = detect_led(sources, replace(ALONE, masks=draw_mask(tmp_path / "m")))
    taken = np.linalg.norm(detection.tracks.pixels - (120, 40), axis=2) < 3
    assert taken.sum(axis=0).tolist() == [0, 30]
    assert detection.tracks.visible[:, 0].all()
    pixels = detection.tracks.pixels[detection.tracks.visible[:, 0], 0]
    np.testing.assert_allclose(pixels[:, 0], 20 + np.arange(60), atol=0.5)
    assert detection.masks == (tmp_path / "m" / "cam_0.png", None)
    overview = mask_overview(detection, 0)
    assert (overview == HIDDEN).all(axis=2).mean() == pytest.approx(60 * 50 / (160 * 120) / 2, rel=0.1)
    assert mask_overview(detection, 1) is None


def test_a_glow_that_reaches_over_the_edge_of_a_mask_is_no_light(folder, tmp_path):
    """The mask is drawn too small: the brightest pixel that it leaves touches it."""
    small = draw_mask(tmp_path / "m", hidden=np.s_[30:50, 121:160])
    detection = detect_led([folder / "cam_0"], replace(ALONE, masks=small))
    assert detection.reasons[1::2, 0].tolist() == [Reason.AT_BORDER] * 30
    (crop,) = [crop for crop in contact_sheet(detection, 0, per_reason=1) if crop.reason == Reason.AT_BORDER]
    assert (crop.image == HIDDEN).all(axis=2).any()


def test_masks_lie_beside_the_recordings_and_are_no_camera(folder, tmp_path):
    for camera in ("cam_0", "cam_1"):
        (tmp_path / camera).mkdir()
        cv2.imwrite(str(tmp_path / camera / "0.png"), np.zeros((120, 160), np.uint8))
    draw_mask(tmp_path / "masks", "cam_1")
    sources = [tmp_path / "cam_0", tmp_path / "cam_1"]
    assert mask_files(None, sources, ("cam_0", "cam_1")) == (None, tmp_path / "masks" / "cam_1.png")
    assert mask_files(None, sources[:1], ("cam_0",)) == (None,)  # the mask of a camera that is not looked at
    assert list(recordings(tmp_path)) == ["cam_0", "cam_1"]
    assert mask_files(None, [folder / "cam_0"], ("cam_0",)) == (None,)
    draw_mask(tmp_path / "masks", "cam_2")
    with pytest.raises(UsageError, match=r"cam_2\.png' belongs to no camera; the cameras are cam_0, cam_1"):
        mask_files(None, sources, ("cam_0", "cam_1"))
    with pytest.raises(UsageError, match=r"'.*masks' holds masks"):
        detect_led([*sources, tmp_path / "masks"], ALONE)


def test_masks_that_cannot_be_used(folder, tmp_path):
    sources = [folder / "cam_0"]
    with pytest.raises(UsageError, match="no folder of masks"):
        mask_files(tmp_path / "none", sources, ("cam_0",))
    (tmp_path / "m").mkdir()
    with pytest.raises(UsageError, match="holds no masks"):
        mask_files(tmp_path / "m", sources, ("cam_0",))
    draw_mask(tmp_path / "m", size=(80, 60))
    with pytest.raises(FileFormatError, match="is 80 x 60 px but the camera's images are 160 x 120"):
        detect_led(sources, replace(ALONE, masks=tmp_path / "m"))
    draw_mask(tmp_path / "m", hidden=np.s_[:, :])
    with pytest.raises(FileFormatError, match="black all over"):
        read_mask(tmp_path / "m" / "cam_0.png", (160, 120))
    cv2.imwrite(str(tmp_path / "m" / "cam_0.jpg"), np.full((120, 160), 255, np.uint8))
    with pytest.raises(FileFormatError, match="are masks of one camera"):
        mask_files(tmp_path / "m", sources, ("cam_0",))
