"""Numbers that are none: NaN and infinity, which TOML can hold and ranges with one bound let pass."""

from __future__ import annotations

import math
from collections.abc import Iterator


def not_finite(value: object, place: str = "") -> Iterator[tuple[str, float]]:
    """All of them in nested tables and lists, each with its dotted path."""
    if isinstance(value, dict):
        for key, part in value.items():
            yield from not_finite(part, f"{place}.{key}" if place else key)
    elif isinstance(value, list):
        for i, part in enumerate(value):
            yield from not_finite(part, f"{place}[{i}]")
    elif isinstance(value, float) and not math.isfinite(value):
        yield place, value
