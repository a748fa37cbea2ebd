"""All lenses by name, and what settings may ask for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.camera.brown import Brown
from jaxpoint.camera.kannala_brandt import KannalaBrandt
from jaxpoint.camera.lens import AbstractLens
from jaxpoint.camera.mixed import embedded, mixed_lens, own_coefficients
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


class LensChoice(NamedTuple):
    """The lenses of C cameras as a setting asks for them, in one class."""

    model: type[AbstractLens]
    free: Bool[np.ndarray, "C k"]  # which coefficients an adjustment may move
    mean: Float[np.ndarray, "C k"]  # where they are drawn to

    def select(self, cameras: Sequence[int]) -> LensChoice:
        """Of some of the cameras."""
        return LensChoice(self.model, self.free[list(cameras)], self.mean[list(cameras)])


def chosen_lenses(setting: str, names: Sequence[str]) -> LensChoice:
    """What a setting asks for: one choice for all cameras (`brown`), or one a camera (`cam_0=fisheye,cam_1=brown`).

    A choice without a name among them is that of all cameras that are not named: `brown,cam_2=fisheye`.

    Raises:
        UsageError: no lens offers a choice, or the setting names a camera twice, an unknown one, or not all.
    """
    found = [lens_of_choice(choice) for choice in choices_of(setting, names)]
    return _in_one_class([(model, _named(model, free)) for model, free in found])


def lenses_of_models(models: Sequence[type[AbstractLens]]) -> LensChoice:
    """The lenses of these models, one a camera, with all their coefficients free."""
    return _in_one_class([(model, np.ones(len(model.coefficients), bool)) for model in models])


def check_setting(setting: str) -> None:
    """Refuse a setting of which no lens offers a choice, before the cameras are known.

    Raises:
        UsageError: that is so.
    """
    for part in setting.split(","):
        lens_of_choice(part.rpartition("=")[2].strip())


def setting_without(setting: str, camera: str) -> str:
    """The setting for the other cameras."""
    rest = [part for part in setting.split(",") if part.rpartition("=")[0].strip() != camera]
    return ",".join(rest)


def choices_of(setting: str, names: Sequence[str]) -> list[str]:
    """The choice of each camera; see `chosen_lenses`."""
    named: dict[str, str] = {}
    others: list[str] = []
    for part in (part.strip() for part in setting.split(",")):
        name, _, choice = (text.strip() for text in part.rpartition("="))
        if not name:
            others.append(choice)
        elif name in named:
            raise UsageError(f"--lens.distortion names camera '{name}' twice ({setting}); name it once.")
        else:
            named[name] = choice
    unknown = [name for name in named if name not in names]
    if unknown:
        raise UsageError(f"--lens.distortion names camera '{unknown[0]}', but the cameras are {', '.join(names)}.")
    if len(others) > 1:
        raise UsageError(
            f"--lens.distortion {setting} has {len(others)} choices without a camera; leave one, or write "
            "camera=choice."
        )
    missing = [name for name in names if name not in named]
    if missing and not others:
        raise UsageError(
            f"--lens.distortion {setting} leaves out camera '{missing[0]}'; name it too, or begin with a choice "
            f"for all others (brown,{setting})."
        )
    return [named.get(name, others[0] if others else "") for name in names]


def _named(model: type[AbstractLens], names: Sequence[str]) -> Bool[np.ndarray, " k"]:
    return np.array([coefficient.name in names for coefficient in model.coefficients], dtype=bool)


def _in_one_class(cameras: Sequence[tuple[type[AbstractLens], np.ndarray]]) -> LensChoice:
    """Lenses and their free coefficients, camera by camera, as those of one class."""
    whole = mixed_lens(model for model, _ in cameras)
    size = len(cameras), len(whole.coefficients)
    free, mean = np.zeros(size, bool), np.zeros(size)
    for camera, (model, own) in enumerate(cameras):
        free[camera, own_coefficients(whole, model)] = own
        mean[camera] = embedded(whole, model, [coefficient.prior_mean for coefficient in model.coefficients])
    return LensChoice(whole, free, mean)
