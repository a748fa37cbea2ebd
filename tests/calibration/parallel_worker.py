"""One process of a spread adjustment: `parallel_worker.py DEVICES PROCESS PROCESSES PORT`; prints a line of JSON."""

import json
import sys

import jax

DEVICES, PROCESS, PROCESSES, PORT = map(int, sys.argv[1:])
FRAMES = 1024
jax.config.update("jax_num_cpu_devices", DEVICES)
jax.config.update("jax_enable_x64", True)
if PROCESSES > 1:
    jax.config.update("jax_cpu_collectives_implementation", "gloo")
    jax.distributed.initialize(f"127.0.0.1:{PORT}", num_processes=PROCESSES, process_id=PROCESS)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from scipy.spatial.transform import Rotation  # noqa: E402

from jaxpoint.calibration import bundle, parallel  # noqa: E402
from jaxpoint.calibration.schur import Problem, SchurLevenbergMarquardt, Unknowns  # noqa: E402
from jaxpoint.camera.brown import Brown  # noqa: E402
from jaxpoint.camera.parameters import CENTER, FOCAL, size_of  # noqa: E402


def room():
    """Four cameras on a ring about a cloud of points; every process makes all of it and takes its part."""
    rng = np.random.default_rng(0)
    base = Rotation.from_euler("y", np.arange(4)[:, None]).as_matrix()
    cameras = np.zeros((4, size_of(Brown)))
    cameras[:, 5], cameras[:, FOCAL], cameras[:, CENTER] = 5.0, np.log(800.0), (640.0, 360.0)
    points = rng.uniform(-1.0, 1.0, (FRAMES, 3))
    local = np.einsum("cij,fj->fci", base, points) + cameras[:, 3:6]
    pixels = 800.0 * local[..., :2] / local[..., 2:] + cameras[:, CENTER] + rng.normal(0, 0.5, (FRAMES, 4, 2))
    seen = (rng.random((FRAMES, 4)) < 0.8).astype(float)
    seen[:, :2] = 1.0  # a point that one camera alone sees has no optimum
    moved = cameras + np.where(np.arange(size_of(Brown)) < 6, rng.normal(0, 0.01, (4, size_of(Brown))), 0.0)
    return moved, base, pixels, seen, points + rng.normal(0, 0.02, points.shape)


def main():
    cameras, base, pixels, seen, points = room()
    own = slice(PROCESS * FRAMES // PROCESSES, (PROCESS + 1) * FRAMES // PROCESSES)
    weight = np.tile(1.0 / np.array([*6 * [0.1], 0.05, 0.01, 10, 10, 0.1, 0.1, 0.01, 0.01, 0.01]) ** 2, (4, 1))
    problem = Problem(
        bundle.to_blocks(pixels[own]),
        bundle.to_blocks(seen[own]),
        base,
        np.ones((4, size_of(Brown)), bool),
        cameras,
        weight,
        np.array(bundle.LEAST_SQUARES),
        np.array(100),
    )
    start = Unknowns(jnp.asarray(cameras), jnp.asarray(bundle.to_blocks(points[own])))
    mesh = parallel.device_mesh()
    start, problem = parallel.spread(mesh, start, jax.tree.map(jnp.asarray, problem))
    end = parallel.solve_on(mesh, SchurLevenbergMarquardt(bundle.CameraModel(), rtol=1e-12), start, problem)
    numbers = np.asarray(end.cameras)
    found = {
        "cost": float(end.cost),
        "settled": bool(end.settled),
        "focals": numbers[:, FOCAL].tolist(),
        "positions": numbers[:, 3:6].tolist(),
        "points": bundle.from_blocks(parallel.local_blocks(end.points)).tolist(),
        "bytes": [shard.data.nbytes for shard in problem.pixels.addressable_shards],
    }
    sys.stdout.write(json.dumps(found) + "\n")


main()
