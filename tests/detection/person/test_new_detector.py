"""A detector of people that returns given joints: it goes through following, arms and answers as built-in ones do."""

import csv
import json
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from jaxpoint.cli import main
from jaxpoint.detection import register_detector, unregister_detector
from jaxpoint.evidence import AbstractCameraEvidence, AbstractPersonEvidence, FrameReason, HeadReason, SeenJoints

SESSION = Path(str(files("jaxpoint"))) / "data" / "session"
FRAMES = range(8, 22)  # of the first gesture, at which one person is there
NAMES = {"right_elbow": "right_elbow", "right_wrist": "right_wrist", "right_tip": "right_index"}


# The detector: from here to `given` is all that it takes.
@dataclass(frozen=True)
class GivenPerson(AbstractPersonEvidence):
    """Joints that somebody knows, px by name."""

    places: dict

    def joints(self):
        return SeenJoints.of(self.places)


@dataclass(frozen=True, kw_only=True)
class GivenViews(AbstractCameraEvidence):
    """One of them in each frame."""

    people: list

    def person(self, sighting):
        return GivenPerson(self.people[sighting])


def given(request):
    """The true joints of the session, as each camera would see them."""
    session, truth = request.session, true_joints()
    frames = [place for place, frame in enumerate(session.frame_ids) if frame in truth]
    pixels = {
        (place, name): np.asarray(session.rig.project(point))
        for place in frames
        for name, point in truth[session.frame_ids[place]].items()
    }
    views = []
    for camera, (width, height) in enumerate(session.sizes.tolist()):
        seen = [place for place in frames if ((pixels[place, "head"][camera] >= 0).all())]
        seen = [place for place in seen if (pixels[place, "head"][camera] < (width, height)).all()]
        heads = np.array([pixels[place, "head"][camera] for place in seen]).reshape(-1, 2)
        reasons = np.full(len(session.frame_ids), FrameReason.NOBODY, int)
        reasons[seen] = FrameReason.PERSON
        people = [{name: pixels[place, joint][camera] for joint, name in NAMES.items()} for place in seen]
        box = np.concatenate([heads - 15, np.full((len(seen), 2), 100)], axis=1).astype(int)
        common = {"size": (width, height), "reasons": reasons, "frame": np.array(seen, int), "box": box, "head": heads}
        height, found = np.full(len(seen), 30.0), np.full(len(seen), int(HeadReason.FOUND))
        views.append(GivenViews(**common, head_height=height, head_reason=found, people=people))
    return views


def true_joints() -> dict[int, dict[str, np.ndarray]]:
    """Of the one person who is there: place of each joint by frame, m."""
    found: dict[int, dict[str, np.ndarray]] = {}
    for row in rows(SESSION / "truth" / "joints.csv"):
        if int(row["frame"]) in FRAMES and row["joint"] in (*NAMES, "head"):
            place = np.array([float(row[f"{axis}_m"]) for axis in "xyz"])
            found.setdefault(int(row["frame"]), {})[row["joint"]] = place
    return found


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def registered():
    register_detector("given", given)
    yield
    unregister_detector("given")


@pytest.mark.usefixtures("registered")
def test_given_joints_are_followed_and_answered(tmp_path, capsys):
    out = tmp_path / "answers"
    assert main(["point", str(SESSION), "--detector", "given", "--out", str(out)]) == 0, capsys.readouterr().err
    (answer,) = json.loads((out / "gestures.json").read_text())
    assert answer["answer"] == rows(SESSION / "truth" / "gestures.csv")[0]["target"]
    origin, truth = np.array(answer["origin_m"]), true_joints()
    assert np.linalg.norm(origin - truth[answer["frame"]]["right_tip"]) < 0.01
    assert (out / "pictures" / "gesture_1.jpg").exists()


@pytest.mark.usefixtures("registered")
def test_given_joints_are_tabulated_and_drawn(tmp_path):
    out = tmp_path / "people"
    assert main(["detect", "person", str(SESSION), "--detector", "given", "--out", str(out)]) == 0
    arms = [row for row in rows(out / "arms.csv") if row["reason"] == "found"]
    assert len(arms) >= len(FRAMES) - 2  # in one, the arm that comes up is unlike those beside it
    found = [row for row in rows(out / "detections.csv") if row["arm_reason"] == "found"]
    assert len(found) > 2 * len(arms)
    assert {row["head_reason"] for row in found} == {"found"}
    assert (out / "report.html").exists()


def test_a_detector_is_named_by_its_module(monkeypatch, tmp_path, capsys):
    (tmp_path / "of_mine.py").write_text("def nobody(request):\n    return []\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    command = ["detect", "person", str(SESSION), "--out", str(tmp_path / "out"), "--detector"]
    assert main([*command, "of_mine:nobody"]) == 2
    assert "gave 0 views with none frames, and the session has 6 cameras" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (["--detector", "nobodys"], "choose among auto, landmarks, silhouettes, or name yours as module:function"),
        (["--detector", "no_such_module:at_all"], "needs the module 'no_such_module', which cannot be"),
        (["--detector", "json:nothing"], "'json:nothing' is no function"),
        (["--detector", "landmarks"], "give it by --landmarks"),
        (["--detector", "silhouettes", "--landmarks", "x.csv"], "reads no landmarks"),
    ],
)
def test_other_detectors_are_refused(more, says, tmp_path, capsys):
    assert main(["detect", "person", str(SESSION), "--out", str(tmp_path / "out"), *more]) == 2
    assert says in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out").exists()


def test_a_name_is_given_once():
    with pytest.raises(ValueError, match="There is a detector 'landmarks' already"):
        register_detector("landmarks", given)
    with pytest.raises(ValueError, match="There is no joint 'left_thumb'"):
        SeenJoints.of({"left_thumb": (1.0, 2.0)})


def test_the_detector_is_short():
    lines = Path(__file__).read_text(encoding="utf-8").split("# The detector")[1].split("def true_joints")[0]
    assert len(lines.splitlines()) <= 60
