"""A simulated session: six cameras watch people in a room, and the truth is known of every frame.

`simulate_session` builds it from settings and a seed; its frames stream without touching the disk. The same settings
and seed give the same frames, in whatever order they are asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np
from jaxtyping import Float, UInt8

from jaxpoint.camera.rig import CameraRig
from jaxpoint.config.simulation import FaultSettings, SimulationSettings
from jaxpoint.errors import UsageError
from jaxpoint.simulate.camera_clocks import Clocks, make_clocks
from jaxpoint.simulate.furniture import NamedObject
from jaxpoint.simulate.lighting import RoomLight, light_room
from jaxpoint.simulate.mesh import PARTS_A_PERSON, Mesh
from jaxpoint.simulate.people.actor import Actor
from jaxpoint.simulate.people.floor import Floor
from jaxpoint.simulate.people.gesture import Gesture
from jaxpoint.simulate.people.play import Play, make_play
from jaxpoint.simulate.people.simulated_person import Side
from jaxpoint.simulate.render import Drawn, LitPeople, RoomView, draw_people, light_people, nobody, render_room
from jaxpoint.simulate.scene import SIZE_M, Scene, make_scene
from jaxpoint.simulate.sensor import NoiseField, Sensor, random_sensor
from jaxpoint.simulate.truth import ViewTruth, view_truth
from jaxpoint.simulate.viewpoints import Viewpoint, random_viewpoints, rig_of

Progress = Callable[[str, int, int], None]
"""Called with what is being made, how much of it is done, and how much there is."""

KEEP_FROM_CAMERA_M = 0.6  # nobody stands closer to a camera than that on the floor plan
OVERHEAD_M = 2.3  # what begins higher is above everyone, arms included


@dataclass(frozen=True)
class SimulatedFrame:
    """One image and its truth."""

    frame: int  # common moment: sync_index
    camera: int
    time_s: float  # of the camera's exposure, which clock errors move off the common moment
    image: UInt8[np.ndarray, "H W 3"]  # blue, green, red
    labels: UInt8[np.ndarray, "H W"]  # `Part`, plus PARTS_A_PERSON times the person
    views: tuple[ViewTruth, ...]  # one a person in the room


@dataclass(frozen=True)
class Moment:
    """Who is in the room at one time."""

    people: LitPeople
    joints: dict[int, dict[str, Float[np.ndarray, "3"]]]  # m, of each person


@dataclass(frozen=True)
class SimulatedSession:
    """A room, its cameras, and what happens in it."""

    settings: SimulationSettings
    seed: int
    scene: Scene
    light: RoomLight
    viewpoints: tuple[Viewpoint, ...]
    sensors: tuple[Sensor, ...]
    rooms: tuple[RoomView, ...]  # the empty room as each camera sees it
    play: Play
    clocks: Clocks
    shutter_s: float
    noise: NoiseField = field(repr=False)
    _kept: dict[float, Moment | None] = field(default_factory=dict, repr=False)

    @property
    def rig(self) -> CameraRig:
        """The true cameras, m."""
        return rig_of(self.viewpoints)

    @property
    def objects(self) -> tuple[NamedObject, ...]:
        """What can be pointed at."""
        return self.scene.objects

    @property
    def gestures(self) -> Sequence[Gesture]:
        """Who points at what, and when."""
        return self.play.gestures

    def time_of(self, frame: int) -> float:
        """Seconds of a common moment."""
        return frame / self.settings.frames_per_second

    def frame_at(self, time_s: float) -> int:
        """The common moment nearest to a time."""
        return round(time_s * self.settings.frames_per_second)

    def frames(
        self, moments: Sequence[int] | None = None, cameras: Sequence[int] | None = None
    ) -> Iterator[SimulatedFrame]:
        """Images in order of time, and of cameras within a moment, that these cameras have of these moments."""
        for moment in range(self.clocks.moments) if moments is None else moments:
            for camera in range(len(self.viewpoints)) if cameras is None else cameras:
                if self.clocks.present[moment, camera]:
                    yield self.frame(moment, camera)

    def frame(self, moment: int, camera: int) -> SimulatedFrame:
        """One camera's image of one moment.

        Raises:
            ValueError: the camera has no image of that moment.
        """
        if not self.clocks.present[moment, camera]:
            raise ValueError(f"Camera {camera} has no image of moment {moment}; see `clocks.present`.")
        time_s = float(self.clocks.shown_s[moment, camera])
        present, room = self.at(time_s), self.rooms[camera]
        shown = nobody(room.image) if present is None else draw_people(self.viewpoints[camera], room, present.people)
        views = () if present is None else self._views(camera, time_s, present, shown)
        image = self._developed(camera, int(self.clocks.source[moment, camera]), shown.image, time_s)
        return SimulatedFrame(moment, camera, time_s, image, shown.labels, views)

    def empty(self, frame: int, camera: int) -> UInt8[np.ndarray, "H W 3"]:
        """The empty room, recorded before anyone enters; frames count from 0."""
        time_s = (frame - self.settings.empty_frames) / self.settings.frames_per_second
        return self._developed(camera, frame - self.settings.empty_frames, self.rooms[camera].image, time_s)

    def present(self, time_s: float) -> list[Actor]:
        """Who is in the room."""
        return [actor for actor in self.play.actors if actor.present(time_s)]

    def pointing(self, time_s: float, person: int) -> Gesture | None:
        """The gesture that a person makes at a time, or the next one; the last one after it."""
        own = [gesture for gesture in self.play.gestures if gesture.person == person]
        return next((gesture for gesture in own if gesture.last_s >= time_s), own[-1] if own else None)

    def at(self, time_s: float) -> Moment | None:
        """Who is in the room at a time, None when nobody is; kept until another time is asked for."""
        if time_s not in self._kept:
            self._kept.clear()
            self._kept[time_s] = self._moment(time_s)
        return self._kept[time_s]

    def _moment(self, time_s: float) -> Moment | None:
        actors = self.present(time_s)
        if not actors:
            return None
        # Who appears or vanishes while the shutter is open is drawn at rest.
        moments = (time_s - self.shutter_s / 2, time_s + self.shutter_s / 2)
        start, end = (
            Mesh.joined([actor.mesh(moment if actor.present(moment) else time_s) for actor in actors])
            for moment in moments
        )
        joints = {actor.person.number: actor.joints(time_s) for actor in actors}
        return Moment(light_people(start, end, self.light), joints)

    def _views(self, camera: int, time_s: float, moment: Moment, shown: Drawn) -> tuple[ViewTruth, ...]:
        view = self.viewpoints[camera]
        return tuple(
            view_truth(view, moment.people, shown, person, self.hand(time_s, person), joints)
            for person, joints in moment.joints.items()
        )

    def hand(self, time_s: float, person: int) -> Side:
        """The hand with which a person points."""
        gesture = self.pointing(time_s, person)
        if gesture is not None:
            return gesture.hand
        return next(actor.person.handed for actor in self.play.actors if actor.person.number == person)

    def _developed(self, camera: int, moment: int, light: np.ndarray, time_s: float) -> np.ndarray:
        rng = np.random.default_rng([self.seed, 1, camera, moment + (1 << 20)])
        return self.sensors[camera].develop(light, self.noise.window(rng), self.brightness(moment, time_s))

    def brightness(self, moment: int, time_s: float) -> float:
        """Of all lamps together, about 1: flicker from frame to frame and a slow drift."""
        settings = self.settings.light
        rng = np.random.default_rng([self.seed, 2, moment + (1 << 20)])
        phase = np.random.default_rng([self.seed, 3]).uniform(0.0, 2 * np.pi)
        slow = settings.drift * np.sin(2 * np.pi * time_s / settings.drift_s + phase)
        return float((1 + slow) * (1 + settings.flicker * np.clip(rng.normal(), -3.0, 3.0)))


def simulate_session(
    settings: SimulationSettings | None = None, seed: int = 0, progress: Progress | None = None
) -> SimulatedSession:
    """Draw a room, cameras and a play, and render the empty room for every camera.

    Args:
        settings: distributions of all that varies.
        seed: the same seed and settings give the same session.
        progress: called after every camera.

    Raises:
        UsageError: the settings ask for a play that cannot be, or for one shorter than a frame.
        ValueError: the room leaves people no place, or there are more of them than labels.
    """
    settings = settings or SimulationSettings()
    rngs = [np.random.default_rng([seed, 0, i]) for i in range(6)]
    scene = make_scene(rngs[0], settings.scene)
    light = light_room(scene)
    viewpoints = random_viewpoints(rngs[1], settings.viewpoints, scene)
    play = make_play(rngs[3], settings.people, cast(Any, scene.objects), floor_of(scene, viewpoints))
    highest = max((actor.person.number for actor in play.actors), default=0)
    if highest >= 256 // PARTS_A_PERSON:
        raise ValueError(
            f"The play has a person number {highest}, and labels know {256 // PARTS_A_PERSON} people; ask for fewer."
        )
    clocks = make_clocks(rngs[4], settings, _moments(play, settings))
    rooms = []
    for view in viewpoints:
        rooms.append(render_room(view, scene, light))
        if progress is not None:
            progress("room", len(rooms), len(viewpoints))
    sensors = tuple(
        _faulty(random_sensor(rngs[2], settings.sensor, room.image), i, settings.faults) for i, room in enumerate(rooms)
    )
    bounds = settings.sensor.shutter_s
    shutter = float(rngs[5].uniform(bounds.low, bounds.high))
    noise = NoiseField(rngs[5], settings.viewpoints.size)
    return SimulatedSession(
        settings, seed, scene, light, tuple(viewpoints), sensors, tuple(rooms), play, clocks, shutter, noise
    )


def _moments(play: Play, settings: SimulationSettings) -> int:
    """How many common moments the cameras have of a play."""
    moments = round(play.duration_s * settings.frames_per_second)
    if not moments:
        raise UsageError(
            f"The play lasts {play.duration_s:.1f} s, too short for a frame at {settings.frames_per_second:g} frames a "
            f"second; set [simulate] frames_per_second to {1 / play.duration_s:.2g} or more."
        )
    return moments


def _faulty(sensor: Sensor, camera: int, faults: FaultSettings) -> Sensor:
    """The sensor with what is wrong with it."""
    factor = dict(faults.exposure_factor).get(camera, 1.0)
    return replace(sensor, response=sensor.response * np.float32(factor), grey=camera in faults.grey)


def floor_of(scene: Scene, viewpoints: Sequence[Viewpoint] = ()) -> Floor:
    """The floor as people need it; nobody stands right before a camera."""
    boxes = np.array([(*low[:2], *high[:2], high[2]) for low, high in scene.boxes if low[2] < OVERHEAD_M])
    places = np.array([view.position[:2] for view in viewpoints]).reshape(-1, 2)
    kept = np.hstack([places - KEEP_FROM_CAMERA_M, places + KEEP_FROM_CAMERA_M])
    door = float(scene.door[0]), float(scene.door[1])
    return Floor(SIZE_M, boxes.tolist(), kept.tolist(), scene.chairs, door)
