"""Settings of simulated people: who they are, how they point, and what they do when.

Every quantity that varies is a distribution, so that an experiment can sweep it. Plain Python, as all settings are.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from msgspec import Meta

from jaxpoint.config.types import Count, Fraction, NotNegative, Positive


@dataclass(frozen=True)
class Uniform:
    """Evenly between two bounds."""

    low: float
    high: float

    def __post_init__(self) -> None:
        _check_range(self.low, self.high)


@dataclass(frozen=True)
class Normal:
    """A normal distribution, drawn again outside its bounds."""

    mean: float
    sd: NotNegative
    low: float
    high: float

    def __post_init__(self) -> None:
        _check_range(self.low, self.high)


def _check_range(low: float, high: float) -> None:
    if not low <= high:
        raise ValueError(f"low = {low:g} and high = {high:g} are no range; low must be at most high")


@dataclass(frozen=True)
class SleeveShares:
    """Relative frequencies of sleeves."""

    none: Fraction = 0.1
    short: Fraction = 0.4
    elbow: Fraction = 0.15
    rolled: Fraction = 0.15
    """Rolled up to the middle of the forearm."""
    long: Fraction = 0.2

    def __post_init__(self) -> None:
        if not any(vars(self).values()):
            raise ValueError("all shares are 0; give at least one kind of sleeve more")


@dataclass(frozen=True)
class LooksSettings:
    """Who the people are and what they wear."""

    stature_m: Uniform = Uniform(1.50, 1.95)
    build: Uniform = Uniform(0.90, 1.15)
    """Girth of trunk and limbs over that of an average build."""
    skin_tone: Uniform = Uniform(0.0, 1.0)
    """0 is the darkest, 1 the lightest skin of `simulate.people.colours`."""
    sleeves: SleeveShares = field(default_factory=SleeveShares)
    clothes_like_skin: Fraction = 0.22
    """Share of people whose shirt or trousers are beige, pink or brown."""
    patterned: Fraction = 0.3
    """Share of striped or mottled shirts."""
    shorts: Fraction = 0.12
    cap: Fraction = 0.25
    """Share of people with a coloured cap on the index finger."""
    cap_length_m: Uniform = Uniform(0.030, 0.040)
    left_handed: Fraction = 0.12
    bald: Fraction = 0.12
    long_hair: Fraction = 0.3


@dataclass(frozen=True)
class AccurateSettings:
    """Eye, fingertip and target in line."""

    elbow_flexion_deg: Normal = Normal(12.0, 7.0, 3.0, 30.0)
    """By how much the elbow is bent; a person's own mean."""
    swivel_deg: Normal = Normal(60.0, 15.0, 20.0, 100.0)
    """How far the elbow stands out from straight below the arm; a person's own."""
    aim_error_deg: Normal = Normal(0.0, 0.03, -0.07, 0.07)
    """By how much the fingertip leaves the line from the eye to the target, per axis and trial."""
    finger_error_deg: Normal = Normal(0.0, 4.0, -10.0, 10.0)
    """By how much the finger itself leaves that line, per axis; a person's own mean."""


@dataclass(frozen=True)
class ApproximateSettings:
    """The forearm goes roughly to the target; the eye takes no part.

    Errors are those of the elbow-wrist axis against the direction from the fingertip to the target. Where people
    were measured (`pointing_torsalve`: 7 people, 945 gestures), lines of the arm were too high by 15 to 18 degrees
    and turned inwards by 4 to 15; the thesis reports 4.9 degrees (7.4). The spread covers both.
    """

    elbow_flexion_deg: Normal = Normal(45.0, 15.0, 15.0, 80.0)
    swivel_deg: Normal = Normal(35.0, 15.0, 0.0, 70.0)
    elevation_bias_deg: Normal = Normal(9.0, 4.0, 0.0, 20.0)
    """Positive: too high; a person's own mean."""
    azimuth_bias_deg: Normal = Normal(5.0, 4.0, -8.0, 15.0)
    """Positive: turned inwards, to the left of a right hand's target; a person's own mean."""
    elevation_scatter_deg: Positive = 2.3
    """Standard deviation from trial to trial of one person."""
    azimuth_scatter_deg: Positive = 1.6
    finger_follows: Uniform = Uniform(0.2, 1.0)
    """Share of the forearm's error that the finger has too: 1 is a straight wrist."""


@dataclass(frozen=True)
class HoldSettings:
    """How the arm comes up, stays and goes down."""

    raise_s: Uniform = Uniform(0.6, 1.0)
    hold_s: Uniform = Uniform(0.8, 1.2)
    lower_s: Uniform = Uniform(0.6, 0.9)
    tremor_sd_m: Uniform = Uniform(0.002, 0.004)
    """Of the fingertip, in each of two directions across the arm."""
    tremor_hz: Uniform = Uniform(3.0, 8.0)


@dataclass(frozen=True)
class PointingSettings:
    """The law of behaviour, kept apart from every estimator.

    Who means an object points at its middle. Where another named object hides that from the pointing eye, the middle of
    the part that is seen is pointed at; an object of which hardly anything is seen is not meant, and who points at
    nothing looks past every object. Furniture without a name hides nothing here.
    """

    accurate: AccurateSettings = field(default_factory=AccurateSettings)
    approximate: ApproximateSettings = field(default_factory=ApproximateSettings)
    hold: HoldSettings = field(default_factory=HoldSettings)
    accurate_share: Fraction = 0.5
    """Share of people who point accurately."""
    eye_of_same_side: Fraction = 0.7
    """Share of people whose dominant eye is on the side of the pointing hand."""
    palm_turn_deg: Uniform = Uniform(15.0, 95.0)
    """0 is thumb up, 90 palm down; a person's own."""


@dataclass(frozen=True)
class PeopleSettings:
    """What happens in a session."""

    play: Literal["session", "gestures", "crossing", "empty"] = "session"
    """`session`: people enter, walk, stand or sit, and point. `gestures`: one after another they stand somewhere and
    point, nothing between. `crossing`: two people walk past each other. `empty`: nobody."""
    people: Count = 2
    """In `gestures`: how many gestures one person makes before the next takes over is gestures / people."""
    gestures: Count = 8
    """Of all people together."""
    crossings: Count = 4
    """In `crossing`: how often the two pass each other."""
    empty_s: Positive = 2.0
    """The room is empty for so long at the start."""
    change_s: NotNegative = 0.0
    """In `gestures`: the room is empty for so much longer before the next person takes over. Whoever follows heads
    takes people who come back within 2 s for who they were."""
    pause_s: Uniform = Uniform(0.3, 1.0)
    """Between what a person does."""
    sitting: Fraction = 0.2
    """Share of the stops at which the person sits, where there are chairs."""
    gestures_a_stop: Annotated[int, Meta(ge=1)] = 2
    nothing: Fraction = 0.15
    """Share of gestures that point at no object but at the wall, floor or ceiling."""
    walking_m_s: Uniform = Uniform(0.9, 1.3)
    target_distance_m: Uniform = Uniform(1.2, 6.0)
    turn_deg: Normal = Normal(0.0, 20.0, -50.0, 50.0)
    """How far the feet point away from the target."""
    looks: LooksSettings = field(default_factory=LooksSettings)
    pointing: PointingSettings = field(default_factory=PointingSettings)
