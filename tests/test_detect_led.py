"""`jaxpoint detect led` on recordings as they come: videos of unlike rates, deep images, names, masks."""

import json
import os
import re
import shutil
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest
from videos import write_stamped

from jaxpoint.cli import main
from jaxpoint.commands.detect_led import REMEDIES
from jaxpoint.detection.light.blob import Reason
from jaxpoint.io.track_files import load_tracks

SIZE = (160, 120)


def cases():
    """The folder of small inputs that users' situations led to."""
    folder = Path(os.environ.get("JAXPOINT_DATA", "none")).parent / "cases"
    if not folder.is_dir():
        pytest.skip("The small cases do not lie beside the folder that JAXPOINT_DATA names.")
    return folder


def run(capsys, *words):
    code = main(["detect", "led", *map(str, words), "--workers", "1"])
    out, err = capsys.readouterr()
    return code, " ".join(out.split()), " ".join(err.split())


def path_px(seconds):
    """A light on its way, px."""
    return np.stack([80 + 55 * np.cos(3.1 * seconds), 60 + 40 * np.sin(5.0 * seconds)], axis=-1)


def picture(seconds, rng):
    (x, y), (rows, columns) = path_px(seconds), np.mgrid[: SIZE[1], : SIZE[0]]
    light = 170 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * 1.5**2))
    image = 30 + light[..., None] * (0.3, 1.0, 0.3) + rng.normal(0, 1.5, (*SIZE[::-1], 3))
    return np.clip(image, 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def videos(tmp_path_factory):
    """Four seconds: usual, with dropped frames, at 29.83 frames a second, and with pixels of 16/15."""
    root, rng = tmp_path_factory.mktemp("videos"), np.random.default_rng(0)
    usual = np.arange(120) / 30
    times = {
        "usual": usual,
        "drops": np.delete(usual, [10, 11, 40, 90]),
        "slow": np.arange(119) / 29.83,
        "pal": usual,
        "short": usual[:110],
    }
    for name, own in times.items():
        aspect = Fraction(16, 15) if name == "pal" else None
        write_stamped(root / f"{name}.mp4", [picture(time, rng) for time in own], own, aspect)
    return root


def errors(tracks):
    """Distance from the light at the time of each row, px; NaN where it was not found."""
    distance = np.linalg.norm(tracks.pixels - path_px(tracks.times)[:, None], axis=2)
    return np.where(tracks.visible, distance, np.nan)


def test_videos_are_paired_by_their_time_stamps(videos, tmp_path, capsys):
    given = [videos / f"{name}.mp4" for name in ("usual", "drops", "slow", "pal")]
    code, out, _ = run(capsys, *given, "--out", tmp_path / "t.npz")
    assert code == 0
    assert "paired by the time stamps of the videos" in out
    assert "The time stamps of 'drops' skip 4 frames; they stay gaps." in out
    assert "unlike frame rates" in out
    tracks = load_tracks(tmp_path / "t.npz")
    np.testing.assert_allclose(tracks.times, np.arange(120) / 30, atol=1e-3)
    assert (~tracks.visible[:, 1]).nonzero()[0].tolist() == [10, 11, 40, 90]
    assert tracks.visible.sum(axis=0).min() >= 116
    assert np.nanmedian(errors(tracks), axis=0).max() < 0.2
    assert np.nanmax(errors(tracks)) < 1  # the nearest frame of 29.83 would be 5 px off
    np.testing.assert_allclose(tracks.pixel_aspects, [1, 1, 1, 16 / 15])


def test_videos_whose_lengths_contradict_are_refused(videos, tmp_path, capsys):
    given = [videos / "usual.mp4", videos / "short.mp4", "--out", tmp_path / "t.npz"]
    code, _, err = run(capsys, *given)
    assert code == 4
    assert "'short' has 110 frames, others up to 120" in err
    assert "--pair-by time" in err
    code, out, _ = run(capsys, *given, "--pair-by", "time")
    assert code == 0
    assert "taken to have started at once" in out


@pytest.mark.parametrize("bits", [10, 12])
def test_deep_images_are_no_dark_ones(bits, tmp_path, capsys):
    folder = cases() / "12-deep-images"
    given = [folder / f"mono{bits}" / f"cam{camera}" for camera in range(2)]
    code, out, _ = run(capsys, *given, "--min-frames", 12, "--out", tmp_path / "t.npz", "--json")
    assert code == 0
    assert [camera["found"] for camera in json.loads(out)["cameras"]] == [12, 12]
    tracks = load_tracks(tmp_path / "t.npz")
    truth = np.stack([np.load(folder / f"mono{bits}-truth{camera}.npy")[:12] for camera in range(2)], axis=1)
    assert np.linalg.norm(tracks.pixels - truth, axis=2).max() < 0.05


def number_of(file):
    """The first number of a name."""
    return int(re.findall(r"\d+", file.stem)[0])


@pytest.mark.parametrize(("names", "by"), [("suffix", "at the start of the names"), ("stamp", "after 'frame_'")])
def test_images_are_paired_by_the_number_that_rises(names, by, tmp_path, capsys):
    """Two cameras of which the second lost three images; as many of each as it takes are copied."""
    folder = cases() / "20-names" / names
    for camera in ("cam0", "cam1"):
        (tmp_path / camera).mkdir()
        for file in sorted((folder / camera).iterdir())[:120]:
            shutil.copy(file, tmp_path / camera)
    numbers = [{number_of(file) for file in (tmp_path / camera).iterdir()} for camera in ("cam0", "cam1")]
    code, out, _ = run(capsys, tmp_path / "cam0", tmp_path / "cam1", "--out", tmp_path / "t.npz")
    assert code == 0
    assert f"Frames are paired by the number {by}." in out
    tracks = load_tracks(tmp_path / "t.npz")
    assert tracks.frame_ids.tolist() == sorted(numbers[0] | numbers[1])
    lost = ~np.isin(tracks.frame_ids, sorted(numbers[1]))
    assert lost.sum() >= 1
    assert not tracks.visible[lost, 1].any()
    assert tracks.visible[~lost, 1].all()


def test_masks_are_said_and_drawn(tmp_path, capsys):
    rng = np.random.default_rng(1)
    (tmp_path / "cam_0").mkdir()
    for k in range(30):
        cv2.imwrite(str(tmp_path / "cam_0" / f"{k}.png"), picture(k / 30, rng))
    (tmp_path / "masks").mkdir()
    mask = np.full(SIZE[::-1], 255, np.uint8)
    mask[:10] = 0
    cv2.imwrite(str(tmp_path / "masks" / "cam_0.png"), mask)
    given = [tmp_path / "cam_0", "--min-frames", 30, "--out", tmp_path / "t.npz"]
    code, out, _ = run(capsys, *given)
    assert code == 0
    assert f"Masks of cam_0 from {tmp_path / 'masks'}." in out
    assert "no light is looked for under the stripes" in (tmp_path / "t.html").read_text()
    cv2.imwrite(str(tmp_path / "masks" / "cam_0.png"), np.zeros(SIZE[::-1], np.uint8))
    code, _, err = run(capsys, *given, "--force")
    assert code == 7
    assert "black all over" in err


def test_a_camera_without_light_is_told_what_helps_against_its_reason(tmp_path, capsys):
    assert set(REMEDIES) == {reason.name.lower() for reason in Reason} - {"found"}
    rng = np.random.default_rng(2)
    (tmp_path / "cam").mkdir()
    for k in range(30):  # two lights, each on its way
        both = np.maximum(picture(k / 30, rng), picture(k / 30 + 0.7, rng))
        cv2.imwrite(str(tmp_path / "cam" / f"{k}.png"), both)
    code, _, err = run(capsys, tmp_path / "cam", "--min-frames", 30, "--out", tmp_path / "t.npz")
    assert code == 4
    assert "for the reason 'several'" in err
    assert "hide reflections and windows by --masks" in err
