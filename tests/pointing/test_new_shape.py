"""A shape that src/ does not know: 60 lines, and it is read, met, weighed, drawn and added like any other."""

import inspect
import json
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxpoint.cli import main
from jaxpoint.compilation import jit_once
from jaxpoint.errors import FileFormatError
from jaxpoint.geometry.line import Ray
from jaxpoint.io.object_files import read_objects
from jaxpoint.io.object_scene import read_scene
from jaxpoint.pointing.hits import intersect
from jaxpoint.pointing.mass import OutlineView, across
from jaxpoint.pointing.nearest import nearest, nearest_to_points
from jaxpoint.pointing.pointing_line import PointingLine
from jaxpoint.pointing.posterior import Behaviour, posterior
from jaxpoint.pointing.shapes import AbstractShape, register, unregister
from jaxpoint.pointing.shapes.polygon import in_frame
from jaxpoint.pointing.shapes.primitives import AbstractPrimitives
from jaxpoint.pointing.shapes.shape import length, vector
from jaxpoint.report.figures_pointing import PointingScene, RoomScene, room_view

SHARES = np.linspace(0.0, 1.0, 8)
RING = np.stack([f(2 * np.pi * np.arange(24) / 24) for f in (np.cos, np.sin, np.zeros_like)], axis=1)
UP = np.eye(3)[2]


@dataclass(frozen=True)
class Cylinder(AbstractShape):
    """An upright cylinder, met from outside."""

    center: np.ndarray
    radius: float
    height: float
    name, fields = "cylinder", (vector("center"), length("radius"), length("height"))
    sides = property(lambda self: (2 * self.radius, self.height))
    reach = property(lambda self: np.array([self.radius, self.radius, self.height / 2]))
    bounds = property(lambda self: (self.center - self.reach, self.center + self.reach))

    def primitives(self):
        return Cylinders, (self.center[None], np.array([self.radius]), np.array([self.height / 2]))


class Cylinders(AbstractPrimitives):
    center: jax.Array
    radius: jax.Array
    half: jax.Array  # of the height
    most: ClassVar[int | None] = None

    def bounding_spheres(self):
        return self.center, jnp.hypot(self.radius, self.half)

    def meet(self, ray):
        (x, y, z), d = (ray.origin[None] - self.center).T, jnp.where(ray.direction == 0, 1e-9, ray.direction)
        flat2, along = d[0] ** 2 + d[1] ** 2, x * d[0] + y * d[1]
        root2 = along**2 - flat2 * (x**2 + y**2 - self.radius**2)
        wall, ends = jnp.sqrt(jnp.where(root2 > 0, root2, 1.0)) / flat2, self.half / jnp.abs(d[2])
        enter = jnp.maximum(-along / flat2 - wall, -z / d[2] - ends)
        leave = jnp.minimum(-along / flat2 + wall, -z / d[2] + ends)
        hit = (root2 > 0) & (enter > 0) & (enter < leave)
        return jnp.where(hit, enter, jnp.inf), jnp.full_like(enter, 0.5), jnp.full_like(enter, 0.5)

    def point_distances(self, points):
        x, y, z = (points - self.center).T
        return jnp.hypot(jnp.maximum(jnp.hypot(x, y) - self.radius, 0.0), jnp.maximum(jnp.abs(z) - self.half, 0.0))

    def silhouettes(self, origin, frame=None):  # of each end the near arc, or the far one where that end is seen
        x, y, z = (origin[None] - self.center).T
        wide, towards = jnp.arccos(jnp.clip(self.radius / jnp.hypot(x, y), 0.0, 1.0)), jnp.arctan2(y, x)

        def corners(side, share):
            turn = towards + side * (2 * share * jnp.where(side * z > self.half, wide - jnp.pi, wide) - wide)
            rim = self.radius * jnp.cos(turn) - x, self.radius * jnp.sin(turn) - y, side * self.half - z
            return in_frame(frame, jnp.stack(rim, axis=1))

        ends = [jax.vmap(partial(corners, side))(SHARES) for side in (1.0, -1.0)]
        start = tuple(jnp.concatenate(part) for part in zip(*ends))
        return start, tuple(jnp.roll(part, -1, axis=0) for part in start), jnp.sign(self.radius)

    def shrink(self, about, share):
        return Cylinders(about + share * (self.center - about), share * self.radius, share * self.half)

    def outlines(self):
        each = zip(*(np.asarray(part) for part in (self.center, self.radius, self.half)))
        return np.array([[c + r * RING + side * half * UP for side in (1, -1)] for c, r, half in each])


