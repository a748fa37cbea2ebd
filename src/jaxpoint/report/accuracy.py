"""How wrong the cameras and a place in the room may be, and where more light would help: the numbers of the section."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from jaxpoint.calibration.expected import ADDED, Gain, boxes_of, eighths, expected_error, gains
from jaxpoint.calibration.gauge import centres_by_parameters
from jaxpoint.calibration.result import Calibration
from jaxpoint.calibration.uncertainty import variance_px2
from jaxpoint.camera.mixed import own_coefficients
from jaxpoint.report.advice import Advice
from jaxpoint.report.summary import RigScene, Summary
from jaxpoint.report.tables import Table

HEAD_M = 1.7  # height of a standing person's head
ACROSS = 48  # cells of a map along its longer side
SAMPLES = 7  # places along each side of the volume over which means are taken
WORTH = 0.02  # a smaller predicted gain is not worth the walk
BEST = 3  # places named


@dataclass(frozen=True)
class ErrorMap:
    """The expected error on a level plane, on a grid of Y by X cells."""

    title: str
    x: Float[np.ndarray, " X"]  # middles of the cells, scene's unit
    y: Float[np.ndarray, " Y"]
    views: Int[np.ndarray, "Y X"]  # cameras that have the place in view
    error: Float[np.ndarray, "Y X"]  # infinite where it is not known; mm, or thousandths of the unit


@dataclass(frozen=True)
class Accuracy:
    """What the covariance of a calibration means in the room."""

    scene: RigScene  # in the room, or turned upright
    planes: tuple[ErrorMap, ...]
    mean: float  # expected error over the volume of the light; mm, or thousandths of the unit
    share: float  # of the calibration in its square
    sigma_px: float
    gauge: str
    boxes: Float[np.ndarray, "N 2 3"]  # of the volume of the light, scene's unit
    gains: tuple[Gain, ...]  # of more light in them, best first

    @property
    def unit(self) -> str:
        """Of errors."""
        return "mm" if self.scene.unit == "m" else "thousandths of the solver's unit"


def accuracy_of(calibration: Calibration, summary: Summary) -> Accuracy | None:
    """The expected error on two planes and over the volume of the light, and what more light would change.

    None without a covariance or noise, or where two cameras nowhere see the same place.
    """
    covariance, aligned = calibration.camera_covariance, summary.scene.in_room
    if covariance is None or len(summary.scene.points) < 2 or not calibration.sigma_px > 0:
        return None
    turn, shift = (np.eye(3), np.zeros(3)) if aligned else summary.scene.levelling()
    scene = summary.scene if aligned else summary.scene.upright()

    def in_rig(places: np.ndarray) -> np.ndarray:
        return (places - shift) @ turn

    about = calibration.rig, covariance, calibration.sigma_px
    low, high = np.quantile(scene.points, [0.01, 0.99], axis=0)
    places = in_rig(_spread(low, high))
    over = expected_error(*about, places)
    if not over.known.any():
        return None
    planes = []
    for title, height in _heights(scene):
        x, y, grid = _grid(scene, height)
        found, shape = expected_error(*about, in_rig(grid)), (len(y), len(x))
        planes.append(ErrorMap(title, x, y, found.seen.sum(axis=1).reshape(shape), 1e3 * found.total.reshape(shape)))
    boxes = boxes_of(low, high)
    light = eighths(boxes)[:, _of_eight(len(calibration.rig))]
    better = gains(*about, variance_px2(calibration), places, in_rig(light))
    by_cameras, by_pixels = (part[over.known].mean() for part in (over.calibration, over.observation))
    return Accuracy(
        scene,
        tuple(planes),
        1e3 * float(over.total[over.known].mean()),
        float(by_cameras / (by_cameras + by_pixels)),
        calibration.sigma_px,
        calibration.gauge or "free",
        boxes,
        tuple(better),
    )


def _of_eight(cameras: int) -> list[int]:
    """Which of a box's eight positions stand for the light in it: fewer for large rigs, whose work grows with them."""
    return list(range(8)) if cameras <= 8 else [0, 3, 5, 6] if cameras <= 16 else [0, 7]


def _spread(low: np.ndarray, high: np.ndarray) -> Float[np.ndarray, "P 3"]:
    """Places evenly through a volume."""
    steps = (np.arange(SAMPLES) + 0.5) / SAMPLES
    return low + np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3) * (high - low)


def _heights(scene: RigScene) -> list[tuple[str, float]]:
    """The two planes: floor and head height, or low and high in the light's path where there is no floor."""
    if scene.in_room:
        return [("On the floor", 0.0), (f"At head height, {HEAD_M:g} m", HEAD_M)]
    low, high = np.quantile(scene.points[:, 2], [0.1, 0.9])
    return [("Low in the light's path", float(low)), ("High in the light's path", float(high))]


def _grid(scene: RigScene, height: float) -> tuple[np.ndarray, np.ndarray, Float[np.ndarray, "P 3"]]:
    """Middles of the cells of a plane that holds all cameras and the light, and their places, row by row."""
    low, high = (end[:2] for end in scene.reach(0.01))
    margin = 0.04 * (high - low).max()
    low, span = low - margin, high - low + 2 * margin
    step = span.max() / ACROSS
    x, y = (low[i] + step * (np.arange(int(np.ceil(span[i] / step))) + 0.5) for i in (0, 1))
    return x, y, np.stack([*(axis.ravel() for axis in np.meshgrid(x, y)), np.full(len(x) * len(y), height)], axis=1)


