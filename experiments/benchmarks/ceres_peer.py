"""Ceres as a peer: builds the small program in `ceres/` for this machine, and runs it on a problem.

python experiments/benchmarks/ceres_peer.py FILE dense
"""

from __future__ import annotations

import getpass
import json
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec

from jaxpoint.errors import JaxpointError, MissingDependencyError

Method = Literal["dense", "sparse"]
METHODS: tuple[Method, ...] = ("dense", "sparse")
SOURCE = Path(__file__).parent / "ceres"
TOLERANCE = 1e-8
THREADS = 2


@dataclass(frozen=True)
class CeresRun:
    """What one run of the program printed."""

    initial_cost: float  # half the sum of squares, px^2
    cost: float
    iterations: int  # the failed ones too
    converged: bool
    solve_s: float  # of ceres::Solve, its preprocessing included
    minimizer_s: float  # of that, the iterations
    total_s: float  # with reading the file and setting the problem up
    threads: int
    peak_mb: float  # of the whole process


def build() -> Path:
    """The program, built outside of the source tree; what is up to date is not built again.

    Raises:
        MissingDependencyError: there is no compiler, no cmake or no Ceres.
    """
    for program in ("cmake", "c++"):
        if shutil.which(program) is None:
            raise MissingDependencyError(
                f"The peer Ceres is built with '{program}', which is not there: install cmake, a C++ compiler and "
                "libceres-dev, or leave it out with --no-ceres."
            )
    folder = Path(tempfile.gettempdir()) / f"jaxpoint-ceres-{getpass.getuser()}"
    found = _ran("cmake", "-S", SOURCE, "-B", folder)
    if found.returncode != 0 and "Ceres" in found.stderr:
        raise MissingDependencyError(
            "The peer Ceres is not installed with its headers: install libceres-dev, or leave it out with --no-ceres."
        )
    made = _ran("cmake", "--build", folder) if found.returncode == 0 else found
    if made.returncode != 0:
        raise JaxpointError(f"The peer Ceres does not build: see 'cmake -S {SOURCE} -B {folder}' and its --build.")
    return folder / "ba"


def run(program: Path, problem: Path, method: Method, tolerance: float = TOLERANCE) -> CeresRun:
    """Solve a problem once.

    Raises:
        JaxpointError: the program failed.
    """
    ended = _ran(program, problem, method, str(tolerance), str(THREADS))
    if ended.returncode != 0:
        raise JaxpointError(f"Ceres ended with code {ended.returncode} on '{problem}': {ended.stderr.strip()}")
    return msgspec.convert(json.loads(ended.stdout), CeresRun)


def _ran(*command: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True)


if __name__ == "__main__":
    try:
        sys.stdout.write(f"{run(build(), Path(sys.argv[1]), METHODS[METHODS.index(sys.argv[2])])}\n")
    except JaxpointError as error:
        sys.stderr.write(f"ceres_peer: {error}\n")
        sys.exit(error.exit_code)
