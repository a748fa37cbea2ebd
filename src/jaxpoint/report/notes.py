"""Notes on a recording, to be read before its answers are used."""

from __future__ import annotations

import re
from collections.abc import Sequence

_CAMERA = re.compile(r"[Cc]amera '([^']+)'")
_ANY = "\0"  # where a camera stood; in no sentence otherwise


def merged_notes(notes: Sequence[str]) -> list[str]:
    """Every note once; a single sentence where the same holds for several cameras.

    Args:
        notes: sentences that name a camera, if any, as "camera 'cam_0'".
    """
    cameras: dict[str, list[str]] = {}
    for note in dict.fromkeys(notes):
        cameras.setdefault(_CAMERA.sub(_ANY, note, count=1), []).extend(_CAMERA.findall(note)[:1])
    return [_of_all(text, names) for text, names in cameras.items()]


def _of_all(text: str, names: Sequence[str]) -> str:
    if not names:
        return text
    *others, last = (f"'{name}'" for name in names)
    said = f"each of the cameras {', '.join(others)} and {last}" if others else f"camera {last}"
    return text.replace(_ANY, said[0].upper() + said[1:] if text.startswith(_ANY) else said)
