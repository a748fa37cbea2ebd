"""Two calibrations against each other: in words, as a table, and as a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from jaxpoint.calibration.difference import Allowed, Difference
from jaxpoint.io.files import StrPath
from jaxpoint.report import figures_difference, tables
from jaxpoint.report.html import render, write_page
from jaxpoint.report.style import short_names, style, to_svg
from jaxpoint.report.tables import Table
from jaxpoint.report.verdict import Judgement

THOUSAND = 1e3  # from the first one's unit to that of lengths


@dataclass(frozen=True)
class Compared:
    """A difference with what a person needs to read it."""

    found: Difference
    unit: str  # of lengths: "mm", or "thousandths" of the first one's unit
    notes: tuple[str, ...] = ()  # what the comparison cannot say


def difference_table(compared: Compared) -> Table:
    """One row a camera: how far apart, and beside it in brackets what the uncertainties allow."""
    found, allowed = compared.found, compared.found.allowed
    pixels, places = found.pixels, THOUSAND * found.centres
    turned, focal = np.rad2deg(found.rotations), found.focals
    rows = []
    for c, name in enumerate(found.first.names):
        row = [name, f"{pixels[c]:.3f}", f"{places[c]:.3g}", f"{turned[c]:.4f}", f"{focal[c]:+.2f}"]
        if allowed is not None:
            row[2:2] = [f"{allowed.pixels[c]:.3f}"]
            row[4:4] = [f"{THOUSAND * allowed.centres[c]:.3g}"]
            row.append(f"{allowed.ratio[c]:.2f}" + (" *" if c in allowed.culprits else ""))
        rows.append(row)
    header = ["camera", "pixels px", f"centre {compared.unit}", "rotation deg", "focal px"]
    if allowed is not None:
        header[2:2] = ["allowed"]
        header[4:4] = ["allowed"]
        header.append("ratio")
    return Table(header, rows)


def sentences(compared: Compared) -> tuple[str, ...]:
    """What the difference amounts to, and whether chance explains it."""
    found = compared.found
    apart = THOUSAND * np.linalg.norm(found.moved, axis=1)
    places = (
        f"The same place comes out {_short(THOUSAND * found.points)} {compared.unit} apart (rms over {len(apart)} "
        f"places), {_short(apart.max())} {compared.unit} at most"
    )
    if found.allowed is None:
        return (f"{places}.", *compared.notes)
    places += f"; the uncertainties allow {_short(THOUSAND * found.allowed.points)} {compared.unit}."
    return (places, _verdict(found.allowed, found.first.names), *compared.notes)


def _verdict(allowed: Allowed, names: Sequence[str]) -> str:
    measure = f"{allowed.ratio_all:.2f} times what their uncertainties allow ({allowed.freedoms} numbers compared)"
    if allowed.consistent:
        return f"Consistent: they differ {measure}; chance alone exceeds that in {allowed.chance_all:.0%} of cases."
    if not allowed.culprits:
        return f"Not consistent: they differ {measure}, and no single camera explains it."
    listed = " and ".join(names[c] for c in allowed.culprits)
    return (
        f"Not consistent: they differ {measure}. {listed} stands out (* in the table): its lens or place is another "
        "relative to the other cameras. Was it touched?"
    )


def judgement(compared: Compared) -> Judgement:
    """The page's first words."""
    first, *rest = sentences(compared)
    allowed = compared.found.allowed
    if allowed is None:
        return Judgement("care", "Compared, without their uncertainties", " ".join([first, *rest]), [])
    title = "These calibrations are consistent" if allowed.consistent else "These calibrations are not consistent"
    return Judgement("good" if allowed.consistent else "bad", title, f"{rest[0]} {first}", [])


def figures_of(compared: Compared) -> dict[str, Any]:
    """All that `diff.json` holds."""
    found, allowed = compared.found, compared.found.allowed
    cameras = [
        {
            "name": name,
            "pixels_px": _finite(found.pixels[c]),
            "centre": float(THOUSAND * found.centres[c]),
            "rotation_deg": float(np.rad2deg(found.rotations[c])),
            "focal_px": float(found.focals[c]),
        }
        for c, name in enumerate(found.first.names)
    ]
    figures: dict[str, Any] = {
        "unit": compared.unit,
        "scale": float(found.similarity.scale),
        "places": len(found.places),
        "points_rms": THOUSAND * found.points,
        "points_max": float(THOUSAND * np.linalg.norm(found.moved, axis=1).max()),
        "cameras": cameras,
        "consistent": None,
        "notes": list(compared.notes),
    }
    if allowed is None:
        return figures
    for c, camera in enumerate(cameras):
        camera["allowed_pixels_px"] = float(allowed.pixels[c])
        camera["allowed_centre"] = float(THOUSAND * allowed.centres[c])
        camera["ratio"] = float(allowed.ratio[c])
    return figures | {
        "consistent": allowed.consistent,
        "allowed_points_rms": THOUSAND * allowed.points,
        "ratio": allowed.ratio_all,
        "chance": allowed.chance_all,
        "freedoms": allowed.freedoms,
        "culprits": [found.first.names[c] for c in allowed.culprits],
    }


def write_difference_report(
    path: StrPath, compared: Compared, *, titles: tuple[str, str], provenance: Mapping[str, Any] | None = None
) -> None:
    """Write the page of a difference.

    Args:
        path: the HTML file; it is replaced whole or not at all.
        titles: what the first and the second calibration are called.
        provenance: what it was made with, shown as it is.

    Raises:
        OSError: the folder is missing or not writable.
    """
    found, names = compared.found, short_names(compared.found.first.names)
    with style():
        images, largest = figures_difference.shift_maps(found, names)
        figures = {
            "images": Markup(to_svg(images)),
            "room": Markup(to_svg(figures_difference.room_map(found, names, compared.unit))),
        }
    page = render(
        "difference.html.j2",
        kind="jaxpoint diff",
        title="Two calibrations of one room",
        subtitle=f"{titles[1]} against {titles[0]}",
        sections=[("verdict", "Verdict"), ("cameras", "Cameras"), ("images", "Images"), ("room", "Room"),
                  ("provenance", "Provenance")],
        judgement=judgement(compared),
        notes=compared.notes,
        cameras=difference_table(compared),
        compared=found.allowed is not None,
        figures=figures,
        largest=f"{largest:.2g} px",
        provenance=tables.origin_table(provenance, {}, None),
        config_text=None,
    )  # fmt: skip
    write_page(path, page)


def _short(value: float) -> str:
    return f"{value:.0f}" if value >= 100 else f"{value:.2g}"


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
