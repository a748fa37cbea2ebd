"""`jaxpoint point` and `jaxpoint demo` from pixels: one gesture of the embedded session, then what must be refused."""

import csv
import json
import shutil
from contextlib import contextmanager
from importlib.resources import as_file, files
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from jaxpoint.body import following as following
from jaxpoint.cli import main
from jaxpoint.errors import MissingDependencyError

MOMENTS = range(28, 45)  # the second gesture, at the window, with what is before and after
CAMERAS = ("cam_0", "cam_1", "cam_2", "cam_5")
KEPT = ("calibration.json", "camera_centres.csv", "objects.csv", "session.toml")


def run(*arguments, capsys):
    code = main([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    return code, out, err


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A session of one gesture: the embedded one, with fewer frames."""
    short = tmp_path_factory.mktemp("point") / "session"
    short.mkdir()
    with as_file(files("jaxpoint") / "data" / "session") as whole:
        for name in ("videos", "empty", "wave"):
            (short / name).mkdir()
            for camera in CAMERAS:
                (short / name / f"{camera}.mp4").symlink_to(whole / name / f"{camera}.mp4")
        for name in KEPT:
            shutil.copy(whole / name, short / name)
        (short / "truth").mkdir()
        header, *lines = (whole / "timestamps.csv").read_text().splitlines()
        chosen = [line for line in lines if int(line.split(",")[0]) in MOMENTS]
        (short / "timestamps.csv").write_text("\n".join([header, *chosen]) + "\n")
        header, *lines = (whole / "truth" / "gestures.csv").read_text().splitlines()
        (short / "truth" / "gestures.csv").write_text("\n".join([header, lines[1]]) + "\n")
    return short


@pytest.fixture(autouse=True, scope="module")
def followed_once():
    """The arms of one session by one calibration are looked for once in this file, not again for every refusal."""
    found, own = {}, following.follow

    def once(rig, views, times, *arguments, **more):
        key = np.asarray(rig.positions).tobytes(), times.tobytes()
        if key not in found:
            found[key] = own(rig, views, times, *arguments, **more)
        return found[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(following, "follow", once)
        yield


@pytest.fixture(scope="module")
def options(folder):
    return "--workers", 1, "--cache", folder.parent / "cache"


def test_a_gesture_is_answered_from_pixels(folder, options, tmp_path, capsys):
    code, out, err = run("point", folder, *options, "--out", tmp_path / "answers", "--follow", capsys=capsys)
    assert code == 0, err
    (line,) = out.splitlines()
    answer = json.loads(line)
    assert (answer["answer"], answer["line"]) == ("window", "eye-fingertip")
    assert answer["probability"] > 0.5
    assert answer["hits"][0]["name"] == "window"
    assert 0.5 < answer["distance_m"] < 2.0
    assert sum(answer["probabilities"].values()) <= 1 + 1e-9
    with (tmp_path / "answers" / "gestures.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert (row["answer"], row["nearest_1"]) == ("window", "window")
    assert json.loads((tmp_path / "answers" / "gestures.json").read_text()) == [answer]
    assert len(answer["point_m"]) == 3
    guessed, calibration = json.loads((tmp_path / "answers" / "metrics.json").read_text())["notes"][-2:]
    assert "--room.low" in guessed
    assert "its part of the lines' errors" in calibration
    page = (tmp_path / "answers" / "report.html").read_text()
    assert "the window" in page.lower()
    assert (tmp_path / "answers" / "pictures" / "gesture_1.jpg").stat().st_size > 10_000


def test_words_are_paired_and_times_are_taken(folder, options, tmp_path, capsys):
    (tmp_path / "words.csv").write_text("word,start_s,end_s\nthat,5.3,5.5\nlamp,5.6,5.9\n")
    (tmp_path / "times.csv").write_text("start_s,end_s\n5.4,6.2\n")
    room = ("--config", folder / "session.toml")
    given = ("--words", tmp_path / "words.csv", "--times", tmp_path / "times.csv", *room)
    code, out, err = run("point", folder, *options, *given, "--out", tmp_path / "answers", "--json", capsys=capsys)
    assert code == 0, err
    told = json.loads(out)
    (answer,) = told["gestures"]
    assert told["notes"][0].startswith("Each of the cameras 'cam_0', 'cam_1', 'cam_2' and 'cam_5': 11 pairs of quiet")
    assert not any("guessed" in note for note in told["notes"])
    assert answer["words"] == ["that", "lamp"]
    assert answer["start_s"] >= 5.4 - 1e-9
    assert answer["end_s"] <= 6.2 + 1e-9


def shifted(path: Path, folder: Path) -> Path:
    """The objects 30 m away."""
    with path.open() as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        row.update({key: str(float(value) + 30) for key, value in row.items() if key.endswith("_x")})
    with (folder / "far.csv").open("w") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    return folder / "far.csv"


def test_what_cannot_be_answered_is_refused_in_a_sentence(folder, options, tmp_path, capsys):
    calibration = json.loads((folder / "calibration.json").read_text())
    no_scale, small = tmp_path / "no_scale.json", tmp_path / "small.json"
    no_scale.write_text(json.dumps({**calibration, "unit": "arbitrary"}))
    cameras = [{**camera, "size": [1280, 720]} for camera in calibration["cameras"]]
    small.write_text(json.dumps({**calibration, "cameras": cameras}))
    one = tmp_path / "one"
    (one / "videos").mkdir(parents=True)
    shutil.copy(folder / "videos" / "cam_0.mp4", one / "videos")
    for name in KEPT:
        shutil.copy(folder / name, one / name)
    (tmp_path / "times.csv").write_text("start_s,end_s\n50,51\n")
    cases = [
        ((folder, "--gesture.min-stretch", 0.99), 4, "No gesture was found in 17 frames"),
        ((one,), 4, "has 1 camera; a line in the room takes two views or more"),
        ((folder, "--calibration", no_scale), 2, "has no metric scale"),
        ((folder, "--calibration", small), 2, "is 512 x 288 px, but"),
        ((folder, "--objects", shifted(folder / "objects.csv", tmp_path)), 4, "The gesture starts outside the room"),
        ((folder, "--times", tmp_path / "times.csv"), 4, "Between 50.00 and 51.00 s no arm was measured, as the"),
        ((folder, "--line", "blend"), 2, "The weights of a blend"),
        ((folder, "--room.low", 0, 0, 0), 2, "low and high corner both"),
        ((folder, "--room.low", 0, 0, 0, "--room.high", 6, 5, "nan"), 2, "'room.high[2]' cannot be used"),
        ((folder, "--room.low", 0, 0, 0, "--room.high", 6, 5, 300), 2, "from 0 to 300 m in z"),
        ((folder, "--objects", tmp_path / "none.csv"), 7, "There is no file"),
    ]
    before = sorted(tmp_path.rglob("*"))
    for arguments, wanted, message in cases:
        code, out, err = run("point", *arguments, *options, "--out", tmp_path / "out", capsys=capsys)
        assert code == wanted, (arguments, err)
        assert message in err
        assert len(err.splitlines()) == 1
        assert not out
    assert sorted(tmp_path.rglob("*")) == before


def test_who_cannot_speak_says_so_before_any_work(folder, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("shutil.which", lambda program: None)
    code, _, err = run("point", folder, "--speak", "--out", tmp_path / "out", capsys=capsys)
    assert code == 3
    assert "needs the program espeak-ng" in err


def test_answers_are_spoken(monkeypatch):
    from jaxpoint.report.answer_text import speak

    said = []
    monkeypatch.setattr("shutil.which", lambda program: f"/usr/bin/{program}")
    monkeypatch.setattr(
        "subprocess.run", lambda command, **_: said.append(command) or type("Done", (), {"returncode": 0})
    )
    speak("the window, 1.1 m away")
    assert said == [["espeak-ng", "the window, 1.1 m away"]]


@pytest.fixture
def answered(monkeypatch):
    """A command that knows its two answers at once; its folder of results is what `write_answers` is told to make."""
    answers = [
        SimpleNamespace(number=i, time_s=2.0 * i, person=1, probability=0.9, name=name, text=f"the {name}, 1.0 m away")
        for i, name in enumerate(("window", "door"), start=1)
    ]
    pointed = SimpleNamespace(answers=answers, notes=("A note.",))
    monkeypatch.setattr("jaxpoint.commands.point.Point.find_answers", lambda *_: (None, None, pointed))
    monkeypatch.setattr("jaxpoint.commands.answers_folder.write_answers", lambda *_: {"gestures": 2})
    monkeypatch.setattr("jaxpoint.report.answer_text.sentence", lambda answer: answer.text)
    monkeypatch.setattr("jaxpoint.report.answer_text.as_json", lambda answer: {"answer": answer.name})


@pytest.mark.parametrize(("flags", "first"), [(["--follow"], '{"answer": "window"}'), ([], "  1     2.0 s  person 1")])
def test_answers_are_told_before_anything_is_written(answered, folder, tmp_path, capsys, monkeypatch, flags, first):
    told = []

    def full(*_):
        told.extend(capsys.readouterr().out.splitlines())
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("jaxpoint.commands.answers_folder.write_answers", full)
    code, out, err = run("point", folder, *flags, "--out", tmp_path / "out", capsys=capsys)
    assert (code, out) == (3, "")
    assert "No space left" in err
    assert told[0].startswith(first)
    assert len(told) == 2 + (not flags)


def test_a_voice_that_does_not_start_says_why(monkeypatch):
    from jaxpoint.report.answer_text import speak

    def broken(*_, **__):
        raise OSError(8, "Exec format error")

    monkeypatch.setattr("shutil.which", lambda program: f"/usr/bin/{program}")
    monkeypatch.setattr("subprocess.run", broken)
    with pytest.raises(MissingDependencyError, match=r"espeak-ng failed \(Exec format error\)"):
        speak("the window")


@pytest.mark.parametrize("flags", [[], ["--follow"], ["--json"]])
def test_a_voice_that_fails_loses_no_answer(answered, folder, tmp_path, capsys, caplog, monkeypatch, flags):
    said = []
    failed = SimpleNamespace(returncode=3, stderr="broken\naudio\n")
    monkeypatch.setattr("shutil.which", lambda program: f"/usr/bin/{program}")
    monkeypatch.setattr("subprocess.run", lambda command, **_: said.append(command) or failed)
    code, out, err = run("point", folder, "--speak", *flags, "--out", tmp_path / "out", capsys=capsys)
    assert (code, err) == (0, "")
    assert "Missing: the voice (espeak-ng failed (broken audio); go without --speak)" in caplog.text
    assert ("Missing: the voice" in out) == (flags != ["--follow"])  # a robot reads answers and nothing else
    assert len(said) == 1
    assert len(out.splitlines()) == {"--follow": 2, "--json": 1}.get("".join(flags), 5)


def test_the_demo_goes_from_the_waved_light_to_the_named_object(folder, options, tmp_path, capsys, monkeypatch):
    @contextmanager
    def session():
        yield folder

    monkeypatch.setattr("jaxpoint.commands.demo.embedded_session", session)
    monkeypatch.setattr("jaxpoint.compilation.keep_programs", lambda folder: folder)
    code, out, err = run("demo", *options, "--out", tmp_path / "run", "--json", capsys=capsys)
    assert code == 0, err
    figures = json.loads(out)
    assert (figures["right"], figures["all"], figures["truth"]) == (1, 1, ["window"])
    assert figures["camera_mm"] < 20
    assert figures["gestures"][0]["calibration_sigma_deg"] < 0.5
    assert not any("guessed" in note for note in figures["notes"])
    assert "The answer is right." in (tmp_path / "run" / "report.html").read_text()
    kept = json.loads((tmp_path / "run" / "calibration" / "calibration.json").read_text())
    assert kept["unit"] == "m"
    assert kept["covariance"]["gauge"] == "landmarks"
