"""Damaged files of every exchange format: one sentence and exit code 7, never a traceback; harmless ones are read."""

import re

import numpy as np
import pytest
from test_exchange import READ, SIZE, pixels, rig_of, target_of

from jaxpoint.errors import JaxpointError
from jaxpoint.io.exchange import read_calibration, write_calibration
from jaxpoint.io.formats.format_registry import FORMATS

NUMBER = re.compile(r"(?<![\w.])[-+]?\d+\.?\d*(e[-+]?\d+)?(?![\w.])")
VALUES = ("nan", "1e999", "-1", "0", "abc", "", "[", '"', "1 2", "<a>")
PER_FILE = 12  # places that are damaged in each
PYTHON = re.compile(r"Traceback|object is not|NoneType|dtype|ndarray|unhashable|list index|KeyError|to float|np\.")


def written(name, tmp_path):
    """The files of a rig, and where they lie."""
    rig, path = rig_of("none" if name == "vicon" else "brown4", 2), target_of(name, tmp_path)
    write_calibration(rig, path, name)
    return path, sorted(path.iterdir()) if path.is_dir() else [path]


def read(path, name):
    return read_calibration(path, name, size=None if FORMATS[name].holds.sizes else SIZE)


def damaged(text):
    """Cut off, without a line, and with other values."""
    rng = np.random.default_rng(len(text))
    for share in (0.0, 0.1, 0.5, 0.9, 0.99):
        yield text[: int(share * len(text))]
    lines = text.splitlines(keepends=True)
    for i in rng.permutation(len(lines))[:PER_FILE]:
        yield "".join([*lines[:i], *lines[i + 1 :]])
        yield "".join([*lines[: i + 1], *lines[i:]])
    found = list(NUMBER.finditer(text))
    for i in rng.permutation(len(found))[:PER_FILE]:
        value = VALUES[int(rng.integers(len(VALUES)))]
        yield text[: found[i].start()] + value + text[found[i].end() :]
    yield "[" * 100_000
    yield "{" * 100_000
    yield "a: " * 100_000
    yield "<a>" * 100_000


def refusal(path, name):
    """What reading refuses; other exceptions are for the test to fail by."""
    try:
        read_calibration(path, name, size=SIZE)
    except JaxpointError as error:
        return error
    return None


@pytest.mark.parametrize("name", READ)
def test_damage_ends_in_a_sentence(tmp_path, name):
    path, files = written(name, tmp_path)
    refused = 0
    for file in {re.sub(r"\d", "", file.name): file for file in files}.values():  # one of each kind
        text = file.read_text()
        for broken in damaged(text):
            file.write_text(broken)
            for given in (name, None):
                error = refusal(path, given)
                if error is not None:
                    refused += error.exit_code == 7
                    said = str(error)
                    assert error.exit_code in (2, 7), said[:900]
                    assert not PYTHON.search(said), said[:900]
                    assert len(said) < 900, said[:900]
                    assert "\n" not in said, said
        file.write_text(text)
    assert refused > 20


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "crlf"])
@pytest.mark.parametrize("name", READ)
def test_other_ends_of_lines_and_encodings(tmp_path, name, encoding):
    path, files = written(name, tmp_path)
    before = pixels(read(path, name).rig)
    for file in files:
        text = file.read_text()
        if encoding == "crlf":
            file.write_bytes(text.replace("\n", "\r\n").encode())
        else:
            file.write_text(text.replace("<?xml version='1.0' encoding='utf-8'?>", ""), encoding=encoding)
    np.testing.assert_array_equal(pixels(read_calibration(path, size=SIZE).rig), before)


@pytest.mark.parametrize("name", ["anipose", "caliscope", "pose2sim", "kalibr", "ros", "easymocap", "mrcal", "colmap"])
def test_comments(tmp_path, name):
    path, files = written(name, tmp_path)
    before = pixels(read(path, name).rig)
    for file in files:
        lines = file.read_text().splitlines()
        first = 1 if lines[0].startswith("%YAML") else 0
        file.write_text("\n".join([*lines[:first], "# by hand: K_x", *lines[first:], "# end", ""]))
    np.testing.assert_array_equal(pixels(read_calibration(path, size=SIZE).rig), before)
