"""Which model of skin's colour is best: the box in Cr and Cb, the thesis's hue with that box, or fitted Gaussians?

On `skin_uci` (pixels of faces against anything else) a fitted model is tried on colours that it has not seen: the folds
are drawn by unique colour, and the figure is the part of the other pixels that passes at the threshold that 99 % of the
skin passes. The boxes have no threshold and stand at their own place.

On `skin_hands30` (photographs of hands with their exact masks) the threshold is the shipped one: recall and overlap
(intersection over union) inside the boxes around the hands, means over the images. The fitted model of an image is made
without that image. This is the harder question, and the one that decides.

The last lines are the numbers in `jaxpoint.detection.person.skin`, fitted to everything.

    python experiments/skin_models.py DATA --out skin_models.md
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import tyro

from jaxpoint.config.person import SkinSettings
from jaxpoint.detection.person.skin import SkinModel, fit_skin, skin_likelihood, skin_mask, skin_model
from jaxpoint.errors import FileFormatError
from jaxpoint.io.files import replacing

FOLDS = 5
RECALL = 0.99


@dataclass(frozen=True)
class SkinModels:
    """Compare models of skin's colour."""

    data: tyro.conf.Positional[Path]
    """Folder that holds skin_uci and skin_hands30."""
    out: Path | None = None
    """Also write the table here."""
    seed: int = 0
    """Of the folds."""


@dataclass(frozen=True)
class Hands:
    """A photograph of hands."""

    image: np.ndarray  # (H, W, 3)
    hand: np.ndarray  # (H, W), exact
    inside: np.ndarray  # (H, W), the boxes around the hands


@dataclass(frozen=True)
class Row:
    """A model on both sets, fractions."""

    name: str
    uci_recall: float
    uci_other: float
    recall: float
    overlap: float


def read_uci(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of skin and others, (N, 3) and (M, 3), blue, green, red."""
    rows = np.vstack([np.loadtxt(path, dtype=np.int16) for path in sorted(folder.glob("Skin_NonSkin*.txt"))])
    skin, other = (rows[rows[:, 3] == label, :3].astype(np.uint8) for label in (1, 2))
    return skin, other


def read_hands(folder: Path) -> list[Hands]:
    """All photographs of skin_hands30."""
    return [_hands(path, folder) for path in sorted((folder / "rgb").glob("*.jpg"))]


def _hands(path: Path, folder: Path) -> Hands:
    image = _read(path)
    hand = _read(folder / "mask" / f"{path.stem}.png")[..., 0] > 127
    inside = np.zeros_like(hand)
    for x, y, width, height in np.loadtxt(folder / "det" / f"{path.stem}.txt", ndmin=2).astype(int):
        inside[y : y + height, x : x + width] = True
    return Hands(image, hand, inside)


def _read(path: Path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise FileFormatError(f"'{path}' cannot be read as an image; fetch the recording again.")
    return image


def other_at_recall(skin: np.ndarray, other: np.ndarray, extra: list[np.ndarray], seed: int) -> float:
    """Part of the other pixels that pass where 99 % of the skin does, each scored by a model without its colour."""
    packed = np.concatenate([skin, other]).astype(np.int64) @ np.array([1 << 16, 1 << 8, 1])
    colours = np.unique(packed, return_inverse=True)[1]
    folds = np.random.default_rng(seed).integers(0, FOLDS, colours.max() + 1)[colours]
    of_skin, of_other = folds[: len(skin)], folds[len(skin) :]
    scores = np.zeros(len(skin)), np.zeros(len(other))
    for fold in range(FOLDS):
        model = fit_skin([skin[of_skin != fold], *extra], other[of_other != fold])
        for score, pixels, among in ((scores[0], skin, of_skin), (scores[1], other, of_other)):
            score[among == fold] = skin_likelihood(pixels[among == fold][None], model)[0]
    return float((scores[1] >= np.quantile(scores[0], 1 - RECALL)).mean())


def recall_and_overlap(photographs: list[Hands], models: list[SkinModel]) -> tuple[float, float]:
    """Means over the photographs, each with its own model."""
    figures = []
    for shot, model in zip(photographs, models):
        found = skin_mask(shot.image[shot.inside][None], model)[0]
        hand = shot.hand[shot.inside]
        both = np.count_nonzero(found & hand)
        figures.append((both / np.count_nonzero(hand), both / np.count_nonzero(found | hand)))
    recall, overlap = np.mean(figures, axis=0)
    return float(recall), float(overlap)


def without_each(skin: np.ndarray, other: np.ndarray, hands: list[np.ndarray]) -> list[SkinModel]:
    """The shipped recipe, once for every photograph, fitted without it."""
    threshold = SkinSettings().threshold
    models = []
    for left_out in range(len(hands)):
        fitted = fit_skin([skin, np.concatenate(hands[:left_out] + hands[left_out + 1 :])], other)
        models.append(SkinModel("fitted", fitted.skin, fitted.other, threshold))
    return models


def compare(options: SkinModels) -> list[Row]:
    """Every model on both sets."""
    skin, other = read_uci(options.data / "skin_uci")
    photographs = read_hands(options.data / "skin_hands30")
    hands = [shot.image[shot.hand & shot.inside] for shot in photographs]
    rows = []
    for name, model in (
        ("box", skin_model(SkinSettings("box"))),
        ("thesis", skin_model(SkinSettings("thesis"))),
        ("thesis, red wrap", skin_model(SkinSettings("thesis", red_wrap=True))),
    ):
        found, passed = (float(skin_mask(pixels[None], model).mean()) for pixels in (skin, other))
        rows.append(Row(name, found, passed, *recall_and_overlap(photographs, [model] * len(hands))))
    threshold = SkinSettings().threshold
    faces = fit_skin(skin, other)
    faces = SkinModel("fitted", faces.skin, faces.other, threshold)
    on_hands = recall_and_overlap(photographs, [faces] * len(hands))
    rows.append(Row("fitted, faces only", RECALL, other_at_recall(skin, other, [], options.seed), *on_hands))
    on_hands = recall_and_overlap(photographs, without_each(skin, other, hands))
    on_uci = other_at_recall(skin, other, [np.concatenate(hands)], options.seed)
    rows.append(Row("fitted (default)", RECALL, on_uci, *on_hands))
    return rows


def shipped(data: Path) -> SkinModel:
    """The default of the package, fitted to all that there is."""
    skin, other = read_uci(data / "skin_uci")
    hands = [shot.image[shot.hand & shot.inside] for shot in read_hands(data / "skin_hands30")]
    return fit_skin([skin, np.concatenate(hands)], other)


def markdown(rows: list[Row]) -> str:
    """The table, per cent."""
    lines = [
        "| model | UCI skin found | UCI other passed | hands: recall | hands: overlap |",
        "|---|---|---|---|---|",
        *(
            f"| {row.name} | {100 * row.uci_recall:.1f} | {100 * row.uci_other:.2f} "
            f"| {100 * row.recall:.1f} | {100 * row.overlap:.1f} |"
            for row in rows
        ),
    ]
    return "\n".join(lines) + "\n"


def main(options: SkinModels) -> None:
    """Print and write the table."""
    text = markdown(compare(options))
    print(text)
    model = shipped(options.data)
    for name, mixture in (("SKIN", model.skin), ("OTHER", model.other)):
        for part in mixture:
            print(name, *(f"{value:.1f}" for value in (*part.mean, *part.covariance)))
    if options.out:
        with replacing(options.out) as file:
            file.write(text.encode())


if __name__ == "__main__":
    main(tyro.cli(SkinModels, description=__doc__))
