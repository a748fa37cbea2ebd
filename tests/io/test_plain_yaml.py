"""The YAML of calibration tools: as OpenCV reads it where OpenCV can, and what it cannot."""

import cv2
import numpy as np
import pytest

from jaxpoint.errors import FileFormatError
from jaxpoint.io.plain_yaml import parse_yaml

MATRIX = {"k": {"rows": 1, "data": [1.0, 2.0]}}
WORDS = {"a": True, "b": None, "c": np.inf, "d": None, "e": None, "f": False}
NUMBERS = [1, -2, 3.5, 1e-05, 0.5, -7.0, 80.0]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("a: 1\nb: two words\n", {"a": 1, "b": "two words"}),
        ("a: [1, -2, 3.5, 1.e-5, .5, -7.,\n   8e+001]", {"a": NUMBERS}),
        ("a:\n- 1\n- -2\nb: 3", {"a": [1, -2], "b": 3}),  # Kalibr does not indent its lists
        ("a:\n  - [1, 2]\n  - [3, 4]\n", {"a": [[1, 2], [3, 4]]}),
        ("a:\n-\n  - 1\n  - -2\n-\n  - 3\n  - 4\n", {"a": [[1, -2], [3, 4]]}),
        ("- a: 1\n  b: 2\n- a: 3\n", [{"a": 1, "b": 2}, {"a": 3}]),
        ("a: {rows: 1, cols: 2, data: [1.0, 2]}", {"a": {"rows": 1, "cols": 2, "data": [1.0, 2]}}),
        (
            "%YAML:1.0\n---\nk: !!opencv-matrix\n   rows: 1\n   data: [ 1.,\n       2. ]",
            {"k": {"rows": 1, "data": [1, 2]}},
        ),
        ("%YAML 1.2\n---\nk: {}\nl: []\n...\n", {"k": {}, "l": []}),
        ("a: 1 # one\n# two\n\nb: 'x # y'\nc: a#b\n", {"a": 1, "b": "x # y", "c": "a#b"}),
        ("a: \"it's\"\nb: '\"'\nc: \"a \\\" b\"\nd: 'it''s'", {"a": "it's", "b": '"', "c": 'a " b', "d": "it's"}),
        ("a: true\nb: ~\nc: .inf\nd: null\ne:\nf: False", WORDS),
        ("a: /cam0/image_raw\nb: 10:20:30\n'c d': 1", {"a": "/cam0/image_raw", "b": "10:20:30", "c d": 1}),
        ("a:\r\n  b: 1\r\n", {"a": {"b": 1}}),
        ("word", "word"),
        ("", None),
    ],
)
def test_what_tools_write(text, value):
    assert parse_yaml("x.yaml", text) == value


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: [1, 2", "line 1: .*a bracket is not closed"),
        ("a: [1, 2] 3", "'3' stands after the bracket"),
        ("a: 1\n b: 2", "line 2: .*the indentation does not fit"),
        ("a: 1\na: 2", "line 2: .*'a' stands there twice"),
        ("a: 1\nwords", "line 2: .*a key and a colon are expected"),
        ("a: &anchor\n", "line 1: .*anchors, aliases"),
        ("a: |\n  text", "text over several lines are not read"),
        ("a: {b}", "'b' has no colon"),
        ("[" * 60 + "]" * 60, "more than 40 levels"),
        ("\n".join(" " * i + f"a{i}:" for i in range(60)), "more than 40 levels"),
    ],
)
def test_what_is_refused(text, message):
    with pytest.raises(FileFormatError, match=rf"x\.yaml, .*{message}"):
        parse_yaml("x.yaml", text)


def test_as_opencv_reads_the_samples(data_folder):
    """Every sample that OpenCV can read is the same to both."""
    compared = 0
    for path in sorted((data_folder / "formats").rglob("*.y*ml")):
        text = path.read_text()
        storage = opened(text if text.lstrip().startswith("%YAML") else f"%YAML:1.0\n---\n{text}")
        mine = parse_yaml(path, text)
        if storage is not None:
            assert plain(mine) == plain(tree(storage.root())), path
            compared += 1
    assert compared > 30


def opened(text):
    try:
        return cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    except (cv2.error, SystemError):
        return None


def tree(node):
    if node.isMap():
        return {key: tree(node.getNode(key)) for key in node.keys()}  # noqa: SIM118
    if node.isSeq():
        return [tree(node.at(i)) for i in range(node.size())]
    return node.string() if node.isString() else node.real() if node.isInt() or node.isReal() else None


def plain(value):
    """With words for what OpenCV does not tell from words."""
    if isinstance(value, dict):
        return {key: plain(part) for key, part in value.items()}
    if isinstance(value, list):
        return [plain(part) for part in value]
    return str(value).lower() if isinstance(value, str | bool) else value


def test_long_lists_are_read_in_no_time():
    lines = ["a: [ 0."] + [", 1.5e+00, -2.25e-01"] * 20000
    assert len(parse_yaml("x.yaml", "\n".join([*lines, "]"]))["a"]) == 40001
    with pytest.raises(FileFormatError, match="a bracket is not closed"):
        parse_yaml("x.yaml", "\n".join(lines))