def camera_table(calibration: Calibration, summary: Summary) -> Table | None:
    """One row a camera: its parameters with one standard deviation each."""
    covariance = calibration.camera_covariance
    if covariance is None:
        return None
    count, aligned = len(summary.names), summary.scene.in_room
    blocks = np.einsum("cpcq->cpq", covariance.reshape(count, -1, count, calibration.rig.camera_size))
    sigma = np.sqrt(np.maximum(np.einsum("cpp->cp", blocks), 0.0))
    turn = np.eye(3) if aligned else summary.scene.levelling()[0]
    by_parameters = turn @ centres_by_parameters(calibration.rig)
    places = np.sqrt(np.maximum(np.einsum("cip,cpq,ciq->ci", by_parameters, blocks, by_parameters), 0.0))
    turned = np.rad2deg(np.sqrt((sigma[:, :3] ** 2).sum(axis=1)))
    unit = "mm" if aligned else "thousandths"
    rows, kind = [], type(calibration.rig.cameras.lens)
    for c, (name, model) in enumerate(zip(summary.names, calibration.rig.lens_models)):
        square = np.ptp(summary.focal[c]) < 1e-9 * summary.focal[c, 0]
        rows.append([
            name,
            with_sigmas(summary.focal[c, : 1 if square else 2], sigma[c, 6:8]),
            with_sigmas(summary.center[c], sigma[c, 8:10]),
            with_sigmas(summary.distortion[c], sigma[c, 10:][own_coefficients(kind, model)]) or "none",
            "± " + ", ".join(f"{1e3 * off:.1f}" for off in places[c]),
            f"± {turned[c]:.3f}°",
        ])  # fmt: skip
    header = ["Focal length", "Principal point", "Distortion", f"Position\nx, y, z, {unit}", "Orientation"]
    return Table(["Camera", *header], rows)


def with_sigmas(values: Float[np.ndarray, " N"], sigmas: Float[np.ndarray, " M"]) -> str:
    """Numbers with one standard deviation each (M >= N), to its second digit; held zeros are left out."""
    return ", ".join(
        f"{value:.{_digits(sigma)}f} ± {sigma:.{_digits(sigma)}f}" if sigma > 0 else f"{value:.4g} (held)"
        for value, sigma in zip(values, sigmas, strict=False)
        if sigma > 0 or value != 0
    )


def _digits(sigma: float) -> int:
    return int(np.clip(1 - np.floor(np.log10(sigma)), 0, 9))


def sentence(accuracy: Accuracy) -> str:
    """How large the error is, and which of its two sources dominates."""
    share = accuracy.share
    most = "Both" if abs(share - 0.5) < 0.1 else "The calibration" if share > 0.5 else "The noise of the pixels"
    verb = "weigh about alike" if most == "Both" else "dominates"
    return (
        f"Where the light was waved, a place that is seen once by all cameras that have it in view is expected to come "
        f"out {_length(accuracy.mean, accuracy)} from the truth. {most} {verb}: of the squared error {share:.0%} comes "
        f"from the calibration, which more light would lower, and {1 - share:.0%} from the {accuracy.sigma_px:.2f} px "
        "of noise of the place's own pixels, which only more looks at it would."
    )


def frame_note(accuracy: Accuracy) -> str:
    """What holds the frame in which these errors are counted."""
    if accuracy.gauge == "landmarks":
        return "Errors are counted in the room's frame: how well the known points are known has its share."
    note = "Errors are those of the rig's shape (free gauge)"
    return (
        f"{note}, in a frame that fits the light and the cameras best; how that frame stands in a room is not counted."
    )


def on_accuracy(accuracy: Accuracy | None, names: Sequence[str]) -> Iterator[Advice]:
    """Where more light is predicted to help most, or that it hardly would."""
    if accuracy is None or not accuracy.gains:
        return
    best = accuracy.gains[0]
    finding = f"The expected error over the volume of the light is {_length(accuracy.mean, accuracy)}."
    if best.fraction < WORTH:
        yield Advice(
            finding,
            f"More waving hardly helps: {ADDED} more positions of the light in the best place "
            f"({_where(accuracy, best)}) would lower it by {best.fraction:.1%}.",
        )
        return
    told = "; ".join(
        f"{_where(accuracy, gain)}{_seen_by(gain.cameras, names)}: −{gain.fraction:.0%}"
        for gain in accuracy.gains[:BEST]
    )
    yield Advice(finding, f"More light lowers it most, {ADDED} positions each and predicted alone, at {told}.")


def _where(accuracy: Accuracy, gain: Gain) -> str:
    low, high = accuracy.boxes[gain.part]
    unit = " m" if accuracy.scene.unit == "m" else ""
    ends = np.round([low, high], 1) + 0.0  # no -0.0
    return ", ".join(f"{axis} {a:.1f} to {b:.1f}" for axis, a, b in zip("xyz", *ends)) + unit


def _seen_by(cameras: Sequence[int], names: Sequence[str]) -> str:
    """The cameras that see most of a part; nothing where none does, as along a corridor whose cameras follow."""
    return f", seen by {_listed(cameras, names)}" if cameras else ""


def _listed(cameras: Sequence[int], names: Sequence[str]) -> str:
    if len(cameras) == len(names) > 2:
        return "all cameras"
    return " and ".join([", ".join(names[c] for c in cameras[:-1]), names[cameras[-1]]]).removeprefix(" and ")


def _length(value: float, accuracy: Accuracy) -> str:
    return f"{value:.2g} {accuracy.unit}" if value < 10 else f"{value:.0f} {accuracy.unit}"
