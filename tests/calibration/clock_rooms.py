"""Rooms whose cameras have clocks of their own, with the truth known."""

import numpy as np
from scipy.interpolate import CubicSpline

from jaxpoint.simulate.rooms import random_room
from jaxpoint.tracks import Tracks

LEAD = 300  # frames of the light before the first of the tracks, for cameras that show it late


def room_with_clocks(seed, offsets, rates=None, frames=900, stride=24):
    """Tracks of cameras of which frame f shows the light at (f - offset) / rate; 2 % outliers, 5 % not seen."""
    offsets = np.asarray(offsets, float)
    rates = np.ones(len(offsets)) if rates is None else np.asarray(rates, float)
    room = random_room(
        seed, cameras=len(offsets), frames=2 * frames, layout="around", visibility=1.0, outliers=0.0, noise_px=0.3,
        stride=stride,
    )  # fmt: skip
    path = CubicSpline(np.arange(len(room.points)), room.points)
    rng, pixels = np.random.default_rng(seed), np.full((frames, len(offsets), 2), np.nan)
    for camera, (late, rate) in enumerate(zip(offsets, rates)):
        moments = (np.arange(frames) - late) / rate + LEAD
        exact, inside = room.seen(path(np.clip(moments, 0, len(room.points) - 1)))
        seen = inside[:, camera] & (moments >= 0) & (moments < len(room.points)) & (rng.random(frames) < 0.95)
        shown = exact[:, camera] + rng.normal(0.0, 0.4, (frames, 2))
        wrong = rng.random(frames) < 0.02
        shown[wrong] = rng.uniform([0, 0], [1279, 719], (wrong.sum(), 2))
        pixels[seen, camera] = shown[seen]
    return Tracks.from_pixels(pixels, room.tracks.image_sizes, names=room.tracks.names)


def with_camera(tracks, camera, pixels, visible=None):
    """The tracks with other sightings of one camera."""
    changed, seen = tracks.pixels.copy(), tracks.visible.copy()
    changed[:, camera] = pixels
    if visible is not None:
        seen[:, camera] = visible
    return Tracks.from_pixels(np.where(seen[..., None], changed, np.nan), tracks.image_sizes, names=tracks.names)
