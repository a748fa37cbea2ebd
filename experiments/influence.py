"""Which single observation, and which landmark, turns a pointing line most?

A simulated room is calibrated from its light, aligned with clicked landmarks, and an arm in it is triangulated. The
whole chain is one function (`jaxpoint.calibration.chain`), so one derivative tells how far the pointing line would turn
if any one number were different: degrees a pixel for every pixel of the light, every click and both ends of the arm, in
the direction that turns it most, and degrees a millimetre for every landmark. The first of each kind are checked: moved
by a tenth of a pixel or millimetre and by a whole one, and everything solved again. (The robust loss bends within a
pixel, so a whole one of the light often turns less.) The light's are also left out. With a recording the question is
the angle between three far points of its own light instead.

    python experiments/influence.py --out influence.md
    python experiments/influence.py DATA/svoboda_strawlab2010 --every 4 --out influence_strawlab.md
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from jaxtyping import Array, Float
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from jaxpoint.calibration.chain import Chain, Measured, chain_of
from jaxpoint.calibration.result import Calibration
from jaxpoint.calibration.selfcal import calibrate
from jaxpoint.camera.rig import CameraRig
from jaxpoint.compilation import jit_once
from jaxpoint.errors import InsufficientDataError
from jaxpoint.geometry.line import angle_between, normalise
from jaxpoint.io.track_files import read_tracks
from jaxpoint.report.style import BAD, INK, short_names, style
from jaxpoint.simulate.known import CLICK_PX, TAPE_M, KnownRoom, known_in
from jaxpoint.simulate.rooms import ROOM_M, random_room
from jaxpoint.triangulation import triangulate

BLUES = ListedColormap(colormaps["YlGnBu"](np.linspace(0.2, 1.0, 256)))  # the palest are lost on white
ARM_M = 0.6  # from shoulder to hand
ARM_PX = 1.0  # standard deviation with which an arm's end is found in an image
LANDMARKS = 6
MM = 1e-3
KINDS = ("light", "clicks", "landmarks", "pixels")
TITLES = {"light": "the light", "clicks": "clicks on landmarks", "landmarks": "landmarks", "pixels": "the arm"}


@dataclass(frozen=True)
class Influences:
    """Rank single observations by how far they turn a pointing line."""

    recording: Annotated[Path | None, tyro.conf.Positional] = None
    """Tracks of a real recording; a simulated room if left out."""
    seed: int = 4
    """Of the simulated room."""
    cameras: int = 5
    """Of the simulated room."""
    every: int = 1
    """Use every n-th frame of the recording."""
    top: int = 4
    """How many of each kind are shown and checked."""
    out: Path = Path("influence.md")
    """The table, as Markdown; the picture lies beside it as .png."""


@dataclass(frozen=True)
class Question:
    """A calibration and what is asked of it. `answer` (rad) is such that a turn is the length of its change."""

    what: str
    answer: Callable[[Chain, Measured], tuple[Float[Array, " M"], CameraRig]]
    chain: Chain
    measured: Measured
    frame_ids: np.ndarray
    landmark_names: tuple[str, ...]
    sigmas: dict[str, float]  # of one coordinate of each kind, px or m
    unit: str  # of lengths in the picture
    legs: tuple[int, ...] = ()  # frames whose points make the angle that is asked for


@dataclass(frozen=True)
class Row:
    """One observation: how far it turns the line a unit (px, or mm for landmarks), and what solving again showed."""

    kind: str
    index: tuple[int, ...]
    name: str
    degrees: float  # in the worst direction
    direction: np.ndarray
    nearby: float = np.nan  # degrees, solved again with it moved by a tenth of a unit in that direction, times ten
    turned: float = np.nan  # moved by one unit
    left_out: float | None = None  # without it


def pointing_question(known: KnownRoom, calibration: Calibration, seed: int) -> Question:
    """Where an arm points in a simulated room that was calibrated."""
    arm, visible = seen_arm(known, np.random.default_rng([seed, 1]))
    landmarks = known.landmarks
    count = len(landmarks.names)
    chain, measured = chain_of(
        calibration,
        arm,
        visible,
        landmarks=landmarks.points,
        clicks=known.clicks.pixels[:count],
        clicked=known.clicks.visible[:count],
        sigmas=landmarks.sigmas,
    )
    sigmas = {"light": calibration.sigma_px, "clicks": CLICK_PX, "landmarks": TAPE_M, "pixels": ARM_PX}
    return Question(
        "the pointing line", direction, chain, measured, calibration.tracks.frame_ids, landmarks.names, sigmas, "m"
    )


def seen_arm(known: KnownRoom, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (2, C, 2) of an arm's two ends with noise, and which cameras see them: three or more, where there are."""
    needed = min(3, known.room.tracks.cameras)
    for _ in range(1000):
        base = rng.uniform(ROOM_M * [0.35, 0.35, 0.4], ROOM_M * [0.65, 0.65, 0.5])
        ahead = rng.normal(size=3) * [1.0, 1.0, 0.3]
        pixels, visible = known.room.seen(np.stack([base, base + ARM_M * ahead / np.linalg.norm(ahead)]))
        if (visible.sum(axis=1) >= needed).all():
            return pixels + rng.normal(0.0, ARM_PX, pixels.shape), visible
    raise InsufficientDataError(f"No arm in this room is seen by {needed} cameras; take another seed.")


