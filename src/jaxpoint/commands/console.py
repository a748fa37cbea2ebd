"""Where a command talks: progress on standard error, the outcome on standard output."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from jaxpoint.commands.options import Outcome

Progress = Callable[[str, int, int], None]
"""Called with what is being worked on, how much of it is done, and how much there is."""


class Console:
    """The terminal, or a program that reads JSON."""

    def __init__(self, as_json: bool, verbose: bool):
        self.as_json = as_json
        self.verbose = verbose

    @contextmanager
    def progress(self) -> Iterator[Progress]:
        """A callback that draws one bar for each name, on standard error."""
        from rich.console import Console as RichConsole
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
        from rich.progress import Progress as Bars

        terminal = RichConsole(stderr=True)
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        with Bars(*columns, console=terminal, disable=not terminal.is_terminal) as bars:
            tasks = {}

            def advance(name: str, done: int, total: int) -> None:
                if name not in tasks:
                    tasks[name] = bars.add_task(name, total=total)
                bars.update(tasks[name], completed=done, total=total)

            yield advance

    def say(self, lines: Sequence[str]) -> None:
        """Print lines at once, before the outcome is known; nothing where one JSON object is all that is wanted."""
        if not self.as_json:
            sys.stdout.write("".join(f"{line}\n" for line in lines))
            sys.stdout.flush()

    def show(self, outcome: Outcome) -> None:
        """Print the outcome: its lines, or with `--json` its figures as one object; both say what is missing."""
        self.say((*outcome.lines, *outcome.missing))
        if self.as_json:
            figures = {**outcome.figures, "missing": list(outcome.missing)} if outcome.missing else outcome.figures
            sys.stdout.write(json.dumps(figures, allow_nan=False) + "\n")
            sys.stdout.flush()


def table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> tuple[str, ...]:
    """Lines of a plain text table, the first column to the left and the others to the right."""
    cells = [[str(cell) for cell in row] for row in (header, *rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(header))]
    return tuple(
        "  ".join([row[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:]))])
        for row in cells
    )
