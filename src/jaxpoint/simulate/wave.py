"""A light waved through the dark room: what `detect led` is made for, with what disturbs it.

The light is a matt ball around an LED. Shiny furniture mirrors it, devices on standby glow steadily, and a dim person
who carries it hides it from some cameras. A rolling shutter shows the light, and each of its mirror images, where it is
when that row is read.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8
from numpy.random import Generator
from scipy.interpolate import CubicSpline

from jaxpoint.config.simulation import WaveSettings
from jaxpoint.errors import UsageError
from jaxpoint.simulate.capsules import Capsule
from jaxpoint.simulate.mesh import Mesh, Part
from jaxpoint.simulate.render import LitPeople, RoomView, draw_people
from jaxpoint.simulate.simulated_session import SimulatedSession
from jaxpoint.simulate.viewpoints import Viewpoint

KNOT_FRAMES = 14  # between the random places through which the light goes: about 30 px a frame
LED_BGR = np.array([0.35, 0.45, 1.0])
GLINT_BGR = np.array([0.1, 1.0, 0.3])
PEAK = 1.6  # of the LED, over what saturates the sensor
HALO = 0.02  # of the lens, over the peak
SOFT_PX = 0.7  # standard deviation of the lens's blur
HALO_PX = 5.0
LED_LIGHT = 0.002  # what the LED sheds on things 1 m away, over the lamps
ROLLING_STEPS = 5  # to the moment at which a rolling shutter meets the light
SURFACE_M = 0.03  # what is nearer than this to a surface counts as on it


@dataclass(frozen=True)
class Carrier:
    """The person with the light."""

    capsules: tuple[Capsule, ...]

    @staticmethod
    def at(light: np.ndarray, behind: float, stature_m: float) -> Carrier:
        """Someone who holds the light before them; `behind` is the direction from the light to them, rad."""
        out = np.array([np.cos(behind), np.sin(behind), 0.0])
        ground = light * [1.0, 1.0, 0.0] + 0.5 * out
        up = np.array([0.0, 0.0, stature_m])
        shoulder = ground + 0.81 * up - 0.1 * out
        reach = light - shoulder
        hand = light - 0.08 * reach / np.linalg.norm(reach)
        return Carrier(
            (
                Capsule(ground + 0.12 * up, ground + 0.75 * up, 0.16),
                Capsule(ground + 0.9 * up, ground + 0.94 * up, 0.1, Part.HEAD),
                Capsule(shoulder, hand, 0.04, Part.RIGHT_FOREARM),
            )
        )

    def mesh(self) -> Mesh:
        """Their surface."""
        return Mesh.joined([capsule.mesh(np.array([0.3, 0.25, 0.22])) for capsule in self.capsules])

    def hides(self, eye: np.ndarray, light: np.ndarray) -> bool:
        """Whether they stand between a camera and the light."""
        return any(capsule.hides(eye, light) for capsule in self.capsules)


@dataclass(frozen=True)
class Spot:
    """A small ball of light."""

    place: Float[np.ndarray, "3"]  # m
    radius_m: float
    colour: Float[np.ndarray, "3"]  # blue, green, red, in shares of the sensor's range: it is exposed for the light


@dataclass(frozen=True)
class SimulatedWave:
    """A wave in the room of a session, seen by its cameras."""

    session: SimulatedSession
    path: Callable[[np.ndarray], np.ndarray]  # of the light, m, at any moments, in frames
    light: Float[np.ndarray, "F 3"]  # m; where it is when the middle row of each image is read
    behind: Float[np.ndarray, " F"]  # rad, direction from the light to who carries it
    glints: Float[np.ndarray, "G 3"]  # m
    stature_m: float
    darkness: float
    radius_m: float

    @property
    def frames(self) -> int:
        """Number of frames, F."""
        return len(self.light)

    @property
    def frames_per_second(self) -> float:
        """Of every camera."""
        return self.session.settings.wave.frames_per_second

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the images, px."""
        return self.session.settings.viewpoints.size

    def image(self, frame: int, camera: int) -> UInt8[np.ndarray, "H W 3"]:
        """One camera's image of one moment."""
        session = self.session
        view, room, sensor = session.viewpoints[camera], session.rooms[camera], session.sensors[camera]
        light = self.shown(frame, camera)
        carrier = Carrier.at(light, self.behind[frame], self.stature_m)
        shown = draw_people(view, room, _dimly_lit(carrier.mesh(), light, self.darkness)).image
        shown *= np.float32(self.darkness)
        for spot in self._spots(frame, camera, light, carrier):
            _add_spot(shown, sensor.response, view, room, spot)
        rng = np.random.default_rng([session.seed, 4, camera, frame])
        return sensor.develop(shown, session.noise.window(rng))

    def visible(self, frame: int, camera: int) -> bool:
        """Whether the camera sees the light itself, inside its image and hidden by nothing."""
        view, room = self.session.viewpoints[camera], self.session.rooms[camera]
        light = self.shown(frame, camera)
        carrier = Carrier.at(light, self.behind[frame], self.stature_m)
        if carrier.hides(view.position, light):
            return False
        return _shown_at(view, room, light) is not None

    def shown(self, frame: int, camera: int) -> Float[np.ndarray, "3"]:
        """Where the light (m) is when the camera's shutter meets it: at the frame's moment where it is a global one."""
        found = self._met(frame, camera, lambda light: light)
        return self.light[frame] if found is None else found

    def _met(
        self, frame: int, camera: int, place_of: Callable[[np.ndarray], np.ndarray | None]
    ) -> Float[np.ndarray, "3"] | None:
        """The place that the light, or an image of it, has when its row is read; None where there is none."""
        view, readout = self.session.viewpoints[camera], self.readouts.get(camera, 0.0)
        place = place_of(self.light[frame])
        for _ in range(ROLLING_STEPS if readout else 0):
            if place is None:
                return None
            row = np.nan_to_num(view.project(place[None])[0][0, 1])
            late = readout * (np.clip(row / view.size[1], 0.0, 1.0) - 0.5)
            place = place_of(self.path(np.array([frame + late]))[0])
        return place

    @property
    def readouts(self) -> dict[int, float]:
        """Frames from the first image row to the last, of the cameras with rolling shutters."""
        return dict(self.session.settings.wave.readouts)

    def _spots(self, frame: int, camera: int, light: np.ndarray, carrier: Carrier) -> list[Spot]:
        """The light, its mirror images, and glints, whether furniture hides them or not."""
        view = self.session.viewpoints[camera]
        spots = [Spot(glint, 0.002, 0.25 * GLINT_BGR) for glint in self.glints]
        if not carrier.hides(view.position, light):
            spots.append(Spot(light, self.radius_m, PEAK * LED_BGR))
        strength = self.session.settings.wave.reflections
        for corners, share in self.session.scene.mirrors if strength > 0 else ():
            place = self._met(frame, camera, lambda at, corners=corners: mirrored(corners, view.position, at))
            if place is not None:
                spots.append(Spot(place, 1.5 * self.radius_m, strength * share * PEAK * LED_BGR))
        return spots


