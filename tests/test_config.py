"""Settings: strict TOML files, ranges, and the round trip."""

import dataclasses
import re
import tomllib
import typing
from pathlib import Path

import pytest

from jaxpoint.config import CalibrateSettings, LensSettings, RoomConfig, check_settings, load_config, to_toml
from jaxpoint.errors import UsageError

CONFIGS = Path(__file__).parents[1] / "configs"


def written(folder: Path, text: str) -> Path:
    path = folder / "room.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_what_is_written_is_read_back(tmp_path):
    room = RoomConfig(calibrate=CalibrateSettings(seed=7, lens=LensSettings(distortion="brown")))
    assert load_config(written(tmp_path, to_toml(room))) == room


def test_an_empty_file_is_all_defaults(tmp_path):
    assert load_config(written(tmp_path, "")) == RoomConfig()


def test_paths_count_from_the_file_and_are_written_absolute(tmp_path, monkeypatch):
    room = load_config(written(tmp_path, '[align]\nlandmarks = "known/landmarks.csv"'))
    assert room.align.landmarks == tmp_path / "known/landmarks.csv"
    monkeypatch.chdir(tmp_path)
    elsewhere = load_config(written(tmp_path, to_toml(RoomConfig(align=type(room.align)(landmarks=Path("a.csv"))))))
    assert elsewhere.align.landmarks == tmp_path / "a.csv"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[calibrate.lens]\ndistorsion = 'none'", "unknown key 'calibrate.lens.distorsion'; did you mean 'distortion'"),
        ("[colour]\nx = 1", "unknown key 'colour'; known here: input, detect, track"),
        ("[calibrate]\nheld_out = 2.0", "'calibrate.held_out' cannot be used: Expected `float` <= 1.0"),
        ("[calibrate]\nmax_mean_px = nan", "'calibrate.max_mean_px' cannot be used"),
        ("[detect.person.background]\nthreshold = inf", "'detect.person.background.threshold' cannot be used"),
        ("[track]\nheight_m = [0.6, inf]", "'track.height_m[1]' cannot be used: expected a finite number (given: inf)"),
        ("[track]\nheight_m = [2.2, 0.6]", "'track.height_m' cannot be used: its lowest, 2.2, is not below"),
        ("[track]\nconfirm = [5, 3]", "'track.confirm[0]' cannot be used: it is 5, above track.confirm[1], which is 3"),
        ("[detect.person.head]\nnearest_m = 7", "'head.nearest_m' cannot be used: it is 7, above head.farthest_m"),
        ("[detect.person.motion]\ncanny_low = 101.0", "'motion.canny_low' cannot be used: it is 101, above motion"),
        ("[calibrate]\nseed = 'one'", "'calibrate.seed' cannot be used: Expected `int`, got `str`"),
        ("[calibrate.lens]\nprincipal_point = 'left'", "'calibrate.lens.principal_point' cannot be used"),
        ("[align]\nlandmarks = 3", "'align.landmarks' cannot be used: expected a path in quotes"),
        ("calibrate = 3", "'calibrate' cannot be used"),
        ("[calibrate", "cannot be read as TOML"),
        ("[simulate]\nframes_per_second = 0.001", "'simulate.frames_per_second' cannot be used: Expected `float` >= 0"),
        ("[simulate.wave]\nframes = 1", "'simulate.wave.frames' cannot be used: Expected `int` >= 2"),
        ("[simulate.viewpoints]\nsize = [3, 2]", "size[0]' cannot be used: Expected `int` >= 32 (given: [3, 2])"),
        ("[simulate.viewpoints]\nsize = [96, 55]", "size[1]' cannot be used: Expected `int` that's a multiple of 2"),
        (
            "[simulate.sensor]\nshutter_s = { low = 3, high = 1 }",
            "'simulate.sensor.shutter_s' cannot be used: low = 3 and high = 1 are no range",
        ),
        (
            "[simulate.people]\nturn_deg = { mean = 2, sd = 1, low = nan, high = 1 }",
            "'simulate.people.turn_deg.low' cannot be used: expected a finite number",
        ),
        (
            "[simulate.people.looks]\nsleeves = { none = 0, short = 0, elbow = 0, rolled = 0, long = 0 }",
            "'simulate.people.looks.sleeves' cannot be used: all shares are 0",
        ),
    ],
)
def test_a_bad_file_is_refused_by_the_path_of_its_key(tmp_path, text, message):
    with pytest.raises(UsageError) as caught:
        load_config(written(tmp_path, text))
    assert message in str(caught.value)
    assert "room.toml" in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(UsageError, match="There is no configuration file"):
        load_config(tmp_path / "nothing.toml")


def test_settings_made_in_python_are_held_to_the_same_ranges():
    assert check_settings(CalibrateSettings()) == CalibrateSettings()
    with pytest.raises(UsageError, match=r"'lens\.principal_point_sigma'"):
        check_settings(CalibrateSettings(lens=LensSettings(principal_point_sigma=-1.0)))


@pytest.mark.parametrize("name", ["room", "people"])
def test_the_configs_show_the_defaults(name):
    assert load_config(CONFIGS / f"{name}.toml") == RoomConfig()


def test_the_config_of_people_shows_every_setting():
    shown = tomllib.loads((CONFIGS / "people.toml").read_text(encoding="utf-8"))
    defaults = tomllib.loads(to_toml(RoomConfig()))
    detect = {name: defaults["detect"][name] for name in ("person", "marker")}
    assert shown == {"detect": detect, "track": defaults["track"]}


def test_the_config_of_a_room_shows_every_setting():
    """As a line, or commented out where the default cannot be written."""
    text = (CONFIGS / "room.toml").read_text(encoding="utf-8")
    shown = {
        (table, key)
        for table, body in re.findall(r"^\[([\w.]+)\][^\n]*\n(.*?)(?=^\[|\Z)", text, re.MULTILINE | re.DOTALL)
        for key in re.findall(r"^(?:# )?(\w+) = ", body, re.MULTILINE)
    }
    assert set(_keys(RoomConfig, "")) == shown


def _keys(settings: type, path: str):
    """The table and name of every setting, but for those of people and simulation, which have files of their own."""
    for name, kind in typing.get_type_hints(settings).items():
        inner = f"{path}.{name}".lstrip(".")
        if inner in ("detect.person", "detect.marker", "track", "simulate"):
            continue
        if dataclasses.is_dataclass(kind):
            yield from _keys(kind, inner)
        else:
            yield path, name
