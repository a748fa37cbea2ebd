"""The command line: parse, call one command, exit with a code.

Codes: 0 fine, 1 a bug, 2 usage or configuration, 3 environment, 4 data insufficient or degenerate, 5 quality gate
failed (results kept and marked), 6 not converged, 7 file format, 130 interrupted.
"""

from __future__ import annotations

import argparse
import logging
import os
import signal
import sys
import time
import traceback
from collections.abc import Sequence
from functools import reduce
from importlib.metadata import version
from operator import or_
from pathlib import Path
from typing import Annotated, Any, NoReturn, get_args

import tyro

from jaxpoint.commands.align import Align
from jaxpoint.commands.bias_apply import BiasApply
from jaxpoint.commands.bias_compare import BiasCompare
from jaxpoint.commands.bias_fit import BiasFit
from jaxpoint.commands.board import Board
from jaxpoint.commands.calibrate import Calibrate
from jaxpoint.commands.check import Check
from jaxpoint.commands.console import Console
from jaxpoint.commands.convert import Convert
from jaxpoint.commands.demo import Demo
from jaxpoint.commands.detect_board import DetectBoard
from jaxpoint.commands.detect_led import DetectLed
from jaxpoint.commands.detect_marker import DetectMarker
from jaxpoint.commands.detect_person import DetectPerson
from jaxpoint.commands.diff import Diff
from jaxpoint.commands.doctor import Doctor
from jaxpoint.commands.intrinsics import Intrinsics
from jaxpoint.commands.kept_programs import programs_folder, trim_programs
from jaxpoint.commands.objects_add import ObjectsAdd
from jaxpoint.commands.objects_check import ObjectsCheck
from jaxpoint.commands.objects_list import ObjectsList
from jaxpoint.commands.options import Outcome
from jaxpoint.commands.point import Point
from jaxpoint.commands.simulate import Simulate
from jaxpoint.commands.stereo import Stereo
from jaxpoint.commands.triangulate import Triangulate
from jaxpoint.commands.undistort import Undistort
from jaxpoint.commands.validate import Validate
from jaxpoint.config import RoomConfig, check_settings, load_config
from jaxpoint.errors import InsufficientDataError, JaxpointError, MissingDependencyError

Command = (
    DetectLed
    | DetectBoard
    | DetectPerson
    | DetectMarker
    | ObjectsAdd
    | ObjectsList
    | ObjectsCheck
    | BiasFit
    | BiasApply
    | BiasCompare
    | Check
    | Calibrate
    | Align
    | Validate
    | Triangulate
    | Diff
    | Convert
    | Doctor
    | Demo
    | Simulate
    | Point
    | Board
    | Intrinsics
    | Stereo
    | Undistort
)
COMMANDS = get_args(Command)
GROUPS = {
    "detect": "Find something in the images of every camera.",
    "objects": "Keep the database of objects that can be pointed at.",
    "bias": "How far people's lines of pointing miss: learn it, take it back, compare models.",
}
DESCRIPTION = """Calibrate the cameras of a room from a small light waved through it, and say what a person points at.

In this order: detect led, check, calibrate, align, validate; diff tells later whether a camera was touched. Then point
names what the people of a session point at. Without a recording: jaxpoint demo, and jaxpoint simulate for people who
point in a room whose truth is known. More on each command and its flags: jaxpoint COMMAND --help
"""
STYLE = (tyro.conf.FlagCreatePairsOff, tyro.conf.PositionalMetavarFromFieldName)
ENVIRONMENT = MissingDependencyError.exit_code
INTERRUPTED = 130


