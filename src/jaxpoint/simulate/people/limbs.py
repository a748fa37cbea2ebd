"""Arms, legs, neck and feet: round about their bones, with sleeves and trouser legs.

The section of every limb is an ellipse whose centre lies on the line between the joints, but for a few millimetres
where forearm and calf bulge. Each limb ends in half balls about its joints, so that a bent joint has no gap.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from jaxpoint.simulate.people.simulated_person import SLEEVES, Person
from jaxpoint.simulate.people.surface import Surface, loft

SPACING_M = 0.026
# Along the bone (0..1): half width over stature of an average build. Girths after the means of Winter's and NASA-STD-
# 3000's tables: upper arm 30 cm around, forearm 27, wrist 17, thigh 56, calf 37, ankle 23.
UPPER_ARM = ((0.0, 0.0260), (0.12, 0.0290), (0.3, 0.0300), (0.6, 0.0280), (0.9, 0.0243), (1.0, 0.0236))
FOREARM = ((0.0, 0.0250), (0.25, 0.0252), (0.5, 0.0225), (0.85, 0.0160), (1.0, 0.0150))
THIGH = ((0.0, 0.0530), (0.15, 0.0525), (0.3, 0.0495), (0.7, 0.0395), (1.0, 0.0335))
SHANK = ((0.0, 0.0325), (0.3, 0.0340), (0.65, 0.0255), (0.9, 0.0205), (1.0, 0.0205))
FOREARM_BULGE_M = 0.003
CALF_BULGE_M = 0.006
CLOTH_M = 0.006  # how far cloth stands off, at least


def arm_surfaces(person: Person) -> dict[str, Surface]:
    """Upper arm and forearm, by bone; x is the palm's side, z the way to the hand."""
    size, covered = person.proportions, SLEEVES[person.sleeve]
    upper = _limb(person, size.upper_arm, UPPER_ARM, covered, person.shirt, loose=(-0.001, 0.009))
    lower = _limb(
        person, size.forearm, FOREARM, covered - 1, person.shirt, loose=(0.008, 0.005), flat=0.86, bulge=FOREARM_BULGE_M
    )
    return {"upper_arm": upper, "forearm": lower}


def leg_surfaces(person: Person) -> dict[str, Surface]:
    """Thigh, shank and foot, by bone; x is forwards, z the way down."""
    size = person.proportions
    thigh = _limb(person, size.thigh, THIGH, 0.85 if person.shorts else 2.0, person.trousers, loose=(0.006, 0.012))
    shank = _limb(
        person,
        size.shank,
        SHANK,
        -1.0 if person.shorts else 0.99,
        person.trousers,
        loose=(0.012, 0.020),
        bulge=-CALF_BULGE_M,
    )
    return {"thigh": thigh, "shank": shank, "foot": _foot(person)}


def neck_surface(person: Person) -> Surface:
    """The neck; z is up."""
    size = person.proportions
    length = size.skull_height - size.neck_height
    heights = np.array([-0.35, -0.3, 0.0, 0.4, 0.8, 1.2, 1.25]) * length
    half = np.array([0.0, 0.043, 0.036, 0.0325, 0.033, 0.030, 0.0]) * person.stature_m * (0.4 + 0.6 * person.build)
    return loft(heights, np.stack([1.05 * half, half], 1), np.tile(person.skin, (7, 1)), around=14)


def _limb(person, length, profile, covered, cloth, *, loose, flat=1.0, bulge=0.0) -> Surface:
    """A tapered limb of this length (m), covered by cloth up to the share `covered` of it.

    `loose` is how far the cloth stands off beyond CLOTH_M, at the near and at the far end; `flat` the thickness over
    the breadth at the far end; `bulge` how far (m) sections are off the bone where the limb is thickest.
    """
    scale = person.stature_m * person.build
    shares = np.linspace(0.0, 1.0, int(np.ceil(length / SPACING_M)) + 1)
    if 0 < covered < 1:
        kept = shares[np.abs(shares - covered) * length > 0.005]
        shares = np.sort([*kept, covered - 0.0005 / length, covered + 0.0005 / length])
    radius = scale * np.interp(shares, *np.transpose(profile))
    off = (0.012 if covered >= 2 else 0.0), 0.0  # trousers have no cuff at the knee
    first, last = radius[0] + off[0], radius[-1] + off[1]
    cap = np.array([[1.0, 0.0], [0.92, 0.39], [0.6, 0.8]])  # along and across of a quarter circle
    heights = np.concatenate([-cap[:, 0] * first, shares * length, length + cap[::-1, 0] * last])
    half = np.concatenate([cap[:, 1] * radius[0], radius, cap[::-1, 1] * radius[-1]])
    share = heights / length
    is_cloth = share <= covered if covered < 1 else np.full(len(share), True)
    stands_off = CLOTH_M + np.interp(share, [0.0, 1.0], loose)
    half = half + np.where(is_cloth & (half > 0), stands_off, 0.0)
    thin = np.interp(share, [0.3, 1.0], [1.0, flat])
    axes = np.stack([half * thin, half / np.where(thin > 0, thin, 1.0) ** 0.5], 1)
    centers = np.zeros((len(heights), 2))
    centers[:, 0] = bulge * np.exp(-(((share - 0.28) / 0.2) ** 2))
    return loft(heights, axes, _colours(person, heights, is_cloth, cloth), around=12, centers=centers)


def _colours(person, heights, is_cloth, cloth) -> Float[np.ndarray, "S 3"]:
    colour = np.where(is_cloth[:, None], cloth, person.skin)
    if person.pattern == "stripes" and cloth is person.shirt:
        dark = np.floor(heights / 0.055).astype(int) % 2 == 0
        colour = colour * np.where(is_cloth & dark, 0.6, 1.0)[:, None]
    return colour


def _foot(person: Person) -> Surface:
    """A shoe; z is forwards, x up, the origin in the ankle; the sole is flat and lies on the floor."""
    size = person.proportions
    along = np.array([-0.27, -0.25, -0.15, 0.0, 0.15, 0.3, 0.45, 0.6, 0.70, 0.73]) * size.foot
    top = np.array([0.2, 0.9, 1.15, 1.2, 1.0, 0.72, 0.55, 0.48, 0.40, 0.2]) * size.ankle
    wide = np.array([0.0, 0.72, 0.95, 1.0, 1.0, 1.15, 1.3, 1.2, 0.75, 0.0]) * 0.0225 * person.stature_m
    half = top / 2
    centers = np.stack([half - size.ankle, np.zeros(len(along))], 1)
    return loft(
        along, np.stack([half, wide], 1), np.tile(person.shoes, (10, 1)), around=12, centers=centers, exponent=3.0
    )
