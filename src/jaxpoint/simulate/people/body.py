"""A person's surface: made once, then carried along by the bones of a pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8

from jaxpoint.simulate.mesh import PARTS_A_PERSON, Mesh, Part
from jaxpoint.simulate.people.bones import NUMBER
from jaxpoint.simulate.people.hand import hand_surfaces
from jaxpoint.simulate.people.limbs import arm_surfaces, leg_surfaces, neck_surface
from jaxpoint.simulate.people.simulated_person import Person
from jaxpoint.simulate.people.surface import Surface
from jaxpoint.simulate.people.trunk import head_surface, trunk_surface, yoke_surface

SLOTS = 8  # persons that a mask of 8 bits can tell apart
MOTTLE_SD = 0.06  # of cloth's albedo, from corner to corner


@dataclass(frozen=True)
class Frames:
    """Where the B bones of a pose are: rotations (columns x, y, z) and origins, world metres."""

    rotation: Float[np.ndarray, "B 3 3"]
    origin: Float[np.ndarray, "B 3"]


@dataclass(frozen=True)
class Body:
    """V corners, each in the frame of its bone; those of the trunk also in the thorax's, with a weight."""

    vertices: Float[np.ndarray, "V 3"]
    normals: Float[np.ndarray, "V 3"]
    bones: Int[np.ndarray, " V"]
    trunk: slice  # the corners that two bones move
    upper: Float[np.ndarray, "K 3"]  # the trunk's corners in the thorax's frame
    weight: Float[np.ndarray, "K 1"]  # the thorax's share in them
    triangles: Int[np.ndarray, "T 3"]
    parts: UInt8[np.ndarray, " V"]
    albedo: Float[np.ndarray, "V 3"]

    def mesh(self, frames: Frames) -> Mesh:
        """The surface in the pose of these bones."""
        turn = frames.rotation[self.bones]
        vertices = np.matmul(turn, self.vertices[:, :, None])[:, :, 0] + frames.origin[self.bones]
        normals = np.matmul(turn, self.normals[:, :, None])[:, :, 0]
        thorax = NUMBER["thorax"]
        upper = self.upper @ frames.rotation[thorax].T + frames.origin[thorax]
        vertices[self.trunk] += self.weight * (upper - vertices[self.trunk])
        turned = self.normals[self.trunk] @ frames.rotation[thorax].T
        blend = normals[self.trunk] + self.weight * (turned - normals[self.trunk])
        normals[self.trunk] = blend / np.linalg.norm(blend, axis=1, keepdims=True)
        return Mesh(vertices, normals, self.triangles, self.parts, self.albedo)


def make_body(person: Person) -> Body:
    """The surface of a person; the cap, if there is one, is on the index finger of the hand that points."""
    size = person.proportions
    pieces: list[tuple[str, Part, Surface]] = [("pelvis", Part.BODY, _trunk(person))]
    pieces += [("thorax", Part.BODY, yoke_surface(person, side)) for side in ("left", "right")]
    pieces += [("neck", Part.NECK, neck_surface(person)), ("head", Part.HEAD, head_surface(person))]
    arm, leg = arm_surfaces(person), leg_surfaces(person)
    for side in ("left", "right"):
        hand = hand_surfaces(person, side, capped=person.cap is not None and side == person.handed)
        for bone, surface in (arm | leg | hand).items():
            pieces.append((f"{side}_{bone}", _part(side, bone), surface))
    counts = [len(surface.vertices) for _, _, surface in pieces]
    starts = np.cumsum([0, *counts])
    trunk = pieces[0][2].vertices
    offset = np.array([0.0, 0.0, size.neck_height - size.hip_height])  # of the thorax's origin from the pelvis's
    height = (trunk[:, 2] + size.hip_height) / size.stature
    share = np.clip((height - 0.56) / (0.70 - 0.56), 0.0, 1.0)[:, None]
    parts = np.repeat([part for _, part, _ in pieces], counts) + PARTS_A_PERSON * (person.number % SLOTS)
    return Body(
        vertices=np.concatenate([surface.vertices for _, _, surface in pieces]),
        normals=np.concatenate([surface.normals for _, _, surface in pieces]),
        bones=np.repeat([NUMBER[bone] for bone, _, _ in pieces], counts),
        trunk=slice(0, counts[0]),
        upper=trunk - offset,
        weight=share**2 * (3 - 2 * share),
        triangles=np.concatenate([surface.triangles + start for (_, _, surface), start in zip(pieces, starts)]),
        parts=parts.astype(np.uint8),
        albedo=np.concatenate([_mottled(person, surface.albedo) for _, _, surface in pieces]),
    )


def _trunk(person: Person) -> Surface:
    """The trunk in the pelvis's frame, whose origin lies between the hips."""
    made = trunk_surface(person)
    down = np.array([0.0, 0.0, person.proportions.hip_height])
    return Surface(made.vertices - down, made.normals, made.triangles, made.albedo)


def _part(side: str, bone: str) -> Part:
    if bone in ("upper_arm", "forearm"):
        return Part[f"{side}_{bone}".upper()]
    if bone in ("thigh", "shank", "foot"):
        return Part.BODY
    return Part[f"{side}_{'finger' if bone.startswith('index') else 'hand'}".upper()]


def _mottled(person: Person, albedo: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 3"]:
    """Cloth is a little uneven; a mottled shirt much more. Skin is even."""
    is_shirt = np.isclose(albedo, person.shirt).all(axis=1)
    rng = np.random.default_rng([person.number, len(albedo)])
    sd = MOTTLE_SD * np.where(is_shirt & (person.pattern == "mottled"), 5.0, 1.0)
    bare = np.isclose(albedo, person.skin).all(axis=1)
    noise = 1 + np.where(bare, 0.0, sd) * rng.normal(size=len(albedo))
    return np.clip(albedo * noise[:, None], 0.005, 0.98)