def command_line() -> NoReturn:
    """What `jaxpoint` on the command line calls: run the command and exit with its code.

    A request to end (SIGTERM) is an interruption as Ctrl-C is, so that nothing half-written stays.
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    code = main(sys.argv[1:])
    if code == INTERRUPTED:
        # Threads of an interrupted XLA compilation crash the interpreter's orderly shutdown.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


def main(argv: Sequence[str]) -> int:
    """Run one command and return its exit code.

    Raises:
        SystemExit: help was asked for (0), or a flag is unknown or has a wrong value (2).
    """
    console = Console("--json" in argv, "-v" in argv or "--verbose" in argv)
    logging.basicConfig(format="%(name)s: %(message)s")
    logging.getLogger("jaxpoint").setLevel(logging.INFO if console.verbose else logging.WARNING)
    try:
        outcome = _run(parse(argv), console)
        console.show(outcome)
    except BrokenPipeError:  # the reader of our output has gone, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except KeyboardInterrupt as interrupt:
        return _fail(console, f"interrupted; {interrupt}" if interrupt.args else "interrupted.", INTERRUPTED)
    except JaxpointError as error:
        return _fail(console, str(error), error.exit_code)
    except OSError as error:
        where = "" if error.filename is None else f" at '{error.filename}'"
        return _fail(console, f"{error.strerror or error}{where}; mend that and repeat the command.", ENVIRONMENT)
    except ModuleNotFoundError as error:
        return _fail(console, f"The package '{error.name}' is missing; see `jaxpoint doctor`.", ENVIRONMENT)
    except Exception as error:
        # The outermost caller: a bug must end in one line and its exit code, with the traceback under -v.
        if _is_bad_input(error):
            return _fail(console, str(error), InsufficientDataError.exit_code)
        if console.verbose:
            traceback.print_exception(error)
        return _fail(console, f"{type(error).__name__}: {error} (a bug; -v shows where)", JaxpointError.exit_code)
    if outcome.failure is None:
        return 0
    _say(outcome.failure)
    return outcome.failure.exit_code


def parse(argv: Sequence[str]) -> Command:
    """The command that the arguments ask for: defaults, under the file of `--config`, under the flags.

    Raises:
        UsageError: the file of `--config` cannot be used, or a value is out of range.
        SystemExit: help was asked for (0), or a flag is unknown or has a wrong value (2).
    """
    finder = argparse.ArgumentParser(prog="jaxpoint", add_help=False, allow_abbrev=False)
    finder.add_argument("--config", type=Path)
    finder.add_argument("--version", action="version", version=f"jaxpoint {version('jaxpoint')}")
    path = finder.parse_known_args(argv)[0].config
    room = RoomConfig() if path is None else load_config(path)
    return check_settings(tyro.cli(_parser(room), prog="jaxpoint", description=DESCRIPTION, args=argv, config=STYLE))


def _parser(room: RoomConfig) -> Any:
    """One subcommand for each class; `DetectLed` is `detect led`, of the group `detect`."""
    single, grouped = [], {group: [] for group in GROUPS}
    for kind in COMMANDS:
        name = kind.__name__.lower()
        group = next((group for group in GROUPS if name.startswith(group)), None)
        own = tyro.conf.subcommand(name.removeprefix(group or ""), default=kind.with_defaults(room))
        (single if group is None else grouped[group]).append(Annotated[kind, own])
    groups = [
        Annotated[reduce(or_, kinds), tyro.conf.subcommand(group, description=GROUPS[group])]
        for group, kinds in grouped.items()
    ]
    return reduce(or_, [*groups, *single])


def _run(command: Command, console: Console) -> Outcome:
    if isinstance(command, Doctor):  # must work where jax does not
        return command.run(console)
    import jax

    from jaxpoint.compilation import keep_programs

    if jax.config.values["jax_compilation_cache_dir"] is None:  # set by the user for all of JAX, it stays
        folder = programs_folder(command.runtime)
        if folder is not None:
            trim_programs(folder, time.time())
            keep_programs(folder)
    with jax.enable_x64(True):
        return command.run(console)


def _is_bad_input(error: Exception) -> bool:
    """Whether it is a ValueError that jaxpoint itself raised: those explain bad input."""
    if not isinstance(error, ValueError):
        return False
    *_, (frame, _) = traceback.walk_tb(error.__traceback__)
    return frame.f_globals.get("__name__", "").startswith("jaxpoint.")


def _fail(console: Console, message: str, code: int) -> int:
    _say(message)
    console.show(Outcome({"error": message, "exit_code": code}))
    return code


def _say(message: object) -> None:
    sys.stderr.write(f"jaxpoint: {message}\n")