CORNERS = ",".join(f"{corner}_{axis}" for corner in ("lt", "rt", "lb", "rb") for axis in "xyz")
TABLE = f"""name,shape,unit,kind,center_x,center_y,center_z,radius,height,{CORNERS}
poster,rectangle,cm,picture,,,,,,300,-40,200,300,40,200,300,-40,100,300,40,100
bin,cylinder,cm,,200,30,60,25,70{12 * ","}
lamp,sphere,cm,light,100,-150,180,20,{12 * ","}
"""
BIN = Cylinder(np.array([2.0, 0.3, 0.6]), 0.25, 0.7)
SPREAD = np.array([0.07, 0.05])
TIP = np.array([0.1, 0.0, 1.3])  # above the bin's upper end


@pytest.fixture
def table(tmp_path):
    register(Cylinder)
    (tmp_path / "objects.csv").write_text(TABLE)
    yield tmp_path / "objects.csv"
    unregister("cylinder")


def within(points):
    """Whether points lie in the bin."""
    gap = points - BIN.center
    return (np.hypot(gap[..., 0], gap[..., 1]) < BIN.radius) & (np.abs(gap[..., 2]) < BIN.height / 2)


def surface(count=500):
    """Points all over the bin: of its wall, and of its ends."""
    turn, share = np.meshgrid(np.linspace(0, 2 * np.pi, count), np.linspace(-1, 1, 200))
    ring = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=-1)
    wall = BIN.radius * ring + BIN.height / 2 * share[..., None] * UP
    ends = [BIN.radius * share[..., None] * ring + side * BIN.height / 2 * UP for side in (1, -1)]
    return BIN.center + np.concatenate([wall, *ends]).reshape(-1, 3)


def rays(origin, spread=0.35, count=48):
    """From a point to all about the bin."""
    to = BIN.center - origin + spread * np.random.default_rng(3).normal(size=(count, 3))
    return Ray(np.tile(origin, (count, 1)), to / np.linalg.norm(to, axis=1, keepdims=True))


def test_it_takes_60_lines():
    assert sum(len(inspect.getsource(part).splitlines()) for part in (Cylinder, Cylinders)) + 2 <= 60


def test_it_is_read(table):
    database = read_objects(table)
    assert [thing.shape.name for thing in database.things] == ["rectangle", "cylinder", "sphere"]
    np.testing.assert_allclose(database.things[1].shape.numbers, BIN.numbers)
    assert database.objects.names == ("poster", "bin", "lamp")
    np.testing.assert_allclose(database.objects.bounds, [[0.8, -1.7, 0.25], [3.0, 0.55, 2.0]], atol=1e-12)
    table.write_text(TABLE.replace("60,25,70", "60,-25,70"))
    with pytest.raises(FileFormatError, match=r"line 3: 'bin' has a side of -500 mm; an object needs at least 1 mm"):
        read_objects(table)


def test_hits_are_those_of_points_along_the_rays(table):
    objects, lines = read_objects(table).objects, rays(TIP)
    hits = intersect(lines, objects)
    along = np.linspace(0.0, 4.0, 40_001)
    inside = within(TIP + along[None, :, None] * np.asarray(lines.direction)[:, None])
    ours = np.asarray(hits.valid & (hits.object == 1))
    np.testing.assert_array_equal(ours.any(axis=1), inside.any(axis=1))
    first = along[inside.argmax(axis=1)[inside.any(axis=1)]]
    np.testing.assert_allclose(np.asarray(hits.distance)[ours], first, atol=2e-4)
    assert 10 < len(first) < 40


def test_it_is_as_near_as_its_nearest_points(table):
    objects, lines, points = read_objects(table).objects, rays(TIP), surface() - TIP
    far, misses = np.linalg.norm(points, axis=1), ~np.asarray(intersect(lines, objects).object == 1).any(axis=1)
    along = np.asarray(lines.direction) @ points.T
    angles = np.arccos(np.clip(along / far, -1, 1)).min(axis=1)
    across = np.sqrt(far**2 - np.maximum(along, 0.0) ** 2).min(axis=1)
    for measure, oracle, close in (("angle", angles, 3e-3), ("distance", across, 1e-3)):
        found = nearest(lines, objects, measure)
        ours = np.asarray(found.measure)[np.asarray(found.object == 1) & np.asarray(found.valid)]
        np.testing.assert_allclose(ours[misses], oracle[misses], atol=close)
        np.testing.assert_allclose(ours[~misses], 0.0, atol=1e-6)
    spot = nearest_to_points(TIP, objects)
    assert float(spot.measure[spot.object == 1][0]) == pytest.approx(far.min(), abs=1e-3)


