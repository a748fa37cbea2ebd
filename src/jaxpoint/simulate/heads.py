"""Two people who meet in a room, as heads that cameras would find: places known, no image drawn.

What a detector does to them is here: it misses heads, finds some where there is none, and takes two people whose
silhouettes overlap in a view for one, with one head: mostly the nearer person's, now and then a place between the two.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from jaxtyping import Bool, Float

from jaxpoint.simulate.rooms import ROOM_M, RandomRoom, random_room

Meeting = Literal["pass", "cross", "overtake", "turn back"]
FRAME_RATE = 12.5  # frames per second
BODY_M = 0.5  # width of a person's silhouette
CANDIDATES = 4  # heads that a view can offer
_REACH_M = 2.0  # people walk this far from where they meet, and stop


@dataclass(frozen=True)
class Heads:
    """Heads of P people seen by C cameras, K candidates at most in each view."""

    room: RandomRoom
    times: Float[np.ndarray, " F"]  # s
    places: Float[np.ndarray, "F P 3"]  # m, the truth
    pixels: Float[np.ndarray, "F C K 2"]  # px, in no order
    valid: Bool[np.ndarray, "F C K"]
    merged: Bool[np.ndarray, "F C"]  # where two people are one silhouette


def random_meeting(
    seed: int,
    *,
    cameras: int = 6,
    kind: Meeting | None = None,
    noise_px: float = 4.0,
    misses: float = 0.2,
    clutter: float = 0.3,
    seconds: float = 7.0,
) -> Heads:
    """Two people whose heads come within 0.3 to 0.6 m of one another in the floor plan.

    Args:
        seed: the same seed and arguments give the same meeting.
        cameras: C, on all four walls.
        kind: they pass one another, their ways cross at right angles, one overtakes the other, or they meet, stand
            for a moment, and go back; drawn if not given.
        noise_px: standard deviation of a pixel coordinate.
        misses: fraction of heads not found, in each view.
        clutter: heads found in each view where there is none, per frame.
        seconds: length of the recording.
    """
    rng = np.random.default_rng([seed, 71])
    room = random_room(seed, cameras=cameras, layout="around", visibility=1.0, outliers=0.0, frames=200)
    times = np.arange(round(seconds * FRAME_RATE)) / FRAME_RATE
    places = _meet(rng, times, kind or rng.choice(get_args(Meeting)))
    return _seen(rng, room, times, places, noise_px, misses, clutter)


def _meet(rng, times, kind: Meeting) -> np.ndarray:
    """(F, 2, 3) places of two heads; the nearest approach is near the middle of the time."""
    gap = rng.uniform(0.3, 0.6)
    speeds = rng.uniform(0.7, 1.4, 2)
    turn = rng.uniform(0.0, 2 * np.pi)
    middle = ROOM_M[:2] * 0.5 + rng.uniform(-0.6, 0.6, 2)
    way = np.stack([_walked(times - times.mean(), speed, kind == "turn back") for speed in speeds], axis=1)
    if kind == "turn back":
        way[:, 0], way[:, 1] = way[:, 0] - gap / 2, gap / 2 - way[:, 1]
    elif kind == "overtake":
        way[:, 1] *= 0.35 / speeds[1] * speeds[0]
    aside = np.zeros_like(way)
    if kind == "cross":
        aside[:, 1], way[:, 1] = way[:, 1], 0.0
        way[:, 0] += gap * np.sqrt(1 + (speeds[0] / speeds[1]) ** 2)
    elif kind != "turn back":
        aside[:, 1] = gap
        way[:, 1] *= 1 if kind == "overtake" else -1
    flat = np.stack([np.cos(turn) * way - np.sin(turn) * aside, np.sin(turn) * way + np.cos(turn) * aside], axis=-1)
    height = rng.uniform(1.42, 1.78, 2) + 0.02 * np.sin(
        2 * np.pi * (rng.uniform(1.7, 2.1, 2) * times[:, None] + rng.random(2))
    )
    sway = 0.02 * np.sin(2 * np.pi * (0.9 * times[:, None, None] + rng.random((2, 2))))
    return np.concatenate([middle + flat + sway, height[..., None]], axis=-1)


def _walked(moments, speed, back: bool) -> np.ndarray:
    """Distance walked (m), 0 at moment 0; with `back` negative on both sides of a rest of 0.6 s."""
    if not back:
        return _REACH_M * np.tanh(speed * moments / _REACH_M)
    away = np.maximum(np.abs(moments) - 0.3, 0.0)
    return -_REACH_M * np.tanh(speed / _REACH_M * (np.sqrt(away**2 + 0.3**2) - 0.3))


def _seen(rng, room: RandomRoom, times, places, noise_px, misses, clutter) -> Heads:
    frames, people, _ = places.shape
    exact, in_view = room.seen(places.reshape(-1, 3))
    cameras = exact.shape[1]
    exact = exact.reshape(frames, people, cameras, 2).transpose(0, 2, 1, 3)
    in_view = in_view.reshape(frames, people, cameras).transpose(0, 2, 1)
    depth = np.einsum("cj,fpj->fcp", room.rotation[:, 2], places) + room.translation[:, 2][:, None]
    width = BODY_M * room.focal[:, None] / np.maximum(depth, 0.3)
    merged = in_view.all(axis=2) & (np.abs(exact[..., 0, 0] - exact[..., 1, 0]) < width.mean(axis=2))
    found = in_view & (rng.random(in_view.shape) >= misses)
    shown = exact.copy()
    nearer = np.argmin(depth, axis=2)
    shown_of = np.zeros(cameras, int)  # whose head a view takes for that of both
    for frame, camera in np.argwhere(merged):
        if frame == 0 or not merged[frame - 1, camera]:
            shown_of[camera] = nearer[frame, camera] ^ (rng.random() < 0.25)
        elif rng.random() < 0.1:
            shown_of[camera] ^= 1
        whose = shown_of[camera]
        found[frame, camera, 1 - whose] = False
        if rng.random() < 0.15:
            shown[frame, camera, whose] = exact[frame, camera].mean(axis=0)
    pixels = np.zeros((frames, cameras, CANDIDATES, 2))
    valid = np.zeros((frames, cameras, CANDIDATES), bool)
    for frame, camera in np.ndindex(frames, cameras):
        own = shown[frame, camera][found[frame, camera]]
        own = own + rng.normal(0.0, noise_px, own.shape)
        false = rng.uniform([0.0, 0.0], [1279.0, 719.0], (rng.poisson(clutter), 2))
        every = rng.permutation(np.concatenate([own, false])[:CANDIDATES])
        pixels[frame, camera, : len(every)] = every
        valid[frame, camera, : len(every)] = True
    return Heads(room, times, places, pixels, valid, merged)
