"""The pages: whole, offline, small, and well formed."""

import base64
import io
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from jaxpoint.calibration.pairs import pair_table
from jaxpoint.calibration.result import Verdict
from jaxpoint.report.html import write_detection_section, write_report, write_tracks_report
from jaxpoint.report.style import short_names, to_svg
from jaxpoint.report.tables import origin_table
from jaxpoint.tracks import Tracks

VOID = {"meta", "img", "br"}


class Page(HTMLParser):
    """Collects ids, links and text, and checks that every element is closed in order."""

    def __init__(self, text):
        super().__init__()
        self.text, self.ids, self.targets, self.open, self.words = text, [], [], [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        if "id" in attributes:
            self.ids.append(attributes["id"])
        self.targets += [attributes[key] for key in ("href", "src") if key in attributes]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.targets += [value for key, value in attrs if key in ("href", "src")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not self.open or self.open[-1] not in ("script", "style"):
            self.words.append(data)

    @property
    def prose(self):
        return " ".join(" ".join(self.words).split())


@pytest.fixture(scope="module")
def page(calibration, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(
        path,
        calibration,
        provenance={"versions": {"jax": "1.2"}, "inputs": {"points.dat": "abc"}},
        config_text="[calibrate]\nseed = 7\n",
        sheets=[("cam_0, frame 5", np.full((20, 30, 3), [250, 10, 10], np.uint8))],
    )
    return Page(path.read_text(encoding="utf-8"))


def test_page_is_offline_and_small(page):
    assert len(page.text) < 3_000_000
    assert all(target.startswith(("#", "data:image/")) for target in page.targets)
    assert not re.search(r"https?://|@import|url\((?!#)", page.text)


def test_every_link_of_the_page_has_its_section(page):
    links = re.findall(r'<a href="#([\w-]+)"', page.text)
    assert len(links) == 12
    assert set(links) <= set(page.ids)


def test_every_figure_is_well_formed_and_takes_the_colours_of_the_page(page):
    figures = re.findall(r"<svg .*?</svg>", page.text, flags=re.DOTALL)
    assert len(figures) == 9
    for figure in figures:
        ElementTree.fromstring(figure)
        assert "var(--ink)" in figure
        assert "nan" not in re.sub(r'"data:[^"]*"', "", figure).lower()


def test_page_says_what_it_must(page, summary):
    for text in (
        "This calibration can be trusted", f"{summary.mean_px:.3f} px", "The known point lamp is off by 60 mm",
        "10 of 12", "jax 1.2", "seed = 7", "points.dat", "too few points", "rms 16.3 mm",
    ):  # fmt: skip
        assert text in page.prose
    worst = f"{summary.errors[summary.rejected].max():.1f}"
    assert worst in page.prose


def test_interactive_view_gets_both_frames(page, summary):
    data = json.loads(re.search(r'id="rig-data">(.*?)</script>', page.text).group(1))
    assert [scene["unit"] for scene in data] == ["arbitrary", "m"]
    tips = np.array([camera["cone"][0] for camera in data[1]["cameras"]])
    np.testing.assert_allclose(tips, summary.scene.centers, atol=1e-3)
    sizes = [np.linalg.norm(np.ptp(scene["points"], axis=0)) for scene in data]
    assert sizes[1] / sizes[0] == pytest.approx(2.5, rel=0.1)


def test_sheets_are_pictures(page):
    (uri,) = re.findall(r'<img src="data:image/jpeg;base64,([^"]+)"', page.text)
    image = np.asarray(Image.open(io.BytesIO(base64.b64decode(uri))))
    np.testing.assert_allclose(image.mean(axis=(0, 1)), [250, 10, 10], atol=4)


def test_hostile_names_are_shown_as_they_are(unaligned, tmp_path):
    names = ("<b>a</b>", "</script>", '"&', "d")
    tracks = replace_names(unaligned.tracks, names)
    write_report(tmp_path / "r.html", replace(unaligned, tracks=tracks, pairs=pair_table(tracks), stages=()))
    page = Page((tmp_path / "r.html").read_text(encoding="utf-8"))
    assert "<b>a</b>" in page.prose
    assert "alignment" not in page.ids
    assert "stages" not in page.ids
    assert "jaxpoint align RUN" in page.prose


def test_a_failed_calibration_still_has_its_report(unaligned, tmp_path):
    verdicts = np.where(unaligned.verdicts == Verdict.KEPT, Verdict.UNDECIDED, unaligned.verdicts)
    nothing = replace(
        unaligned, verdicts=verdicts, point_valid=np.zeros_like(unaligned.point_valid), sigma_px=0.0, converged=False
    )
    write_report(tmp_path / "r.html", nothing)
    page = Page((tmp_path / "r.html").read_text(encoding="utf-8"))
    assert "Not to be trusted" in page.prose
    assert not re.search(r"\bnan\b", page.prose, flags=re.IGNORECASE)


def test_tracks_report(calibration, tmp_path):
    write_tracks_report(tmp_path / "check.html", calibration.tracks, calibration.pairs)
    page = Page((tmp_path / "check.html").read_text(encoding="utf-8"))
    assert "Ready to calibrate" in page.prose
    links = re.findall(r'<a href="#([\w-]+)"', page.text)
    assert set(links) <= set(page.ids)
    for a, b in ((0, 1), (2, 3)):
        assert f"{calibration.pairs.shared[a, b]:,}" in page.prose
    write_tracks_report(tmp_path / "bad.html", calibration.tracks, calibration.pairs, problem="The light never moves.")
    bad = Page((tmp_path / "bad.html").read_text(encoding="utf-8"))
    assert "Not enough to calibrate" in bad.prose
    assert "The light never moves." in bad.prose


def test_detection_page(tmp_path):
    write_detection_section(tmp_path / "d.html", [("door <1>", np.zeros((4, 4, 3), np.uint8))])
    assert "door <1>" in Page((tmp_path / "d.html").read_text(encoding="utf-8")).prose


def test_nothing_is_left_where_writing_fails(tmp_path):
    with pytest.raises(OSError, match="missing"):
        write_detection_section(tmp_path / "missing" / "d.html", [])
    assert list(tmp_path.iterdir()) == []


def replace_names(tracks, names):
    return Tracks(tracks.pixels, tracks.visible, tracks.image_sizes, tracks.frame_ids, tracks.times, names)


def test_short_names_stay_different():
    assert short_names(("a", "b")) == ("a", "b")
    assert short_names(("laboratory-camera-1", "laboratory-camera-2")) == ("…amera-1", "…amera-2")
    long = ("the door in the north wall", "window to the south garden")
    assert len(set(short_names(long))) == 2
    assert max(map(len, short_names(long))) <= 14


def test_files_keep_their_names_where_a_run_tells_what_it_was_made_from():
    made = {"time_of": "now", "inputs": {"a/camera_centres.csv": "1f", "b_c.toml": "2e"}}
    assert origin_table(made, {}, None).rows == [["time of", "now"], ["inputs", "a/camera_centres.csv 1f, b_c.toml 2e"]]


def test_numbers_in_a_figure_are_not_cut():
    figure = Figure()
    figure.text(0.123456, 0.5, "0.0015 and 0.123456")
    svg = to_svg(figure)
    assert "0.0015 and 0.123456" in svg
    assert not re.search(r"<[^>]*\d\.\d{4}", svg)
