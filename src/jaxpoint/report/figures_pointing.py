"""The room with somebody who points: arm, line, its cone, and what is meant (thesis, figures 49, 50 and 52)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from mpl_toolkits.mplot3d.axis3d import Axis as Axis3D

from jaxpoint.report.style import BAD, FAINT, INK, PAGE

_ARM = "#e08214"
_OTHER = "#3b82d0"
_ELEVATION = 34  # degrees, from which the room is looked at
_RING = np.linspace(0.0, 2 * np.pi, 41)
_BODY = (("head", "shoulder"), ("shoulder", "elbow"), ("elbow", "wrist"), ("wrist", "tip"))


@dataclass(frozen=True)
class RoomScene:
    """What is the same for all gestures."""

    low: Float[np.ndarray, "3"]  # m, of the room
    high: Float[np.ndarray, "3"]  # m
    faces: Mapping[str, Sequence[Float[np.ndarray, "N 3"]]]  # m, outlines of the objects, by name
    cameras: Float[np.ndarray, "C 3"]  # m
    names: tuple[str, ...]  # of the cameras


@dataclass(frozen=True)
class PointingScene:
    """One gesture."""

    joints: Mapping[str, Float[np.ndarray, "3"]]  # m
    origin: Float[np.ndarray, "3"]  # m
    direction: Float[np.ndarray, "3"]  # unit
    length_m: float  # of the line as drawn
    sigma: float  # rad, of the direction: the cone is two of them
    meant: str | None  # the object
    others: Sequence[str]


def room_view(room: RoomScene, scene: PointingScene) -> Figure:
    """The room in 3-D: the object that is meant is red, others that may be meant are blue, the cone holds 86 %."""
    figure = Figure(figsize=(PAGE * 0.72, 5.4))
    ax = cast(Axes3D, figure.add_axes((0.0, 0.0, 1.0, 1.0), projection="3d", computed_zorder=False))
    _box(ax, room)
    for name, faces in room.faces.items():
        _object(ax, name, faces, name == scene.meant, name in scene.others)
    ax.scatter(*room.cameras.T, marker="s", s=22, c=INK, depthshade=False)
    for name, (x, y, z) in zip(room.names, room.cameras):
        ax.text(x, y, z + 0.1, name, color=INK, fontsize=7, ha="center")
    _person(ax, room, scene)
    end = scene.origin + scene.length_m * scene.direction
    ax.plot(*np.stack([scene.origin, end]).T, color=_ARM, lw=1.6, ls=(0, (4, 2)))
    _cone(ax, scene)
    ax.scatter(*end, s=26, c=BAD if scene.meant else _ARM, depthshade=False)
    ax.set(xlim=(room.low[0], room.high[0]), ylim=(room.low[1], room.high[1]), zlim=(room.low[2], room.high[2]))
    ax.set(xlabel="x, m", ylabel="y, m", zlabel="z, m")
    ax.set_box_aspect(tuple(room.high - room.low), zoom=1.0)  # pyright: ignore[reportArgumentType]
    ax.view_init(elev=_ELEVATION, azim=_azimuth(room, scene))
    for axis in cast(list[Axis3D], [ax.xaxis, ax.yaxis, ax.zaxis]):
        axis.set_pane_color((0.5, 0.55, 0.6, 0.04))
        axis.line.set_color(FAINT)
    ax.tick_params(labelsize=7)
    ax.locator_params(nbins=6)
    return figure


def _azimuth(room: RoomScene, scene: PointingScene) -> int:
    """From where to look, degrees: the line is long, what is meant faces us, the person is in front."""
    person = (scene.origin - (room.low + room.high) / 2)[:2] / np.linalg.norm((room.high - room.low)[:2])
    faces = room.faces.get(scene.meant, ()) if scene.meant else ()
    up = np.deg2rad(_ELEVATION)

    def merit(azimuth: int) -> float:
        across = np.deg2rad(azimuth)
        sight = np.array([np.cos(up) * np.cos(across), np.cos(up) * np.sin(across), np.sin(up)])
        length = float(np.linalg.norm(np.cross(scene.direction, sight)))
        facing = max((_facing(face, sight) for face in faces), default=1.0)
        return length + min(facing, 0.5) + float(person @ sight[:2])

    return max(range(-180, 180, 15), key=merit)


def _facing(face: Float[np.ndarray, "N 3"], sight: Float[np.ndarray, "3"]) -> float:
    """Which share of a face's area is seen from there."""
    spread = face - face.mean(axis=0)
    return float(abs(np.linalg.svd(spread)[2][2] @ sight))


def _box(ax: Axes3D, room: RoomScene) -> None:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    edges = [(a, b) for i, a in enumerate(corners) for b in corners[i + 1 :] if np.abs(a - b).sum() == 1]
    placed = [room.low + np.stack(edge) * (room.high - room.low) for edge in edges]
    ax.add_collection3d(Line3DCollection(placed, colors=FAINT, linewidths=0.8))


def _object(ax: Axes3D, name: str, faces: Sequence[np.ndarray], meant: bool, other: bool) -> None:
    color = BAD if meant else _OTHER if other else FAINT
    shown = Poly3DCollection(list(faces), facecolors=color, edgecolors=color, linewidths=1.8 if meant else 0.7)
    shown.set_alpha(0.5 if meant else 0.3 if other else 0.12)
    ax.add_collection3d(shown)
    if meant or other:
        x, y, z = np.concatenate(list(faces)).max(axis=0) * [0, 0, 1] + np.concatenate(list(faces)).mean(axis=0) * [
            1,
            1,
            0,
        ]
        ax.text(x, y, z + 0.08, name, color=color, weight="bold", fontsize=9, ha="center")


def _person(ax: Axes3D, room: RoomScene, scene: PointingScene) -> None:
    """A head, the trunk down to the floor, and the arm that points."""
    for start, end in _BODY:
        arm = start != "head"
        ends = np.stack([scene.joints[start], scene.joints[end]])
        ax.plot(*ends.T, color=_ARM if arm else INK, lw=3.0 if arm else 2.0, solid_capstyle="round")
    head = scene.joints["head"]
    floor = np.array([head[0], head[1], room.low[2]])
    ax.plot(*np.stack([head, floor]).T, color=INK, lw=2.0, alpha=0.6)
    turn = 0.12 * np.stack([np.cos(_RING), np.sin(_RING), 0 * _RING], axis=1)
    for ring in (turn, turn[:, [0, 2, 1]], turn[:, [2, 0, 1]]):
        ax.plot(*(head + ring).T, color=INK, lw=1.0)


def _cone(ax: Axes3D, scene: PointingScene) -> None:
    helper = np.eye(3)[int(np.argmin(np.abs(scene.direction)))]
    side = np.cross(scene.direction, helper)
    side /= np.linalg.norm(side)
    up = np.cross(scene.direction, side)
    spread = np.tan(2 * min(scene.sigma, 0.5))
    lines = []
    for share in (0.5, 1.0):
        reach = share * scene.length_m
        ring = np.cos(_RING)[:, None] * side + np.sin(_RING)[:, None] * up
        lines.append(scene.origin + reach * (scene.direction + spread * ring))
    lines += [np.stack([scene.origin, lines[-1][i]]) for i in range(0, 40, 10)]
    ax.add_collection3d(Line3DCollection(lines, colors=_ARM, linewidths=0.8, alpha=0.7))
