"""What may be wrong with a rig of `doubtful_rigs.py`: pixels, images, lenses, clocks, and cameras of something else."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from doubtful_rigs_cameras import Cameras

KINDS = ("aspect", "crop", "lens", "rate", "late", "frozen", "mirrored", "other room")
ONE_CAMERA = ("rate", "late", "frozen", "mirrored", "other room")  # one camera is left out, or mended in time
ASPECTS = (16 / 15, 4 / 3, 64 / 45)
FRAME_RATE = 30.0
LATEST = 150  # frames


@dataclass(frozen=True)
class Fault:
    """One fault and the cameras that have it."""

    kind: str  # of `KINDS`
    cameras: tuple[int, ...]
    value: float = 0.0  # pixel aspect; share of the width cut; degrees of view; frames a second; frames late
    share: float = 0.0  # of a crop: share of the height cut; both are signed, from the left or top where positive

    @property
    def one(self) -> bool:
        """Whether one camera differs from the others, so that a message can name it."""
        return len(self.cameras) == 1

    def __str__(self) -> str:
        unit = {"lens": " deg", "rate": " frames/s", "late": " frames"}.get(self.kind, "")
        value = f" {self.value:.4g}{unit}" if self.value else ""
        return f"{self.kind}{value} (camera{'' if self.one else 's'} {', '.join(map(str, self.cameras))})"


def draw_faults(rng: np.random.Generator, first: str, cameras: int) -> tuple[Fault, ...]:
    """The fault of this kind ("none" for none), and one of another kind beside it in one rig of five."""
    kinds = [] if first == "none" else [first]
    if kinds and rng.random() < 0.2:
        kinds.append(str(rng.choice([kind for kind in KINDS if kind != first])))
    faults: list[Fault] = []
    for kind in kinds:
        taken = {fault.cameras[0] for fault in faults if fault.one}
        faults.append(_draw(rng, kind, cameras, [c for c in range(cameras) if c not in taken]))
    return tuple(faults)


def _draw(rng: np.random.Generator, kind: str, cameras: int, free: list[int]) -> Fault:
    every, own = tuple(range(cameras)), (int(rng.choice(free)),)
    if kind == "aspect":
        some = rng.permutation(cameras)[: rng.integers(1, cameras)].tolist()
        return Fault(kind, every if rng.random() < 0.5 else tuple(sorted(some)), float(rng.choice(ASPECTS)))
    if kind == "crop":
        signed = rng.uniform(0.0, 0.35, 2) * rng.choice([-1.0, 1.0], 2) * [1.0, rng.random()]
        return Fault(kind, every if rng.random() < 0.5 else own, float(signed[0]), float(signed[1]))
    if kind == "lens":
        return Fault(kind, every if rng.random() < 0.7 else own, float(rng.uniform(60.0, 150.0)))
    if kind == "rate":
        return Fault(kind, own, float(rng.uniform(29.0, 29.97)))
    if kind == "late":
        return Fault(kind, own, float(np.rint(np.exp(rng.uniform(0.0, np.log(LATEST))))))
    return Fault(kind, own)


def faulty_cameras(cameras: Cameras, faults: tuple[Fault, ...]) -> Cameras:
    """The cameras with their wrong lenses, pixels and images: lens first, then pixels, then the cut."""
    ordered = sorted(faults, key=lambda fault: KINDS.index(fault.kind) if fault.kind != "lens" else -1)
    change = {"lens": _equidistant, "aspect": _not_square, "crop": _cropped}
    for fault in ordered:
        if fault.kind in change:
            cameras = change[fault.kind](cameras, fault)
    return cameras


def _equidistant(cameras: Cameras, fault: Fault) -> Cameras:
    """Lenses r = f theta that fill the width of the image with `value` degrees."""
    chosen = np.isin(np.arange(len(cameras)), fault.cameras)
    focal = cameras.size[:, 0] / np.deg2rad(fault.value)
    return replace(
        cameras,
        focal=np.where(chosen, focal, cameras.focal),
        radial=np.where(chosen[:, None], 0.0, cameras.radial),
        equidistant=cameras.equidistant | chosen,
    )


def _not_square(cameras: Cameras, fault: Fault) -> Cameras:
    """Pixels `value` as wide as high: fewer columns for the same view."""
    aspect = np.where(np.isin(np.arange(len(cameras)), fault.cameras), fault.value, 1.0)
    width = np.rint(cameras.size[:, 0] / aspect)
    center, size = cameras.center.copy(), cameras.size.copy()
    center[:, 0], size[:, 0] = (center[:, 0] + 0.5) / aspect - 0.5, width
    return replace(cameras, aspect=cameras.aspect * aspect, center=center, size=size)


def _cropped(cameras: Cameras, fault: Fault) -> Cameras:
    """Images cut on one side across and on one side down."""
    chosen = np.isin(np.arange(len(cameras)), fault.cameras)[:, None]
    cut = np.array([fault.value, fault.share])
    pixels = np.where(chosen, np.rint(np.abs(cut) * cameras.size), 0.0)
    center = cameras.center - np.where(cut > 0, pixels, 0.0)
    return replace(cameras, center=center, size=(cameras.size - pixels).astype(int))


def clocks(faults: tuple[Fault, ...], frames: int, cameras: int) -> Float[np.ndarray, "F C"]:
    """The moment (in frames of 30 a second) that every camera shows in each of its frames."""
    moments = np.tile(np.arange(frames, dtype=float)[:, None], (1, cameras))
    for fault in faults:
        if fault.kind == "late":
            moments[:, fault.cameras[0]] -= fault.value
        elif fault.kind == "rate":
            moments[:, fault.cameras[0]] *= FRAME_RATE / fault.value
    return moments
