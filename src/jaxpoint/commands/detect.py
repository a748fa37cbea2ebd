"""`jaxpoint detect`: images to tracks."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from jaxpoint.commands.console import Console
from jaxpoint.commands.options import Inline, Outcome, SeededOptions
from jaxpoint.config import LedSettings, RoomConfig


@dataclass(frozen=True, kw_only=True)
class Detect(SeededOptions):
    """Find the light in the images of every camera, and write where it was.

    jaxpoint detect led cam1/ cam2/ cam3.mp4 --out tracks.npz

    Give one folder of images or one video a camera, all of the same moments.
    """

    kind: Annotated[Literal["led"], tyro.conf.Positional]
    """What to look for."""
    sources: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """One folder of images or one video a camera."""
    settings: Annotated[LedSettings, Inline] = field(default_factory=LedSettings)

    @staticmethod
    def with_defaults(room: RoomConfig) -> Detect:
        """The command's defaults under a configuration file."""
        return Detect(kind=tyro.MISSING, sources=tyro.MISSING, settings=room.detect.led, runtime=room.runtime)

    def run(self, console: Console) -> Outcome:
        """Write the tracks and, beside them, how the detection went."""
        raise NotImplementedError
