"""The engine in a process of its own, kept alive between solves: first call, memory and warm times of one process."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import Any

from jaxpoint.errors import JaxpointError

SCRIPT = Path(__file__).with_name("engine.py")


class Worker:
    """`engine.py` on one problem.

    `first` is what its first call told; its `process_s` counts from the start of the process to the end of that call.
    """

    def __init__(self, problem: Path, *, rtol: float, cache: Path | None = None, devices: int = 1) -> None:
        started = time.perf_counter()
        kept = [] if cache is None else ["--cache", str(cache)]
        self._process = subprocess.Popen(
            [sys.executable, SCRIPT, str(problem), "--rtol", str(rtol), "--devices", str(devices), *kept],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.first: dict[str, Any] = self._answer()
        self.first["process_s"] = time.perf_counter() - started
        self.first |= self._answer()

    def solve(self) -> dict[str, Any]:
        """Solve once more, compiled."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return self._answer()

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise JaxpointError(f"The engine ended with code {self._process.wait()}; see its own words above.")
        return json.loads(line)

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._process.communicate()


def first_call(problem: Path, *, rtol: float, cache: Path | None = None, devices: int = 1) -> dict[str, Any]:
    """The first call in a fresh process, and nothing else."""
    with Worker(problem, rtol=rtol, cache=cache, devices=devices) as worker:
        return worker.first
