"""One adjustment by jaxpoint's engine, in a process of its own.

Prints a line of JSON when the first call has returned (its time, compilation included, steps and memory) and one with
the cost that was reached; then one for every line that it reads: another solve from the same start, now that everything
is compiled. With --cache the programs are kept in that folder for the next process. FILE is what
`problem.write_problem` wrote, or a BAL problem.

    yes | head -5 | python experiments/benchmarks/engine.py FILE
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from bal import BalModel, read_bal
from jax.sharding import Mesh
from problem import BundleProblem, read_problem
from scipy.spatial.transform import Rotation

from jaxpoint.calibration import bundle, parallel
from jaxpoint.calibration.schur import Problem, SchurLevenbergMarquardt, Unknowns
from jaxpoint.camera.brown import Brown
from jaxpoint.camera.parameters import ASPECT, CENTER, COEFFICIENTS, FOCAL, chosen_coefficients, size_of
from jaxpoint.compilation import keep_programs

TOLERANCE = 1e-8


@dataclass(frozen=True)
class Engine:
    """Solve one problem as often as asked."""

    problem: Annotated[Path, tyro.conf.Positional]
    """The problem: a file of this benchmark, or of BAL (.txt)."""
    cache: Path | None = None
    """Folder of compiled programs, used and filled."""
    rtol: float = TOLERANCE
    """Relative decrease of the cost below which the solver sees no progress."""
    steps: int = 200
    """Stop after so many steps."""
    devices: int = 1
    """Over so many devices of this machine the points are spread: of a CPU, its cores."""


@dataclass(frozen=True)
class Task:
    """All that `bundle.solve` takes, and the devices to do it on, where there are several."""

    solver: SchurLevenbergMarquardt
    start: Unknowns
    data: Problem
    mesh: Mesh | None = None

    def spread(self) -> Task:
        """The same task laid over all devices."""
        mesh = parallel.device_mesh()
        return Task(self.solver, *parallel.spread(mesh, self.start, self.data), mesh)


def main(options: Engine) -> None:
    """Solve once, then once for every line read."""
    imported_mb = memory_mb("VmRSS")
    if options.devices > 1:
        jax.config.update("jax_num_cpu_devices", options.devices)
    if options.cache is not None:
        keep_programs(options.cache)
    task = task_of(load(options.problem), options.rtol, options.steps)
    task = task.spread() if options.devices > 1 else task
    end, first_s = solve(task)
    figures = {"first_s": first_s, "device": jax.devices()[0].device_kind}
    figures |= {"steps": int(end.steps), "settled": bool(end.settled)}
    figures |= {"imported_mb": imported_mb, "peak_mb": memory_mb("VmHWM"), "device_peak_mb": device_peak_mb()}
    report(figures)
    report({"cost": cost_of(load(options.problem), end)})
    forget_peak()
    for _ in sys.stdin:
        end, seconds = solve(task)
        report({"seconds": seconds, "steps": int(end.steps), "peak_mb": memory_mb("VmHWM")})


def load(path: Path) -> BundleProblem:
    """The problem in a file of either kind."""
    return read_bal(path) if path.suffix == ".txt" else read_problem(path)


def solve(task: Task) -> tuple[bundle.Adjusted, float]:
    """The one call that is measured, and its seconds."""
    started = time.perf_counter()
    if task.mesh is None:
        end = bundle.solve(task.solver, task.start, task.data)
    else:
        end = parallel.solve_on(task.mesh, task.solver, task.start, task.data)
    end = jax.block_until_ready(end)
    return end, time.perf_counter() - started


def task_of(problem: BundleProblem, rtol: float, steps: int, block: int = bundle.BLOCK) -> Task:
    """The problem as the engine takes it: dense blocks of points, no priors, plain least squares."""
    cameras, base = as_unknown(problem)
    pixels, weights, points = dense(problem, block)
    free = free_of(problem.parameters)
    held = tuple(np.flatnonzero(~free).tolist())
    model = BalModel() if problem.parameters == 9 else bundle.CameraModel(held=held)
    nothing = jnp.zeros(cameras.shape)
    free = jnp.asarray(np.broadcast_to(free, cameras.shape))
    data = Problem(
        jnp.asarray(bundle.to_blocks(pixels, block)),
        jnp.asarray(bundle.to_blocks(weights, block)),
        jnp.asarray(base),
        free,
        prior_mean=nothing,
        prior_weight=nothing,
        loss_scale=jnp.asarray(bundle.LEAST_SQUARES),
        step_limit=jnp.asarray(steps),
    )
    solver = SchurLevenbergMarquardt(model=model, rtol=jnp.asarray(rtol))
    return Task(solver, Unknowns(jnp.asarray(cameras), jnp.asarray(bundle.to_blocks(points, block))), data)


def dense(problem: BundleProblem, block: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels (N, C, 2), weights (N, C) and points (N, 3); N is the number of points, rounded up to whole blocks."""
    count, cameras = -(-len(problem.points) // block) * block, len(problem.cameras)
    pixels, weights, points = np.zeros((count, cameras, 2)), np.zeros((count, cameras)), np.zeros((count, 3))
    pixels[problem.point_of, problem.camera_of] = problem.pixels
    weights[problem.point_of, problem.camera_of] = 1.0
    points[: len(problem.points)] = problem.points
    return pixels, weights, points


def free_of(parameters: int) -> np.ndarray:
    """Which numbers of the engine's camera the lens moves."""
    free = np.ones(9 if parameters == 9 else size_of(Brown), bool)
    if parameters == 11:
        free[ASPECT], free[COEFFICIENTS] = False, chosen_coefficients(Brown, ("k1", "k2"))
    return free


def as_unknown(problem: BundleProblem) -> tuple[np.ndarray, np.ndarray]:
    """The start as the engine has it: numbers of the cameras about their base rotations, and these."""
    base = Rotation.from_rotvec(problem.cameras[:, :3].copy()).as_matrix()
    if problem.parameters == 9:
        numbers = problem.cameras.copy()
    else:
        numbers = np.zeros((len(problem.cameras), size_of(Brown)))
        focals = problem.parameters == 15
        lens = problem.cameras[:, 7 + focals :]
        numbers[:, 3:6] = problem.cameras[:, 3:6]
        numbers[:, FOCAL] = np.log(problem.cameras[:, 6 + focals])
        numbers[:, ASPECT] = np.log(problem.cameras[:, 6] / problem.cameras[:, 6 + focals])
        numbers[:, CENTER.start : CENTER.start + lens.shape[1]] = lens
    numbers[:, :3] = 0.0
    return numbers, base


def as_cameras(numbers: np.ndarray, base: np.ndarray, parameters: int) -> np.ndarray:
    """The engine's cameras in the benchmark's own numbers, (C, p)."""
    turned = Rotation.from_rotvec(numbers[:, :3].copy()) * Rotation.from_matrix(base)
    pose = np.concatenate([turned.as_rotvec(), numbers[:, 3:6]], axis=1)
    if parameters == 9:
        return np.concatenate([pose, numbers[:, 6:]], axis=1)
    focal = np.exp(numbers[:, FOCAL])
    focals = [focal] if parameters == 11 else [focal * np.exp(numbers[:, ASPECT]), focal]
    lens = numbers[:, CENTER.start : CENTER.start + parameters - 6 - len(focals)]
    return np.concatenate([pose, np.stack(focals, axis=1), lens], axis=1)


def cost_of(problem: BundleProblem, end: bundle.Adjusted) -> float:
    """The cost of an answer, by the benchmark's own projection."""
    _, base = as_unknown(problem)
    cameras = as_cameras(np.asarray(end.cameras), base, problem.parameters)
    return problem.cost(cameras, bundle.from_blocks(end.points)[: len(problem.points)])


def memory_mb(name: str) -> float:
    """A figure of this process's memory as the kernel counts it: VmRSS now, VmHWM at most so far."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{name}:"):
            return float(line.split()[1]) / 1024.0
    return float("nan")


def forget_peak() -> None:
    """Let VmHWM start anew from what is held now."""
    Path("/proc/self/clear_refs").write_text("5")


def device_peak_mb() -> float | None:
    """At most so much of the accelerator's memory was in use; None where there is none."""
    statistics = jax.devices()[0].memory_stats()
    return None if statistics is None else statistics["peak_bytes_in_use"] / 2**20


def report(figures: dict[str, Any]) -> None:
    """One line of JSON."""
    sys.stdout.write(json.dumps(figures) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    with jax.enable_x64(True):
        main(tyro.cli(Engine, description=__doc__))