@pytest.mark.parametrize("tip", [TIP, TIP - [0.0, 0.0, 1.2], TIP - [0.0, 0.0, 0.7]], ids=["above", "below", "beside"])
def test_its_mass_is_that_of_drawn_lines(table, tip):
    objects, rng = read_objects(table).objects, np.random.default_rng(1)
    direction = (BIN.center - tip + [0.0, 0.2, 0.2]) / np.linalg.norm(BIN.center - tip + [0.0, 0.2, 0.2])
    behaviour = Behaviour(*SPREAD, freedom=None)
    found = posterior(PointingLine(Ray(tip, direction), np.zeros((6, 6))), objects, behaviour)
    base = np.asarray(across(jnp.asarray(direction)))
    assert float(found.mass[1]) == pytest.approx(
        met_share(tip, direction + rng.normal(size=(20_000, 2)) * SPREAD @ base), abs=0.01
    )
    assert int(found.order[0]) == 1
    out, turn = (
        np.sqrt(rng.random(20_000)) * 0.4,
        rng.random(20_000) * 2 * np.pi,
    )  # of a cone, even on the plane before it
    share = met_share(tip, direction + np.stack([out * np.cos(turn), out * np.sin(turn)], axis=1) @ base, 1 + out**2)
    sizes = objects.shapes.each(lambda own: own.solid_angles(jnp.asarray(tip)))
    assert float(sizes[0]) == pytest.approx(share * np.pi * 0.4**2, rel=0.05)


def met_share(tip, directions, spread=None):
    """The share of directions in which the bin lies, each weighed by (1 + tan^2)^(-3/2) where `spread` is 1 + tan^2."""
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    met = within(tip + np.linspace(1.2, 2.6, 281)[:, None, None] * unit[None]).any(axis=0)
    return np.mean(met if spread is None else met * spread**-1.5)


def test_its_mass_has_derivatives(table):
    shapes, start = read_objects(table).objects.shapes, BIN.center - TIP + [0.0, 0.2, 0.2]
    start = jnp.asarray(start / np.linalg.norm(start))

    def mass(direction):
        view = OutlineView.of(PointingLine(Ray(TIP, direction), 1e-4 * jnp.eye(6)), jnp.diag(SPREAD**2), 4)
        return shapes.primitives[0].masses(view)[0]

    slopes = jit_once(jax.value_and_grad(mass))
    step = jnp.array([1e-6, -2e-6, 1e-6])
    there, back = slopes(start + step)[0], slopes(start - step)[0]
    assert float(slopes(start)[1] @ step) == pytest.approx(float(there - back) / 2, rel=1e-4)


def test_it_is_drawn_and_bounds_the_room(table):
    scene, _ = read_scene(table)
    np.testing.assert_allclose(scene.centres[1], BIN.center, atol=1e-12)
    room = RoomScene(
        np.asarray(scene.room.low), np.asarray(scene.room.high), scene.objects.outlines, TIP[None], ("cam",)
    )
    rims = room.faces["bin"]
    np.testing.assert_allclose([rim.mean(axis=0)[2] for rim in rims], [0.95, 0.25])
    arm = {name: TIP - 0.1 * i for i, name in enumerate(("tip", "wrist", "elbow", "shoulder", "head"))}
    to = (BIN.center - TIP) / np.linalg.norm(BIN.center - TIP)
    figure = room_view(room, PointingScene(arm, TIP, to, 1.8, 0.05, "bin", ("lamp",)))
    assert {"bin", "lamp", "cam"} == {text.get_text() for text in figure.axes[0].texts}


def test_the_commands_know_it(table, capsys):
    def run(*words):
        code = main(["objects", words[0], str(table), *words[1:]])
        out, err = capsys.readouterr()
        return code, out + err

    added = ("--name", "vase", "--shape", "cylinder", "--measures", "center", "1", "-0.5", "0.8", "radius", "0.1")
    code, text = run("add", *added)
    assert (code, "0 numbers for 'height' where 1 are needed" in text) == (2, True)
    code, text = run("add", *added, "height", "0.3")
    assert code == 0, text
    assert "0.200 x 0.300 m, a cylinder, measured" in text
    line = table.read_text().splitlines()[-1]
    assert line.startswith("vase,cylinder,cm,,100.00000,-50.00000,80.00000,10.00000,30.00000,,")
    code, text = run("list", "--json")
    assert [one["shape"] for one in json.loads(text)["objects"]] == ["rectangle", "cylinder", "sphere", "cylinder"]
    code, text = run("check", "--room-low", "0", "-3", "0", "--room-high", "2.1", "3", "3")
    assert (code, "'bin' reaches 0.15 m out of the room" in text) == (0, True)
