"""Names and numbers of the bones: every corner of a body moves with one of them (the trunk with two)."""

from __future__ import annotations

FINGERS = ("index", "middle", "ring", "little", "thumb")
ARM = ("upper_arm", "forearm", "hand", *(f"{finger}_{part}" for finger in FINGERS for part in ("near", "far")))
LEG = ("thigh", "shank", "foot")
BONES = (
    "pelvis",
    "thorax",
    "neck",
    "head",
    *(f"{side}_{bone}" for side in ("left", "right") for bone in (*ARM, *LEG)),
)
NUMBER = {name: number for number, name in enumerate(BONES)}
