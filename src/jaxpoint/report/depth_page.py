"""The page of the depth of one pair of images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from jaxpoint.io.files import StrPath
from jaxpoint.report import tables
from jaxpoint.report.html import render, write_page


def write_depth_page(
    path: StrPath, names: Sequence[str], rectified: Mapping[str, Any], provenance: Mapping[str, Any]
) -> None:
    """Write the page, whole or not at all.

    Raises:
        OSError: the folder is missing or not writable.
    """
    page = render(
        "depth.html.j2",
        kind="jaxpoint stereo",
        title="Depth of a pair of images",
        subtitle=" and ".join(names),
        sections=[("rectified", "Rectified"), ("provenance", "Provenance")],
        rectified=rectified,
        provenance=tables.origin_table(provenance, {}, None),
        config_text=None,
    )
    write_page(path, page)