def simulate_wave(session: SimulatedSession) -> SimulatedWave:
    """The wave of a session: the same session gives the same wave.

    Raises:
        UsageError: a rolling shutter is of a camera that is not there.
    """
    settings = session.settings.wave
    cameras = len(session.viewpoints)
    for camera, _ in settings.readouts:
        if camera >= cameras:
            raise UsageError(
                f"[simulate.wave] gives a readout of camera {camera}, but there are {cameras} cameras, numbered from 0."
            )
    rng = np.random.default_rng([session.seed, 5])
    glints = [corners.mean(axis=0) for corners, _ in session.scene.mirrors][: settings.glints]
    path = _path(rng, settings, session)
    return SimulatedWave(
        session,
        path,
        path(np.arange(settings.frames)),
        np.cumsum(rng.normal(0.0, 0.08, settings.frames)) + rng.uniform(0.0, 2 * np.pi),
        np.array(glints).reshape(-1, 3),
        float(rng.uniform(1.6, 1.9)),
        float(rng.uniform(settings.darkness.low, settings.darkness.high)),
        float(rng.uniform(settings.led_radius_m.low, settings.led_radius_m.high)),
    )


def _path(rng: Generator, settings: WaveSettings, session: SimulatedSession) -> Callable[[np.ndarray], np.ndarray]:
    """A smooth walk of the light through the room: places (m) at any moments, in frames."""
    knots = max(6, settings.frames // KNOT_FRAMES)
    low, high = session.scene.free_floor
    lowest, highest = np.append(low - 0.5, 0.25), np.append(high + 0.5, 2.2)
    path = CubicSpline(np.linspace(0.0, settings.frames - 1.0, knots), rng.uniform(lowest, highest, (knots, 3)))
    return lambda moments: np.clip(path(moments), 0.05, session.scene.size - 0.05)


def _dimly_lit(mesh: Mesh, light: np.ndarray, darkness: float) -> LitPeople:
    """Someone lit by the LED and by what is left of the room's light (which the caller darkens)."""
    offset = light - mesh.vertices
    square = np.maximum((offset**2).sum(axis=1), 0.01)
    facing = np.maximum(np.einsum("vc,vc->v", offset, mesh.normals), 0.0) / np.sqrt(square)
    glow = (LED_LIGHT / darkness * facing / square)[:, None] * LED_BGR
    colour = mesh.albedo[:, ::-1] * (0.3 + glow)
    none = np.zeros((0, 1, 1), np.float32)
    points = mesh.vertices
    return LitPeople(points, points, mesh.triangles, mesh.parts, colour.astype(np.float32), none, none)


def mirrored(corners: np.ndarray, eye: np.ndarray, light: np.ndarray) -> np.ndarray | None:
    """Where an eye sees a light in a mirror (left-top, right-top, left-bottom, right-bottom corners), or None."""
    left_top, across, down = corners[0], corners[1] - corners[0], corners[2] - corners[0]
    normal = np.cross(down, across)
    normal /= np.linalg.norm(normal)
    height_eye, height_light = (eye - left_top) @ normal, (light - left_top) @ normal
    if height_eye <= 0 or height_light <= 0:
        return None
    image = light - 2 * height_light * normal
    place = eye + (image - eye) * height_eye / (height_eye + height_light)
    u, v = (place - left_top) @ across / (across @ across), (place - left_top) @ down / (down @ down)
    return place + 0.005 * normal if 0 <= u <= 1 and 0 <= v <= 1 else None


def _shown_at(view: Viewpoint, room: RoomView, place: np.ndarray) -> tuple[np.ndarray, float] | None:
    """Pixel and depth (m) of a place that no furniture hides, or None."""
    pixels, depths = view.project(place[None])
    pixel, depth = pixels[0], float(depths[0])
    if not np.isfinite(pixel).all() or (pixel < 0).any() or (pixel > np.array(view.size) - 1).any():
        return None
    column, row = np.rint(2 * pixel + 0.5).astype(int)
    return None if depth > room.depth[row, column] + SURFACE_M else (pixel, depth)


def _add_spot(image: np.ndarray, response: np.ndarray, view: Viewpoint, room: RoomView, spot: Spot) -> None:
    """Add a spot with the lens's blur and halo, in place; nothing where furniture hides its middle."""
    shown = _shown_at(view, room, spot.place)
    if shown is None:
        return
    (x, y), depth = shown
    radius = view.focal * spot.radius_m / depth
    reach = int(np.ceil(radius + 4 * HALO_PX))
    left, top = max(0, round(x) - reach), max(0, round(y) - reach)
    part = np.s_[top : round(y) + reach + 1, left : round(x) + reach + 1]
    rows, columns = np.mgrid[: image[part].shape[0], : image[part].shape[1]]
    distance = np.hypot(columns + left - x, rows + top - y)
    disc = np.clip((radius - distance) / (2 * SOFT_PX) + 0.5, 0.0, 1.0) * min(1.0, (radius / SOFT_PX) ** 2)
    halo = HALO * np.exp(-0.5 * (distance / HALO_PX) ** 2)
    image[part] += ((disc + halo)[..., None] * spot.colour / response[part]).astype(np.float32)
