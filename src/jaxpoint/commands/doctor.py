"""`jaxpoint doctor`: can this machine run jaxpoint?"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING

from jaxpoint.commands.console import Console
from jaxpoint.commands.inputs import check_no_out
from jaxpoint.commands.kept_programs import clear_programs, kept_programs, programs_folder
from jaxpoint.commands.options import Outcome, SeededOptions
from jaxpoint.config import RoomConfig
from jaxpoint.errors import MissingDependencyError

if TYPE_CHECKING:
    from jaxpoint.environment import EnvironmentCheck


@dataclass(frozen=True, kw_only=True)
class Doctor(SeededOptions):
    """Say what this machine has: versions, devices, float64, cameras, and how to get what is missing.

    jaxpoint doctor
    """

    clear_programs: bool = field(default=False)
    """Remove the compiled programs that are kept from run to run; they are compiled anew when they are needed."""

    @staticmethod
    def with_defaults(room: RoomConfig) -> Doctor:
        """The command's defaults under a configuration file."""
        return Doctor(runtime=room.runtime)

    def run(self, console: Console) -> Outcome:
        """All findings; something needed that is missing is a failure of the outcome."""
        from jaxpoint.environment import examine

        check_no_out(self.out)
        findings = [*examine(), self._programs()]
        wrong = [finding for finding in findings if not finding.good]
        failure = None
        if wrong:
            failure = MissingDependencyError(f"{wrong[0].name}: {wrong[0].state}. Remedy: {wrong[0].remedy}")
        lines = tuple(f"{f.name:<24}{f.state}" + (f"  ({f.remedy})" if f.remedy else "") for f in findings)
        return Outcome({"good": not wrong, "findings": [asdict(f) for f in findings]}, lines, failure)

    def _programs(self) -> EnvironmentCheck:
        from jaxpoint.environment import EnvironmentCheck

        folder = programs_folder(self.runtime)
        if folder is None:
            return EnvironmentCheck("kept programs", "none are kept")
        if self.clear_programs:
            return EnvironmentCheck("kept programs", f"removed {clear_programs(folder)}")
        found = kept_programs(folder)
        return EnvironmentCheck("kept programs", str(found), remedy="--clear-programs removes them" * bool(found.files))
