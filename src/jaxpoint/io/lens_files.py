"""Known lenses for a recording: which of them is whose, and at which image size; `exchange.read_lenses` reads them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxpoint.camera.rig import CameraRig


def match_names(wanted: Sequence[str], given: Sequence[str]) -> list[int] | None:
    """Where each wanted camera is among the given; cam_3, cam3 and 3 mean the same. None where one is missing."""
    keys: Mapping[str, int] = {camera_key(name): i for i, name in enumerate(given)}
    if len(keys) != len(given):
        keys = {name: i for i, name in enumerate(given)}
        return [keys[name] for name in wanted] if set(wanted) <= keys.keys() else None
    places = [keys.get(camera_key(name)) for name in wanted]
    found = [place for place in places if place is not None]
    return found if len(found) == len(wanted) == len(set(found)) else None


def camera_key(name: str) -> str:
    """What is the same of names that mean one camera."""
    match = re.fullmatch(r"(?:cam(?:era)?|port)?[_-]?0*(\d+)", name, re.IGNORECASE)
    return match[1] if match else name


def scale_lenses(rig: CameraRig, sizes: np.ndarray) -> CameraRig:
    """The lenses for images of other sizes (C, 2) of the same shape; pixel (0, 0) is the centre of the first one."""
    by = np.asarray(sizes, float) / np.asarray(rig.image_sizes, float)
    with jax.enable_x64(True):
        focal, center = np.asarray(rig.cameras.focal) * by, (np.asarray(rig.cameras.center) + 0.5) * by - 0.5
        lens = type(rig.cameras.lens).of(focal, center, rig.cameras.distortion)
        return eqx.tree_at(
            lambda rig: (rig.cameras.lens, rig.image_sizes), rig, (lens, jnp.asarray(sizes, dtype=jnp.int32))
        )
