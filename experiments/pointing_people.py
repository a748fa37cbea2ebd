"""People who point, as numbers: their joints in the hold, what they mean, and which cameras see it.

The bodies, laws of behaviour, rooms and cameras are the simulator's; no image is drawn. Only what a camera can see at
all is asked: forearm and finger within the image, before the lens, and not along the line of sight. Whether a body
hides an arm is not; sessions from pixels (`person_evaluation.py`) say what that costs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxpoint.camera.rig import CameraRig
from jaxpoint.config.people import AccurateSettings, ApproximateSettings, Normal, PeopleSettings, PointingSettings
from jaxpoint.config.simulation import SimulationSettings
from jaxpoint.geometry.arrays import as_float
from jaxpoint.pointing.objects import Objects, Thing
from jaxpoint.pointing.shapes import Rectangle
from jaxpoint.simulate.furniture import NamedObject
from jaxpoint.simulate.people.actor import Actor
from jaxpoint.simulate.people.bones import NUMBER
from jaxpoint.simulate.people.gesture import Gesture
from jaxpoint.simulate.people.play import make_play
from jaxpoint.simulate.scene import Scene, make_scene
from jaxpoint.simulate.simulated_session import floor_of
from jaxpoint.simulate.viewpoints import Viewpoint, random_viewpoints, rig_of

POINTS = ("tip", "knuckle", "wrist", "elbow", "shoulder", "head", "eye")
FOREARM_WIDTH_M = 0.08
SLANTED = np.deg2rad(20.0)  # nearer to the line of sight an arm is no segment any more


@dataclass(frozen=True)
class Setting:
    """A furnished room, its objects and its cameras."""

    seed: int
    scene: Scene
    viewpoints: tuple[Viewpoint, ...]
    things: tuple[NamedObject, ...]

    @staticmethod
    def drawn(seed: int, objects: int) -> Setting:
        """The simulator's room with more small objects on its walls, until there are as many as asked for."""
        settings = SimulationSettings()
        rngs = [np.random.default_rng([seed, part]) for part in range(3)]
        scene = make_scene(rngs[0], settings.scene)
        viewpoints = tuple(random_viewpoints(rngs[1], settings.viewpoints, scene))
        things = list(scene.objects)[:objects]
        while len(things) < objects:
            hung = _hung(rngs[2], scene, f"sign {len(things)}")
            if all(_apart(hung, thing) for thing in things):
                things.append(hung)
        return Setting(seed, scene, viewpoints, tuple(things))


@dataclass(frozen=True)
class Gestures:
    """G gestures in one room."""

    rig: CameraRig  # the true cameras
    objects: Objects
    points: dict[str, Float[np.ndarray, "G 3"]]  # of `POINTS`, m
    target: Float[np.ndarray, "G 3"]  # m
    meant: Int[np.ndarray, " G"]  # number of the object; -1: a place where none is
    person: Int[np.ndarray, " G"]  # different ones in all rooms
    seen: Bool[np.ndarray, "G C"]
    rank: Float[np.ndarray, "G C"]  # eccentricity times log of pixels: the thesis's order of views (7.3)

    def __len__(self) -> int:
        return len(self.target)

    @property
    def distance(self) -> Float[np.ndarray, " G"]:
        """From fingertip to target, m."""
        return np.linalg.norm(self.target - self.points["tip"], axis=1)

    def select(self, chosen: Bool[np.ndarray, " G"]) -> Gestures:
        """Some of them."""
        points = {name: place[chosen] for name, place in self.points.items()}
        rest = {name: getattr(self, name)[chosen] for name in ("target", "meant", "person", "seen", "rank")}
        return replace(self, points=points, **rest)


def gestures_of(
    settings: Sequence[Setting], pointing: PointingSettings, people: int, each: int, views: int = 3
) -> list[Gestures]:
    """In every room so many people, each with so many gestures, of which those are kept that enough cameras see."""
    found = []
    for number, setting in enumerate(settings):
        behaviour = PeopleSettings(play="gestures", people=people, gestures=people * each, pointing=pointing)
        floor = floor_of(setting.scene, setting.viewpoints)
        play = make_play(np.random.default_rng([setting.seed, 3]), behaviour, cast(Any, setting.things), floor)
        own = _measured(setting, play.actors, number * people)
        found.append(own.select(own.seen.sum(axis=1) >= views))
    return found


def law(share_accurate: float, **approximate: Any) -> PointingSettings:
    """The simulator's people with some of them accurate, and the others' errors as given."""
    return PointingSettings(accurate_share=share_accurate, approximate=replace(ApproximateSettings(), **approximate))


def exactly(value: float) -> Normal:
    """The same for everybody."""
    return Normal(value, 0.0, value, value)


def straight_accurate() -> PointingSettings:
    """Eye, fingertip and target exactly in line."""
    exact = AccurateSettings(aim_error_deg=exactly(0.0), finger_error_deg=exactly(0.0))
    return PointingSettings(accurate_share=1.0, accurate=exact)


