"""How long does one gesture take, from the arms of its hold to the sentence?

An arm that is held for a second, as six cameras saw it, in a furnished room of 30 objects: held joints with the
calibration's part of their covariance, the ways of pointing, hits, probabilities of all objects, and the sentence.
Detection is not in it (`person.py`). Everything is compiled; the median and the 95th percentile of all calls are
given, by the clock and by the processor time of the process.

    python experiments/benchmarks/gesture.py
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

import jax
import numpy as np
import tyro

from jaxpoint.body.arm import ArmReason, ArmView, PointingArm
from jaxpoint.body.following import Following
from jaxpoint.body.predicted_axis import strips_axis
from jaxpoint.body.stature import limb_span
from jaxpoint.body.strip_pixels import strip_pixels
from jaxpoint.body.strips import Strip
from jaxpoint.body.tracking.head_tracks import HeadTracks, Status, Tracking
from jaxpoint.camera.rig import CameraRig
from jaxpoint.commands.console import table
from jaxpoint.config.simulation import SimulationSettings
from jaxpoint.evidence.limb_slices import SLICES
from jaxpoint.geometry.angles import turn_directions
from jaxpoint.pointing.answers import ObjectScene, answers
from jaxpoint.pointing.bias.bias import Bias, Fitted
from jaxpoint.pointing.bias.models import Constant
from jaxpoint.pointing.bias.spread import Spread
from jaxpoint.pointing.held_joints import held_joints
from jaxpoint.pointing.holds import Hold
from jaxpoint.pointing.line_hypotheses import Correction, correction_of, line_hypotheses
from jaxpoint.pointing.objects import Objects, Thing
from jaxpoint.pointing.room_box import Room
from jaxpoint.pointing.shapes import Rectangle
from jaxpoint.report.answer_text import sentence
from jaxpoint.simulate.scene import make_scene
from jaxpoint.simulate.viewpoints import random_viewpoints, rig_of

HEAD_M = 1.6  # above the floor
PIXEL_NOISE = 0.5
BIAS = np.deg2rad([5.0, 9.0])  # of the forearm of a person who points approximately, to the left and up


@dataclass(frozen=True)
class GestureTime:
    """What is timed."""

    frames: int = 12
    """Moments of a hold."""
    repeats: int = 200
    """Timed calls, after those that compile."""
    seed: int = 0


@dataclass(frozen=True)
class Given:
    """A gesture, measured in the images, and the room that it was made in."""

    rig: CameraRig
    following: Following
    hold: Hold
    scene: ObjectScene
    camera_covariance: np.ndarray
    correction: Correction
    target: str


def main(options: GestureTime) -> None:
    """Print the table."""
    with jax.enable_x64(True):
        given = drawn(options)
        stages = {
            "held joints, calibration's error included": lambda: held(given),
            "the whole, calibration's error included": lambda: answered(given, known=True),
            "the whole, calibration taken as true": lambda: answered(given, known=False),
        }
        rows = [(name, *timed(call, options.repeats)) for name, call in stages.items()]
    heads = ("one gesture, ms", "median", "95th percentile", "processor, median")
    sys.stdout.write("\n".join(table(heads, rows)) + f"\n{answered(given, known=True)}\n")


def held(given: Given):
    """Joints of the hold."""
    return held_joints(given.rig, given.following, [given.hold], given.camera_covariance)


def answered(given: Given, *, known: bool) -> str:
    """The sentence."""
    with jax.enable_x64(True):
        joints = held_joints(given.rig, given.following, [given.hold], given.camera_covariance if known else None)
        ways = line_hypotheses(joints, "auto", None, given.correction)
        return sentence(answers([given.hold], joints, ways, given.scene, [1], [0], known_errors=known)[0])


def timed(call: Callable[[], object], repeats: int) -> tuple[str, str, str]:
    """Milliseconds: median, 95th percentile, and median of the processor time."""
    for _ in range(3):
        call()
    wall, own = [], []
    for _ in range(repeats):
        start, used = time.perf_counter(), time.process_time()
        call()
        wall.append(1e3 * (time.perf_counter() - start))
        own.append(1e3 * (time.process_time() - used))
    return f"{np.median(wall):.1f}", f"{np.percentile(wall, 95):.1f}", f"{np.median(own):.1f}"


def drawn(options: GestureTime) -> Given:
    """A straight arm in the middle of a room of the simulator, and its pixels with noise."""
    settings, rngs = SimulationSettings(), [np.random.default_rng([options.seed, part]) for part in range(3)]
    room = make_scene(rngs[0], settings.scene)
    rig = rig_of(random_viewpoints(rngs[1], settings.viewpoints, room))
    rig = jax.tree.map(lambda leaf: leaf if leaf.dtype == np.int32 else np.asarray(leaf, float), rig)
    objects = Objects.of([Thing(thing.name, Rectangle(thing.corners), thing.kind) for thing in room.objects])
    centres = np.array([np.mean(thing.corners, axis=0) for thing in room.objects])
    head = np.array([room.size[0] / 2, room.size[1] / 2, HEAD_M])
    tip = head + np.array([0.55, -0.25, -0.2])
    target = int(rngs[2].integers(len(centres)))
    towards = centres[target] - tip
    ahead = np.asarray(turn_directions(towards / np.linalg.norm(towards), BIAS))
    arms = {(at, 0): _arm(rig, head, tip, ahead, rngs[2]) for at in range(options.frames)}
    times = np.linspace(0.0, 1.0, options.frames)
    hold = Hold(0, np.arange(options.frames), times, len(rig))
    behaviour = Spread(np.deg2rad(4.0) ** 2 * np.eye(2), 8)
    bias = Bias(("forearm",), Constant(BIAS), behaviour, behaviour.scale, behaviour,
                Fitted("", 0, 0, 0, None, None))  # fmt: skip
    scene = ObjectScene(objects, centres, Room(np.zeros(3), room.size), True)
    spread = np.tile([*[1e-3] * 6, *[1.0] * 4, *[1e-4] * 5], len(rig))
    following = _following(rig, head, times, arms)
    return Given(rig, following, hold, scene, np.diag(spread**2), correction_of(bias), room.objects[target].name)


def _arm(rig: CameraRig, head: np.ndarray, tip: np.ndarray, ahead: np.ndarray, rng: np.random.Generator) -> PointingArm:
    span = limb_span(head)
    places = tip - np.linspace(span[0], span[1], SLICES)[:, None] * ahead
    middle = np.asarray(rig.project(places)).transpose(1, 0, 2)
    middle = middle + rng.normal(0.0, PIXEL_NOISE, middle.shape)
    axis = strips_axis(rig, middle, np.ones(middle.shape[:2], bool), tip, ahead, span)
    strips = [Strip(own, np.full(SLICES, 20.0)) for own in middle]
    tips = np.asarray(rig.project(tip)) + rng.normal(0.0, PIXEL_NOISE, (len(rig), 2))
    views = tuple(ArmView(ArmReason.FOUND, tips[c], strips[c].base, 0.5, 1.0) for c in range(len(rig)))
    axis = jax.tree.map(np.asarray, axis)
    pixels = strip_pixels(strips, tips, axis, span)
    return PointingArm(tip + rng.normal(0.0, 0.003, 3), 0.01, axis, views, 0.5, pixels)


def _following(rig: CameraRig, head: np.ndarray, times: np.ndarray, arms: dict) -> Following:
    shape = (len(times), 1)
    seen = np.zeros((*shape, len(rig)), int)
    heads = HeadTracks(
        np.arange(len(times)), times, np.array([1]), np.tile(head, (*shape, 1)), np.full(shape, 0.01), seen == 0,
        np.full(shape, int(Status.MEASURED)), rig.names,
    )  # fmt: skip
    tracking = Tracking(
        heads, np.zeros((*shape, 3)), np.tile(1e-4 * np.eye(6), (*shape, 1, 1)), seen, heads.positions,
        np.tile(1e4 * np.eye(3), (*shape, 1, 1)), np.ones(shape),
    )  # fmt: skip
    return Following(tracking, seen, arms)


if __name__ == "__main__":
    main(tyro.cli(GestureTime, description=__doc__))