class Solved(NamedTuple):
    """Everything solved once."""

    value: Float[Array, " M"]  # the answer, rad
    slopes: Measured  # its derivative by every number measured, M first
    rig: CameraRig


def direction(chain: Chain, measured: Measured) -> tuple[Float[Array, "3"], CameraRig]:
    """The pointing line's unit vector: for small turns the length of its change is the turn in rad."""
    rig, (base, tip) = chain.rig_and_points(measured)
    return normalise(tip - base), rig


def angle_question(calibration: Calibration) -> Question:
    """The angle between three points of the light that are far apart, all cameras' own; no room is needed."""
    rows = far_frames(calibration)
    kept = calibration.kept[rows]
    chain, measured = chain_of(calibration, calibration.tracks.pixels[rows], kept)

    def angle(chain: Chain, measured: Measured) -> tuple[Float[Array, "1"], CameraRig]:
        rig, (first, corner, last) = chain.rig_and_points(replace(measured, pixels=measured.light[rows]))
        return angle_between(first - corner, last - corner)[None], rig

    ids = calibration.tracks.frame_ids
    what = f"the angle at the light of frame {ids[rows[1]]} between those of {ids[rows[0]]} and {ids[rows[2]]}"
    return Question(
        what, angle, chain, measured, ids, (), {"light": calibration.sigma_px}, calibration.unit, tuple(rows)
    )


