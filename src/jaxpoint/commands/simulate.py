"""`jaxpoint simulate`: a recording of people in a room, whose truth is known."""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from jaxpoint.commands.console import Console
from jaxpoint.commands.options import Outcome, SeededOptions, at
from jaxpoint.config import Count, RoomConfig
from jaxpoint.config.simulation import AtLeastOne, ImageSide, SimulationSettings
from jaxpoint.extras import extra

if TYPE_CHECKING:
    from jaxpoint.simulate.simulated_session import SimulatedSession


@dataclass(frozen=True, kw_only=True)
class Simulate(SeededOptions):
    """Make a recording of people who point at things in a room, with the truth of every frame beside it.

    jaxpoint simulate --out session --gestures 8

    Further settings stand in [simulate] of the file of --config.
    """

    gestures: Count
    """How often somebody points."""
    people: Count
    """How many people there are."""
    cameras: AtLeastOne
    """How many cameras hang in the room."""
    size: Annotated[tuple[ImageSide, ImageSide], tyro.conf.arg(metavar="WIDTH HEIGHT")]
    """Of the images, px; both even."""
    wave: bool = False
    """Wave a light through the dark room first, for `detect led` and `calibrate`."""
    masks: bool = False
    """Also write whose pixel is which, an image a frame."""
    settings: tyro.conf.Suppress[SimulationSettings] = field(default_factory=SimulationSettings)

    @staticmethod
    def with_defaults(room: RoomConfig) -> Simulate:
        """The command's defaults under a configuration file."""
        people, views = room.simulate.people, room.simulate.viewpoints
        return Simulate(
            gestures=people.gestures,
            people=people.people,
            cameras=views.cameras,
            size=views.size,
            settings=room.simulate,
            runtime=room.runtime,
        )

    def run(self, console: Console) -> Outcome:
        """Write the session's folder, whole or not at all."""
        from jaxpoint.runs import MARK, new_run, provenance, write_json
        from jaxpoint.simulate.session_folder import write_preview, write_session
        from jaxpoint.simulate.simulated_session import simulate_session
        from jaxpoint.simulate.wave import simulate_wave

        out = self.needed_folder("session")
        with console.progress() as progress:
            session = simulate_session(self._resolved(), self.seed, progress)
            wave = simulate_wave(session) if self.wave else None
            missing: list[str] = []

            def preview(folder: Path) -> None:
                with extra("preview.jpg", missing):
                    write_preview(folder / "preview.jpg", session)

            with new_run(out, self.force, preview) as folder:
                write_session(folder, session, wave=wave, masks=self.masks, progress=progress)
                write_json(folder / MARK, provenance(shlex.join(["jaxpoint", *sys.argv[1:]]), (), self.seed))
        return replace(_outcome(out, session, self.wave), missing=tuple(missing))

    def _resolved(self) -> SimulationSettings:
        """The settings with what flags say."""
        return replace(
            self.settings,
            people=replace(self.settings.people, gestures=self.gestures, people=self.people),
            viewpoints=replace(self.settings.viewpoints, cameras=self.cameras, size=self.size),
        )


def _outcome(out: Path, session: SimulatedSession, wave: bool) -> Outcome:
    images = int(session.clocks.present.sum())
    figures = {
        "session": str(out),
        "seed": session.seed,
        "cameras": list(session.rig.names),
        "moments": session.clocks.moments,
        "images": images,
        "gestures": len(session.gestures),
        "objects": len(session.objects),
        "seconds_shown": session.play.duration_s,
        "wave": wave,
    }
    lines = (
        f"{images} images of {len(session.viewpoints)} cameras, {session.play.duration_s:.1f} s, "
        f"{len(session.gestures)} gestures among {len(session.objects)} named objects",
        *at("Preview", out / "preview.jpg"),
        f"Session: {out}",
    )
    return Outcome(figures, lines)