def _measured(setting: Setting, actors: Sequence[Actor], first_person: int) -> Gestures:
    made = [(actor, gesture) for actor in actors for gesture in actor.gestures]
    joints = [_joints(actor, gesture) for actor, gesture in made]
    points = {name: np.stack([own[name] for own in joints]) for name in POINTS}
    number = {thing.name: k for k, thing in enumerate(setting.things)}
    seen, rank = np.stack([_looked_at(view, points) for view in setting.viewpoints], axis=-1)
    with jax.enable_x64(True):
        objects = Objects.of([Thing(thing.name, Rectangle(thing.corners)) for thing in setting.things])
        rig = jax.tree.map(lambda leaf: leaf if leaf.dtype == np.int32 else as_float(leaf), rig_of(setting.viewpoints))
    return Gestures(
        rig,
        objects,
        points,
        np.stack([gesture.target_m for _, gesture in made]),
        np.array([number.get(gesture.target, -1) for _, gesture in made]),
        np.array([first_person + gesture.person for _, gesture in made]),
        seen.astype(bool),
        rank,
    )


def _joints(actor: Actor, gesture: Gesture) -> dict[str, np.ndarray]:
    """The arm that points and the head, in the middle of the hold; the eye is the one nearer to the line of sight."""
    skeleton = actor.skeleton((gesture.hold_first_s + gesture.hold_last_s) / 2)
    side = gesture.hand
    own = {name: skeleton.joints[f"{side}_{name}"] for name in ("tip", "wrist", "elbow", "shoulder")}
    eyes = [skeleton.joints[f"{eye}_eye"] for eye in ("left", "right")]
    sight = gesture.target_m - own["tip"]
    off = [np.linalg.norm(np.cross(sight, own["tip"] - eye)) / np.linalg.norm(own["tip"] - eye) for eye in eyes]
    knuckle = skeleton.frames.origin[NUMBER[f"{side}_index_near"]]
    return own | {"knuckle": knuckle, "head": skeleton.joints["head"], "eye": eyes[int(np.argmin(off))]}


def _looked_at(view: Viewpoint, points: dict[str, np.ndarray]) -> np.ndarray:
    """Whether a camera sees forearm and finger, and how well the thesis would rank it, (2, G)."""
    width, height = view.size
    pixels, depths = zip(*(view.project(points[name]) for name in ("tip", "wrist", "elbow")))
    within = [(p >= 0).all(axis=1) & (p[:, 0] < width) & (p[:, 1] < height) & (d > 0.3) for p, d in zip(pixels, depths)]
    axis, sight = points["elbow"] - points["wrist"], points["wrist"] - view.position
    lengths = np.linalg.norm(axis, axis=1) * np.linalg.norm(sight, axis=1)
    sine = np.linalg.norm(np.cross(axis, sight), axis=1) / lengths
    seen = np.all(within, axis=0) & (sine > np.sin(SLANTED))
    long = np.linalg.norm(np.where(seen[:, None], pixels[2] - pixels[0], 1.0), axis=1)
    wide = view.focal * FOREARM_WIDTH_M / np.where(seen, depths[1], 1.0)
    eccentricity = np.sqrt(np.maximum(1 - (wide / np.maximum(long, 1e-9)) ** 2, 0.0))
    return np.stack([seen, np.where(seen, eccentricity * np.log(long * wide), -np.inf)])


def _hung(rng: np.random.Generator, scene: Scene, name: str) -> NamedObject:
    """A sign on a wall, clear of what stands there."""
    x, y, z = np.eye(3)
    walls = (
        (y * 0.005, x, 0),
        (scene.size * y - y * 0.005, x, 0),
        (x * 0.005, y, 1),
        (scene.size * x - x * 0.005, y, 1),
    )
    while True:
        start, along, axis = walls[int(rng.integers(4))]
        wide, high = rng.uniform(0.12, 0.35, 2)
        middle = start + along * rng.uniform(0.3, scene.size[axis] - 0.3) + z * rng.uniform(0.5, 2.4)
        inside = (middle > scene.boxes[:, 0] - 0.2) & (middle < scene.boxes[:, 1] + 0.2)
        if not inside.all(axis=1).any():
            side, up = along * wide / 2, z * high / 2
            corners = np.stack([middle - side + up, middle + side + up, middle - side - up, middle + side - up])
            return NamedObject(name, "sign", (), corners)


def _apart(one: NamedObject, other: NamedObject) -> bool:
    """Whether two rectangles leave a little room between them."""
    reach = [np.linalg.norm(np.ptp(np.asarray(thing.corners), axis=0)) / 2 for thing in (one, other)]
    gap = np.asarray(one.corners).mean(axis=0) - np.asarray(other.corners).mean(axis=0)
    return bool(np.linalg.norm(gap) > min(sum(reach), reach[0] + 0.35) + 0.03)
