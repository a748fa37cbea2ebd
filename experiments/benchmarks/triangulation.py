"""How many points a second does `triangulate` find, beside OpenCV and a vmapped SVD?

Cameras stand in a ring around a room (`--views` of them), and all see every point, through lenses with distortion and
with 0.5 px of noise. One call is measured from numpy pixels to results that are there: everything is compiled, and
`triangulate` undistorts, refines by pixel error, and gives residuals, parallax and flags. Beside it: OpenCV's
undistortPoints and triangulatePoints (two views only; undistorted to its default accuracy, linear, no refinement) and
the null vector by a vmapped SVD in JAX (linear, of points that are undistorted already). All run in turn, and the table
has medians, by wall clock and by the processor time of the process; on a machine with other work the second says more.
The error is the root mean square distance from the truth.

    python experiments/benchmarks/triangulation.py --out triangulation.md
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import tyro

from jaxpoint.camera.rig import CameraRig
from jaxpoint.io.files import replacing
from jaxpoint.triangulation import triangulate

NOISE_PX = 0.5
SIZE_PX = np.array([1280, 720])


@dataclass(frozen=True)
class Speed:
    """Time triangulation."""

    views: tuple[int, ...] = (2, 4, 6)
    """Cameras that see every point."""
    points: int = 2**19
    """Points in a call."""
    svd_points: int = 2**14
    """Points in a call of the SVD, which is slow."""
    repeats: int = 7
    """Timed calls of each, after one that compiles."""
    seed: int = 0
    """Of the room."""
    out: Path | None = None
    """Also write the table here."""


@dataclass(frozen=True)
class Scene:
    """What the cameras saw, and the truth."""

    rig: CameraRig
    points: np.ndarray  # (N, 3), m
    pixels: np.ndarray  # (N, C, 2)


@dataclass(frozen=True)
class Peer:
    """One way to triangulate; `run` gives the first of the scene's points."""

    name: str
    count: int
    run: Callable[[], np.ndarray]


def main(options: Speed) -> None:
    """Time all, and print the table."""
    head = ["views", "method", "million points/s", "million points/processor second", "error, mm"]
    lines = [head, ["---"] * len(head)]
    for views in options.views:
        scene = scene_of(views, options.points, np.random.default_rng([options.seed, views]))
        lines += [[str(views), *row] for row in timed(peers_of(scene, options), scene, options.repeats)]
    text = "".join(f"| {' | '.join(line)} |\n" for line in lines)
    sys.stdout.write(text)
    if options.out is not None:
        with replacing(options.out) as file:
            file.write(text.encode())


def scene_of(views: int, count: int, rng: np.random.Generator) -> Scene:
    """Cameras 4 m from the middle of a room, 2.5 m up, and points in it."""
    angle = 2 * np.pi * np.arange(views) / max(views, 3)  # two are a third of the way around apart
    position = np.stack([4 * np.cos(angle), 4 * np.sin(angle), np.full(views, 2.5)], axis=1)
    forward = unit(np.array([0.0, 0.0, 1.0]) - position)
    right = unit(np.cross(forward, [0.0, 0.0, 1.0]))
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    lens = rng.normal([-0.2, 0.05, 0.0, 0.0, 0.0], [0.03, 0.01, 1e-3, 1e-3, 1e-3], (views, 5))
    rig = CameraRig.from_parameters(
        rng.uniform(700.0, 1000.0, (views, 2)),
        rng.uniform(-20.0, 20.0, (views, 2)) + SIZE_PX / 2,
        lens,
        rotation,
        -np.einsum("cij,cj->ci", rotation, position),
        np.tile(SIZE_PX, (views, 1)),
    )
    points = rng.uniform([-1.2, -1.2, 0.2], [1.2, 1.2, 1.8], (count, 3))
    return Scene(rig, points, np.asarray(rig.project(points)) + rng.normal(0.0, NOISE_PX, (count, views, 2)))


def unit(vectors: np.ndarray) -> np.ndarray:
    """Scaled to length 1."""
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def peers_of(scene: Scene, options: Speed) -> list[Peer]:
    """All that can do this scene."""
    visible = np.ones(scene.pixels.shape[:2], bool)

    def ours(covariance: bool) -> np.ndarray:
        found = triangulate(scene.rig, scene.pixels, visible, covariance=covariance)
        return np.asarray(jax.block_until_ready(found).points)

    count = len(scene.points)
    peers = [
        Peer("`triangulate`", count, lambda: ours(covariance=True)),
        Peer("`triangulate`, no covariance", count, lambda: ours(covariance=False)),
    ]
    if scene.pixels.shape[1] == 2:
        peers.append(Peer("OpenCV (linear)", count, lambda: opencv(scene)))
    few = min(options.svd_points, count)
    ideal, _ = scene.rig.undistort(scene.pixels[:few])
    matrices = scene.rig.matrices
    peers.append(Peer("SVD in JAX (linear)", few, lambda: np.asarray(by_svd(matrices, ideal))))
    return peers


def opencv(scene: Scene) -> np.ndarray:
    """undistortPoints and triangulatePoints."""
    ideal, poses = [], []
    for index, camera in enumerate(scene.rig):
        lens = np.asarray(camera.distortion)
        seen = np.ascontiguousarray(scene.pixels[:, index])[:, None]
        ideal.append(cv2.undistortPoints(seen, np.asarray(camera.intrinsics), lens)[:, 0].T)
        pose = camera.cam_from_world
        poses.append(np.column_stack([np.asarray(pose.rotation), np.asarray(pose.translation)]))
    found = cv2.triangulatePoints(*poses, *ideal)
    return (found[:3] / found[3]).T


@jax.jit
def by_svd(matrices: jax.Array, pixels: jax.Array) -> jax.Array:
    """The null vector of the rows x P3 - P1 and y P3 - P2."""

    def one(pixel: jax.Array) -> jax.Array:
        rows = pixel[:, :, None] * matrices[:, 2:] - matrices[:, :2]
        rows = rows.reshape(-1, 4)
        null = jnp.linalg.svd(rows / jnp.linalg.norm(rows, axis=1, keepdims=True), full_matrices=False)[2][-1]
        return null[:3] / null[3]

    return jax.vmap(one)(pixels)


def timed(peers: list[Peer], scene: Scene, repeats: int) -> list[list[str]]:
    """Name, speeds and error of each; they run in turn."""
    errors = [np.sqrt(np.mean(np.sum((peer.run() - scene.points[: peer.count]) ** 2, axis=1))) for peer in peers]
    seconds = np.empty((repeats, len(peers), 2))
    for row in seconds:
        for index, peer in enumerate(peers):
            wall, processor = time.perf_counter(), time.process_time()
            peer.run()
            row[index] = time.perf_counter() - wall, time.process_time() - processor
    middle = np.median(seconds, axis=0)
    return [
        [peer.name, *(f"{peer.count / 1e6 / each:.2f}" for each in spent), f"{1e3 * error:.3f}"]
        for peer, spent, error in zip(peers, middle, errors)
    ]


if __name__ == "__main__":
    with jax.enable_x64(True):
        main(tyro.cli(Speed, description=__doc__))
