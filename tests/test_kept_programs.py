"""Compiled programs that are kept from run to run."""

import os
from dataclasses import replace

import pytest

from jaxpoint.cli import main
from jaxpoint.commands.kept_programs import clear_programs, kept_programs, programs_folder, trim_programs
from jaxpoint.config.room import RuntimeSettings
from jaxpoint.errors import UsageError


@pytest.fixture
def folder(tmp_path):
    """Ten programs of 100 bytes, the first used longest ago, one of another processor, and a stranger's file."""
    for i in range(10):
        path = tmp_path / ("jaxlib-1-a" if i else "jaxlib-1-b") / f"{i}-cache"
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(b"x" * 100)
        os.utime(path, (1000.0 + i, 1000.0))
    (tmp_path / "notes.txt").write_text("mine")
    return tmp_path


def names(folder):
    return sorted(int(path.name.split("-")[0]) for path in folder.glob("jaxlib-*/*"))


def test_the_longest_unused_go_first(folder):
    trim_programs(folder, 2000.0, max_bytes=1000)
    assert names(folder) == list(range(10))
    trim_programs(folder, 2000.0, max_bytes=999)
    assert names(folder) == [6, 7, 8, 9]


def test_what_was_not_written_to_its_end_goes(folder):
    for i, used_s in ((3, 1000.0), (4, 1990.0)):
        path = folder / "jaxlib-1-a" / f"{i}-cache"
        path.write_bytes(b"")
        os.utime(path, (used_s, used_s))
    trim_programs(folder, 2000.0)
    assert names(folder) == [0, 1, 2, 4, 5, 6, 7, 8, 9]


def test_clearing_leaves_what_is_not_ours(folder):
    assert clear_programs(folder).files == 10
    assert [path.name for path in folder.iterdir()] == ["notes.txt"]
    assert str(kept_programs(folder)) == f"0 in {folder} (0 MB)"


def test_where_they_are_kept(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    settings = RuntimeSettings()
    assert programs_folder(settings) == tmp_path / "jaxpoint" / "programs"
    assert programs_folder(replace(settings, keep_programs=False)) is None
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match=r"file/in' for compiled programs cannot be made .* --compilation-cache"):
        programs_folder(replace(settings, compilation_cache=tmp_path / "file" / "in"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert programs_folder(settings) is None


def test_doctor_shows_and_clears_them(folder, capsys):
    assert main(["doctor", "--compilation-cache", str(folder)]) == 0
    assert f"10 in {folder} (0 MB)  (--clear-programs removes them)" in capsys.readouterr().out
    assert main(["doctor", "--compilation-cache", str(folder), "--clear-programs"]) == 0
    assert f"removed 10 in {folder}" in capsys.readouterr().out
    assert names(folder) == []