def far_frames(calibration: Calibration) -> np.ndarray:
    """Three frames, of those that most cameras saw, whose points make a large triangle."""
    views = np.where(calibration.point_valid, calibration.kept.sum(axis=1), 0)
    enough = np.sort(views)[-max(3, len(views) // 10)]
    rows = np.flatnonzero(views >= max(enough, 2))
    if len(rows) < 3:
        raise InsufficientDataError(f"{len(rows)} points of the light are known; three are needed for an angle.")
    points = calibration.points[rows]
    apart = np.linalg.norm(points[:, None] - points[None], axis=-1)
    first, last = np.unravel_index(apart.argmax(), apart.shape)
    corner = (apart[first] * apart[last] * (apart[first] > 0) * (apart[last] > 0)).argmax()
    return rows[[first, corner, last]]


def solver_of(question: Question) -> Callable[[Measured], Solved]:
    """The function that solves everything."""

    @jit_once
    def solve(chain: Chain, measured: Measured) -> Solved:
        value, pull, rig = jax.vjp(lambda measured: question.answer(chain, measured), measured, has_aux=True)
        return Solved(value, jax.vmap(lambda row: pull(row)[0])(jnp.eye(len(value))), rig)

    return lambda measured: solve(question.chain, measured)


def ranked(question: Question, slopes: Measured) -> dict[str, list[Row]]:
    """The observations of every kind, the most influential first."""
    rows = {}
    for kind in KINDS:
        slope = np.degrees(np.moveaxis(np.asarray(getattr(slopes, kind)), 0, -2))  # (..., M, k)
        if not slope.size or not slope.any():
            continue
        _, sizes, ways = np.linalg.svd(slope, full_matrices=False)
        size = sizes[..., 0] * (MM if kind == "landmarks" else 1.0)
        order = np.argsort(-size, axis=None)[: np.count_nonzero(size)]
        places = [tuple(int(i) for i in np.unravel_index(flat, size.shape)) for flat in order]
        rows[kind] = [Row(kind, i, name_of(question, kind, i), float(size[i]), ways[(*i, 0)]) for i in places]
    return rows


def name_of(question: Question, kind: str, index: tuple[int, ...]) -> str:
    """An observation in words."""
    if kind == "landmarks":
        return f"place of {question.landmark_names[index[0]]}"
    camera = question.chain.names[index[1]]
    if kind == "light":
        return f"light of frame {question.frame_ids[index[0]]} in {camera}"
    if kind == "clicks":
        return f"click on {question.landmark_names[index[0]]} in {camera}"
    return f"{('shoulder', 'hand')[index[0]]} in {camera}"


def checked(question: Question, solve: Callable[[Measured], Solved], before: np.ndarray, row: Row) -> Row:
    """Solve again with the observation moved, and, if it is of the light, without it."""
    measured = question.measured
    value = getattr(measured, row.kind)
    step = row.direction * (MM if row.kind == "landmarks" else 1.0)

    def turned(**changes: Array) -> float:
        return float(np.degrees(np.linalg.norm(np.asarray(solve(replace(measured, **changes)).value) - before)))

    nearby, far = (turned(**{row.kind: value.at[row.index].add(by * step)}) for by in (0.1, 1.0))
    without = turned(weights=measured.weights.at[row.index].set(0.0)) if row.kind == "light" else None
    return replace(row, nearby=10 * nearby, turned=far, left_out=without)


def budget(question: Question, slopes: Measured) -> dict[str, float]:
    """How far the noise of all observations of a kind turns the line together, degrees (root mean square)."""
    parts = {kind: np.asarray(getattr(slopes, kind)) for kind in question.sigmas}
    return {kind: float(np.degrees(question.sigmas[kind] * np.linalg.norm(part))) for kind, part in parts.items()}


def markdown(question: Question, rows: dict[str, list[Row]], spread: dict[str, float], top: int) -> str:
    """What matters most, in words; the noise of each kind; and the first of each kind beside what really happened."""
    head = ["", "observation", "degrees", "moved by a tenth, times ten", "moved by one", "left out"]
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for kind, some in rows.items():
        unit = "mm" if kind == "landmarks" else "px"
        for row in some[:top]:
            numbers = [f"{row.nearby:.5f}", f"{row.turned:.5f}", "" if row.left_out is None else f"{row.left_out:.5f}"]
            cells = [TITLES[kind], row.name, f"{row.degrees:.5f} a {unit}", *numbers]
            lines.append(f"| {' | '.join(cells)} |")
    table = "\n".join(lines)
    return f"{in_words(question, rows)}\n\n{noise_in_words(question, spread)}\n\n{table}\n"


def in_words(question: Question, rows: dict[str, list[Row]]) -> str:
    """Which single observation of each kind matters most."""
    said = []
    for kind, some in rows.items():
        unit = "millimetre" if kind == "landmarks" else "pixel"
        said.append(f"the {some[0].name} ({some[0].degrees:.2g} degrees a {unit}, first of {len(some)})")
    return f"What turns {question.what} most: " + "; ".join(said) + "."


def noise_in_words(question: Question, spread: dict[str, float]) -> str:
    """What the noise of every kind adds up to."""
    order = sorted(spread, key=lambda kind: -spread[kind])
    said = [f"{TITLES[kind]} {spread[kind]:.2g}" for kind in order]
    return f"What the noise of all of them together turns it by, in degrees: {', '.join(said)}."


def main(options: Influences) -> None:
    """Calibrate, rank, check the first of each kind, write and print the table, and draw the picture.

    Raises:
        JaxpointError: the recording cannot be read or solved.
    """
    with jax.enable_x64(True):
        question = asked(options)
        solve = solver_of(question)
        solved = solve(question.measured)
        rows = ranked(question, solved.slopes)
        for some in rows.values():
            some[: options.top] = [
                checked(question, solve, np.asarray(solved.value), row) for row in some[: options.top]
            ]
        text = markdown(question, rows, budget(question, solved.slopes), options.top)
        options.out.write_text(text)
        picture(question, solved.rig, rows, options.top).savefig(
            options.out.with_suffix(".png"), dpi=120, facecolor="white", bbox_inches="tight"
        )
    sys.stdout.write(text)


def asked(options: Influences) -> Question:
    """Calibrate the recording, or a simulated room."""
    if options.recording is not None:
        tracks = read_tracks(options.recording)
        return angle_question(calibrate(tracks.select_frames(np.arange(0, tracks.frames, options.every))))
    room = random_room(options.seed, cameras=options.cameras, layout="around", outliers=0.03, noise_px=0.5)
    return pointing_question(known_in(room, options.seed, LANDMARKS, 0), calibrate(room.tracks), options.seed)


def picture(question: Question, rig: CameraRig, rows: dict[str, list[Row]], top: int) -> Figure:
    """The room from above: the light by its influence, lines of sight of the first, landmarks and the arm."""
    chain, measured = question.chain, question.measured
    seen = np.asarray(measured.weights) > 0
    pixels, visible = (np.concatenate(pair) for pair in ((measured.light, measured.pixels), (seen, chain.visible)))
    points = np.asarray(triangulate(rig, pixels, visible, covariance=False).points)
    light, arm = points[: len(seen)], points[len(seen) :]
    cameras = np.asarray(rig.positions)
    flat = from_above(question, np.concatenate([cameras, light[seen.sum(axis=1) >= 2]]))
    with style():
        figure = Figure(figsize=(9.0, 6.6), layout="constrained")
        ax = figure.add_subplot()
        draw_light(figure, ax, flat(light), rows["light"])
        for rank, row in enumerate(rows["light"][:top]):
            ends = flat(np.stack([cameras[row.index[1]], light[row.index[0]]]))
            label = None if rank else f"first {top} pixels of the light"
            ax.plot(*ends.T, color=INK, lw=1.0, zorder=3, label=label)
        for name, place in zip(short_names(chain.names), flat(cameras)):
            ax.plot(*place, "^", ms=11, color=INK, mec="white", zorder=4)
            up = place[1] > np.median(flat(light)[:, 1])
            ax.annotate(
                name, place, (0, 9 if up else -18), textcoords="offset points", color=INK, weight="bold", ha="center"
            )
        draw_landmarks(ax, question, rows, flat)
        draw_line(ax, question, flat(light[list(question.legs)] if question.legs else arm))
        unit = "m" if question.unit == "m" else "solver's unit"
        ax.set(aspect="equal", xlabel=f"x, {unit}", ylabel=f"y, {unit}")
        ax.margins(0.08)
        seen_from = "from above" if len(measured.landmarks) else "on the rig's two longest axes"
        ax.set_title(f"What turns {question.what} ({seen_from})")
        figure.legend(loc="outside lower center", ncols=4)
    return figure


def from_above(question: Question, points: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """To the plane of the picture: the room's ground plan, or the two longest axes of a rig that knows no room."""
    if len(question.measured.landmarks):
        return lambda places: places[..., :2]
    middle = np.median(points, axis=0)
    axes = np.linalg.svd(points - middle, full_matrices=False)[2][:2]
    return lambda places: (places - middle) @ axes.T


def draw_light(figure: Figure, ax: Axes, places: np.ndarray, rows: list[Row]) -> None:
    """Every point of the light by the most that one of its pixels turns the line."""
    most: dict[int, float] = {}
    for row in rows:
        most.setdefault(row.index[0], row.degrees)
    frames, values = np.array(list(most)), 1e3 * np.array(list(most.values()))
    order = np.argsort(values)
    scale = LogNorm(np.quantile(values, 0.1), values.max())
    dots = ax.scatter(*places[frames[order]].T, c=values[order], s=22, cmap=BLUES, norm=scale, zorder=2)
    plain = FuncFormatter(lambda value, _: f"{value:g}")
    label = "thousandths of a degree a pixel, the most of a point's pixels"
    figure.colorbar(dots, ax=ax, label=label, shrink=0.8, format=plain).ax.yaxis.set_minor_formatter(plain)


def draw_landmarks(ax: Axes, question: Question, rows: dict[str, list[Row]], flat) -> None:
    """Landmarks with what a millimetre of each turns the line by."""
    places = flat(np.asarray(question.measured.landmarks))
    for rank, row in enumerate(rows.get("landmarks", [])):
        place = places[row.index[0]]
        label = None if rank else "landmark, thousandths of a degree a mm"
        ax.plot(*place, "s", ms=8, mfc="none", mec=INK, mew=1.6, zorder=4, label=label)
        box = {"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.8}
        text = f"{1e3 * row.degrees:.0f}"
        ax.annotate(text, place, (8, -4), textcoords="offset points", color=INK, weight="bold", bbox=box, zorder=4)


def draw_line(ax: Axes, question: Question, places: np.ndarray) -> None:
    """The two legs of the angle, or the arm and where it points."""
    if question.legs:
        ax.plot(*places.T, "-", color=BAD, lw=2.5, zorder=5, label="angle")
        return
    far = places[0] + 6.0 * (places[1] - places[0])
    ax.plot(*np.stack([places[0], far]).T, "--", color=BAD, lw=1.2, zorder=5)
    ax.plot(*places.T, "-", color=BAD, lw=5, solid_capstyle="round", zorder=5, label="arm")


if __name__ == "__main__":
    main(tyro.cli(Influences, description=__doc__))
