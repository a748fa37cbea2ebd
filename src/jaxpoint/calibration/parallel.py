"""One adjustment on several devices: of one machine, or of many processes through `jax.distributed`.

The blocks of points lie spread over a mesh. Every device sums its part of the reduced camera system, one all-reduce a
step adds the parts, and the cameras are the same everywhere. Memory for points and observations falls with the number
of devices.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxpoint.calibration.bundle import Adjusted, run_solver
from jaxpoint.calibration.schur import Problem, SchurLevenbergMarquardt, Unknowns
from jaxpoint.compilation import jit

AXIS = "points"
_SPREAD, _WHOLE = PartitionSpec(AXIS), PartitionSpec()


def device_mesh(devices: list | None = None) -> Mesh:
    """A mesh of these devices, or of all that JAX knows, those of other processes included."""
    return Mesh(np.array(jax.devices() if devices is None else devices), (AXIS,))


def spread(mesh: Mesh, start: Unknowns, problem: Problem) -> tuple[Unknowns, Problem]:
    """Lay a problem over the mesh, its blocks padded by hidden ones to a multiple of the devices.

    With several processes each gives the blocks of its own frames, equally many, and the same cameras.

    Raises:
        ValueError: the problem has targets, priors of points or shared lenses, which one device solves.
    """
    if problem.targets or problem.point_priors is not None or problem.owner is not None:
        raise ValueError("Targets, priors of points and shared lenses are solved on one device: use `bundle.solve`.")
    missing = -len(start.points) % len(mesh.local_devices)

    def blocks(values):
        values = np.asarray(values)
        padded = np.concatenate([values, np.zeros((missing, *values.shape[1:]), values.dtype)])
        return jax.make_array_from_process_local_data(NamedSharding(mesh, _SPREAD), padded)

    def same(values):
        return jax.make_array_from_process_local_data(NamedSharding(mesh, _WHOLE), np.asarray(values))

    whole = jax.tree.map(same, problem)
    return (
        Unknowns(same(start.cameras), blocks(start.points)),
        replace(whole, pixels=blocks(problem.pixels), weights=blocks(problem.weights)),
    )


def local_blocks(values: jax.Array) -> np.ndarray:
    """The blocks that this process holds, in order (a solved problem's points)."""
    shards = sorted(values.addressable_shards, key=lambda shard: shard.index[0].start or 0)
    return np.concatenate([np.asarray(shard.data) for shard in shards])


@partial(jit, static_argnames="mesh")
def solve_on(mesh: Mesh, solver: SchurLevenbergMarquardt, start: Unknowns, problem: Problem) -> Adjusted:
    """`bundle.solve` on all devices of a mesh; start and problem as `spread` lays them.

    The same call in every process of a `jax.distributed` run. The optimum is that of one device.
    """
    solver = replace(solver, axis=AXIS)

    def part(cameras, points, pixels, weights, rest):
        own = replace(rest, pixels=pixels, weights=weights)
        end = run_solver(solver, Unknowns(cameras, points), own)
        return (end.cameras, end.cost, end.steps, end.settled), end.points

    specs = (_WHOLE, _SPREAD, _SPREAD, _SPREAD, _WHOLE)
    run = jax.shard_map(part, mesh=mesh, in_specs=specs, out_specs=(_WHOLE, _SPREAD), check_vma=False)
    rest = replace(problem, pixels=problem.pixels[:0], weights=problem.weights[:0])
    (cameras, *ends), points = run(start.cameras, start.points, problem.pixels, problem.weights, rest)
    return Adjusted(cameras, points, (), *ends)
