"""Who a person is: drawn once, the same in every frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from jaxpoint.config.people import LooksSettings
from jaxpoint.simulate.people import colours
from jaxpoint.simulate.people.drawing import chosen, draw
from jaxpoint.simulate.people.proportions import Proportions

Side = Literal["left", "right"]
# How much of the arm is covered, 0 the shoulder, 1 the elbow, 2 the wrist.
SLEEVES = {"none": 0.0, "short": 0.5, "elbow": 0.95, "rolled": 1.45, "long": 1.97}


@dataclass(frozen=True)
class Person:
    """One person. Colours are linear red, green, blue, 0..1."""

    number: int
    stature_m: float
    build: float  # girth over that of an average build
    handed: Side
    tone: float  # of the skin, 0 dark to 1 light
    skin: Float[np.ndarray, "3"]
    hair: Float[np.ndarray, "3"]
    hair_style: Literal["bald", "short", "long"]
    shirt: Float[np.ndarray, "3"]
    pattern: Literal["plain", "stripes", "mottled"]
    trousers: Float[np.ndarray, "3"]
    shoes: Float[np.ndarray, "3"]
    sleeve: str  # a key of SLEEVES
    shorts: bool
    clothes_like_skin: Literal["no", "shirt", "trousers"]
    cap: Float[np.ndarray, "3"] | None
    cap_length_m: float

    @property
    def proportions(self) -> Proportions:
        return Proportions(self.stature_m)


def draw_person(rng: np.random.Generator, number: int, settings: LooksSettings) -> Person:
    """One person; what is drawn for one quantity does not depend on the settings of another."""
    which = "no"
    if rng.random() < settings.clothes_like_skin:
        which = "shirt" if rng.random() < 0.6 else "trousers"
    cap = colours.linear_from_hex(str(rng.choice(colours.CAPS))) if rng.random() < settings.cap else None
    tone = draw(rng, settings.skin_tone)
    head = rng.random()
    return Person(
        number=number,
        stature_m=draw(rng, settings.stature_m),
        build=draw(rng, settings.build),
        handed="left" if rng.random() < settings.left_handed else "right",
        tone=tone,
        skin=colours.skin_albedo(rng, tone),
        hair=_cloth(rng, colours.HAIR if tone < 0.5 else colours.LIGHT_HAIR),
        hair_style="bald" if head < settings.bald else "long" if head > 1 - settings.long_hair else "short",
        shirt=_cloth(rng, colours.CLOTHES_LIKE_SKIN if which == "shirt" else colours.CLOTHES),
        pattern="plain" if rng.random() >= settings.patterned else "stripes" if rng.random() < 0.5 else "mottled",
        trousers=_cloth(rng, colours.CLOTHES_LIKE_SKIN if which == "trousers" else colours.CLOTHES),
        shoes=_cloth(rng, ("1c1a18", "3a2a20", "e8e8e8", "27313d")),
        sleeve=chosen(rng, vars(settings.sleeves)),
        shorts=rng.random() < settings.shorts,
        clothes_like_skin=which,
        cap=cap,
        cap_length_m=draw(rng, settings.cap_length_m),
    )


def _cloth(rng, codes) -> np.ndarray:
    """One of the colours, a little lighter or darker."""
    return np.clip(colours.linear_from_hex(str(rng.choice(codes))) * rng.uniform(0.85, 1.15), 0.0, 0.95)
