"""How many test processes `make test` starts, by cores and memory, on Linux, in containers and on macOS."""

import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SCRIPT = ROOT / ".ci" / "workers.py"
NAMES = runpy.run_path(str(SCRIPT))
GB = 1024**3
VM_STAT = """Mach Virtual Memory Statistics: (page size of 16384 bytes)
Pages free:                               65536.
Pages active:                            400000.
Pages inactive:                          131072.
Pages speculative:                        32768.
Pages wired down:                        100000.
Pages purgeable:                          32768.
"File-backed pages":                     200000.
"""


@pytest.mark.parametrize(
    ("cores", "memory", "expected"),
    [(2, 24 * GB, 2), (8, 16 * GB, 4), (8, 15 * GB, 3), (64, 128 * GB, 32), (4, 2 * GB, 1), (8, None, 8)],
)
def test_workers_by_cores_and_memory(cores, memory, expected):
    assert NAMES["workers"](cores, memory) == expected


def test_memory_as_linux_tells_it():
    meminfo = "MemTotal:       16384000 kB\nMemFree:  100 kB\nMemAvailable:    8388608 kB\n"
    assert NAMES["linux_memory"](meminfo) == 8 * GB
    assert NAMES["linux_memory"]("MemTotal: 1 kB\n") is None


def test_memory_as_macos_tells_it():
    assert NAMES["pages_of_macos"](VM_STAT) == 4 * GB
    assert NAMES["pages_of_macos"]("nothing of the kind") is None


def test_a_container_has_less(tmp_path):
    limit = NAMES["container_memory"]
    assert limit(tmp_path) is None
    (tmp_path / "memory.current").write_text(f"{GB}\n")
    (tmp_path / "memory.max").write_text("max\n")
    assert limit(tmp_path) is None
    (tmp_path / "memory.max").write_text(f"{9 * GB}\n")
    assert limit(tmp_path) == 8 * GB


def test_make_asks_the_script():
    printed = subprocess.run([sys.executable, SCRIPT], capture_output=True, text=True, check=True).stdout
    assert 1 <= int(printed) <= NAMES["usable_cores"]()
    planned = subprocess.run(["make", "--dry-run", "test"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert re.search(r"--numprocesses \d+ ", planned)
