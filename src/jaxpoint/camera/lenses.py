"""All lenses by name, and what settings may ask for."""

from __future__ import annotations

from jaxpoint.camera.brown import Brown
from jaxpoint.camera.kannala_brandt import KannalaBrandt
from jaxpoint.camera.lens import AbstractLens
from jaxpoint.camera.pinhole import Pinhole
from jaxpoint.camera.rational import Rational
from jaxpoint.errors import UsageError

LENSES: dict[str, type[AbstractLens]] = {lens.name: lens for lens in (Brown, Pinhole, Rational, KannalaBrandt)}


def register_lens(lens: type[AbstractLens]) -> None:
    """Make a lens known by its name and by the settings that it offers.

    Raises:
        ValueError: another lens has the name, or offers one of its settings.
    """
    taken = {choice for other in LENSES.values() if other is not lens for choice in (other.name, *other.choices)}
    clash = taken & {lens.name, *lens.choices}
    if clash:
        raise ValueError(f"A lens called '{sorted(clash)[0]}' is known already; choose another name.")
    LENSES[lens.name] = lens


def lens_of_choice(choice: str) -> tuple[type[AbstractLens], tuple[str, ...]]:
    """The lens that a setting asks for, and the coefficients that are free under it.

    Raises:
        UsageError: no lens offers it.
    """
    for lens in LENSES.values():
        if choice in lens.choices:
            return lens, lens.choices[choice]
    offered = ", ".join(sorted(choice for lens in LENSES.values() for choice in lens.choices))
    raise UsageError(f"There is no lens model '{choice}'; choose auto or one of {offered}.")
